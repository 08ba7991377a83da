//! Components. Starts and stops parts that share a process.
//!
//! Every part has its own Zenoh session, even if parts share a process: no data is passed in memory.

use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use clap::ValueEnum;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::Instant;
use zenav_cloud::mapping::{self, KnownMap, MappingConfig};
use zenav_cloud::mission::MissionError;
use zenav_cloud::{dispatch, motion};
use zenav_edge::{Attached, Body, EdgeConfig, Referee, RemoteBody, ServiceConfig, SimBody};
use zenav_mission::MissionConfig;
use zenav_protocol::bus::{Bus, BusConfig, BusError, Clock, Security, Shutdown};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::GoalPoint;
use zenav_protocol::robot::RobotModel;
use zenav_sim::{RobotSpec, SimError, Simulation, World};

use crate::config::{Deployment, RobotSection};
use crate::exit_code;
use crate::failure::Failure;
use crate::files;
use crate::tasks::boxed;

/// Time limit for all parts to end.
const DRAIN: Duration = Duration::from_secs(8);

/// Missions that share a session. Zenoh compares the key of each message, sent or received, with all subscriptions of its session, and a
/// session of a hundred missions spent about a third of its time there; each further session costs a link, and some memory.
const MISSIONS_A_SESSION: usize = 8;

/// Pause before a failed mission is restarted: initial and largest.
const MISSION_PAUSE: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));

/// A start pose where no robot can be: in which world, and what says where. The known map is not the world, which is easily mistaken.
fn bad_start(deployment: &Deployment, world: &World, robot: &Id, error: &SimError) -> Failure {
    let option = if deployment.robots.len() == 1 {
        "`--pose`, or "
    } else {
        ""
    };
    let mut told = format!(
        "world `{}`: {error}; {option}`start` of [robots.{robot}] says where",
        world.name()
    );
    let map = deployment
        .mapping
        .run
        .map
        .as_deref()
        .map(|map| map.display().to_string());
    // A map's description counts as a world, an image does not.
    let is_world = |map: &String| map.ends_with(".yaml") || map.ends_with(".yml");
    if let Some(map) = map.filter(|map| is_world(map) && *map != deployment.simulation.world) {
        told.push_str(&format!(
            ". The simulated robot drives in the world, not in the map: `--world {map}` makes a world of the map"
        ));
    }
    Failure::usage(told)
}

/// Off-board services.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CloudPart {
    /// Maps from scans
    Mapping,
    /// Motion workers: paths and trajectories
    #[value(alias = "planning")]
    Motion,
    /// Missions of the deployment's robots
    Mission,
    /// All off-board services
    All,
}

/// Clock of a deployment's services.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Time {
    /// Simulated time, published by the world.
    Simulated,
    /// Wall time: every body is a driver of real motors, and no simulated clock is published.
    Wall,
}

impl Time {
    fn of(deployment: &Deployment) -> Self {
        if deployment.robots.values().all(|robot| robot.driver) {
            Self::Wall
        } else {
            Self::Simulated
        }
    }

    fn clock(self, bus: &Bus) -> Result<Clock, BusError> {
        match self {
            Self::Simulated => Clock::follow(bus),
            Self::Wall => Ok(Clock::wall()),
        }
    }
}

/// The parts running in this process.
#[derive(Debug)]
pub struct Parts {
    tasks: JoinSet<(String, Result<(), Failure>)>,
    shutdown: Shutdown,
    security: Security,
    /// Number of parts that have not started: they wait for a router, or for a world.
    waiting: Arc<watch::Sender<usize>>,
}

impl Default for Parts {
    fn default() -> Self {
        Self::new(Security::default())
    }
}

impl Parts {
    /// No parts yet; `security` protects the links of all later ones.
    pub(crate) fn new(security: Security) -> Self {
        Self {
            tasks: JoinSet::new(),
            shutdown: Shutdown::new(),
            security,
            waiting: Arc::new(watch::Sender::new(0)),
        }
    }

    /// Protection of the links of all parts.
    pub(crate) fn security(&self) -> &Security {
        &self.security
    }

    /// Bus configuration of a part of a deployment.
    pub(crate) fn bus(&self, deployment: &Deployment, name: &str) -> BusConfig {
        BusConfig {
            security: self.security.clone(),
            ..BusConfig::service(name, &deployment.bus.connect).within(&deployment.bus.namespace)
        }
    }

