//! Claims about restarts: no goal is lost, none ends twice, none is driven after its end.

use std::collections::BTreeMap;

use zenav_protocol::messages::{GoalPhase, GoalRequest, LeaseRole};
use zenav_protocol::topics::{MissionReply, MissionRequest};

use super::rig::{Rig, cancel, to};

#[test]
fn a_goal_once_acknowledged_survives_a_restart_and_ends_once() {
    let mut rig = Rig::new();
    rig.submit(to(4.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.kill();
    rig.run(20.0);
    assert!(rig.pose().x < 3.9, "without a mission the plan runs out");
    rig.start();
    rig.success_of("a", 30.0);
    assert_eq!(rig.ends["a"], 1);
    assert_eq!(rig.goal("a").legs.len(), 1, "the same drive goes on");
    assert!(rig.driven() < 4.1);
}

#[test]
fn a_restart_in_mid_drive_goes_on_with_the_same_motion() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.kill();
    rig.run(0.5);
    rig.start();
    rig.success_of("a", 30.0);
    assert_eq!(rig.trajectories(), 1, "it was planned anew");
    let lives: Vec<u64> = rig.plans.iter().map(|plan| plan.revision.incarnation).collect();
    assert!(lives.is_sorted() && lives.last() == Some(&(lives[0] + 1)), "{lives:?}");
}

#[test]
fn a_paused_goal_is_still_paused_after_a_restart() {
    let mut rig = Rig::new();
    rig.submit(to(5.0, 0.0, "a")).unwrap();
    rig.run(3.0);
    rig.pause(false);
    rig.start();
    let before = rig.plans.len();
    rig.run(10.0);
    assert_eq!((rig.phase("a"), rig.plans.len()), (GoalPhase::Paused, before));
    rig.pause(true);
    rig.success_of("a", 30.0);
}

/// Dies at its `n`th write, for every possible `n`, during a mission of three goals of which the second is cancelled.
#[test]
fn a_mission_killed_at_every_write_loses_no_goal_ends_none_twice_and_commands_under_its_own_lease_alone() {
    let mut write = 0;
    loop {
        let mut rig = Rig::new();
        rig.run(0.5);
        rig.dies_after_writes = Some(write);
        let mut acknowledged: BTreeMap<String, GoalRequest> = BTreeMap::new();
        let goals = [to(0.8, 0.0, "a"), to(0.8, 0.5, "b"), to(0.4, 0.0, "c")];
        for goal in &goals {
            let client = rig.ask(MissionRequest::Goal(goal.clone()));
            rig.run(0.1);
            if matches!(rig.replies.get(&client), Some(Ok(_))) {
                acknowledged.insert(goal.id.clone().unwrap(), goal.clone());
            }
            if rig.stage.robots[0].mission.is_none() {
                rig.start();
            }
        }
        // Cancelled once it is driven; repeated until acknowledged, as a client does.
        let mut canceled = !acknowledged.contains_key("b");
        let mut cancel_sent = false;
        for _ in 0..3000 {
            let is_driven = |rig: &Rig| rig.goals.get("b").is_some_and(|b| b.state == GoalPhase::Active);
            if !canceled && (cancel_sent || is_driven(&rig)) {
                cancel_sent = true;
                rig.ask(cancel(Some("b"), "cancel-b"));
            }
            rig.step();
            // The answer may come a step later than the request.
            let answers = rig.replies.values().rev();
            if let Some(Ok(MissionReply::Cancel(reply))) = answers.take(3).find(|answer| answer.is_ok()) {
                assert_eq!(reply.state, GoalPhase::Canceled, "write {write}");
                canceled = true;
            }
            if rig.stage.robots[0].mission.is_none() {
                rig.run(2.0);
                rig.start();
            }
            if canceled && rig.goals.values().all(|goal| goal.state.is_end()) {
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
            assert_eq!(rig.phase(id), end, "write {write}: goal {id}");
            assert_eq!(rig.ends[id], 1, "write {write}: goal {id}");
        }
        let epoch = rig.state.as_ref().unwrap().lease.epoch;
        let foreign = rig.plans.iter().find(|plan| plan.epoch == 0 || plan.epoch > epoch);
        assert!(foreign.is_none(), "write {write}: a plan under no grant of the robot's");
        let in_order = rig.plans.windows(2).all(|pair| pair[0].epoch <= pair[1].epoch);
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
    let sleeping = rig.stage.robots[0].mission.take();
    rig.run(20.0);
    // Another holder has taken over in the meantime.
    rig.take_lease("anna", LeaseRole::Operator);
    let plans = rig.plans.len();
    rig.stage.robots[0].mission = sleeping;
    rig.run(2.0);
    assert_eq!(rig.plans.len(), plans);
    assert_eq!(rig.stage.robots[0].mission.as_ref().unwrap().epoch(), None);
}
