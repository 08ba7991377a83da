//! Which of Nav2's conditions need nothing but the blackboard? Whether a goal has changed, whether
//! an error code is among those that a recovery can mend (nav2_behavior_tree 1.5).

use super::leaf::{Leaf, LeafIo};
use super::ports::parse_ints;
use super::status::Status;
use super::value::Value;

/// The condition of that id, if the blackboard decides it.
pub fn nav2_condition<C>(id: &str) -> Option<Box<dyn Leaf<C>>> {
    let codes: &'static [i64] = match id {
        "GoalUpdated" => return Some(Box::new(GoalUpdated { for_life: false })),
        "GlobalUpdatedGoal" => return Some(Box::new(GoalUpdated { for_life: true })),
        "InitialPoseReceived" => return Some(Box::new(InitialPoseReceived)),
        // Unknown, patience exceeded, no progress, no valid control.
        "WouldAControllerRecoveryHelp" => &[100, 104, 105, 106],
        // Unknown, time-out, no valid path; to one pose and through many.
        "WouldAPlannerRecoveryHelp" => &[200, 207, 208, 300, 307, 308],
        // Unknown, time-out, smoothed path in collision, failed to smooth.
        "WouldASmootherRecoveryHelp" => &[500, 502, 503, 504],
        // Unknown, time-out, no valid route.
        "WouldARouteRecoveryHelp" => &[400, 404, 405],
        "AreErrorCodesPresent" => &[],
        _ => return None,
    };
    Some(Box::new(CodeIsAmong(codes)))
}

/// The goal and the goals, from the ports or, as Nav2 does, from entries of these names.
pub(crate) fn goals(io: &LeafIo<'_>) -> [Option<Value>; 2] {
    ["goal", "goals"].map(|name| io.value(name).ok().or_else(|| io.entry(name)).cloned())
}

/// `Success` if goal or goals differ from those remembered, which they then replace.
///
/// GoalUpdated remembers from its activation on: its first tick after its parent has reset it is
/// `Failure`. GlobalUpdatedGoal remembers for life: its very first tick is `Success`.
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
        if first && !self.for_life {
            Status::Failure
        } else {
            Status::Success
        }
    }
}

/// `Success` if `error_code` is among `error_codes_to_check`, or among these.
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
        if among { Status::Success } else { Status::Failure }
    }
}

/// `Success` if the port `initial_pose_received` says so.
struct InitialPoseReceived;

impl<C> Leaf<C> for InitialPoseReceived {
    fn start(&mut self, io: &mut LeafIo<'_>, _: &mut C) -> Status {
        match io.get("initial_pose_received") {
            Ok(true) => Status::Success,
            _ => Status::Failure,
        }
    }
}
