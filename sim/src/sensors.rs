//! What do encoders, gyro, compass and GPS measure, and when? Truth with noise, each from its own random stream.
//!
//! A stream belongs to a robot's name and a sensor: another robot in the world changes nobody's noise.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{Gps, Imu};
use zenav_protocol::robot::{EncoderModel, GpsModel, ImuModel};
use zenav_protocol::time::Stamp;

/// A sensor with a random stream of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// Ranges.
    Lidar,
    /// Wheel angles.
    Encoders,
    /// Yaw rate and heading.
    Imu,
    /// Position.
    Gps,
}

/// The random stream of a robot's sensor.
#[must_use]
pub fn stream(seed: u64, robot: &Id, sensor: Sensor) -> Pcg64Mcg {
    // FNV-1a over the name, then the finaliser of SplitMix64 (Steele et al. 2014) to spread every bit.
    let name = robot.as_str().bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    let mix = |value: u64| {
        let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        value ^ (value >> 31)
    };
    let low = mix(mix(seed).wrapping_add(name).wrapping_add(sensor as u64));
    Pcg64Mcg::new((u128::from(mix(low.wrapping_add(0x9e37_79b9_7f4a_7c15))) << 64) | u128::from(low))
}

fn gauss(rng: &mut Pcg64Mcg, std_dev: f64) -> f64 {
    let unit: f64 = StandardNormal.sample(rng);
    unit * std_dev
}

/// When a sensor measures: at multiples of its period, at the first step at or after each.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    rate_hz: f64,
    next: Stamp,
}

impl Schedule {
    /// The first reading is at time zero.
    #[must_use]
    pub fn new(rate_hz: f64) -> Self {
        Self {
            rate_hz,
            next: Stamp::ZERO,
        }
    }

    /// Whether a reading is due.
    pub fn due(&mut self, now: Stamp) -> bool {
        if now < self.next {
            return false;
        }
        // The small part keeps a period that is a multiple of the step from slipping by rounding.
        let passed = (now.as_secs() * self.rate_hz + 1e-9).floor();
        self.next = Stamp::from_secs((passed + 1.0) / self.rate_hz);
        true
    }
}

/// Wheel encoders: each turn is measured with a share of error, the sum is rounded to the resolution.
#[derive(Clone, Debug)]
pub struct Encoders {
    model: EncoderModel,
    rng: Pcg64Mcg,
    measured: [f64; 2],
}

impl Encoders {
    /// At zero.
    #[must_use]
    pub fn new(model: EncoderModel, rng: Pcg64Mcg) -> Self {
        Self {
            model,
            rng,
            measured: [0.0; 2],
        }
    }

    /// Adds a true turn of both wheels, rad.
    pub fn turn(&mut self, wheels: [f64; 2]) {
        for (measured, turn) in self.measured.iter_mut().zip(wheels) {
            *measured += turn * (1.0 + gauss(&mut self.rng, self.model.noise));
        }
    }

    /// Measured angles since start (left, right; rad).
    #[must_use]
    pub fn angles(&self) -> [f64; 2] {
        let step = self.model.resolution;
        self.measured.map(|angle| {
            if step > 0.0 {
                (angle / step).round() * step
            } else {
                angle
            }
        })
    }
}

/// Gyro and compass. The gyro integrates: it tells the mean yaw rate since its last reading.
#[derive(Clone, Debug)]
pub struct Inertial {
    model: ImuModel,
    rng: Pcg64Mcg,
    schedule: Schedule,
    turned: f64,
    last: Stamp,
}

impl Inertial {
    /// At rest.
    #[must_use]
    pub fn new(model: ImuModel, rng: Pcg64Mcg) -> Self {
        let schedule = Schedule::new(model.rate_hz);
        Self {
            model,
            rng,
            schedule,
            turned: 0.0,
            last: Stamp::ZERO,
        }
    }

    /// Adds a true turn of the base, rad.
    pub fn turn(&mut self, angle: f64) {
        self.turned += angle;
    }

