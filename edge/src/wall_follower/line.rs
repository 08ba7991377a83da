//! Line extraction. Which straight walls does a run of returns show? Split and merge, each piece fitted by principal components.
//!
//! Nguyen, Gächter, Martinelli, Tomatis and Siegwart, "A Comparison of Line Extraction Algorithms Using 2D Range Data for Indoor Mobile
//! Robotics", Autonomous Robots 23, 2007: a run is split where it bends farthest from its chord; the total least squares line of a
//! piece goes through its mean along the first principal component.

use nalgebra::{Matrix2, Point2, Unit, Vector2};
use zenav_protocol::geometry::Pose2;

/// A straight piece of wall, from its first end to its last in the order of the beams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    /// First end, m.
    pub from: Point2<f64>,
    /// Last end, m.
    pub to: Point2<f64>,
}

impl Wall {
    /// The line of points by principal components, cut where its first and last points lie; `None` for fewer than two
    /// points, or points in one place.
    #[must_use]
    pub fn fit(points: &[Point2<f64>]) -> Option<Self> {
        let (first, last) = (points.first()?, points.last()?);
        let share = 1.0 / points.len() as f64;
        let mean = Point2::from(points.iter().map(|point| point.coords).sum::<Vector2<f64>>() * share);
        let scatter: Matrix2<f64> = points
            .iter()
            .map(|point| {
                let off = point - mean;
                off * off.transpose()
            })
            .sum();
        // The singular vectors of a symmetric matrix are its principal components, the longest first.
        let components = scatter.svd(true, false).u?;
        let along = Unit::try_new(components.column(0).into_owned(), 1e-12)?;
        let project = |point: &Point2<f64>| mean + *along * (point - mean).dot(&along);
        let wall = Self {
            from: project(first),
            to: project(last),
        };
        ((wall.to - wall.from).norm() > 1e-6).then_some(wall)
    }

    /// The same wall in the frame of `pose`.
    #[must_use]
    pub fn seen_from(&self, pose: Pose2) -> Self {
        let inverse = pose.inverse();
        Self {
            from: inverse.transform_point(self.from),
            to: inverse.transform_point(self.to),
        }
    }

    /// The nearest point of the wall to a point.
    #[must_use]
    pub fn nearest(&self, point: Point2<f64>) -> Point2<f64> {
        let along = self.to - self.from;
        // A wall without length would divide by zero: either of its ends will do.
        let share = (point - self.from).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE);
        self.from + along * share.clamp(0.0, 1.0)
    }
}

/// Splits a run into straight walls; a point may be `bend` m off its chord.
#[must_use]
pub fn walls(run: &[Point2<f64>], bend: f64) -> Vec<Wall> {
    let mut found = Vec::new();
    let mut left = vec![run];
    while let Some(piece) = left.pop() {
        let [first, inner @ .., last] = piece else { continue };
        // A run around the robot ends where it began: its chord is a point.
        let chord = Wall {
            from: *first,
            to: *last,
        };
        let off = |point: &Point2<f64>| (chord.nearest(*point) - point).norm();
        let farthest = inner.iter().map(off).enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        match farthest {
            Some((index, off)) if off > bend => {
                // The bend belongs to both pieces.
                let (at, above) = (index + 2, index + 1);
                left.extend(piece.get(above..));
                left.extend(piece.get(..at));
            }
            _ => found.extend(Wall::fit(piece)),
        }
    }
    found
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_corner_makes_two_walls_that_meet() {
        let mut run: Vec<_> = (0..=20).map(|i| Point2::new(0.05 * f64::from(i), 1.0)).collect();
        run.extend((1..=20).map(|i| Point2::new(1.0, 1.0 - 0.05 * f64::from(i))));
        let found = walls(&run, 0.03);
        assert_eq!(found.len(), 2);
        assert!((found[0].to - Point2::new(1.0, 1.0)).norm() < 1e-9 && (found[1].from - found[0].to).norm() < 1e-9);
    }

    #[test]
    fn nothing_is_made_of_too_little() {
        assert_eq!(walls(&[], 0.03), []);
        assert_eq!(walls(&[Point2::new(1.0, 1.0)], 0.03), []);
        assert_eq!(walls(&[Point2::new(1.0, 1.0); 5], 0.03), []);
    }

    proptest! {
        #[test]
        fn noise_moves_a_fitted_wall_less_than_itself(
            angle in -3.0..3.0, distance in 0.2..3.0_f64, noise in prop::collection::vec(-0.01..0.01_f64, 20..60)
        ) {
            let frame = Pose2::new(0.0, 0.0, angle);
            let count = noise.len() as f64;
            let points: Vec<_> = noise.iter().enumerate()
                .map(|(i, off)| frame.transform_point(Point2::new(i as f64 / count - 0.5, distance + off)))
                .collect();
            let wall = Wall::fit(&points).unwrap().seen_from(frame);
            let foot = wall.nearest(Point2::origin());
            prop_assert!((foot.y - distance).abs() < 0.011);
            prop_assert!(wall.from.x < wall.to.x);
        }

        #[test]
        fn every_point_of_a_run_lies_near_one_of_its_walls(
            points in prop::collection::vec((-2.0..2.0, -2.0..2.0), 2..60)
        ) {
            let run: Vec<_> = points.into_iter().map(|(x, y)| Point2::new(x, y)).collect();
            let found = walls(&run, 0.05);
            for point in &run {
                let off = found.iter().map(|wall| (wall.nearest(*point) - point).norm()).fold(f64::INFINITY, f64::min);
                prop_assert!(off < 3.0 * 0.05, "{off}");
            }
            prop_assert!(!found.is_empty());
        }
    }
}
