//! Consistency of the pose estimate. Compares the error with the covariance over many seeded drives, each with its own start error, gyro
//! bias and wheel errors; at every step the errors of all drives are averaged. In [`CONDITIONS`] they are drawn from the filter's own
//! priors, and noise is as the filter assumes it: a filter without mistakes is consistent there. In [`MISMATCHED`] one of these assumptions
//! is wrong, so no filter that keeps to them can be consistent; what is asked is only that the errors stay bounded.
//!
//! Consistency after Bar-Shalom, Li, Kirubarajan 2001, ch. 5.4: the mean normalised estimation error squared (NEES) of `runs`
//! drives with three states lies in the two-sided 95 % band of chi-square / runs, [2.54, 3.50] for 100; so does, with its own
//! degrees of freedom, the normalised innovation squared (NIS) of each sensor. Errors are strongly correlated in time, so the steps of a
//! short drive are few independent samples: even for a perfect filter the share of steps in the band is 95 % only on average over long
//! drives or many seeds.

use std::collections::VecDeque;
use std::time::Duration;

use nalgebra::{Matrix3, Vector3};
use zenav_edge::estimator::{Estimator, Tally};
use zenav_edge::settings::EstimatorSettings;
use zenav_fixtures::robot;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::id::Id;
use zenav_protocol::messages::Correction;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;
use zenav_sim::{RobotSpec, Simulation, World};

use super::sim_rig::SimRigError;
use super::worlds::Rng;

/// Standard deviation of the start pose: m and rad.
const START: (f64, f64) = (0.05, 0.05);
/// Standard deviation of corrections from the cloud: m and rad.
const CORRECTION: (f64, f64) = (0.03, 0.02);
/// Steps between two corrections.
const CORRECTED: usize = 25;

/// Latency and loss of the sensors, and errors of the robot that the filter does not expect.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Name in the table.
    pub name: &'static str,
    /// Latency of GPS, s.
    pub gps_latency: f64,
    /// Latency of gyro and compass, s.
    pub imu_latency: f64,
    /// Share of GPS, gyro and compass readings that are lost.
    pub dropout: f64,
    /// Least and greatest latency of corrections, s; corrections may overtake one another.
    pub corrected: Option<(f64, f64)>,
    /// No GPS between these seconds of every minute.
    pub gps_lost: Option<(f64, f64)>,
    /// No gyro and compass between these seconds of every minute.
    pub imu_lost: Option<(f64, f64)>,
    /// How the robot differs from what the filter assumes.
    pub mismatch: Mismatch,
}

/// How the robot differs from what the filter assumes.
#[derive(Clone, Copy, Debug)]
pub struct Mismatch {
    /// Relative error of both wheel radii, on top of that drawn from the prior.
    pub wheels: f64,
    /// Slip, in multiples of the setting's square root (both per square root of a metre).
    pub slip: f64,
    /// Magnitude of the gyro's bias in standard deviations of its prior; `None`: drawn from the prior.
    pub gyro_bias: Option<f64>,
    /// Noise of GPS, in multiples of what it reports.
    pub gps_noise: f64,
}

const MATCHED: Mismatch = Mismatch {
    wheels: 0.0,
    slip: 1.0,
    gyro_bias: None,
    gps_noise: 1.0,
};

/// All sensors work, and the filter's assumptions hold.
pub(super) const ON_TIME: Conditions = Conditions {
    name: "all sensors",
    gps_latency: 0.0,
    imu_latency: 0.0,
    dropout: 0.0,
    corrected: None,
    gps_lost: None,
    imu_lost: None,
    mismatch: MATCHED,
};

/// The tested conditions in which the filter's assumptions hold.
pub const CONDITIONS: [Conditions; 5] = [
    ON_TIME,
    Conditions {
        name: "GPS 0.5 s late",
        gps_latency: 0.5,
        ..ON_TIME
    },
    Conditions {
        name: "late and missing",
        gps_latency: 0.3,
        imu_latency: 0.06,
        dropout: 0.2,
        corrected: Some((0.2, 1.5)),
        ..ON_TIME
    },
    Conditions {
        name: "GPS lost for 30 s",
        gps_lost: Some((15.0, 45.0)),
        ..ON_TIME
    },
    Conditions {
        name: "IMU lost for 30 s",
        imu_lost: Some((15.0, 45.0)),
        ..ON_TIME
    },
];

