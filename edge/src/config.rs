//! Edge configuration. Which robot is this, where does it start, and how is it tuned?

use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::LostPolicy;
use zenav_protocol::robot::RobotModel;

use crate::settings::EdgeSettings;

/// Control period, unless the body has another one, s.
pub const TICK: f64 = 0.02;

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
    ///
    /// ```
    /// # let model = zenav_fixtures::robot("tiago");
    /// use zenav_edge::EdgeConfig;
    /// use zenav_protocol::{geometry::Pose2, id::Id, messages::LostPolicy};
    ///
    /// let config = EdgeConfig::new(Id::robot("tiago")?, model, Pose2::new(1.0, 2.0, 0.0));
    /// assert_eq!((config.tick, config.on_lost), (0.02, LostPolicy::FinishHorizon));
    /// let autonomous = EdgeConfig { on_lost: LostPolicy::ReturnHome, ..config };
    /// assert_eq!(autonomous.settings.lease.lost_after, 3.0, "s without a heartbeat until it turns back");
    /// # Ok::<(), zenav_protocol::id::InvalidId>(())
    /// ```
    #[must_use]
    pub fn new(robot: Id, model: RobotModel, start: Pose2) -> Self {
        Self {
            robot,
            model,
            start,
            tick: TICK,
            on_lost: LostPolicy::FinishHorizon,
            settings: EdgeSettings::default(),
        }
    }
}
