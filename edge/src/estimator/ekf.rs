//! Extended Kalman filter. What is the estimate at a moment, and how does one input change it? The states are the pose in the map, the
//! gyro's bias and the three systematic errors of a differential drive (Borenstein and Feng 1996): the radius of either wheel and their
//! separation.
//!
//! Sensor noise comes from the robot file, which states it as a data sheet does: encoder noise for each wheel, gyro noise for each reading,
//! quantisation noise. The slip of the wheels, the spread of the states at the start, their random walks, and that of the map that
//! corrections refer to, are settings. The errors of a simulated body are in the same file and are not read. Encoder steps are ignored,
//! because they do not add up. A constant error is a state, not noise, because it does not average out. Source: Bar-Shalom, Li,
//! Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, ch. 5 and 10; gates by the Mahalanobis distance.

use nalgebra::{Matrix2, Matrix3, RowSVector, SMatrix, SVector, Vector2, Vector3};
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::{GpsModel, RobotModel};
use zenav_protocol::time::Stamp;

use crate::settings::EstimatorSettings;

/// Gates at 99.9 % of the chi-square distribution for one, two and three dimensions.
const GATE: [f64; 3] = [10.83, 13.82, 16.27];
/// Least variance of a measurement, m² or rad².
const LEAST_VARIANCE: f64 = 1e-8;

/// Least standard deviation of the gyro's bias at the start, rad/s.
const LEAST_BIAS_STD: f64 = 1e-5;
/// Without readings the wheels come to rest within this time, s: a body stops them without commands.
const ROLLS_OUT: f64 = 1.0;
/// Turns known better than this are not compared, rad².
const LEAST_TURN_VARIANCE: f64 = 1e-16;

/// A robot that corrections move by more than this, m or rad, is somewhere else than it believed.
const ELSEWHERE: (f64, f64) = (0.3, 0.3);

/// Indices in the state after x, y and yaw.
const BIAS: usize = 3;
const LEFT: usize = 4;
const RIGHT: usize = 5;
const APART: usize = 6;
const STATES: usize = 7;

/// The robot model, and the tuning of the filter.
pub(super) type Known<'a> = (&'a RobotModel, &'a EstimatorSettings);

type State = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;

/// An input of a sensor, checked to be finite.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Input {
    /// Mean yaw rate since the gyro's reading before, rad/s.
    Gyro(f64),
    /// Angles of both wheels since start, rad; NaN where unknown.
    Wheels([f64; 2]),
    /// Heading, rad.
    Compass(f64),
    /// Position, m, and its variance, m².
    Gps(Vector2<f64>, f64),
    /// Pose, made off board, and its covariance.
    Correction(Pose2, Matrix3<f64>),
    /// Pose at which the robot was found anew, whatever the estimate before, and its covariance.
    Found(Pose2, Matrix3<f64>),
}

impl Input {
    /// Whether it is finite; wheel angles may be NaN.
    pub(super) fn is_finite(&self) -> bool {
        match self {
            Self::Gyro(value) | Self::Compass(value) => value.is_finite(),
            Self::Wheels(_) => true,
            Self::Gps(position, variance) => position.iter().chain([variance]).all(|value| value.is_finite()),
            Self::Correction(pose, noise) | Self::Found(pose, noise) => {
                pose.is_finite() && noise.iter().all(|value| value.is_finite())
            }
        }
    }

    /// The same in another map frame. GPS and compass do not depend on the map.
    pub(super) fn moved(&mut self, new_from_old: Pose2) {
        if let Self::Correction(pose, noise) | Self::Found(pose, noise) = self {
            *pose = new_from_old * *pose;
            let turn = turning(new_from_old.yaw);
            *noise = turn * *noise * turn.transpose();
        }
    }

    /// Order of inputs with one stamp: prediction before measurement.
    pub(super) fn rank(&self) -> u8 {
        match self {
            Self::Gyro(_) => 0,
            Self::Wheels(_) => 1,
            Self::Compass(_) => 2,
            Self::Gps(..) => 3,
            Self::Correction(..) => 4,
            Self::Found(..) => 5,
        }
    }
}

