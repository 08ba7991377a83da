//! Blind-spot grid. Which floor in the blind spot is known to be free? A rolling free-space grid: floor that was seen free before it
//! left the field of view.
//!
//! A ring buffer of cells around the robot in the odometry frame. Floor never seen counts as occupied: the robot does not back into unknown
//! floor unless it feels its way. At the start, the disc that the robot needs to turn is assumed free.

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::robot::Footprint;

use crate::field_of_view::{FieldOfView, ProjectedScan};
use crate::settings::{BlindSpotGridSettings, EdgeSettings};

/// Cells a side, a power of two.
pub(crate) const SIDE: i32 = 1 << SIDE_BITS;
const SIDE_BITS: u32 = 7;
const CELLS: usize = (SIDE * SIDE) as usize;

/// Floor known to be free, in a ring buffer around the robot.
#[derive(Clone, Debug)]
pub struct BlindSpotGrid {
    view: FieldOfView,
    settings: BlindSpotGridSettings,
    /// Beams are traced up to this distance from the lidar, m.
    range: f64,
    /// Radius of the disc assumed free at the start, m.
    reach: f64,
    /// `None` before the first scan.
    cells: Option<Box<[Cell; CELLS]>>,
    /// Scans so far.
    sweep: u16,
}

/// State of the floor at a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Floor {
    /// In the field of view: the newest scan decides.
    InSight,
    /// In the blind spot, and free when it was last seen.
    Free,
    /// In the blind spot, and occupied when it was last seen, to within a cell.
    Occupied,
    /// In the blind spot, and never seen or out of the grid since.
    Unknown,
}

/// A cell of the ring buffer.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Lap of the ring buffer that the cell belongs to, 16 bits per axis.
    at: u32,
    /// The last scan with a beam through it.
    looked: u16,
    /// Number of scans that must still pass through it before it is free; zero: free.
    doubt: u8,
}

/// A cell that belongs to no place yet, or to one 200 km away.
const NOWHERE: Cell = Cell {
    at: 0x8000_8000,
    looked: 0,
    doubt: u8::MAX,
};

impl BlindSpotGrid {
    /// Only the disc that the robot needs to turn at its start is known to be free.
    #[must_use]
    pub(crate) fn new(view: FieldOfView, footprint: &Footprint, settings: &EdgeSettings) -> Self {
        let range = settings.local_obstacles.range;
        let settings = settings.blind_spot_grid;
        let reach = match footprint {
            // A round robot turns on the spot.
            Footprint::Radius(_) => 0.0,
            Footprint::Polygon(_) => footprint.circumscribed_radius() + settings.start_margin,
        };
        Self {
            view,
            settings,
            range,
            reach,
            cells: None,
            sweep: 0,
        }
    }

    /// Whether there is a blind spot: places around the robot that no lidar sees.
    #[must_use]
    pub fn has_blind_spot(&self) -> bool {
        self.view.has_blind_spot()
    }

    /// Takes a scan: traces its beams through the grid.
    pub(crate) fn insert(&mut self, scan: &ProjectedScan<'_>) {
        if !self.has_blind_spot() {
            return;
        }
        self.sweep = self.sweep.wrapping_add(1);
        let (laser, sweep) = (scan.laser(), self.sweep);
        let (size, most) = (self.settings.cell, self.range);
        let base = scan.odom_from_base * Point2::origin();
        let cells = self.cells.get_or_insert_with(|| at_start(base, self.reach, size));
        let stride = ((size / most / scan.lidar.angle_increment()) as usize).max(1);
        let at = |beam: usize| scan.ranges.get(beam).copied().unwrap_or(0.0);
        let walked = scan.rays.iter().enumerate().step_by(stride);
        for (nth, (beam, ray)) in walked.enumerate() {
            let mut range = f64::from(at(beam));
            if range.is_infinite() {
                // A missing return between two returns is not free space.
                range = f64::from(at(beam.saturating_sub(1)).min(at(beam + 1)).max(0.0));
            }
            // NaN carries no information.
            if range.is_nan() || range < scan.lidar.range_min {
                continue;
            }
            // One step leads from column to column, or from row to row.
            let step = size / ray.x.abs().max(ray.y.abs());
            let (dx, dy) = (fixed(ray.x * step, size), fixed(ray.y * step, size));
            let steps = |range: f64| (range / step) as u32;
            // Beams are dense near the lidar: every second one starts at half the range, every second of the rest at a quarter, and so on.
            let begin = steps(most).checked_shr(nth.trailing_zeros() + 1).unwrap_or(0);
            let mut x = fixed(laser.x, size) + i64::from(begin) * dx;
            let mut y = fixed(laser.y, size) + i64::from(begin) * dy;
            for _ in begin..steps((range - self.settings.return_margin).min(most)) {
                look_through(cells, locate(x, y), sweep);
                (x, y) = (x + dx, y + dy);
            }
        }
        for (range, ray) in scan.ranges.iter().zip(scan.rays) {
            let range = f64::from(*range);
            if range >= scan.lidar.range_min && range <= most {
                let (at, index) = place(laser + ray * range, size);
                if let Some(cell) = cells.get_mut(index) {
                    *cell = Cell {
                        at,
                        looked: sweep,
                        doubt: self.settings.free_after,
                    };
                }
            }
        }
    }

