//! Watch. The robot's states and events, checked as they arrive.

use std::time::Duration;

use tokio::time::Instant;
use zenav_protocol::bus::{Bus, BusError, Subscription};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{EdgeState, Event, EventKind, LostPolicy, Mode};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use crate::observer::is_rest;

/// Time for a robot to brake after its plan was withdrawn, s of its clock.
const BRAKES: f64 = 1.5;
/// A robot faster than this drives, m/s, or turns, rad/s: a plan may begin with a turn on the spot.
const DRIVES: f64 = 0.05;
const TURNS: f64 = 0.1;

/// Observes the robot.
pub struct Watch {
    states: Subscription<EdgeState>,
    events: Subscription<Event>,
    policy: LostPolicy,
    last: Option<EdgeState>,
    /// Last time with a plan in force, and last time with a live lease, on the robot's clock.
    planned: Stamp,
    leased: Stamp,
    /// When it began to be watched, or was heard again, on its clock: one that was frozen brakes then.
    begun: Stamp,
    boot: String,
    /// Wall time of the last state.
    pub heard: Instant,
    /// Contacts.
    pub collisions: usize,
    /// Motion that must not happen: without a valid plan, or without a lease under the policy `stop`.
    pub invalid: Vec<String>,
}

impl Watch {
    /// Watches from now on.
    ///
    /// # Errors
    /// When the bus is closed.
    pub fn new(bus: &Bus, robot: &str, policy: LostPolicy) -> Result<Self, BusError> {
        Ok(Self {
            states: bus.subscribe(&topics::STATE, &[robot], 4096)?,
            events: bus.subscribe(&topics::EVENT, &[robot], 4096)?,
            policy,
            last: None,
            planned: Stamp::ZERO,
            leased: Stamp::ZERO,
            begun: Stamp::ZERO,
            boot: String::new(),
            heard: Instant::now(),
            collisions: 0,
            invalid: Vec::new(),
        })
    }

    /// Processes the messages that have arrived.
    pub fn listen(&mut self) {
        while let Some(event) = self.events.try_next() {
            self.collisions += usize::from(event.message.kind == EventKind::Bumped);
        }
        while let Some(state) = self.states.try_next() {
            self.heard = Instant::now();
            self.check(state.message);
        }
    }

    /// Begins anew, because states were lost: what was in force meanwhile is not known.
    pub fn forget(&mut self) {
        self.boot.clear();
    }

    fn check(&mut self, state: EdgeState) {
        if state.boot_id != self.boot {
            // A new boot has a new clock.
            (self.planned, self.leased, self.begun) = (state.stamp, state.stamp, state.stamp);
            self.boot.clone_from(&state.boot_id);
        }
        // A maneuver, such as a tree's recovery, needs no plan but the lease.
        let has_maneuver = state.mode == Mode::Behaviour && state.lease.live;
        if state.plan.is_some() || has_maneuver {
            self.planned = state.stamp;
        }
        if state.lease.live {
            self.leased = state.stamp;
        }
        if !is_rest(state.velocity) {
            let expired = state
                .plan
                .as_ref()
                .is_some_and(|plan| plan.valid_for <= 0.0 && !plan.finished)
                && state.stamp.secs_since(self.begun) > BRAKES;
            let without = state.stamp.secs_since(self.planned) > BRAKES;
            let alone = self.policy == LostPolicy::Stop && state.stamp.secs_since(self.leased) > BRAKES;
            let what = match (expired, without, alone) {
                (true, ..) => Some("its plan has expired"),
                (_, true, _) => Some("it has no plan"),
                (.., true) => Some("its lease has lapsed, by the policy `stop`"),
                _ => None,
            };
            if let Some(what) = what {
                let (secs, Twist2 { v, w }) = (state.stamp.as_secs(), state.velocity);
                self.invalid.push(format!(
                    "at {secs:.2} s it moves at {v:.2} m/s, {w:.2} rad/s, and {what}"
                ));
            }
        }
        self.last = Some(state);
    }

    /// Whether the robot drives or turns.
    #[must_use]
    pub fn drives(&self) -> bool {
        let moves = |velocity: Twist2| velocity.v.abs() > DRIVES || velocity.w.abs() > TURNS;
        self.last.as_ref().is_some_and(|state| moves(state.velocity))
            && self.heard.elapsed() < Duration::from_millis(500)
    }

    /// Whether the robot drives with more than `left` of its plan to go, s.
    #[must_use]
    pub fn is_under_way(&self, left: f64) -> bool {
        let plan = self.last.as_ref().and_then(|state| state.plan.as_ref());
        self.drives() && plan.is_some_and(|plan| plan.time_left > left)
    }
}
