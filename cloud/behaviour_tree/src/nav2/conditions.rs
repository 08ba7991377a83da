//! Nav2's conditions. Which need only the blackboard and the time? Whether a goal has changed, whether an error code is one that a recovery
//! can fix, whether time has expired (nav2_behavior_tree 1.5); and, for a simulated robot, whether it keeps to its path and whether poses
//! are near each other.

use serde::Deserialize;

use super::literals;
use crate::leaf::{Leaf, LeafIo};
use crate::ports::{PortError, parse_ints};
use crate::status::Status;
use crate::value::Value;

/// Constructor of a condition.
pub type MakeCondition<C> = fn() -> Box<dyn Leaf<C>>;

/// Constructor of the condition with this id, if it depends only on the blackboard and the time.
pub fn condition<C>(id: &str) -> Option<MakeCondition<C>> {
    Some(match id {
        "GoalUpdated" => || Box::new(GoalUpdated { for_life: false }),
        "GlobalUpdatedGoal" => || Box::new(GoalUpdated { for_life: true }),
        "TimeExpired" => || Box::<TimeExpired>::default(),
        "PathExpiringTimer" => || Box::<PathExpiringTimer>::default(),
        "InitialPoseReceived" => || Box::new(InitialPoseReceived),
        // Unknown, patience exceeded, no progress, no valid control.
        "WouldAControllerRecoveryHelp" => || Box::new(CodeIsAmong(&[100, 104, 105, 106])),
        // Unknown, time-out, no valid path; to one pose and through several.
        "WouldAPlannerRecoveryHelp" => || Box::new(CodeIsAmong(&[200, 207, 208, 300, 307, 308])),
        // Unknown, time-out, smoothed path in collision, failed to smooth.
        "WouldASmootherRecoveryHelp" => || Box::new(CodeIsAmong(&[500, 502, 503, 504])),
        // Unknown, time-out, no valid route.
        "WouldARouteRecoveryHelp" => || Box::new(CodeIsAmong(&[400, 404, 405])),
        "AreErrorCodesPresent" => || Box::new(CodeIsAmong(&[])),
        _ => return None,
    })
}

/// The condition with this id, if it depends only on the blackboard, for a robot at the origin.
pub(super) fn scripted_condition<C>(id: &str) -> Option<Box<dyn Leaf<C>>> {
    Some(match id {
        "IsWithinPathTrackingBounds" => Box::new(WithinBounds),
        "ArePosesNear" => Box::new(PosesNear),
        other => return condition(other).map(|make| make()),
    })
}

/// The goal and the goals, from the ports or, as in Nav2, from entries with these names.
pub(super) fn goals(io: &LeafIo<'_>) -> [Option<Value>; 2] {
    ["goal", "goals"].map(|name| io.value(name).ok().or_else(|| io.entry(name)).cloned())
}

/// `Success` if goal or goals differ from the remembered ones, which they then replace.
///
/// GoalUpdated remembers from its activation: its first tick after a reset by its parent is `Failure`. GlobalUpdatedGoal remembers for the
/// life of the tree: its very first tick is `Success`.
struct GoalUpdated {
    for_life: bool,
}

impl<C> Leaf<C> for GoalUpdated {
    fn start(&mut self, io: &mut LeafIo<'_>, _: &mut C) -> Status {
        let goals = goals(io);
        let seen: Option<[Option<Value>; 2]> = io.recall();
        let first = if self.for_life {
            seen.is_none()
        } else {
            !io.previous().is_active()
        };
        if !first && seen.as_ref() == Some(&goals) {
            return Status::Failure;
        }
        if let Err(wrong) = io.remember(&goals) {
            return io.fail(wrong.to_string());
        }
        Status::from_truth(!first || self.for_life)
    }
}