/// The tested conditions in which one of them does not.
pub const MISMATCHED: [Conditions; 3] = [
    Conditions {
        name: "wheels 2 % off, slip doubled",
        mismatch: Mismatch {
            wheels: 0.02,
            slip: 2.0,
            ..MATCHED
        },
        ..ON_TIME
    },
    Conditions {
        name: "gyro bias of 3 sigma",
        mismatch: Mismatch {
            gyro_bias: Some(3.0),
            ..MATCHED
        },
        ..ON_TIME
    },
    Conditions {
        name: "GPS noisier by half",
        mismatch: Mismatch {
            gps_noise: 1.5,
            ..MATCHED
        },
        ..ON_TIME
    },
];

/// Sums over drives, step by step.
#[derive(Clone, Debug, Default)]
pub struct Sums {
    /// NEES of (x, y, yaw).
    pub nees: Vec<f64>,
    /// NIS of compass, GPS and corrections, with the number of drives that had one in the step.
    pub nis: [Vec<(f64, u32)>; 3],
    /// Number of steps with a position error within three standard deviations, and of all steps.
    pub within: (u32, u32),
    /// Largest position error, m.
    pub worst: f64,
    /// Largest value of three standard deviations of the position, m.
    pub allowed: f64,
    /// How the filter handled its inputs.
    pub tally: Tally,
    /// Time that each step of the filter took, s.
    pub took: Vec<f64>,
}

/// Corrections on their way, with their arrival times.
#[derive(Default)]
struct OffBoard {
    waiting: VecDeque<(Stamp, Correction)>,
}

impl OffBoard {
    fn measure(&mut self, now: Stamp, truth: Pose2, (least, most): (f64, f64), rng: &mut Rng) {
        let (position, yaw) = CORRECTION;
        let correction = Correction {
            stamp: now,
            map_from_base: Pose2::new(
                truth.x + position * rng.gauss(),
                truth.y + position * rng.gauss(),
                truth.yaw + yaw * rng.gauss(),
            ),
            covariance: Matrix3::from_diagonal(&Vector3::new(position * position, position * position, yaw * yaw))
                .as_slice()
                .try_into()
                .unwrap_or_default(),
            ..Correction::default()
        };
        self.waiting
            .push_back((now.plus_secs(rng.between(least, most)), correction));
    }

    fn arrived(&mut self, now: Stamp) -> Vec<Correction> {
        let (arrived, waiting) = std::mem::take(&mut self.waiting)
            .into_iter()
            .partition(|(due, _)| *due <= now);
        self.waiting = waiting;
        let arrived: VecDeque<(Stamp, Correction)> = arrived;
        arrived.into_iter().map(|(_, correction)| correction).collect()
    }
}

/// Estimator settings with the prior that the start poses are drawn from.
fn known_start() -> EstimatorSettings {
    EstimatorSettings {
        start_std: START.0,
        start_yaw_std: START.1,
        // These corrections come from no map: they share no error, and their errors do not accumulate.
        map_std: 0.0,
        map_walk: 0.0,
        map_turn_walk: 0.0,
        ..EstimatorSettings::default()
    }
}

impl Conditions {
    /// The robot's body: its errors are drawn from the filter's priors, but for the mismatch.
    pub(super) fn body(&self, believed: &RobotModel, priors: &EstimatorSettings, rng: &mut Rng) -> RobotModel {
        let mut model = believed.clone();
        let errors = &mut model.drive.errors;
        errors.wheel_radius = [0.0; 2].map(|_| self.mismatch.wheels + priors.radius_std * rng.gauss());
        errors.wheel_separation = priors.separation_std * rng.gauss();
        errors.slip = self.mismatch.slip * priors.slip.sqrt();
        let drawn = rng.gauss();
        let sigmas = self.mismatch.gyro_bias.map_or(drawn, |sigmas| sigmas * drawn.signum());
        model.imu.gyro_bias = priors.bias_std * sigmas;
        (model.imu.latency, model.imu.dropout) = (self.imu_latency, self.dropout);
        if let Some(gps) = &mut model.gps {
            (gps.latency, gps.dropout) = (self.gps_latency, self.dropout);
            gps.noise *= self.mismatch.gps_noise;
        }
        model
    }
}

