//! Piecewise trajectory. The robot's state at a time, from a chain of stretches: braking along an arc, turning on the spot, following a
//! path.

use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::SolverFigures;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};

use super::jerk::{self, JerkError};
use super::law::{Progress, TimeLaw};
use super::limits::Limits;
use super::path::GeometricPath;
use super::profile::Profile;
use super::sweep::{SweepError, fastest};

/// Where a piece's rates are taken, as shares of its time: at its ends (slightly inside, since an end belongs to two pieces) and in the
/// middle.
const SHARES: [f64; 3] = [1e-9, 0.5, 1.0 - 1e-9];

/// Pose, velocity and acceleration at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Pose and velocity.
    pub point: TrajectoryPoint,
    /// Forward acceleration, m/s².
    pub a: f64,
    /// Yaw acceleration, rad/s².
    pub alpha: f64,
}

impl State {
    fn new(t: f64, pose: Pose2, twist: Twist2, a: f64, alpha: f64) -> Self {
        Self {
            point: TrajectoryPoint::new(t, pose, twist),
            a,
            alpha,
        }
    }

    /// The same motion as that of a robot whose front is this one's rear: forwards becomes backwards.
    ///
    /// ```
    /// use zenav_protocol::geometry::{Pose2, Twist2};
    /// use zenav_protocol::trajectory::TrajectoryPoint;
    /// use zenav_smoothing::State;
    ///
    /// // Along x, faster and faster, in a bend to the left.
    /// let point = TrajectoryPoint::new(1.5, Pose2::IDENTITY, Twist2::new(0.4, 0.2));
    /// let turned = State { point, a: 0.3, alpha: 0.1 }.turned();
    /// assert!((turned.point.yaw.abs() - std::f64::consts::PI).abs() < 1e-12);
    /// assert_eq!((turned.point.v, turned.point.w, turned.a, turned.alpha), (-0.4, 0.2, -0.3, 0.1));
    /// ```
    #[must_use]
    pub fn turned(self) -> Self {
        let Self { point, a, alpha } = self;
        // A difference, because the opposite of zero would print as -0.
        let twist = Twist2::new(0.0 - point.v, point.w);
        Self::new(point.t, point.pose().turned(), twist, 0.0 - a, alpha)
    }
}

/// Velocity and acceleration at a time, without the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rates {
    /// Time, s.
    pub t: f64,
    /// Velocity.
    pub twist: Twist2,
    /// Forward acceleration, m/s².
    pub a: f64,
    /// Yaw acceleration, rad/s².
    pub alpha: f64,
}

/// A trajectory in time, from time zero on.
#[derive(Clone, Debug, Default)]
pub struct PiecewiseTrajectory {
    stretches: Vec<(f64, Stretch)>,
    duration: f64,
    length: f64,
    lower_bound: f64,
}

#[derive(Clone, Debug)]
enum Stretch {
    /// Comes to rest along the robot's present arc: the velocity is `twist` (per unit of the faster wheel's speed) times the profile's
    /// speed.
    Brake {
        start: Pose2,
        twist: Twist2,
        profile: Profile,
    },
    /// Turns on the spot, `sign` times the profile.
    Spin { start: Pose2, sign: f64, profile: Profile },
    /// Follows a path by its time law.
    Follow { path: GeometricPath, law: TimeLaw },
}

impl PiecewiseTrajectory {
    /// Without any motion.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Duration, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Distance driven by the base, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Shortest duration of the same turns and paths by the exact sweep, without the jerk limit, s.
    #[must_use]
    pub fn lower_bound(&self) -> f64 {
        self.lower_bound
    }