/// A pose measurement was compared with the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Compared {
    /// Index of the sensor: compass, GPS, correction.
    pub(super) sensor: usize,
    /// Normalised innovation squared.
    pub(super) distance: f64,
    /// Whether it passed the gate and was fused.
    pub(super) fused: bool,
}

/// Wheel and gyro readings that cover the interval to the next input.
#[derive(Clone, Copy, Debug)]
pub(super) struct OdometryInterval {
    /// Stamp and angles (rad) of the wheels' reading that ends the interval.
    pub(super) wheels: (Stamp, [f64; 2]),
    /// Stamp and mean rate (rad/s) of the gyro's reading that covers it.
    pub(super) gyro: Option<(Stamp, f64)>,
}

/// Dead reckoning since start, not corrected for gyro bias and wheel errors.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reckoned {
    /// Distance rolled, m.
    pub(super) way: f64,
    /// Angle turned, rad.
    pub(super) turn: f64,
    /// Time in which the turn came from the gyro, s.
    pub(super) by_gyro: f64,
}

/// What the wheels rolled in a step.
struct Rolled {
    /// Distance rolled by the left and the right wheel, m, without their errors, and its variance, m².
    sides: [f64; 2],
    variances: [f64; 2],
    /// Whether the encoders told it.
    is_known: bool,
}

/// How a step moves the base.
struct Step {
    /// Distance, m, and turn, rad.
    way: f64,
    turn: f64,
    /// Their derivatives by the state.
    way_by: RowSVector<f64, STATES>,
    turn_by: RowSVector<f64, STATES>,
    /// Derivative of the turn by the distance of the right wheel, rad/m; zero where the gyro gives the turn.
    wheel_turns: f64,
    /// Variance of the turn by the gyro's noise, rad².
    gyro_variance: f64,
    /// Sine and cosine of the heading at half the turn.
    sin: f64,
    cos: f64,
}

impl Step {
    /// Derivative of the pose by something, from the derivatives of distance and turn: along the heading at half the turn.
    fn spread(&self, way_by: f64, turn_by: f64) -> Vector3<f64> {
        let Self { way, sin, cos, .. } = *self;
        Vector3::new(
            cos * way_by - 0.5 * way * sin * turn_by,
            sin * way_by + 0.5 * way * cos * turn_by,
            turn_by,
        )
    }
}

/// Rotates the axes of a pose's covariance.
fn turning(yaw: f64) -> Matrix3<f64> {
    let (sin, cos) = yaw.sin_cos();
    Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
}

/// The state of the filter at one stamp.
#[derive(Clone, Debug)]
pub(super) struct Ekf {
    time: Stamp,
    state: State,
    covariance: Covariance,
    reckoned: Reckoned,
    wheels: (Stamp, [f64; 2]),
    /// Stamp and rate, rad/s, of the gyro's last reading.
    gyro: Option<(Stamp, f64)>,
    still: f64,
    stood_at: [f64; 2],
    rejected: [u32; 3],
    contradicting: Option<Contradicting>,
    /// Distance rolled since the last correction, forwards or backwards, m.
    uncorrected: f64,
    /// Whether a correction was fused or adopted.
    is_corrected: bool,
    /// Stamp at which corrections last moved the estimate to another place.
    replaced_at: Option<Stamp>,
}

/// Corrections in a row that contradict the estimate and agree with each other.
#[derive(Clone, Copy, Debug)]
struct Contradicting {
    /// The last one and its covariance, and what was estimated instead.
    pose: Pose2,
    noise: Matrix3<f64>,
    estimate: Pose2,
    count: u32,
}