    fn edge_bus(&self, deployment: &Deployment, id: &Id, section: &RobotSection) -> BusConfig {
        BusConfig {
            listen: vec![section.listen.clone()],
            is_narrow: true,
            ..self.bus(deployment, &format!("edge-{id}"))
        }
    }

    /// Runs a part on its own bus until shutdown.
    pub(crate) fn spawn<F, R>(&mut self, name: String, bus: BusConfig, part: F)
    where
        F: FnOnce(Bus, Shutdown) -> R + Send + 'static,
        R: Future<Output = Result<(), Failure>> + Send + 'static,
    {
        let opening = async { Ok((Bus::open(bus).await?, ())) };
        self.spawn_once(name, opening, |bus, (), shutdown| part(bus, shutdown));
    }

    /// Runs a part until shutdown, on the bus (and any further resource) that `opening` provides once it completes.
    fn spawn_once<T, O, F, R>(&mut self, name: String, opening: O, part: F)
    where
        T: Send + 'static,
        O: Future<Output = Result<(Bus, T), Failure>> + Send + 'static,
        F: FnOnce(Bus, T, Shutdown) -> R + Send + 'static,
        R: Future<Output = Result<(), Failure>> + Send + 'static,
    {
        let (shutdown, waiting) = (self.shutdown.clone(), Arc::clone(&self.waiting));
        waiting.send_modify(|count| *count += 1);
        self.tasks.spawn(boxed(async move {
            // A part waits for a missing router or world, but shutdown must not.
            let opened = tokio::select! {
                opened = opening => opened,
                () = shutdown.wait() => return (name, Ok(())),
            };
            let (bus, with) = match opened {
                Ok(opened) => opened,
                Err(error) => return (name, Err(error)),
            };
            waiting.send_modify(|count| *count -= 1);
            let result = part(bus.clone(), with, shutdown).await;
            bus.close().await;
            (name, result)
        }));
    }

    /// Starts the deployment's robots. Those simulated here share one world and its time; returns their referees, in order of their ids.
    /// Robots of a served world reach it at `world_endpoint`, or if there is none on the deployment's bus.
    ///
    /// # Errors
    /// Bad files, or a start pose that is occupied.
    pub fn edges(
        &mut self,
        deployment: &Deployment,
        world: &World,
        world_endpoint: Option<&str>,
    ) -> Result<Vec<Referee>, Failure> {
        let mut here = Vec::new();
        let mut specs = Vec::new();
        for (id, section) in deployment.robot_ids()? {
            self.security.check_robot(&id, !section.attach)?;
            let model = files::robot(&section.model)?;
            let start = section.start.map(|start| Pose2::new(start.x, start.y, start.yaw));
            if section.attach {
                self.attached(deployment, id, section, model, (start, world_endpoint));
                continue;
            }
            if section.driver {
                self.driven(deployment, id, section, model, start);
                continue;
            }
            specs.push(RobotSpec {
                id: id.clone(),
                model,
                start: start.unwrap_or_else(|| world.start()),
            });
            here.push((id, section));
        }
        if specs.is_empty() {
            return Ok(Vec::new());
        }
        let simulation =
            Simulation::new(world, specs.clone(), deployment.simulation.seed).map_err(|error| match &error {
                SimError::Outside { robot, .. } | SimError::Occupied { robot, .. } | SimError::NotFinite(robot) => {
                    bad_start(deployment, world, robot, &error)
                }
                _ => Failure::usage(&error),
            })?;
        let mut referees = Vec::new();
        for (((id, section), spec), (body, referee)) in here.into_iter().zip(specs).zip(SimBody::all(simulation)) {
            let service = ServiceConfig {
                edge: edge_config(&id, section, spec.model, spec.start),
                state_dir: deployment.robot_dir(&id),
                speed: deployment.simulation.speed,
                gives_the_time: referees.is_empty(),
            };
            referees.push(referee);
            let bus = self.edge_bus(deployment, &id, section);
            self.spawn(format!("edge {id}"), bus, move |bus, shutdown| {
                run_edge(bus, service, Box::new(body), shutdown)
            });
        }
        Ok(referees)
    }

    /// Starts the deployment's only robot simulated here; returns its referee.
    ///
    /// # Errors
    /// As [`edges`](Self::edges), or if there is none.
    pub fn edge(&mut self, deployment: &Deployment, world: &World) -> Result<Referee, Failure> {
        let referee = self.edges(deployment, world, None)?.pop();
        referee.ok_or_else(|| Failure::failed("the deployment has no simulated robot"))
    }

