//! Predicted start. In which state will the robot be when a plan made now comes into force? At rest where it stands, or on its trajectory.

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{Mode, Splice};

use crate::context::Context;
use crate::motion::PlanStatus;

/// A trajectory with less time left than this is driven to its end before the next one begins, s.
const SHORT_REST: f64 = 0.4;

/// The state that a route begins in.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Begin {
    pub pose: Pose2,
    pub twist: Twist2,
    /// Point on the previous trajectory; `None` from rest.
    pub splice: Option<Splice>,
}

impl Begin {
    /// From rest, at a pose.
    pub(super) fn at_rest(pose: Pose2) -> Self {
        Self {
            pose,
            twist: Twist2::ZERO,
            splice: None,
        }
    }
}

/// The predicted state of the robot when a plan made now comes into force.
pub(super) fn predicted(ctx: &mut Context, from_rest: bool) -> Result<Begin, &'static str> {
    let (Some(pose), Some(state)) = (ctx.robot.pose(), ctx.robot.state()) else {
        return Err("waits for the robot");
    };
    // Also in the middle of a trajectory, where the robot may be held up.
    if ctx.robot.is_at_rest() {
        return Ok(Begin::at_rest(pose));
    }
    let ahead = ctx
        .motion
        .time(state, ctx.robot.state_age(ctx.now), ctx.latency_budget())
        .filter(|_| ctx.motion.status() == Some(&PlanStatus::Taken));
    // A held trajectory still runs to the point where the new one begins, only slower.
    let follows = state.mode == Mode::Follow && !from_rest;
    if let (Some(time), true, Some(trajectory), Some(trajectory_id)) =
        (ahead, follows, ctx.motion.trajectory(), ctx.motion.id())
    {
        let time = time.max(0.0);
        if time + SHORT_REST < trajectory.end_time() {
            let point = trajectory.sample(time);
            let splice = Splice { trajectory_id, time };
            return Ok(Begin {
                pose: point.pose(),
                twist: point.twist(),
                splice: Some(splice),
            });
        }
    }
    Err("waits for the robot to stand")
}
