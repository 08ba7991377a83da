//! Pose estimator. Where is the robot? Dead reckoning (`odom_from_base`, continuous) and its correction (`map_from_odom`), REP-105.
//!
//! Encoders and gyro predict; compass, GPS and corrections from off board update (`ekf`). An input counts at its own stamp, however late
//! and in whatever order it arrives, because everything after it is applied again (`measurement_buffer`): the pose in the map is a function
//! of the set of inputs. Odometry is continuous: neither a correction nor a late reading makes it jump.

mod ekf;
mod measurement_buffer;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Vector2};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{Correction, Gps, Imu};
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::history::PoseHistory;
use crate::settings::EstimatorSettings;
use ekf::{Ekf, Input, Reckoned};
use measurement_buffer::{Admission, MeasurementBuffer};

/// After this many readings in a row that are too late, the body's clock has restarted.
const ANOTHER_CLOCK_AFTER: u32 = 25;
/// The heading no longer comes from a gyro that has been silent for longer than this, s.
const GYRO_SILENT: f64 = 0.5;

/// A gyro measures no greater rate, rad/s: a common full scale is 2000 degrees a second. One reading far beyond it would leave the sum of all
/// turns without any precision for the next ones.
const FASTEST_TURN: f64 = 35.0;
/// A correction with a greater variance, m² or rad², tells nothing: the inverse of such a matrix overflows.
const MOST_VARIANCE: f64 = 1e6;

/// Slower than this is rest, m/s and rad/s: a filter alone would never get there.
const REST: f64 = 1e-6;

/// Counts of the inputs since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Pose measurements that were fused.
    pub fused: u64,
    /// Pose measurements rejected by their gate.
    pub outliers: u64,
    /// Inputs older than the buffer.
    pub too_late: u64,
    /// Inputs that arrived again.
    pub repeated: u64,
    /// Inputs that are not finite or beyond what can be measured, have no valid covariance, or are stamped in the future.
    pub broken: u64,
}

/// The pose filter.
#[derive(Clone, Debug)]
pub struct Estimator {
    model: RobotModel,
    settings: EstimatorSettings,
    start: Ekf,
    buffer: Option<MeasurementBuffer>,
    odom_from_base: Pose2,
    /// Dead reckoning that odometry already includes.
    reckoned: Reckoned,
    velocity: Twist2,
    history: PoseHistory,
    late_in_a_row: u32,
    tally: Tally,
    nis: [Option<f64>; 3],
    was_replaced: bool,
}

impl Estimator {
    /// A robot at rest at `start` in the map, known as well as the settings say.
    #[must_use]
    pub fn new(model: &RobotModel, start: Pose2, settings: &EstimatorSettings) -> Self {
        Self {
            model: model.clone(),
            settings: settings.clone(),
            start: Ekf::new(start, settings),
            buffer: None,
            odom_from_base: Pose2::IDENTITY,
            reckoned: Reckoned::default(),
            velocity: Twist2::ZERO,
            history: PoseHistory::default(),
            late_in_a_row: 0,
            tally: Tally::default(),
            nis: [None; 3],
            was_replaced: false,
        }
    }

