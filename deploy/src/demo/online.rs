//! `zenav demo online`: a small robot in an unknown house drives to one room after another while the map grows, and plans through unseen
//! space as if free; meanwhile unreachable goals are refused.

use zenav_cloud::mapping::PoseSource;

use super::Script;
use super::refusals::Impossible;

pub(super) const SCRIPT: Script = Script {
    name: "online",
    tree: "online",
    poses: PoseSource::Slam,
    carried: None,
    world: "house",
    robot: ("waffle", "turtlebot3_waffle"),
    planner: Some("rrt_star"),
    time_limit: 900.0,
    uses_stored_map: false,
    impossible: &[
        Impossible {
            name: "in the wall of the hall",
            x: 6.4,
            y: 3.1,
        },
        Impossible {
            name: "far outside the house",
            x: 5.5,
            y: -40.0,
        },
    ],
    drawn: true,
    alone: false,
};