impl Ekf {
    /// A robot that stands at `start` in the map.
    pub(super) fn new(start: Pose2, settings: &EstimatorSettings) -> Self {
        let std = State::from([
            settings.start_std,
            settings.start_std,
            settings.start_yaw_std,
            settings.bias_std.max(LEAST_BIAS_STD),
            settings.radius_std,
            settings.radius_std,
            settings.separation_std,
        ]);
        Self {
            time: Stamp::ZERO,
            state: State::from([start.x, start.y, start.yaw, 0.0, 0.0, 0.0, 0.0]),
            covariance: SMatrix::from_diagonal(&std.component_mul(&std)),
            reckoned: Reckoned::default(),
            wheels: (Stamp::ZERO, [0.0; 2]),
            gyro: None,
            still: 0.0,
            stood_at: [0.0; 2],
            rejected: [0; 3],
            contradicting: None,
            uncorrected: 0.0,
            is_corrected: false,
            replaced_at: None,
        }
    }

    /// The same estimate at rest at another time: the clock has restarted, or starts now.
    pub(super) fn begin(&mut self, stamp: Stamp, wheels: [f64; 2]) {
        (self.time, self.wheels, self.gyro) = (stamp, (stamp, wheels), None);
        (self.still, self.stood_at) = (0.0, wheels);
    }

