//! CMA-ES. Minimises a function of which only values are known.
//!
//! Own code: the crate `cmaes` 0.2 brings a second nalgebra, rand, rand_distr and statrs with it, and owns the loop, which here runs in
//! parallel over candidates and rooms.
//!
//! The (mu/mu_w, lambda) CMA-ES after Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772, with its default parameters
//! (table 1, without negative weights). Pure: candidates out, costs in; the same seed gives the same candidates.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// A running search.
#[derive(Clone, Debug)]
pub struct Evolution {
    rng: Pcg64Mcg,
    mean: DVector<f64>,
    /// Step size.
    sigma: f64,
    covariance: DMatrix<f64>,
    /// Evolution paths of the covariance and of the step size.
    path: DVector<f64>,
    step_path: DVector<f64>,
    weights: Vec<f64>,
    population: usize,
    generation: u32,
}

impl Evolution {
    /// Starts at a point, with the same standard deviation in all directions, and `population` candidates per generation, at least 4.
    #[must_use]
    pub fn new(start: &[f64], sigma: f64, population: usize, seed: u64) -> Self {
        let population = population.max(4);
        let parents = population / 2;
        let raw: Vec<f64> = (1..=parents)
            .map(|rank| (0.5 * (population as f64 + 1.0)).ln() - (rank as f64).ln())
            .collect();
        let sum: f64 = raw.iter().sum();
        let size = start.len();
        Self {
            rng: Pcg64Mcg::seed_from_u64(seed),
            mean: DVector::from_column_slice(start),
            sigma,
            covariance: DMatrix::identity(size, size),
            path: DVector::zeros(size),
            step_path: DVector::zeros(size),
            weights: raw.iter().map(|weight| weight / sum).collect(),
            population,
            generation: 0,
        }
    }

    /// Mean of the search distribution.
    #[must_use]
    pub fn mean(&self) -> &[f64] {
        self.mean.as_slice()
    }

    /// The candidates of a generation.
    pub fn ask(&mut self) -> Vec<Vec<f64>> {
        let eigen = SymmetricEigen::new(self.covariance.clone());
        let lengths = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
        (0..self.population)
            .map(|_| {
                let normal = DVector::from_fn(self.mean.len(), |_, _| gauss(&mut self.rng));
                let step = &eigen.eigenvectors * lengths.component_mul(&normal);
                (&self.mean + step * self.sigma).as_slice().to_vec()
            })
            .collect()
    }

    /// Takes the costs of the candidates of [`Self::ask`]; a cost that is not a number counts as the largest.
    pub fn tell(&mut self, candidates: &[Vec<f64>], costs: &[f64]) {
        let mut ranked: Vec<(f64, DVector<f64>)> = costs
            .iter()
            .zip(candidates)
            .map(|(cost, candidate)| {
                let step = (DVector::from_column_slice(candidate) - &self.mean) / self.sigma;
                (if cost.is_nan() { f64::INFINITY } else { *cost }, step)
            })
            .collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.generation += 1;

        let n = self.mean.len() as f64;
        let effective = 1.0 / self.weights.iter().map(|weight| weight * weight).sum::<f64>();
        let step_rate = (effective + 2.0) / (n + effective + 5.0);
        let damping = 1.0 + 2.0 * (((effective - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0) + step_rate;
        let path_rate = (4.0 + effective / n) / (n + 4.0 + 2.0 * effective / n);
        let rank_one = 2.0 / ((n + 1.3).powi(2) + effective);
        let rank_many =
            (2.0 * (effective - 2.0 + 1.0 / effective) / ((n + 2.0).powi(2) + effective)).min(1.0 - rank_one);
        let expected = n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n));

        let best = || self.weights.iter().zip(&ranked);
        let step: DVector<f64> = best().map(|(weight, (_, step))| step * *weight).sum();
        self.mean += &step * self.sigma;

        let eigen = SymmetricEigen::new(self.covariance.clone());
        let whitened = &eigen.eigenvectors
            * eigen
                .eigenvalues
                .map(|value| 1.0 / value.max(1e-20).sqrt())
                .component_mul(&eigen.eigenvectors.tr_mul(&step));
        self.step_path =
            &self.step_path * (1.0 - step_rate) + whitened * (step_rate * (2.0 - step_rate) * effective).sqrt();
        let length = self.step_path.norm();
        let settled = 1.0 - (1.0 - step_rate).powi(2 * (self.generation as i32));
        let goes_on = length / settled.sqrt() < (1.4 + 2.0 / (n + 1.0)) * expected;
        let keep = if goes_on { 1.0 } else { 0.0 };
        self.path =
            &self.path * (1.0 - path_rate) + &step * (keep * (path_rate * (2.0 - path_rate) * effective).sqrt());

        let many: DMatrix<f64> = best()
            .map(|(weight, (_, step))| step * step.transpose() * *weight)
            .sum();
        let lost = (1.0 - keep) * path_rate * (2.0 - path_rate);
        self.covariance = &self.covariance * (1.0 - rank_one - rank_many + rank_one * lost)
            + &self.path * self.path.transpose() * rank_one
            + many * rank_many;
        self.sigma *= ((step_rate / damping) * (length / expected - 1.0)).exp();
    }
}

/// A standard normal number (Box and Muller).
fn gauss(rng: &mut Pcg64Mcg) -> f64 {
    let (radius, turn): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
    (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * turn).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn search(start: &[f64], generations: u32, cost: impl Fn(&[f64]) -> f64) -> Vec<f64> {
        let mut evolution = Evolution::new(start, 0.5, 8, 7);
        for _ in 0..generations {
            let candidates = evolution.ask();
            let costs: Vec<f64> = candidates.iter().map(|candidate| cost(candidate)).collect();
            evolution.tell(&candidates, &costs);
        }
        evolution.mean().to_vec()
    }

    #[test]
    fn it_finds_the_end_of_rosenbrocks_valley() {
        let valley = |x: &[f64]| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (1.0 - x[0]).powi(2);
        let found = search(&[-1.2, 1.0], 250, valley);
        assert!(
            (found[0] - 1.0).abs() < 1e-4 && (found[1] - 1.0).abs() < 1e-4,
            "{found:?}"
        );
    }

    #[test]
    fn it_finds_the_middle_of_a_long_turned_ellipsoid() {
        let bowl = |x: &[f64]| {
            let (a, b) = (x[0] + x[1] - 1.0, x[0] - x[1] + 3.0);
            1e4 * a * a + b * b + (x[2] - 2.0).powi(2)
        };
        let found = search(&[0.0, 0.0, 0.0], 150, bowl);
        assert!(bowl(&found) < 1e-6, "{found:?}");
    }

    #[test]
    fn a_cost_that_is_not_a_number_is_the_worst() {
        let found = search(&[3.0], 60, |x| {
            if x[0] > 1.0 && x[0] < 1.5 {
                f64::NAN
            } else {
                x[0] * x[0]
            }
        });
        assert!(found[0].abs() < 1e-2 || found[0] >= 1.0, "{found:?}");
        assert!(found[0].is_finite());
    }
}