    /// Starts a robot in the world that `zenav sim serve` serves: on the deployment's bus, or at a separate endpoint, to which the robot
    /// opens a session for its body alone, like the wiring of a real one.
    fn attached(
        &mut self,
        deployment: &Deployment,
        id: Id,
        section: &RobotSection,
        model: RobotModel,
        (start, world_endpoint): (Option<Pose2>, Option<&str>),
    ) {
        let (section, state_dir) = (section.clone(), deployment.robot_dir(&id));
        let bus = self.edge_bus(deployment, &id, &section);
        let body_bus = world_endpoint.map(|endpoint| BusConfig {
            security: self.security.clone(),
            ..BusConfig::service(&format!("body-{id}"), endpoint).within(&deployment.bus.namespace)
        });
        let name = format!("edge {id}");
        let attaching = {
            let (id, model, settings) = (id.clone(), model.clone(), section.edge.body.clone());
            async move {
                let attached = RemoteBody::attach(body_bus.as_ref().unwrap_or(&bus), &id, &model, start, &settings);
                let attached = attached.await;
                let Attached {
                    bus: body_bus_open,
                    body,
                    reply,
                } = attached.map_err(|error| Failure::new(exit_code::of_attach(&error), error.to_string()))?;
                match body_bus {
                    None => Ok((body_bus_open, (body, reply, None))),
                    Some(_) => {
                        body_bus_open.started();
                        Ok((Bus::open(bus).await?, (body, reply, Some(body_bus_open))))
                    }
                }
            }
        };
        self.spawn_once(
            name,
            attaching,
            move |bus, (body, reply, body_bus), shutdown| async move {
                let mut edge = edge_config(&id, &section, model, reply.start);
                edge.tick = reply.tick_secs;
                let service = ServiceConfig {
                    edge,
                    state_dir,
                    speed: reply.speed,
                    gives_the_time: false,
                };
                let result = run_edge(bus, service, Box::new(body), shutdown).await;
                if let Some(body_bus) = body_bus {
                    body_bus.close().await;
                }
                result
            },
        );
    }

    /// Starts a robot whose body is a driver process on its bus.
    fn driven(
        &mut self,
        deployment: &Deployment,
        id: Id,
        section: &RobotSection,
        model: RobotModel,
        start: Option<Pose2>,
    ) {
        let service = ServiceConfig {
            edge: edge_config(&id, section, model, start.unwrap_or_default()),
            state_dir: deployment.robot_dir(&id),
            speed: 1.0,
            gives_the_time: false,
        };
        let (bus, settings) = (self.edge_bus(deployment, &id, section), section.edge.body.clone());
        self.spawn(format!("edge {id}"), bus, move |bus, shutdown| async move {
            let body = RemoteBody::new(&bus, id.as_str(), u64::from(std::process::id()), &settings)?;
            run_edge(bus, service, Box::new(body), shutdown).await
        });
    }

    /// Starts mapping for these robots.
    ///
    /// # Errors
    /// A known map or zones that cannot be read.
    pub fn mapping(&mut self, deployment: &Deployment, world: &World, robots: &[Id]) -> Result<(), Failure> {
        let known = match &deployment.mapping.run.map {
            Some(file) => Some(KnownMap {
                grid: Arc::new(files::map(file)?),
                live: deployment.mapping.run.live,
            }),
            None => None,
        };
        let (places, zones) = (places(world), files::zones(deployment.zones.file.as_deref())?);
        let time = Time::of(deployment);
        for id in robots {
            let config = MappingConfig {
                settings: deployment.mapping.settings.clone(),
                poses: deployment.poses(),
                folder: Some(deployment.robot_dir(id)),
                known: known.clone(),
                places: places.clone(),
                zones: Arc::clone(&zones),
                ..MappingConfig::new(id.as_str())
            };
            let bus = self.bus(deployment, &format!("mapping-{id}"));
            self.spawn(format!("mapping {id}"), bus, move |bus, shutdown| async move {
                let clock = time.clock(&bus)?;
                mapping::run(bus, clock, config, shutdown)
                    .await
                    .map_err(Failure::failed)
            });
        }
        Ok(())
    }

