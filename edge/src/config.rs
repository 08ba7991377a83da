//! Edge configuration. Which robot is this, where does it start, and how is it tuned?

use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::LostPolicy;
use zenav_protocol::robot::RobotModel;

use crate::settings::EdgeSettings;

/// Configuration of one edge.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeConfig {
    /// The robot's name in every key.
    pub robot: Id,
    /// Footprint, limits, sensors and gains.
    pub model: RobotModel,
    /// Pose at the start, map frame.
    pub start: Pose2,
    /// Control period, s.
    pub tick: f64,
    /// What to do with an accepted plan once the lease has expired.
    pub on_lost: LostPolicy,
    /// Everything that can be tuned.
    pub settings: EdgeSettings,
}

impl EdgeConfig {
    /// The defaults for a robot that stands at `start` in the map.
    #[must_use]
    pub fn new(robot: Id, model: RobotModel, start: Pose2) -> Self {
        Self {
            robot,
            model,
            start,
            tick: 0.02,
            on_lost: LostPolicy::FinishHorizon,
            settings: EdgeSettings::default(),
        }
    }
}
