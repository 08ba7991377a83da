//! Fixes. Measurements of the robot's pose in the world, by GPS and compass, as factors of single nodes.
//!
//! The map is begun at the robot's own estimate, so its frame is the world's, to within the error of that estimate. In a solve the world
//! becomes a node of its own that never moves, the start of the map is measured from it, and each factor is an edge from it. Like a closure,
//! a factor that does not fit is switched off. A new factor that is farther off than sensor, start and drift explain is off from the
//! beginning: a solve switches it on once others have moved the map to it. The errors of GPS and compass last longer than it takes to drive
//! through a submap: each sensor gives one factor to a submap, not one to each of its nodes.

use nalgebra::{Matrix3, Vector3};
use zenav_pose_graph::{Edge, EdgeKind, GraphError, PoseGraph};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::sensors::{Absolute, Fix};

use crate::slam::Slam;

/// Standard deviation of the start of a map in the world, m and rad: that of the start pose in the robot's own estimate.
const START: (f64, f64) = (0.05, 0.05);
/// Least standard deviation of a factor, m or rad: sensors have errors that they do not report.
const LEAST: (f64, f64) = (0.02, 0.005);
/// Drift of the map since the last factor that holds, standard deviation in m and rad for each metre driven.
const DRIFT: (f64, f64) = (0.03, 0.01);
/// A new factor makes a solve due if it is off by more standard deviations of the sensor than this, and by more than so much, m or rad.
const OFF: (f64, f64, f64) = (3.0, 0.2, 0.05);
/// A fix measured farther from the node, m or rad, is left out: odometry is exact over a short way only.
const NEAR: (f64, f64) = (0.5, 0.5);

/// A measurement of a node in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Factor {
    pub(crate) node: usize,
    /// As measured; what the sensor does not measure is as estimated then, and has no information.
    pub(crate) world_from_node: Pose2,
    /// Information of the position along each axis, 1/m², and of the heading, 1/rad².
    pub(crate) information: [f64; 2],
    /// 0 if it is held to be false.
    pub(crate) weight: f64,
}

impl Factor {
    /// The factor of a fix for a node at an estimated pose.
    fn of(node: usize, world_from_node: Pose2, node_from_fix: Pose2, fix: &Fix) -> Self {
        let certain = |std_dev: f64, least: f64| std_dev.max(least).powi(-2);
        let (measured, information) = match fix.measured {
            Absolute::Position { x, y, std_dev } => {
                // From the node to where the sensor was, along the world's axes.
                let at = world_from_node.transform_point(node_from_fix.position()) - world_from_node.position();
                let measured = Pose2::new(x - at.x, y - at.y, world_from_node.yaw);
                (measured, [certain(std_dev, LEAST.0), 0.0])
            }
            Absolute::Heading { yaw, std_dev } => {
                let measured = Pose2::new(world_from_node.x, world_from_node.y, yaw - node_from_fix.yaw);
                (measured, [0.0, certain(std_dev, LEAST.1)])
            }
        };
        Self {
            node,
            world_from_node: measured,
            information,
            weight: 1.0,
        }
    }

    fn information(&self) -> Matrix3<f64> {
        let [plane, heading] = self.information;
        Matrix3::from_diagonal(&Vector3::new(plane, plane, heading))
    }

    fn is_position(&self) -> bool {
        self.information[0] > 0.0
    }

    /// How far a pose is off, m or rad.
    fn off(&self, world_from_node: Pose2) -> f64 {
        let error = self.world_from_node.inverse() * world_from_node;
        if self.is_position() {
            error.x.hypot(error.y)
        } else {
            error.yaw.abs()
        }
    }
}

impl Slam {
    /// The weight of each measurement by GPS or compass that became a factor: 0 if it is held to be false.
    pub fn fix_weights(&self) -> impl Iterator<Item = f64> {
        self.back_end.factors().iter().map(|factor| factor.weight)
    }

    /// Keeps the newest fix of each sensor for the next factors.
    pub(crate) fn hold_fixes(&mut self, fixes: &[Fix]) {
        for fix in fixes.iter().filter(|fix| fix.is_sane()) {
            let kind = match fix.measured {
                Absolute::Position { .. } => 0,
                Absolute::Heading { .. } => 1,
            };
            self.fixes[kind] = Some(*fix);
        }
    }

    /// Adds the held fixes as factors of the newest node.
    pub(crate) fn add_factors(&mut self, node: usize) {
        for fix in std::mem::take(&mut self.fixes).into_iter().flatten() {
            let node_from_fix = self.last_node_odometry.inverse() * fix.odom_from_base;
            if node_from_fix.x.hypot(node_from_fix.y) > NEAR.0 || node_from_fix.yaw.abs() > NEAR.1 {
                continue;
            }
            let pose = self.back_end.poses()[node];
            let factor = Factor::of(node, pose, node_from_fix, &fix);
            let (is_held, is_solve_due) = self.judge(&factor);
            self.is_dirty |= is_solve_due;
            let weight = f64::from(u8::from(is_held));
            self.back_end.add_factor(Factor { weight, ..factor });
        }
    }

