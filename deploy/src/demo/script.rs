//! Script. The scenarios: their trees, worlds and robots, and what happens in them.

use clap::ValueEnum;
use zenav_cloud::mapping::PoseSource;
use zenav_protocol::geometry::Pose2;

use super::refusals::Impossible;

/// Definition of a scenario.
#[derive(Clone, Copy, Debug)]
pub(super) struct Script {
    /// Its name.
    pub name: &'static str,
    /// Its tree.
    pub tree: &'static str,
    /// Source of the poses for mapping. With any source but the robot itself, the robot has neither GPS nor compass.
    pub poses: PoseSource,
    /// Kidnapping of the robot.
    pub carried: Option<Carried>,
    /// A shipped world.
    pub world: &'static str,
    /// Name of the robot, and its shipped model.
    pub robot: (&'static str, &'static str),
    /// Planner; `None` for the deployment's own.
    pub planner: Option<&'static str>,
    /// Time limit of the scenario, simulated, s.
    pub time_limit: f64,
    /// Whether a map from an earlier run is used.
    pub uses_stored_map: bool,
    /// Goals that must be refused after the first drive has started.
    pub impossible: &'static [Impossible],
    /// Whether a picture is drawn at the end of every drive.
    pub drawn: bool,
    /// Whether the robot follows walls on its own: no cloud and no goal.
    pub alone: bool,
}

/// Kidnapping of the robot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Carried {
    /// After this driven distance, m.
    pub after: f64,
    /// New pose.
    pub to: Pose2,
}

/// Scenarios.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Scenario {
    /// Map a kitchen by SLAM, then drive to its corner and to the sink; with a map of an earlier run in --out, localise in that map
    /// instead
    Kitchen,
    /// Follow the walls of a room for ten minutes, without a cloud
    #[value(name = "wall_follow", alias = "wall-follow")]
    WallFollow,
    /// Drive to four rooms of an unknown house, planning while the map grows
    Online,
    /// Like kitchen, but map anew in every run: a map in --out is never used
    Slam,
    /// Carry a robot away: it finds itself in its map again
    Kidnapped,
}

impl Scenario {
    pub const fn script(self) -> Script {
        match self {
            Self::Kitchen => KITCHEN,
            Self::WallFollow => WALL_FOLLOW,
            Self::Online => ONLINE,
            Self::Slam => SLAM,
            Self::Kidnapped => KIDNAPPED,
        }
    }

    /// Whether the scenario's robot may have GPS and a compass.
    pub const fn has_gps(self) -> bool {
        matches!(self, Self::Kitchen | Self::Online)
    }
}

/// Map the kitchen while driving around its table twice, store the map, drive to the corner and to the sink.
const KITCHEN: Script = Script {
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

/// The kitchen's drives, in a map that SLAM makes anew in every run.
const SLAM: Script = Script {
    name: "slam",
    uses_stored_map: false,
    ..KITCHEN
};

/// A robot with a map of the house is carried into another room during its drive. It detects this, has itself searched for in the whole
/// map, and still reaches its goals.
const KIDNAPPED: Script = Script {
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
    uses_stored_map: false,
    ..KITCHEN
};

/// A small robot in an unknown house drives to one room after another while the map grows, and plans through unseen space as if free;
/// meanwhile unreachable goals are refused.
const ONLINE: Script = Script {
    name: "online",
    tree: "online",
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
    ..KITCHEN
};

/// A Neato with 360 beams and a bumper follows the walls of a room with inner and outer corners for ten minutes, without a cloud and
/// without a goal.
const WALL_FOLLOW: Script = Script {
    name: "wall_follow",
    tree: "wall_follow",
    poses: PoseSource::Edge,
    world: "wall_follow",
    robot: ("neato", "neato"),
    time_limit: 600.0,
    uses_stored_map: false,
    alone: true,
    ..KITCHEN
};