    /// Starts motion workers.
    ///
    /// # Errors
    /// An invalid worker name, bad zones.
    pub fn motion(&mut self, deployment: &Deployment, name: &str) -> Result<(), Failure> {
        let zones = files::zones(deployment.zones.file.as_deref())?;
        for number in 1..=deployment.planning.run.workers {
            let worker = Id::new(format!("{name}-{number}")).map_err(Failure::usage)?;
            let name = format!("motion-{worker}");
            let bus = self.bus(deployment, &name);
            let zones = Arc::clone(&zones);
            let (settings, time) = (deployment.motion(), Time::of(deployment));
            self.spawn(format!("motion {worker}"), bus, move |bus, shutdown| async move {
                let clock = time.clock(&bus)?;
                motion::run(bus, clock, worker, zones, settings, shutdown)
                    .await
                    .map_err(Failure::failed)
            });
        }
        Ok(())
    }

    /// Starts robots' missions, some to a session: one orchestrator may serve a hundred robots.
    ///
    /// # Errors
    /// Bad zones.
    pub fn missions(&mut self, deployment: &Deployment, world: &World, robots: &[Id]) -> Result<(), Failure> {
        let (places, zones) = (places(world), files::zones(deployment.zones.file.as_deref())?);
        let config = |id: &Id| MissionConfig {
            robot: id.clone(),
            holder: deployment.mission.run.holder.clone(),
            store: deployment.robot_dir(id).join("mission.redb"),
            places: places.clone(),
            zones: Arc::clone(&zones),
            planner: deployment.planning.run.planner.clone(),
            settings: deployment.mission.settings.clone(),
        };
        let (holder, has_others) = (&deployment.mission.run.holder, robots.len() > 1);
        for (nth, robots) in robots.chunks(MISSIONS_A_SESSION).enumerate() {
            let configs: Vec<MissionConfig> = robots.iter().map(config).collect();
            let name = match nth {
                0 => format!("missions-{holder}"),
                _ => format!("missions-{holder}-{nth}"),
            };
            let (bus, time) = (self.bus(deployment, &name), Time::of(deployment));
            self.spawn(name, bus, move |bus, shutdown| async move {
                let clock = time.clock(&bus)?;
                if nth == 0 {
                    bus.serve_log()?;
                }
                let mut missions = JoinSet::new();
                for config in configs {
                    let (bus, clock, shutdown) = (bus.clone(), clock.clone(), shutdown.clone());
                    missions.spawn(boxed(keep_mission(bus, clock, config, shutdown, has_others)));
                }
                while let Some(ended) = missions.join_next().await {
                    ended.map_err(|error| Failure::failed(format!("a mission broke off: {error}")))??;
                }
                Ok(())
            });
        }
        Ok(())
    }

    /// Starts the dispatcher that takes goals for a group of robots.
    fn dispatch(&mut self, deployment: &Deployment, world: &World, group: Id, robots: Vec<Id>) {
        let bus = self.bus(deployment, &format!("dispatch-{group}"));
        let places = places(world);
        self.spawn(format!("group {group}"), bus, move |bus, shutdown| async move {
            dispatch::service::run(bus, group, robots, places, shutdown)
                .await
                .map_err(Failure::failed)
        });
    }

    /// Starts all enabled off-board services of a deployment.
    ///
    /// # Errors
    /// An invalid worker name, a known map or zones that cannot be read.
    pub fn cloud(
        &mut self,
        deployment: &Deployment,
        world: &World,
        which: CloudPart,
        worker: &str,
    ) -> Result<(), Failure> {
        let wanted = |part| which == CloudPart::All || which == part;
        let robots: Vec<Id> = deployment.robot_ids()?.into_iter().map(|(id, _)| id).collect();
        if wanted(CloudPart::Mapping) && deployment.mapping.run.enabled {
            self.mapping(deployment, world, &robots)?;
        }
        if wanted(CloudPart::Mission) && deployment.mission.run.enabled {
            self.missions(deployment, world, &robots)?;
            for (group, robots) in deployment.group_ids()? {
                self.dispatch(deployment, world, group, robots);
            }
        }
        if wanted(CloudPart::Motion) {
            self.motion(deployment, worker)?;
        }
        Ok(())
    }

    /// Waits until every part has connected to a router and started.
    pub(crate) fn all_begun(&self) -> impl Future<Output = ()> + Send + use<> {
        let mut waiting = self.waiting.subscribe();
        async move {
            let _ = waiting.wait_for(|count| *count == 0).await;
        }
    }