/// Drives for `secs` and adds to the sums. `clock`: time since any fixed moment.
///
/// # Errors
/// [`SimRigError`] for an invalid robot or world.
pub fn drive(
    sums: &mut Sums,
    conditions: &Conditions,
    seed: u64,
    secs: f64,
    clock: &dyn Fn() -> Duration,
) -> Result<(), SimRigError> {
    let mut rng = Rng::new(seed, 3);
    let (believed, settings) = (robot("tiago"), known_start());
    let model = conditions.body(&believed, &settings, &mut rng);
    let world = World::shipped("empty")?;
    let start = world.start();
    let spec = RobotSpec {
        id: Id::robot("robot")?,
        model: model.clone(),
        start,
    };
    let mut sim = Simulation::new(&world, vec![spec], seed)?;
    let guess = Pose2::new(
        start.x + START.0 * rng.gauss(),
        start.y + START.0 * rng.gauss(),
        start.yaw + START.1 * rng.gauss(),
    );
    let mut estimator = Estimator::new(&believed, guess, &settings);
    let mut off_board = OffBoard::default();
    let mut wheels = [0.0; 2];
    for tick in 0..(secs * 50.0) as usize {
        if tick % 100 == 0 {
            let (v, w) = (rng.between(0.0, 0.5), rng.between(-0.6, 0.6));
            wheels = model.drive.wheels(Twist2::new(v, w));
        }
        sim.drive(0, wheels);
        sim.step();
        let mut readings = sim.readings(0);
        if let Some(gps) = &mut readings.gps {
            gps.std_dev /= conditions.mismatch.gps_noise;
        }
        let second = readings.stamp.as_secs() % 60.0;
        let lost = |times: Option<(f64, f64)>| times.is_some_and(|(from, to)| second >= from && second < to);
        if lost(conditions.gps_lost) {
            readings.gps = None;
        }
        if lost(conditions.imu_lost) {
            readings.imu = None;
        }
        let truth = sim.truth(0).map_from_base;
        if let Some(late) = conditions.corrected.filter(|_| tick % CORRECTED == 0) {
            off_board.measure(readings.stamp, truth, late, &mut rng);
        }
        let corrections = off_board.arrived(readings.stamp);
        let before = clock();
        estimator.step(&readings, &corrections);
        sums.took.push(clock().saturating_sub(before).as_secs_f64());
        sums.add(tick, &estimator, truth);
    }
    let (sum, tally) = (&mut sums.tally, estimator.tally());
    sum.fused += tally.fused;
    sum.outliers += tally.outliers;
    sum.too_late += tally.too_late;
    sum.repeated += tally.repeated;
    sum.broken += tally.broken;
    Ok(())
}

/// Time of each step, s, with a correction that is nearly as late as the window allows, so that all later inputs are reapplied.
///
/// # Errors
/// [`SimRigError`] for an invalid robot or world.
pub fn latest(clock: &dyn Fn() -> Duration) -> Result<Vec<f64>, SimRigError> {
    const LATE: f64 = 1.95;
    let model: RobotModel = robot("tiago");
    let world = World::shipped("empty")?;
    let start = world.start();
    let id = Id::robot("robot")?;
    let spec = RobotSpec {
        id,
        model: model.clone(),
        start,
    };
    let mut sim = Simulation::new(&world, vec![spec], 1)?;
    let mut estimator = Estimator::new(&model, start, &known_start());
    sim.drive(0, [2.0, 2.5]);
    let mut took = Vec::new();
    let mut rng = Rng::new(1, 3);
    let mut off_board = OffBoard::default();
    for _ in 0..500 {
        sim.step();
        let readings = sim.readings(0);
        off_board.measure(readings.stamp, sim.truth(0).map_from_base, (LATE, LATE), &mut rng);
        let corrections = off_board.arrived(readings.stamp);
        let before = clock();
        estimator.step(&readings, &corrections);
        if !corrections.is_empty() {
            took.push(clock().saturating_sub(before).as_secs_f64());
        }
    }
    Ok(took)
}

