//! Course. Where will a moving obstacle be, and how near does its way of some moments come to a place?

use nalgebra::Point2;

/// What a robot has told of its future.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Where it will be, a step apart, odometry frame; it stays at the last. Never empty.
    pub places: Vec<Point2<f64>>,
    /// s.
    pub step: f64,
    /// How long after the first place the track's stamp is, s.
    pub begun: f64,
    /// Whether it makes way for this robot, rather than this one for it.
    pub makes_way: bool,
}

impl Course {
    /// The place `secs` after the track's stamp, odometry frame.
    #[must_use]
    pub fn at(&self, secs: f64) -> Point2<f64> {
        let share = ((self.begun + secs) / self.step).clamp(0.0, self.places.len() as f64);
        let place = |nth: usize| self.places.get(nth).or(self.places.last()).copied().unwrap_or_default();
        let from = place(share as usize);
        from + (place(share as usize + 1) - from) * share.fract()
    }
}

/// The way of a track over some moments, as a line of a few points.
#[derive(Clone, Copy, Debug)]
pub struct Way {
    points: [Point2<f64>; 4],
    count: usize,
}

impl Way {
    pub(crate) fn straight(first: Point2<f64>, last: Point2<f64>) -> Self {
        let points = [first, last, last, last];
        Self { points, count: 2 }
    }

    pub(crate) fn bent(points: [Point2<f64>; 4]) -> Self {
        Self { points, count: 4 }
    }

    /// Distance of a point from it, m.
    #[must_use]
    pub fn distance(&self, point: Point2<f64>) -> f64 {
        let mut distance = [0.0];
        self.distances(&[point.x], point.y, &mut distance);
        distance[0]
    }

    /// Distances of the points of a row from it, m; as many as there is room for.
    pub fn distances(&self, xs: &[f64], y: f64, distances: &mut [f64]) {
        distances.fill(f64::INFINITY);
        for leg in self.points[..self.count].windows(2) {
            let (from, along) = (leg[0], leg[1] - leg[0]);
            let squared = along.norm_squared().max(1e-9);
            for (least, x) in distances.iter_mut().zip(xs) {
                let point = Point2::new(*x, y);
                let share = ((point - from).dot(&along) / squared).clamp(0.0, 1.0);
                *least = least.min((point - (from + along * share)).norm_squared());
            }
        }
        for distance in distances {
            *distance = distance.sqrt();
        }
    }

    /// A place in its middle, and the distance of its farthest point from there, m.
    #[must_use]
    pub fn disc(&self) -> (Point2<f64>, f64) {
        let points = &self.points[..self.count];
        let middle = nalgebra::center(&self.points[0], &self.points[self.count - 1]);
        let reach = points.iter().map(|point| (point - middle).norm());
        (middle, reach.fold(0.0, f64::max))
    }
}