    /// Takes one tick's readings and the pose measurements that were made off board for this boot. Cost: a few microseconds; a late input
    /// adds a replay of all inputs after it, a window's worth at most.
    ///
    /// ```
    /// # let tiago = zenav_fixtures::robot("tiago");
    /// use zenav_edge::{estimator::Estimator, settings::EstimatorSettings};
    /// use zenav_protocol::{geometry::Pose2, readings::Readings, time::Stamp};
    ///
    /// let mut estimator = Estimator::new(&tiago, Pose2::new(1.0, 2.0, 0.0), &EstimatorSettings::default());
    /// for tick in 0..=50 {
    ///     // Both wheels turn by 0.1 rad from one reading to the next.
    ///     let (stamp, wheels) = (Stamp::from_secs(0.02 * f64::from(tick)), [0.1 * f64::from(tick); 2]);
    ///     estimator.step(&Readings { wheels, ..Readings::new(stamp) }, []);
    /// }
    /// let way = 5.0 * tiago.drive.wheel_radius;
    /// assert!((estimator.odom_from_base().x - way).abs() < 1e-3 && (estimator.map_from_base().x - 1.0 - way).abs() < 1e-3);
    /// ```
    pub fn step<'a>(&mut self, readings: &Readings, corrections: impl IntoIterator<Item = &'a Correction>) {
        self.nis = [None; 3];
        let replaced_at = self.ekf().replaced_at();
        self.wheels(readings);
        if let Some(imu) = &readings.imu {
            self.imu(imu);
        }
        if let Some(gps) = &readings.gps {
            self.gps(gps);
        }
        for correction in corrections {
            self.correction(correction);
        }
        self.settle();
        self.was_replaced = self.ekf().replaced_at().is_some_and(|at| Some(at) != replaced_at);
    }

    /// Carries the estimate over to another map frame: odometry, and the estimate relative to the walls, stay as they are.
    pub fn moved(&mut self, new_from_old: Pose2) {
        self.start.moved(new_from_old);
        if let Some(buffer) = &mut self.buffer {
            buffer.moved(new_from_old);
        }
    }

    /// Pose in the map.
    #[must_use]
    pub fn map_from_base(&self) -> Pose2 {
        self.ekf().map_from_base()
    }

    /// Whether this tick's corrections moved the pose in the map by more than 0.3 m or 0.3 rad, against the estimate before or as it was found
    /// anew: the robot is somewhere else than it believed.
    #[must_use]
    pub fn was_replaced(&self) -> bool {
        self.was_replaced
    }

    /// The normalised innovation squared of this tick's measurements: compass (1 degree of freedom), GPS (2), correction (3).
    #[must_use]
    pub fn nis(&self) -> [Option<f64>; 3] {
        self.nis
    }

    /// Counts of the inputs.
    #[must_use]
    pub fn tally(&self) -> Tally {
        self.tally
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

    /// Standard deviation of the gyro's bias, rad/s; `None` if the heading does not come from the gyro.
    pub(crate) fn gyro_bias_std(&self) -> Option<f64> {
        let ekf = self.ekf();
        let age = ekf.time().secs_since(ekf.gyro_at()?);
        (age < GYRO_SILENT).then(|| ekf.gyro_bias_std())
    }

    /// Row-major covariance of (x, y, yaw): m², m rad, rad². Once corrections were fused, the error of the map at the robot's place is in it,
    /// too: fusing more of them there does not reduce it.
    #[must_use]
    pub fn covariance(&self) -> [f64; 9] {
        let mut covariance = self.ekf().covariance();
        if self.ekf().is_corrected() {
            let shared = self.settings.map_std.powi(2);
            covariance += Matrix3::from_diagonal(&[shared, shared, 0.0].into());
        }
        std::array::from_fn(|i| covariance[(i / 3, i % 3)])
    }

    fn ekf(&self) -> &Ekf {
        self.buffer.as_ref().map_or(&self.start, MeasurementBuffer::ekf)
    }

    /// Wheel angles. Without them the update waits for the next ones, which cover the gap, up to the encoder timeout.
    fn wheels(&mut self, readings: &Readings) {
        if !readings.wheels.iter().all(|angle| angle.is_finite()) {
            self.tally.broken += 1;
            let patient = |buffer: &MeasurementBuffer| {
                readings.stamp.secs_since(buffer.newest()) <= self.settings.encoder_timeout
            };
            if self.buffer.as_ref().is_none_or(patient) {
                return;
            }
        }
        if self.buffer.is_none() {
            self.buffer = Some(MeasurementBuffer::new(
                self.start.clone(),
                readings.stamp,
                readings.wheels,
            ));
            self.history.push(readings.stamp, self.odom_from_base);
        } else if self.admit(readings.stamp, Input::Wheels(readings.wheels)) == Some(Admission::TooLate) {
            self.late_in_a_row += 1;
            if self.late_in_a_row >= ANOTHER_CLOCK_AFTER {
                self.buffer = Some(MeasurementBuffer::new(
                    self.ekf().clone(),
                    readings.stamp,
                    readings.wheels,
                ));
                self.history = PoseHistory::default();
                self.history.push(readings.stamp, self.odom_from_base);
                self.late_in_a_row = 0;
            }
            return;
        }
        self.late_in_a_row = 0;
    }

    /// A gyro and compass reading.
    fn imu(&mut self, imu: &Imu) {
        if imu.yaw_rate.abs() > FASTEST_TURN {
            self.tally.broken += 1;
        } else {
            self.admit(imu.stamp, Input::Gyro(imu.yaw_rate));
        }
        if let Some(yaw) = imu.yaw.filter(|_| self.model.imu.compass_noise.is_some()) {
            self.admit(imu.stamp, Input::Compass(yaw));
        }
    }

    /// A position measurement.
    fn gps(&mut self, gps: &Gps) {
        if gps.std_dev < 0.0 {
            self.tally.broken += 1;
            return;
        }
        let variance = gps.std_dev * gps.std_dev;
        self.admit(gps.stamp, Input::Gps(Vector2::new(gps.x, gps.y), variance));
    }

    /// A pose measurement made off board.
    fn correction(&mut self, correction: &Correction) {
        let noise = Matrix3::from_row_slice(&correction.covariance);
        let is_measurable = noise.iter().all(|value| value.abs() <= MOST_VARIANCE);
        if !is_measurable || noise.cholesky().is_none() || (noise - noise.transpose()).norm() > 1e-9 * noise.norm() {
            self.tally.broken += 1;
            return;
        }
        let input = if correction.is_found_anew {
            Input::Found(correction.map_from_base, noise)
        } else {
            Input::Correction(correction.map_from_base, noise)
        };
        self.admit(correction.stamp, input);
    }

    fn admit(&mut self, stamp: Stamp, input: Input) -> Option<Admission> {
        let buffer = self.buffer.as_mut()?;
        if !input.is_finite() {
            self.tally.broken += 1;
            return None;
        }
        let admission = buffer.insert(stamp, input);
        match admission {
            Admission::Taken => {}
            Admission::Repeated => self.tally.repeated += 1,
            Admission::TooLate => self.tally.too_late += 1,
            Admission::Ahead => self.tally.broken += 1,
        }
        Some(admission)
    }

    /// Applies what was admitted, and advances odometry.
    fn settle(&mut self) {
        let Some(buffer) = &mut self.buffer else {
            return;
        };
        buffer.replay((&self.model, &self.settings), |compared| {
            self.nis[compared.sensor] = Some(compared.distance);
            *(if compared.fused {
                &mut self.tally.fused
            } else {
                &mut self.tally.outliers
            }) += 1;
        });
        let newest = buffer.newest();
        let ekf = buffer.ekf();
        let (now, then) = (ekf.reckoned(), self.reckoned);
        let Some(last) = self.history.newest().filter(|last| *last < newest) else {
            return;
        };
        self.reckoned = now;
        // The bias as it is known now: odometry that was integrated with earlier estimates stays as it is.
        let turn = now.turn - then.turn - ekf.gyro_bias() * (now.by_gyro - then.by_gyro);
        let way = now.way - then.way;
        self.odom_from_base = self.odom_from_base.advance(Twist2::new(way, turn), 1.0);
        self.history.push(newest, self.odom_from_base);
        let secs = newest.secs_since(last);
        let share = (secs / self.settings.velocity_smoothing).min(1.0);
        let smoothed = |was: f64, is: f64| {
            let smoothed = was + share * (is - was);
            if smoothed.abs() < REST { 0.0 } else { smoothed }
        };
        self.velocity = Twist2::new(
            smoothed(self.velocity.v, way / secs),
            smoothed(self.velocity.w, turn / secs),
        );
    }
}
