//! Planar lidar. What does it report of the true ranges, and when?

use rand::RngExt as _;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::readings::{Readings, Sweep};
use zenav_protocol::sensors::LidarModel;

use super::timing::{Delay, Schedule};
use super::{Moment, Sensor, stepped};
use crate::lidar::AngularBuffer;

/// One lidar of a robot.
#[derive(Clone, Debug)]
pub struct Lidar {
    name: String,
    model: LidarModel,
    buffer: AngularBuffer,
    rng: Pcg64Mcg,
    schedule: Schedule,
    delay: Delay<Sweep>,
}

impl Lidar {
    /// Before its first sweep.
    #[must_use]
    pub fn new(name: &str, model: LidarModel, rng: Pcg64Mcg) -> Self {
        Self {
            name: name.to_owned(),
            buffer: AngularBuffer::new(&model),
            rng,
            schedule: Schedule::new(model.rate_hz),
            delay: Delay::new(model.latency),
            model,
        }
    }

    fn sweep(&mut self, moment: &Moment<'_>) -> Sweep {
        self.buffer.begin(moment.map_from_base() * self.model.mount);
        self.buffer.scene(moment.around.scene);
        self.buffer.crowd(moment.around.crowd, moment.around.own);
        let model = LidarModel {
            noise: moment.fault.noise(self.model.noise),
            dropout: moment.fault.dropout(self.model.dropout),
            ..self.model.clone()
        };
        let mut ranges = Vec::with_capacity(model.beams);
        measure(&model, self.buffer.ranges(), &mut self.rng, &mut ranges);
        Sweep {
            lidar: self.name.clone(),
            stamp: moment.now,
            ranges,
        }
    }
}

impl Sensor for Lidar {
    fn sense(&mut self, moment: &Moment<'_>, readings: &mut Readings) {
        let due = self.schedule.due(moment.now) && !moment.fault.is_dead;
        let swept = due.then(|| self.sweep(moment));
        readings
            .sweeps
            .extend(self.delay.pass(moment.now, swept, moment.fault.late));
    }
}

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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::robot::{RobotModel, shipped};

    #[test]
    fn a_reading_is_rounded_to_millimetres_and_bounded_by_the_limits() {
        let tiago = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
        let model = LidarModel {
            range_min: 0.1,
            range_max: 5.0,
            noise: 0.0,
            ..tiago.lidar.unwrap()
        };
        let mut ranges = Vec::new();
        let mut rng = Pcg64Mcg::new(1);
        let truth = [1.234_56, 0.05, 5.01, f64::INFINITY];
        measure(&model, truth.into_iter(), &mut rng, &mut ranges);
        assert_eq!(ranges, [1.235, f32::INFINITY, f32::INFINITY, f32::INFINITY]);
    }
}
