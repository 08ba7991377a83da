//! Deployment. What is it made of, and where did each value come from?
//!
//! | file | answers |
//! |---|---|
//! | `mod` | which sections are there? Those of the libraries are their own settings |
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
use zenav_planning::PlanningSettings;
use zenav_protocol::config_text::{Expected, OutOfBounds, check_all};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::LostPolicy;
use zenav_protocol::settings;
use zenav_protocol::settings::Settings as _;
use zenav_slam::SlamSettings;
use zenav_smoothing::SmoothingSettings;

use crate::connect::{self, DEFAULT_ENDPOINT, ROBOT_ENDPOINT};
use crate::failure::Failure;

pub use hosts::{HostSection, Role};
pub(crate) use layers::Layers;
pub use layers::load;
pub(crate) use security::SecurityArgs;
pub use security::{IdentityArgs, Profile, SecuritySection};
pub use service::Service;
pub use show::{ConfigArgs, run};

settings! {
    /// Which parts run, where they meet, and their settings. The default is one simulated robot and every service on this machine.
    pub struct Deployment {
        /// The router.
        pub router: RouterSection;
        /// How the parts reach the router.
        pub bus: BusSection;
        /// How links are protected.
        pub security: SecuritySection;
        /// The simulated world.
        pub simulation: SimulationSection;
        /// The robots, by id; a file that names any means those and no others.
        pub robots: BTreeMap<String, RobotSection> = one_robot();
        /// The hosts by name, where the parts run on several machines.
        pub hosts: BTreeMap<String, HostSection> = BTreeMap::new();
        /// Groups of robots by name: a goal for a group is done by the nearest of its robots that is free.
        pub groups: BTreeMap<String, Vec<String>> = BTreeMap::new();
        /// The mapping service.
        pub mapping: Service<MappingSection, MappingSettings>;
        /// Poses by SLAM, where `mapping.poses` asks for them.
        pub slam: SlamSettings;
        /// Poses by localisation, where `mapping.poses` asks for them.
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
        /// What is kept on disk.
        pub data: DataSection;
    }
    check = Deployment::fits;
}

settings! {
    /// The router.
    pub struct RouterSection {
        /// Whether `zenav up` runs one.
        pub enabled: bool = true;
        /// Endpoints that it listens on.
        pub listen: Vec<String> = vec![DEFAULT_ENDPOINT.to_owned()];
        /// Other routers to link to.
        pub connect: Vec<String> = Vec::new();
        /// Address of loopback where `GET /KEY` answers with a key's value; empty: none.
        pub rest: String = String::new();
    }
}

settings! {
    /// How the parts reach the router.
    pub struct BusSection {
        /// The router's endpoint; of several, separated by commas, one is enough.
        pub connect: String = DEFAULT_ENDPOINT.to_owned();
        /// What Zenoh puts before every key, such as `site1`, so that two deployments on one router do not see one another; empty: nothing.
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
        /// Simulated time against wall time.
        pub speed: f64 = 1.0, "", 0.001..=1000.0;
    }
}

settings! {
    /// A robot.
    pub struct RobotSection {
        /// Robot file or shipped name.
        pub model: String = "tiago".to_owned();
        /// The edge's own endpoint: works with router and cloud gone. Port 0 takes a free one.
        pub listen: String = "tcp/127.0.0.1:0".to_owned();
        /// What to do when the lease has expired: `finish_horizon` (drive the accepted plan to its expiry), `stop`, and once the link is lost
        /// `wall_follow` (follow walls) or `return_home` (drive back the way it came).
        pub on_lost: LostPolicy = LostPolicy::default();
        /// Whether it is a robot of the world that `zenav sim serve` serves, instead of one simulated in the edge's process.
        pub attach: bool = false;
        /// Whether its body is a process of its own, which publishes `body/readings` and obeys `edge/wheels`: a driver of real motors.
        pub driver: bool = false;
        /// Pose in the world at the start; without it, the world's own.
        pub start: Option<Pose2> = None;
        /// Tunables of the robot's side: `[robots.NAME.edge.collision_monitor]` and so on.
        pub edge: EdgeSettings;
    }
}

settings! {
    /// How the mapping service is run.
    pub struct MappingSection {
        /// Whether it runs.
        pub enabled: bool = true;
        /// From which poses scans are drawn: `edge` (the robot's own estimate, for robots with GPS and compass), `slam` (scans and
        /// odometry alone) or `localise` (in the map that mapping begins with); the robot is then corrected.
        pub poses: PoseSource = PoseSource::Edge;
        /// Known map to begin with, a `map_server` description or an image; without it, the stored one.
        pub map: Option<PathBuf> = None;
        /// Whether scans are inserted into the known map; otherwise it is held.
        pub live: bool = false;
    }
}

settings! {
    /// How planning and smoothing workers are run.
    pub struct PlanningSection {
        /// How many run.
        pub workers: usize = 1, "", 1..=64;
        /// Planner that missions ask for.
        pub planner: String = "astar".to_owned();
    }
}

settings! {
    /// Zones of the map, in which all robots are: each robot's map frame is the same.
    pub struct ZonesSection {
        /// A file of keep-out and speed zones; none without it.
        pub file: Option<PathBuf> = None;
    }
}

settings! {
    /// How the mission orchestrator is run.
    pub struct MissionSection {
        /// Whether it runs.
        pub enabled: bool = true;
        /// Its name as a lease holder.
        pub holder: String = "mission".to_owned();
    }
}

settings! {
    /// How the mission-control page is run.
    pub struct GatewaySection {
        /// Whether `zenav up` and `zenav demo` serve it.
        pub enabled: bool = true;
    }
}

settings! {
    /// What is kept on disk.
    pub struct DataSection {
        /// Folder for maps, goals, and the edges' epochs.
        pub dir: PathBuf = "zenav-data".into();
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
                return Err(OutOfBounds {
                    key: format!("robots.{name}.driver"),
                    problem: "is set, and so is `attach`: expected one body".to_owned(),
                });
            }
        }
        let robots = self.robots.iter();
        let endpoints = robots
            .map(|(name, robot)| (format!("robots.{name}.listen"), &robot.listen))
            .chain(
                self.router
                    .listen
                    .iter()
                    .map(|endpoint| ("router.listen".to_owned(), endpoint)),
            );
        let addresses = [
            ("router.rest", &self.router.rest),
            ("gateway.listen", &self.gateway.settings.listen),
        ];
        let addresses = addresses.into_iter().filter(|(_, address)| !address.is_empty());
        let all = endpoints
            .map(|(key, text)| (key, text, connect::endpoint(text)))
            .chain(addresses.map(|(key, text)| (key.to_owned(), text, connect::address(text))));
        for (key, text, read) in all {
            read.map_err(|expected| OutOfBounds {
                key,
                problem: format!("is `{text}`: {expected}"),
            })?;
        }
        if self.robots.is_empty() {
            return Err(OutOfBounds {
                key: "robots".to_owned(),
                problem: "names no robot: expected at least one section [robots.NAME]".to_owned(),
            });
        }
        Ok(())
    }

    /// The source of poses of mapping.
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

    /// The files that its services read, by key.
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

    /// The groups' names and robots, checked. A part that looks after one robot has the others' sections no more: whether the deployment has
    /// all of a group is looked at when its file is read.
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
            Some(robot) => {
                let known: Vec<&str> = self.robots.keys().map(String::as_str).collect();
                Err(Failure::usage(format!(
                    "[groups] {name}: no robot `{robot}` under [robots]: there are {}",
                    known.join(", ")
                )))
            }
        }
    }
}
