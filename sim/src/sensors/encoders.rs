//! Wheel encoders. The reported wheel angles.

use rand_pcg::Pcg64Mcg;
use zenav_protocol::readings::Readings;
use zenav_protocol::sensors::EncoderModel;
use zenav_protocol::time::Stamp;

use super::random::gauss;
use super::timing::{Delay, Schedule, is_lost};
use super::{Moment, Sensor, stepped};
use crate::chassis::Moved;
use crate::faults::Fault;

/// Wheel encoders: each turn is measured with a relative error, and the sum is rounded to the resolution.
#[derive(Clone, Debug)]
pub struct Encoders {
    model: EncoderModel,
    rng: Pcg64Mcg,
    measured: [f64; 2],
    schedule: Option<Schedule>,
    delay: Delay<[f64; 2]>,
    told: [f64; 2],
}

impl Encoders {
    /// At zero.
    #[must_use]
    pub fn new(model: EncoderModel, rng: Pcg64Mcg) -> Self {
        Self {
            rng,
            measured: [0.0; 2],
            schedule: model.rate_hz.map(Schedule::new),
            delay: Delay::new(model.latency),
            told: [0.0; 2],
            model,
        }
    }

    /// Adds a true rotation of both wheels, rad.
    pub fn turn(&mut self, wheels: [f64; 2], fault: &Fault) {
        let noise = fault.noise(self.model.noise);
        for (measured, turn) in self.measured.iter_mut().zip(wheels) {
            *measured += turn * (1.0 + gauss(&mut self.rng, noise));
        }
    }

    /// Measured angles since start (left, right; rad), as far as they have arrived.
    pub fn read(&mut self, now: Stamp, fault: &Fault) -> [f64; 2] {
        let due = self.schedule.as_mut().is_none_or(|schedule| schedule.due(now));
        let read = (due && !is_lost(&mut self.rng, self.model.dropout, fault))
            .then(|| self.measured.map(|angle| stepped(angle, self.model.resolution)));
        if let Some(angles) = self.delay.pass(now, read, fault.late) {
            self.told = angles;
        }
        self.told
    }
}

impl Sensor for Encoders {
    fn moved(&mut self, moved: &Moved, fault: &Fault) {
        self.turn(moved.wheels, fault);
    }

    fn sense(&mut self, moment: &Moment<'_>, readings: &mut Readings) {
        readings.wheels = self.read(moment.now, &moment.fault);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::super::random::{Stream, stream};
    use super::*;
    use zenav_protocol::id::Id;

    fn rng() -> Pcg64Mcg {
        stream(1, &Id::new("tiago").unwrap(), Stream::Imu)
    }

    #[test]
    fn encoders_keep_the_sum_within_their_noise_and_on_their_steps() {
        let mut encoders = Encoders::new(
            EncoderModel {
                noise: 0.005,
                resolution: 0.001,
                ..EncoderModel::default()
            },
            rng(),
        );
        for _ in 0..10_000 {
            encoders.turn([0.01, -0.02], &Fault::default());
        }
        let [left, right] = encoders.read(Stamp::ZERO, &Fault::default());
        assert!(
            (left - 100.0).abs() < 0.02 && (right + 200.0).abs() < 0.04,
            "{left} {right}"
        );
        assert!((left / 0.001 - (left / 0.001).round()).abs() < 1e-6);
    }

    #[test]
    fn encoders_with_a_rate_hold_their_angles_in_between() {
        let mut encoders = Encoders::new(
            EncoderModel {
                noise: 0.0,
                resolution: 0.0,
                rate_hz: Some(10.0),
                dropout: 0.0,
                latency: 0.04,
            },
            rng(),
        );
        let told: Vec<f64> = (0..13)
            .map(|tick| {
                let angles = encoders.read(Stamp(tick * 20_000_000), &Fault::default());
                encoders.turn([0.1, 0.1], &Fault::default());
                angles[0]
            })
            .collect();
        // Read at 0, 0.1, 0.2 s, reported 0.04 s later.
        assert!(told[..7].iter().all(|angle| *angle == 0.0), "{told:?}");
        assert!(told[7..12].iter().all(|angle| (angle - 0.5).abs() < 1e-12), "{told:?}");
        assert!((told[12] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn encoders_that_lose_a_reading_tell_the_one_before_and_miss_no_turn() {
        let model = EncoderModel {
            noise: 0.0,
            resolution: 0.0,
            rate_hz: None,
            dropout: 0.4,
            latency: 0.0,
        };
        let mut encoders = Encoders::new(model, rng());
        let (mut lost, mut last) = (0, 0.0);
        for tick in 1..=1000 {
            encoders.turn([0.1, 0.1], &Fault::default());
            let [told, _] = encoders.read(Stamp(tick * 20_000_000), &Fault::default());
            if told == last {
                lost += 1;
            } else {
                assert!((told - 0.1 * tick as f64).abs() < 1e-9, "{told} at tick {tick}");
            }
            last = told;
        }
        assert!((350..450).contains(&lost), "{lost}");
    }
}
