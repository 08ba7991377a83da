//! Plan life cycle. Which plan drives the robot? Received, judged, accepted or rejected, discarded, and ended: reached, expired or lost.

use std::cmp::Reverse;
use zenav_protocol::geometry::Pose2;

use zenav_protocol::messages::{EventKind, Plan};
use zenav_protocol::time::Stamp;

use super::Pilot;
use crate::acceptance::{Rejection, judge_head};
use crate::active_plan::{ActivePlan, Scene, Taken};

/// Verdict on a plan with a new trajectory.
pub(crate) const ACCEPTED: &str = "accepted";
/// Verdict on a plan that renews the trajectory being followed.
pub(crate) const RENEWED: &str = "renewed";
/// Most discarded trajectories remembered.
const DISCARDED: usize = 32;
/// Most rejected plans remembered.
const REFUSED: usize = 256;

impl Pilot {
    /// Judges the plans that arrived: of a burst, the newest plan of the current epoch that may be driven counts. Returns the verdict on
    /// it, or on the last one that was refused, in a word.
    pub(super) fn receive_plans(&mut self, now: Stamp, mut plans: Vec<Plan>) -> Option<&'static str> {
        let epoch = self.authority.epoch();
        plans.sort_by_key(|plan| Reverse((plan.epoch == epoch, plan.epoch, plan.revision)));
        let mut refused = None;
        for plan in plans {
            match self.receive_plan(now, epoch, plan) {
                Ok(verdict) => return Some(verdict),
                Err(verdict) => refused = verdict.or(refused),
            }
        }
        refused
    }

    /// Judges one plan: `Ok` with the verdict if it is driven from now on, otherwise `Err`; no verdict on a plan that was judged before.
    fn receive_plan(&mut self, now: Stamp, epoch: u64, plan: Plan) -> Result<&'static str, Option<&'static str>> {
        let newest = self.newest.filter(|(of, _)| *of == epoch).map(|(_, revision)| revision);
        let of_epoch = plan.epoch == epoch;
        let again = newest == Some(plan.revision) || self.refused.contains(&(epoch, plan.revision));
        if again && of_epoch {
            // The bus delivers the retained sample again after every reconnection: no event.
            return Err(None);
        }
        let (goal_id, revision, trajectory_id) = (
            plan.goal_id.chars().take(128).collect::<String>(),
            plan.revision,
            plan.trajectory_id,
        );
        let taken = self.judge_plan(now, plan);
        // Only an accepted plan makes others stale: a rejected one, whatever its counter, must not lock the holder out.
        if taken.is_ok() {
            self.newest = Some((epoch, revision));
        }
        if taken.is_err() && of_epoch {
            self.refused.push_back((epoch, revision));
            if self.refused.len() > REFUSED {
                self.refused.pop_front();
            }
        }
        let verdict = match &taken {
            Ok(Taken::Renewed) => Ok(RENEWED),
            Ok(Taken::Begun) => Ok(ACCEPTED),
            Err(rejection) => Err(Some(rejection.kind())),
        };
        match taken {
            Ok(Taken::Renewed) => {}
            Ok(Taken::Begun) => self.events.record(
                now,
                EventKind::PlanAccepted {
                    goal_id,
                    revision,
                    trajectory_id,
                },
            ),
            Err(rejection) => self.events.record(
                now,
                EventKind::PlanRejected {
                    goal_id,
                    revision,
                    trajectory_id,
                    reason: rejection.to_string(),
                },
            ),
        }
        verdict
    }

    fn judge_plan(&mut self, now: Stamp, plan: Plan) -> Result<Taken, Rejection> {
        let settings = &self.config.settings.acceptance;
        let grant = self.authority.grant(now, self.events.boot_id(), self.newest, settings);
        let expiry = judge_head(&plan, &grant)?;
        if !self.health.is_trusted() {
            return Err(Rejection::NotLocalised);
        }
        if self.discarded.contains(&plan.trajectory_id) {
            return Err(Rejection::Discarded(plan.trajectory_id));
        }
        if let Some(id) = self.maneuvers.running() {
            return Err(Rejection::Busy(id.to_owned()));
        }
        let scene = Scene {
            model: &self.config.model,
            map_from_base: self.estimator.map_from_base(),
            map_from_odom: self.estimator.map_from_odom(),
            velocity: self.estimator.velocity(),
            obstacles: &self.obstacles,
            settings: &self.config.settings,
        };
        let renews = |active: &ActivePlan| active.plan().trajectory_id == plan.trajectory_id;
        let here_from_plan = match self.frame.moved_since(plan.map.frame) {
            Some(moved) => moved,
            // The tracked path was carried over while it was in force; a renewal of the same plan needs no move.
            None if self.active_plan.as_ref().is_some_and(renews) => Pose2::IDENTITY,
            None => {
                return Err(Rejection::OldFrame {
                    got: plan.map.frame,
                    current: self.frame.number(),
                });
            }
        };
        ActivePlan::take(&mut self.active_plan, plan, here_from_plan, expiry, &scene)
    }

    /// Discards the plan and the maneuver.
    pub(crate) fn discard(&mut self, now: Stamp, reason: &str) {
        self.maneuvers.cancel(now, reason, &mut self.events);
        self.discard_plan(now, reason);
        self.dead_man.release();
    }

    /// Discards the plan: its trajectory is never accepted again.
    pub(crate) fn discard_plan(&mut self, now: Stamp, reason: &str) {
        let Some(active) = self.active_plan.take() else {
            return;
        };
        if self.discarded.len() == DISCARDED {
            self.discarded.pop_front();
        }
        self.discarded.push_back(active.plan().trajectory_id);
        if !active.is_finished() {
            self.events.record(
                now,
                EventKind::PlanDiscarded {
                    goal_id: active.plan().goal_id.clone(),
                    reason: reason.to_owned(),
                },
            );
        }
    }

    /// Forgets the discarded trajectories: another holder numbers its own anew.
    pub(crate) fn forget_discarded(&mut self) {
        self.discarded.clear();
    }

    /// Ends the plan when it is reached, expired or lost.
    pub(super) fn end_plan(&mut self, now: Stamp) {
        let pose = self.estimator.map_from_base();
        let off_track = self
            .avoidance
            .is_evading()
            .then_some(self.config.settings.avoidance.off_track);
        let Some(active) = &mut self.active_plan else {
            self.avoidance.reset();
            return;
        };
        if active.ends(&pose) {
            let plan = active.plan();
            self.events.record(
                now,
                EventKind::PlanFinished {
                    goal_id: plan.goal_id.clone(),
                    trajectory_id: plan.trajectory_id,
                },
            );
        } else if active.expires(now) {
            self.events.record(
                now,
                EventKind::PlanExpired {
                    goal_id: active.plan().goal_id.clone(),
                },
            );
        } else if let Some(reason) = active.lost(off_track) {
            self.discard_plan(now, reason);
        }
    }
}