    /// Whether nothing moves.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.stretches.is_empty()
    }

    /// Brakes to rest from a pose and velocity; returns the final pose.
    ///
    /// ```
    /// use zenav_protocol::geometry::{Pose2, Twist2};
    /// use zenav_smoothing::{Limits, PiecewiseTrajectory};
    ///
    /// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.5, lateral_acceleration: 0.5,
    /// #     yaw_rate: 2.5, jerk: None };
    /// // From 0.45 m/s with 0.75 m/s².
    /// let mut trajectory = PiecewiseTrajectory::new();
    /// let end = trajectory.brake(Pose2::IDENTITY, Twist2::new(0.45, 0.0), &limits);
    /// assert!((end.x - 0.45 * 0.45 / 1.5).abs() < 1e-9 && (trajectory.duration() - 0.6).abs() < 1e-9);
    /// ```
    pub fn brake(&mut self, start: Pose2, twist: Twist2, limits: &Limits) -> Pose2 {
        let surface_speed = limits.surface_speed(twist);
        if !(surface_speed.is_finite() && surface_speed > 1e-6 * limits.wheel_acceleration) {
            return start;
        }
        let profile = limits.braking(twist);
        let unit = Twist2::new(twist.v / surface_speed, twist.w / surface_speed);
        let end = start.advance(unit, profile.distance());
        self.length += unit.v.abs() * profile.distance();
        self.lower_bound += limits.without_jerk().braking_time(twist);
        self.append(Stretch::Brake {
            start,
            twist: unit,
            profile,
        });
        end
    }

    /// Turns on the spot by an angle (rad, counter-clockwise), from rest to rest.
    ///
    /// ```
    /// use std::f64::consts::FRAC_PI_2;
    /// use zenav_protocol::geometry::Pose2;
    /// use zenav_smoothing::{Limits, PiecewiseTrajectory};
    ///
    /// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.5, lateral_acceleration: 0.5,
    /// #     yaw_rate: 2.5, jerk: None };
    /// let mut trajectory = PiecewiseTrajectory::new();
    /// trajectory.spin(Pose2::IDENTITY, -FRAC_PI_2, &limits);
    /// let end = trajectory.at(trajectory.duration()).point;
    /// assert!((end.yaw + FRAC_PI_2).abs() < 1e-9 && trajectory.length() == 0.0);
    /// ```
    pub fn spin(&mut self, start: Pose2, angle: f64, limits: &Limits) {
        if !angle.is_finite() || angle.abs() < 1e-9 {
            return;
        }
        let profile = Profile::rest_to_rest(angle.abs(), &limits.spin());
        let sign = angle.signum();
        self.lower_bound += Profile::rest_to_rest(angle.abs(), &limits.without_jerk().spin()).duration();
        self.append(Stretch::Spin { start, sign, profile });
    }

    /// Follows a path from a speed (m/s) to rest, as fast as all limits except the jerk allow.
    ///
    /// # Errors
    /// As [`fastest`].
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_smoothing::{GeometricPath, Limits, PiecewiseTrajectory};
    ///
    /// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.5, lateral_acceleration: 0.5,
    /// #     yaw_rate: 2.5, jerk: None };
    /// let path = GeometricPath::straight(Point2::new(1.0, 1.0), Point2::new(1.0, 3.0), 0.02).unwrap();
    /// let mut trajectory = PiecewiseTrajectory::new();
    /// trajectory.follow(path.clone(), 0.0, &limits)?;
    /// let end = trajectory.at(trajectory.duration()).point;
    /// assert!((end.position() - Point2::new(1.0, 3.0)).norm() < 1e-6 && end.v == 0.0);
    /// assert!(trajectory.follow(path, 0.9, &limits).is_err(), "the limit is 0.5 m/s");
    /// # Ok::<(), zenav_smoothing::SweepError>(())
    /// ```
    pub fn follow(&mut self, path: GeometricPath, start_speed: f64, limits: &Limits) -> Result<(), SweepError> {
        let squared = fastest(&path, limits, start_speed)?;
        let law = TimeLaw::steady(&path, &squared);
        self.length += path.length();
        self.lower_bound += law.duration();
        self.append(Stretch::Follow { path, law });
        Ok(())
    }

    /// The same trajectory with the jerk limit of `limits`, and the solver's figures; a path without such a law keeps the sweep's.
    /// Without a jerk limit nothing changes, and there are no figures.
    #[must_use]
    pub fn with_limited_jerk(self, limits: &Limits) -> (Self, Option<JerkFigures>) {
        let Some(jerk) = limits.jerk else {
            return (self, None);
        };
        let mut figures = JerkFigures::default();
        let mut trajectory = Self::new();
        (trajectory.length, trajectory.lower_bound) = (self.length, self.lower_bound);
        for (_, mut stretch) in self.stretches {
            if let Stretch::Follow { path, law } = &mut stretch {
                match jerk::limited(path, limits, jerk, &law.squared()) {
                    Ok(limited) => {
                        *law = limited.law;
                        figures.solver.iterations += limited.iterations;
                        figures.solver.gap = figures.solver.gap.max(limited.gap);
                        figures.solver.status = limited.status;
                    }
                    Err(error) => figures.failed = Some(error),
                }
            }
            trajectory.append(stretch);
        }
        if let Some(error) = &figures.failed {
            figures.solver.status = error.to_string();
        }
        (trajectory, Some(figures))
    }

    /// The same turns and paths under other limits; braking stays as it is. `None` if they do not allow the speed at a path's start.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_smoothing::{GeometricPath, Limits, PiecewiseTrajectory};
    /// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.5, lateral_acceleration: 0.5,
    /// #     yaw_rate: 2.5, jerk: None };
    /// # let path = GeometricPath::straight(Point2::origin(), Point2::new(2.0, 0.0), 0.02).unwrap();
    /// # let mut trajectory = PiecewiseTrajectory::new();
    /// # trajectory.follow(path, 0.0, &limits)?;
    /// // 2 m straight on, at 0.5 m/s and now at 0.25 m/s.
    /// let slow = trajectory.retimed(&Limits { speed: 0.25, ..limits }).unwrap();
    /// assert!((slow.duration() - (2.0 / 0.25 + 0.25 / 0.75)).abs() < 0.05);
    /// assert!(slow.length() == trajectory.length() && slow.lower_bound() == trajectory.duration());
    /// # Ok::<(), zenav_smoothing::SweepError>(())
    /// ```
    #[must_use]
    pub fn retimed(&self, limits: &Limits) -> Option<Self> {
        let mut trajectory = Self::new();
        (trajectory.length, trajectory.lower_bound) = (self.length, self.lower_bound);
        for (_, stretch) in &self.stretches {
            let stretch = match stretch {
                Stretch::Brake { .. } => stretch.clone(),
                Stretch::Spin { start, sign, profile } => Stretch::Spin {
                    start: *start,
                    sign: *sign,
                    profile: Profile::rest_to_rest(profile.distance(), &limits.spin()),
                },
                Stretch::Follow { path, law } => {
                    let begins = law.squared().first().copied().unwrap_or(0.0);
                    let squared = fastest(path, limits, begins.sqrt()).ok()?;
                    if squared[0] < begins - 1e-9 {
                        return None;
                    }
                    let law = TimeLaw::steady(path, &squared);
                    Stretch::Follow {
                        path: path.clone(),
                        law,
                    }
                }
            };
            trajectory.append(stretch);
        }
        Some(trajectory)
    }

    /// Energy that it draws from a robot's battery, J: Simpson's rule on every piece.
    #[must_use]
    pub fn energy(&self, model: &RobotModel) -> f64 {
        let power = |rates: &Rates| {
            let wheels = |twist| model.drive.wheels(twist);
            model.power(wheels(rates.twist), wheels(Twist2::new(rates.a, rates.alpha)))
        };
        let rates = self.rates();
        let pieces = rates.chunks_exact(SHARES.len()).map(|piece| match piece {
            [begin, middle, end] => (end.t - begin.t) / 6.0 * (power(begin) + 4.0 * power(middle) + power(end)),
            _ => 0.0,
        });
        pieces.sum()
    }

    fn append(&mut self, stretch: Stretch) {
        let duration = stretch.duration();
        self.stretches.push((self.duration, stretch));
        self.duration += duration;
    }

    /// The state at a time (s), clamped to the trajectory's ends. Logarithmic in the samples.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_smoothing::{GeometricPath, Limits, PiecewiseTrajectory};
    /// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.5, lateral_acceleration: 0.5,
    /// #     yaw_rate: 2.5, jerk: None };
    /// # let path = GeometricPath::straight(Point2::origin(), Point2::new(2.0, 0.0), 0.02).unwrap();
    /// # let mut trajectory = PiecewiseTrajectory::new();
    /// # trajectory.follow(path, 0.0, &limits)?;
    /// // 2 m straight on, from rest with 0.75 m/s²: after 0.4 s it has driven 0.06 m.
    /// let state = trajectory.at(0.4);
    /// assert!((state.point.x - 0.06).abs() < 1e-9 && (state.point.v - 0.3).abs() < 1e-9 && (state.a - 0.75).abs() < 1e-9);
    /// assert_eq!(trajectory.at(1e9).point.v, 0.0);
    /// # Ok::<(), zenav_smoothing::SweepError>(())
    /// ```
    #[must_use]
    pub fn at(&self, t: f64) -> State {
        let t = t.clamp(0.0, self.duration);
        let index = self
            .stretches
            .partition_point(|(begin, _)| *begin <= t)
            .saturating_sub(1);
        let Some((begin, stretch)) = self.stretches.get(index) else {
            return State::default();
        };
        let mut state = stretch.at(t - begin);
        state.point.t = t;
        state.point.yaw = wrap_angle(state.point.yaw);
        if t >= self.duration {
            // Every trajectory ends at rest, to the last bit.
            (state.point.v, state.point.w) = (0.0, 0.0);
        }
        state
    }

    /// States at most `period` seconds apart, the end included; empty if nothing moves.
    #[must_use]
    pub fn states(&self, period: f64) -> Vec<State> {
        if self.is_empty() {
            return Vec::new();
        }
        // A period that is not a number leaves the two ends.
        let steps = ((self.duration / period).ceil().clamp(1.0, 1e6) as usize).max(1);
        (0..=steps)
            .map(|i| self.at(self.duration * i as f64 / steps as f64))
            .collect()
    }

    /// Rates at the ends and in the middle of every smooth piece; where two pieces meet, those of both.
    #[must_use]
    pub fn rates(&self) -> Vec<Rates> {
        let mut rates = Vec::new();
        for (begin, stretch) in &self.stretches {
            stretch.rates(*begin, &mut rates);
        }
        rates
    }

    /// Like [`Self::states`], as sent over the wire.
    #[must_use]
    pub fn sampled(&self, period: f64) -> Trajectory {
        self.states(period).into_iter().map(|state| state.point).collect()
    }
}

