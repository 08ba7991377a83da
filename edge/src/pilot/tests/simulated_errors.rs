//! Claims about a robot whose file also states the errors of its simulated body: the pilot does not read them.

#![allow(clippy::unwrap_used, reason = "tests")]

use zenav_protocol::robot::DriveErrors;

use super::Persisted;
use super::rig::Rig;
use crate::control_io::Publication;

#[test]
fn the_pilot_does_the_same_whatever_errors_its_simulated_body_has() {
    let nominal = zenav_fixtures::robot("tiago");
    let mut crooked = nominal.clone();
    crooked.drive.errors = DriveErrors {
        wheel_radius: [0.05, -0.05],
        wheel_separation: 0.1,
        slip: 0.05,
        mass: 0.5,
        motor_lag: 0.1,
        dead_time: 0.2,
    };
    (crooked.imu.gyro_bias, crooked.imu.compass_bias) = (0.1, 0.2);
    crooked.lidar.as_mut().unwrap().bias = 0.1;
    crooked.gps.as_mut().unwrap().bias = [1.0, -1.0];
    // The rig's sensors and motors have no errors, so both pilots get the same readings as long as they do the same.
    let [mut nominal, mut crooked] = [nominal, crooked].map(|model| {
        let mut rig = Rig::of(model, Persisted::default());
        let epoch = rig.mission();
        let plan = rig.ahead(epoch, 1, 1, 2.0);
        rig.send(plan);
        rig
    });
    let mut poses = 0;
    for _ in 0..200 {
        let [one, other] = [nominal.tick(), crooked.tick()];
        assert_eq!(one.wheels, other.wheels);
        let published = [one, other].map(|out| {
            let all = out.publications.into_iter();
            all.filter(|one| matches!(one, Publication::Pose(_)))
                .collect::<Vec<_>>()
        });
        assert_eq!(published[0], published[1]);
        poses += published[0].len();
    }
    assert!(poses > 100 && nominal.pose.x > 0.5, "{poses} {:?}", nominal.pose);
}
