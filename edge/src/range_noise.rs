//! Range noise. How large is the noise of a lidar's ranges? Estimated from the scans themselves, whatever the robot file says.
//!
//! Three neighbouring returns `a, b, c` of one surface lie nearly on a line, so `a - 2 b + c` is noise alone, with six times a range's
//! variance. The median of its size over a scan ignores the edges of things (Rousseeuw and Croux, "Alternatives to the median absolute
//! deviation", 1993, for the factor).

/// The median size of a Gaussian value, in standard deviations.
const MEDIAN: f32 = 0.6745;
/// A scan with fewer triples is not used.
const LEAST_TRIPLES: usize = 30;
/// Weight of one scan in the estimate.
const SHARE: f64 = 0.1;
/// Bounds of the estimate, m: rounded ranges seem to have none, rough ground seems to have much.
const BOUNDS: (f64, f64) = (0.005, 0.06);

/// Estimates the noise of one lidar's ranges.
#[derive(Clone, Debug)]
pub(crate) struct RangeNoise {
    /// Standard deviation of a range, m.
    std_dev: f64,
    /// Whether any scan has been used yet.
    is_estimated: bool,
    triples: Vec<f32>,
}

impl RangeNoise {
    /// Starts from the expected noise, m.
    pub(crate) fn new(expected: f64) -> Self {
        Self {
            std_dev: expected,
            is_estimated: false,
            triples: Vec::new(),
        }
    }

    /// Takes the ranges of a scan, of which those count that `is_near` accepts; returns the standard deviation of a range, m.
    pub(crate) fn update(&mut self, ranges: &[f32], is_near: impl Fn(f64) -> bool) -> f64 {
        self.triples.clear();
        for triple in ranges.windows(3) {
            if let [a, b, c] = triple
                && triple.iter().all(|range| is_near(f64::from(*range)))
            {
                self.triples.push((a - 2.0 * b + c).abs());
            }
        }
        if self.triples.len() >= LEAST_TRIPLES {
            let middle = self.triples.len() / 2;
            let (_, median, _) = self.triples.select_nth_unstable_by(middle, f32::total_cmp);
            let seen = f64::from(*median / (MEDIAN * 6.0_f32.sqrt())).clamp(BOUNDS.0, BOUNDS.1);
            let share = if self.is_estimated { SHARE } else { 1.0 };
            self.std_dev += share * (seen - self.std_dev);
            self.is_estimated = true;
        }
        self.std_dev
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_found_among_walls_and_posts_to_a_fifth() {
        // A linear congruential generator (Knuth): uniform from 0 to 1.
        let mut state = 5_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / f64::from(1 << 24)
        };
        for std_dev in [0.01, 0.02, 0.03] {
            let mut noise = RangeNoise::new(0.2);
            let mut found = 0.0;
            for _ in 0..10 {
                let mut range = |beam: usize| {
                    let wall = 2.0 / (beam as f64 / 720.0 * 1.2 - 0.6).cos();
                    let post = if beam % 60 < 15 { 0.8 } else { wall };
                    let error: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                    (post + std_dev * error) as f32
                };
                let ranges: Vec<f32> = (0..720).map(&mut range).collect();
                found = noise.update(&ranges, |range| range < 3.0);
            }
            assert!((found / std_dev - 1.0).abs() < 0.2, "{found} of {std_dev}");
        }
    }

    #[test]
    fn a_scan_without_returns_changes_nothing() {
        let mut noise = RangeNoise::new(0.02);
        assert_eq!(noise.update(&[f32::INFINITY; 720], f64::is_finite), 0.02);
        assert_eq!(noise.update(&[f32::NAN; 720], f64::is_finite), 0.02);
    }
}
