//! View. What a lost robot has seen since it was lost, joined by odometry. One scan may fit several places; all around, only one.

use std::collections::HashSet;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;

/// A scan is kept if the robot has moved or turned this far since the last one, m and rad.
const APART: (f64, f64) = (0.3, 0.4);
/// A robot that has moved and turned less than this is at rest, m and rad.
const AT_REST: (f64, f64) = (0.02, 0.02);
/// Most scans kept; the oldest go first.
const MOST: usize = 8;
/// Side of the cells in which a surface is seen once, m.
const CELL: f64 = 0.05;
/// Odometry may say anything: cells are not numbered any farther.
const FARTHEST: f64 = 1e12;
/// If a smaller share of a scan was seen before, the robot was carried meanwhile.
const SAME: f64 = 0.3;

/// A scan: where its beams begin and end, m.
#[derive(Clone, Debug)]
pub(crate) struct Sight {
    pub(crate) laser: Point2<f64>,
    pub(crate) points: Vec<Point2<f64>>,
}

/// Whether a step is so long that a scan at its end shows something new.
pub(crate) fn is_apart(step: Pose2) -> bool {
    !is_within(step, APART)
}

fn is_within(step: Pose2, (way, turn): (f64, f64)) -> bool {
    step.x.hypot(step.y) < way && step.yaw.abs() < turn
}

/// The scans of a lost robot, oldest first, each with the pose by dead reckoning at its stamp, in the frame of its base. Poses are in one
/// frame, which is arbitrary and stays the same while the robot is lost.
#[derive(Clone, Debug, Default)]
pub(crate) struct View(Vec<(Pose2, Sight)>);

impl View {
    /// Forgets all scans.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    /// Keeps a scan taken at `pose` if it was taken elsewhere than the last one. If the robot has been at rest since, the scan replaces the
    /// last one: it may have been carried.
    pub(crate) fn keep(&mut self, pose: Pose2, laser: Point2<f64>, points: &[Point2<f64>]) {
        if let Some((kept, last)) = self.0.last() {
            let mut seen = HashSet::new();
            add(&mut seen, *kept, &last.points);
            let is_known = |point: &&Point2<f64>| seen.contains(&cell(pose.transform_point(**point)));
            if (points.iter().filter(is_known).count() as f64) < SAME * points.len() as f64 {
                self.clear();
            }
        }
        if let Some((kept, last)) = self.0.last_mut() {
            let step = kept.inverse() * pose;
            if is_within(step, AT_REST) {
                *last = Sight {
                    laser: step.transform_point(laser),
                    points: points.iter().map(|point| step.transform_point(*point)).collect(),
                };
            }
            if !is_apart(step) {
                return;
            }
        }
        if self.0.len() == MOST {
            self.0.remove(0);
        }
        let points = points.to_vec();
        self.0.push((pose, Sight { laser, points }));
    }

    /// A scan, and of the kept ones what it does not see; all in the frame of the base at the scan, newest first.
    pub(crate) fn joined(&self, pose: Pose2, laser: Point2<f64>, points: &[Point2<f64>]) -> Vec<Sight> {
        let mut seen = HashSet::new();
        add(&mut seen, pose, points);
        let mut sights = vec![Sight {
            laser,
            points: points.to_vec(),
        }];
        for (then, sight) in self.0.iter().rev() {
            let base_from_then = pose.inverse() * *then;
            let is_new = |point: &&Point2<f64>| !seen.contains(&cell(then.transform_point(**point)));
            let new = sight.points.iter().filter(is_new);
            sights.push(Sight {
                laser: base_from_then.transform_point(sight.laser),
                points: new.map(|point| base_from_then.transform_point(*point)).collect(),
            });
            add(&mut seen, *then, &sight.points);
        }
        sights
    }
}

/// The cell of a point in the frame of the poses.
fn cell(point: Point2<f64>) -> (i64, i64) {
    let index = |along: f64| (along / CELL).floor().clamp(-FARTHEST, FARTHEST) as i64;
    (index(point.x), index(point.y))
}

/// Adds the cells of a scan's points and their neighbours.
fn add(seen: &mut HashSet<(i64, i64)>, pose: Pose2, points: &[Point2<f64>]) {
    for point in points {
        let (x, y) = cell(pose.transform_point(*point));
        seen.extend((-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (x + dx, y + dy))));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of 2 m ahead.
    fn wall(x: f64) -> Vec<Point2<f64>> {
        (0..40).map(|nth| Point2::new(x, 0.05 * f64::from(nth) - 1.0)).collect()
    }

    #[test]
    fn at_rest_the_newest_scan_replaces_the_last_and_a_slow_turn_keeps_what_it_began_with() {
        let (laser, all) = (Point2::origin(), |points: Vec<Point2<f64>>| {
            [wall(3.0), points].concat()
        });
        let mut view = View::default();
        view.keep(Pose2::IDENTITY, laser, &all(wall(1.0)));
        view.keep(Pose2::new(0.01, 0.0, 0.0), laser, &all(wall(2.0)));
        let sights = view.joined(Pose2::IDENTITY, laser, &wall(3.0));
        assert!(
            sights[1].points.iter().all(|point| (point.x - 2.01).abs() < 1e-9),
            "{sights:?}"
        );
        assert_eq!((sights.len(), sights[1].points.len()), (2, 40));
        // The first scan of a turn by 0.015 rad at a time stays.
        let mut view = View::default();
        for nth in 0..20 {
            let pose = Pose2::new(0.0, 0.0, 0.015 * f64::from(nth));
            let ahead: Vec<_> = wall(3.0)
                .iter()
                .map(|point| pose.inverse().transform_point(*point))
                .collect();
            let points = if nth < 2 { [ahead, wall(1.0)].concat() } else { ahead };
            view.keep(pose, laser, &points);
        }
        let sights = view.joined(Pose2::IDENTITY, laser, &wall(3.0));
        assert_eq!(sights[1].points.len(), 40, "{sights:?}");
    }

    #[test]
    fn odometry_that_is_out_of_all_bounds_is_survived() {
        let (laser, far) = (Point2::origin(), Pose2::new(1e18, -1e300, 0.0));
        let mut view = View::default();
        view.keep(far, laser, &wall(3.0));
        assert_eq!(view.joined(far, laser, &wall(3.0))[0].points, wall(3.0));
    }
}
