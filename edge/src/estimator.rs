//! Where is the robot? Dead reckoning (`odom_from_base`, continuous) and its correction (`map_from_odom`), REP-105.
//!
//! An extended Kalman filter over (x, y, yaw, gyro bias, wheel scale) in the map frame: encoders and gyro predict, GPS, compass
//! and corrections from off board update. A measurement is compared with the pose at its own stamp, reached backwards by
//! odometry, so late and out-of-order ones count rightly; those that do not fit are gated by their Mahalanobis distance
//! (Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, ch. 5 and 11).

use nalgebra::{Matrix3, RowSVector, SMatrix, SVector, Vector2, Vector3};
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::{Correction, Gps, Imu};
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::history::PoseHistory;

/// Gates at 99.9 % of the chi-square distribution for one, two and three dimensions.
const GATE: [f64; 3] = [10.83, 13.82, 16.27];
/// After so many rejected measurements in a row the estimate is doubted rather than the sensor.
const DOUBT_AFTER: u32 = 25;
/// Least random walk of a wheel beyond the encoder's own noise (slip, floor), m² for each m rolled.
const SLIP: f64 = 1e-6;
/// The wheels' variance is taken this much larger: arcs, steps and gates are not in the model.
const CAUTION: f64 = 1.8;
/// Wheels that have not turned for this long are at rest, s.
const STILL: f64 = 0.5;
/// A gyro that was silent for longer does not tell what happened meanwhile, s.
const LONGEST_SPAN: f64 = 1.0;
/// Random walk of the gyro's bias, (rad/s)² for each s.
const BIAS_WALK: f64 = 1e-10;
/// How far wheels may be from their stated radius, as a share (standard deviation), and how that wanders, 1/s.
const SCALE: (f64, f64) = (0.01, 1e-9);
/// Turns by wheels alone are wrong by this share: separation and unequal radii.
const TURN_SHARE: f64 = 0.02;
/// States: x, y, yaw, gyro bias, wheel scale.
const STATES: usize = 5;

/// The pose filter.
#[derive(Clone, Debug)]
pub struct Estimator {
    model: RobotModel,
    /// x, y, yaw in the map, the gyro's bias, and how much larger the wheels are than stated, as a share.
    state: SVector<f64, STATES>,
    covariance: SMatrix<f64, STATES, STATES>,
    odom_from_base: Pose2,
    velocity: Twist2,
    history: PoseHistory,
    last: Option<(Stamp, [f64; 2])>,
    gyro: Option<(Stamp, f64)>,
    /// Turn reckoned since the gyro's last reading, rad.
    reckoned: f64,
    still: f64,
    stood_at: [f64; 2],
    rejected: [u32; 3],
    /// Of each kind of measurement, the newest one's normalised innovation squared.
    nis: [Option<f64>; 3],
}

/// What became of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fusion {
    /// It counted.
    Fused,
    /// It did not fit, was broken, or too old.
    Rejected,
}

impl Estimator {
    /// A robot that stands at `start` in the map, known to the given standard deviations (m, rad).
    #[must_use]
    pub fn new(model: &RobotModel, start: Pose2, std: f64, yaw_std: f64) -> Self {
        let bias_std = model.imu.gyro_bias.abs().max(0.5 * model.imu.gyro_noise).max(1e-5);
        Self {
            model: model.clone(),
            state: SVector::from([start.x, start.y, start.yaw, 0.0, 0.0]),
            covariance: SMatrix::from_diagonal(&SVector::from([
                std * std,
                std * std,
                yaw_std * yaw_std,
                bias_std * bias_std,
                SCALE.0 * SCALE.0,
            ])),
            odom_from_base: Pose2::IDENTITY,
            velocity: Twist2::ZERO,
            history: PoseHistory::default(),
            last: None,
            gyro: None,
            reckoned: 0.0,
            still: 0.0,
            stood_at: [0.0; 2],
            rejected: [0; 3],
            nis: [None; 3],
        }
    }

    /// Takes one tick's readings: predicts, then updates by what came.
    pub fn step(&mut self, readings: &Readings) {
        self.nis = [None; 3];
        self.predict(readings);
        if let Some(imu) = &readings.imu {
            self.compass(imu);
        }
        if let Some(gps) = &readings.gps {
            self.gps(gps);
        }
    }

    /// Pose in the map.
    #[must_use]
    pub fn map_from_base(&self) -> Pose2 {
        Pose2::new(self.state[0], self.state[1], self.state[2])
    }