/// Figures of limiting the jerk.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JerkFigures {
    /// The solver's figures.
    pub solver: SolverFigures,
    /// Why a path kept the sweep's law, if one did.
    pub failed: Option<JerkError>,
}

impl Stretch {
    fn duration(&self) -> f64 {
        match self {
            Self::Brake { profile, .. } | Self::Spin { profile, .. } => profile.duration(),
            Self::Follow { law, .. } => law.duration(),
        }
    }

    /// Appends the rates of every piece: at its ends, and in the middle.
    fn rates(&self, begin: f64, rates: &mut Vec<Rates>) {
        let (times, piece): (Vec<f64>, _) = match self {
            Self::Brake { profile, .. } | Self::Spin { profile, .. } => {
                (profile.breaks().chain([profile.duration()]).collect(), None)
            }
            Self::Follow { path, law } => (law.times().to_vec(), Some((path, law))),
        };
        for (index, pair) in times.windows(2).enumerate() {
            let length = pair[1] - pair[0];
            for share in SHARES {
                let into = share * length;
                let t = begin + pair[0] + into;
                rates.push(match piece {
                    Some((path, law)) => {
                        let Progress { distance, v, a, .. } = law.on(index, into);
                        let slope = path.slope(index);
                        let k = path.points()[index].k + slope * distance;
                        Rates {
                            t,
                            twist: Twist2::new(v, k * v),
                            a,
                            alpha: k * a + slope * v * v,
                        }
                    }
                    None => {
                        let State { point, a, alpha } = self.at(pair[0] + into);
                        Rates {
                            t,
                            twist: point.twist(),
                            a,
                            alpha,
                        }
                    }
                });
            }
        }
    }

    fn at(&self, t: f64) -> State {
        match self {
            Self::Brake { start, twist, profile } => {
                let (distance, speed, a) = profile.at(t);
                let pose = start.advance(*twist, distance);
                State::new(
                    t,
                    pose,
                    Twist2::new(twist.v * speed, twist.w * speed),
                    twist.v * a,
                    twist.w * a,
                )
            }
            Self::Spin { start, sign, profile } => {
                let (turned, w, alpha) = profile.at(t);
                let pose = Pose2 {
                    yaw: start.yaw + sign * turned,
                    ..*start
                };
                State::new(t, pose, Twist2::new(0.0, sign * w), 0.0, sign * alpha)
            }
            Self::Follow { path, law } => {
                let Progress { index, distance, v, a } = law.at(t);
                let point = path.between(index, distance);
                let alpha = point.k * a + path.slope(index) * v * v;
                State::new(t, point.pose(), Twist2::new(v, point.k * v), a, alpha)
            }
        }
    }
}
