//! Faults. Which faults does the robot itself have, and how does it continue? Missing readings, a disk that stores nothing, and a lidar that
//! is mounted crooked.
//!
//! The state names each fault while it lasts; an event marks its beginning and its end. Without readings the robot's clock stands still: it
//! brakes, accepts no plan, and still answers requests, above all a stop.

use zenav_protocol::messages::{EventKind, Faults, Mode};
use zenav_protocol::time::Stamp;

use super::Pilot;
use crate::control_io::{Inbox, Outbox, Publication};

impl Pilot {
    /// Records the present faults; a change is an event.
    pub(super) fn note_faults(&mut self, now: Stamp, faults: Faults) {
        if faults == self.faults {
            return;
        }
        let before = std::mem::replace(&mut self.faults, faults);
        let parts = [
            ("body", "heard", "silent", before.body, self.faults.body.clone()),
            (
                "storage",
                "stored",
                "not_stored",
                before.storage,
                self.faults.storage.clone(),
            ),
            ("lidar", "straight", "crooked", before.lidar, self.faults.lidar.clone()),
        ];
        for (behaviour, well, ill, before, after) in parts {
            if before.is_some() == after.is_some() {
                continue;
            }
            let (from, to) = if after.is_some() { (well, ill) } else { (ill, well) };
            self.events.record(
                now,
                EventKind::Transition {
                    behaviour: behaviour.to_owned(),
                    from: from.to_owned(),
                    to: to.to_owned(),
                    reason: after.unwrap_or_default(),
                },
            );
        }
    }

    /// A lidar that looks elsewhere than its file says, in words; to whole degrees, so that they seldom change.
    pub(super) fn crooked_lidar(&self) -> Option<String> {
        let (name, angle) = self.mount_watch.off()?;
        let side = if angle > 0.0 { "left" } else { "right" };
        let degrees = angle.abs().to_degrees();
        Some(format!(
            "`{name}` looks {degrees:.0}° farther to the {side} than its file says"
        ))
    }

    /// A tick without readings, for the reason `why`: the robot brakes and answers. Plans, corrections and teleop that arrived meanwhile
    /// are dropped: they would be stale by the time it may move.
    pub fn step_blind(&mut self, inbox: Inbox, why: &str) -> Outbox {
        let now = self.now();
        let mut out = Outbox::default();
        self.note_faults(
            now,
            Faults {
                body: Some(why.to_owned()),
                storage: inbox.not_stored,
                lidar: self.crooked_lidar(),
            },
        );
        for (ticket, request) in inbox.requests {
            let reply = self.answer(now, request);
            out.replies.push((ticket, reply));
        }
        for heartbeat in &inbox.heartbeats {
            self.authority.heartbeat(now, heartbeat, &mut self.events);
        }
        self.authority.update_link(now, &mut self.events);
        self.mode = if self.authority.is_stopped() {
            Mode::Stopped
        } else {
            Mode::Idle
        };
        self.dead_man.release();
        out.publications
            .extend(self.events.take().into_iter().map(Publication::Event));
        out.publications.push(Publication::State(Box::new(self.state(now))));
        out.persist = self.authority.unpersisted();
        out
    }
}
