//! Claims about a slow link to the cloud: the robot still drives, and its refusals arrive, however late.

use super::rig::{Rig, room, to};

/// Simulated time to a goal 4 m away with this round trip, s.
fn time_over(round_trip: f64) -> f64 {
    let mut rig = Rig::with(room(|_| false), room(|_| false), round_trip);
    rig.submit(to(4.0, 0.0, "a")).unwrap();
    let begun = rig.stage.now().as_secs();
    rig.success_of("a", 30.0 + 4.0 * round_trip);
    rig.stage.now().as_secs() - begun
}

#[test]
fn a_round_trip_of_seconds_delays_a_mission_and_does_not_stop_it() {
    let near = time_over(0.1);
    for (round_trip, times) in [(1.0, 1.2), (2.0, 2.0), (5.0, 3.5)] {
        let far = time_over(round_trip);
        // Both are whole numbers of ticks.
        assert!(
            far <= times * near + 1e-9,
            "{far} s over {round_trip} s, {near} s over 0.1 s"
        );
    }
}

#[test]
fn the_robot_tells_the_round_trip_that_it_measures() {
    let mut rig = Rig::with(room(|_| false), room(|_| false), 1.5);
    assert!(rig.run_until(10.0, |rig| {
        let told = rig.state.as_ref().and_then(|state| state.round_trip_secs);
        told.is_some_and(|secs| (1.5..1.7).contains(&secs))
    }));
}

#[test]
fn over_a_round_trip_that_no_lease_outlives_the_robot_stays_and_the_goal_says_why_within_ten_seconds() {
    let mut rig = Rig::with(room(|_| false), room(|_| false), 14.0);
    // A round trip until the mission has heard the robot, and another one until it knows the robot's model.
    rig.run(40.0);
    rig.submit(to(4.0, 0.0, "a")).unwrap();
    let says_why = |rig: &Rig| rig.goal("a").feedback.step.contains("over a round trip of 10 s no");
    assert!(rig.run_until(10.0, says_why), "{:#?}", rig.goal("a"));
    rig.run(60.0);
    assert!(rig.is_at_rest() && rig.driven() < 0.01, "{} m", rig.driven());
}

#[test]
fn a_refusal_is_heard_although_the_plan_was_renewed_meanwhile() {
    let mut rig = Rig::with(room(|_| false), room(|_| false), 1.5);
    rig.run(6.0);
    rig.plans_are_spoiled = true;
    rig.submit(to(4.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.plans_are_spoiled = false;
    rig.success_of("a", 30.0);
}
