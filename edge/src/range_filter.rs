//! Range filter. Where is a surface, given the noise of single beams?
//!
//! Along a straight wall the inverse range is a sinusoid of the beam's angle. Each return is replaced by the value of the sinusoid through
//! its neighbours if their inverse ranges lie on one to within the lidar's noise; at the end of a wall the neighbours on one side suffice.
//! Objects thinner than a run of beams, and every step larger than the noise, stay as measured.
//!
//! A line instead of the sinusoid would put a wall at the edge of the view nearer than the same wall in its middle, by a quarter of a
//! percent: enough to turn a map.
//!
//! Sources: Savitzky and Golay, "Smoothing and differentiation of data by simplified least squares procedures", Analytical Chemistry 1964;
//! the choice among windows after Nagao and Matsuyama, "Edge preserving smoothing", CGIP 1979.

use crate::range_noise::RangeNoise;

/// Angle to either side of a beam within which neighbours are used, rad.
const REACH: f64 = 0.07;
/// Most beams on either side.
const MOST: usize = 12;
/// Largest change of a range, in standard deviations.
const LARGEST_CHANGE: f64 = 2.5;
/// Largest residual of a wall that counts as noise, in its own standard deviations: noise exceeds it in one window of a hundred.
const LARGEST_RESIDUAL: f64 = 2.5;
/// Ranges beyond this are not filtered, m: near obstacles matter, and far away a run of beams spans more than one object.
const FARTHEST: f64 = 5.0;

/// Filters the sweeps of one lidar.
#[derive(Clone, Debug)]
pub(crate) struct RangeFilter {
    noise: RangeNoise,
    /// Angle between beams, rad.
    increment: f64,
    /// Beams on either side.
    half: usize,
    /// Cosine and sine of every half increment from the first beam on.
    directions: Vec<(f64, f64)>,
    /// Sums over the beams before each one: the number without a return, the inverse range times the cosine and times the sine of the
    /// beam's angle, and the square of the inverse range.
    sums: Vec<[f64; 4]>,
    ranges: Vec<f32>,
}

impl RangeFilter {
    /// For a lidar whose beams are `increment` rad apart, and whose ranges have the noise `expected` (m) as far as is known.
    pub(crate) fn new(increment: f64, expected: f64) -> Self {
        let increment = increment.abs().max(1e-6);
        Self {
            noise: RangeNoise::new(expected),
            increment,
            half: ((REACH / increment) as usize).min(MOST),
            directions: Vec::new(),
            sums: Vec::new(),
            ranges: Vec::new(),
        }
    }

    /// Filters a sweep of ranges (m); `is_return` tells which of them are returns.
    pub(crate) fn update(&mut self, ranges: &[f32], is_return: impl Fn(f64) -> bool) {
        let is_near = |range: f64| is_return(range) && range < FARTHEST;
        let std_dev = self.noise.update(ranges, is_near);
        let half_steps = self.directions.len()..2 * ranges.len();
        let turned = half_steps.map(|step| (0.5 * self.increment * step as f64).sin_cos());
        self.directions.extend(turned.map(|(sin, cos)| (cos, sin)));
        self.sums.clear();
        let mut sums = [0.0; 4];
        self.sums.push(sums);
        for (range, (cos, sin)) in ranges.iter().zip(self.directions.iter().step_by(2)) {
            let range = f64::from(*range);
            if is_near(range) && range > 0.0 {
                let inverse = range.recip();
                sums[1] += inverse * cos;
                sums[2] += inverse * sin;
                sums[3] += inverse * inverse;
            } else {
                sums[0] += 1.0;
            }
            self.sums.push(sums);
        }
        let half = self.half;
        // Number of beams before and after, the least noise first.
        let windows = [
            [half, half],
            [half / 2, 2 * half - half / 2],
            [2 * half - half / 2, half / 2],
            [half / 2, half / 2],
            [0, 2 * half],
            [2 * half, 0],
            [0, half],
            [half, 0],
        ];
        self.ranges.clear();
        for (beam, range) in ranges.iter().enumerate() {
            let measured = f64::from(*range);
            let most = LARGEST_CHANGE * std_dev;
            let smooth = || {
                let walls = windows.iter().filter_map(|[before, after]| {
                    let (first, last) = (beam.checked_sub(*before)?, beam + after);
                    self.wall(first, last, beam, std_dev)
                });
                walls.into_iter().find(|smooth| (smooth - measured).abs() <= most)
            };
            let kept = if is_near(measured) { smooth() } else { None };
            self.ranges.push(kept.map_or(*range, |smooth| smooth as f32));
        }
    }

