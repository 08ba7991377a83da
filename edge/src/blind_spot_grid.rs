//! Rolling free-space grid of the blind sector. Where no lidar looks, what of the floor is known to be free? What was seen free before,
//! and where the robot stood.
//!
//! A ring buffer of cells around the robot in the odometry frame. What was never seen counts as occupied: a robot does not
//! drive backwards into the unknown. Where it starts, the disc that it needs to turn is taken for free.

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::robot::Footprint;

use crate::field_of_view::{FieldOfView, ProjectedScan};
use crate::local_obstacles::MEMORY_RANGE;

/// After a return a cell is free again when this many sweeps have looked through it: thin legs are hit now and then only.
const DOUBT: u8 = 10;
/// Side of a cell, m.
const CELL: f64 = 0.05;
/// Cells a side, a power of two: more than twice the memory's range.
const SIDE: i32 = 1 << SIDE_BITS;
const SIDE_BITS: u32 = 7;
const CELLS: usize = (SIDE * SIDE) as usize;
/// Beams are followed up to this before what they met, m.
const SHORT: f64 = 0.02;
/// What is free at the start beyond the robot itself, m.
const AT_START: f64 = 0.16;

/// Floor that is known to be free.
#[derive(Clone, Debug)]
pub struct BlindSpotGrid {
    view: FieldOfView,
    /// Radius of what is taken for free at the start, m.
    reach: f64,
    /// None before the first sweep.
    cells: Option<Box<[Cell; CELLS]>>,
    /// Counts the sweeps.
    sweep: u16,
}

/// What is known of a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Floor {
    /// The newest sweep tells.
    InSight,
    /// Out of sight, and free when it was seen last.
    Free,
    /// Out of sight, and something stood thereabouts: within a cell of it.
    Occupied,
    /// Never seen, or too long ago.
    Unknown,
}

/// A place of the ring.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Which round of the ring it stands for, 16 bits a side.
    at: u32,
    /// The sweep that looked through it last.
    looked: u16,
    /// Zero: free.
    doubt: u8,
}

/// Stands for no place yet, or for one that is 200 km away.
const NOWHERE: Cell = Cell {
    at: 0x8000_8000,
    looked: 0,
    doubt: DOUBT,
};

impl BlindSpotGrid {
    /// Nothing known but what the robot needs to turn where it starts.
    #[must_use]
    pub(crate) fn new(view: FieldOfView, footprint: &Footprint) -> Self {
        let reach = match footprint {
            // A disc turns where it stands.
            Footprint::Radius(_) => 0.0,
            Footprint::Polygon(_) => footprint.circumscribed_radius() + AT_START,
        };
        Self {
            view,
            reach,
            cells: None,
            sweep: 0,
        }
    }

    /// Whether there is a sector that no lidar sees.
    #[must_use]
    pub fn has_blind_sector(&self) -> bool {
        self.view.has_blind_sector()
    }

    /// Takes a sweep.
    pub(crate) fn insert(&mut self, cast: &ProjectedScan<'_>) {
        if !self.has_blind_sector() {
            return;
        }
        self.sweep = self.sweep.wrapping_add(1);
        let (laser, sweep) = (cast.laser(), self.sweep);
        let base = cast.odom_from_base * Point2::origin();
        let cells = self.cells.get_or_insert_with(|| at_start(base, self.reach));
        let stride = ((CELL / MEMORY_RANGE / cast.lidar.angle_increment()) as usize).max(1);
        let at = |beam: usize| cast.ranges.get(beam).copied().unwrap_or(0.0);
        let walked = cast.rays.iter().enumerate().step_by(stride);
        for (nth, (beam, ray)) in walked.enumerate() {
            let mut range = f64::from(at(beam));
            if range.is_infinite() {
                // A lost beam between two that met something is not a free one.
                range = f64::from(at(beam.saturating_sub(1)).min(at(beam + 1)).max(0.0));
            }
            // What is not a number tells nothing.
            if range.is_nan() || range < cast.lidar.range_min {
                continue;
            }
            // From column to column, or from row to row.
            let step = CELL / ray.x.abs().max(ray.y.abs());
            let (dx, dy) = (fixed(ray.x * step), fixed(ray.y * step));
            let steps = |range: f64| (range / step) as u32;
            // Beams lie closer together the nearer they are: of two, one begins where the other alone would leave cells out.
            let begin = steps(MEMORY_RANGE).checked_shr(nth.trailing_zeros() + 1).unwrap_or(0);
            let mut x = fixed(laser.x) + i64::from(begin) * dx;
            let mut y = fixed(laser.y) + i64::from(begin) * dy;
            for _ in begin..steps((range - SHORT).min(MEMORY_RANGE)) {
                look_through(cells, locate(x, y), sweep);
                (x, y) = (x + dx, y + dy);
            }
        }
        for (range, ray) in cast.ranges.iter().zip(cast.rays) {
            let range = f64::from(*range);
            if range >= cast.lidar.range_min && range <= MEMORY_RANGE {
                let (at, index) = place(laser + ray * range);
                if let Some(cell) = cells.get_mut(index) {
                    *cell = Cell {
                        at,
                        looked: sweep,
                        doubt: DOUBT,
                    };
                }
            }
        }
    }

    /// What is known of a place (base frame of a robot at `odom_from_base`).
    #[must_use]
    pub fn floor(&self, odom_from_base: &Isometry2<f64>, place: Point2<f64>) -> Floor {
        if !self.is_blind(place) {
            return Floor::InSight;
        }
        let (at, index) = self::place(odom_from_base * place);
        let cell = self.cells.as_ref().and_then(|cells| cells.get(index));
        match cell.filter(|cell| cell.at == at) {
            None => Floor::Unknown,
            Some(cell) if cell.doubt > 0 => Floor::Occupied,
            Some(_) => Floor::Free,
        }
    }

