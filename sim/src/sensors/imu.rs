//! Inertial unit with compass. The reported yaw rate and heading.

use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::readings::Readings;
use zenav_protocol::sensors::{Imu, ImuModel};
use zenav_protocol::time::Stamp;

use super::random::gauss;
use super::timing::{Delay, Schedule, is_lost};
use super::{Moment, Sensor, stepped};
use crate::chassis::Moved;
use crate::faults::Fault;

/// Gyro and compass. The gyro integrates: it reports the mean yaw rate since its last reading.
#[derive(Clone, Debug)]
pub struct InertialUnit {
    model: ImuModel,
    rng: Pcg64Mcg,
    schedule: Schedule,
    turned: f64,
    last: Stamp,
    delay: Delay<Imu>,
}

impl InertialUnit {
    /// At rest.
    #[must_use]
    pub fn new(model: ImuModel, rng: Pcg64Mcg) -> Self {
        Self {
            rng,
            schedule: Schedule::new(model.rate_hz),
            turned: 0.0,
            last: Stamp::ZERO,
            delay: Delay::new(model.latency),
            model,
        }
    }

    /// Adds a true turn of the base, rad.
    pub fn turn(&mut self, angle: f64) {
        self.turned += angle;
    }

    /// A reading, if one arrives.
    pub fn read(&mut self, now: Stamp, truth: Pose2, fault: &Fault) -> Option<Imu> {
        let measured = self.measure(now, truth, fault);
        self.delay.pass(now, measured, fault.late)
    }

    fn measure(&mut self, now: Stamp, truth: Pose2, fault: &Fault) -> Option<Imu> {
        if fault.is_dead {
            // Rotation during the failure is not measured.
            (self.turned, self.last) = (0.0, now);
        }
        if !self.schedule.due(now) || is_lost(&mut self.rng, self.model.dropout, fault) {
            return None;
        }
        let secs = now.secs_since(self.last);
        let rate = if secs > 0.0 { self.turned / secs } else { 0.0 };
        self.turned = 0.0;
        self.last = now;
        let yaw_rate = rate + self.model.gyro_bias + gauss(&mut self.rng, fault.noise(self.model.gyro_noise));
        let yaw_rate = stepped(yaw_rate, self.model.resolution);
        let yaw = self
            .model
            .compass_noise
            .map(|noise| wrap_angle(truth.yaw + self.model.compass_bias + gauss(&mut self.rng, noise)));
        Some(Imu {
            stamp: now,
            yaw_rate,
            yaw,
        })
    }
}

impl Sensor for InertialUnit {
    fn moved(&mut self, moved: &Moved, _fault: &Fault) {
        self.turn(moved.turn);
    }

    fn sense(&mut self, moment: &Moment<'_>, readings: &mut Readings) {
        readings.imu = self.read(moment.now, moment.map_from_base(), &moment.fault);
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
    fn the_gyro_tells_the_mean_rate_with_bias_and_noise() {
        let mut imu = InertialUnit::new(
            ImuModel {
                rate_hz: 10.0,
                gyro_noise: 0.01,
                gyro_bias: 0.1,
                ..ImuModel::default()
            },
            rng(),
        );
        let mut readings = Vec::new();
        for tick in 0..10_000 {
            readings.extend(imu.read(Stamp(tick * 20_000_000), Pose2::IDENTITY, &Fault::default()));
            imu.turn(0.02 * 0.5);
        }
        assert!(readings.iter().all(|imu| imu.yaw.is_none()));
        let rates: Vec<f64> = readings.iter().skip(1).map(|imu| imu.yaw_rate).collect();
        let mean = rates.iter().sum::<f64>() / rates.len() as f64;
        let spread = (rates.iter().map(|rate| (rate - mean).powi(2)).sum::<f64>() / rates.len() as f64).sqrt();
        assert!(
            (mean - 0.6).abs() < 1e-3 && (spread - 0.01).abs() < 1e-3,
            "{mean} {spread}"
        );
    }
}
