//! Where is the robot at a time? A chain of stretches in time: braking along an arc, turning on the spot, following a way.

use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::TrajectoryPoint;

use super::limits::Limits;
use super::path::GeometricPath;
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

/// A motion in time, from time zero on.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    stretches: Vec<(f64, Stretch)>,
    duration: f64,
    length: f64,
}

#[derive(Clone, Debug)]
enum Stretch {
    /// Both wheels slow down evenly, along the arc that the robot is on.
    Brake { start: Pose2, twist: Twist2, duration: f64 },
    /// Turns on the spot: a trapezoid in the yaw rate.
    Spin {
        start: Pose2,
        angle: f64,
        rate: f64,
        acceleration: f64,
        duration: f64,
    },
    /// Follows a way; squared speeds and times at its samples.
    Follow {
        path: GeometricPath,
        squared: Vec<f64>,
        times: Vec<f64>,
    },
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
        let duration = limits.braking_time(twist);
        if !(duration.is_finite() && duration > 1e-6) {
            return start;
        }
        let end = start.advance(twist, 0.5 * duration);
        self.length += 0.5 * twist.v.abs() * duration;
        self.push(duration, Stretch::Brake { start, twist, duration });
        end
    }

    /// Turns on the spot by an angle (rad, counter-clockwise), from rest to rest.
    pub fn spin(&mut self, start: Pose2, angle: f64, limits: &Limits) {
        if !angle.is_finite() || angle.abs() < 1e-9 {
            return;
        }
        let acceleration = limits.spin_acceleration();
        let rate = limits.spin_rate().min((angle.abs() * acceleration).sqrt());
        let duration = angle.abs() / rate + rate / acceleration;
        self.push(
            duration,
            Stretch::Spin {
                start,
                angle,
                rate,
                acceleration,
                duration,
            },
        );
    }

    /// Follows a way as fast as the limits allow, from a speed (m/s) to rest.
    ///
    /// # Errors
    /// As [`fastest`].
    pub fn follow(&mut self, path: GeometricPath, start_speed: f64, limits: &Limits) -> Result<(), SweepError> {
        let squared = fastest(&path, limits, start_speed)?;
        let mut times = Vec::with_capacity(squared.len());
        let mut t = 0.0;
        times.push(t);
        for (pair, b) in path.points().windows(2).zip(squared.windows(2)) {
            t += 2.0 * (pair[1].s - pair[0].s) / (b[0].sqrt() + b[1].sqrt()).max(1e-9);
            times.push(t);
        }
        self.length += path.length();
        self.push(t, Stretch::Follow { path, squared, times });
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
            Self::Brake { start, twist, duration } => {
                let share = (1.0 - t / duration).max(0.0);
                let pose = start.advance(*twist, t * 0.5 * (1.0 + share));
                let point = TrajectoryPoint {
                    t,
                    x: pose.x,
                    y: pose.y,
                    yaw: pose.yaw,
                    v: twist.v * share,
                    w: twist.w * share,
                };
                State {
                    point,
                    a: -twist.v / duration,
                    alpha: -twist.w / duration,
                }
            }
            Self::Spin {
                start,
                angle,
                rate,
                acceleration,
                duration,
            } => {
                let ramp = rate / acceleration;
                let (turned, w, alpha) = if t < ramp {
                    (0.5 * acceleration * t * t, acceleration * t, *acceleration)
                } else if t <= duration - ramp {
                    (rate * (t - 0.5 * ramp), *rate, 0.0)
                } else {
                    let left = (duration - t).max(0.0);
                    (
                        angle.abs() - 0.5 * acceleration * left * left,
                        acceleration * left,
                        -acceleration,
                    )
                };
                let sign = angle.signum();
                let point = TrajectoryPoint {
                    t,
                    x: start.x,
                    y: start.y,
                    yaw: start.yaw + sign * turned,
                    v: 0.0,
                    w: sign * w,
                };
                State {
                    point,
                    a: 0.0,
                    alpha: sign * alpha,
                }
            }
            Self::Follow { path, squared, times } => {
                let index = times.partition_point(|begin| *begin <= t).clamp(1, times.len() - 1) - 1;
                let (from, to) = (&path.points()[index], &path.points()[index + 1]);
                let length = to.s - from.s;
                let a = (squared[index + 1] - squared[index]) / (2.0 * length);
                let into = t - times[index];
                let speed = squared[index].sqrt();
                let point = path.between(index, into * (speed + 0.5 * a * into));
                let v = (speed + a * into).max(0.0);
                let slope = (to.k - from.k) / length;
                State {
                    point: TrajectoryPoint {
                        t,
                        x: point.x,
                        y: point.y,
                        yaw: point.yaw,
                        v,
                        w: point.k * v,
                    },
                    a,
                    alpha: point.k * a + slope * v * v,
                }
            }
        }
    }
}
