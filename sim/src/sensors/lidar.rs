//! Planar lidar. The sweeps that it reports of the true ranges, and their timing.

use rand::RngExt as _;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::{Readings, Sweep};
use zenav_protocol::sensors::LidarModel;
use zenav_protocol::time::Stamp;

use super::timing::{Delay, Schedule};
use super::{Moment, Sensor, stepped};
use crate::faults::Fault;
use crate::lidar::AngularBuffer;

/// Beams of a sweeping lidar are measured together within this time, s.
const TOGETHER: f64 = 0.001;

/// One lidar of a robot. A sweeping lidar measures each beam from its pose at that beam's time.
#[derive(Clone, Debug)]
pub struct Lidar {
    name: String,
    model: LidarModel,
    /// The beams, in the order of their times.
    groups: Vec<BeamGroup>,
    /// Number of groups of the present sweep that are measured.
    measured: usize,
    /// Time and pose of the base at the last step.
    last: Option<(Stamp, Pose2)>,
    rng: Pcg64Mcg,
    schedule: Schedule,
    delay: Delay<Sweep>,
}

/// Neighbouring beams that are measured together.
#[derive(Clone, Debug)]
struct BeamGroup {
    first: usize,
    buffer: AngularBuffer,
    /// Time from here to the end of the sweep, s.
    before_end: f64,
}

impl Lidar {
    /// Before its first sweep.
    #[must_use]
    pub fn new(name: &str, model: LidarModel, rng: Pcg64Mcg) -> Self {
        let (beams, sweep_time) = (model.beams, model.sweep_time.abs());
        let together = if sweep_time > 0.0 {
            ((beams as f64 * TOGETHER / sweep_time) as usize).clamp(1, beams)
        } else {
            beams
        };
        let groups = (0..beams).step_by(together).map(|first| {
            let end = (first + together).min(beams);
            BeamGroup {
                first,
                buffer: AngularBuffer::of_beams(&model, first..end),
                before_end: model.before_end(0.5 * (first + end - 1) as f64),
            }
        });
        let mut groups: Vec<BeamGroup> = groups.collect();
        groups.sort_by(|a, b| b.before_end.total_cmp(&a.before_end));
        Self {
            name: name.to_owned(),
            groups,
            measured: 0,
            last: None,
            rng,
            schedule: Schedule::new(model.rate_hz),
            delay: Delay::new(model.latency),
            model,
        }
    }

    /// Measures the beams that are due, in a sweep that ends at `end`.
    fn measure_until(&mut self, moment: &Moment<'_>, end: Stamp) {
        let here = moment.map_from_base();
        let (before, there) = self.last.replace((moment.now, here)).unwrap_or((moment.now, here));
        let step = moment.now.secs_since(before);
        while let Some(group) = self.groups.get_mut(self.measured) {
            let ago = moment.now.secs_since(end) + group.before_end;
            if ago < 0.0 {
                break;
            }
            let map_from_base = if ago > 0.0 && step > 0.0 {
                here.interpolate(&there, (ago / step).min(1.0))
            } else {
                here
            };
            group.buffer.begin(map_from_base * self.model.mount);
            group.buffer.scene(moment.around.scene);
            group.buffer.crowd(moment.around.crowd, moment.around.own);
            self.measured += 1;
        }
    }

    /// The sweep that was just measured.
    fn sweep(&mut self, stamp: Stamp, fault: &Fault) -> Sweep {
        let model = LidarModel {
            noise: fault.noise(self.model.noise),
            dropout: fault.dropout(self.model.dropout),
            ..self.model.clone()
        };
        let mut groups: Vec<&BeamGroup> = self.groups.iter().collect();
        groups.sort_by_key(|group| group.first);
        let truth = groups.into_iter().flat_map(|group| group.buffer.ranges());
        let mut ranges = Vec::with_capacity(model.beams);
        measure(&model, truth, &mut self.rng, &mut ranges);
        Sweep {
            lidar: self.name.clone(),
            stamp,
            ranges,
        }
    }
}

impl Sensor for Lidar {
    fn sense(&mut self, moment: &Moment<'_>, readings: &mut Readings) {
        let next = self.schedule.next();
        let is_due = self.schedule.due(moment.now);
        let end = match is_due {
            // A lidar that takes all beams at once measures at the step.
            true if self.model.sweep_time == 0.0 => moment.now,
            true => self.schedule.next().plus_secs(-1.0 / self.model.rate_hz),
            false => next,
        };
        self.measure_until(moment, end);
        let swept = (is_due && !moment.fault.is_dead).then(|| self.sweep(end, &moment.fault));
        if is_due {
            self.measured = 0;
        }
        readings
            .sweeps
            .extend(self.delay.pass(moment.now, swept, moment.fault.late));
    }
}

/// The lidar's report of true ranges: bias and noise are added, and the result is rounded to its steps. There is no return outside its
/// limits, nor for lost beams.
pub fn measure(model: &LidarModel, truth: impl Iterator<Item = f64>, rng: &mut impl rand::Rng, ranges: &mut Vec<f32>) {
    ranges.clear();
    ranges.extend(truth.map(|range| {
        // Far beyond the limit, noise cannot bring it back.
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
