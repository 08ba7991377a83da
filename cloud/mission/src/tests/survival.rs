//! Claims about restarts: no goal is lost, none ends twice, none is driven after its end.

use std::collections::BTreeMap;

use zenav_protocol::messages::*;
use zenav_protocol::topics::{MissionReply, MissionRequest};

use super::rig::{Rig, to};

#[test]
fn a_goal_once_acknowledged_survives_a_restart_and_ends_once() {
    let mut rig = Rig::new();
    rig.submit(to(4.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.kill();
    rig.run(20.0);
    assert!(rig.edge.pose.x < 3.9, "without a mission the plan runs out");
    rig.start();
    assert!(rig.run_until(30.0, |rig| rig.state("a").is_end()));
    assert_eq!(rig.state("a"), GoalPhase::Succeeded);
    assert_eq!(rig.kept.ends["a"], 1);
    assert_eq!(rig.goal("a").legs.len(), 1, "the same drive goes on");
    assert!(rig.edge.driven < 4.1);
}

#[test]
fn a_restart_in_mid_drive_goes_on_with_the_same_motion() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    let motion = rig.plans.last().unwrap().1.trajectory_id;
    rig.kill();
    rig.run(0.5);
    rig.start();
    assert!(rig.run_until(30.0, |rig| rig.state("a").is_end()));
    assert!(
        rig.plans.iter().all(|(_, plan)| plan.trajectory_id == motion),
        "it was planned anew"
    );
    assert!(rig.plans.last().unwrap().1.revision.incarnation == 2);
    assert_eq!(rig.state("a"), GoalPhase::Succeeded);
}

#[test]
fn a_paused_goal_is_still_paused_after_a_restart() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.answer(MissionRequest::Pause(PauseRequest::default())).unwrap();
    rig.kill();
    rig.start();
    let before = rig.plans.len();
    rig.run(10.0);
    assert_eq!((rig.state("a"), rig.plans.len()), (GoalPhase::Paused, before));
    rig.answer(MissionRequest::Pause(PauseRequest {
        resume: true,
        ..PauseRequest::default()
    }))
    .unwrap();
    assert!(rig.run_until(30.0, |rig| rig.state("a") == GoalPhase::Succeeded));
}

/// Dies at its `n`th write, for every `n` there is, during a mission of three goals of which the second is cancelled.
#[test]
fn a_mission_killed_at_every_write_loses_no_goal_ends_none_twice_and_commands_under_its_own_lease_alone() {
    let cancel = || {
        MissionRequest::Cancel(CancelRequest {
            id: Some("b".into()),
            request_id: Some("cancel-b".into()),
        })
    };
    let mut write = 0;
    loop {
        let mut rig = Rig::new();
        rig.config.plan_valid = 5.0;
        rig.dies_after_writes = Some(write);
        let mut acknowledged: BTreeMap<String, GoalRequest> = BTreeMap::new();
        let goals = [to(2.0, 0.0, "a"), to(2.0, 1.0, "b"), to(1.0, 0.0, "c")];
        for goal in &goals {
            let client = rig.ask(MissionRequest::Goal(goal.clone()));
            rig.run(0.1);
            if matches!(rig.replies.get(&client), Some(Ok(_))) {
                acknowledged.insert(goal.id.clone().unwrap(), goal.clone());
            }
            if rig.mission.is_none() {
                rig.start();
            }
        }
        // Once it is driven; sent until it is acknowledged, as a client does.
        let mut canceled = !acknowledged.contains_key("b");
        let mut cancel_sent = None;
        let mut ended: BTreeMap<String, GoalPhase> = BTreeMap::new();
        for _ in 0..3000 {
            let driven = |rig: &Rig| {
                rig.kept
                    .goals
                    .get("b")
                    .is_some_and(|b| b.state.state == GoalPhase::Active)
            };
            if !canceled && (cancel_sent.is_some() || driven(&rig)) {
                cancel_sent = Some(rig.ask(cancel()));
            }
            rig.step();
            // The answer may come with a later step than the request's.
            let answers = rig.replies.values().rev();
            if let Some(Ok(MissionReply::Cancel(reply))) = answers.take(3).find(|answer| answer.is_ok()) {
                assert_eq!(reply.state, GoalPhase::Canceled, "write {write}");
                canceled = true;
            }
            if rig.mission.is_none() {
                rig.run(2.0);
                rig.start();
            }
            for (id, goal) in &rig.kept.goals {
                if goal.state.state.is_end() {
                    let first = *ended.entry(id.clone()).or_insert(goal.state.state);
                    assert_eq!(first, goal.state.state, "write {write}: {id} ended twice");
                }
            }
            if canceled && rig.kept.goals.values().all(|goal| goal.state.state.is_end()) {
                break;
            }
        }
        assert!(canceled, "write {write}: the cancel was never acknowledged");
        for id in acknowledged.keys() {
            let end = if id == "b" {
                GoalPhase::Canceled
            } else {
                GoalPhase::Succeeded
            };
            assert_eq!(rig.state(id), end, "write {write}: goal {id}");
            assert_eq!(rig.kept.ends[id], 1, "write {write}: goal {id}");
        }
        let epoch = rig.edge.book.epoch();
        let foreign = rig.plans.iter().find(|(_, plan)| plan.epoch == 0 || plan.epoch > epoch);
        assert!(foreign.is_none(), "write {write}: a plan under no grant of the robot's");
        let in_order = rig.plans.windows(2).all(|pair| pair[0].1.epoch <= pair[1].1.epoch);
        assert!(in_order, "write {write}: a plan under a lease that was lost");
        let died = rig.dies_after_writes.is_none();
        let plans = rig.plans.len();
        rig.run(2.0);
        assert_eq!(rig.plans.len(), plans, "write {write}: driven after its end");
        if !died {
            break;
        }
        write += 1;
    }
    assert!(write >= 8, "only {write} writes in the whole mission");
}

#[test]
fn a_mission_that_was_only_paused_does_not_command_on_waking() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    let sleeping = rig.mission.take();
    rig.run(20.0);
    // Somebody else has taken over meanwhile.
    let other = LeaseRequest::new("mission-b", LeaseRole::Mission, LeaseAction::Acquire, "1");
    let epoch = rig.edge.book.request(rig.now, &other).unwrap().epoch;
    let plans = rig.plans.len();
    rig.mission = sleeping;
    for beat in 1..40 {
        rig.edge.book.renew(rig.now, "mission-b", epoch, beat);
        rig.step();
    }
    assert_eq!(rig.plans.len(), plans);
    assert_eq!(rig.mission.as_ref().unwrap().epoch(), None);
}
