//! `zenav demo kitchen`: map the kitchen while driving around its table twice, store the map, drive to the corner and to the sink.

use zenav_cloud::mapping::PoseSource;

use super::Script;

pub(super) const SCRIPT: Script = Script {
    name: "kitchen",
    tree: "kitchen",
    poses: PoseSource::Slam,
    carried: None,
    world: "kitchen",
    robot: ("tiago", "tiago"),
    planner: None,
    time_limit: 300.0,
    uses_stored_map: true,
    impossible: &[],
    drawn: false,
    alone: false,
};
