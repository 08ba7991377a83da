//! Claims about drives.

use zenav_protocol::lease::LeaseArbiter;
use zenav_protocol::messages::*;
use zenav_protocol::topics::MissionRequest;

use super::rig::{DT, Rig, to};
use crate::io::Ask;

#[test]
fn a_goal_is_driven_to_and_ends_succeeded() {
    let mut rig = Rig::new();
    assert_eq!(rig.submit(to(3.0, 0.0, "a")).unwrap().state, GoalPhase::Accepted);
    assert!(rig.run_until(30.0, |rig| rig.state("a").is_end()));
    let goal = rig.goal("a");
    assert_eq!((goal.state, goal.reason.clone()), (GoalPhase::Succeeded, None));
    assert!((rig.edge.pose.x - 3.0).abs() < 0.05);
    assert_eq!(goal.legs.len(), 1);
    let leg = &goal.legs[0];
    assert_eq!((leg.state, leg.plans, leg.replans), (GoalPhase::Succeeded, 1, 0));
    assert!((leg.planned_length - 3.0).abs() < 1e-9 && leg.ended > Some(leg.started));
    assert!(rig.published.iter().any(|goal| goal.state == GoalPhase::Succeeded));
    assert!(rig.status.is_some_and(|status| status.leads));
}

#[test]
fn a_plan_is_renewed_each_second_with_the_same_motion() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(6.0);
    let ids: std::collections::BTreeSet<u64> = rig.plans.iter().map(|(_, plan)| plan.trajectory_id).collect();
    assert_eq!(ids.len(), 1);
    assert!((4..=6).contains(&rig.plans.len()), "{}", rig.plans.len());
    let revisions: Vec<Revision> = rig.plans.iter().map(|(_, plan)| plan.revision).collect();
    assert!(revisions.windows(2).all(|pair| pair[0] < pair[1]));
    let based_on: Vec<_> = rig.plans.iter().map(|(_, plan)| plan.based_on.stamp).collect();
    assert!(
        based_on.windows(2).all(|pair| pair[0] < pair[1]),
        "every renewal is of a newer pose"
    );
}

#[test]
fn a_blocked_path_is_replaced_not_renewed() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(2.0);
    let old = rig.plans.last().unwrap().1.clone();
    rig.occupy(4.0, 0.0);
    rig.remap();
    let before = rig.plans.len();
    assert!(rig.run_until(2.0, |rig| rig.plans.len() > before));
    let next = &rig.plans[before].1;
    assert_ne!(next.trajectory_id, old.trajectory_id, "the blocked motion was renewed");
    assert_eq!(next.splice.map(|splice| splice.trajectory_id), Some(old.trajectory_id));
    assert!(
        next.waypoints.len() > 1 && next.trajectory.first().is_some_and(|first| first.v > 0.1),
        "it begins at speed"
    );
    assert!(rig.run_until(40.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded);
    assert_eq!(rig.goal("a").feedback.replans, 1);
}

#[test]
fn a_way_blocked_for_good_is_not_renewed_and_the_goal_is_given_up_with_the_reason() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(2.0);
    for y in -50..78 {
        rig.occupy(4.0, f64::from(y) * 0.1 + 0.05);
    }
    rig.remap();
    let id = rig.plans.last().unwrap().1.trajectory_id;
    let before = rig.plans.len();
    assert!(rig.run_until(60.0, |rig| rig.state("a").is_end()));
    let later = &rig.plans[before..];
    assert!(
        later
            .iter()
            .all(|(_, plan)| plan.trajectory_id != id || plan.valid_for < 2.0),
        "the blocked way was renewed"
    );
    assert!(rig.edge.pose.x < 3.7);
    let goal = rig.goal("a");
    assert_eq!(goal.state, GoalPhase::Aborted);
    assert!(goal.reason.as_ref().unwrap().contains("no path"), "{:?}", goal.reason);
}

#[test]
fn cancel_ends_it_canceled_and_the_robot_soon_stands() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(4.0);
    let motion = rig.plans.last().unwrap().1.trajectory_id;
    let before = rig.plans.len();
    rig.answer(MissionRequest::Cancel(CancelRequest {
        id: Some("a".into()),
        request_id: Some("c1".into()),
    }))
    .unwrap();
    assert_eq!(rig.state("a"), GoalPhase::Canceled);
    rig.run(5.0);
    let after = &rig.plans[before..];
    // The one plan after it shortens the motion to the time that braking takes.
    assert!(
        after.len() == 1 && after[0].1.trajectory_id == motion && after[0].1.valid_for < 2.0,
        "{after:?}"
    );
    let stands = rig.edge.pose;
    rig.run(3.0);
    assert_eq!((rig.edge.pose, rig.plans.len()), (stands, before + 1));
    assert_eq!(rig.kept.ends["a"], 1);
}

