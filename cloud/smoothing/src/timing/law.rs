//! Time law. Speed and time between the samples of a path, with an acceleration that is linear in the arc length from sample to sample.
//!
//! With `x` the distance since the sample, `x'' = a + c x`: constant acceleration (`c = 0`) for the sweep's laws, else hyperbolic or
//! circular functions of the time. With `τ = tanh(√c t / 2) / √c` (`tan` for a negative `c`) all of them are rational: an interval of
//! length `L` from speed `v` to `w` ends at `τ = L / (v + w)`. From rest without acceleration the jerk is constant, `x = L (t / T)³`;
//! likewise into rest.

use super::path::GeometricPath;

/// Speeds at the samples of a path, accelerations on its intervals, and the resulting times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimeLaw {
    intervals: Vec<Interval>,
    /// Times at the samples, s.
    times: Vec<f64>,
}

/// Position and speed on an interval at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// The interval.
    pub index: usize,
    /// Distance since its first sample, m.
    pub distance: f64,
    /// Speed, m/s.
    pub v: f64,
    /// Acceleration, m/s².
    pub a: f64,
}

impl TimeLaw {
    /// Constant acceleration between samples, by the squared speeds (m²/s²) at them.
    ///
    /// # Panics
    /// With fewer speeds than the path has samples.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_smoothing::{GeometricPath, TimeLaw};
    ///
    /// // 0.5 m from rest to 1 m/s, and 0.5 m back to rest: 1 s each.
    /// let path = GeometricPath::straight(Point2::origin(), Point2::new(1.0, 0.0), 0.125).unwrap();
    /// let law = TimeLaw::steady(&path, &[0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0]);
    /// assert!((law.duration() - 2.0).abs() < 1e-9);
    /// let middle = law.at(0.5);
    /// assert!((middle.v - 0.5).abs() < 1e-9 && (middle.a - 1.0).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn steady(path: &GeometricPath, squared: &[f64]) -> Self {
        Self::of(path, squared, |i, length| {
            let a = (squared[i + 1] - squared[i]) / (2.0 * length);
            [a, a]
        })
    }

    /// Continuous acceleration: `accelerations` (m/s²) at the samples, with which `squared` (m²/s²) agrees.
    ///
    /// # Panics
    /// With fewer speeds or accelerations than the path has samples.
    #[must_use]
    pub fn continuous(path: &GeometricPath, squared: &[f64], accelerations: &[f64]) -> Self {
        Self::of(path, squared, |i, _| [accelerations[i], accelerations[i + 1]])
    }

    fn of(path: &GeometricPath, squared: &[f64], acceleration: impl Fn(usize, f64) -> [f64; 2]) -> Self {
        let mut times = Vec::with_capacity(squared.len());
        let mut t = 0.0;
        times.push(t);
        let mut intervals = Vec::with_capacity(squared.len());
        let mut before = squared[0].max(0.0).sqrt();
        for (i, pair) in path.points().windows(2).enumerate() {
            let after = squared[i + 1].max(0.0).sqrt();
            let length = pair[1].s - pair[0].s;
            let interval = Interval {
                length,
                speeds: [before, after],
                accelerations: acceleration(i, length),
            };
            t += interval.duration();
            times.push(t);
            intervals.push(interval);
            before = after;
        }
        Self { intervals, times }
    }

    /// Duration, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// Times at the samples, s.
    #[must_use]
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Squared speeds at the samples, m²/s².
    #[must_use]
    pub fn squared(&self) -> Vec<f64> {
        let first = self.intervals.iter().take(1).map(|interval| interval.speeds[0]);
        let rest = self.intervals.iter().map(|interval| interval.speeds[1]);
        first.chain(rest).map(|v| v * v).collect()
    }

    /// Progress at a time (s). Logarithmic in the samples.
    #[must_use]
    pub fn at(&self, t: f64) -> Progress {
        let after = self.times.partition_point(|begin| *begin <= t);
        let index = after.clamp(1, self.intervals.len().max(1)) - 1;
        self.on(index, t - self.times[index])
    }

    /// Progress at a time since the beginning of an interval (s).
    #[must_use]
    pub fn on(&self, index: usize, into: f64) -> Progress {
        let Some(interval) = self.intervals.get(index) else {
            return Progress::default();
        };
        let (distance, v, a) = interval.at(into);
        Progress { index, distance, v, a }
    }
}

/// Interval from one sample to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Interval {
    length: f64,
    speeds: [f64; 2],
    accelerations: [f64; 2],
}

impl Interval {
    /// `c`, 1/s².
    fn slope(&self) -> f64 {
        (self.accelerations[1] - self.accelerations[0]) / self.length
    }

    fn leaves_rest(&self) -> bool {
        self.speeds[0] == 0.0 && self.accelerations[0] == 0.0
    }