    /// State of the floor at a place (base frame of a robot at `odom_from_base`).
    #[must_use]
    pub fn floor(&self, odom_from_base: &Isometry2<f64>, place: Point2<f64>) -> Floor {
        if !self.in_blind_spot(place) {
            return Floor::InSight;
        }
        let (at, index) = self::place(odom_from_base * place, self.settings.cell);
        let cell = self.cells.as_ref().and_then(|cells| cells.get(index));
        match cell.filter(|cell| cell.at == at) {
            None => Floor::Unknown,
            Some(cell) if cell.doubt > 0 => Floor::Occupied,
            Some(_) => Floor::Free,
        }
    }

    /// Whether driving straight ahead (back, for a negative speed) leads into the blind spot.
    #[must_use]
    pub fn leads_into_blind_spot(&self, v: f64) -> bool {
        v != 0.0 && self.in_blind_spot(Point2::new(v.signum() * 2.0 * self.range, 0.0))
    }

    /// Whether a place (base frame of a robot at `odom_from_base`) is in the blind spot and not known to be free.
    #[must_use]
    pub fn is_unknown(&self, odom_from_base: &Isometry2<f64>, place: Point2<f64>) -> bool {
        matches!(self.floor(odom_from_base, place), Floor::Occupied | Floor::Unknown)
    }

    /// Whether a place (base frame) is in the blind spot.
    #[must_use]
    pub fn in_blind_spot(&self, place: Point2<f64>) -> bool {
        self.view.in_blind_spot(place)
    }
}

/// A grid in which only the disc that the robot needs to turn at its start is free.
fn at_start(base: Point2<f64>, radius: f64, cell: f64) -> Box<[Cell; CELLS]> {
    let mut cells = Box::new([NOWHERE; CELLS]);
    let steps = (radius / cell).ceil() as i32;
    for i in -steps..=steps {
        for j in -steps..=steps {
            let off = Vector2::new(f64::from(i), f64::from(j)) * cell;
            if off.norm() <= radius {
                look_through(&mut cells, place(base + off, cell), 0);
            }
        }
    }
    cells
}

/// Marks a cell that a beam of a scan passes through.
fn look_through(cells: &mut [Cell; CELLS], (at, index): Place, sweep: u16) {
    let Some(cell) = cells.get_mut(index) else { return };
    // Branchless: the branch would be unpredictable.
    let doubt = cell.doubt.saturating_sub(u8::from(cell.looked != sweep));
    *cell = Cell {
        at,
        looked: sweep,
        doubt: if cell.at == at { doubt } else { 0 },
    };
}

/// The lap of the ring buffer that a place belongs to, and its index there.
type Place = (u32, usize);

/// A coordinate (m) in cells of a size, fixed-point with 16 fractional bits: stepping needs no float rounding.
fn fixed(coordinate: f64, cell: f64) -> i64 {
    (coordinate * (65536.0 / cell)) as i64
}

fn locate(x: i64, y: i64) -> Place {
    let (x, y) = ((x >> 16) as i32, (y >> 16) as i32);
    let index = ((y & (SIDE - 1)) << SIDE_BITS) | (x & (SIDE - 1));
    let (east, north) = ((x >> SIDE_BITS) as u16, (y >> SIDE_BITS) as u16);
    (u32::from(east) << 16 | u32::from(north), index as usize)
}

fn place(point: Point2<f64>, cell: f64) -> Place {
    locate(fixed(point.x, cell), fixed(point.y, cell))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::field_of_view::{ScanProjector, rigid};
    use std::f64::consts::PI;
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::readings::Sweep;
    use zenav_protocol::robot::{LidarModel, RobotModel};
    use zenav_protocol::time::Stamp;

    fn lidar(robot: &str) -> LidarModel {
        zenav_fixtures::robot(robot).lidar.unwrap()
    }

    fn grid(lidar: &LidarModel, footprint: &Footprint) -> BlindSpotGrid {
        BlindSpotGrid::new(
            FieldOfView::new([lidar], footprint),
            footprint,
            &EdgeSettings::default(),
        )
    }

    fn jackal() -> RobotModel {
        zenav_fixtures::robot("jackal")
    }

    #[test]
    fn what_was_never_seen_is_unknown_and_what_was_seen_stays_known() {
        let lidar = lidar("tiago");
        let mut grid = grid(&lidar, &jackal().footprint);
        let sweep = Sweep::new(Stamp(1), vec![2.0; lidar.beams]);
        grid.insert(&ScanProjector::new(&lidar).project(&sweep, Pose2::IDENTITY).unwrap());
        let floor = |base: Pose2, x: f64| grid.floor(&rigid(base), Point2::new(x, 0.0));
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
        let mut grid = grid(&lidar, &jackal().footprint);
        let sweep = Sweep::new(Stamp(1), vec![f32::NAN; lidar.beams]);
        grid.insert(&ScanProjector::new(&lidar).project(&sweep, Pose2::IDENTITY).unwrap());
        let turned = rigid(Pose2::new(0.0, 0.0, PI));
        assert_eq!(grid.floor(&turned, Point2::new(-1.5, 0.0)), Floor::Unknown);
    }

    #[test]
    fn a_lidar_with_a_full_circle_of_view_has_no_blind_spot() {
        assert!(!grid(&lidar("neato"), &Footprint::Radius(0.17)).has_blind_spot());
    }
}
