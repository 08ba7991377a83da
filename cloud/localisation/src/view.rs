//! View. What a lost robot has seen since it was lost, joined by odometry. One scan may fit several places; all around, only one.

use std::collections::HashSet;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;

/// A scan is kept if the robot has moved or turned this far since the last one, m and rad.
const APART: (f64, f64) = (0.3, 0.4);
/// Most scans kept; the oldest go first.
const MOST: usize = 8;
/// Side of the cells in which a surface is seen once, m.
const CELL: f64 = 0.05;
/// If a smaller share of a scan was seen before, the robot was carried meanwhile.
const SAME: f64 = 0.3;

/// A scan: where its beams begin and end, m.
#[derive(Clone, Debug)]
pub(crate) struct Sight {
    pub(crate) laser: Point2<f64>,
    pub(crate) points: Vec<Point2<f64>>,
}

/// The scans of a lost robot, oldest first, each with the odometry at its stamp, in the frame of its base.
#[derive(Clone, Debug, Default)]
pub(crate) struct View(Vec<(Pose2, Sight)>);

impl View {
    /// Forgets all scans.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    /// Whether several scans are kept.
    pub(crate) fn is_wide(&self) -> bool {
        self.0.len() > 1
    }

    /// Keeps a scan taken at `odom_from_base` if it was taken elsewhere than the last one.
    pub(crate) fn keep(&mut self, odom_from_base: Pose2, laser: Point2<f64>, points: &[Point2<f64>]) {
        if let Some((odometry, last)) = self.0.last() {
            let mut seen = HashSet::new();
            add(&mut seen, *odometry, &last.points);
            let is_known = |point: &&Point2<f64>| seen.contains(&cell(odom_from_base.transform_point(**point)));
            if (points.iter().filter(is_known).count() as f64) < SAME * points.len() as f64 {
                self.clear();
            }
        }
        let is_near = self.0.last().is_some_and(|(odometry, _)| {
            let step = odometry.inverse() * odom_from_base;
            step.x.hypot(step.y) < APART.0 && step.yaw.abs() < APART.1
        });
        if is_near {
            return;
        }
        if self.0.len() == MOST {
            self.0.remove(0);
        }
        let points = points.to_vec();
        self.0.push((odom_from_base, Sight { laser, points }));
    }

    /// A scan, and of the kept ones what it does not see; all in the frame of the base at the scan, newest first.
    pub(crate) fn joined(&self, odom_from_base: Pose2, laser: Point2<f64>, points: &[Point2<f64>]) -> Vec<Sight> {
        let mut seen = HashSet::new();
        add(&mut seen, odom_from_base, points);
        let mut sights = vec![Sight {
            laser,
            points: points.to_vec(),
        }];
        for (odometry, sight) in self.0.iter().rev() {
            let base_from_then = odom_from_base.inverse() * *odometry;
            let is_new = |point: &&Point2<f64>| !seen.contains(&cell(odometry.transform_point(**point)));
            let new = sight.points.iter().filter(is_new);
            sights.push(Sight {
                laser: base_from_then.transform_point(sight.laser),
                points: new.map(|point| base_from_then.transform_point(*point)).collect(),
            });
            add(&mut seen, *odometry, &sight.points);
        }
        sights
    }
}

/// The cell of a point in the frame of odometry.
fn cell(point: Point2<f64>) -> (i64, i64) {
    ((point.x / CELL).floor() as i64, (point.y / CELL).floor() as i64)
}

/// Adds the cells of a scan's points and their neighbours.
fn add(seen: &mut HashSet<(i64, i64)>, odom_from_base: Pose2, points: &[Point2<f64>]) {
    for point in points {
        let (x, y) = cell(odom_from_base.transform_point(*point));
        seen.extend((-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (x + dx, y + dy))));
    }
}
