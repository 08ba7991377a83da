//! Is the estimate as good as its covariance says? Many seeded drives, each with its own start error, gyro bias and crooked wheels,
//! drawn from what the filter assumes; at every step the errors of all drives are averaged.
//!
//! Consistency after Bar-Shalom, Li, Kirubarajan 2001, ch. 5.4: the mean normalised estimation error squared (NEES) of `runs`
//! drives with three states lies in the two-sided 95 % band of chi-square / runs, [2.54, 3.50] for 100; so does, with its own
//! degrees of freedom, the normalised innovation squared (NIS) of each sensor.

use nalgebra::{Matrix3, Vector3};
use zenav_edge::estimator::Estimator;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::id::Id;
use zenav_protocol::robot::RobotModel;
use zenav_sim::{RobotSpec, Simulation, World};

use super::ground::{GroundError, robot};
use super::worlds::Dice;

/// How well the start is known: m and rad.
const START: (f64, f64) = (0.05, 0.05);
/// Crookedness of the wheels' radii, as a share: what the filter assumes.
const WHEELS: f64 = 0.01;
/// Bias of the gyro, rad/s: what the filter assumes.
const GYRO_BIAS: f64 = 0.001;

/// How the sensors are.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Name in the table.
    pub name: &'static str,
    /// GPS comes this late, s.
    pub gps_latency: f64,
    /// Share of GPS and compass readings that are lost.
    pub dropout: f64,
    /// GPS is lost altogether between these times, s.
    pub gps_lost: Option<(f64, f64)>,
}

/// What is looked at.
pub const CONDITIONS: [Conditions; 3] = [
    Conditions {
        name: "all sensors",
        gps_latency: 0.0,
        dropout: 0.0,
        gps_lost: None,
    },
    Conditions {
        name: "late and missing",
        gps_latency: 0.1,
        dropout: 0.2,
        gps_lost: None,
    },
    Conditions {
        name: "GPS lost for 30 s",
        gps_latency: 0.0,
        dropout: 0.0,
        gps_lost: Some((15.0, 45.0)),
    },
];

/// Sums over drives, step by step.
#[derive(Clone, Debug, Default)]
pub struct Sums {
    /// NEES of (x, y, yaw).
    pub nees: Vec<f64>,
    /// NIS of the compass and of GPS, with how many drives had one in the step.
    pub nis: [Vec<(f64, u32)>; 2],
    /// Steps at which the position error was within three standard deviations, and all.
    pub within: (u32, u32),
    /// Largest position error, m.
    pub worst: f64,
}

/// Drives for `secs` and adds up.
///
/// # Errors
/// [`GroundError`] for a robot or world that cannot be.
pub fn drive(sums: &mut Sums, conditions: &Conditions, seed: u64, secs: f64) -> Result<(), GroundError> {
    let mut dice = Dice::new(seed, 3);
    let believed: RobotModel = robot("tiago")?;
    let mut model = believed.clone();
    model.drive.errors.wheel_radius = [0.0; 2].map(|_| WHEELS * dice.gauss());
    model.drive.errors.slip = 1e-3;
    model.imu.gyro_bias = GYRO_BIAS * dice.gauss();
    model.imu.dropout = conditions.dropout;
    if let Some(gps) = &mut model.gps {
        (gps.latency, gps.dropout) = (conditions.gps_latency, conditions.dropout);
    }
    let world = World::shipped("empty")?;
    let start = world.start();
    let spec = RobotSpec {
        id: Id::robot("robot")?,
        model: model.clone(),
        start,
    };
    let mut sim = Simulation::new(&world, vec![spec], seed)?;
    let guess = Pose2::new(
        start.x + START.0 * dice.gauss(),
        start.y + START.0 * dice.gauss(),
        start.yaw + START.1 * dice.gauss(),
    );
    let mut believed = believed;
    believed.drive.errors.slip = model.drive.errors.slip;
    let mut estimator = Estimator::new(&believed, guess, START.0, START.1);
    let mut wheels = [0.0; 2];
    for tick in 0..(secs * 50.0) as usize {
        if tick % 100 == 0 {
            let (v, w) = (dice.between(0.0, 0.5), dice.between(-0.6, 0.6));
            wheels = model.drive.wheels(zenav_protocol::geometry::Twist2::new(v, w));
        }
        sim.drive(0, wheels);
        sim.step();
        let mut readings = sim.readings(0);
        let now = readings.stamp.as_secs();
        if conditions.gps_lost.is_some_and(|(from, to)| now >= from && now < to) {
            readings.gps = None;
        }
        estimator.step(&readings);
        let (estimate, truth) = (estimator.map_from_base(), sim.truth(0).map_from_base);
        let covariance = Matrix3::from_row_slice(&estimator.covariance());
        let error = Vector3::new(
            estimate.x - truth.x,
            estimate.y - truth.y,
            wrap_angle(estimate.yaw - truth.yaw),
        );
        let Some(inverse) = covariance.try_inverse() else {
            sums.within.1 += 1;
            continue;
        };
        let at = |values: &mut Vec<f64>, value| match values.get_mut(tick) {
            Some(sum) => *sum += value,
            None => values.push(value),
        };
        at(&mut sums.nees, (error.transpose() * inverse * error)[0]);
        for (sums, nis) in sums.nis.iter_mut().zip(estimator.nis()) {
            if sums.len() <= tick {
                sums.push((0.0, 0));
            }
            if let (Some(sum), Some(nis)) = (sums.get_mut(tick), nis) {
                *sum = (sum.0 + nis, sum.1 + 1);
            }
        }
        let off = error.x.hypot(error.y);
        let claimed = 3.0 * (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
        sums.within.0 += u32::from(off <= claimed);
        sums.within.1 += 1;
        sums.worst = sums.worst.max(off);
    }
    Ok(())
}

/// The two-sided 95 % band of a mean of `runs` chi-square values with `freedom` degrees (Wilson and Hilferty 1931).
#[must_use]
pub fn band(freedom: f64, runs: f64) -> (f64, f64) {
    let all = freedom * runs;
    let spread = 2.0 / (9.0 * all);
    let at = |sigmas: f64| freedom * (1.0 - spread + sigmas * spread.sqrt()).powi(3);
    (at(-1.96), at(1.96))
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
