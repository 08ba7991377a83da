//! Claims about drives.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{
    EventKind, GoalPhase, GoalPoint, GoalRequest, Intent, LeaseRole, MapAction, Mode, ResumeRequest, Revision,
    StopRequest,
};
use zenav_protocol::topics::EdgeRequest;

use super::rig::{Rig, cancel, room, through, to, tree};

#[test]
fn a_goal_is_driven_to_and_ends_succeeded() {
    let mut rig = Rig::new();
    assert_eq!(rig.submit(to(3.0, 0.0, "a")).unwrap().state, GoalPhase::Accepted);
    let goal = rig.success_of("a", 30.0);
    assert_eq!(goal.reason, None);
    assert!(rig.distance(3.0, 0.0) < 0.05, "{:?}", rig.pose());
    assert_eq!(goal.legs.len(), 1);
    let leg = &goal.legs[0];
    assert_eq!((leg.state, leg.plans, leg.replans), (GoalPhase::Succeeded, 1, 0));
    assert!((3.0..3.2).contains(&leg.planned_length) && leg.ended > Some(leg.started));
    assert!(rig.status.is_some_and(|status| status.leads));
}

#[test]
fn a_plan_is_renewed_each_second_with_the_same_motion() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(6.0);
    assert_eq!(rig.trajectories(), 1);
    assert!((4..=6).contains(&rig.plans.len()), "{}", rig.plans.len());
    let revisions: Vec<Revision> = rig.plans.iter().map(|plan| plan.revision).collect();
    assert!(revisions.windows(2).all(|pair| pair[0] < pair[1]));
    let based_on: Vec<_> = rig.plans.iter().map(|plan| plan.based_on.stamp).collect();
    assert!(
        based_on.windows(2).all(|pair| pair[0] < pair[1]),
        "every renewal is of a newer pose"
    );
    let accepted = |event: &&EventKind| matches!(event, EventKind::PlanAccepted { .. });
    assert_eq!(rig.events.iter().filter(accepted).count(), 1, "{:?}", rig.events);
}

#[test]
fn a_blocked_path_is_replaced_not_renewed() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(2.5);
    let old = rig.plans.last().unwrap().clone();
    rig.occupy(4.0, 0.0, 0.2);
    let before = rig.plans.len();
    let replaced = |rig: &Rig| {
        rig.plans[before..]
            .iter()
            .any(|plan| plan.trajectory_id != old.trajectory_id)
    };
    assert!(rig.run_until(3.0, replaced), "the blocked motion was renewed");
    let next = rig.plans.last().unwrap();
    assert_eq!(next.splice.map(|splice| splice.trajectory_id), Some(old.trajectory_id));
    assert!(
        next.waypoints.len() > 1 && next.trajectory.first().is_some_and(|first| first.v > 0.1),
        "it begins at speed"
    );
    let goal = rig.success_of("a", 40.0);
    assert!(goal.feedback.replans >= 1);
}

#[test]
fn a_path_blocked_for_good_is_not_renewed_and_the_goal_is_given_up_with_the_reason() {
    let mut rig = Rig::on(room(|at| at.y.abs() > 0.8));
    (rig.config.settings.patience, rig.config.settings.linger) = (0.0, 0.0);
    rig.start();
    rig.submit(to(6.0, 0.0, "a")).unwrap();
    rig.run(2.5);
    rig.occupy(4.5, 0.0, 0.45);
    let id = rig.plans.last().unwrap().trajectory_id;
    rig.run(1.0);
    let before = rig.plans.len();
    let goal = rig.end_of("a", 60.0);
    let later = &rig.plans[before..];
    assert!(
        later
            .iter()
            .all(|plan| plan.trajectory_id != id || plan.valid_for < 2.0),
        "the blocked path was renewed"
    );
    assert!(rig.pose().x < 3.9 && rig.truth().collisions == 0);
    assert_eq!(goal.state, GoalPhase::Aborted);
    assert!(goal.reason.as_ref().unwrap().contains("no path"), "{:?}", goal.reason);
}

