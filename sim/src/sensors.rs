//! What do encoders, gyro, compass and GPS measure, and when? Truth with bias, noise and steps, each from its own random stream;
//! readings get lost, and come late with the stamp of their measurement.
//!
//! A stream belongs to a robot's name and a sensor: another robot in the world changes nobody's noise.

use std::collections::VecDeque;

use rand::RngExt as _;
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
    /// No sensor, but the floor: what the wheels slip.
    Slip,
}

/// The random stream of a robot's sensor.
#[must_use]
pub fn stream(seed: u64, robot: &Id, sensor: Sensor) -> Pcg64Mcg {
    // FNV-1a over the name.
    let name = robot.as_str().bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    generator(seed, name.wrapping_add(sensor as u64))
}

/// The random stream of a mover, by its place in the world's file.
#[must_use]
pub fn walker_stream(seed: u64, index: usize) -> Pcg64Mcg {
    generator(seed, WALKERS.wrapping_add(index as u64))
}

/// Keeps the movers' streams apart from the robots'.
const WALKERS: u64 = 0x5_7A1B_E125;

/// A generator of its own for each name; the finaliser of SplitMix64 (Steele et al. 2014) spreads every bit.
fn generator(seed: u64, name: u64) -> Pcg64Mcg {
    let mix = |value: u64| {
        let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        value ^ (value >> 31)
    };
    let low = mix(mix(seed).wrapping_add(name));
    Pcg64Mcg::new((u128::from(mix(low.wrapping_add(0x9e37_79b9_7f4a_7c15))) << 64) | u128::from(low))
}

pub(crate) fn gauss(rng: &mut Pcg64Mcg, std_dev: f64) -> f64 {
    let unit: f64 = StandardNormal.sample(rng);
    unit * std_dev
}

/// Whether a reading is lost. A sensor that loses none draws nothing.
fn is_lost(rng: &mut Pcg64Mcg, dropout: f64) -> bool {
    dropout > 0.0 && rng.random::<f64>() < dropout
}

/// Rounds to a sensor's steps; a step of zero leaves the value.
pub(crate) fn stepped(value: f64, step: f64) -> f64 {
    if step > 0.0 {
        (value / step).round() * step
    } else {
        value
    }
}

/// Readings on their way.
#[derive(Clone, Debug)]
pub struct Delay<T> {
    latency: f64,
    waiting: VecDeque<(Stamp, T)>,
}

impl<T> Delay<T> {
    /// Nothing on its way; every reading takes `latency` seconds.
    #[must_use]
    pub fn new(latency: f64) -> Self {
        Self {
            latency,
            waiting: VecDeque::new(),
        }
    }

    /// Sends what was measured now; returns what arrives now, of several the latest.
    pub fn pass(&mut self, now: Stamp, reading: Option<T>) -> Option<T> {
        if self.latency <= 0.0 {
            return reading;
        }
        if let Some(reading) = reading {
            self.waiting.push_back((now.plus_secs(self.latency), reading));
        }
        let mut arrived = None;
        while self.waiting.front().is_some_and(|(due, _)| *due <= now) {
            arrived = self.waiting.pop_front().map(|(_, reading)| reading);
        }
        arrived
    }
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

    /// Adds a true turn of both wheels, rad.
    pub fn turn(&mut self, wheels: [f64; 2]) {
        for (measured, turn) in self.measured.iter_mut().zip(wheels) {
            *measured += turn * (1.0 + gauss(&mut self.rng, self.model.noise));
        }
    }

    /// Measured angles since start (left, right; rad), as far as they have arrived.
    pub fn read(&mut self, now: Stamp) -> [f64; 2] {
        let due = self.schedule.as_mut().is_none_or(|schedule| schedule.due(now));
        let read = (due && !is_lost(&mut self.rng, self.model.dropout))
            .then(|| self.measured.map(|angle| stepped(angle, self.model.resolution)));
        if let Some(angles) = self.delay.pass(now, read) {
            self.told = angles;
        }
        self.told
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
    delay: Delay<Imu>,
}

impl Inertial {
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

