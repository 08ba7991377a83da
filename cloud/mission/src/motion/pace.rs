//! Pace. Where will the robot be on its plan when the next plan reaches it?

use zenav_protocol::time::Stamp;

/// Time over which the rate of plan time is measured, s.
const PACE: f64 = 0.3;
/// Greatest age of a plan's start that a robot accepts, s.
const LATE: f64 = 1.0;

/// Rate of plan time: lower where the robot is held up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace {
    /// The robot's time and plan time at the last measurement.
    taken: Option<(Stamp, f64)>,
    /// Seconds of plan time per second, 0 to 1.
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

    /// The pace on a plan spliced to this one: the robot is held up there in the same way.
    pub(super) fn carried_over(self) -> Self {
        Self { taken: None, ..self }
    }

    /// Plan time that passes in this many seconds, s; the same number before the rate is known. A robot may resume full pace at any time:
    /// then it is at most [`LATE`] farther.
    pub(super) fn within(&self, secs: f64) -> f64 {
        (secs * self.rate.unwrap_or(1.0)).max(secs - LATE)
    }
}
