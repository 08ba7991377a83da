//! Where the lidar does not look, what of the floor is known to be free? What it saw free before, and where the robot stood.
//!
//! A ring buffer of cells around the robot in the odometry frame. What was never seen counts as occupied: a robot does not
//! drive backwards into the unknown. Where it starts, the disc that it needs to turn is taken for free.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::{Footprint, LidarModel};

use crate::surroundings::{MEMORY_RANGE, View};

/// After a return a cell is free again when this many sweeps have looked through it: thin legs are hit now and then only.
const DOUBT: u8 = 10;
/// Side of a cell, m.
const CELL: f64 = 0.05;
/// Cells a side: more than twice the memory's range.
const SIDE: i32 = 128;
/// Beams are followed in steps of this, m.
const STEP: f64 = 0.04;
/// And up to this before what they met, m.
const SHORT: f64 = 0.02;
/// What is free at the start beyond the robot itself, m.
const AT_START: f64 = 0.16;

/// Floor that is known to be free.
#[derive(Clone, Debug)]
pub struct Trodden {
    lidar: LidarModel,
    view: View,
    /// Radius of what is taken for free at the start, m.
    reach: f64,
    cells: Vec<Cell>,
    /// Counts the sweeps.
    sweep: u32,
}

/// A place of the ring.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// What it stands for.
    at: (i32, i32),
    /// The sweep that looked through it last.
    looked: u32,
    /// Zero: free.
    doubt: u8,
}

impl Trodden {
    /// Nothing known but what the robot needs to turn where it starts.
    #[must_use]
    pub fn new(lidar: &LidarModel, footprint: &Footprint) -> Self {
        let reach = match footprint {
            // A disc turns where it stands.
            Footprint::Radius(_) => 0.0,
            Footprint::Polygon(_) => footprint.circumscribed_radius() + AT_START,
        };
        Self {
            lidar: lidar.clone(),
            view: View::new(lidar),
            reach,
            cells: Vec::new(),
            sweep: 0,
        }
    }

    /// Whether there is a sector that the lidar never sees.
    #[must_use]
    pub fn has_blind_sector(&self) -> bool {
        self.view.is_blind(Vector2::new(-1.0, 0.0)) || self.view.is_blind(Vector2::new(-1.0, -1e-9))
    }

    /// Takes a sweep with the lidar's number of beams, and the robot's odometry at its stamp.
    pub fn insert(&mut self, sweep: &Sweep, odom_from_base: Pose2) {
        if !self.has_blind_sector() {
            return;
        }
        self.sweep = self.sweep.wrapping_add(1);
        if self.cells.is_empty() {
            let nowhere = Cell {
                at: (i32::MIN, i32::MIN),
                looked: 0,
                doubt: DOUBT,
            };
            self.cells = vec![nowhere; (SIDE * SIDE) as usize];
            self.tread(odom_from_base.position(), self.reach);
        }
        let laser = odom_from_base * self.lidar.mount;
        let increment = self.lidar.angle_increment();
        let stride = ((CELL / MEMORY_RANGE / increment) as usize).max(1);
        let at = |beam: usize| sweep.ranges.get(beam).copied().unwrap_or(0.0);
        for beam in (0..sweep.ranges.len()).step_by(stride) {
            let mut range = f64::from(at(beam));
            if range.is_infinite() {
                // A lost beam between two that met something is not a free one.
                range = f64::from(at(beam.saturating_sub(1)).min(at(beam + 1)).max(0.0));
            }
            if range < self.lidar.range_min {
                continue;
            }
            let angle = laser.yaw + self.lidar.angle_min() + beam as f64 * increment;
            let step = Vector2::new(angle.cos(), angle.sin()) * STEP;
            let mut place = laser.position();
            for _ in 0..((range - SHORT).min(MEMORY_RANGE) / STEP) as u32 {
                self.look_through(place);
                place += step;
            }
        }
        for (beam, range) in sweep.ranges.iter().enumerate() {
            let range = f64::from(*range);
            if range >= self.lidar.range_min && range <= MEMORY_RANGE {
                let angle = laser.yaw + self.lidar.angle_min() + beam as f64 * increment;
                self.hit(laser.position() + Vector2::new(angle.cos(), angle.sin()) * range);
            }
        }
    }

