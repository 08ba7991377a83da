//! Chance. How many false closures may be expected to fit as well as one that was found?
//!
//! A false closure measures anything. So the differences between what false closures measure and where their nodes are have some density
//! around zero, and the expected number of those that fit as well as a given closure is this density times the volume of the ellipsoid of
//! better fits: small for a closure between nodes that are well known to each other, large for one that the graph could take anywhere. The
//! closures that certainly do not fit tell the density.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Vector3};

/// The density is taken within distances that hold at least this share of the false closures.
const LEAST_SHARE: f64 = 0.125;
/// The same for at least this number of them (all, if there are fewer), and the distance is at least this, m: a single false closure near
/// zero tells no density.
const LEAST: (usize, f64) = (8, 1.0);

/// What false closures measure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chance {
    /// Number of false closures by difference to the poses, 1/(m² rad), around zero.
    density: f64,
    /// Within this distance, m.
    reach: f64,
}

impl Chance {
    /// From the distances, m, between where false closures see a node and where it is. Their yaws are taken to be anything.
    pub(crate) fn of(mut misses: Vec<f64>) -> Self {
        misses.sort_by(f64::total_cmp);
        let share = (misses.len() as f64 * LEAST_SHARE) as usize;
        let first = share.max(LEAST.0 - 1).min(misses.len().saturating_sub(1));
        let mut chance = Self {
            density: 0.0,
            reach: f64::INFINITY,
        };
        for (at, reach) in misses.iter().enumerate().skip(first) {
            let reach = reach.max(LEAST.1);
            let density = (at + 1) as f64 / (TAU * PI * reach * reach);
            if density > chance.density {
                chance = Self { density, reach };
            }
        }
        chance
    }

    /// Whether there are false closures at all.
    pub(crate) fn is_any(&self) -> bool {
        self.density > 0.0
    }

    /// The expected number of false closures whose chi squared is no larger than this. `information`: of the difference, the closure's
    /// own covariance included.
    pub(crate) fn expected(&self, chi_squared: f64, information: &Matrix3<f64>) -> f64 {
        if self.density == 0.0 {
            return 0.0;
        }
        // No ellipsoid is larger than what false closures cover.
        let plane = 1.0 / (self.reach * self.reach);
        let bounded = information + Matrix3::from_diagonal(&Vector3::new(plane, plane, 3.0 / (PI * PI)));
        let root = bounded.determinant().max(f64::MIN_POSITIVE).sqrt();
        self.density * 4.0 / 3.0 * PI * chi_squared.max(0.0).powf(1.5) / root
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Information of standard deviations, m and rad.
    fn information(plane: f64, yaw: f64) -> Matrix3<f64> {
        Matrix3::from_diagonal(&Vector3::new(plane, plane, yaw).map(|sigma| 1.0 / (sigma * sigma)))
    }

    #[test]
    fn the_expected_number_is_the_density_times_the_ellipsoid() {
        // Evenly over a disc of 10 m, and over all yaws: 100 / (π 100 m² 2π).
        let misses: Vec<f64> = (1..=100).map(|at| 10.0 * (f64::from(at) / 100.0).sqrt()).collect();
        let density = 100.0 / (PI * 100.0 * TAU);
        let chance = Chance::of(misses);
        let expected = chance.expected(4.0, &information(0.1, 0.05));
        let ellipsoid = 4.0 / 3.0 * PI * 8.0 * 0.1 * 0.1 * 0.05;
        assert!((expected / (density * ellipsoid) - 1.0).abs() < 0.01, "{expected}");
        // What is known to nothing is where any false closure may see it.
        let anywhere = chance.expected(4.0, &Matrix3::zeros());
        assert!((10.0..1000.0).contains(&anywhere), "{anywhere}");
    }
    #[test]
    fn false_closures_that_miss_by_little_are_expected_to_fit_by_chance() {
        let expected = |reach: f64| {
            let misses = (1..=50).map(|at| reach * (f64::from(at) / 50.0).sqrt()).collect();
            Chance::of(misses).expected(3.0, &information(0.2, 0.1))
        };
        assert!(expected(1.0) > 50.0 * expected(10.0));
    }
    #[test]
    fn a_single_false_closure_near_zero_tells_no_density() {
        let expected = |misses: &[f64]| Chance::of(misses.to_vec()).expected(2.0, &information(0.2, 0.1));
        let near = expected(&[0.0]);
        assert!(near > 0.0 && near < 0.01, "{near}");
        assert!(expected(&[0.0, 20.0, 20.0]) < near, "the nearest of few decides");
        // Rounding may leave a chi squared just below zero.
        assert_eq!(Chance::of(vec![3.0]).expected(-1e-18, &information(0.2, 0.1)), 0.0);
    }
    #[test]
    fn without_false_closures_nothing_is_chance() {
        let chance = Chance::of(Vec::new());
        assert!(!chance.is_any());
        assert_eq!(chance.expected(30.0, &Matrix3::zeros()), 0.0);
    }
}
