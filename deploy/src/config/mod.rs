//! Deployment. What it consists of, and where each value comes from.
//!
//! | file | answers |
//! |---|---|
//! | `mod` | which sections are there? Those of the libraries are the libraries' own settings |
//! | `security` | how are links protected? |
//! | `hosts` | sections of a deployment of many hosts |
//! | `layers` | defaults, a file, the environment: which value counts, and what is wrong with one? |
//! | `service` | does a service run, and with which of its library's settings? |
//! | `show` | `zenav config show`: every value with unit, default, bounds and origin |

mod hosts;
mod layers;
mod security;
mod service;
mod show;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use zenav_cloud::mapping::{PoseSettings, PoseSource};
use zenav_cloud::motion::MotionSettings;
use zenav_edge::EdgeSettings;
use zenav_gateway::GatewaySettings;
use zenav_localisation::LocalisationSettings;
use zenav_mapping::MappingSettings;
use zenav_mission::MissionSettings;
use zenav_planning::{Planner, PlanningSettings};
use zenav_protocol::config_text::{Expected, OutOfBounds, check_all};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::LostPolicy;
use zenav_protocol::settings;
use zenav_protocol::settings::Settings as _;
use zenav_slam::SlamSettings;
use zenav_smoothing::SmoothingSettings;

use crate::arguments;
use crate::connect::{DEFAULT_ENDPOINT, ROBOT_ENDPOINT};
use crate::failure::Failure;
use crate::output::listed;

pub use hosts::{HostSection, Role};
pub(crate) use layers::Layers;
pub use layers::load;
pub(crate) use security::SecurityArgs;
pub use security::{IdentityArgs, Profile, SecuritySection};
pub use service::Service;
pub use show::{ConfigArgs, run};

settings! {
    /// Which parts run, how they connect, and their settings. The default is one simulated robot and every service on this machine.
    pub struct Deployment {
        /// The router.
        pub router: RouterSection;
        /// How parts reach the router.
        pub bus: BusSection;
        /// How links are protected.
        pub security: SecuritySection;
        /// The simulated world.
        pub simulation: SimulationSection;
        /// Robots by id; a file that names any replaces the default robot.
        pub robots: BTreeMap<String, RobotSection> = one_robot();
        /// Hosts by name, if the parts run on several machines.
        pub hosts: BTreeMap<String, HostSection> = BTreeMap::new();
        /// Groups of robots by name: the nearest free robot of a group takes a goal for the group.
        pub groups: BTreeMap<String, Vec<String>> = BTreeMap::new();
        /// The mapping service.
        pub mapping: Service<MappingSection, MappingSettings>;
        /// Pose estimation by SLAM, if `mapping.poses` asks for it.
        pub slam: SlamSettings;
        /// Pose estimation by localisation, if `mapping.poses` asks for it.
        pub localisation: LocalisationSettings;
        /// Motion workers.
        pub planning: Service<PlanningSection, PlanningSettings>;
        /// How paths become trajectories.
        pub smoothing: SmoothingSettings;
        /// Zones of the map.
        pub zones: ZonesSection;
        /// The mission orchestrator.
        pub mission: Service<MissionSection, MissionSettings>;
        /// The mission-control page.
        pub gateway: Service<GatewaySection, GatewaySettings>;
        /// Data on disk.
        pub data: DataSection;
    }
    check = Deployment::fits;
}

settings! {
    /// The router.
    pub struct RouterSection {
        /// Whether `zenav up` runs one.
        pub enabled: bool = true;
        /// Endpoints to listen on.
        pub listen: Vec<String> = vec![DEFAULT_ENDPOINT.to_owned()];
        /// Other routers to link to.
        pub connect: Vec<String> = Vec::new();
        /// Loopback address that answers `GET /KEY` with a key's value; empty: none.
        pub rest: String = String::new();
        /// Whether it answers Zenoh's multicast scouting, so that Zenoh's tools on this network find it without its endpoint.
        pub scouting: bool = false;
    }
}

settings! {
    /// How parts reach the router.
    pub struct BusSection {
        /// Endpoint of the router, or several separated by commas, of which one must be reachable.
        pub connect: String = DEFAULT_ENDPOINT.to_owned();
        /// Prefix that Zenoh puts before every key, such as `site1`: separates two deployments on one router; empty: none.
        pub namespace: String = String::new();
    }
}

settings! {
    /// The simulated world.
    pub struct SimulationSection {
        /// World file or shipped name.
        pub world: String = "kitchen".to_owned();
        /// Seed of all noise.
        pub seed: u64 = 1;
        /// Simulated time relative to wall time.
        pub speed: f64 = 1.0, "", 0.001..=1000.0;
    }
}

