//! Mission configuration. Which robot is the mission for, and with which settings?

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use zenav_protocol::id::Id;
use zenav_protocol::messages::GoalPoint;
use zenav_space::Zones;

use crate::settings::MissionSettings;

/// One robot's mission.
#[derive(Clone, Debug, PartialEq)]
pub struct MissionConfig {
    /// Name of the robot that it drives.
    pub robot: Id,
    /// The orchestrator's name, as holder of the robot's lease; must be unique.
    pub holder: String,
    /// The store's file; used only by the service.
    pub store: PathBuf,
    /// Named goals, map frame.
    pub places: BTreeMap<String, GoalPoint>,
    /// Zones of the map.
    pub zones: Arc<Zones>,
    /// Requested planner (`astar`, …).
    pub planner: String,
    /// Tunable settings.
    pub settings: MissionSettings,
}

impl MissionConfig {
    /// The defaults for a robot.
    ///
    /// ```
    /// use zenav_mission::MissionConfig;
    /// use zenav_protocol::id::Id;
    ///
    /// let mut config = MissionConfig::new(Id::robot("tiago")?, "mission-1", "tiago.redb".into());
    /// assert_eq!((&*config.planner, config.settings.tolerance), ("astar", 0.15));
    /// config.settings.tolerance = 0.05; // m
    /// assert!(Id::robot("svc").is_err(), "a reserved name");
    /// # Ok::<(), zenav_protocol::id::InvalidId>(())
    /// ```
    #[must_use]
    pub fn new(robot: Id, holder: impl Into<String>, store: PathBuf) -> Self {
        Self {
            robot,
            holder: holder.into(),
            store,
            places: BTreeMap::new(),
            zones: Arc::default(),
            planner: "astar".to_owned(),
            settings: MissionSettings::default(),
        }
    }
}
