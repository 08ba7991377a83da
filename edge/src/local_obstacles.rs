//! Local obstacle memory. Which obstacles are around the robot, and which of them move? The newest scan, and in the lidar's blind spot what
//! earlier scans saw.
//!
//! Points are kept in the odometry frame: it is continuous, so a correction of the map never moves an obstacle.

use std::collections::VecDeque;

use nalgebra::{Isometry2, Point2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::{Footprint, LidarModel};
use zenav_protocol::time::Stamp;

use crate::blind_spot_grid::BlindSpotGrid;
use crate::field_of_view::{FieldOfView, ScanProjector, rigid};
use crate::moving_obstacles::MovingObstacles;
use crate::settings::EdgeSettings;

/// Remembered points beyond this distance are dropped, m.
pub(crate) const MEMORY_RANGE: f64 = 3.0;
/// Most points remembered.
const MEMORY_POINTS: usize = 2048;
/// After this long without a scan somebody may have entered the blind spot, s.
const SILENCE: f64 = 0.5;
/// Least spacing of remembered points, m.
const SPACING: f64 = 0.02;

/// Obstacle points around the robot, static and moving, and the floor known in the blind spot.
#[derive(Clone, Debug)]
pub struct LocalObstacles {
    lidar: LidarModel,
    view: FieldOfView,
    projector: ScanProjector,
    /// Top speed of the robot, m/s.
    fastest: f64,
    stamp: Option<Stamp>,
    seen: Vec<Point2<f64>>,
    /// Points that are in the blind spot now, until they are seen again or left behind.
    remembered: VecDeque<Point2<f64>>,
    moving: MovingObstacles,
    blind_spots: BlindSpotGrid,
}

impl LocalObstacles {
    /// No scan yet. Nothing moves faster than `fastest`, m/s.
    #[must_use]
    pub fn new(lidar: &LidarModel, footprint: &Footprint, fastest: f64) -> Self {
        Self {
            lidar: lidar.clone(),
            view: FieldOfView::new(lidar),
            projector: ScanProjector::new(lidar),
            fastest,
            stamp: None,
            seen: Vec::new(),
            remembered: VecDeque::new(),
            moving: MovingObstacles::new(lidar, footprint, fastest),
            blind_spots: BlindSpotGrid::new(lidar, footprint),
        }
    }

    /// The same with other tunables than the defaults.
    #[must_use]
    pub fn with_settings(mut self, settings: &EdgeSettings) -> Self {
        self.moving = self.moving.with_settings(settings, self.fastest);
        self
    }

    /// Takes a scan with the robot's odometry at the scan's stamp. Returns whether it was used: not with another number of beams, or not
    /// newer than the last.
    pub fn insert(&mut self, sweep: &Sweep, odom_from_base: Pose2) -> bool {
        if self.stamp.is_some_and(|last| sweep.stamp <= last) {
            return false;
        }
        let Some(scan) = self.projector.project(sweep, odom_from_base) else {
            return false;
        };
        if self.view.has_blind_spot() {
            if self.stamp.is_some_and(|last| sweep.stamp.secs_since(last) > SILENCE) {
                self.moving.note_occlusion(odom_from_base.position(), sweep.stamp);
            }
            remember(
                &mut self.remembered,
                &self.seen,
                self.view,
                scan.odom_from_laser.inverse(),
            );
        }
        self.seen.clear();
        let laser = scan.laser();
        for (range, ray) in scan.ranges.iter().zip(scan.rays) {
            let range = f64::from(*range);
            // NaN compares false: no return.
            if range >= self.lidar.range_min && range <= self.lidar.range_max {
                self.seen.push(laser + ray * range);
            }
        }
        self.moving.insert(&scan);
        self.blind_spots.insert(&scan);
        self.stamp = Some(sweep.stamp);
        true
    }

    /// The bumper was touched at a place (base frame): in the blind spot that counts as a moving obstacle.
    pub fn touch(&mut self, now: Stamp, place: Point2<f64>, odom_from_base: Pose2) {
        let local = self.lidar.mount.inverse().transform_point(place).coords;
        if self.view.in_blind_spot(local) {
            self.moving.note_occlusion(odom_from_base.transform_point(place), now);
        }
    }

    /// Age of the newest scan, s; `None` before the first.
    #[must_use]
    pub fn age(&self, now: Stamp) -> Option<f64> {
        self.stamp.map(|stamp| now.secs_since(stamp))
    }

    /// Stamp of the newest scan.
    #[must_use]
    pub fn stamp(&self) -> Option<Stamp> {
        self.stamp
    }

    /// All known points in the base frame of a robot at `odom_from_base`.
    pub fn in_base(&self, odom_from_base: Pose2) -> impl Iterator<Item = Point2<f64>> + '_ {
        let base_from_odom = rigid(odom_from_base.inverse());
        self.seen
            .iter()
            .chain(&self.remembered)
            .map(move |point| base_from_odom * point)
    }

    /// The newest scan's points in another frame.
    pub fn seen_in(&self, frame_from_odom: Pose2) -> impl Iterator<Item = Point2<f64>> + '_ {
        let frame_from_odom = rigid(frame_from_odom);
        self.seen.iter().map(move |point| frame_from_odom * point)
    }

    /// The moving ones among them.
    #[must_use]
    pub fn moving(&self) -> &MovingObstacles {
        &self.moving
    }

    /// The floor known to be free in the blind spot.
    #[must_use]
    pub fn blind_spots(&self) -> &BlindSpotGrid {
        &self.blind_spots
    }
}

