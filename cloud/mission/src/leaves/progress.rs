//! Does the robot get on? Without enough distance or turn in time, a drive has failed (Nav2's PoseProgressChecker).

use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::time::Stamp;

use crate::context::Context;

/// Who makes way for another robot is given so many times as long: after that, both stand.
const MAKING_WAY: f64 = 2.0;
/// And who makes way for people, so many times: they go on.
const AMONG_PEOPLE: f64 = 4.0;

/// Where and when the robot was seen to get on last.
#[derive(Clone, Copy, Debug, Default)]
pub struct Progress {
    anchor: Option<Anchor>,
}

#[derive(Clone, Copy, Debug)]
struct Anchor {
    since: Stamp,
    pose: Pose2,
    /// How many times as long it is given, by what it has made way for since.
    times: f64,
}

impl Progress {
    /// Begins to count anew: what holds the robot now is no fault of the drive's.
    pub fn reset(&mut self) {
        self.anchor = None;
    }

    /// Whether the robot has been without progress for too long.
    pub fn is_stuck(&mut self, ctx: &Context) -> bool {
        let Some(pose) = ctx.robot.pose() else { return false };
        let settings = &ctx.config.settings.progress;
        let times = ctx.robot.state().map_or(1.0, |state| match () {
            () if state.among_people => AMONG_PEOPLE,
            () if state.makes_way => MAKING_WAY,
            () => 1.0,
        });
        match &mut self.anchor {
            Some(anchor)
                if anchor.pose.distance(&pose) < settings.distance
                    && wrap_angle(pose.yaw - anchor.pose.yaw).abs() < settings.angle =>
            {
                anchor.times = anchor.times.max(times);
                ctx.now.secs_since(anchor.since) > anchor.times * settings.timeout
            }
            _ => {
                self.anchor = Some(Anchor {
                    since: ctx.now,
                    pose,
                    times,
                });
                false
            }
        }
    }
}
