//! Does the robot get on? Without enough distance or turn in time, a drive has failed (Nav2's PoseProgressChecker).

use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::time::Stamp;

use crate::context::Context;

/// Who makes way for another robot is given so many times as long, for that one to come through a lane: after that, both stand.
const MAKING_WAY: f64 = 4.0;

/// Where and when the robot was seen to get on last.
#[derive(Clone, Copy, Debug, Default)]
pub struct Progress {
    anchor: Option<(Stamp, Pose2)>,
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
        let makes_way = ctx.robot.state().is_some_and(|state| state.makes_way);
        let timeout = if makes_way { MAKING_WAY } else { 1.0 } * settings.timeout;
        match self.anchor {
            Some((since, anchor))
                if anchor.distance(&pose) < settings.distance
                    && wrap_angle(pose.yaw - anchor.yaw).abs() < settings.angle =>
            {
                ctx.now.secs_since(since) > timeout
            }
            _ => {
                self.anchor = Some((ctx.now, pose));
                false
            }
        }
    }
}
