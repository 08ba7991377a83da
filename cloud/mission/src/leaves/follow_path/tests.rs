//! A drive while somebody comes into its way, and leaves it again.

use zenav_protocol::messages::MotionReply;

use super::*;
use crate::rig::{Drive, Rig, straight};

/// A way round of 60 s, some 38 s longer than the rest of the plan.
const BESIDE: [(f64, f64); 2] = [(1.0, 5.0), (12.0, 5.0)];
const ROUND: f64 = 60.0;

/// 1 m after the start of its plan, and waiting for somebody who has come into its way at 10 s.
fn waiting() -> Drive {
    let mut drive = Drive::new(r#"<FollowPath path="{path}"/>"#);
    let path = drive.tree.blackboard_mut().set("path", "[[0,0],[12,0]]");
    path.unwrap();
    told(&mut drive, 2.0, |rig| MotionReply::Smooth(rig.smooth(straight())));
    drive.rig.follows(1.0);
    assert_eq!(drive.tick(4.0), Status::Running);
    drive.rig.at(10.0);
    drive.rig.show(Some(6.2));
    assert_eq!(drive.tick(10.0), Status::Running);
    told(&mut drive, 10.1, the_way_round);
    assert_eq!(drive.rig.waits_since(), Some(10.0));
    drive
}

/// It asks for a route at this time, is told this soon after, and goes on.
fn told(drive: &mut Drive, secs: f64, reply: impl FnOnce(&Rig) -> MotionReply) {
    let status = drive.told(secs, reply);
    assert_eq!(status, Status::Running, "{secs} s: {:?}", drive.rig.ctx.goal.failure);
}

fn the_way_round(rig: &Rig) -> MotionReply {
    rig.route(&BESIDE, ROUND)
}

fn plan(drive: &Drive) -> Option<u64> {
    drive.rig.ctx.motion.id()
}

#[test]
fn it_drives_on_while_it_waits_for_who_is_far_ahead() {
    let mut drive = waiting();
    let (before, published) = (plan(&drive), drive.rig.ctx.plans.len());
    assert!(before.is_some() && !drive.rig.ctx.motion.is_held());
    told(&mut drive, 11.5, the_way_round);
    assert_eq!(plan(&drive), before);
    assert!(drive.rig.ctx.plans.len() > published, "its plan is renewed");
}

#[test]
fn it_stays_on_its_way_if_that_is_free_when_the_way_round_is_found() {
    let mut drive = waiting();
    let before = plan(&drive);
    drive.rig.at(51.9);
    drive.rig.show(None);
    told(&mut drive, 52.0, the_way_round);
    assert_eq!(plan(&drive), before);
    assert_eq!(drive.rig.waits_since(), None);
}

#[test]
fn it_drives_round_who_stays_and_turns_back_when_the_short_way_opens_and_saves_time() {
    for (left, turns_back) in [(55.0, true), (22.0, false)] {
        let mut drive = waiting();
        let before = plan(&drive);
        told(&mut drive, 52.0, the_way_round);
        let round = plan(&drive);
        assert_ne!(round, before, "it has waited as long as the way round costs");
        drive.rig.follows(1.0);
        drive.rig.progress.as_mut().unwrap().time_left = left;
        drive.rig.at(53.0);
        drive.rig.show(None);
        assert_eq!(drive.tick(53.0), Status::Running);
        told(&mut drive, 53.1, |rig| rig.route(&[], 21.0));
        assert_eq!(plan(&drive) != round, turns_back, "{left} s left");
        // Either way it does not look for the short way again.
        assert_eq!(drive.rig.ctx.goal.avoided, None);
    }
}