/// `Success` if `error_code` is among `error_codes_to_check`, or by default among these.
struct CodeIsAmong(&'static [i64]);

impl<C> Leaf<C> for CodeIsAmong {
    fn start(&mut self, io: &mut LeafIo<'_>, _: &mut C) -> Status {
        let Ok(Some(code)) = io.get_optional::<i64>("error_code") else {
            return Status::Failure;
        };
        let among = match io.value("error_codes_to_check").ok().and_then(parse_ints) {
            Some(codes) => codes.contains(&code),
            None => self.0.contains(&code),
        };
        Status::from_truth(among)
    }
}

/// `Success` if the port `initial_pose_received` is true.
struct InitialPoseReceived;

impl<C> Leaf<C> for InitialPoseReceived {
    fn start(&mut self, io: &mut LeafIo<'_>, _: &mut C) -> Status {
        Status::from_truth(io.get("initial_pose_received") == Ok(true))
    }
}

/// `Failure` until `seconds` have passed since its activation, then `Success` once, and again after each such period.
#[derive(Default)]
struct TimeExpired {
    since: Option<f64>,
}

impl<C> Leaf<C> for TimeExpired {
    fn start(&mut self, io: &mut LeafIo<'_>, _: &mut C) -> Status {
        let seconds = match io.number_or("seconds", 1.0) {
            Ok(seconds) => seconds,
            Err(wrong) => return io.fail(wrong),
        };
        let now = io.now().as_secs_f64();
        let since = self.since.filter(|_| io.previous().is_active());
        let expired = since.is_some_and(|since| now - since >= seconds);
        if expired || since.is_none() {
            self.since = Some(now);
        }
        Status::from_truth(expired)
    }
}

/// `Failure` until `seconds` have passed since `path` was last written, then `Success` once, and again after each such period.
#[derive(Default)]
struct PathExpiringTimer {
    began: Option<(u64, f64)>,
}

impl<C> Leaf<C> for PathExpiringTimer {
    fn start(&mut self, io: &mut LeafIo<'_>, _: &mut C) -> Status {
        let seconds = match io.number_or("seconds", 1.0) {
            Ok(seconds) => seconds,
            Err(wrong) => return io.fail(wrong),
        };
        let (sequence, now) = (io.sequence("path"), io.now().as_secs_f64());
        let same = self.began.filter(|(known, _)| *known == sequence);
        if same.is_some_and(|(_, began)| now - began < seconds) {
            return Status::Failure;
        }
        self.began = Some((sequence, now));
        Status::from_truth(same.is_some())
    }
}

/// The part of Nav2's TrackingFeedback that IsWithinPathTrackingBounds reads.
#[derive(Deserialize)]
struct Feedback {
    /// m; positive to the left of the path.
    position_tracking_error: f64,
    /// rad.
    heading_tracking_error: f64,
}

/// Distance from the path according to the tracking feedback, m, if it is outside the bounds on the ports of IsWithinPathTrackingBounds.
/// Without feedback, nothing is out of bounds.
///
/// # Errors
/// A port, or the feedback, has another type.
pub fn off_path(io: &LeafIo<'_>) -> Result<Option<f64>, PortError> {
    if io.value("tracking_feedback").is_err() {
        return Ok(None);
    }
    let feedback: Feedback = io.get_data("tracking_feedback")?;
    let (left, right) = (
        io.number_or("max_error_left", 0.5)?,
        io.number_or("max_error_right", 0.5)?,
    );
    let heading = io.number_or("max_error_heading", std::f64::consts::PI)?;
    let error = feedback.position_tracking_error;
    let aside = if error >= 0.0 { error <= left } else { -error <= right };
    let within = aside && feedback.heading_tracking_error.abs() <= heading;
    Ok(if within { None } else { Some(error) })
}

/// `Success` while the tracking feedback is within bounds, or missing.
struct WithinBounds;

impl<C> Leaf<C> for WithinBounds {
    fn start(&mut self, io: &mut LeafIo<'_>, _: &mut C) -> Status {
        match off_path(io) {
            Ok(None) => Status::Success,
            Ok(Some(error)) => io.fail(format!("{error:.2} m beside the path")),
            Err(wrong) => io.fail(wrong),
        }
    }
}

/// `Success` if `ref_pose` (default: the origin) and `target_pose` are within `tolerance`, m.
struct PosesNear;

impl<C> Leaf<C> for PosesNear {
    fn start(&mut self, io: &mut LeafIo<'_>, _: &mut C) -> Status {
        let pose = |port| {
            io.value(port)
                .ok()
                .and_then(literals::pose_of)
                .map(|pose| [pose.x, pose.y])
        };
        let reference = match io.is_set("ref_pose") {
            true => pose("ref_pose"),
            false => Some([0.0, 0.0]),
        };
        let (Some(one), Some(two)) = (reference, pose("target_pose")) else {
            return io.fail("there are no two poses to compare");
        };
        match io.number_or("tolerance", 0.5) {
            Ok(tolerance) => Status::from_truth((one[0] - two[0]).hypot(one[1] - two[1]) <= tolerance),
            Err(wrong) => io.fail(wrong),
        }
    }
}