settings! {
    /// A robot.
    pub struct RobotSection {
        /// Robot file or shipped name.
        pub model: String = "tiago".to_owned();
        /// The edge's own endpoint: works without router and cloud. Port 0 takes a free one.
        pub listen: String = "tcp/127.0.0.1:0".to_owned();
        /// Behaviour after the lease expires: `finish_horizon` (drive the accepted plan to its expiry), `stop`, and after the link is lost
        /// `wall_follow` (follow walls) or `return_home` (drive back along the path it came).
        pub on_lost: LostPolicy = LostPolicy::default();
        /// Whether the robot lives in the world that `zenav sim serve` serves; otherwise the edge's process simulates it.
        pub attach: bool = false;
        /// Whether the body is a separate process, a driver of real motors, that publishes `body/readings` and obeys `edge/wheels`.
        pub driver: bool = false;
        /// Start pose in the world; without it, the world's own.
        pub start: Option<Pose2> = None;
        /// Settings of the robot's side: `[robots.NAME.edge.collision_monitor]` and so on.
        pub edge: EdgeSettings;
    }
}

settings! {
    /// How the mapping service runs.
    pub struct MappingSection {
        /// Whether it runs.
        pub enabled: bool = true;
        /// Poses at which scans are inserted: `edge` (the robot's own estimate, for robots with GPS and compass), `slam` (scans and
        /// odometry, with GPS and compass if present) or `localise` (in the map that mapping starts with); `slam` and `localise` also
        /// correct the robot's pose.
        pub poses: PoseSource = PoseSource::Edge;
        /// Known map to start with, a `map_server` description or an image; without it, the stored one.
        pub map: Option<PathBuf> = None;
        /// Whether scans are inserted into the known map; otherwise it stays unchanged.
        pub live: bool = false;
    }
}

settings! {
    /// How the motion workers (planning and smoothing) run.
    pub struct PlanningSection {
        /// Number of workers.
        pub workers: usize = 1, "", 1..=64;
        /// Planner that missions request: `astar`, `jps`, `theta`, `rrt`, `rrt_connect` or `rrt_star`.
        pub planner: String = "astar".to_owned();
    }
}

settings! {
    /// Zones of the map. All robots share one map frame.
    pub struct ZonesSection {
        /// File of keep-out and speed zones; without it, none.
        pub file: Option<PathBuf> = None;
    }
}

settings! {
    /// How the mission orchestrator runs.
    pub struct MissionSection {
        /// Whether it runs.
        pub enabled: bool = true;
        /// Its name as a lease holder.
        pub holder: String = "mission".to_owned();
    }
}

settings! {
    /// How the mission-control page is served.
    pub struct GatewaySection {
        /// Whether `zenav up` and `zenav demo` serve it.
        pub enabled: bool = true;
    }
}

settings! {
    /// Data on disk.
    pub struct DataSection {
        /// Folder for maps, goals, and the edges' epochs; a relative one is in the working directory.
        pub dir: PathBuf = "zenav-data".into();
    }
}

/// A value of a key that cannot be.
fn wrong(key: impl Into<String>, problem: impl Into<String>) -> OutOfBounds {
    OutOfBounds {
        key: key.into(),
        problem: problem.into(),
    }
}

fn one_robot() -> BTreeMap<String, RobotSection> {
    let robot = RobotSection {
        listen: ROBOT_ENDPOINT.to_owned(),
        ..RobotSection::default()
    };
    [("tiago".to_owned(), robot)].into()
}

