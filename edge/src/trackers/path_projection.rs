//! Path projection. Where on its path is the robot? At the nearest place ahead of the last one: even a law without time then has a plan
//! time.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Drive;
use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};

use super::Progress;

/// The nearest place is looked for this far ahead, m: a path that comes back close to itself is not cut short.
const WINDOW: f64 = 0.6;

/// Points on a straight leg are this far apart, m.
const LEG_STEP: f64 = 0.05;
/// Most steps of all legs together, however long they are.
const MOST_STEPS: f64 = 100_000.0;

/// A trajectory followed by position, not by time.
#[derive(Clone, Debug)]
pub struct PathProjection {
    trajectory: Trajectory,
    time: f64,
    off: f64,
}

impl PathProjection {
    /// From plan time `time` (s) on.
    #[must_use]
    pub fn new(trajectory: Trajectory, time: f64) -> Self {
        let time = time.clamp(
            trajectory.start_time(),
            trajectory.end_time().max(trajectory.start_time()),
        );
        Self {
            trajectory,
            time,
            off: 0.0,
        }
    }

    /// Along straight legs from a robot at `map_from_base` through waypoints, at the robot's top speed throughout.
    #[must_use]
    pub fn through(drive: &Drive, map_from_base: Pose2, waypoints: &[Point2<f64>]) -> Self {
        let mut points: Vec<TrajectoryPoint> = Vec::with_capacity(waypoints.len() * 8);
        let most = MOST_STEPS / waypoints.len().max(1) as f64;
        let (mut from, mut t) = (map_from_base.position(), 0.0);
        for to in waypoints {
            let leg = to - from;
            let length = leg.norm();
            if length < 1e-6 {
                continue;
            }
            let steps = (length / LEG_STEP).ceil().clamp(1.0, most.max(1.0)) as u32;
            let first = u32::from(!points.is_empty());
            for step in first..=steps {
                let share = f64::from(step) / f64::from(steps);
                let position = from + leg * share;
                points.push(TrajectoryPoint {
                    t: t + share * length / drive.top_speed(),
                    x: position.x,
                    y: position.y,
                    yaw: leg.y.atan2(leg.x),
                    v: drive.top_speed(),
                    w: 0.0,
                });
            }
            (from, t) = (*to, t + length / drive.top_speed());
        }
        Self::new(points.into(), 0.0)
    }

    /// Moves on to the place on the path nearest to the robot.
    ///
    /// ```
    /// # let drive = zenav_fixtures::robot("tiago").drive;
    /// use nalgebra::Point2;
    /// use zenav_edge::trackers::PathProjection;
    /// use zenav_protocol::geometry::Pose2;
    ///
    /// let mut projection = PathProjection::through(&drive, Pose2::IDENTITY, &[Point2::new(2.0, 0.0)]);
    /// projection.advance(&Pose2::new(0.5, 0.1, 0.0));
    /// assert!((projection.left() - 1.5).abs() < 1e-6 && (projection.off_track() - 0.1).abs() < 1e-6);
    /// ```
    pub fn advance(&mut self, map_from_base: &Pose2) {
        let nearest = self
            .trajectory
            .nearest_ahead(self.time, map_from_base.position(), WINDOW);
        self.off = nearest.distance;
        self.time = self.time.max(nearest.t);
    }

    /// Carries the path over to another map frame.
    pub fn moved(&mut self, new_from_old: Pose2) {
        self.trajectory = self.trajectory.moved(new_from_old);
    }

    /// Plan time reached, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Where the robot is on the path.
    #[must_use]
    pub fn here(&self) -> TrajectoryPoint {
        self.trajectory.sample(self.time)
    }

    /// The last point.
    #[must_use]
    pub fn end(&self) -> TrajectoryPoint {
        self.trajectory.sample(self.trajectory.end_time())
    }

    /// The first place ahead on the path that is `distance` (m) from the robot, or its end.
    #[must_use]
    pub fn ahead(&self, map_from_base: &Pose2, distance: f64) -> Point2<f64> {
        let here = map_from_base.position();
        let points = self.trajectory.spaced(self.time, LEG_STEP, f64::INFINITY);
        let mut positions = points.map(|point| point.position());
        let far = positions.find(|position| (position - here).norm() >= distance);
        far.unwrap_or_else(|| self.end().position())
    }

    /// Distance left, m.
    #[must_use]
    pub fn left(&self) -> f64 {
        self.trajectory.length_left(self.time)
    }

    /// Trajectory and plan time, s.
    #[must_use]
    pub fn followed(&self) -> (&Trajectory, f64) {
        (&self.trajectory, self.time)
    }

    /// Distance from the path, m.
    #[must_use]
    pub fn off_track(&self) -> f64 {
        self.off
    }

    /// Progress along the path.
    #[must_use]
    pub fn progress(&self, finished: bool) -> Progress {
        Progress {
            time: self.time,
            waypoint: 0,
            distance_left: self.left(),
            time_left: (self.trajectory.end_time() - self.time).max(0.0),
            finished,
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
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
        let mut projection = PathProjection::new(circle.collect(), 0.0);
        // The end lies a little beyond the start.
        projection.advance(&Pose2::new(0.1, 0.05, 0.0));
        assert!(
            projection.time() < 1.0 && projection.left() > 6.0,
            "{}",
            projection.time()
        );
        assert!(projection.off_track() > 0.03);
    }

    #[test]
    fn the_path_through_waypoints_is_as_long_as_its_legs() {
        let model = zenav_fixtures::robot("tiago");
        let waypoints = [Point2::new(3.0, 0.0), Point2::new(3.0, 1.0)];
        let projection = PathProjection::through(&model.drive, Pose2::IDENTITY, &waypoints);
        assert!((projection.left() - 4.0).abs() < 1e-9);
    }
}
