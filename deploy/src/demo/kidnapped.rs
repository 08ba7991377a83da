//! `zenav demo kidnapped`: a robot with a map of the house is carried into another room during its drive. It detects this, has itself
//! searched for in the whole map, and still reaches its goals.

use zenav_cloud::mapping::PoseSource;
use zenav_protocol::geometry::Pose2;

use super::{Carried, Script};

pub(super) const SCRIPT: Script = Script {
    name: "kidnapped",
    tree: "kidnapped",
    poses: PoseSource::Localise,
    carried: Some(Carried {
        after: 2.0,
        to: Pose2 {
            x: 8.2,
            y: 6.4,
            yaw: 2.0,
        },
    }),
    world: "house",
    robot: ("tiago", "tiago"),
    planner: None,
    time_limit: 300.0,
    uses_stored_map: false,
    impossible: &[],
    drawn: false,
    alone: false,
};
