//! Corridor. Which free polygons contain the plan in force? A plan leaves them out; the motion worker's answer with the same trajectory has
//! them.

use std::collections::VecDeque;

use serde::Serialize;
use zenav_protocol::messages::{MotionReply, Plan};
use zenav_protocol::trajectory::Trajectory;

use super::compact::milli;

/// Most answers kept; beyond that the oldest is dropped. A worker keeps as many for late subscribers, but only of those that it published, and it
/// publishes none while nobody subscribes.
const MAX_ANSWERS: usize = 16;
/// Most corners of a corridor; one with more is not drawn.
const MAX_CORNERS: usize = 10_000;

/// The corridor of a plan: convex polygons, each as a flat list of `x`, `y` of its corners.
#[derive(Debug, Serialize)]
pub(crate) struct CompactCorridor<'a> {
    trajectory_id: u64,
    polygons: &'a [Vec<f64>],
}

/// A robot's plan, and the newest corridors that may belong to it. The two arrive in either order.
#[derive(Debug, Default)]
pub(crate) struct Corridors {
    /// Id and trajectory of the newest plan.
    plan: Option<(u64, Trajectory)>,
    /// Trajectories with their corridors, oldest first.
    answers: VecDeque<(Trajectory, Vec<Vec<f64>>)>,
    /// The plan whose corridor was returned last.
    told: Option<u64>,
}

impl Corridors {
    /// Takes a plan; returns its corridor unless that is unknown, or was returned last.
    pub(super) fn take_plan(&mut self, plan: &Plan) -> Option<CompactCorridor<'_>> {
        // A renewed plan has the same trajectory.
        if self.plan.as_ref().is_none_or(|(id, _)| *id != plan.trajectory_id) {
            self.plan = Some((plan.trajectory_id, plan.trajectory.clone()));
        }
        self.found()
    }

    /// Takes a motion worker's answer; returns the plan's corridor like [`Self::take_plan`].
    pub(super) fn take_answer(&mut self, answer: &MotionReply) -> Option<CompactCorridor<'_>> {
        let smooth = match answer {
            MotionReply::Trajectory(both) => both.smooth.as_ref()?,
            MotionReply::Smooth(smooth) => smooth,
            MotionReply::Plan(_) => return None,
        };
        let corners: usize = smooth.corridor.iter().map(Vec::len).sum();
        if corners == 0 || corners > MAX_CORNERS {
            return None;
        }
        let polygons = smooth.corridor.iter().map(|polygon| {
            let flat = polygon.iter().flat_map(|corner| [milli(corner.x), milli(corner.y)]);
            flat.collect::<Vec<f64>>()
        });
        self.answers.push_back((smooth.trajectory.clone(), polygons.collect()));
        if self.answers.len() > MAX_ANSWERS {
            self.answers.pop_front();
        }
        self.found()
    }

    fn found(&mut self) -> Option<CompactCorridor<'_>> {
        let (id, trajectory) = self.plan.as_ref()?;
        if self.told == Some(*id) {
            return None;
        }
        let (_, polygons) = self.answers.iter().rev().find(|(driven, _)| driven == trajectory)?;
        self.told = Some(*id);
        Some(CompactCorridor {
            trajectory_id: *id,
            polygons,
        })
    }
}
