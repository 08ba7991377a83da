//! A robot indoors, with its cloud services, in lockstep: it has neither GPS nor compass.

use zenav::lockstep::{ClosedLoop, ClosedLoopConfig};
use zenav_cloud::mapping::{PoseSettings, PoseSource};
use zenav_cloud::motion::MotionSettings;
use zenav_edge::EdgeConfig;
use zenav_mapping::MappingSettings;
use zenav_mission::MissionConfig;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::id::Id;
use zenav_protocol::messages::GoalRequest;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::topics::MissionRequest;
use zenav_sim::{RobotSpec, Simulation, World};

/// The world of a text without a map.
pub(super) fn world(text: &str, name: &str) -> Result<World, String> {
    World::from_toml(text, name, &|name| Err(name.to_owned())).map_err(|error| error.to_string())
}

/// The robot.
pub(super) fn model() -> Result<RobotModel, String> {
    RobotModel::with_options("tiago+indoor", |name| Err(name.to_owned())).map_err(|error| error.to_string())
}

/// The robot at the world's start; plans come `cloud_delay` (s) after their scan, on average.
pub(super) fn stage(
    world: &World,
    source: PoseSource,
    known_map: Option<OccupancyGrid>,
    cloud_delay: f64,
    seed: u64,
) -> Result<ClosedLoop, String> {
    stage_with(world, model()?, source, known_map, cloud_delay, seed)
}

/// The same, with a body that may differ from the model that the robot is told.
pub(super) fn stage_with(
    world: &World,
    body: RobotModel,
    source: PoseSource,
    known_map: Option<OccupancyGrid>,
    cloud_delay: f64,
    seed: u64,
) -> Result<ClosedLoop, String> {
    let id = Id::robot("tiago").map_err(|error| error.to_string())?;
    let (model, start) = (model()?, world.start());
    let config = ClosedLoopConfig {
        edge: EdgeConfig::new(id.clone(), model, start),
        mission: MissionConfig::new(id.clone(), "mission", "unused".into()),
        mapping: MappingSettings::default(),
        poses: PoseSettings {
            source,
            ..PoseSettings::default()
        },
        motion: MotionSettings::default(),
        known_map,
        cloud_delay,
        seed,
    };
    let spec = RobotSpec { id, model: body, start };
    let simulation = Simulation::new(world, vec![spec], seed).map_err(|error| error.to_string())?;
    Ok(ClosedLoop::new(simulation, vec![config]))
}

/// A goal at a place, m.
pub(super) fn goal(id: &str, x: f64, y: f64) -> MissionRequest {
    MissionRequest::Goal(GoalRequest {
        id: Some(id.to_owned()),
        x: Some(x),
        y: Some(y),
        ..GoalRequest::default()
    })
}
