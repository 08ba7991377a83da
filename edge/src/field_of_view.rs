//! Field of view and scan projection. Which directions does a lidar see, and where do the beams of a scan lie in the odometry frame?

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::LidarModel;
use zenav_protocol::time::Stamp;

/// A pose for transforming many points: sine and cosine are computed once.
pub(crate) fn rigid(pose: Pose2) -> Isometry2<f64> {
    Isometry2::new(Vector2::new(pose.x, pose.y), pose.yaw)
}

/// The directions that a lidar sees, in its own frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FieldOfView {
    /// Directions of the first and of the last beam.
    first: Vector2<f64>,
    last: Vector2<f64>,
    /// Opening of the blind spot, rad; a gap of about a beam's spacing is none.
    gap: f64,
}

impl FieldOfView {
    pub(crate) fn new(lidar: &LidarModel) -> Self {
        let first = lidar.angle_min();
        let span = lidar.angle_increment() * (lidar.beams.max(1) - 1) as f64;
        let direction = |angle: f64| Vector2::new(angle.cos(), angle.sin());
        let gap = std::f64::consts::TAU - span;
        Self {
            first: direction(first),
            last: direction(first + span),
            gap: if gap > 0.1 { gap } else { 0.0 },
        }
    }

    /// Whether some directions are never seen.
    pub(crate) fn has_blind_spot(&self) -> bool {
        self.gap > 0.0
    }

    /// Whether this direction is never seen.
    pub(crate) fn in_blind_spot(&self, local: Vector2<f64>) -> bool {
        let (after_last, before_first) = (self.last.perp(&local) > 0.0, local.perp(&self.first) > 0.0);
        if self.gap <= std::f64::consts::PI {
            self.gap > 0.0 && after_last && before_first
        } else {
            after_last || before_first
        }
    }

    /// Distance of a place from the blind spot, m: zero inside it, infinite where there is none.
    pub(crate) fn distance_to_blind_spot(&self, local: Vector2<f64>) -> f64 {
        if !self.has_blind_spot() {
            return f64::INFINITY;
        }
        if self.in_blind_spot(local) {
            return 0.0;
        }
        let off = |edge: &Vector2<f64>| {
            if edge.dot(&local) > 0.0 {
                edge.perp(&local).abs()
            } else {
                local.norm()
            }
        };
        off(&self.first).min(off(&self.last))
    }
}

/// A scan in the odometry frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProjectedScan<'a> {
    /// When it was taken.
    pub(crate) stamp: Stamp,
    /// Pose of the lidar.
    pub(crate) odom_from_laser: Isometry2<f64>,
    /// Range of each beam, m.
    pub(crate) ranges: &'a [f32],
    /// Direction of each beam in the odometry frame.
    pub(crate) rays: &'a [Vector2<f64>],
}

impl ProjectedScan<'_> {
    /// Position of the lidar, odometry frame.
    pub(crate) fn laser(&self) -> Point2<f64> {
        self.odom_from_laser.translation.vector.into()
    }
}

/// Projects scans into the odometry frame; the directions of the beams are computed once.
#[derive(Clone, Debug)]
pub(crate) struct ScanProjector {
    mount: Pose2,
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
            mount: lidar.mount,
            beams: (0..lidar.beams).map(direction).collect(),
            rays: Vec::new(),
        }
    }

    /// Projects a scan of a robot at `odom_from_base`; `None` for another number of beams.
    pub(crate) fn project<'a>(&'a mut self, sweep: &'a Sweep, odom_from_base: Pose2) -> Option<ProjectedScan<'a>> {
        if sweep.ranges.len() != self.beams.len() {
            return None;
        }
        let odom_from_laser = rigid(odom_from_base * self.mount);
        let (cos, sin) = (odom_from_laser.rotation.re, odom_from_laser.rotation.im);
        let turn = |beam: &Vector2<f64>| Vector2::new(cos * beam.x - sin * beam.y, sin * beam.x + cos * beam.y);
        self.rays.clear();
        self.rays.extend(self.beams.iter().map(turn));
        Some(ProjectedScan {
            stamp: sweep.stamp,
            odom_from_laser,
            ranges: &sweep.ranges,
            rays: &self.rays,
        })
    }
}