impl Deployment {
    fn fits(&self) -> Result<(), OutOfBounds> {
        for (name, robot) in &self.robots {
            let start = robot.start.unwrap_or_default();
            robot
                .check()
                .and_then(|()| check_all(&[("start.yaw", start.yaw, Expected::Angle)]))
                .map_err(|error| error.within(name).within("robots"))?;
            if robot.attach && robot.driver {
                let key = format!("robots.{name}.driver");
                return Err(wrong(key, "is set, and so is `attach`: expected one body"));
            }
        }
        let robots = self.robots.iter();
        let of_robots = robots.map(|(name, robot)| (format!("robots.{name}.listen"), &robot.listen));
        let RouterSection { listen, connect, .. } = &self.router;
        let of_router = [("router.listen", listen), ("router.connect", connect)];
        let of_router = of_router
            .into_iter()
            .flat_map(|(key, all)| all.iter().map(move |endpoint| (key.to_owned(), endpoint)));
        let endpoints = of_robots.chain(of_router);
        let addresses = [
            ("router.rest", &self.router.rest),
            ("gateway.listen", &self.gateway.settings.listen),
        ];
        let addresses = addresses.into_iter().filter(|(_, address)| !address.is_empty());
        let all = endpoints
            .map(|(key, text)| (key, text, arguments::endpoint(text)))
            .chain(addresses.map(|(key, text)| (key.to_owned(), text, arguments::address(text))));
        for (key, text, read) in all {
            read.map_err(|expected| wrong(key, format!("is `{text}`: {expected}")))?;
        }
        // On hosts of a deployment routers run where `runs` says.
        if !self.router.enabled && self.hosts.is_empty() {
            let asked = [
                ("router.connect", !self.router.connect.is_empty()),
                ("router.rest", !self.router.rest.is_empty()),
                ("router.scouting", self.router.scouting),
            ];
            if let Some((key, _)) = asked.into_iter().find(|(_, is_asked)| *is_asked) {
                let problem = "is set, and `router.enabled` is false: expected a router, or none of its settings";
                return Err(wrong(key, problem));
            }
        }
        let planner = &self.planning.run.planner;
        if planner.parse::<Planner>().is_err() {
            let known = listed(Planner::ALL.iter().map(|(name, _)| name));
            return Err(wrong(
                "planning.planner",
                format!("is `{planner}`: expected one of {known}"),
            ));
        }
        if self.robots.is_empty() {
            let problem = "names no robot: expected at least one section [robots.NAME]";
            return Err(wrong("robots", problem));
        }
        Ok(())
    }

    /// Source of mapping's poses.
    #[must_use]
    pub fn poses(&self) -> PoseSettings {
        PoseSettings {
            source: self.mapping.run.poses,
            slam: self.slam,
            localisation: self.localisation,
        }
    }

    /// Settings of the motion workers.
    #[must_use]
    pub fn motion(&self) -> MotionSettings {
        MotionSettings {
            planning: self.planning.settings.clone(),
            smoothing: self.smoothing,
        }
    }

    /// Files that the deployment's services read, by key.
    pub(crate) fn files(&self) -> [(&'static str, Option<&Path>); 2] {
        [
            ("mapping.map", self.mapping.run.map.as_deref()),
            ("zones.file", self.zones.file.as_deref()),
        ]
    }

    /// Folder for a robot's files.
    #[must_use]
    pub fn robot_dir(&self, robot: &Id) -> PathBuf {
        self.data.dir.join(robot.as_str())
    }

    /// The robots' checked ids with their sections.
    ///
    /// # Errors
    /// A usage failure that names the bad id.
    pub fn robot_ids(&self) -> Result<Vec<(Id, &RobotSection)>, Failure> {
        self.robots
            .iter()
            .map(|(name, section)| {
                Id::robot(name.clone())
                    .map(|id| (id, section))
                    .map_err(|error| Failure::usage(format!("[robots.{name}]: {error}")))
            })
            .collect()
    }

    /// Names and robots of the groups, each checked by itself. Whether every robot of a group has a section is checked when the file is
    /// read: a part for one robot no longer has the other robots' sections.
    ///
    /// # Errors
    /// A usage failure that names the bad group.
    pub fn group_ids(&self) -> Result<Vec<(Id, Vec<Id>)>, Failure> {
        let groups = self.groups.iter();
        groups.map(|(name, robots)| self.group(name, robots)).collect()
    }

    fn group(&self, name: &str, robots: &[String]) -> Result<(Id, Vec<Id>), Failure> {
        let bad = |why: String| Failure::usage(format!("[groups] {name}: {why}"));
        let group = Id::robot(name).map_err(|error| bad(error.to_string()))?;
        if self.robots.contains_key(name) {
            return Err(bad("a robot has this name".to_owned()));
        }
        if robots.is_empty() {
            return Err(bad("expected names of robots".to_owned()));
        }
        let members: Result<Vec<Id>, _> = robots.iter().map(|robot| Id::robot(robot.clone())).collect();
        Ok((group, members.map_err(|error| bad(error.to_string()))?))
    }

    /// Whether all robots of a group have a section.
    fn has_robots(&self, name: &str, robots: &[String]) -> Result<(), Failure> {
        match robots.iter().find(|robot| !self.robots.contains_key(*robot)) {
            None => Ok(()),
            Some(robot) => Err(Failure::usage(format!(
                "[groups] {name}: no robot `{robot}` under [robots]: there are {}",
                listed(self.robots.keys())
            ))),
        }
    }
}