    /// The normalised innovation squared of this tick's measurements: compass (1 degree of freedom), GPS (2), correction (3).
    #[must_use]
    pub fn nis(&self) -> [Option<f64>; 3] {
        self.nis
    }

    /// Dead reckoning since start: continuous, drifting.
    #[must_use]
    pub fn odom_from_base(&self) -> Pose2 {
        self.odom_from_base
    }

    /// The correction of dead reckoning: may jump.
    #[must_use]
    pub fn map_from_odom(&self) -> Pose2 {
        self.map_from_base() * self.odom_from_base.inverse()
    }

    /// Dead reckoning at an earlier stamp; `None` when that is too long ago.
    #[must_use]
    pub fn odom_from_base_at(&self, stamp: Stamp) -> Option<Pose2> {
        self.history.at(stamp)
    }

    /// Velocity in the base frame.
    #[must_use]
    pub fn velocity(&self) -> Twist2 {
        self.velocity
    }

    /// Row-major covariance of (x, y, yaw): m², m rad, rad².
    #[must_use]
    pub fn covariance(&self) -> [f64; 9] {
        let block: Matrix3<f64> = self.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let mut rows = [0.0; 9];
        rows.iter_mut()
            .enumerate()
            .for_each(|(i, value)| *value = block[(i / 3, i % 3)]);
        rows
    }

    fn predict(&mut self, readings: &Readings) {
        let wheels = if readings.wheels.iter().all(|angle| angle.is_finite()) {
            readings.wheels
        } else {
            self.last.map_or([0.0; 2], |(_, wheels)| wheels)
        };
        let Some((then, before)) = self.last.replace((readings.stamp, wheels)) else {
            self.history.push(readings.stamp, self.odom_from_base);
            return;
        };
        let dt = readings.stamp.secs_since(then);
        if dt <= 0.0 {
            return;
        }
        let drive = &self.model.drive;
        let mut turns = [wheels[0] - before[0], wheels[1] - before[1]];
        // An encoder that was reset or lost counts: no wheel turns at thrice its limit.
        if turns
            .iter()
            .any(|turn| turn.abs() > 3.0 * drive.max_wheel_speed * dt + 0.1)
        {
            turns = [0.0; 2];
        }
        let rolled = drive.twist(turns);
        let slip = SLIP.max(drive.errors.slip.powi(2));
        let wheel_variance = turns
            .iter()
            .map(|turn| {
                let metres = turn * drive.wheel_radius;
                (self.model.encoders.noise * metres).powi(2) + slip * metres.abs()
            })
            .sum::<f64>()
            * CAUTION;

        let forward_variance = 0.25 * wheel_variance;
        let mut turn_variance = wheel_variance / drive.wheel_separation.powi(2) + (TURN_SHARE * rolled.w).powi(2);
        let (turn, by_gyro) = match self.turned(readings.imu.as_ref(), readings.stamp, dt) {
            Some((turn, variance)) => {
                turn_variance = variance;
                (turn, true)
            }
            None => (rolled.w, false),
        };
        self.reckon(readings, turn);
        self.learn_bias_at_rest(wheels, dt);

        let scale = 1.0 + self.state[4];
        let step = Twist2::new(rolled.v, turn);
        self.odom_from_base = self.odom_from_base.advance(step, 1.0);
        self.history.push(readings.stamp, self.odom_from_base);
        self.velocity = self.smoothed(Twist2::new(rolled.v / dt, turn / dt), dt);

        let heading = self.state[2] + 0.5 * turn;
        let way = scale * rolled.v;
        let moved = self.map_from_base().advance(Twist2::new(way, turn), 1.0);
        self.state = SVector::from([moved.x, moved.y, moved.yaw, self.state[3], self.state[4]]);
        let mut jacobian = SMatrix::<f64, STATES, STATES>::identity();
        jacobian[(0, 2)] = -way * heading.sin();
        jacobian[(1, 2)] = way * heading.cos();
        jacobian[(0, 4)] = rolled.v * heading.cos();
        jacobian[(1, 4)] = rolled.v * heading.sin();
        if by_gyro {
            jacobian[(2, 3)] = -dt;
            jacobian[(0, 3)] = 0.5 * dt * way * heading.sin();
            jacobian[(1, 3)] = -0.5 * dt * way * heading.cos();
        }
        let (sin, cos) = heading.sin_cos();
        // The forward error acts along the heading; a little sideways slip keeps the covariance regular.
        let along = Vector2::new(cos, sin);
        let across = Vector2::new(-sin, cos);
        let position =
            along * along.transpose() * forward_variance + across * across.transpose() * (0.05 * forward_variance);
        let mut noise = SMatrix::<f64, STATES, STATES>::zeros();
        noise.fixed_view_mut::<2, 2>(0, 0).copy_from(&position);
        noise[(2, 2)] = turn_variance;
        noise[(3, 3)] = BIAS_WALK * dt;
        noise[(4, 4)] = SCALE.1 * dt;
        self.covariance = jacobian * self.covariance * jacobian.transpose() + noise;
    }

