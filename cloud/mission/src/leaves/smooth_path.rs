//! SmoothPath: a motion worker smooths a path, starting at rest. The result is a path of corner points; FollowPath drives it from the
//! robot's position.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{GoalPoint, MotionReply, MotionRequest, SmoothRequest};
use zenav_protocol::time::Stamp;

use super::path::{self, DrivenPath};
use super::ports::{settled_path, write};
use super::selectors::Choice;
use super::{fail, no_error, step};
use crate::context::Context;
use crate::io::{Answer, NoAnswer, Ticket};
use crate::route::RouteData;
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Nav2's error codes of path smoothing.
mod error_code {
    pub const UNKNOWN: i64 = 500;
    pub const INVALID_SMOOTHER: i64 = 501;
    pub const TIMEOUT: i64 = 502;
    pub const FAILED_TO_SMOOTH_PATH: i64 = 504;
    pub const INVALID_PATH: i64 = 505;
}

/// A worker answered another request.
const OFF_TOPIC: &str = "the motion worker answered another request";
/// Greatest deviation of the result from the smooth curve, m.
const EXACT: f64 = 0.01;
/// Least time to wait for a worker, s: enough for a network.
const PATIENCE: f64 = 3.0;

/// Smooths `unsmoothed_path`.
#[derive(Default)]
pub struct SmoothPath {
    ticket: Option<Ticket>,
    given: Option<RouteData>,
    /// Frame of the map that the request is in.
    frame: u64,
    since: Stamp,
}

impl SmoothPath {
    /// Sends the path to a motion worker, in the present frame of the map.
    fn ask(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let data = match settled_path(io, ctx, "unsmoothed_path") {
            Ok(data) if data.points.len() > 1 => data,
            Ok(_) => {
                let why = "a path of fewer than two points";
                return fail(io, ctx, Some(error_code::INVALID_PATH), why);
            }
            Err(why) => return fail(io, ctx, Some(error_code::INVALID_PATH), why),
        };
        let (Some(model), Some(map)) = (ctx.robot.model().cloned(), ctx.map.newest()) else {
            let why = "the robot or its map is not known yet";
            return fail(io, ctx, Some(error_code::UNKNOWN), why);
        };
        if !ctx.frames.is_settled() {
            return step(io, ctx, "waits until the map is in one frame");
        }
        let start = start(&data.driven());
        let request = SmoothRequest {
            robot: ctx.config.robot.to_string(),
            model,
            map,
            path: data.points.clone(),
            via: data.via.iter().map(GoalPoint::position).collect(),
            backwards: data.backwards.clone(),
            start,
            start_velocity: Twist2::ZERO,
            goal_yaw: data.goal.yaw,
            unknown_is_free: ctx.config.settings.unknown_is_free,
            profile: ctx.goal.profile,
        };
        self.ticket = Some(ctx.asks.ask_motion(MotionRequest::Smooth(request)));
        self.given = Some(data);
        self.frame = ctx.frames.at();
        step(io, ctx, "smooths")
    }
}