#[test]
fn loss_of_the_lease_pauses_and_its_return_goes_on_with_a_new_plan() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    let operator = LeaseRequest::new("me", LeaseRole::Operator, LeaseAction::Acquire, "o1");
    let granted = rig.edge.book.request(rig.now, &operator).unwrap();
    rig.edge.discard(rig.now, "another holder");
    let (plans, stands) = (rig.plans.len(), rig.edge.pose);
    for beat in 1..60 {
        rig.edge.book.renew(rig.now, "me", granted.epoch, beat);
        rig.step();
    }
    assert_eq!(
        (rig.plans.len(), rig.edge.pose),
        (plans, stands),
        "no plan without the lease"
    );
    assert_eq!(rig.state("a"), GoalPhase::Active);
    assert!(rig.run_until(30.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded);
    let next = &rig.plans[plans].1;
    assert!(next.epoch > granted.epoch && next.splice.is_none());
    assert!(
        next.trajectory[0].pose().distance(&stands) < 0.01,
        "it begins where the robot stands"
    );
}

#[test]
fn a_lapsed_lease_is_taken_again_and_the_motion_goes_on_under_the_new_epoch() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    let (motion, epoch) = (
        rig.plans.last().unwrap().1.trajectory_id,
        rig.plans.last().unwrap().1.epoch,
    );
    // The grant is forgotten by the robot, the plan is not.
    rig.edge.book = LeaseArbiter::new(std::time::Duration::from_secs(1), epoch, None);
    assert!(rig.run_until(30.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded);
    assert!(rig.plans.iter().any(|(_, plan)| plan.epoch > epoch));
    assert!(rig.plans.iter().all(|(_, plan)| plan.trajectory_id == motion) || rig.goal("a").feedback.plans <= 2);
}

#[test]
fn a_robot_that_starts_anew_is_planned_for_anew() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.edge.reboot();
    let before = rig.plans.len();
    assert!(rig.run_until(40.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded);
    assert!(
        rig.plans[before..]
            .iter()
            .all(|(_, plan)| plan.based_on.boot_id == rig.edge.boot_id)
    );
}

#[test]
fn a_stopped_robot_gets_no_plan_until_it_is_let_go() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.edge.mode = Mode::Stopped;
    rig.edge.discard(rig.now, "stopped by hand");
    rig.run(0.2);
    let before = rig.plans.len();
    rig.run(20.0);
    assert_eq!(rig.plans.len(), before);
    assert_eq!(rig.state("a"), GoalPhase::Active);
    rig.edge.mode = Mode::Idle;
    assert!(rig.run_until(30.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded);
}

#[test]
fn a_robot_that_does_not_get_on_fails_the_drive() {
    let mut rig = Rig::new();
    rig.edge.stuck = true;
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run_until(160.0, |rig| rig.state("a").is_end());
    let goal = rig.goal("a");
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
    assert!((80.0..130.0).contains(&took), "{took}");
}

#[test]
fn refused_plans_are_not_repeated_for_ever() {
    let mut rig = Rig::new();
    rig.edge.refuse = Some("blocked in the latest scan".into());
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    assert!(rig.run_until(200.0, |rig| rig.state("a").is_end()));
    assert!(
        rig.goal("a")
            .reason
            .as_ref()
            .unwrap()
            .contains("blocked in the latest scan")
    );
    assert!(rig.plans.len() < 60, "{}", rig.plans.len());
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
    rig.run(15.0);
    assert_eq!(rig.state("a"), GoalPhase::Active);
    rig.run(10.0);
    assert_eq!(rig.state("a"), GoalPhase::Aborted);
    assert!(rig.goal("a").reason.as_ref().unwrap().contains("deadline"));
    rig.worker_up = true;
    assert!(rig.run_until(30.0, |rig| rig.state("b") == GoalPhase::Succeeded));
}

#[test]
fn a_pause_holds_the_robot_and_a_resume_goes_on() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    let pause = |resume| {
        MissionRequest::Pause(PauseRequest {
            id: None,
            resume,
            request_id: None,
        })
    };
    rig.answer(pause(false)).unwrap();
    rig.run(3.0);
    assert_eq!(rig.state("a"), GoalPhase::Paused);
    let stands = rig.edge.pose;
    rig.run(60.0);
    assert_eq!(rig.edge.pose, stands);
    rig.answer(pause(true)).unwrap();
    assert!(rig.run_until(20.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded);
}

