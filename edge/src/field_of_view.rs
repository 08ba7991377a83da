//! Field of view and scan projection. Which directions do the robot's lidars see together, and where do the beams of a scan lie in the
//! odometry frame?

use std::f64::consts::TAU;

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::{Footprint, LidarModel};
use zenav_protocol::time::Stamp;

/// With several lidars, blind places are searched up to this range, m, at this spacing, m.
const SAMPLED_RANGE: f64 = 6.0;
const SAMPLE: f64 = 0.01;

/// A pose for transforming many points: sine and cosine are computed once.
pub(crate) fn rigid(pose: Pose2) -> Isometry2<f64> {
    Isometry2::new(Vector2::new(pose.x, pose.y), pose.yaw)
}

/// The number of the beam nearest to an angle, rad, counted from the first beam, at most a full circle; a lidar that sees less than that has
/// no beam of the higher numbers. `None` before the first beam.
pub(crate) fn nearest_beam(lidar: &LidarModel, angle: f64) -> Option<usize> {
    let spacing = lidar.angle_increment();
    let beam = (angle / spacing).round();
    // A full circle ends at its first beam.
    let circle = (TAU / spacing).round();
    (beam >= 0.0).then_some(if beam < circle { beam as usize } else { 0 })
}

/// The sector that one lidar sees, in the base frame.
#[derive(Clone, Copy, Debug)]
struct Sector {
    /// Where the lidar sits.
    origin: Vector2<f64>,
    /// Direction of the first and of the last beam.
    first: Vector2<f64>,
    last: Vector2<f64>,
    /// Angle that is never seen, rad; a gap of one beam does not count.
    gap: f64,
}

impl Sector {
    fn new(lidar: &LidarModel) -> Self {
        let first = lidar.mount.yaw + lidar.angle_min();
        let span = lidar.angle_increment() * (lidar.beams.max(1) - 1) as f64;
        let direction = |angle: f64| Vector2::new(angle.cos(), angle.sin());
        Self {
            origin: lidar.mount.position().coords,
            first: direction(first),
            last: direction(first + span),
            gap: lidar.gap(),
        }
    }

    /// Whether this lidar never sees a place.
    fn in_blind_spot(&self, place: Point2<f64>) -> bool {
        let local = place.coords - self.origin;
        let (after_last, before_first) = (self.last.perp(&local) > 0.0, local.perp(&self.first) > 0.0);
        if self.gap <= std::f64::consts::PI {
            self.gap > 0.0 && after_last && before_first
        } else {
            after_last || before_first
        }
    }

    /// Depth of a place in the sector that is never seen, m; negative: its distance from it.
    fn depth(&self, place: Point2<f64>) -> f64 {
        if self.gap == 0.0 {
            return f64::NEG_INFINITY;
        }
        let local = place.coords - self.origin;
        let off = |edge: &Vector2<f64>| {
            if edge.dot(&local) > 0.0 {
                edge.perp(&local).abs()
            } else {
                local.norm()
            }
        };
        let off = off(&self.first).min(off(&self.last));
        if self.in_blind_spot(place) { off } else { -off }
    }
}

/// The joint view of all lidars of a robot, in the base frame: a place is blind if no lidar sees it.
#[derive(Clone, Debug)]
pub(crate) struct FieldOfView {
    sectors: Vec<Sector>,
    has_blind_spot: bool,
}