    fn comes_to_rest(&self) -> bool {
        self.speeds[1] == 0.0 && self.accelerations[1] == 0.0
    }

    fn duration(&self) -> f64 {
        if self.leaves_rest() || self.comes_to_rest() {
            return 3.0 * self.length / (self.speeds[0] + self.speeds[1]).max(1e-9);
        }
        let tau = self.length / (self.speeds[0] + self.speeds[1]).max(1e-9);
        let z = self.slope() * tau * tau;
        let stretch = if z.abs() < 1e-4 {
            1.0 + z * (1.0 / 3.0 + z * (0.2 + z / 7.0))
        } else if z > 0.0 {
            z.sqrt().min(1.0 - 1e-12).atanh() / z.sqrt()
        } else {
            (-z).sqrt().atan() / (-z).sqrt()
        };
        2.0 * tau * stretch
    }

    /// Distance, speed and acceleration at a time since the beginning.
    fn at(&self, t: f64) -> (f64, f64, f64) {
        let ([v0, v1], [a0, a1]) = (self.speeds, self.accelerations);
        if self.leaves_rest() || self.comes_to_rest() {
            let duration = self.duration();
            let share = (t / duration).clamp(0.0, 1.0);
            if self.leaves_rest() {
                return (self.length * share.powi(3), v1 * share * share, a1 * share);
            }
            let left = 1.0 - share;
            return (self.length * (1.0 - left.powi(3)), v0 * left * left, a0 * left);
        }
        let c = self.slope();
        let z = 0.25 * c * t * t;
        let tau = 0.5
            * t
            * if z.abs() < 1e-4 {
                1.0 - z * (1.0 / 3.0 - z * (2.0 / 15.0 - z * 17.0 / 315.0))
            } else if z > 0.0 {
                z.sqrt().tanh() / z.sqrt()
            } else {
                (-z).sqrt().tan() / (-z).sqrt()
            };
        let below = 1.0 - c * tau * tau;
        let distance = 2.0 * tau * (v0 + a0 * tau) / below;
        let v = (v0 * (2.0 - below) + 2.0 * a0 * tau) / below;
        (distance, v.max(0.0), a0 + c * distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Euler's method in small steps, against the closed form.
    fn assert_consistent(interval: &Interval) {
        let duration = interval.duration();
        let steps = 1000;
        let dt = duration / f64::from(steps);
        let (mut distance, mut v, _) = interval.at(0.0);
        assert!(distance.abs() < 1e-12 && (v - interval.speeds[0]).abs() < 1e-12);
        for i in 0..steps {
            let t = duration * f64::from(i) / f64::from(steps);
            let (_, middle_v, middle_a) = interval.at(t + 0.5 * dt);
            (distance, v) = (distance + middle_v * dt, v + middle_a * dt);
            let (x, speed, _) = interval.at(t + dt);
            assert!((x - distance).abs() < 1e-5 * interval.length && (speed - v).abs() < 1e-4 * v.max(0.01));
        }
        let (x, speed, a) = interval.at(duration);
        assert!(
            (x - interval.length).abs() < 1e-9 * interval.length,
            "{x} of {}",
            interval.length
        );
        assert!((speed - interval.speeds[1]).abs() < 1e-7 && (a - interval.accelerations[1]).abs() < 1e-6);
    }

    #[test]
    fn out_of_rest_and_into_it_the_jerk_is_constant() {
        // x = t³/6: after a second 1/6 m, 1/2 m/s, 1 m/s².
        let leaving = Interval {
            length: 1.0 / 6.0,
            speeds: [0.0, 0.5],
            accelerations: [0.0, 1.0],
        };
        assert!((leaving.duration() - 1.0).abs() < 1e-12);
        assert_consistent(&leaving);
        assert_consistent(&Interval {
            length: 1.0 / 6.0,
            speeds: [0.5, 0.0],
            accelerations: [-1.0, 0.0],
        });
    }

    proptest! {
        #[test]
        fn speed_and_way_are_integrals_of_the_acceleration(length in 0.005..0.5_f64, v in 0.0..1.0_f64, a0 in -2.0..2.0_f64, a1 in -2.0..2.0_f64) {
            let squared = v * v + (a0 + a1) * length;
            // Speed stays positive on the path.
            let least = (0..=50).map(|i| {
                let x = length * f64::from(i) / 50.0;
                v * v + 2.0 * a0 * x + (a1 - a0) / length * x * x
            }).fold(squared, f64::min);
            prop_assume!(least > 1e-4 || (v == 0.0 && a0 > 0.01 && squared > 1e-4));
            assert_consistent(&Interval { length, speeds: [v, squared.sqrt()], accelerations: [a0, a1] });
        }
    }
}
