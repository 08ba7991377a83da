//! Active plan. Which plan is in force, and is it still valid? Tracks publication, renewal, holding, and the robot's reports.
//!
//! A trajectory keeps its id while its plan is renewed; the robot continues along it. A new trajectory gets a new id. The decision to move
//! is made by leaves, not here.

mod pace;
mod recheck;

use nalgebra::Point2;
use zenav_protocol::messages::{
    BasedOn, EdgeState, Event, EventKind, MapRef, Mode, Plan, PlanStatistics, Revision, Splice,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::trajectory::Trajectory;

use self::pace::Pace;
pub(crate) use self::recheck::{BLOCKED_WITHIN, Recheck, recheck};
use super::frames::MapFrames;
use super::lease::newer;
use super::robot::is_rest;

/// A robot that does not report an accepted plan for this long has dropped it, s.
const DROPPED: f64 = 0.6;

/// Content of a new plan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlanDraft {
    /// The map that the plan was made on.
    pub map: MapRef,
    /// Corner points.
    pub waypoints: Vec<Point2<f64>>,
    /// Trajectory; empty for plain waypoints.
    pub trajectory: Trajectory,
    /// Point on the previous trajectory at which this one begins.
    pub splice: Option<Splice>,
    /// How the plan was computed.
    pub statistics: PlanStatistics,
}

/// The robot's response to the plan in force.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlanStatus {
    /// No response yet.
    Sent,
    /// The robot drives it, or will continue once it is renewed.
    Taken,
    /// The robot is at rest at its end.
    Finished,
    /// The robot refused it.
    Refused(String),
    /// The robot discarded it.
    Void(String),
}

#[derive(Clone, Debug)]
struct ActivePlan {
    /// The plan as published, in the frame that it names.
    plan: Plan,
    /// Its trajectory in the mission's frame of the map.
    here: Trajectory,
    status: PlanStatus,
    /// Time of the last publication, renewal or hold.
    published: Stamp,
    /// Time at which the robot last reported the plan.
    confirmed: Stamp,
    held: bool,
    /// Whether the robot has accepted this trajectory: then a refusal refers to a renewal.
    was_taken: bool,
    /// Rate at which the robot advances.
    pace: Pace,
    /// The newest revision at the last refusal: over a slow link older ones were still under way, and their refusals are not news.
    refused: Option<Revision>,
}

/// Maintains the plan in force.
#[derive(Clone, Debug, Default)]
pub struct MotionKeeper {
    incarnation: u64,
    revisions: u64,
    motions: u64,
    current: Option<ActivePlan>,
    /// The previous plan, while the robot has not accepted the new one.
    previous: Option<ActivePlan>,
    changed: bool,
    /// Whether the present drive has already had a plan: the next one replaces it.
    pub was_begun_for_leg: bool,
}

impl MotionKeeper {
    /// No plan in force.
    #[must_use]
    pub fn new(incarnation: u64) -> Self {
        Self {
            incarnation,
            ..Self::default()
        }
    }

    /// Restores the plan that was in force before a restart: it counts as accepted until the robot reports otherwise.
    pub(crate) fn restore(&mut self, plan: Plan) {
        self.was_begun_for_leg = true;
        let long_ago = Stamp::ZERO;
        self.current = Some(ActivePlan {
            status: PlanStatus::Taken,
            was_taken: true,
            ..ActivePlan::sent(plan, Pace::default(), long_ago)
        });
    }

    /// Id of the trajectory in force.
    #[must_use]
    pub fn id(&self) -> Option<u64> {
        self.current.as_ref().map(|current| current.plan.trajectory_id)
    }

    /// The robot's response; `None` when no plan is in force.
    #[must_use]
    pub fn status(&self) -> Option<&PlanStatus> {
        self.current.as_ref().map(|current| &current.status)
    }

    /// The plan as last published.
    #[must_use]
    pub fn plan(&self) -> Option<&Plan> {
        self.current.as_ref().map(|current| &current.plan)
    }

    /// The trajectory in force, in the mission's frame of the map.
    #[must_use]
    pub fn trajectory(&self) -> Option<&Trajectory> {
        self.current.as_ref().map(|current| &current.here)
    }

    /// Switches to the present frame of the map: the driven path moves with the robot's surroundings, as it does on the robot.
    pub(crate) fn settle(&mut self, frames: &MapFrames) {
        for active in self.current.iter_mut().chain(&mut self.previous) {
            match frames.robot(active.plan.map.frame) {
                Some(moved) => active.here = active.plan.trajectory.moved(moved),
                None => active.status = PlanStatus::Void("it was made in an older frame of the map".to_owned()),
            }
        }
    }