impl FieldOfView {
    pub(crate) fn new<'a>(lidars: impl IntoIterator<Item = &'a LidarModel>, footprint: &Footprint) -> Self {
        let sectors: Vec<Sector> = lidars.into_iter().map(Sector::new).collect();
        let mut view = Self {
            sectors,
            has_blind_spot: true,
        };
        view.has_blind_spot = match &view.sectors[..] {
            [] => true,
            [one] => one.gap > 0.0,
            _ => view.has_blind_place(footprint),
        };
        view
    }

    /// Whether any place outside the footprint is blind, by sampling.
    fn has_blind_place(&self, footprint: &Footprint) -> bool {
        let rings = (SAMPLED_RANGE / SAMPLE).ceil() as u32;
        let directions = (0..360_u32).map(|degree| f64::from(degree).to_radians().sin_cos());
        directions.into_iter().any(|(sin, cos)| {
            let places = (0..rings).map(|ring| SAMPLE * f64::from(ring));
            places
                .map(|range| Point2::new(range * cos, range * sin))
                .any(|place| self.in_blind_spot(place) && footprint.distance(place) > 0.0)
        })
    }

    /// Whether there are places that no lidar sees.
    pub(crate) fn has_blind_spot(&self) -> bool {
        self.has_blind_spot
    }

    /// Whether no lidar ever sees a place.
    pub(crate) fn in_blind_spot(&self, place: Point2<f64>) -> bool {
        self.has_blind_spot && self.sectors.iter().all(|sector| sector.in_blind_spot(place))
    }

    /// Lower bound of the distance from a place to the blind spot, m: zero inside it, infinite without one.
    pub(crate) fn distance_to_blind_spot(&self, place: Point2<f64>) -> f64 {
        (-self.depth(place)).max(0.0)
    }

    /// Upper bound of the depth of a place in the blind spot, m; negative: its distance from it; minus infinity without one. A disc is
    /// hidden only if its center lies deeper than its radius.
    pub(crate) fn depth(&self, place: Point2<f64>) -> f64 {
        if !self.has_blind_spot {
            return f64::NEG_INFINITY;
        }
        let depths = self.sectors.iter().map(|sector| sector.depth(place));
        depths.fold(f64::INFINITY, f64::min)
    }
}

/// A sweep projected into the odometry frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProjectedScan<'a> {
    /// Which lidar took it.
    pub(crate) lidar: &'a LidarModel,
    /// When its last beam was measured.
    pub(crate) stamp: Stamp,
    /// Where the robot was.
    pub(crate) odom_from_base: Isometry2<f64>,
    /// Where the lidar was.
    pub(crate) odom_from_laser: Isometry2<f64>,
    /// One range per beam, m.
    pub(crate) ranges: &'a [f32],
    /// Directions of the beams in the odometry frame, as many as ranges.
    pub(crate) rays: &'a [Vector2<f64>],
}

impl ProjectedScan<'_> {
    /// Where the lidar was, odometry frame.
    pub(crate) fn laser(&self) -> Point2<f64> {
        self.odom_from_laser.translation.vector.into()
    }

    /// The beam towards a place, odometry frame, and the distance to it, m; `None` at the lidar itself.
    pub(crate) fn beam_to(&self, place: Point2<f64>) -> Option<(usize, f64)> {
        let off = place - self.laser();
        let (first, toward) = (self.rays.first()?, off.try_normalize(1e-6)?);
        let angle = first.perp(&toward).atan2(first.dot(&toward)).rem_euclid(TAU);
        Some((nearest_beam(self.lidar, angle)?, off.norm()))
    }

    /// Whether a beam and those up to `half` beside it all reach farther than a range, m.
    pub(crate) fn reaches(&self, beam: usize, half: usize, range: f64) -> bool {
        let beams = beam.saturating_sub(half)..(beam + half + 1).min(self.ranges.len());
        let through = self.ranges.get(beams).unwrap_or_default();
        !through.is_empty() && through.iter().all(|seen| f64::from(*seen) > range)
    }

    /// When a beam was measured; a beam beyond the last counts as the last.
    pub(crate) fn met(&self, beam: f64) -> Stamp {
        let beam = beam.min(self.lidar.beams.saturating_sub(1) as f64);
        self.stamp.plus_secs(-self.lidar.before_end(beam))
    }

    /// Whether a range is a real return; NaN is none.
    pub(crate) fn is_return(&self, range: f64) -> bool {
        range >= self.lidar.range_min && range <= self.lidar.range_max
    }
}