#[test]
fn cancel_ends_it_canceled_and_the_robot_soon_stands() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(4.0);
    let motion = rig.plans.last().unwrap().trajectory_id;
    let before = rig.plans.len();
    rig.answer(cancel(Some("a"), "c1")).unwrap();
    assert_eq!(rig.phase("a"), GoalPhase::Canceled);
    assert!(rig.run_until(2.0, Rig::is_at_rest));
    let stands = rig.pose();
    rig.run(3.0);
    let after = &rig.plans[before..];
    // The one later plan shortens the motion to the braking time.
    assert!(
        after.len() == 1 && after[0].trajectory_id == motion && after[0].valid_for < 2.0,
        "{after:?}"
    );
    assert!(rig.pose().distance(&stands) < 0.01);
    assert_eq!(rig.ends["a"], 1);
}

#[test]
fn loss_of_the_lease_pauses_and_its_return_goes_on_with_a_new_plan() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    let epoch = rig.take_lease("me", LeaseRole::Operator);
    rig.run(0.3);
    let plans = rig.plans.len();
    assert!(rig.run_until(2.0, Rig::is_at_rest));
    let stands = rig.pose();
    rig.run(3.0);
    assert_eq!(rig.plans.len(), plans, "no plan without the lease");
    assert!(rig.pose().distance(&stands) < 0.01);
    assert_eq!(rig.phase("a"), GoalPhase::Active);
    rig.drop_lease();
    rig.success_of("a", 30.0);
    let next = &rig.plans[plans];
    assert!(next.epoch > epoch && next.splice.is_none());
    assert!(
        next.trajectory[0]
            .pose()
            .position()
            .coords
            .metric_distance(&stands.position().coords)
            < 0.05,
        "it begins where the robot stands"
    );
}

#[test]
fn a_lapsed_lease_is_taken_again_and_the_motion_goes_on_under_the_new_epoch() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    let epoch = rig.plans.last().unwrap().epoch;
    rig.is_mute = true;
    rig.run(1.3);
    rig.is_mute = false;
    let driven = rig.driven();
    rig.run(1.0);
    assert!(
        rig.driven() - driven > 0.5,
        "the plan is finished as far as it is valid"
    );
    let goal = rig.success_of("a", 30.0);
    assert!(rig.plans.iter().any(|plan| plan.epoch > epoch));
    // A renewal after the lapse is refused: the next plan then continues from the motion in force, which does not end.
    let expired = |event: &EventKind| matches!(event, EventKind::PlanExpired { .. });
    assert!(
        goal.feedback.plans <= 2 && !rig.events.iter().any(expired),
        "{:?}",
        rig.events
    );
}

#[test]
fn a_robot_that_starts_anew_is_planned_for_anew() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.reboot();
    rig.run(0.1);
    let before = rig.plans.len();
    rig.success_of("a", 40.0);
    let boot = &rig.state.as_ref().unwrap().boot_id;
    let anew = &rig.plans[before..];
    assert!(!anew.is_empty() && anew.iter().all(|plan| plan.based_on.boot_id == *boot));
}

#[test]
fn a_stopped_robot_gets_no_plan_until_it_is_let_go() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.ask_robot(EdgeRequest::Stop(StopRequest::default())).unwrap();
    rig.run(0.2);
    let before = rig.plans.len();
    rig.run(20.0);
    assert_eq!(rig.plans.len(), before);
    assert_eq!(rig.phase("a"), GoalPhase::Active);
    assert!(rig.is_at_rest() && rig.state.as_ref().unwrap().mode == Mode::Stopped);
    rig.ask_robot(EdgeRequest::Resume(ResumeRequest::default())).unwrap();
    rig.success_of("a", 30.0);
}

#[test]
fn a_robot_that_does_not_get_on_fails_the_drive() {
    let mut rig = Rig::new();
    rig.wheels = Some([0.0; 2]);
    rig.config.settings.progress.timeout = 3.0;
    rig.start();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    let goal = rig.end_of("a", 240.0);
    assert_eq!(goal.state, GoalPhase::Aborted);
    assert!(
        goal.legs.len() == 1 && goal.feedback.recoveries > 3,
        "it is tried again"
    );
    assert!(
        goal.legs
            .iter()
            .all(|leg| leg.reason.as_ref().unwrap().contains("no progress")),
        "{:?}",
        goal.legs
    );
    let took = goal.legs[0].ended.unwrap().secs_since(goal.legs[0].started);
    assert!((80.0..170.0).contains(&took), "{took}");
}

