//! Claims about a robot among robots that announce their course.

use nalgebra::Point2;
use zenav_protocol::messages::Intent;

use super::fresh;

#[test]
fn it_waits_for_a_robot_that_goes_first_and_drives_on_when_that_one_is_through_or_silent() {
    for falls_silent in [false, true] {
        let mut rig = fresh();
        let epoch = rig.mission();
        let mut plan = rig.ahead(epoch, 1, 7, 4.0);
        let begun = rig.now;
        // The other robot slowly crosses the plan 2.2 m ahead; it has the longer path, and so right of way.
        let other = |secs: f64| Point2::new(2.2, -2.5 + 0.3 * secs);
        let (mut waited, mut nearest) = (0.0, f64::INFINITY);
        for nth in 0..125_u32 {
            let secs = rig.now.secs_since(begun);
            if !falls_silent || secs < 6.0 {
                rig.inbox.intents.push(Intent {
                    stamp: rig.now,
                    robot: "anna".into(),
                    radius: 0.27,
                    step: 0.4,
                    places: (0..16).map(|nth| other(secs + 0.4 * f64::from(nth))).collect(),
                    later: (1..=12).map(|nth| other(secs + 6.0 + 2.0 * f64::from(nth))).collect(),
                    later_step: 2.0,
                    driving: true,
                    way_secs: 60.0,
                    ..Intent::default()
                });
                nearest = nearest.min((other(secs) - rig.pose.position()).norm());
            }
            if nth % 5 == 0 {
                plan.revision.counter += 1;
                plan.based_on.stamp = rig.now;
                rig.send(plan.clone());
            }
            rig.run(0.2);
            let state = rig.state.as_ref().unwrap();
            if rig.at_rest() && rig.pose.x > 0.5 && rig.pose.x < 3.5 {
                assert!(state.makes_way, "at {secs} s");
                let before = 2.2 - 2.0 * 0.27 - 0.3;
                assert!((before - 0.3..before + 0.1).contains(&rig.pose.x), "{:?}", rig.pose);
                waited += 0.2;
            }
        }
        assert_eq!(rig.rejection(), None);
        assert!(nearest > 2.0 * 0.27, "{nearest}");
        let expected = if falls_silent { 1.0..5.0 } else { 4.0..12.0 };
        assert!(expected.contains(&waited), "{waited} s");
        assert!((rig.pose.x - 4.0).abs() < 0.05 && rig.at_rest(), "{:?}", rig.pose);
    }
}