impl Leaf<Context> for SmoothPath {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.halt(io, ctx);
        if let Err(why) = Choice::Smoother.check(io.get_optional("smoother_id").ok().flatten()) {
            return fail(io, ctx, Some(error_code::INVALID_SMOOTHER), why);
        }
        self.since = ctx.now;
        self.ask(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let waited = ctx.now.secs_since(self.since);
        let patience = io
            .number_or("max_smoothing_duration", PATIENCE)
            .unwrap_or(PATIENCE)
            .max(PATIENCE);
        let Some(answer) = self.ticket.and_then(|ticket| ctx.asks.take(ticket)) else {
            if waited > patience {
                self.halt(io, ctx);
                let why = format!("no motion worker has smoothed the path within {patience:.0} s");
                return fail(io, ctx, Some(error_code::TIMEOUT), why);
            }
            if self.ticket.is_none() {
                return self.ask(io, ctx);
            }
            return step(io, ctx, "smooths");
        };
        self.ticket = None;
        let reply = match answer {
            Ok(Answer::Motion(reply)) => match *reply {
                MotionReply::Smooth(reply) if reply.map.frame != ctx.frames.at() || self.frame != ctx.frames.at() => {
                    // The next tick asks again.
                    return step(io, ctx, "smooths anew: the map has moved");
                }
                MotionReply::Smooth(reply) => reply,
                _ => return fail(io, ctx, Some(error_code::UNKNOWN), OFF_TOPIC),
            },
            Ok(_) => return fail(io, ctx, Some(error_code::UNKNOWN), OFF_TOPIC),
            Err(NoAnswer::Silent(why)) => return fail(io, ctx, Some(error_code::TIMEOUT), why),
            Err(NoAnswer::Refused(refusal)) => {
                return fail(io, ctx, Some(error_code::FAILED_TO_SMOOTH_PATH), refusal.to_string());
            }
        };
        let (Some(given), false) = (self.given.take(), reply.trajectory.is_empty()) else {
            let why = format!("the path cannot be driven: {}", reply.statistics.status);
            return fail(io, ctx, Some(error_code::FAILED_TO_SMOOTH_PATH), why);
        };
        let DrivenPath { points, backwards } = DrivenPath::of(&reply.trajectory, EXACT);
        let smooth = RouteData {
            route: 0,
            length: path::length(&points),
            points,
            backwards,
            frame: Some(self.frame),
            ..given
        };
        if let Err(why) = write(io, "smoothed_path", smooth.value()) {
            return fail(io, ctx, Some(error_code::UNKNOWN), why);
        }
        // A tree with other types of entries on these ports gets no values.
        let _ = io.set("smoothing_duration", waited);
        let _ = io.set("was_completed", true);
        no_error(io);
        Status::Success
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.start(io, ctx)
    }

    fn halt(&mut self, _io: &mut LeafIo<'_>, ctx: &mut Context) {
        ctx.asks.forget(self.ticket.take());
    }
}

/// The first point of a path, with the heading in which the robot drives its first leg.
fn start(path: &DrivenPath) -> Pose2 {
    let begin = path.points.first().copied().unwrap_or_else(Point2::origin);
    let mut corners = path.corners();
    let first = corners.find(|(point, _)| (point - begin).norm() > 1e-6);
    let ahead = first.map(|(point, is_backwards)| if is_backwards { begin - point } else { point - begin });
    Pose2::new(begin.x, begin.y, ahead.map_or(0.0, |ahead| ahead.y.atan2(ahead.x)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{Drive, straight};

    #[test]
    fn a_path_of_the_first_frame_is_carried_over_and_an_answer_in_that_frame_is_asked_for_again() {
        let mut drive = Drive::new(
            r#"<Sequence>
              <ComputePathToPose goal="12;0" path="{path}"/>
              <SmoothPath unsmoothed_path="{path}" smoothed_path="{smooth}"/>
            </Sequence>"#,
        );
        // The corners to be smoothed, m along y; the answer is in the frame of the newest map.
        let smooths = |drive: &mut Drive| {
            drive
                .smooths(straight())
                .path
                .iter()
                .map(|point| point.y)
                .collect::<Vec<_>>()
        };
        assert_eq!(drive.told(2.0, |rig| rig.route(&[], 24.0)), Status::Running);
        assert_eq!(drive.path("path").frame, Some(0));
        assert_eq!(smooths(&mut drive), [0.0, 0.0]);
        drive.rig.closes(Pose2::new(0.0, 1.0, 0.0));
        assert_eq!((drive.tick(2.1), drive.tick(2.15)), (Status::Running, Status::Running));
        assert_eq!(smooths(&mut drive), [1.0, 1.0], "all lies a metre farther to the left");
        assert_eq!(drive.tick(2.2), Status::Success);
        assert_eq!(drive.path("smooth").frame, Some(1));
    }
}
