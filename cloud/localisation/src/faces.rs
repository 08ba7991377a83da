//! Faces. How far behind the walls of the map the lidar sees them, learned from matches.
//!
//! A cell is occupied if a wall touches it, so that the walls of a map are up to a cell thicker than they are, on all sides. A scan that sees
//! walls on one side only would be matched that far off; one that sees walls all around shows how much it is.

use nalgebra::{Point2, Rotation2};
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{LikelihoodField, Refinable};

/// Share of a scan's offset that is learned.
const RATE: f64 = 0.02;
/// Points less likely than this may lie on another surface.
const SURE: f64 = 0.6;
/// Least number of points that a scan's offset is taken from.
const LEAST: usize = 40;

/// The offset of the seen walls, m; positive behind those of the map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Faces(f64);

impl Faces {
    /// The points of a scan where the map would have them: moved across their surfaces, towards the laser.
    pub(crate) fn in_map(self, laser: Point2<f64>, points: Vec<Point2<f64>>) -> Vec<Point2<f64>> {
        if self.0 == 0.0 {
            return points;
        }
        let scan = Refinable::seen_from(laser, &points);
        let moved = points.iter().zip(scan.normals());
        moved
            .map(|(point, normal)| normal.map_or(*point, |normal| point + normal * self.0))
            .collect()
    }

    /// Learns from a scan that was matched at `map_from_base`; its points where the map would have them.
    pub(crate) fn learn(
        &mut self,
        field: &LikelihoodField,
        laser: Point2<f64>,
        points: &[Point2<f64>],
        map_from_base: Pose2,
    ) {
        let scan = Refinable::seen_from(laser, points);
        let turn = Rotation2::new(map_from_base.yaw);
        let (mut sum, mut count) = (0.0, 0_usize);
        for (point, normal) in points.iter().zip(scan.normals()) {
            let Some(normal) = normal else { continue };
            let (likelihood, slope) = field.likelihood(map_from_base.transform_point(*point));
            if likelihood >= SURE {
                // The slope of a Gaussian is its value times the distance over the variance.
                sum += slope.dot(&(turn * normal)) * field.sigma().powi(2) / likelihood;
                count += 1;
            }
        }
        if count >= LEAST {
            let most = 0.5 * field.spec().resolution;
            self.0 = (self.0 + RATE * sum / count as f64).clamp(-most, most);
        }
    }
}

#[cfg(test)]
mod tests {
    use zenav_fixtures::{map_where, spec};

    use super::*;
    use crate::known_map::KnownMap;

    /// The walls of a room of 5 m, seen from its middle this far behind the outermost free cells, m; only some of the four.
    fn walls(behind: f64, sides: usize) -> Vec<Point2<f64>> {
        let along = (0..96).map(|nth| -2.375 + 0.05 * f64::from(nth));
        let side = |turn: usize| {
            let turn = Rotation2::new(turn as f64 * std::f64::consts::FRAC_PI_2);
            along.clone().map(move |y| turn * Point2::new(2.5 + behind, y))
        };
        (0..sides).flat_map(side).collect()
    }

    #[test]
    fn walls_all_around_show_how_thick_the_map_makes_them_and_too_few_points_do_not() {
        let room = map_where(spec(120, 120, 0.05), |at| {
            (at.x - 3.0).abs().max((at.y - 3.0).abs()) > 2.5
        });
        let map = KnownMap::new(&room, 0.08);
        let (laser, middle) = (Point2::origin(), Pose2::new(3.0, 3.0, 0.0));
        // The centres of the first occupied cells are 0.025 m behind the free ones.
        for behind in [0.04, 0.01] {
            let mut faces = Faces::default();
            for _ in 0..300 {
                let seen = faces.in_map(laser, walls(behind, 4));
                faces.learn(map.field(), laser, &seen, middle);
            }
            assert!((faces.0 - (behind - 0.025)).abs() < 0.003, "{faces:?} of {behind}");
            let moved = faces.in_map(laser, walls(behind, 4));
            assert!((moved[48].x - 2.525).abs() < 0.003, "{:?}", moved[48]);
        }
        let mut faces = Faces::default();
        faces.learn(map.field(), laser, &walls(0.04, 1)[..30], middle);
        assert_eq!(faces, Faces::default());
    }
}