    /// Whether the plan is held, to run out.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.current.as_ref().is_some_and(|current| current.held)
    }

    /// Time since its last publication or renewal, s.
    #[must_use]
    pub fn age(&self, now: Stamp) -> f64 {
        self.current
            .as_ref()
            .map_or(f64::INFINITY, |current| now.secs_since(current.published))
    }

    /// The plan to store, if it has changed since the last call.
    pub(crate) fn take_changed(&mut self) -> Option<Option<Box<Plan>>> {
        std::mem::take(&mut self.changed).then(|| self.current.as_ref().map(|current| Box::new(current.plan.clone())))
    }

    /// Puts a new plan into force.
    pub(crate) fn begin(
        &mut self,
        draft: PlanDraft,
        goal_id: &str,
        epoch: u64,
        based_on: BasedOn,
        valid_for: f64,
        now: Stamp,
    ) -> Plan {
        self.motions += 1;
        let before = self.current.as_ref().filter(|_| draft.splice.is_some());
        let pace = before.map(|before| before.pace.carried_over()).unwrap_or_default();
        let plan = Plan {
            goal_id: goal_id.to_owned(),
            epoch,
            revision: self.next_revision(),
            trajectory_id: newer(self.incarnation, self.motions),
            map: draft.map,
            frame: "map".to_owned(),
            based_on,
            valid_for,
            waypoints: draft.waypoints,
            trajectory: draft.trajectory,
            splice: draft.splice,
            statistics: draft.statistics,
        };
        self.previous = self
            .current
            .take()
            .filter(|current| current.status == PlanStatus::Taken);
        self.current = Some(ActivePlan::sent(plan.clone(), pace, now));
        self.changed = true;
        self.was_begun_for_leg = true;
        plan
    }

    /// Renews the validity of the same trajectory, under the present epoch. `None` without a renewable plan.
    pub(crate) fn renew(&mut self, epoch: u64, based_on: BasedOn, valid_for: f64, now: Stamp) -> Option<Plan> {
        self.publish(epoch, based_on, valid_for, now, false)
    }

    /// Shortens the validity of the same trajectory. `None` if it is already held, or no plan is in force.
    pub(crate) fn hold(&mut self, epoch: u64, based_on: BasedOn, valid_for: f64, now: Stamp) -> Option<Plan> {
        if self.is_held() {
            None
        } else {
            self.publish(epoch, based_on, valid_for, now, true)
        }
    }

    fn publish(&mut self, epoch: u64, based_on: BasedOn, valid_for: f64, now: Stamp, held: bool) -> Option<Plan> {
        let revision = self.next_revision();
        let current = self
            .current
            .as_mut()
            .filter(|current| matches!(current.status, PlanStatus::Sent | PlanStatus::Taken))?;
        current.plan = Plan {
            epoch,
            revision,
            based_on,
            valid_for,
            ..current.plan.clone()
        };
        current.published = now;
        current.held = held;
        Some(current.plan.clone())
    }

    /// Handles a refusal: the previous plan, or the same trajectory if the robot already drove it, is in force again. Returns whether there
    /// is one.
    pub(crate) fn revert(&mut self) -> bool {
        if let Some(current) = self.current.as_mut().filter(|current| current.was_taken) {
            current.status = PlanStatus::Taken;
            return true;
        }
        let previous = self.previous.take();
        self.changed |= previous.is_some();
        let reverts = previous.is_some();
        self.current = previous.or(self.current.take());
        reverts
    }

    /// Takes the plan out of force.
    pub fn clear(&mut self) {
        self.previous = None;
        self.changed |= self.current.take().is_some();
    }

    fn next_revision(&mut self) -> Revision {
        self.revisions += 1;
        Revision {
            incarnation: self.incarnation,
            counter: self.revisions,
        }
    }

    /// Observes the robot's reports.
    pub(crate) fn observe(&mut self, now: Stamp, state: Option<&EdgeState>, events: &[Event]) {
        let Some(current) = &mut self.current else { return };
        for event in events {
            current.take(now, event);
        }
        let Some(state) = state else { return };
        if state.boot_id != current.plan.based_on.boot_id {
            current.status = PlanStatus::Void("the robot has started anew".to_owned());
            return;
        }
        match &state.plan {
            Some(progress) if progress.trajectory_id == current.plan.trajectory_id => {
                current.confirmed = now;
                current.pace.observe(state.stamp, progress.time);
                if matches!(current.status, PlanStatus::Sent | PlanStatus::Taken) {
                    current.was_taken = true;
                    // Based on the state alone: an event may be from anybody, and names no revision.
                    let is_ours = (progress.epoch, progress.revision) <= (current.plan.epoch, current.plan.revision);
                    current.status = if progress.finished && is_ours && is_rest(state.velocity) {
                        PlanStatus::Finished
                    } else {
                        PlanStatus::Taken
                    };
                }
            }
            _ if current.status == PlanStatus::Taken && now.secs_since(current.confirmed) > DROPPED => {
                current.status = PlanStatus::Void("the robot has dropped the plan".to_owned());
            }
            _ => {}
        }
    }

    /// Plan time that the robot reaches in `ahead` s if it continues at its pace, given a state that is `age` s old, s; `None` unless it
    /// drives this trajectory.
    #[must_use]
    pub fn time(&self, state: &EdgeState, age: f64, ahead: f64) -> Option<f64> {
        let current = self.current.as_ref()?;
        let progress = state
            .plan
            .as_ref()
            .filter(|progress| progress.trajectory_id == current.plan.trajectory_id)?;
        let moving = state.mode == Mode::Follow && !progress.finished && progress.valid_for > 0.0;
        let since = if moving { age.clamp(0.0, 0.5) } else { 0.0 };
        Some(progress.time + current.pace.within(since + ahead))
    }
}

