//! Edge metrics. What is counted and measured on a robot? The control thread updates atomic numbers that were looked up before it began;
//! the rest is derived from the states and events that the robot publishes.

use std::collections::BTreeMap;
use std::time::Duration;

use zenav_observability::metrics::{
    BATTERY, COLLISION_MONITOR, CONTROL_LATENESS, CONTROL_MISSED, CONTROL_TICK, GUARD_ZONE, LEASE_CHANGES, LEASE_HELD,
    LINK_LOST, LINK_STATE, PLANS, ROUND_TRIP, STATE_UNSAVED,
};
use zenav_observability::{Gauge, Histogram, IntCounter};
use zenav_protocol::messages::{EdgeState, EventKind, GuardZone, LeaseRole, Link};

use crate::acceptance::Rejection;
use crate::pilot::{ACCEPTED, RENEWED};

/// Durations and counts of the control loop.
#[derive(Clone, Debug)]
pub(crate) struct ControlMetrics {
    late: Histogram,
    tick: Histogram,
    monitor: Histogram,
    missed: IntCounter,
    plans: BTreeMap<&'static str, IntCounter>,
}

impl ControlMetrics {
    pub(crate) fn new(robot: &str) -> Self {
        let verdicts = [ACCEPTED, RENEWED].iter().chain(Rejection::KINDS);
        Self {
            late: CONTROL_LATENESS.with_label_values(&[robot]),
            tick: CONTROL_TICK.with_label_values(&[robot]),
            monitor: COLLISION_MONITOR.with_label_values(&[robot]),
            missed: CONTROL_MISSED.with_label_values(&[robot]),
            plans: verdicts
                .map(|verdict| (*verdict, PLANS.with_label_values(&[robot, verdict])))
                .collect(),
        }
    }

    /// Records how late a tick began, and how many before it were skipped.
    pub(crate) fn began(&self, late: Option<Duration>, missed: u64) {
        if let Some(late) = late {
            self.late.observe(late.as_secs_f64());
        }
        self.missed.inc_by(missed);
    }

    /// Records how long a tick took, how long the collision monitor took of that, and the verdict on a plan.
    pub(crate) fn ended(&self, took: Duration, monitor: Duration, verdict: Option<&'static str>) {
        self.tick.observe(took.as_secs_f64());
        self.monitor.observe(monitor.as_secs_f64());
        if let Some(count) = verdict.and_then(|verdict| self.plans.get(verdict)) {
            count.inc();
        }
    }
}

/// A state as one gauge for each of its possible values.
#[derive(Debug)]
struct States<T>(Vec<(T, Gauge)>);

impl<T: PartialEq> States<T> {
    fn show(&self, now: &T) {
        for (value, gauge) in &self.0 {
            gauge.set(f64::from(u8::from(value == now)));
        }
    }
}

/// Metrics derived from the robot's published states and events.
#[derive(Debug)]
pub(crate) struct RobotMetrics {
    robot: String,
    link: States<Link>,
    lease: States<Option<LeaseRole>>,
    zone: States<GuardZone>,
    battery: Gauge,
    lease_changes: IntCounter,
    link_lost: IntCounter,
    pub(crate) unsaved: IntCounter,
}

impl RobotMetrics {
    pub(crate) fn new(robot: &str) -> Self {
        let link = |state| LINK_STATE.with_label_values(&[robot, state]);
        let lease = |role| LEASE_HELD.with_label_values(&[robot, role]);
        let zone = |zone| GUARD_ZONE.with_label_values(&[robot, zone]);
        Self {
            link: States(vec![
                (Link::Connected, link("connected")),
                (Link::Stale, link("stale")),
                (Link::Lost, link("lost")),
            ]),
            lease: States(vec![
                (Some(LeaseRole::Mission), lease("mission")),
                (Some(LeaseRole::Operator), lease("operator")),
                (None, lease("none")),
            ]),
            zone: States(vec![
                (GuardZone::Clear, zone("clear")),
                (GuardZone::Slow, zone("slow")),
                (GuardZone::Stop, zone("stop")),
            ]),
            battery: BATTERY.with_label_values(&[robot]),
            lease_changes: LEASE_CHANGES.with_label_values(&[robot]),
            link_lost: LINK_LOST.with_label_values(&[robot]),
            unsaved: STATE_UNSAVED.with_label_values(&[robot]),
            robot: robot.to_owned(),
        }
    }

    pub(crate) fn state(&self, state: &EdgeState) {
        self.link.show(&state.link);
        self.lease.show(&state.lease.role.filter(|_| state.lease.live));
        self.zone.show(&state.guard);
        self.battery.set(state.battery);
        if let Some(round_trip) = state.round_trip_secs {
            ROUND_TRIP.with_label_values(&[&self.robot]).set(round_trip);
        }
    }

    /// Counts an event, and logs it if an operator would want to know.
    pub(crate) fn event(&self, event: &EventKind) {
        let robot = self.robot.as_str();
        match event {
            EventKind::Lease { holder, epoch, reason } => {
                self.lease_changes.inc();
                tracing::info!(robot, holder, epoch, reason, "lease");
            }
            EventKind::LinkChanged { link } => {
                if *link == Link::Lost {
                    self.link_lost.inc();
                }
                tracing::debug!(robot, ?link, "link to the holder of the lease");
            }
            EventKind::PlanAccepted {
                goal_id, trajectory_id, ..
            } => tracing::debug!(robot, goal = goal_id, plan = trajectory_id, "plan accepted"),
            EventKind::PlanRejected {
                goal_id,
                trajectory_id,
                reason,
                ..
            } => tracing::info!(robot, goal = goal_id, plan = trajectory_id, reason, "plan rejected"),
            EventKind::PlanExpired { goal_id } => tracing::warn!(robot, goal = goal_id, "plan expired"),
            EventKind::PlanDiscarded { goal_id, reason } => {
                tracing::debug!(robot, goal = goal_id, reason, "plan discarded");
            }
            EventKind::PlanFinished { goal_id, trajectory_id } => {
                tracing::debug!(robot, goal = goal_id, plan = trajectory_id, "plan finished");
            }
            EventKind::Bumped => tracing::warn!(robot, "contact"),
            EventKind::BatteryLow { charge } => tracing::warn!(robot, charge, "battery low"),
            EventKind::Stopped { by } => tracing::warn!(robot, by, "stopped"),
            EventKind::Resumed { by } => tracing::info!(robot, by, "resumed"),
            EventKind::Localisation { health } => tracing::info!(robot, ?health, "localisation"),
            _ => {}
        }
    }
}
