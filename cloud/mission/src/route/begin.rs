//! Where will the robot be when a plan made now comes into force? At rest where it stands, or on the motion that it drives.

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::*;

use crate::context::Context;
use crate::motion::PlanStatus;

/// Less than this left of a motion is driven to its end before the next begins, s.
const SHORT_REST: f64 = 0.4;

/// The state that a route begins in.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Begin {
    pub pose: Pose2,
    pub twist: Twist2,
    /// Where on the motion before it; `None` from rest.
    pub splice: Option<Splice>,
}

/// The state that the robot will be in when a plan made now comes into force.
pub(super) fn predicted(ctx: &mut Context, from_rest: bool) -> Result<Begin, &'static str> {
    let (Some(pose), Some(state)) = (ctx.robot.pose(), ctx.robot.state()) else {
        return Err("waits for the robot");
    };
    // Also in the middle of a motion: something may hold the robot there.
    if ctx.robot.is_at_rest() {
        return Ok(Begin {
            pose,
            twist: Twist2::ZERO,
            splice: None,
        });
    }
    let ahead = ctx
        .motion
        .time(state, ctx.robot.state_age(ctx.now))
        .filter(|_| ctx.motion.standing() == Some(&PlanStatus::Taken));
    // A motion that is held runs on to where the new one begins, if slower.
    let follows = state.mode == Mode::Follow && !from_rest;
    if let (Some(time), true, Some(plan)) = (ahead, follows, ctx.motion.plan()) {
        let time = (time + ctx.config.latency_budget).max(0.0);
        let end = plan.trajectory.last().map_or(0.0, |point| point.t);
        if time + SHORT_REST < end {
            let point = sample(&plan.trajectory, time);
            let splice = Splice {
                trajectory_id: plan.trajectory_id,
                time,
            };
            return Ok(Begin {
                pose: point.pose(),
                twist: point.twist(),
                splice: Some(splice),
            });
        }
    }
    Err("waits for the robot to stand")
}

/// Where a trajectory is at a time, linear between its points; held at both ends.
#[must_use]
pub fn sample(trajectory: &[TrajectoryPoint], t: f64) -> TrajectoryPoint {
    let after = trajectory.partition_point(|point| point.t <= t);
    let (Some(from), to) = (trajectory.get(after.saturating_sub(1)), trajectory.get(after)) else {
        return TrajectoryPoint::default();
    };
    let Some(to) = to.filter(|to| after > 0 && to.t > from.t) else {
        return *from;
    };
    let share = (t - from.t) / (to.t - from.t);
    let between = |a: f64, b: f64| a + share * (b - a);
    let turn = zenav_protocol::geometry::wrap_angle(to.yaw - from.yaw);
    TrajectoryPoint {
        t,
        x: between(from.x, to.x),
        y: between(from.y, to.y),
        yaw: zenav_protocol::geometry::wrap_angle(from.yaw + share * turn),
        v: between(from.v, to.v),
        w: between(from.w, to.w),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trajectory_is_held_at_both_ends() {
        let points = [0.0, 1.0].map(|t| TrajectoryPoint {
            t,
            x: 2.0 * t,
            ..TrajectoryPoint::default()
        });
        assert!((sample(&points, 0.25).x - 0.5).abs() < 1e-12);
        assert_eq!(
            (sample(&points, -1.0).x, sample(&points, 5.0).x, sample(&[], 1.0).x),
            (0.0, 2.0, 0.0)
        );
    }
}