    /// Whether a new factor is held to be true until the next solve, and whether that is due.
    fn judge(&self, factor: &Factor) -> (bool, bool) {
        let poses = self.back_end.poses();
        let (information, start, drift, least) = if factor.is_position() {
            (factor.information[0], START.0, DRIFT.0, OFF.1)
        } else {
            (factor.information[1], START.1, DRIFT.1, OFF.2)
        };
        let (mut since, mut rejected) = (0, 0);
        for other in self.back_end.factors().iter().rev() {
            if other.is_position() != factor.is_position() {
                continue;
            }
            if other.weight > 0.0 {
                since = other.node;
                break;
            }
            rejected += 1;
        }
        let steps = poses[since..=factor.node].windows(2);
        let way: f64 = steps.map(|step| step[0].distance(&step[1])).sum();
        let variance = information.recip();
        let off = factor.off(poses[factor.node]);
        let explained = variance + start * start + (drift * way).powi(2);
        let is_plausible = off * off <= self.settings.robust.max_chi_squared * explained;
        let is_off = off > least.max(OFF.0 * variance.sqrt());
        // A sensor with a bias is rejected in each solve: the 1st, 2nd, 4th, 8th, … factor after the last that holds leads to one.
        let is_tried = (rejected + 1_usize).is_power_of_two();
        (
            is_plausible && (is_tried || !is_off),
            is_plausible && is_tried && is_off,
        )
    }
}

/// A graph with its weights and factors, as a graph whose first node is the world; `start`: where its own first node was begun.
pub(crate) fn in_world(
    graph: &PoseGraph,
    weights: &[f64],
    factors: &[Factor],
    start: Pose2,
) -> Result<(PoseGraph, Vec<f64>), GraphError> {
    let (mut world, mut all) = (PoseGraph::new(), weights.to_vec());
    world.add_node(Pose2::IDENTITY)?;
    for pose in graph.poses() {
        world.add_node(*pose)?;
    }
    for edge in graph.edges() {
        let (from, to) = (edge.from + 1, edge.to + 1);
        world.add_edge(Edge { from, to, ..*edge })?;
    }
    for factor in factors {
        world.add_edge(Edge {
            from: 0,
            to: factor.node + 1,
            measurement: factor.world_from_node,
            information: factor.information(),
            kind: EdgeKind::Closure,
        })?;
        all.push(factor.weight);
    }
    let (way, turn) = START;
    world.add_edge(Edge {
        from: 0,
        to: 1,
        measurement: start,
        information: Matrix3::from_diagonal(&Vector3::new(way, way, turn).map(|sigma| sigma.powi(-2))),
        kind: EdgeKind::Odometry,
    })?;
    all.push(1.0);
    Ok((world, all))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::settings::SlamSettings;

    #[test]
    fn what_was_measured_beside_a_node_is_carried_to_it_by_odometry() {
        // The node looks along y; the sensor measured 1 m ahead of it, turned by 0.3 rad.
        let pose = Pose2::new(5.2, 5.9, std::f64::consts::FRAC_PI_2);
        let node_from_fix = Pose2::new(1.0, 0.0, 0.3);
        let fix = |measured| Fix {
            odom_from_base: Pose2::new(4.0, 0.0, 0.3),
            measured,
        };
        let (x, y, std_dev) = (5.0, 7.0, 0.5);
        let position = Factor::of(3, pose, node_from_fix, &fix(Absolute::Position { x, y, std_dev }));
        assert!(position.world_from_node.distance(&Pose2::new(5.0, 6.0, 0.0)) < 1e-9);
        assert_eq!(position.information, [4.0, 0.0]);
        assert!((position.off(pose) - 0.2_f64.hypot(0.1)).abs() < 1e-9);
        let heading = Factor::of(
            3,
            pose,
            node_from_fix,
            &fix(Absolute::Heading { yaw: 1.0, std_dev: 0.1 }),
        );
        assert!((heading.world_from_node.yaw - 0.7).abs() < 1e-9);
        let off = std::f64::consts::FRAC_PI_2 - 0.7;
        assert!((heading.off(pose) - off).abs() < 1e-9);
    }

    #[test]
    fn a_fix_measured_far_from_the_node_or_before_the_robot_was_lost_is_left_out() {
        let factors = |way: f64, turn: f64, is_lost: bool| {
            let mut slam = Slam::new(SlamSettings::default());
            slam.back_end.add_node(Pose2::IDENTITY).unwrap();
            slam.scans.push(Arc::default());
            slam.hold_fixes(&[Fix {
                odom_from_base: Pose2::new(way, 0.0, turn),
                measured: Absolute::Heading { yaw: 0.0, std_dev: 0.1 },
            }]);
            if is_lost {
                slam.lose();
            }
            slam.add_factors(0);
            slam.fix_weights().count()
        };
        assert_eq!(factors(0.4, 0.4, false), 1);
        assert_eq!((factors(0.6, 0.0, false), factors(0.0, 0.6, false)), (0, 0));
        assert_eq!(factors(0.0, 0.0, true), 0);
    }
}