impl Sums {
    /// Adds a step of a drive.
    fn add(&mut self, tick: usize, estimator: &Estimator, truth: Pose2) {
        let estimate = estimator.map_from_base();
        let covariance = Matrix3::from_row_slice(&estimator.covariance());
        let error = Vector3::new(
            estimate.x - truth.x,
            estimate.y - truth.y,
            wrap_angle(estimate.yaw - truth.yaw),
        );
        self.within.1 += 1;
        let Some(inverse) = covariance.try_inverse() else {
            return;
        };
        let nees = (error.transpose() * inverse * error)[0];
        match self.nees.get_mut(tick) {
            Some(sum) => *sum += nees,
            None => self.nees.push(nees),
        }
        for (sums, nis) in self.nis.iter_mut().zip(estimator.nis()) {
            if sums.len() <= tick {
                sums.push((0.0, 0));
            }
            if let (Some(sum), Some(nis)) = (sums.get_mut(tick), nis) {
                *sum = (sum.0 + nis, sum.1 + 1);
            }
        }
        let off = error.x.hypot(error.y);
        let allowed = 3.0 * (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
        self.within.0 += u32::from(off <= allowed);
        self.worst = self.worst.max(off);
        self.allowed = self.allowed.max(allowed);
    }
}

/// The two-sided 95 % band of a mean of `runs` chi-square values with `freedom` degrees (Wilson and Hilferty 1931).
#[must_use]
pub fn band(freedom: f64, runs: f64) -> (f64, f64) {
    let all = freedom * runs;
    let spread = 2.0 / (9.0 * all);
    let at = |sigmas: f64| freedom * (1.0 - spread + sigmas * spread.sqrt()).powi(3);
    (at(-1.96), at(1.96))
}

/// Mean of each step at which about the usual number of drives had a reading, and that number. Readings at scattered times are pooled in
/// order until there are `runs` of them.
#[must_use]
pub fn means(sums: &[(f64, u32)], runs: u64) -> (Vec<f64>, f64) {
    let usual = sums.iter().map(|(_, readings)| *readings).max().unwrap_or(0);
    // With late and lost readings no step has a reading of most drives.
    let pool = u64::from(usual) * 2 < runs;
    let mut pooled: Vec<(f64, u32)> = Vec::new();
    if pool {
        let mut sum = (0.0, 0);
        for step in sums {
            sum = (sum.0 + step.0, sum.1 + step.1);
            if u64::from(sum.1) >= runs {
                pooled.push(std::mem::take(&mut sum));
            }
        }
    } else {
        pooled.extend(
            sums.iter()
                .filter(|(_, readings)| f64::from(*readings) > 0.7 * f64::from(usual)),
        );
    }
    let readings = pooled.iter().map(|(_, readings)| f64::from(*readings)).sum::<f64>();
    let means: Vec<f64> = pooled
        .iter()
        .map(|(sum, readings)| sum / f64::from(*readings))
        .collect();
    let each = readings / means.len().max(1) as f64;
    (means, each)
}

/// Share of steps whose mean lies within the band, and the mean over all.
#[must_use]
pub fn share(means: &[f64], (low, high): (f64, f64)) -> (f64, f64) {
    let inside = means.iter().filter(|mean| (low..=high).contains(*mean)).count();
    let count = means.len().max(1) as f64;
    (inside as f64 / count, means.iter().sum::<f64>() / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_band_of_a_hundred_runs_is_that_of_the_tables() {
        let (low, high) = band(3.0, 100.0);
        assert!((low - 2.54).abs() < 0.01 && (high - 3.50).abs() < 0.01, "{low} {high}");
    }
}