    /// The same estimate in another map frame: nothing moves relative to the walls.
    pub(super) fn moved(&mut self, new_from_old: Pose2) {
        let moved = new_from_old * self.map_from_base();
        (self.state[0], self.state[1], self.state[2]) = (moved.x, moved.y, moved.yaw);
        let mut turn = Covariance::identity();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&turning(new_from_old.yaw));
        if let Some(last) = &mut self.contradicting {
            (last.pose, last.estimate) = (new_from_old * last.pose, new_from_old * last.estimate);
            let turn = turning(new_from_old.yaw);
            last.noise = turn * last.noise * turn.transpose();
        }
        self.covariance = turn * self.covariance * turn.transpose();
    }

    /// Stamp of the estimate.
    pub(super) fn time(&self) -> Stamp {
        self.time
    }

    /// Stamp of the wheels' last reading.
    pub(super) fn wheels_at(&self) -> Stamp {
        self.wheels.0
    }

    /// Stamp of the gyro's last reading.
    pub(super) fn gyro_at(&self) -> Option<Stamp> {
        self.gyro.map(|(stamp, _)| stamp)
    }

    /// Whether the pose refers to a map, by corrections.
    pub(super) fn is_corrected(&self) -> bool {
        self.is_corrected
    }

    /// Stamp at which corrections last moved the estimate to another place.
    pub(super) fn replaced_at(&self) -> Option<Stamp> {
        self.replaced_at
    }

    /// Pose in the map.
    pub(super) fn map_from_base(&self) -> Pose2 {
        Pose2::new(self.state[0], self.state[1], self.state[2])
    }

    /// Covariance of x, y and yaw.
    pub(super) fn covariance(&self) -> Matrix3<f64> {
        self.covariance.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// The gyro's bias, rad/s.
    pub(super) fn gyro_bias(&self) -> f64 {
        self.state[BIAS]
    }

    /// Its standard deviation, rad/s.
    pub(super) fn gyro_bias_std(&self) -> f64 {
        self.covariance[(BIAS, BIAS)].max(0.0).sqrt()
    }

    /// Dead reckoning.
    pub(super) fn reckoned(&self) -> Reckoned {
        self.reckoned
    }

    /// Predicts to an input's stamp, and applies it. `motion` is the motion since the last input.
    pub(super) fn take(
        &mut self,
        (model, settings): Known<'_>,
        stamp: Stamp,
        motion: &OdometryInterval,
        input: &Input,
    ) -> Option<Compared> {
        self.advance((model, settings), stamp, motion);
        match input {
            Input::Gyro(rate) => {
                self.gyro = Some((stamp, *rate));
                self.learn_bias_at_rest((model, settings), *rate);
                None
            }
            Input::Wheels(angles) => {
                self.rest(model, stamp.secs_since(self.wheels.0), *angles);
                self.wheels = (stamp, *angles);
                None
            }
            Input::Compass(yaw) => {
                let noise = model.imu.compass_noise?;
                let innovation = SVector::<f64, 1>::new(wrap_angle(yaw - self.state[2]));
                let mut jacobian = RowSVector::<f64, STATES>::zeros();
                jacobian[2] = 1.0;
                let noise = SMatrix::<f64, 1, 1>::new(noise * noise + LEAST_VARIANCE);
                Some(self.gated(settings, 0, innovation, jacobian, noise))
            }
            Input::Gps(position, variance) => {
                let steps = model.gps.as_ref().map_or(0.0, GpsModel::rounding);
                let innovation = position - self.state.fixed_rows::<2>(0);
                let jacobian = SMatrix::<f64, 2, STATES>::identity();
                let noise = Matrix2::identity() * (variance + steps + LEAST_VARIANCE);
                Some(self.gated(settings, 1, innovation, jacobian, noise))
            }
            Input::Correction(pose, noise) => {
                self.go_astray(settings);
                let innovation = Vector3::new(
                    pose.x - self.state[0],
                    pose.y - self.state[1],
                    wrap_angle(pose.yaw - self.state[2]),
                );
                let jacobian = SMatrix::<f64, 3, STATES>::identity();
                let mut compared = self.gated(settings, 2, innovation, jacobian, *noise);
                if !compared.fused && self.is_contradicted(settings, *pose, noise) {
                    let before = self.map_from_base();
                    self.doubt();
                    (compared.fused, _) = self.update(innovation, jacobian, *noise);
                    self.note_move(before);
                }
                if compared.fused {
                    (self.contradicting, self.is_corrected) = (None, true);
                }
                Some(compared)
            }
            Input::Found(pose, noise) => {
                self.adopt(*pose, noise);
                None
            }
        }
    }

    /// Predicts to a stamp within the interval that `motion` covers.
    fn advance(&mut self, (model, settings): Known<'_>, to: Stamp, motion: &OdometryInterval) {
        let secs = to.secs_since(self.time);
        let interval = motion.wheels.0.secs_since(self.wheels.0);
        if secs <= 0.0 || interval <= 0.0 {
            return;
        }
        self.time = to;
        let rolled = self.rolled((model, settings), motion.wheels.1, secs, interval);
        let step = self.step(model, &rolled, motion.gyro, secs);
        let moved = self.map_from_base().advance(Twist2::new(step.way, step.turn), 1.0);
        (self.state[0], self.state[1], self.state[2]) = (moved.x, moved.y, moved.yaw);
        self.widen(settings, &rolled, &step, secs);
        if motion.gyro.is_some() && rolled.is_known {
            self.compare_turns((model, settings), &rolled, &step, secs);
        }
    }

    /// What the wheels rolled in `secs` of an `interval` (s) that ends at these angles, rad.
    fn rolled(&self, (model, settings): Known<'_>, angles: [f64; 2], secs: f64, interval: f64) -> Rolled {
        let drive = &model.drive;
        let mut turns = [0, 1].map(|side: usize| angles[side] - self.wheels.1[side]);
        // A silent or reset encoder, or lost counts: no wheel turns at three times its limit, and in a pause of the readings none turns on.
        let limit = 3.0 * drive.max_wheel_speed * interval.min(ROLLS_OUT) + 0.1;
        let is_known = turns.iter().all(|turn| turn.abs() <= limit);
        if !is_known {
            turns = [0.0; 2];
        }
        // The part of the distance rolled, m, in this time; variances add up over the interval.
        let share = secs / interval;
        let variances = turns.map(|turn| {
            if !is_known {
                // It may have moved at its limit for about a second.
                return (drive.max_wheel_speed * drive.wheel_radius).powi(2) * secs;
            }
            let metres = turn * drive.wheel_radius;
            share * ((model.encoders.noise * metres).powi(2) + settings.slip * metres.abs())
        });
        Rolled {
            sides: turns.map(|turn| share * turn * drive.wheel_radius),
            variances,
            is_known,
        }
    }

    /// How far the base moves and turns, by its wheels and the gyro's reading that covers the time, and how that depends on the parameters;
    /// adds it to the dead reckoning.
    fn step(&mut self, model: &RobotModel, rolled: &Rolled, gyro: Option<(Stamp, f64)>, secs: f64) -> Step {
        let [left, right] = rolled.sides;
        let way = 0.5 * (left * (1.0 + self.state[LEFT]) + right * (1.0 + self.state[RIGHT]));
        let apart = self.apart(model);
        self.reckoned.way += 0.5 * (left + right);
        self.uncorrected += 0.5 * (left + right).abs();
        let mut way_by = RowSVector::<f64, STATES>::zeros();
        let mut turn_by = RowSVector::<f64, STATES>::zeros();
        (way_by[LEFT], way_by[RIGHT]) = (0.5 * left, 0.5 * right);
        let (turn, wheel_turns, gyro_variance) = match gyro {
            Some((until, rate)) => {
                // The error of one reading, as a random walk over the time that it covers.
                let span = self.gyro.map_or(secs, |(since, _)| until.secs_since(since));
                let noise = model.imu.gyro_noise.powi(2) + model.imu.resolution.powi(2) / 12.0;
                self.reckoned.turn += rate * secs;
                self.reckoned.by_gyro += secs;
                turn_by[BIAS] = -secs;
                ((rate - self.state[BIAS]) * secs, 0.0, noise * span * secs)
            }
            None => {
                let turn = self.turn_by_wheels(rolled, apart);
                self.reckoned.turn += (right - left) / model.drive.wheel_separation;
                (turn_by[LEFT], turn_by[RIGHT]) = (-left / apart, right / apart);
                turn_by[APART] = -turn / (1.0 + self.state[APART]);
                (turn, 1.0 / apart, 0.0)
            }
        };
        let (sin, cos) = (self.state[2] + 0.5 * turn).sin_cos();
        Step {
            way,
            turn,
            way_by,
            turn_by,
            wheel_turns,
            gyro_variance,
            sin,
            cos,
        }
    }

    /// Distance between the wheels by the estimate, m.
    fn apart(&self, model: &RobotModel) -> f64 {
        model.drive.wheel_separation * (1.0 + self.state[APART])
    }

    /// The turn that wheels this far apart (m) make, by the estimate of their radii, rad.
    fn turn_by_wheels(&self, rolled: &Rolled, apart: f64) -> f64 {
        let [left, right] = rolled.sides;
        (right * (1.0 + self.state[RIGHT]) - left * (1.0 + self.state[LEFT])) / apart
    }

    /// Carries the covariance along a step, and adds the noise of wheels and gyro and the random walk of the parameters.
    fn widen(&mut self, settings: &EstimatorSettings, rolled: &Rolled, step: &Step, secs: f64) {
        let Step { way, sin, cos, .. } = *step;
        let mut jacobian = Covariance::identity();
        (jacobian[(0, 2)], jacobian[(1, 2)]) = (-way * sin, way * cos);
        for parameter in [BIAS, LEFT, RIGHT, APART] {
            jacobian
                .fixed_view_mut::<3, 1>(0, parameter)
                .copy_from(&step.spread(step.way_by[parameter], step.turn_by[parameter]));
        }
        self.covariance = jacobian * self.covariance * jacobian.transpose();
        let (by_left, by_right) = (step.spread(0.5, -step.wheel_turns), step.spread(0.5, step.wheel_turns));
        let by_gyro = step.spread(0.0, 1.0);
        let sideways = Vector3::new(-sin, cos, 0.0);
        let variances = rolled.variances;
        let pose_noise = by_left * by_left.transpose() * variances[0]
            + by_right * by_right.transpose() * variances[1]
            + by_gyro * by_gyro.transpose() * step.gyro_variance
            + sideways * sideways.transpose() * (settings.sideways_share * 0.25 * (variances[0] + variances[1]));
        let mut pose = self.covariance.fixed_view_mut::<3, 3>(0, 0);
        pose += pose_noise;
        self.covariance[(BIAS, BIAS)] += settings.bias_walk * secs;
        for parameter in [LEFT, RIGHT, APART] {
            self.covariance[(parameter, parameter)] += settings.wheel_walk * secs;
        }
    }

    /// The prediction took the turn from the gyro; the wheels' turn over the same time is a measurement of it, and of the gyro's bias
    /// against the wheels' errors. Both noises are in the prediction too: the gain accounts for this correlation.
    fn compare_turns(&mut self, (model, settings): Known<'_>, rolled: &Rolled, step: &Step, secs: f64) {
        let [left, right] = rolled.sides;
        let apart = self.apart(model);
        let innovation = step.turn - self.turn_by_wheels(rolled, apart);
        // Encoder steps do not add up, but a single one must not look like slip. Between two steps of a robot that creeps, its wheels seem to
        // stand, and are known no better: only wheels that have stood for longer are at rest.
        let steps = if self.still > settings.still_after && left == 0.0 && right == 0.0 {
            0.0
        } else {
            (model.encoders.resolution * model.drive.wheel_radius).powi(2) / 6.0
        };
        let [by_left, by_right] = rolled.variances;
        let wheel_variance = (by_left + by_right + 2.0 * steps) / (apart * apart);
        let noise = step.gyro_variance + wheel_variance;
        // Linearised at the turn predicted from the gyro's previous reading, which is independent of the innovation's noise. Otherwise
        // noise would look like wheels that are too large and too far apart, or too small and too near (regression dilution).
        let rate_before = self.gyro.map_or(self.state[BIAS], |(_, rate)| rate);
        let foretold = (rate_before - self.state[BIAS]) * secs;
        let (way, aside) = (0.5 * (left + right), 0.5 * foretold * apart);
        // Derivative of the innovation by the state: gyro less wheels.
        let mut jacobian = SVector::<f64, STATES>::zeros();
        jacobian[BIAS] = -secs;
        (jacobian[LEFT], jacobian[RIGHT]) = ((way - aside) / apart, -(way + aside) / apart);
        jacobian[APART] = foretold / (1.0 + self.state[APART]);
        let mut shared = self.covariance * jacobian;
        let mut pose = shared.fixed_rows_mut::<3>(0);
        let (by_gyro, by_wheels) = (step.spread(0.0, 1.0), 0.5 * step.spread(1.0, 0.0));
        pose += by_gyro * step.gyro_variance + by_wheels * ((by_left - by_right) / apart);
        let variance = jacobian.dot(&(self.covariance * jacobian)) + noise;
        if variance < LEAST_TURN_VARIANCE || innovation * innovation > GATE[0] * variance {
            return;
        }
        let gain = shared / variance;
        self.state -= gain * innovation;
        self.state[2] = wrap_angle(self.state[2]);
        self.reckoned.turn -= gain[2] * innovation;
        self.covariance -= gain * shared.transpose();
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
    }

    /// The map that corrections refer to, even one made earlier, has errors that grow with the distance driven: they add up like odometry
    /// drift.
    fn go_astray(&mut self, settings: &EstimatorSettings) {
        let metres = std::mem::take(&mut self.uncorrected);
        let (walk, turn) = (settings.map_walk.powi(2), settings.map_turn_walk.powi(2));
        for (axis, variance) in [(0, walk), (1, walk), (2, turn)] {
            self.covariance[(axis, axis)] += metres * variance;
        }
    }

    /// Updates how long the wheels have been at rest.
    fn rest(&mut self, model: &RobotModel, secs: f64, wheels: [f64; 2]) {
        // Compared with the angles at which they came to rest: a slow creep is not rest.
        let flicker = 1.01 * model.encoders.resolution + 1e-9;
        let resting = wheels
            .iter()
            .zip(self.stood_at)
            .all(|(now, then)| (now - then).abs() <= flicker);
        if resting {
            self.still += secs;
        } else {
            (self.still, self.stood_at) = (0.0, wheels);
        }
    }

    /// A yaw rate measured while the wheels are at rest is the gyro's bias.
    fn learn_bias_at_rest(&mut self, (model, settings): Known<'_>, rate: f64) {
        if self.still > settings.still_after {
            let noise = SMatrix::<f64, 1, 1>::new((2.0 * model.imu.gyro_noise).powi(2) + 1e-6);
            let mut jacobian = RowSVector::<f64, STATES>::zeros();
            jacobian[BIAS] = 1.0;
            self.update(SVector::<f64, 1>::new(rate - self.state[BIAS]), jacobian, noise);
        }
    }

    /// Takes over a pose that is independent of everything that led to the old one.
    fn adopt(&mut self, pose: Pose2, noise: &Matrix3<f64>) {
        (self.state[0], self.state[1], self.state[2]) = (pose.x, pose.y, pose.yaw);
        self.covariance.fixed_rows_mut::<3>(0).fill(0.0);
        self.covariance.fixed_columns_mut::<3>(0).fill(0.0);
        self.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(noise);
        (self.rejected, self.contradicting, self.uncorrected) = ([0; 3], None, 0.0);
        (self.is_corrected, self.replaced_at) = (true, Some(self.time));
    }

    /// Notes that the gate rejected a correction. Whether so many in a row say the same that the estimate is taken to be wrong.
    fn is_contradicted(&mut self, settings: &EstimatorSettings, pose: Pose2, noise: &Matrix3<f64>) -> bool {
        let estimate = self.map_from_base();
        let before = self.contradicting.filter(|last| {
            // Where the robot is by the last one, and by its motion since.
            let expected = last.pose * (last.estimate.inverse() * estimate);
            let off = Vector3::new(
                pose.x - expected.x,
                pose.y - expected.y,
                wrap_angle(pose.yaw - expected.yaw),
            );
            let inverse = (noise + last.noise).try_inverse();
            inverse.is_some_and(|inverse| off.dot(&(inverse * off)) <= GATE[2])
        });
        let count = before.map_or(1, |last| last.count + 1);
        self.contradicting = Some(Contradicting {
            pose,
            noise: *noise,
            estimate,
            count,
        });
        count >= settings.contradicted_by
    }

    /// Notes how far a correction has moved the estimate.
    fn note_move(&mut self, before: Pose2) {
        let moved = before.inverse() * self.map_from_base();
        if moved.x.hypot(moved.y) > ELSEWHERE.0 || moved.yaw.abs() > ELSEWHERE.1 {
            self.replaced_at = Some(self.time);
        }
    }

    /// Doubts the pose: the next measurement counts almost alone.
    fn doubt(&mut self) {
        self.covariance += SMatrix::from_diagonal(&State::from([1.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0]));
    }

    /// Updates unless the gate rejects the measurement; after many rejections in a row the estimate itself is doubted.
    fn gated<const N: usize>(
        &mut self,
        settings: &EstimatorSettings,
        sensor: usize,
        innovation: SVector<f64, N>,
        jacobian: SMatrix<f64, N, STATES>,
        noise: SMatrix<f64, N, N>,
    ) -> Compared {
        let (fused, distance) = self.update(innovation, jacobian, noise);
        let rejected = &mut self.rejected[sensor];
        *rejected = if fused { 0 } else { *rejected + 1 };
        if *rejected >= settings.doubt_after {
            *rejected = 0;
            self.doubt();
        }
        Compared {
            sensor,
            distance,
            fused,
        }
    }

    /// Whether a measurement passed the gate and was fused, and its normalised innovation squared.
    fn update<const N: usize>(
        &mut self,
        innovation: SVector<f64, N>,
        jacobian: SMatrix<f64, N, STATES>,
        noise: SMatrix<f64, N, N>,
    ) -> (bool, f64) {
        let spread = jacobian * self.covariance * jacobian.transpose() + noise;
        let Some(inverse) = spread.try_inverse() else {
            return (false, f64::INFINITY);
        };
        let distance = (innovation.transpose() * inverse * innovation)[0];
        if !distance.is_finite() || distance > GATE[N - 1] {
            return (false, distance);
        }
        let gain = self.covariance * jacobian.transpose() * inverse;
        self.state += gain * innovation;
        self.state[2] = wrap_angle(self.state[2]);
        // Joseph's form stays symmetric and positive.
        let rest = Covariance::identity() - gain * jacobian;
        self.covariance = rest * self.covariance * rest.transpose() + gain * noise * gain.transpose();
        (true, distance)
    }
}