    fn tread(&mut self, center: Point2<f64>, radius: f64) {
        let steps = (radius / STEP).ceil() as i32;
        for i in -steps..=steps {
            for j in -steps..=steps {
                let off = Vector2::new(f64::from(i), f64::from(j)) * STEP;
                if off.norm() <= radius {
                    self.look_through(center + off);
                }
            }
        }
    }

    fn look_through(&mut self, place: Point2<f64>) {
        let (at, index) = locate(place);
        let sweep = self.sweep;
        if let Some(cell) = self.cells.get_mut(index) {
            if cell.at != at {
                *cell = Cell {
                    at,
                    looked: sweep,
                    doubt: 0,
                };
            } else if cell.looked != sweep {
                cell.looked = sweep;
                cell.doubt = cell.doubt.saturating_sub(1);
            }
        }
    }

    fn hit(&mut self, place: Point2<f64>) {
        let (at, index) = locate(place);
        if let Some(cell) = self.cells.get_mut(index) {
            *cell = Cell {
                at,
                looked: self.sweep,
                doubt: DOUBT,
            };
        }
    }

    /// Whether a place (base frame of a robot at `odom_from_base`) is out of sight and not known to be free.
    #[must_use]
    pub fn is_unknown(&self, odom_from_base: &Pose2, place: Point2<f64>) -> bool {
        let local = self.lidar.mount.inverse().transform_point(place).coords;
        if !self.view.is_blind(local) {
            return false;
        }
        let (cell, index) = locate(odom_from_base.transform_point(place));
        self.cells
            .get(index)
            .is_none_or(|known| known.at != cell || known.doubt > 0)
    }

    /// Whether a direction from the base leads where the lidar does not look.
    #[must_use]
    pub fn is_blind(&self, direction: Vector2<f64>) -> bool {
        let (sin, cos) = self.lidar.mount.yaw.sin_cos();
        self.view.is_blind(Vector2::new(
            cos * direction.x + sin * direction.y,
            cos * direction.y - sin * direction.x,
        ))
    }
}

/// The cell of a place, and its index in the ring.
fn locate(place: Point2<f64>) -> ((i32, i32), usize) {
    let cell = (place.coords / CELL).map(|value| value.floor() as i32);
    let index = cell.y.rem_euclid(SIDE) * SIDE + cell.x.rem_euclid(SIDE);
    ((cell.x, cell.y), index as usize)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::f64::consts::PI;
    use zenav_protocol::robot::{RobotModel, shipped};
    use zenav_protocol::time::Stamp;

    fn jackal() -> RobotModel {
        RobotModel::from_toml(shipped("jackal").unwrap(), "jackal").unwrap()
    }

    #[test]
    fn what_was_never_seen_is_unknown_and_what_was_seen_stays_known() {
        let lidar = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap().lidar;
        let mut trodden = Trodden::new(&lidar, &jackal().footprint);
        let sweep = Sweep {
            stamp: Stamp(1),
            ranges: vec![2.0; lidar.beams],
        };
        trodden.insert(&sweep, Pose2::IDENTITY);
        let behind = Point2::new(-0.6, 0.0);
        assert!(trodden.is_unknown(&Pose2::IDENTITY, behind));
        assert!(
            !trodden.is_unknown(&Pose2::IDENTITY, Point2::new(-0.3, 0.0)),
            "the start"
        );
        assert!(!trodden.is_unknown(&Pose2::IDENTITY, Point2::new(0.6, 0.0)), "in sight");
        let turned = Pose2::new(0.0, 0.0, PI);
        assert!(!trodden.is_unknown(&turned, behind), "seen before the turn");
        assert!(
            trodden.is_unknown(&turned, Point2::new(-2.5, 0.0)),
            "beyond what was met"
        );
    }

    #[test]
    fn a_lidar_that_looks_all_around_has_no_blind_sector() {
        let lidar = RobotModel::from_toml(shipped("neato").unwrap(), "neato").unwrap().lidar;
        assert!(!Trodden::new(&lidar, &Footprint::Radius(0.17)).has_blind_sector());
    }
}
