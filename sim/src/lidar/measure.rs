//! What does a lidar report of true ranges? Bias, noise, steps, limits and lost beams.

use rand::RngExt as _;
use rand_distr::{Distribution, StandardNormal};
use zenav_protocol::robot::LidarModel;

use crate::sensors::stepped;

/// What the lidar reports of true ranges: bias and noise added, rounded to its steps; outside its limits there is no return, and none
/// of beams that are lost.
pub fn measure(model: &LidarModel, truth: impl Iterator<Item = f64>, rng: &mut impl rand::Rng, ranges: &mut Vec<f32>) {
    ranges.clear();
    ranges.extend(truth.map(|range| {
        // Far beyond the limit no noise brings it back.
        if range > model.range_max + 8.0 * model.noise + model.bias.abs() {
            return f32::INFINITY;
        }
        let noise: f64 = if model.noise > 0.0 {
            StandardNormal.sample(rng)
        } else {
            0.0
        };
        if model.dropout > 0.0 && rng.random::<f64>() < model.dropout {
            return f32::INFINITY;
        }
        let range = stepped(range + model.bias + noise * model.noise, model.resolution) as f32;
        if (model.range_min..=model.range_max).contains(&f64::from(range)) {
            range
        } else {
            f32::INFINITY
        }
    }));
}
