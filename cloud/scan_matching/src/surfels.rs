//! Surfels. Exact positions of the surfaces that points were seen on.
//!
//! A likelihood field keeps the best of all points. Where many scans saw a wall, each with its noise, its ridge is as wide and flat as that
//! noise, and a scan may lie anywhere on it. A surfel is the mean of the points in a cell whose surfaces have similar normals, as a
//! position and a normal.

use nalgebra::{Point2, Rotation2, Vector2};
use rustc_hash::FxHashMap;
use zenav_protocol::geometry::Pose2;

use crate::field::placed;

/// Side of a cell, m.
const SIDE: f64 = 0.2;
/// Cosine of the largest angle between two similar normals.
const ALIKE: f64 = 0.8;
/// A point belongs to a surfel at most this far across it, m.
const ACROSS: f64 = 0.15;
/// A point is added to a surfel whose middle is at most this far away, m.
const WITHIN: f64 = 0.75 * SIDE;
/// Scans after which a surfel is fixed: with a running mean, the map would follow the drift of the scans that draw it.
const SETTLED: u32 = 12;

/// Column and row of a cell.
type Key = (i32, i32);

/// A stretch of a surface.
#[derive(Clone, Copy, Debug)]
struct Surfel {
    /// Mean of the points.
    at: Point2<f64>,
    /// Sum of their normals.
    normal: Vector2<f64>,
    count: f64,
    /// Number of scans that they come from, and the last of these.
    scans: u32,
    last: u32,
}

/// The surface that a point lies on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Touch {
    /// Unit vector across the surface.
    pub(crate) normal: Vector2<f64>,
    /// Distance of the point from the surface along it, m.
    pub(crate) distance: f64,
    /// Weight of the point, 0 to 1, relative to one on a surface without an error of its own.
    pub(crate) trust: f64,
}

/// The surfaces seen by some scans.
#[derive(Clone, Debug, Default)]
pub struct Surfels {
    cells: FxHashMap<Key, Vec<Surfel>>,
    /// Number of scans so far.
    scans: u32,
}

impl Surfels {
    /// Adds the points of a scan seen from a pose: `map_from_scan`; points, m, and the normals of their surfaces, towards the laser, in the
    /// scan's frame. Points without a normal are left out.
    pub fn insert(&mut self, map_from_scan: Pose2, points: &[Point2<f64>], normals: &[Option<Vector2<f64>>]) {
        let turn = Rotation2::new(map_from_scan.yaw);
        self.scans += 1;
        for (point, normal) in placed(map_from_scan, points).into_iter().zip(normals) {
            let Some(normal) = normal.map(|normal| turn * normal) else {
                continue;
            };
            // A wall on the border of two cells stays one surfel.
            let known = self
                .nearest(point, normal)
                .filter(|(_, _, surfel)| (point - surfel.at).norm() <= WITHIN);
            let (key, number) = known.map_or((cell(point), usize::MAX), |(key, number, _)| (key, number));
            let surfels = self.cells.entry(key).or_default();
            match surfels.get_mut(number) {
                Some(surfel) => surfel.add(point, normal, self.scans),
                None => surfels.push(Surfel {
                    at: point,
                    normal,
                    count: 1.0,
                    scans: 1,
                    last: self.scans,
                }),
            }
        }
    }

    /// The surface under a point with this normal: the nearest of the surrounding surfels with a similar normal.
    pub(crate) fn touched(&self, point: Point2<f64>, normal: Vector2<f64>) -> Option<Touch> {
        let (_, _, surfel) = self.nearest(point, normal)?;
        Some(surfel.touch(point, normal))
    }

    /// The nearest surfel with a similar normal, in a point's cell and those beside it along the normal, with its cell and number.
    fn nearest(&self, point: Point2<f64>, normal: Vector2<f64>) -> Option<(Key, usize, &Surfel)> {
        let [here, above, below] = [0.0, SIDE, -SIDE].map(|away| cell(point + normal * away));
        let others = [above, below].into_iter().filter(|cell| *cell != here);
        let mut nearest = None;
        let mut least = f64::INFINITY;
        for cell in std::iter::once(here).chain(others) {
            for (number, surfel) in self.cells.get(&cell).into_iter().flatten().enumerate() {
                let apart = (point - surfel.at).norm_squared();
                if apart < least && surfel.is_alike(normal) && surfel.touch(point, normal).distance.abs() <= ACROSS {
                    (least, nearest) = (apart, Some((cell, number, surfel)));
                }
            }
        }
        nearest
    }
}

