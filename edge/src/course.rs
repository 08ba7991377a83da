//! Course. Where will a moving obstacle be, and how near does its path over some moments come to a place?

use nalgebra::Point2;

/// A course is ignored beyond this time, s.
const MOST_SECS: f64 = 60.0;

/// The announced course of a robot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Future positions, `step` apart, odometry frame; the robot stays at the last one. Never empty.
    pub places: Vec<Point2<f64>>,
    /// Time between them, s.
    pub step: f64,
    /// Positions on its plan after those, `later_step` apart.
    pub later: Vec<Point2<f64>>,
    /// Time between them, s.
    pub later_step: f64,
    /// Time from the first position to the track's stamp, s.
    pub begun: f64,
    /// Whether the robot drives by a plan.
    pub planned: bool,
    /// Whether it gives way to this robot, rather than the reverse.
    pub makes_way: bool,
}

impl Course {
    /// Position `secs` after the track's stamp, odometry frame.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_edge::course::Course;
    ///
    /// let course = Course { places: vec![Point2::new(0.0, 0.0), Point2::new(0.4, 0.0)], step: 0.5, ..Course::default() };
    /// assert!((course.at(0.25).x - 0.2).abs() < 1e-9);
    /// assert_eq!(course.at(9.0).x, 0.4, "the robot stays at the last place");
    /// ```
    #[must_use]
    pub fn at(&self, secs: f64) -> Point2<f64> {
        let share = ((self.begun + secs) / self.step).clamp(0.0, self.places.len() as f64);
        let place = |nth: usize| self.places.get(nth).or(self.places.last()).copied().unwrap_or_default();
        let from = place(share as usize);
        from + (place(share as usize + 1) - from) * share.fract()
    }
}

impl Course {
    /// All positions from the track's stamp on, within a minute, each with its time, s after the stamp; the end appears once.
    #[must_use]
    pub fn timed(&self) -> Vec<(f64, Point2<f64>)> {
        let steps = std::iter::repeat_n(self.step, self.places.len().saturating_sub(1));
        let steps = steps.chain(std::iter::repeat_n(self.later_step, self.later.len()));
        let mut secs = -self.begun;
        let times = std::iter::once(secs).chain(steps.map(move |step| {
            secs += step;
            secs
        }));
        let timed = times.zip(self.places.iter().chain(&self.later).copied());
        let mut timed: Vec<(f64, Point2<f64>)> = timed.take_while(|(secs, _)| *secs <= MOST_SECS).collect();
        while let [.., (_, before), (_, last)] = timed[..]
            && before == last
        {
            timed.pop();
        }
        // Starts with the leg that it is on now.
        let past = timed.iter().skip(1).take_while(|(secs, _)| *secs < 0.0).count();
        timed[past.min(timed.len().saturating_sub(1))..].to_vec()
    }
}

/// The path of a track over some moments, as a polyline of a few points.
#[derive(Clone, Copy, Debug)]
pub struct PredictedPath {
    points: [Point2<f64>; 4],
    count: usize,
}

impl PredictedPath {
    pub(crate) fn straight(first: Point2<f64>, last: Point2<f64>) -> Self {
        let points = [first, last, last, last];
        Self { points, count: 2 }
    }

    pub(crate) fn bent(points: [Point2<f64>; 4]) -> Self {
        Self { points, count: 4 }
    }

    /// Distance of a point from the path, m.
    #[must_use]
    pub fn distance(&self, point: Point2<f64>) -> f64 {
        let squared = self.points[..self.count].windows(2).map(|leg| {
            let (from, along) = (leg[0], leg[1] - leg[0]);
            let share = (point - from).dot(&along) / along.norm_squared().max(1e-9);
            (point - (from + along * share.clamp(0.0, 1.0))).norm_squared()
        });
        squared.fold(f64::INFINITY, f64::min).sqrt()
    }

    /// Distances of a row of points from the path, m; as many as `distances` has room for. Coordinates count from `origin`. Without
    /// branches, so that the compiler vectorises it.
    pub(crate) fn distances(&self, origin: Point2<f64>, xs: &[f32], y: f32, distances: &mut [f32]) {
        distances.fill(f32::INFINITY);
        for leg in self.points[..self.count].windows(2) {
            let (from, along) = ((leg[0] - origin).cast::<f32>(), (leg[1] - leg[0]).cast::<f32>());
            let per_squared = 1.0 / along.norm_squared().max(1e-6);
            let up = y - from.y;
            for (least, x) in distances.iter_mut().zip(xs) {
                let right = x - from.x;
                let share = (right * along.x + up * along.y) * per_squared;
                // `f32::clamp` and `min` also check for NaN.
                let share = if share > 0.0 { share } else { 0.0 };
                let share = if share < 1.0 { share } else { 1.0 };
                let (right, up) = (right - along.x * share, up - along.y * share);
                let squared = right * right + up * up;
                *least = if squared < *least { squared } else { *least };
            }
        }
        for distance in distances {
            *distance = distance.sqrt();
        }
    }

    /// A point in its middle, and the distance of its farthest point from there, m.
    #[must_use]
    pub fn disc(&self) -> (Point2<f64>, f64) {
        let points = &self.points[..self.count];
        let middle = nalgebra::center(&self.points[0], &self.points[self.count - 1]);
        let reach = points.iter().map(|point| (point - middle).norm());
        (middle, reach.fold(0.0, f64::max))
    }
}
