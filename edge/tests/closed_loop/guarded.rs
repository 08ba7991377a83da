//! Whatever is commanded, nothing is hit.

use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::LeaseRole;

use crate::rig::Rig;

#[test]
fn wild_commands_hit_nothing_that_stands_still() {
    for (robot, seed) in [
        ("tiago", 1),
        ("tiago", 2),
        ("tiago", 3),
        ("jackal", 4),
        ("turtlebot3_waffle", 5),
        ("neato", 6),
    ] {
        let mut rig = Rig::new("kitchen", robot, seed, LeaseRole::Operator);
        let mut random = seed;
        let mut unit = || {
            // Knuth's 64-bit linear congruence: any spread of commands will do.
            random = u64::wrapping_mul(random, 6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) as f64 / f64::from(1_u32 << 31)
        };
        let (top, yaw) = (rig.model.drive.top_speed(), rig.model.drive.top_yaw_rate());
        for _ in 0..60 {
            // Full speed ahead three times in four: the lidar sees it. Backwards only what was seen before is known.
            let forward = if unit() < 0.75 { 1.0 } else { -0.3 };
            let turn = if unit() < 0.5 {
                0.0
            } else {
                (2.0 * unit() - 1.0) * yaw.min(2.0)
            };
            rig.teleop = Some(Twist2::new(forward * top, turn));
            rig.run(1.5);
        }
        let truth = rig.truth();
        println!(
            "{robot} {seed}: {:.1} m, clearance {:.3} m, {} contacts {:?}",
            truth.length, truth.min_clearance, truth.collisions, truth.last_contact
        );
        assert_eq!(truth.collisions, 0, "{robot} {seed}: {truth:?}");
    }
}
