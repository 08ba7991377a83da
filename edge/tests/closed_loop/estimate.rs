//! The estimate is as good as its covariance says.

use nalgebra::{Matrix3, Vector3};
use zenav_protocol::geometry::wrap_angle;
use zenav_protocol::messages::LeaseRole;

use crate::rig::Rig;

#[test]
fn the_normalised_error_is_that_of_three_states() {
    let mut sum = 0.0;
    let mut count = 0.0;
    let mut worst: f64 = 0.0;
    for seed in 1..=20 {
        let mut rig = Rig::new("kitchen", "tiago", seed, LeaseRole::Mission);
        rig.run(0.5);
        let plan = rig.plan(
            &[(-1.3, -1.1), (-1.3, -2.4), (-0.9, -3.1), (0.0, -3.2), (0.95, -3.0)],
            Vec::new(),
        );
        rig.drive(plan, 60.0, |rig| {
            let (Some(pose), truth) = (&rig.pose, rig.truth()) else {
                return;
            };
            let covariance = Matrix3::from_row_slice(&pose.covariance);
            let (estimate, truth) = (pose.map_from_base, truth.map_from_base);
            let error = Vector3::new(
                estimate.x - truth.x,
                estimate.y - truth.y,
                wrap_angle(estimate.yaw - truth.yaw),
            );
            sum += (error.transpose() * covariance.try_inverse().unwrap() * error)[0];
            count += 1.0;
            worst = worst.max(error.x.hypot(error.y));
        });
    }
    let nees = sum / count;
    eprintln!("NEES {nees:.2} (3 expected), worst position error {worst:.3} m");
    assert!((2.54..3.50).contains(&nees), "{nees}");
    assert!(worst < 0.06, "{worst}");
}