impl ActivePlan {
    /// A plan that is published now.
    fn sent(plan: Plan, pace: Pace, now: Stamp) -> Self {
        Self {
            here: plan.trajectory.clone(),
            plan,
            status: PlanStatus::Sent,
            published: now,
            confirmed: now,
            held: false,
            was_taken: false,
            refused: None,
            pace,
        }
    }

    fn take(&mut self, now: Stamp, event: &Event) {
        if event.boot_id != self.plan.based_on.boot_id {
            return;
        }
        let ours = self.plan.trajectory_id;
        match &event.kind {
            EventKind::PlanAccepted { trajectory_id, .. } if *trajectory_id == ours => {
                (self.confirmed, self.was_taken) = (now, true);
                if self.status == PlanStatus::Sent {
                    self.status = PlanStatus::Taken;
                }
            }
            EventKind::PlanRejected {
                trajectory_id,
                revision,
                reason,
                ..
            } if *trajectory_id == ours && self.refused < Some(*revision) && self.status != PlanStatus::Finished => {
                self.refused = Some(self.plan.revision);
                self.status = PlanStatus::Refused(reason.clone());
            }
            // Before the plan was accepted, this refers to the previous one.
            EventKind::PlanDiscarded { goal_id, reason }
                if *goal_id == self.plan.goal_id && self.status == PlanStatus::Taken =>
            {
                self.status = PlanStatus::Void(reason.clone());
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_protocol::geometry::Twist2;
    use zenav_protocol::messages::{Link, PlanProgress};

    #[test]
    fn who_is_held_back_is_expected_where_its_pace_leads() {
        let mut keeper = MotionKeeper::new(1);
        let based_on = BasedOn {
            stamp: Stamp(1),
            boot_id: "b".into(),
        };
        let plan = keeper.begin(PlanDraft::default(), "g", 7, based_on, 5.0, Stamp(1));
        let mut expected = Vec::new();
        for (secs, time) in [(1.0, 2.0), (1.1, 2.1), (1.4, 2.4), (1.8, 2.48)] {
            let progress = PlanProgress {
                epoch: 7,
                revision: plan.revision,
                trajectory_id: plan.trajectory_id,
                time,
                valid_for: 1.0,
                ..PlanProgress::default()
            };
            let state = EdgeState {
                stamp: Stamp::from_secs(secs),
                ..state(0.1, progress)
            };
            keeper.observe(Stamp(2), Some(&state), &[]);
            expected.push(keeper.time(&state, 0.1, 0.4).unwrap() - time);
        }
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(near(expected[0], 0.5) && near(expected[2], 0.5), "{expected:?}");
        assert!(near(expected[3], 0.2 * 0.5), "{expected:?}");
    }

    fn state(velocity: f64, progress: PlanProgress) -> EdgeState {
        EdgeState {
            stamp: Stamp(1),
            boot_id: "b".into(),
            mode: Mode::Follow,
            link: Link::Connected,
            plan: Some(progress),
            velocity: Twist2::new(velocity, 0.0),
            battery: 1.0,
            uplink: 1.0,
            ..EdgeState::default()
        }
    }

    #[test]
    fn a_plan_is_finished_by_the_robot_s_own_state_at_rest_and_not_by_an_event() {
        let mut keeper = MotionKeeper::new(1);
        let based_on = BasedOn {
            stamp: Stamp(1),
            boot_id: "b".into(),
        };
        let plan = keeper.begin(PlanDraft::default(), "g", 7, based_on, 5.0, Stamp(1));
        let forged = Event {
            stamp: Stamp(2),
            boot_id: "b".into(),
            sequence: 9,
            kind: EventKind::PlanFinished {
                goal_id: "g".into(),
                trajectory_id: plan.trajectory_id,
            },
        };
        keeper.observe(Stamp(2), None, &[forged]);
        assert_eq!(keeper.status(), Some(&PlanStatus::Sent));
        let end = PlanProgress {
            epoch: 7,
            revision: plan.revision,
            trajectory_id: plan.trajectory_id,
            finished: true,
            ..PlanProgress::default()
        };
        let later = Revision {
            counter: u64::MAX,
            ..plan.revision
        };
        let strangers = [
            state(0.4, end.clone()),
            state(
                0.0,
                PlanProgress {
                    epoch: 8,
                    ..end.clone()
                },
            ),
            state(
                0.0,
                PlanProgress {
                    revision: later,
                    ..end.clone()
                },
            ),
            state(
                0.0,
                PlanProgress {
                    trajectory_id: 0,
                    ..end.clone()
                },
            ),
        ];
        for stranger in strangers {
            keeper.observe(Stamp(3), Some(&stranger), &[]);
            assert_ne!(keeper.status(), Some(&PlanStatus::Finished), "{stranger:?}");
        }
        keeper.observe(Stamp(4), Some(&state(0.0, end)), &[]);
        assert_eq!(keeper.status(), Some(&PlanStatus::Finished));
    }
}