    /// Waits for the first part to end on its own.
    ///
    /// # Errors
    /// The part's failure.
    pub async fn first_end(&mut self) -> Result<(), Failure> {
        match self.tasks.join_next().await {
            None => std::future::pending().await,
            Some(Ok((name, Ok(())))) => Err(Failure::failed(format!("{name} ended by itself"))),
            Some(Ok((name, Err(failure)))) => Err(Failure::new(failure.code, format!("{name}: {failure}"))),
            Some(Err(error)) => Err(Failure::failed(format!("a part broke off: {error}"))),
        }
    }

    /// Ends all parts, with a common time limit; robots stop before their edges end.
    pub async fn end(mut self) {
        self.shutdown.trigger();
        let ended = async {
            while let Some(part) = self.tasks.join_next().await {
                if let Ok((name, Err(failure))) = part {
                    tracing::warn!(name, %failure, "a part did not end well");
                }
            }
        };
        if tokio::time::timeout(DRAIN, ended).await.is_err() {
            tracing::warn!("some parts did not end in time");
        }
    }
}

/// Configuration of a robot's edge.
pub(crate) fn edge_config(id: &Id, section: &RobotSection, model: RobotModel, start: Pose2) -> EdgeConfig {
    let mut edge = EdgeConfig::new(id.clone(), model, start);
    edge.on_lost = section.on_lost;
    edge.settings = section.edge.clone();
    edge
}

async fn run_edge(bus: Bus, service: ServiceConfig, body: Box<dyn Body>, shutdown: Shutdown) -> Result<(), Failure> {
    let endpoints = bus.endpoints().await;
    tracing::info!(robot = %service.edge.robot, ?endpoints, "the robot's own endpoint");
    zenav_edge::run(bus, service, body, shutdown)
        .await
        .map_err(Failure::failed)
}

/// Runs a robot's mission. A failed mission ends the part; if the part serves other robots too, only the mission is restarted, after a
/// pause.
async fn keep_mission(
    bus: Bus,
    clock: Clock,
    config: MissionConfig,
    shutdown: Shutdown,
    has_others: bool,
) -> Result<(), Failure> {
    let mut pause = MISSION_PAUSE.0;
    loop {
        let began = Instant::now();
        let (bus, clock) = (bus.clone(), clock.clone());
        let ended = zenav_cloud::mission::run(bus, clock, config.clone(), shutdown.clone()).await;
        let error = match ended {
            Err(error) if has_others && !matches!(error, MissionError::Bus(_)) => error,
            ended => return ended.map_err(|error| Failure::failed(format!("mission {}: {error}", config.robot))),
        };
        if began.elapsed() > MISSION_PAUSE.1 {
            pause = MISSION_PAUSE.0;
        }
        tracing::error!(robot = %config.robot, %error, "its mission broke off, and begins again in {} s", pause.as_secs());
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            () = shutdown.wait() => return Ok(()),
        }
        pause = (2 * pause).min(MISSION_PAUSE.1);
    }
}

/// A world's places as named goals.
#[must_use]
pub fn places(world: &World) -> BTreeMap<String, GoalPoint> {
    world
        .places()
        .iter()
        .map(|place| {
            (
                place.name.to_string(),
                GoalPoint {
                    x: place.x,
                    y: place.y,
                    yaw: place.yaw,
                },
            )
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

    use super::*;

    #[test]
    fn a_bad_start_is_told_with_its_world_its_option_and_the_world_of_the_map() {
        let world = World::shipped("kitchen").unwrap();
        let robot = Id::robot("tiago").unwrap();
        let error = SimError::Outside {
            robot: robot.clone(),
            at: Point2::new(5.0, 5.0),
            low: world.bounds().0,
            high: world.bounds().1,
        };
        let mut deployment = Deployment::default();
        let plain = bad_start(&deployment, &world, &robot, &error).message;
        assert!(
            plain.starts_with("world `kitchen`: robot `tiago` cannot stand at (5, 5)")
                && plain.ends_with("; `--pose`, or `start` of [robots.tiago] says where"),
            "{plain}"
        );
        deployment.mapping.run.map = Some("maps/depot.yaml".into());
        deployment.robots.insert("bert".to_owned(), RobotSection::default());
        let mapped = bad_start(&deployment, &world, &robot, &error).message;
        assert!(
            mapped.contains("`--world maps/depot.yaml`") && !mapped.contains("--pose"),
            "{mapped}"
        );
    }
}