    /// A reading, when one arrives.
    pub fn read(&mut self, now: Stamp, truth: Pose2) -> Option<Imu> {
        let measured = self.measure(now, truth);
        self.delay.pass(now, measured)
    }

    fn measure(&mut self, now: Stamp, truth: Pose2) -> Option<Imu> {
        if !self.schedule.due(now) || is_lost(&mut self.rng, self.model.dropout) {
            return None;
        }
        let secs = now.secs_since(self.last);
        let rate = if secs > 0.0 { self.turned / secs } else { 0.0 };
        self.turned = 0.0;
        self.last = now;
        let yaw_rate = rate + self.model.gyro_bias + gauss(&mut self.rng, self.model.gyro_noise);
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

/// GPS or beacons.
#[derive(Clone, Debug)]
pub struct Positioning {
    model: GpsModel,
    rng: Pcg64Mcg,
    schedule: Schedule,
    delay: Delay<Gps>,
}

impl Positioning {
    /// Before its first reading.
    #[must_use]
    pub fn new(model: GpsModel, rng: Pcg64Mcg) -> Self {
        Self {
            rng,
            schedule: Schedule::new(model.rate_hz),
            delay: Delay::new(model.latency),
            model,
        }
    }

    /// A reading, when one arrives.
    pub fn read(&mut self, now: Stamp, truth: Pose2) -> Option<Gps> {
        let measured = self.measure(now, truth);
        self.delay.pass(now, measured)
    }

    fn measure(&mut self, now: Stamp, truth: Pose2) -> Option<Gps> {
        if !self.schedule.due(now) || is_lost(&mut self.rng, self.model.dropout) {
            return None;
        }
        let [bias_x, bias_y] = self.model.bias;
        let x = truth.x + bias_x + gauss(&mut self.rng, self.model.noise);
        let y = truth.y + bias_y + gauss(&mut self.rng, self.model.noise);
        Some(Gps {
            stamp: now,
            x: stepped(x, self.model.resolution),
            y: stepped(y, self.model.resolution),
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
                ..EncoderModel::default()
            },
            rng(),
        );
        for _ in 0..10_000 {
            encoders.turn([0.01, -0.02]);
        }
        let [left, right] = encoders.read(Stamp::ZERO);
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
                ..ImuModel::default()
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
    fn late_readings_keep_the_stamp_of_their_measurement_and_lost_ones_never_come() {
        let mut gps = Positioning::new(
            GpsModel {
                rate_hz: 10.0,
                noise: 0.0,
                bias: [1.0, -2.0],
                resolution: 0.5,
                dropout: 0.3,
                latency: 0.15,
            },
            rng(),
        );
        let mut readings = Vec::new();
        for tick in 0..10_000 {
            let now = Stamp(tick * 20_000_000);
            readings.extend(gps.read(now, Pose2::new(0.3, 0.1, 0.0)).map(|gps| (now, gps)));
        }
        // Ten a second for 200 s, three of ten lost; 0.15 s are eight steps of 20 ms.
        assert!((1300..1500).contains(&readings.len()), "{}", readings.len());
        assert!(
            readings
                .iter()
                .all(|(now, gps)| (now.secs_since(gps.stamp) - 0.16).abs() < 1e-9 && (gps.x, gps.y) == (1.5, -2.0))
        );
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
                let angles = encoders.read(Stamp(tick * 20_000_000));
                encoders.turn([0.1, 0.1]);
                angles[0]
            })
            .collect();
        // Read at 0, 0.1, 0.2 s, told 0.04 s later.
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
            encoders.turn([0.1, 0.1]);
            let [told, _] = encoders.read(Stamp(tick * 20_000_000));
            if told == last {
                lost += 1;
            } else {
                assert!((told - 0.1 * tick as f64).abs() < 1e-9, "{told} at tick {tick}");
            }
            last = told;
        }
        assert!((350..450).contains(&lost), "{lost}");
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