    /// The last filtered sweep, m; a beam without a return is unchanged.
    pub(crate) fn ranges(&self) -> &[f32] {
        &self.ranges
    }

    /// The range of a beam on the straight wall that the beams `first` to `last` met, if they met one.
    fn wall(&self, first: usize, last: usize, beam: usize, std_dev: f64) -> Option<f64> {
        let (from, to) = (self.sums.get(first)?, self.sums.get(last + 1)?);
        let count = (last + 1 - first) as f64;
        if to[0] > from[0] || count < 4.0 {
            return None;
        }
        let [with_cos, with_sin, squares] = [1, 2, 3].map(|i| to[i] - from[i]);
        // About the middle of the window cosine and sine are orthogonal.
        let (cos, sin) = self.directions.get(first + last)?;
        let [even, odd] = [cos * with_cos + sin * with_sin, cos * with_sin - sin * with_cos];
        let ripple = (count * self.increment).sin() / self.increment.sin();
        let [of_cos, of_sin] = [0.5 * (count + ripple), 0.5 * (count - ripple)];
        let (level, slope) = (even / of_cos, odd / of_sin);
        let residual = (squares - level * even - slope * odd).max(0.0);
        // The noise of an inverse range is the range's noise over the square of the range; the limit is on the chi-square of the residual.
        let (freedom, noise) = (count - 2.0, std_dev * level * level);
        let most = freedom + LARGEST_RESIDUAL * (2.0 * freedom).sqrt();
        let (sin, cos) = ((beam as f64 - 0.5 * (first + last) as f64) * self.increment).sin_cos();
        let value = level * cos + slope * sin;
        (residual <= most * noise * noise && value > 0.0).then(|| value.recip())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall at 0.4 m to the left that ends ahead, a leg of one beam before it, nothing beyond; noise of 1 cm.
    fn sweep(seed: u64) -> (Vec<f32>, Vec<f64>) {
        // A linear congruential generator (Knuth): uniform from 0 to 1.
        let mut state = seed;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / f64::from(1 << 24)
        };
        let truth: Vec<f64> = (0..360)
            .map(|beam| match beam {
                100 => 0.2,
                60..=160 => 0.4 / (f64::from(beam) * std::f64::consts::TAU / 360.0).sin(),
                _ => f64::INFINITY,
            })
            .collect();
        let mut noise = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        let measured = truth.iter().map(|range| (range + 0.01 * noise()) as f32).collect();
        (measured, truth)
    }

    #[test]
    fn a_wall_loses_most_of_its_noise_and_a_leg_before_it_stays_where_it_is() {
        let mut filter = RangeFilter::new(std::f64::consts::TAU / 360.0, 0.01);
        let mut squares = [0.0; 2];
        for seed in 1..50 {
            let (measured, truth) = sweep(seed);
            filter.update(&measured, |range| range < 10.0);
            for (beam, truth) in truth.iter().enumerate().filter(|(_, truth)| truth.is_finite()) {
                let (before, after) = (f64::from(measured[beam]), f64::from(filter.ranges()[beam]));
                assert!((after - before).abs() <= 0.03, "{before} became {after}");
                squares[0] += (before - truth).powi(2);
                squares[1] += (after - truth).powi(2);
            }
            assert_eq!(filter.ranges()[100], measured[100]);
            assert_eq!(filter.ranges()[0], f32::INFINITY);
        }
        assert!(squares[1] < 0.3 * squares[0], "{squares:?}");
    }

    #[test]
    fn a_wall_is_where_it_is_all_along_to_its_ends_and_to_the_end_of_the_view() {
        let increment = 0.0058;
        let mut filter = RangeFilter::new(increment, 0.01);
        // Along the left side, out of the view behind.
        let truth = |beam: usize| 1.5 / (0.3 + increment * beam as f64).sin();
        let ranges: Vec<f32> = (0..450).map(|beam| truth(beam) as f32).collect();
        filter.update(&ranges, |range| range < 10.0);
        for (beam, range) in filter.ranges().iter().enumerate().filter(|(_, range)| **range < 5.0) {
            let off = f64::from(*range) / truth(beam) - 1.0;
            assert!(off.abs() < 1e-5, "beam {beam}: {off}");
        }
    }
}
