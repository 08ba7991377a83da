//! Edge configuration. What can be set for an edge that is not in the robot's own file?

use std::time::Duration;

use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::LostPolicy;
use zenav_protocol::robot::RobotModel;

/// Settings of one edge.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeConfig {
    /// The robot's name in every key.
    pub robot: Id,
    /// Footprint, limits, sensors and gains.
    pub model: RobotModel,
    /// Where the robot stands at start, map frame.
    pub start: Pose2,
    /// How well the start is known: standard deviation of x and y, m.
    pub start_std: f64,
    /// How well the start's heading is known: standard deviation, rad.
    pub start_yaw_std: f64,
    /// Control period, s.
    pub tick: f64,
    /// Time to live of a lease without a heartbeat.
    pub lease_ttl: Duration,
    /// Age of the last renewal at which the link is called stale.
    pub stale_after: Duration,
    /// Age of the last renewal at which the link is called lost.
    pub lost_after: Duration,
    /// What to do with an accepted plan when the lease has expired.
    pub on_lost: LostPolicy,
    /// Longest validity that a plan may claim, s.
    pub max_validity: f64,
    /// A teleop command acts until the edge stamp that it echoes is this old, s.
    pub dead_man: f64,
    /// A scan older than this stops the robot, s.
    pub scan_timeout: f64,
}

impl EdgeConfig {
    /// The defaults for a robot that stands at `start` in the map.
    #[must_use]
    pub fn new(robot: Id, model: RobotModel, start: Pose2) -> Self {
        Self {
            robot,
            model,
            start,
            start_std: 0.05,
            start_yaw_std: 0.05,
            tick: 0.02,
            lease_ttl: Duration::from_secs(1),
            stale_after: Duration::from_millis(500),
            lost_after: Duration::from_secs(3),
            on_lost: LostPolicy::FinishHorizon,
            max_validity: 60.0,
            dead_man: 0.3,
            scan_timeout: 0.5,
        }
    }
}
