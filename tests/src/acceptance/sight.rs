//! Sight. The movers that the robot's lidars could have seen, by ground truth. The collision monitor is responsible only for these.

use nalgebra::Point2;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::sensors::Sweep;
use zenav_sim::World;

use super::sim_rig::SimRig;

/// A beam that ends this near to a mover's disc ended on it, m: range noise plus the motion of both since the sweep.
const ON_DISC: f64 = 0.1;
/// A mover this near to the robot's outline touches it, m.
const TOUCH: f64 = 0.02;

/// Which movers of a run have been in sight.
pub struct Sight {
    radii: Vec<f64>,
    seen: Vec<bool>,
}

impl Sight {
    /// No mover has been seen yet. Movers are discs.
    #[must_use]
    pub fn new(world: &World) -> Self {
        let movers = world.movers().iter();
        let radii: Vec<f64> = movers.map(|mover| mover.shape.circumscribed_radius()).collect();
        Self {
            seen: vec![false; radii.len()],
            radii,
        }
    }

    /// Processes the sweeps of the rig's current tick.
    pub fn see(&mut self, rig: &SimRig, sweeps: &[Sweep]) {
        let map_from_base = rig.truth().map_from_base;
        let movers: Vec<Point2<f64>> = rig.sim.movers().collect();
        for sweep in sweeps {
            for end in ends(&rig.model, sweep) {
                let end = map_from_base.transform_point(end);
                for ((seen, radius), center) in self.seen.iter_mut().zip(&self.radii).zip(&movers) {
                    *seen |= (end - center).norm() < radius + ON_DISC;
                }
            }
        }
    }

    /// Whether the robot is touched now, and only by movers that were never in sight.
    #[must_use]
    pub fn is_touched_unseen(&self, rig: &SimRig) -> bool {
        let base_from_map = rig.truth().map_from_base.inverse();
        let mut touching = rig
            .sim
            .movers()
            .zip(&self.radii)
            .zip(&self.seen)
            .filter(|((center, radius), _)| {
                rig.model.footprint.distance(base_from_map.transform_point(*center)) < *radius + TOUCH
            })
            .peekable();
        touching.peek().is_some() && touching.all(|(_, seen)| !seen)
    }
}

/// Where the beams of a sweep ended, base frame.
fn ends<'a>(model: &'a RobotModel, sweep: &'a Sweep) -> impl Iterator<Item = Point2<f64>> + 'a {
    let lidar = model.all_lidars().find(|(name, _)| *name == sweep.lidar);
    lidar.into_iter().flat_map(move |(_, lidar)| {
        let ranges = sweep.ranges.iter().enumerate();
        let returns = ranges.filter(|(_, range)| f64::from(**range) <= lidar.range_max);
        returns.map(move |(beam, range)| {
            let angle = lidar.angle_min() + lidar.angle_increment() * beam as f64;
            let (sin, cos) = angle.sin_cos();
            let end = Point2::new(f64::from(*range) * cos, f64::from(*range) * sin);
            lidar.mount.transform_point(end)
        })
    })
}
