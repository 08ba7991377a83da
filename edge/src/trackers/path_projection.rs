//! Where on its path is the robot? The nearest place ahead of the last one: a law that knows no time still has a plan time.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::TrajectoryPoint;

use super::{Progress, ReferenceTrajectory};

/// The nearest place is looked for this far ahead, m: a path that comes back close to itself is not cut short.
const WINDOW: f64 = 0.6;

/// A timeline followed by place.
#[derive(Clone, Debug)]
pub struct PathProjection {
    timeline: ReferenceTrajectory,
    time: f64,
    off: f64,
}

impl PathProjection {
    /// From plan time `time` (s) on.
    #[must_use]
    pub fn new(timeline: ReferenceTrajectory, time: f64) -> Self {
        let time = time.clamp(timeline.start(), timeline.end().max(timeline.start()));
        Self {
            timeline,
            time,
            off: 0.0,
        }
    }

    /// Moves on to the place nearest to the robot.
    pub fn advance(&mut self, map_from_base: &Pose2) {
        let here = map_from_base.position();
        let first = self.timeline.index(self.time);
        let points = self.timeline.points();
        let lengths = self.timeline.lengths();
        let limit = lengths.get(first).copied().unwrap_or(0.0) + WINDOW;
        let mut best = (f64::INFINITY, self.time);
        let legs = points.windows(2).zip(lengths).skip(first);
        for (leg, _) in legs.take_while(|(_, length)| **length <= limit) {
            let [from, to] = leg else { continue };
            let (a, b) = (from.pose().position(), to.pose().position());
            let along = b - a;
            let squared = along.norm_squared();
            let share = if squared > 0.0 {
                ((here - a).dot(&along) / squared).clamp(0.0, 1.0)
            } else {
                1.0
            };
            let distance = (here - (a + along * share)).norm();
            // A turn on the spot is passed at once.
            if distance <= best.0 + 1e-9 {
                best = (distance, from.t + share * (to.t - from.t));
            }
        }
        if best.0.is_finite() {
            self.off = best.0;
            self.time = self.time.max(best.1);
        } else {
            self.off = (self.timeline.sample(self.time).pose().position() - here).norm();
        }
    }

    /// Plan time reached, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Where the robot is on the path.
    #[must_use]
    pub fn here(&self) -> TrajectoryPoint {
        self.timeline.sample(self.time)
    }

    /// The last point.
    #[must_use]
    pub fn end(&self) -> TrajectoryPoint {
        self.timeline.sample(self.timeline.end())
    }

    /// The first place ahead on the path that is `distance` (m) from the robot, or its end.
    #[must_use]
    pub fn ahead(&self, map_from_base: &Pose2, distance: f64) -> Point2<f64> {
        let here = map_from_base.position();
        let first = self.timeline.index(self.time);
        let points = self.timeline.points().iter().skip(first);
        let far = points
            .map(|point| point.pose().position())
            .find(|place| (place - here).norm() >= distance);
        far.unwrap_or_else(|| self.end().pose().position())
    }

    /// Way left, m.
    #[must_use]
    pub fn left(&self) -> f64 {
        self.timeline.length_left(self.time)
    }

    /// ReferenceTrajectory and plan time.
    #[must_use]
    pub fn motion(&self) -> (&ReferenceTrajectory, f64) {
        (&self.timeline, self.time)
    }

    /// Distance from the path, m.
    #[must_use]
    pub fn off_track(&self) -> f64 {
        self.off
    }

    /// How far it is.
    #[must_use]
    pub fn progress(&self, finished: bool) -> Progress {
        Progress {
            time: self.time,
            waypoint: 0,
            distance_left: self.left(),
            time_left: (self.timeline.end() - self.time).max(0.0),
            finished,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_protocol::geometry::Twist2;

    #[test]
    fn a_path_that_comes_back_is_not_cut_short() {
        let mut pose = Pose2::IDENTITY;
        let circle = (0..=700).map(|step| {
            let point = TrajectoryPoint {
                t: f64::from(step) * 0.02,
                x: pose.x,
                y: pose.y,
                yaw: pose.yaw,
                v: 0.5,
                w: 0.5,
            };
            pose = pose.advance(Twist2::new(0.5, 0.5), 0.02);
            point
        });
        let mut rail = PathProjection::new(ReferenceTrajectory::new(circle.collect()), 0.0);
        // The end lies a little beyond the start.
        rail.advance(&Pose2::new(0.1, 0.05, 0.0));
        assert!(rail.time() < 1.0 && rail.left() > 6.0, "{}", rail.time());
        assert!(rail.off_track() > 0.03);
    }
}