#[test]
fn refused_plans_are_not_repeated_for_ever() {
    // The robot sees an obstacle that is not in the map, and cannot back up.
    let mut rig = Rig::on(room(|at| at.y.abs() > 0.8 || at.x < -0.4));
    rig.stage.robots[0].mapping.mapper.hold();
    rig.occupy(1.2, 0.0, 0.45);
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    let goal = rig.end_of("a", 200.0);
    assert_eq!(goal.state, GoalPhase::Aborted);
    assert!(
        goal.reason.as_ref().unwrap().contains("blocked in the latest scan"),
        "{goal:?}"
    );
    assert!(rig.plans.len() < 60, "{}", rig.plans.len());
    let accepted = |event: &EventKind| matches!(event, EventKind::PlanAccepted { .. });
    assert!(!rig.events.iter().any(accepted), "{:?}", rig.events);
}

#[test]
fn without_a_motion_worker_the_goal_waits_until_its_deadline() {
    let mut rig = Rig::new();
    rig.worker_up = false;
    rig.submit(GoalRequest {
        deadline_secs: Some(20.0),
        ..to(3.0, 0.0, "a")
    })
    .unwrap();
    rig.submit(to(3.0, 1.0, "b")).unwrap();
    // Retried periodically, so look repeatedly over some seconds.
    let says = |rig: &mut Rig, id: &str| {
        (0..25).any(|_| {
            rig.run(0.2);
            rig.goal(id).feedback.step.contains("waits for a motion worker")
        })
    };
    assert!(says(&mut rig, "a"), "{:?}", rig.goal("a"));
    assert_eq!(rig.phase("a"), GoalPhase::Active);
    rig.run(20.0);
    assert_eq!(rig.phase("a"), GoalPhase::Aborted);
    assert!(rig.goal("a").reason.as_ref().unwrap().contains("deadline"));
    assert!(says(&mut rig, "b"), "{:?}", rig.goal("b"));
    rig.worker_up = true;
    rig.success_of("b", 30.0);
}

#[test]
fn a_pause_holds_the_robot_and_a_resume_goes_on() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.pause(false);
    rig.run(3.0);
    assert_eq!(rig.phase("a"), GoalPhase::Paused);
    let stands = rig.pose();
    rig.run(30.0);
    assert!(rig.pose().distance(&stands) < 0.01);
    rig.pause(true);
    rig.success_of("a", 20.0);
}

#[test]
fn waypoints_of_a_goal_are_driven_to_in_order() {
    let mut rig = Rig::new();
    let points = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    rig.submit(through(&points, "w")).unwrap();
    let nearest = rig.success_past("w", 60.0, &points);
    assert!(nearest.iter().all(|near| *near < 0.15), "{nearest:?}");
    let goals: Vec<GoalPoint> = rig.goal("w").legs.iter().filter_map(|leg| leg.goal).collect();
    assert_eq!(goals, through(&points, "w").waypoints);
}

#[test]
fn a_replan_that_comes_late_still_begins_on_the_motion_that_it_replaces() {
    let mut rig = Rig::with(room(|_| false), room(|_| false), 0.4);
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(4.0);
    rig.occupy(4.0, 0.0, 0.2);
    rig.success_of("a", 40.0);
    assert!(rig.plans.iter().any(|plan| plan.splice.is_some()) && rig.driven() > 5.0);
}

#[test]
fn requests_that_change_the_map_carry_the_epoch() {
    let mut rig = Rig::within("kitchen");
    rig.submit(tree("kitchen", "k")).unwrap();
    rig.run(5.0);
    assert_eq!(rig.map_actions(), [MapAction::Reset]);
}

#[test]
fn a_goal_beyond_a_growing_map_is_driven_to_through_the_unknown() {
    let mut rig = Rig::within("empty");
    rig.run(1.0);
    rig.submit(to(9.0, 0.0, "a")).unwrap();
    let goal = rig.success_of("a", 60.0);
    assert_eq!(goal.feedback.replans, 0);
    assert!(rig.distance(9.0, 0.0) < 0.15);
}