    /// A reading, when it is due.
    pub fn read(&mut self, now: Stamp, truth: Pose2) -> Option<Imu> {
        if !self.schedule.due(now) {
            return None;
        }
        let secs = now.secs_since(self.last);
        let rate = if secs > 0.0 { self.turned / secs } else { 0.0 };
        self.turned = 0.0;
        self.last = now;
        let yaw_rate = rate + self.model.gyro_bias + gauss(&mut self.rng, self.model.gyro_noise);
        let yaw = self
            .model
            .compass_noise
            .map(|noise| wrap_angle(truth.yaw + gauss(&mut self.rng, noise)));
        Some(Imu {
            stamp: now,
            yaw_rate,
            yaw,
        })
    }
}

/// GPS or beacons.
#[derive(Clone, Debug)]
pub struct Positioning {
    model: GpsModel,
    rng: Pcg64Mcg,
    schedule: Schedule,
}

impl Positioning {
    /// Before its first reading.
    #[must_use]
    pub fn new(model: GpsModel, rng: Pcg64Mcg) -> Self {
        let schedule = Schedule::new(model.rate_hz);
        Self { model, rng, schedule }
    }

    /// A reading, when it is due.
    pub fn read(&mut self, now: Stamp, truth: Pose2) -> Option<Gps> {
        if !self.schedule.due(now) {
            return None;
        }
        let x = truth.x + gauss(&mut self.rng, self.model.noise);
        let y = truth.y + gauss(&mut self.rng, self.model.noise);
        Some(Gps {
            stamp: now,
            x,
            y,
            std_dev: self.model.noise,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn rng() -> Pcg64Mcg {
        stream(1, &Id::new("tiago").unwrap(), Sensor::Imu)
    }

    #[test]
    fn a_sensor_of_ten_hertz_gives_ten_readings_a_second() {
        let mut schedule = Schedule::new(10.0);
        let due: Vec<u64> = (0..100).filter(|tick| schedule.due(Stamp(tick * 20_000_000))).collect();
        assert_eq!(due, (0..20).map(|k| k * 5).collect::<Vec<_>>());
    }

    #[test]
    fn a_sensor_faster_than_the_step_reads_once_a_step() {
        let mut schedule = Schedule::new(1e6);
        assert!((0..100).all(|tick| schedule.due(Stamp(tick * 20_000_000))));
    }

    #[test]
    fn encoders_keep_the_sum_within_their_noise_and_on_their_steps() {
        let mut encoders = Encoders::new(
            EncoderModel {
                noise: 0.005,
                resolution: 0.001,
            },
            rng(),
        );
        for _ in 0..10_000 {
            encoders.turn([0.01, -0.02]);
        }
        let [left, right] = encoders.angles();
        assert!(
            (left - 100.0).abs() < 0.02 && (right + 200.0).abs() < 0.04,
            "{left} {right}"
        );
        assert!((left / 0.001 - (left / 0.001).round()).abs() < 1e-6);
    }

    #[test]
    fn the_gyro_tells_the_mean_rate_with_bias_and_noise() {
        let mut imu = Inertial::new(
            ImuModel {
                rate_hz: 10.0,
                gyro_noise: 0.01,
                gyro_bias: 0.1,
                compass_noise: None,
            },
            rng(),
        );
        let mut readings = Vec::new();
        for tick in 0..10_000 {
            readings.extend(imu.read(Stamp(tick * 20_000_000), Pose2::IDENTITY));
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

    #[test]
    fn streams_of_robots_and_sensors_differ() {
        let id = |name: &str| Id::new(name).unwrap();
        let first = |robot: &str, sensor, seed| gauss(&mut stream(seed, &id(robot), sensor), 1.0);
        assert_eq!(first("a", Sensor::Gps, 1), first("a", Sensor::Gps, 1));
        assert_ne!(first("a", Sensor::Gps, 1), first("b", Sensor::Gps, 1));
        assert_ne!(first("a", Sensor::Gps, 1), first("a", Sensor::Imu, 1));
        assert_ne!(first("a", Sensor::Gps, 1), first("a", Sensor::Gps, 2));
    }
}