    /// Keeps the turn that was reckoned since the gyro's last reading.
    fn reckon(&mut self, readings: &Readings, turn: f64) {
        match (&readings.imu, self.gyro) {
            (Some(imu), Some((_, rate))) if imu.yaw_rate.is_finite() => {
                let since = readings.stamp.secs_since(imu.stamp).clamp(0.0, LONGEST_SPAN);
                self.reckoned = (rate - self.state[3]) * since;
            }
            _ => self.reckoned += turn,
        }
    }

    /// The turn since the last tick by the gyro, rad, and its variance. A reading is the mean rate since the one before; while
    /// none comes the last rate is held for a while, and the next reading makes up for what was reckoned without it.
    fn turned(&mut self, imu: Option<&Imu>, now: Stamp, dt: f64) -> Option<(f64, f64)> {
        let bias = self.state[3];
        if let Some(imu) = imu.filter(|imu| imu.yaw_rate.is_finite()) {
            let span = self.gyro.map_or(dt, |(last, _)| imu.stamp.secs_since(last));
            let (span, reckoned) = if span > 0.0 && span < LONGEST_SPAN {
                (span, self.reckoned)
            } else {
                (dt, 0.0)
            };
            self.gyro = Some((imu.stamp, imu.yaw_rate));
            let rate = imu.yaw_rate - bias;
            let since = rate * now.secs_since(imu.stamp).clamp(0.0, LONGEST_SPAN);
            return Some((
                rate * span + since - reckoned,
                (self.model.imu.gyro_noise * span).powi(2) + 1e-12,
            ));
        }
        let (stamp, rate) = self.gyro?;
        let held = now.secs_since(stamp) <= 2.5 / self.model.imu.rate_hz;
        held.then_some(((rate - bias) * dt, 1e-12))
    }

    /// A gyro that turns while the wheels stand still shows its bias.
    fn learn_bias_at_rest(&mut self, wheels: [f64; 2], dt: f64) {
        // Against where the wheels stood when they came to rest: a slow creep is no rest.
        let flicker = 1.01 * self.model.encoders.resolution + 1e-9;
        let resting = wheels
            .iter()
            .zip(self.stood_at)
            .all(|(now, then)| (now - then).abs() <= flicker);
        if !resting {
            (self.still, self.stood_at) = (0.0, wheels);
            return;
        }
        self.still += dt;
        if let Some((_, rate)) = self.gyro
            && self.still > STILL
        {
            let noise = SMatrix::<f64, 1, 1>::new((2.0 * self.model.imu.gyro_noise).powi(2) + 1e-6);
            let jacobian = RowSVector::from([0.0, 0.0, 0.0, 1.0, 0.0]);
            self.update(SVector::<f64, 1>::new(rate - self.state[3]), jacobian, noise, GATE[0]);
        }
    }

    /// Encoder steps are coarse against one tick: average over about three.
    fn smoothed(&self, raw: Twist2, dt: f64) -> Twist2 {
        let share = (dt / 0.05).min(1.0);
        Twist2::new(
            self.velocity.v + share * (raw.v - self.velocity.v),
            self.velocity.w + share * (raw.w - self.velocity.w),
        )
    }

    /// How the base lay in its present frame at an earlier stamp.
    fn base_now_from_base_at(&self, stamp: Stamp) -> Option<Pose2> {
        self.history.at(stamp).map(|then| self.odom_from_base.inverse() * then)
    }

    /// Change of a past position with the present yaw.
    fn lever(&self, base_now_from_then: &Pose2) -> Vector2<f64> {
        let (sin, cos) = self.state[2].sin_cos();
        Vector2::new(
            -sin * base_now_from_then.x - cos * base_now_from_then.y,
            cos * base_now_from_then.x - sin * base_now_from_then.y,
        )
    }