/// Projects the sweeps of one lidar: the directions of its beams are computed once.
#[derive(Clone, Debug)]
pub(crate) struct ScanProjector {
    lidar: LidarModel,
    beams: Vec<Vector2<f64>>,
    rays: Vec<Vector2<f64>>,
}

impl ScanProjector {
    pub(crate) fn new(lidar: &LidarModel) -> Self {
        let direction = |beam: usize| {
            let angle = lidar.angle_min() + beam as f64 * lidar.angle_increment();
            Vector2::new(angle.cos(), angle.sin())
        };
        Self {
            beams: (0..lidar.beams).map(direction).collect(),
            rays: Vec::new(),
            lidar: lidar.clone(),
        }
    }

    /// The lidar whose sweeps it projects.
    pub(crate) fn lidar(&self) -> &LidarModel {
        &self.lidar
    }

    /// Directions of the beams of the sweep projected last, odometry frame.
    pub(crate) fn rays(&self) -> &[Vector2<f64>] {
        &self.rays
    }

    /// A sweep of a robot at `odom_from_base`; `None` for another number of beams.
    pub(crate) fn project<'a>(&'a mut self, sweep: &'a Sweep, odom_from_base: Pose2) -> Option<ProjectedScan<'a>> {
        if sweep.ranges.len() != self.beams.len() {
            return None;
        }
        let odom_from_laser = rigid(odom_from_base * self.lidar.mount);
        let (cos, sin) = (odom_from_laser.rotation.re, odom_from_laser.rotation.im);
        let turn = |beam: &Vector2<f64>| Vector2::new(cos * beam.x - sin * beam.y, sin * beam.x + cos * beam.y);
        self.rays.clear();
        self.rays.extend(self.beams.iter().map(turn));
        Some(ProjectedScan {
            lidar: &self.lidar,
            stamp: sweep.stamp,
            odom_from_base: rigid(odom_from_base),
            odom_from_laser,
            ranges: &sweep.ranges,
            rays: &self.rays,
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::robot::RobotModel;

    fn view(names: &str) -> FieldOfView {
        let model = RobotModel::with_options(names, |name| Err(name.to_owned())).unwrap();
        FieldOfView::new(model.all_lidars().map(|(_, lidar)| lidar), &model.footprint)
    }

    #[test]
    fn blind_is_what_no_lidar_sees() {
        let (behind, ahead) = (Point2::new(-1.0, 0.0), Point2::new(1.0, 0.0));
        for robot in ["jackal", "tiago"] {
            let one = view(robot);
            assert!(
                one.has_blind_spot() && one.in_blind_spot(behind) && !one.in_blind_spot(ahead),
                "{robot}"
            );
            assert_eq!(one.distance_to_blind_spot(behind), 0.0);
            let two = view(&format!("{robot}+rear_lidar"));
            assert!(!two.has_blind_spot() && !two.in_blind_spot(behind), "{robot}");
            assert_eq!(two.distance_to_blind_spot(behind), f64::INFINITY);
        }
        assert!(!view("neato").has_blind_spot());
    }

    #[test]
    fn two_lidars_that_leave_a_gap_between_them_have_a_blind_sector() {
        let mut model = RobotModel::with_options("jackal+rear_lidar", |name| Err(name.to_owned())).unwrap();
        for (_, lidar) in model.all_lidars_mut() {
            lidar.field_of_view = 2.0;
        }
        let view = FieldOfView::new(model.all_lidars().map(|(_, lidar)| lidar), &model.footprint);
        let beside = Point2::new(0.0, 1.0);
        assert!(view.has_blind_spot() && view.in_blind_spot(beside) && !view.in_blind_spot(Point2::new(-1.0, 0.0)));
        assert!(view.distance_to_blind_spot(Point2::new(1.0, 0.0)) > 0.3);
    }
}
