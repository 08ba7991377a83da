//! Pace. Where will the robot be on its plan when the next one reaches it?

use zenav_protocol::time::Stamp;

/// The rate of plan time is taken over this time, s.
const PACE: f64 = 0.3;
/// A robot takes a plan whose begin is this long ago, s.
const LATE: f64 = 1.0;

/// How fast plan time runs: more slowly where something holds the robot back.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace {
    /// The robot's time and its plan time, when the rate was taken last.
    taken: Option<(Stamp, f64)>,
    /// Seconds of plan time a second, 0 to 1.
    rate: Option<f64>,
}

impl Pace {
    pub(super) fn observe(&mut self, stamp: Stamp, time: f64) {
        let Some((taken, before)) = self.taken else {
            self.taken = Some((stamp, time));
            return;
        };
        let secs = stamp.secs_since(taken);
        if secs >= PACE {
            *self = Self {
                taken: Some((stamp, time)),
                rate: Some(((time - before) / secs).clamp(0.0, 1.0)),
            };
        }
    }

    /// The pace on the plan that is spliced to this one: what holds the robot back holds it there too.
    pub(super) fn carried_over(self) -> Self {
        Self { taken: None, ..self }
    }

    /// Plan time that goes by in so many seconds, s; as many before the rate is known. A robot may go on at full pace at once: then it is
    /// [`LATE`] farther at most.
    pub(super) fn within(&self, secs: f64) -> f64 {
        (secs * self.rate.unwrap_or(1.0)).max(secs - LATE)
    }
}
