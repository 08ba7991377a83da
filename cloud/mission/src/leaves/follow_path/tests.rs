//! A drive while somebody comes into its way, and leaves it again.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::time::Duration;

use zenav_behaviour_tree::Tree;
use zenav_protocol::messages::MotionReply;

use super::*;
use crate::rig::{Rig, straight};
use crate::trees::build;

/// A way round of 60 s, some 38 s longer than the rest of the plan.
const BESIDE: [(f64, f64); 2] = [(1.0, 5.0), (12.0, 5.0)];
const ROUND: f64 = 60.0;

struct Drive {
    rig: Rig,
    tree: Tree<Context>,
}

impl Drive {
    /// 1 m after the start of its plan, and waiting for somebody who has come into its way at 10 s.
    fn waiting() -> Self {
        let node =
            r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><FollowPath path="{path}"/></BehaviorTree></root>"#;
        let mut tree = build(node).unwrap();
        tree.blackboard_mut().set("path", "[[0,0],[12,0]]").unwrap();
        let mut drive = Self { rig: Rig::new(), tree };
        drive.told(2.0, |rig| MotionReply::Smooth(rig.smooth(straight())));
        drive.rig.follows(1.0);
        drive.tick(4.0);
        drive.rig.at(10.0);
        drive.rig.show(Some(6.2));
        drive.tick(10.0);
        drive.told(10.1, |rig| rig.route(&BESIDE, ROUND));
        assert_eq!(drive.rig.waits_since(), Some(10.0));
        drive
    }

    fn tick(&mut self, secs: f64) {
        self.rig.at(secs);
        let status = self.tree.tick(Duration::from_secs_f64(secs), &mut self.rig.ctx);
        assert_eq!(status, Ok(Status::Running), "{secs} s: {:?}", self.rig.ctx.goal.failure);
    }

    /// It asks for a route at this time, and is told this soon after.
    fn told(&mut self, secs: f64, reply: impl Fn(&Rig) -> MotionReply) {
        self.tick(secs);
        let reply = reply(&self.rig);
        self.rig.answer(reply);
        self.tick(secs + 0.05);
    }

    fn plan(&self) -> Option<u64> {
        self.rig.ctx.motion.id()
    }
}

#[test]
fn it_drives_on_while_it_waits_for_who_is_far_ahead() {
    let mut drive = Drive::waiting();
    let (plan, published) = (drive.plan(), drive.rig.ctx.plans.len());
    assert!(plan.is_some() && !drive.rig.ctx.motion.is_held());
    drive.told(11.5, |rig| rig.route(&BESIDE, ROUND));
    assert_eq!(drive.plan(), plan);
    assert!(drive.rig.ctx.plans.len() > published, "its plan is renewed");
}

#[test]
fn it_stays_on_its_way_if_that_is_free_when_the_way_round_is_found() {
    let mut drive = Drive::waiting();
    let plan = drive.plan();
    drive.rig.at(51.9);
    drive.rig.show(None);
    drive.told(52.0, |rig| rig.route(&BESIDE, ROUND));
    assert_eq!(drive.plan(), plan);
    assert_eq!(drive.rig.waits_since(), None);
}

#[test]
fn it_drives_round_who_stays_and_turns_back_when_the_short_way_opens_and_saves_time() {
    for (left, turns_back) in [(55.0, true), (22.0, false)] {
        let mut drive = Drive::waiting();
        let before = drive.plan();
        drive.told(52.0, |rig| rig.route(&BESIDE, ROUND));
        let round = drive.plan();
        assert_ne!(round, before, "it has waited as long as the way round costs");
        drive.rig.follows(1.0);
        drive.rig.progress.as_mut().unwrap().time_left = left;
        drive.rig.at(53.0);
        drive.rig.show(None);
        drive.tick(53.0);
        drive.told(53.1, |rig| rig.route(&[], 21.0));
        assert_eq!(drive.plan() != round, turns_back, "{left} s left");
        // Either way it does not look for the short way again.
        assert_eq!(drive.rig.ctx.goal.avoided, None);
    }
}