#[test]
fn a_goal_without_a_path_is_given_up_after_some_tries_that_are_counted() {
    // The way is blocked after the goal was accepted.
    let mut rig = Rig::on(room(|at| at.y.abs() > 0.8));
    (rig.config.settings.patience, rig.config.settings.linger) = (0.0, 0.0);
    rig.start();
    rig.worker_up = false;
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.occupy(2.0, 0.0, 0.45);
    rig.run(3.0);
    rig.asked.clear();
    rig.worker_up = true;
    let goal = rig.end_of("a", 60.0);
    let asked = rig
        .asked
        .iter()
        .filter(|ask| matches!(ask, zenav_mission::Ask::Motion(_)))
        .count();
    assert_eq!((goal.state, asked), (GoalPhase::Aborted, 4));
    let reason = goal.reason.unwrap();
    assert!(
        reason.contains("no path: the goal (5.00, 0.00)") && reason.contains("after 4 tries"),
        "{reason}"
    );
    assert!(rig.plans.is_empty());
}

#[test]
fn a_robot_that_by_the_map_stands_in_something_leaves_it_by_the_nearest_free_place() {
    // An obstacle stood there when the map was made, and the map is held.
    let mut rig = Rig::with(room(|_| false), room(|at| at.coords.norm() < 0.1), 0.1);
    rig.stage.robots[0].mapping.mapper.hold();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    let goal = rig.success_of("a", 60.0);
    assert_eq!(goal.feedback.recoveries, 1);
    let first = rig.plans[0].waypoints[0].coords.norm();
    assert!((0.3..0.6).contains(&first), "the free place comes first: {first}");
}

#[test]
fn a_robot_that_is_there_already_has_arrived() {
    let mut rig = Rig::new();
    rig.submit(to(0.0, 0.0, "a")).unwrap();
    rig.success_of("a", 10.0);
    assert!(rig.driven() < 0.05, "{}", rig.driven());
}

#[test]
fn without_a_mapper_the_plan_runs_out_and_the_drive_goes_on_once_it_is_back() {
    let mut rig = Rig::new();
    rig.config.settings.map_timeout = 1.0;
    rig.start();
    rig.submit(to(7.0, 0.0, "a")).unwrap();
    rig.run(2.0);
    rig.set_mapper(false);
    rig.run(2.0);
    let before = rig.plans.len();
    rig.run(7.0);
    let stands = rig.pose();
    rig.run(1.0);
    assert_eq!(
        rig.plans.len(),
        before,
        "renewed although the map says nothing any more"
    );
    assert!(rig.pose().distance(&stands) < 0.01, "the plan has run out");
    assert!(stands.x > 1.0 && stands.x < 6.8, "{stands:?}");
    rig.set_mapper(true);
    rig.success_of("a", 60.0);
}

#[test]
fn a_refused_replacement_leaves_the_motion_before_it_in_force() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(2.5);
    rig.occupy(4.3, 0.0, 0.2);
    rig.plans_are_spoiled = true;
    let refused = |rig: &Rig| {
        rig.events
            .iter()
            .any(|event| matches!(event, EventKind::PlanRejected { .. }))
    };
    assert!(rig.run_until(3.0, refused));
    assert!(!rig.is_at_rest(), "the motion before it is driven");
    rig.plans_are_spoiled = false;
    rig.success_of("a", 40.0);
    assert!(rig.driven() < 9.5, "{}", rig.driven());
}

#[test]
fn a_slow_robot_that_crosses_is_passed_instead_of_waited_for() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    let mut nearest = f64::INFINITY;
    for step in 0..100 {
        let secs = 0.2 * f64::from(step);
        let at = |ahead: f64| Point2::new(2.5, -1.2 + 0.1 * (secs + ahead));
        rig.stage.robots[0].inbox.intents.push(Intent {
            robot: "slow".to_owned(),
            radius: 0.3,
            map_from_base: Pose2::new(at(0.0).x, at(0.0).y, FRAC_PI_2),
            velocity: Twist2::new(0.1, 0.0),
            step: 0.4,
            places: (0..16).map(|nth| at(0.4 * f64::from(nth))).collect(),
            later: (1..=12).map(|nth| at(6.0 + 2.0 * f64::from(nth))).collect(),
            later_step: 2.0,
            driving: true,
            // It has the longer way, so it goes first.
            way_secs: 1000.0,
            ..Intent::default()
        });
        rig.run(0.2);
        nearest = nearest.min(rig.distance(at(0.2).x, at(0.2).y));
    }
    let goal = rig.end_of("a", 1.0);
    assert_eq!(goal.state, GoalPhase::Succeeded, "{:?}", goal.reason);
    assert!(rig.trajectories() >= 2 && nearest > 0.3 + 0.27 + 0.05, "{nearest}");
}
