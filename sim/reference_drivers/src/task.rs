//! Tasks. What is to be driven, in which world, and with which robot?

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::RobotModel;
use zenav_sim::World;

/// One drive from a start to a goal.
#[derive(Clone, Copy)]
pub struct DrivingTask<'a> {
    /// The world, known without error.
    pub world: &'a World,
    /// The robot: its footprint, and the limits of its drive.
    pub model: &'a RobotModel,
    /// Start: `map_from_base`.
    pub start: Pose2,
    /// Goal, map frame, m.
    pub goal: Point2<f64>,
    /// Distance from the goal that counts as reached, m. A driver stops as soon as it is within 0.7 of it.
    pub tolerance: f64,
    /// Time limit, simulated, s: [`Method::AllKnowing`](crate::Method::AllKnowing) plans no path beyond it.
    pub timeout: f64,
}
