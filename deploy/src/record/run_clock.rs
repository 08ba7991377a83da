//! Run clock. Time within a run: the robot's own time from its first pose on, continued if the robot's clock restarts.

use zenav_protocol::time::Stamp;

/// A clock that goes back by more than this has restarted, s: the simulation was started again.
const NEW_BEGINNING: f64 = 5.0;

/// Time since the first pose of a robot, s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RunClock {
    /// Stamp of the first pose since the robot's clock last restarted, and its time within the run.
    began: Option<(Stamp, f64)>,
    /// The time of the newest pose.
    pub(super) now: f64,
}

impl RunClock {
    /// Time within the run; `None` before the first pose.
    pub(super) fn at(&self, stamp: Stamp) -> Option<f64> {
        self.began.map(|(first, then)| then + stamp.secs_since(first))
    }

    /// Takes in a pose; returns its time, which never goes back.
    pub(super) fn advance(&mut self, stamp: Stamp) -> f64 {
        match self.at(stamp) {
            Some(time) if time > self.now - NEW_BEGINNING => self.now = self.now.max(time),
            _ => self.began = Some((stamp, self.now)),
        }
        self.now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_goes_on_where_the_clock_begins_anew() {
        let mut clock = RunClock::default();
        assert_eq!(clock.at(Stamp::from_secs(1.0)), None);
        let times = [100.0, 101.0, 100.9, 130.0, 0.5, 2.5].map(|secs| clock.advance(Stamp::from_secs(secs)));
        let expected = [0.0, 1.0, 1.0, 30.0, 30.0, 32.0];
        assert!(
            times
                .iter()
                .zip(expected)
                .all(|(time, expected)| (time - expected).abs() < 1e-9),
            "{times:?}"
        );
        assert!(
            clock
                .at(Stamp::from_secs(1.5))
                .is_some_and(|time| (time - 31.0).abs() < 1e-9)
        );
    }
}