#[test]
fn waypoints_of_a_goal_are_driven_to_in_order() {
    let mut rig = Rig::new();
    let point = |x, y| GoalPoint { x, y, yaw: None };
    let waypoints = vec![point(1.0, 0.0), point(1.0, 1.0), point(0.0, 1.0)];
    rig.submit(GoalRequest {
        id: Some("w".into()),
        waypoints: waypoints.clone(),
        ..GoalRequest::default()
    })
    .unwrap();
    assert!(rig.run_until(60.0, |rig| rig.state("w").is_end()));
    let goal = rig.goal("w");
    assert_eq!(goal.state, GoalPhase::Succeeded, "{:?}", goal.reason);
    assert_eq!(
        goal.legs.iter().filter_map(|leg| leg.goal).collect::<Vec<_>>(),
        waypoints
    );
}

#[test]
fn a_replan_that_comes_late_still_begins_on_the_motion_that_it_replaces() {
    let mut rig = Rig::new();
    rig.latency = 0.4;
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(4.0);
    rig.occupy(4.3, 0.0);
    rig.remap();
    assert!(rig.run_until(40.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded);
    assert!(rig.edge.driven > 5.0 && DT > 0.0);
}

#[test]
fn asks_that_change_something_carry_the_epoch() {
    let mut rig = Rig::in_the_kitchen();
    rig.map.stored = false;
    rig.submit(GoalRequest {
        id: Some("k".into()),
        tree: Some("kitchen".into()),
        ..GoalRequest::default()
    })
    .unwrap();
    rig.run(5.0);
    assert!(rig.asked.iter().any(|ask| matches!(ask, Ask::Map(request) if request.action == MapAction::Reset && request.epoch.is_some() && request.request_id.is_some())));
}

#[test]
fn a_goal_beyond_a_growing_map_is_driven_to_through_the_unknown() {
    let mut rig = Rig::new();
    rig.map.stored = false;
    rig.run(1.0);
    rig.submit(to(10.0, 0.0, "a")).unwrap();
    assert!(rig.run_until(120.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded, "{:?}", rig.goal("a"));
    assert_eq!(rig.goal("a").feedback.replans, 0);
}

#[test]
fn a_goal_without_a_way_is_given_up_after_some_tries_that_are_counted() {
    let mut rig = Rig::new();
    rig.plans_none = true;
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    assert!(rig.run_until(60.0, |rig| rig.state("a").is_end()));
    let asked = rig.asked.iter().filter(|ask| matches!(ask, Ask::Motion(_))).count();
    assert_eq!((rig.state("a"), asked), (GoalPhase::Aborted, 4));
    let reason = rig.goal("a").reason.clone().unwrap();
    assert!(
        reason.contains("no path: the goal (5.00, 0.00)") && reason.contains("after 4 tries"),
        "{reason}"
    );
    assert!(rig.plans.is_empty());
}

#[test]
fn a_robot_that_by_the_map_stands_in_something_leaves_it_by_the_nearest_free_place() {
    let mut rig = Rig::new();
    rig.occupy(0.0, 0.0);
    rig.remap();
    rig.start_occupied_within = 0.3;
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    assert!(rig.run_until(60.0, |rig| rig.state("a").is_end()));
    let goal = rig.goal("a");
    assert_eq!(
        (goal.state, goal.feedback.recoveries),
        (GoalPhase::Succeeded, 1),
        "{:?}",
        goal.reason
    );
    assert_eq!(
        rig.plans[0].1.waypoints[0],
        nalgebra::Point2::new(0.0, 0.55),
        "the free place comes first"
    );
}

#[test]
fn a_robot_that_is_there_already_has_arrived() {
    let mut rig = Rig::new();
    rig.submit(to(0.0, 0.0, "a")).unwrap();
    assert!(rig.run_until(10.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded, "{:?}", rig.goal("a"));
}

#[test]
fn without_a_mapper_the_plan_runs_out_and_the_drive_goes_on_once_it_is_back() {
    let mut rig = Rig::new();
    rig.config.map_patience = 1.0;
    rig.start();
    rig.submit(to(7.0, 0.0, "a")).unwrap();
    rig.run(2.0);
    rig.mapper_alive = Some(false);
    rig.run(2.0);
    let before = rig.plans.len();
    rig.run(7.0);
    let stands = rig.edge.pose;
    rig.run(1.0);
    assert_eq!(
        rig.plans.len(),
        before,
        "renewed although the map says nothing any more"
    );
    assert_eq!(rig.edge.pose, stands, "the plan has run out");
    assert!(stands.x > 1.0 && stands.x < 6.8, "{stands:?}");
    rig.mapper_alive = Some(true);
    assert!(rig.run_until(60.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded, "{:?}", rig.goal("a"));
}

#[test]
fn a_refused_replacement_leaves_the_motion_before_it_in_force() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(2.0);
    rig.occupy(4.0, 0.0);
    rig.remap();
    rig.edge.refuse = Some("too far from where the robot will be".into());
    rig.run(0.6);
    rig.edge.refuse = None;
    assert!(rig.run_until(40.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded, "{:?}", rig.goal("a"));
    assert!(rig.edge.driven < 9.5, "{}", rig.edge.driven);
}
