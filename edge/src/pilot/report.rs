//! Reporting. What does the robot publish at the end of a tick? Events at once, markers, the intent and the state when they are due.

use zenav_protocol::messages::{EdgeState, LostPolicy, Mode};
use zenav_protocol::time::Stamp;

use super::Pilot;
use crate::control_io::Publication;

impl Pilot {
    /// Events, markers and state.
    pub(super) fn report(&mut self, now: Stamp, out: &mut Vec<Publication>) {
        let events = self.events.take();
        out.extend(events.into_iter().map(Publication::Event));
        if self.telemetry.marker_due(now) {
            let markers = match self.mode {
                Mode::Follow => self
                    .active_plan
                    .as_ref()
                    .and_then(|active| active.marker(now))
                    .into_iter()
                    .collect(),
                Mode::WallFollow => {
                    let (map_from_odom, odom_from_base) =
                        (self.estimator.map_from_odom(), self.estimator.odom_from_base());
                    self.wall_follower.markers(now, map_from_odom, odom_from_base)
                }
                _ => Vec::new(),
            };
            out.extend(markers.into_iter().map(Publication::Marker));
        }
        self.tell_intent(now, out);
        self.tell_yield(now, out);
        if self.telemetry.state_due(now) {
            out.push(Publication::State(Box::new(self.state(now))));
        }
    }

    /// The present state of the robot.
    pub(super) fn state(&self, now: Stamp) -> EdgeState {
        let pose = self.estimator.map_from_base();
        EdgeState {
            stamp: now,
            boot_id: self.events.boot_id().to_owned(),
            mode: self.mode,
            link: self.authority.link(),
            lease: self.authority.lease_state(now),
            round_trip_secs: self.authority.round_trip_secs(),
            plan: self.active_plan.as_ref().map(|active| active.progress(now, &pose)),
            velocity: self.estimator.velocity(),
            guard: self.collision_monitor.zone(),
            battery: self.charge,
            behaviour: self.maneuvers.last().cloned(),
            wall_follower: (self.authority.policy() == LostPolicy::WallFollow).then(|| self.wall_follower.state()),
            missed_ticks: self.missed_ticks,
            uplink: self.telemetry.share(),
            stops: self.authority.stops(),
            makes_way: self.avoidance.is_for_robot() || self.waits_for_robot(now),
            frame: self.frame.number(),
            faults: self.faults.clone(),
        }
    }
}