impl Surfel {
    fn is_alike(&self, normal: Vector2<f64>) -> bool {
        self.normal.dot(&normal) >= ALIKE * self.normal.norm()
    }

    fn add(&mut self, point: Point2<f64>, normal: Vector2<f64>, scan: u32) {
        self.scans += u32::from(scan != self.last);
        self.last = scan;
        if self.scans <= SETTLED {
            let own = self.normal.normalize();
            let away = point - self.at;
            let along = away - own * own.dot(&away);
            self.count += 1.0;
            self.at += (along + own * self.touch(point, normal).distance) / self.count;
            self.normal += normal;
        }
    }

    /// Along the mean of both normals two points of a circle have no distance: pillars are round. After Rusinkiewicz, "A symmetric
    /// objective function for ICP", 2019.
    fn touch(&self, point: Point2<f64>, normal: Vector2<f64>) -> Touch {
        let normal = (self.normal.normalize() + normal).normalize();
        Touch {
            normal,
            distance: normal.dot(&(point - self.at)),
            trust: self.count / (self.count + 1.0),
        }
    }
}

fn cell(point: Point2<f64>) -> Key {
    let at = (point.coords / SIDE).map(f64::floor);
    (at.x as i32, at.y as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall along x at y = 2, seen from below, each point off by a centimetre to one side or the other.
    fn wall(sign: f64) -> (Vec<Point2<f64>>, Vec<Option<Vector2<f64>>>) {
        let of = |number: i32| {
            let off = if number % 2 == 0 { 0.01 } else { -0.01 };
            Point2::new(0.05 * f64::from(number), 2.0 + sign * off)
        };
        let points: Vec<_> = (-40..40).map(of).collect();
        let normals = vec![Some(-Vector2::y()); points.len()];
        (points, normals)
    }

    #[test]
    fn a_surface_lies_in_the_middle_of_its_points_and_is_known_better_by_more() {
        let mut surfels = Surfels::default();
        let (points, normals) = wall(1.0);
        surfels.insert(Pose2::IDENTITY, &points, &normals);
        let once = surfels.touched(Point2::new(0.1, 2.03), -Vector2::y()).unwrap();
        let (points, normals) = wall(-1.0);
        surfels.insert(Pose2::IDENTITY, &points, &normals);
        let twice = surfels.touched(Point2::new(0.1, 2.03), -Vector2::y()).unwrap();
        assert!((twice.distance + 0.03).abs() < 1e-9, "{twice:?}");
        assert!(twice.trust > once.trust, "{once:?}, {twice:?}");
    }

    #[test]
    fn a_wall_s_other_side_and_what_is_far_are_not_touched() {
        let mut surfels = Surfels::default();
        let (points, normals) = wall(1.0);
        surfels.insert(Pose2::IDENTITY, &points, &normals);
        assert_eq!(surfels.touched(Point2::new(0.1, 2.0), Vector2::y()), None);
        assert_eq!(surfels.touched(Point2::new(0.1, 2.25), -Vector2::y()), None);
        assert_eq!(surfels.touched(Point2::new(9.0, 2.0), -Vector2::y()), None);
    }

    #[test]
    fn a_surface_that_settled_does_not_follow_those_who_drift() {
        let mut surfels = Surfels::default();
        let (points, normals) = wall(1.0);
        for drift in 0..40 {
            surfels.insert(Pose2::new(0.0, 0.001 * f64::from(drift), 0.0), &points, &normals);
        }
        let touch = surfels.touched(Point2::new(0.1, 2.0), -Vector2::y()).unwrap();
        assert!(touch.distance.abs() < 0.01, "{touch:?}");
    }
}