    /// Takes a compass reading, if there is one in it.
    fn compass(&mut self, imu: &Imu) -> Option<Fusion> {
        let (yaw, noise) = (imu.yaw?, self.model.imu.compass_noise?);
        let then = self.base_now_from_base_at(imu.stamp)?;
        let innovation = wrap_angle(yaw - (self.map_from_base() * then).yaw);
        Some(self.gated(
            0,
            SVector::<f64, 1>::new(innovation),
            RowSVector::from([0.0, 0.0, 1.0, 0.0, 0.0]),
            SMatrix::<f64, 1, 1>::new(noise * noise + 1e-8),
        ))
    }

    /// Takes a position measurement.
    pub fn gps(&mut self, gps: &Gps) -> Fusion {
        let Some(then) = self.base_now_from_base_at(gps.stamp) else {
            return Fusion::Rejected;
        };
        if !(gps.std_dev.is_finite() && gps.std_dev >= 0.0) {
            return Fusion::Rejected;
        }
        let predicted = self.map_from_base() * then;
        let lever = self.lever(&then);
        let jacobian =
            SMatrix::<f64, 2, STATES>::from_row_slice(&[1.0, 0.0, lever.x, 0.0, 0.0, 0.0, 1.0, lever.y, 0.0, 0.0]);
        let variance = gps.std_dev * gps.std_dev + 1e-8;
        self.gated(
            1,
            Vector2::new(gps.x - predicted.x, gps.y - predicted.y),
            jacobian,
            SMatrix::<f64, 2, 2>::identity() * variance,
        )
    }

    /// Takes a pose measurement made off board; the caller has checked that its boot is this one.
    pub fn correction(&mut self, correction: &Correction) -> Fusion {
        let Some(then) = self.base_now_from_base_at(correction.stamp) else {
            return Fusion::Rejected;
        };
        let noise = Matrix3::from_row_slice(&correction.covariance);
        if noise.cholesky().is_none() || (noise - noise.transpose()).norm() > 1e-9 * noise.norm() {
            return Fusion::Rejected;
        }
        let predicted = self.map_from_base() * then;
        let measured = correction.map_from_base;
        let innovation = Vector3::new(
            measured.x - predicted.x,
            measured.y - predicted.y,
            wrap_angle(measured.yaw - predicted.yaw),
        );
        let lever = self.lever(&then);
        #[rustfmt::skip]
        let jacobian = SMatrix::<f64, 3, STATES>::from_row_slice(&[
            1.0, 0.0, lever.x, 0.0, 0.0,
            0.0, 1.0, lever.y, 0.0, 0.0,
            0.0, 0.0, 1.0, 0.0, 0.0,
        ]);
        self.gated(2, innovation, jacobian, noise)
    }

    /// Updates unless the measurement lies too far off; after many such in a row the estimate itself is doubted.
    fn gated<const N: usize>(
        &mut self,
        sensor: usize,
        innovation: SVector<f64, N>,
        jacobian: SMatrix<f64, N, STATES>,
        noise: SMatrix<f64, N, N>,
    ) -> Fusion {
        let (fusion, distance) = self.update(innovation, jacobian, noise, GATE[N - 1]);
        self.nis[sensor] = Some(distance);
        let rejected = &mut self.rejected[sensor];
        *rejected = if fusion == Fusion::Fused { 0 } else { *rejected + 1 };
        if *rejected >= DOUBT_AFTER && innovation.iter().all(|value| value.is_finite()) {
            *rejected = 0;
            self.covariance += SMatrix::from_diagonal(&SVector::from([1.0, 1.0, 0.5, 0.0, 0.0]));
        }
        fusion
    }

    /// Also tells the normalised innovation squared.
    fn update<const N: usize>(
        &mut self,
        innovation: SVector<f64, N>,
        jacobian: SMatrix<f64, N, STATES>,
        noise: SMatrix<f64, N, N>,
        gate: f64,
    ) -> (Fusion, f64) {
        let spread = jacobian * self.covariance * jacobian.transpose() + noise;
        let Some(inverse) = spread.try_inverse() else {
            return (Fusion::Rejected, f64::INFINITY);
        };
        let distance = (innovation.transpose() * inverse * innovation)[0];
        if !distance.is_finite() || distance > gate {
            return (Fusion::Rejected, distance);
        }
        let gain = self.covariance * jacobian.transpose() * inverse;
        self.state += gain * innovation;
        self.state[2] = wrap_angle(self.state[2]);
        // Joseph's form stays symmetric and positive.
        let rest = SMatrix::<f64, STATES, STATES>::identity() - gain * jacobian;
        self.covariance = rest * self.covariance * rest.transpose() + gain * noise * gain.transpose();
        (Fusion::Fused, distance)
    }
}