/// Keeps those known points that are in the blind spot from here.
fn remember(
    remembered: &mut VecDeque<Point2<f64>>,
    seen: &[Point2<f64>],
    view: FieldOfView,
    laser_from_odom: Isometry2<f64>,
) {
    let blind = |point: &Point2<f64>| {
        let local = (laser_from_odom * point).coords;
        view.in_blind_spot(local) && local.norm_squared() < MEMORY_RANGE * MEMORY_RANGE
    };
    remembered.retain(blind);
    let mut last = Point2::new(f64::INFINITY, 0.0);
    for point in seen.iter().filter(|point| blind(point)) {
        if (point - last).norm_squared() < SPACING * SPACING {
            continue;
        }
        last = *point;
        if remembered.len() == MEMORY_POINTS {
            remembered.pop_front();
        }
        remembered.push_back(*point);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn tiago() -> LidarModel {
        zenav_fixtures::robot("tiago").lidar
    }

    fn sweep(lidar: &LidarModel, secs: f64, hit: Option<(usize, f32)>) -> Sweep {
        let mut ranges = vec![f32::INFINITY; lidar.beams];
        if let Some((beam, range)) = hit {
            ranges[beam] = range;
        }
        Sweep {
            stamp: Stamp::from_secs(secs),
            ranges,
        }
    }

    #[test]
    fn a_point_that_leaves_the_field_of_view_is_remembered_until_it_is_left_behind() {
        let lidar = tiago();
        let mut obstacles = LocalObstacles::new(&lidar, &Footprint::Radius(0.265), 0.6);
        assert!(obstacles.insert(&sweep(&lidar, 1.0, Some((333, 0.6))), Pose2::IDENTITY));
        let behind = Pose2::new(0.0, 0.0, std::f64::consts::PI);
        assert!(obstacles.insert(&sweep(&lidar, 1.1, None), behind));
        let points: Vec<_> = obstacles.in_base(behind).collect();
        assert_eq!(points.len(), 1);
        assert!((points[0].x + 0.8).abs() < 1e-3, "now behind: {:?}", points[0]);
        assert!(obstacles.insert(&sweep(&lidar, 100.0, None), behind));
        assert_eq!(obstacles.in_base(behind).count(), 1, "nobody has looked again");
        let gone = Pose2::new(-4.0, 0.0, std::f64::consts::PI);
        assert!(obstacles.insert(&sweep(&lidar, 110.0, None), gone));
        assert_eq!(obstacles.in_base(gone).count(), 0);
    }

    #[test]
    fn a_point_back_in_view_is_not_remembered() {
        let lidar = tiago();
        let mut obstacles = LocalObstacles::new(&lidar, &Footprint::Radius(0.265), 0.6);
        obstacles.insert(&sweep(&lidar, 1.0, Some((333, 0.6))), Pose2::IDENTITY);
        obstacles.insert(&sweep(&lidar, 1.1, None), Pose2::IDENTITY);
        assert_eq!(obstacles.in_base(Pose2::IDENTITY).count(), 0);
    }

    #[test]
    fn a_malformed_scan_is_ignored() {
        let lidar = tiago();
        let mut obstacles = LocalObstacles::new(&lidar, &Footprint::Radius(0.265), 0.6);
        assert!(!obstacles.insert(
            &Sweep {
                stamp: Stamp(5),
                ranges: vec![1.0; 3]
            },
            Pose2::IDENTITY
        ));
        assert_eq!(obstacles.age(Stamp(6)), None);
        assert!(obstacles.insert(&sweep(&lidar, 1.0, Some((0, f32::NAN))), Pose2::IDENTITY));
        assert_eq!(obstacles.in_base(Pose2::IDENTITY).count(), 0);
        assert!(
            !obstacles.insert(&sweep(&lidar, 1.0, None), Pose2::IDENTITY),
            "the same stamp twice"
        );
    }
}
