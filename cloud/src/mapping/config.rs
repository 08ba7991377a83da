//! Configuration. What is a mapping service given, and why does it not run?

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use serde_json::Value;
use thiserror::Error;
use zenav_mapping::MappingSettings;
use zenav_protocol::bus::BusError;
use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::GoalPoint;
use zenav_space::Zones;

use super::PoseSettings;

/// Configuration of one robot's mapping.
#[derive(Clone, Debug, PartialEq)]
pub struct MappingConfig {
    /// Id of the robot.
    pub robot: String,
    /// How scans become a map.
    pub settings: MappingSettings,
    /// Source of the poses from which scans are drawn.
    pub poses: PoseSettings,
    /// Folder in which the map is stored as `map.pgm`, `map.yaml` and `map.json`; without it, nothing is stored.
    pub folder: Option<PathBuf>,
    /// Map to start with, instead of the stored one.
    pub known: Option<KnownMap>,
    /// Named goals that every map of the robot has, map frame.
    pub places: BTreeMap<String, GoalPoint>,
    /// Zones that every map of the robot has.
    pub zones: Arc<Zones>,
}

/// A map that mapping starts with.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownMap {
    /// Occupancy of every cell.
    pub grid: Arc<OccupancyGrid>,
    /// Whether scans are inserted into it; otherwise the map is held.
    pub live: bool,
}

impl MappingConfig {
    /// Mapping for a robot with default settings and no folder.
    #[must_use]
    pub fn new(robot: impl Into<String>) -> Self {
        Self {
            robot: robot.into(),
            settings: MappingSettings::default(),
            poses: PoseSettings::default(),
            folder: None,
            known: None,
            places: BTreeMap::new(),
            zones: Arc::default(),
        }
    }

    /// The settings needed to draw the same map from the same scans again.
    pub(super) fn told(&self) -> BTreeMap<String, Value> {
        [
            ("mapping", serde_json::to_value(&self.settings)),
            ("poses", serde_json::to_value(self.poses)),
        ]
        .into_iter()
        .filter_map(|(section, settings)| Some((section.to_owned(), settings.ok()?)))
        .collect()
    }
}

/// Why mapping does not run.
#[derive(Debug, Error)]
pub enum MappingError {
    /// A setting is out of bounds.
    #[error("mapping: {0}")]
    Settings(#[from] OutOfBounds),
    /// There is no stored map to localise in.
    #[error(
        "mapping: `poses = \"localise\"` needs a map, and {0} has none stored: name one with `mapping.map` or `--map`, or take `slam`"
    )]
    NoMap(String),
    /// The stored map to localise in cannot be read.
    #[error("mapping: the map stored in {}: {problem}; mend it, move it away, or store another one", folder.display())]
    StoredMap {
        /// Folder that the files are in.
        folder: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// The session of SLAM exists, but cannot be read or set aside.
    #[error("mapping: the session of SLAM in {}: {problem}; mend it or move it away: it is not dropped silently", folder.display())]
    Session {
        /// Folder that the files are in.
        folder: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// The stored places and zones cannot be read.
    #[error("{}: {problem}; mend the file or remove it: the places and zones in it are not dropped silently", file.display())]
    Annotations {
        /// The file of places and zones.
        file: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// Another mapping service uses the folder.
    #[error("{}: in use by another mapping service; expected one for each robot and folder", .0.display())]
    InUse(PathBuf),
    /// The bus was closed, or a key could not be declared.
    #[error(transparent)]
    Bus(#[from] BusError),
}
