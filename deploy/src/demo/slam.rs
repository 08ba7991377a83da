//! `zenav demo slam`: the kitchen's drives by a robot without GPS and compass, in a map that SLAM makes during the run.

use zenav_cloud::mapping::PoseSource;

use super::Script;

pub(super) const SCRIPT: Script = Script {
    name: "slam",
    tree: "kitchen",
    poses: PoseSource::Slam,
    carried: None,
    world: "kitchen",
    robot: ("tiago", "tiago"),
    planner: None,
    time_limit: 300.0,
    uses_stored_map: false,
    impossible: &[],
    drawn: false,
    alone: false,
};
