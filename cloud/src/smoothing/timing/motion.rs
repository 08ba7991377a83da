//! Where is the robot at a time? A chain of stretches in time: braking along an arc, turning on the spot, following a way.

use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::TrajectoryPoint;

use super::law::{Progress, TimeLaw};
use super::limits::Limits;
use super::path::GeometricPath;
use super::profile::Profile;
use super::sweep::{SweepError, fastest};

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
        let point = TrajectoryPoint {
            t,
            x: pose.x,
            y: pose.y,
            yaw: pose.yaw,
            v: twist.v,
            w: twist.w,
        };
        Self { point, a, alpha }
    }
}

/// A motion in time, from time zero on.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    stretches: Vec<(f64, Stretch)>,
    duration: f64,
    length: f64,
}

#[derive(Clone, Debug)]
enum Stretch {
    /// Comes to rest along the arc that the robot is on: velocity is `twist` times the profile's, the profile's begins with one.
    Brake {
        start: Pose2,
        twist: Twist2,
        profile: Profile,
    },
    /// Turns on the spot, `sign` times the profile.
    Spin { start: Pose2, sign: f64, profile: Profile },
    /// Follows a way.
    Follow { path: GeometricPath, law: TimeLaw },
}

impl Motion {
    /// Nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Duration, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Way of the base, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Whether nothing moves.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.stretches.is_empty()
    }

    /// Comes to rest from a pose and velocity; returns where.
    pub fn brake(&mut self, start: Pose2, twist: Twist2, limits: &Limits) -> Pose2 {
        let surface_speed = limits.surface_speed(twist);
        if !(surface_speed.is_finite() && surface_speed > 1e-6 * limits.wheel_acceleration) {
            return start;
        }
        let profile = limits.braking(twist);
        let unit = Twist2::new(twist.v / surface_speed, twist.w / surface_speed);
        let end = start.advance(unit, profile.distance());
        self.length += unit.v.abs() * profile.distance();
        let duration = profile.duration();
        self.push(
            duration,
            Stretch::Brake {
                start,
                twist: unit,
                profile,
            },
        );
        end
    }

    /// Turns on the spot by an angle (rad, counter-clockwise), from rest to rest.
    pub fn spin(&mut self, start: Pose2, angle: f64, limits: &Limits) {
        if !angle.is_finite() || angle.abs() < 1e-9 {
            return;
        }
        let profile = Profile::rest_to_rest(angle.abs(), &limits.spin());
        let sign = angle.signum();
        self.push(profile.duration(), Stretch::Spin { start, sign, profile });
    }

    /// Follows a way as fast as the limits allow but for the jerk, from a speed (m/s) to rest.
    ///
    /// # Errors
    /// As [`fastest`].
    pub fn follow(&mut self, path: GeometricPath, start_speed: f64, limits: &Limits) -> Result<(), SweepError> {
        let squared = fastest(&path, limits, start_speed)?;
        let law = TimeLaw::steady(&path, &squared);
        self.length += path.length();
        self.push(law.duration(), Stretch::Follow { path, law });
        Ok(())
    }

    fn push(&mut self, duration: f64, stretch: Stretch) {
        self.stretches.push((self.duration, stretch));
        self.duration += duration;
    }

    /// The state at a time (s), held to the motion's ends. Logarithmic in the samples.
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
            // Every motion ends at rest, to the last bit.
            (state.point.v, state.point.w) = (0.0, 0.0);
        }
        state
    }

    /// States at most `period` seconds apart, the end included; empty when nothing moves.
    #[must_use]
    pub fn states(&self, period: f64) -> Vec<State> {
        if self.is_empty() {
            return Vec::new();
        }
        let steps = (self.duration / period).ceil().clamp(1.0, 1e6) as usize;
        (0..=steps)
            .map(|i| self.at(self.duration * i as f64 / steps as f64))
            .collect()
    }

    /// As [`Self::states`], as it goes over the wire.
    #[must_use]
    pub fn trajectory(&self, period: f64) -> Vec<TrajectoryPoint> {
        self.states(period).into_iter().map(|state| state.point).collect()
    }
}

impl Stretch {
    fn at(&self, t: f64) -> State {
        match self {
            Self::Brake { start, twist, profile } => {
                let (way, speed, a) = profile.at(t);
                let pose = start.advance(*twist, way);
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
                let Progress { index, way, v, a } = law.at(t);
                let point = path.between(index, way);
                let pose = Pose2 {
                    x: point.x,
                    y: point.y,
                    yaw: point.yaw,
                };
                let alpha = point.k * a + path.slope(index) * v * v;
                State::new(t, pose, Twist2::new(v, point.k * v), a, alpha)
            }
        }
    }
}