    /// Whether straight on (or back, for a negative speed) leads where the lidar does not look.
    #[must_use]
    pub fn leads_into_the_blind(&self, v: f64) -> bool {
        v != 0.0 && self.is_blind(Point2::new(v.signum() * 2.0 * MEMORY_RANGE, 0.0))
    }

    /// Whether a place (base frame of a robot at `odom_from_base`) is out of sight and not known to be free.
    #[must_use]
    pub fn is_unknown(&self, odom_from_base: &Isometry2<f64>, place: Point2<f64>) -> bool {
        matches!(self.floor(odom_from_base, place), Floor::Occupied | Floor::Unknown)
    }

    /// Whether a place (base frame) lies where the lidar does not look.
    #[must_use]
    pub fn is_blind(&self, place: Point2<f64>) -> bool {
        self.view.is_blind(place)
    }
}

/// The floor that a robot needs to turn where it starts.
fn at_start(base: Point2<f64>, radius: f64) -> Box<[Cell; CELLS]> {
    let mut cells = Box::new([NOWHERE; CELLS]);
    let steps = (radius / CELL).ceil() as i32;
    for i in -steps..=steps {
        for j in -steps..=steps {
            let off = Vector2::new(f64::from(i), f64::from(j)) * CELL;
            if off.norm() <= radius {
                look_through(&mut cells, place(base + off), 0);
            }
        }
    }
    cells
}

/// Nothing stands there, by a sweep.
fn look_through(cells: &mut [Cell; CELLS], (at, index): Place, sweep: u16) {
    let Some(cell) = cells.get_mut(index) else { return };
    // Without a branch: which of them it would be is as good as random.
    let doubt = cell.doubt.saturating_sub(u8::from(cell.looked != sweep));
    *cell = Cell {
        at,
        looked: sweep,
        doubt: if cell.at == at { doubt } else { 0 },
    };
}

/// The round of the ring that a place lies in, and its index in the ring.
type Place = (u32, usize);

/// A coordinate in cells, with 16 bits below the point: a walk by these needs no rounding of floats.
fn fixed(coordinate: f64) -> i64 {
    (coordinate * (65536.0 / CELL)) as i64
}

fn locate(x: i64, y: i64) -> Place {
    let (x, y) = ((x >> 16) as i32, (y >> 16) as i32);
    let index = ((y & (SIDE - 1)) << SIDE_BITS) | (x & (SIDE - 1));
    let (east, north) = ((x >> SIDE_BITS) as u16, (y >> SIDE_BITS) as u16);
    (u32::from(east) << 16 | u32::from(north), index as usize)
}

fn place(point: Point2<f64>) -> Place {
    locate(fixed(point.x), fixed(point.y))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::field_of_view::{ScanProjector, rigid};
    use std::f64::consts::PI;
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::readings::Sweep;
    use zenav_protocol::robot::{LidarModel, RobotModel, shipped};
    use zenav_protocol::time::Stamp;

    fn lidar(robot: &str) -> LidarModel {
        let model = RobotModel::from_toml(shipped(robot).unwrap(), robot).unwrap();
        model.lidar.unwrap()
    }

    fn grid(lidar: &LidarModel, footprint: &Footprint) -> BlindSpotGrid {
        BlindSpotGrid::new(FieldOfView::new([lidar], footprint), footprint)
    }

    fn jackal() -> RobotModel {
        RobotModel::from_toml(shipped("jackal").unwrap(), "jackal").unwrap()
    }

    #[test]
    fn what_was_never_seen_is_unknown_and_what_was_seen_stays_known() {
        let lidar = lidar("tiago");
        let mut trodden = grid(&lidar, &jackal().footprint);
        let sweep = Sweep::new(Stamp(1), vec![2.0; lidar.beams]);
        trodden.insert(&ScanProjector::new(&lidar).project(&sweep, Pose2::IDENTITY).unwrap());
        let floor = |base: Pose2, x: f64| trodden.floor(&rigid(base), Point2::new(x, 0.0));
        assert_eq!(floor(Pose2::IDENTITY, -0.6), Floor::Unknown);
        assert_eq!(floor(Pose2::IDENTITY, -0.3), Floor::Free, "the start");
        assert_eq!(floor(Pose2::IDENTITY, 0.6), Floor::InSight);
        let turned = Pose2::new(0.0, 0.0, PI);
        assert_eq!(floor(turned, -0.6), Floor::Free, "seen before the turn");
        assert_eq!(floor(turned, -2.21), Floor::Occupied);
        assert_eq!(floor(turned, -2.5), Floor::Unknown, "beyond what was met");
    }

    #[test]
    fn a_range_that_is_no_number_frees_nothing() {
        let lidar = lidar("tiago");
        let mut trodden = grid(&lidar, &jackal().footprint);
        let sweep = Sweep::new(Stamp(1), vec![f32::NAN; lidar.beams]);
        trodden.insert(&ScanProjector::new(&lidar).project(&sweep, Pose2::IDENTITY).unwrap());
        let turned = rigid(Pose2::new(0.0, 0.0, PI));
        assert_eq!(trodden.floor(&turned, Point2::new(-1.5, 0.0)), Floor::Unknown);
    }

    #[test]
    fn a_lidar_that_looks_all_around_has_no_blind_sector() {
        assert!(!grid(&lidar("neato"), &Footprint::Radius(0.17)).has_blind_sector());
    }
}
