//! Closed loop in lockstep. Runs body, pilot, mapper, workers and mission in a fixed order, one control tick after another.
//!
//! The network is two [`Link`]s per robot: up from the robot, and down to it. Searches and solvers take no simulated time; the links'
//! delay stands for everything from scan to plan.
//!
//! [`ClosedLoop::tick`] runs everything. To observe the messages, or to make a part fail, run the steps one by one:
//! [`ClosedLoop::advance`], then for each robot [`RobotLoop::step_mission`] and [`RobotLoop::carry_out`].

use std::sync::Arc;
use std::time::Duration;

use zenav_cloud::mapping::{MappingCore, PoseSettings, PoseSource};
use zenav_cloud::motion::worker::{Cancel, MotionWorker};
use zenav_cloud::motion::{self, MotionSettings};
use zenav_edge::{EdgeConfig, Inbox, Outbox, Persisted, Pilot, Publication};
use zenav_mapping::{Mapper, MappingSettings};
use zenav_mission::{Answer, Ask, Client, Effect, Mission, MissionConfig, NoAnswer, Restored};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::messages::{
    Correction, GoalState, Heartbeat, Intent, Localisation, LocaliseAction, LocaliseReply, MapAction, MapRef,
    MapRequest, MotionRequest, Plan, Refusal, Scan,
};
use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{EdgeReply, EdgeRequest, MissionReply, MissionRequest};
use zenav_sim::{Simulation, Truth};

use super::delay::Link;
use crate::batch::thread_time;

/// Boot id of every robot.
const BOOT: &str = "lockstep";
/// Control ticks between two steps of the mission.
const TICKS_A_STEP: u64 = 2;

/// Configuration of one robot's part of a run.
#[derive(Debug)]
pub struct ClosedLoopConfig {
    /// The robot.
    pub edge: EdgeConfig,
    /// Its mission.
    pub mission: MissionConfig,
    /// The mapper's settings.
    pub mapping: MappingSettings,
    /// Source of mapping's poses.
    pub poses: PoseSettings,
    /// The motion worker's settings.
    pub motion: MotionSettings,
    /// Map to start with.
    pub known_map: Option<OccupancyGrid>,
    /// Mean delay from scan to plan, s.
    pub cloud_delay: f64,
    /// Seed of the links.
    pub seed: u64,
}

/// Messages up from the robot.
enum Up {
    Publication(Publication),
    Answer(zenav_mission::Ticket, Result<Answer, NoAnswer>),
}

/// Messages down to the robot.
enum Down {
    Plan(Box<Plan>),
    Heartbeat(Heartbeat),
    Correction(Correction),
    Localisation(Localisation),
    Request(zenav_mission::Ticket, EdgeRequest),
}

/// What a part of a robot says.
#[derive(Clone, Copy, Debug)]
pub enum Heard<'a> {
    /// The robot's output of this tick.
    Robot(&'a Outbox),
    /// Messages of mapping, among the inputs of the mission's next step.
    Mapping(&'a zenav_mission::Inputs),
    /// An effect of the mission.
    Mission(&'a Effect),
}

/// The whole system, in one thread.
pub struct ClosedLoop {
    /// The world; its first robots are the driven ones.
    pub simulation: Simulation,
    /// Each robot with its own mapper, worker and mission, in the order of the world.
    pub robots: Vec<RobotLoop>,
    /// Links from each robot to the others.
    intents: Vec<Link<(usize, Intent)>>,
}

impl ClosedLoop {
    /// Prepares a run with one robot per configuration: the first robots of the simulation.
    #[must_use]
    pub fn new(simulation: Simulation, configs: Vec<ClosedLoopConfig>) -> Self {
        let link = |config: &ClosedLoopConfig| Link::new(0.5 * config.cloud_delay, config.seed.wrapping_mul(3));
        Self {
            simulation,
            intents: configs.iter().map(link).collect(),
            robots: configs.into_iter().map(RobotLoop::new).collect(),
        }
    }

    /// One control tick.
    pub fn tick(&mut self) {
        self.tick_heard(|_, _| {});
    }

    /// One control tick; `hear` gets what the parts of each robot say, with the robot's number.
    pub fn tick_heard(&mut self, mut hear: impl FnMut(usize, Heard<'_>)) {
        let outboxes = self.advance();
        for (index, (robot, outbox)) in self.robots.iter_mut().zip(&outboxes).enumerate() {
            hear(index, Heard::Robot(outbox));
            hear(index, Heard::Mapping(&robot.inputs));
            let begun = thread_time();
            let effects = robot.step_mission();
            robot.cpu += thread_time().saturating_sub(begun);
            effects.iter().for_each(|effect| hear(index, Heard::Mission(effect)));
            let begun = thread_time();
            for effect in effects {
                robot.carry_out(effect);
            }
            robot.cpu += thread_time().saturating_sub(begun);
        }
    }

    /// One control tick of world, robots and mappers. Returns each robot's output.
    pub fn advance(&mut self) -> Vec<Outbox> {
        self.simulation.step();
        let now = self.simulation.now();
        self.exchange(now);
        let mut outboxes = Vec::with_capacity(self.robots.len());
        for (index, robot) in self.robots.iter_mut().enumerate() {
            let outbox = robot.advance(now, &self.simulation.readings(index));
            self.simulation.drive(index, outbox.wheels);
            outboxes.push(outbox);
        }
        outboxes
    }

    /// Delivers the other robots' intents, and collects those of the last tick.
    fn exchange(&mut self, now: Stamp) {
        if self.robots.len() < 2 {
            return;
        }
        for (sender, (robot, link)) in self.robots.iter_mut().zip(&mut self.intents).enumerate() {
            if let Some(intent) = robot.told.take() {
                link.send(now, (sender, intent));
            }
        }
        for link in &mut self.intents {
            for (sender, intent) in link.receive(now) {
                let others = self.robots.iter_mut().enumerate().filter(|(index, _)| *index != sender);
                others.for_each(|(_, robot)| robot.inbox.intents.push(intent.clone()));
            }
        }
    }

    /// Simulated time.
    #[must_use]
    pub fn now(&self) -> Stamp {
        self.simulation.now()
    }

    /// Ground truth of a robot.
    ///
    /// # Panics
    /// See [`Simulation::drive`].
    #[must_use]
    pub fn truth(&self, robot: usize) -> Truth {
        self.simulation.truth(robot)
    }
}

/// One robot with its own pilot, links, mapper, worker and mission.
pub struct RobotLoop {
    /// The robot's side.
    pub pilot: Pilot,
    /// Input of the robot's next tick, from everything but the mission.
    pub inbox: Inbox,
    /// The map and its poses.
    pub mapping: MappingCore,
    /// Whether mapping corrects the robot's pose.
    is_corrected: bool,
    /// The mission, while one runs.
    pub mission: Option<Mission>,
    /// Input of the mission's next step.
    pub inputs: zenav_mission::Inputs,
    /// The motion worker's copy of the map.
    replica: MapReplica,
    worker: MotionWorker,
    up: Link<Up>,
    down: Link<Down>,
    replies: Vec<Result<MissionReply, Refusal>>,
    /// The newest state of the goal.
    goal: Option<GoalState>,
    /// Intent announced in the last tick.
    told: Option<Intent>,
    now: Stamp,
    ticks: u64,
    clients: u64,
    cpu: Duration,
}

impl RobotLoop {
    fn new(config: ClosedLoopConfig) -> Self {
        let map = MapRef::new("lockstep", 0);
        let mapper = match &config.known_map {
            Some(grid) => Mapper::with_stored(config.mapping, map, grid, Vec::new(), 0),
            None => Mapper::new(config.mapping, map.id),
        };
        let mut mapper = mapper.with_footprint(config.edge.model.footprint.clone());
        // Live scans are inserted into a known map too: obstacles may have moved.
        mapper.resume();
        Self {
            pilot: Pilot::new(config.edge, BOOT.to_owned(), Persisted::default()),
            inbox: Inbox::default(),
            mapping: MappingCore::new(mapper, &config.poses),
            is_corrected: config.poses.source != PoseSource::Edge,
            replica: MapReplica::new(),
            worker: MotionWorker::new(Arc::clone(&config.mission.zones), config.motion),
            mission: Some(Mission::new(config.mission, Restored::fresh())),
            inputs: zenav_mission::Inputs::default(),
            up: Link::new(0.5 * config.cloud_delay, config.seed),
            down: Link::new(0.5 * config.cloud_delay, config.seed.wrapping_add(1)),
            replies: Vec::new(),
            goal: None,
            told: None,
            now: Stamp::ZERO,
            ticks: 0,
            clients: 0,
            cpu: Duration::ZERO,
        }
    }

    /// Sends a request to the mission at its next step; the answer is addressed to the returned client.
    pub fn ask(&mut self, request: MissionRequest) -> Client {
        self.clients += 1;
        let client = Client(self.clients);
        self.inputs.requests.push((client, request));
        client
    }

    /// Replaces the mission; the new one gets the map information that a new process would get.
    pub fn start(&mut self, mission: Mission) {
        self.mission = Some(mission);
        self.inputs = zenav_mission::Inputs {
            map_info: Some(self.mapping.mapper.info()),
            ..zenav_mission::Inputs::default()
        };
    }

    /// One control tick of robot and mapper. Returns the robot's output.
    fn advance(&mut self, now: Stamp, readings: &Readings) -> Outbox {
        let begun = thread_time();
        self.ticks += 1;
        self.now = now;
        let outbox = self.step_edge(now, readings);
        self.deliver(now);
        self.cpu += thread_time().saturating_sub(begun);
        outbox
    }

    fn step_edge(&mut self, now: Stamp, readings: &Readings) -> Outbox {
        let mut inbox = std::mem::take(&mut self.inbox);
        for message in self.down.receive(now) {
            match message {
                Down::Plan(plan) => inbox.plans.push(*plan),
                Down::Heartbeat(heartbeat) => inbox.heartbeats.push(heartbeat),
                Down::Correction(correction) => inbox.corrections.push(correction),
                Down::Localisation(localisation) => inbox.localisations.push(localisation),
                Down::Request(ticket, request) => inbox.requests.push((zenav_edge::Ticket(ticket.0), request)),
            }
        }
        let outbox = self.pilot.step(now, readings, inbox);
        for publication in &outbox.publications {
            if let Publication::Intent(intent) = publication {
                self.told = Some(intent.clone());
            }
            self.up.send(now, Up::Publication(publication.clone()));
        }
        for (ticket, answer) in &outbox.replies {
            let answer = answer_of(answer.clone());
            self.up.send(now, Up::Answer(zenav_mission::Ticket(ticket.0), answer));
        }
        outbox
    }

    fn deliver(&mut self, now: Stamp) {
        for message in self.up.receive(now) {
            match message {
                Up::Answer(ticket, answer) => self.inputs.answers.push((ticket, answer)),
                Up::Publication(Publication::State(state)) => {
                    self.mapping.hear_frame(state.frame);
                    self.inputs.state = Some(*state);
                }
                Up::Publication(Publication::Pose(pose)) => self.inputs.pose = Some(pose),
                Up::Publication(Publication::Yield(yields)) => self.inputs.yields = Some(yields),
                Up::Publication(Publication::Event(event)) => self.inputs.events.push(event),
                Up::Publication(Publication::Scan(None, scan)) => self.map(now, &scan),
                Up::Publication(Publication::Scan(Some(_), scan)) => {
                    self.mapping.insert_further(&scan, BOOT);
                }
                Up::Publication(_) => {}
            }
        }
        let mapper = &mut self.mapping.mapper;
        while let Some(patch) = mapper.take_patch() {
            if self.replica.apply(&patch) == PatchResult::Gap {
                self.replica.replace(&mapper.reply());
            }
            self.inputs.map_patches.push(patch);
            self.inputs.map_info = Some(mapper.info());
        }
    }

    /// Draws a scan of the main lidar, and passes on the poses that follow from it.
    fn map(&mut self, now: Stamp, scan: &Scan) {
        let mapped = self.mapping.insert(scan, BOOT);
        if mapped.frame.is_some() {
            self.inputs.map_frame = mapped.frame;
        }
        if let Some(correction) = mapped.correction {
            self.down.send(now, Down::Correction(correction));
        }
        if let Some(localisation) = mapped.localisation {
            self.localised(now, localisation);
        }
    }

    /// Tells mission and robot how well the robot is localised. Unlike on the bus, a robot that estimates its pose by itself is not judged
    /// by the known map: it reaches its goals by that estimate.
    fn localised(&mut self, now: Stamp, localisation: Localisation) {
        if self.is_corrected {
            self.inputs.localisation = Some(localisation.clone());
            self.down.send(now, Down::Localisation(localisation));
        }
    }

    /// The mission's step, if it is due. Returns its effects.
    pub fn step_mission(&mut self) -> Vec<Effect> {
        if self.ticks % TICKS_A_STEP != 1 {
            return Vec::new();
        }
        let inputs = std::mem::take(&mut self.inputs);
        let now = self.now;
        self.mission
            .as_mut()
            .map_or_else(Vec::new, |mission| mission.step(now, inputs))
    }

    /// Carries out an effect of the mission.
    pub fn carry_out(&mut self, effect: Effect) {
        let now = self.now;
        match effect {
            Effect::Heartbeat(heartbeat) => self.down.send(now, Down::Heartbeat(heartbeat)),
            Effect::Plan(plan) => self.down.send(now, Down::Plan(plan)),
            Effect::Goal(goal) => self.goal = Some(*goal),
            Effect::Reply(_, reply) => self.replies.push(reply),
            Effect::Ask(ticket, ask) => self.ask_of_mission(ticket, ask),
            // A lockstep run stores nothing, and nobody watches it.
            Effect::Persist(_) | Effect::Status(_) | Effect::StandBy => {}
        }
    }

    /// Passes a request of the mission to the robot, or answers it for the next step.
    fn ask_of_mission(&mut self, ticket: zenav_mission::Ticket, ask: Ask) {
        let mut to_edge = |request| self.down.send(self.now, Down::Request(ticket, request));
        let answer = match ask {
            Ask::Lease(request) => return to_edge(EdgeRequest::Lease(request)),
            Ask::EdgeInfo(request) => return to_edge(EdgeRequest::Info(request)),
            Ask::Behaviour(request) => return to_edge(EdgeRequest::Behaviour(request)),
            Ask::Motion(request) => self.motion_answer(&request),
            Ask::Localise(request) => self.localise_answer(request.action),
            Ask::Map(request) => Ok(self.map_answer(&request)),
            Ask::Remote(server, _) => Err(NoAnswer::Silent(format!(
                "a run in lockstep has no network for {server}"
            ))),
        };
        self.inputs.answers.push((ticket, answer));
    }

    fn localise_answer(&mut self, action: LocaliseAction) -> Result<Answer, NoAnswer> {
        let found = match action {
            LocaliseAction::Global => self.mapping.look_everywhere().map_err(NoAnswer::Refused)?,
            LocaliseAction::Report | LocaliseAction::At => None,
        };
        let health = self.mapping.health();
        if let Some(localisation) = found {
            self.localised(self.now, localisation);
        }
        Ok(Answer::Localised(LocaliseReply { health }))
    }

    fn motion_answer(&mut self, request: &MotionRequest) -> Result<Answer, NoAnswer> {
        if let Some(extent) = motion::padding(request) {
            self.replica.reach(&extent);
        }
        // No clock and no time limit: both would make runs differ.
        self.worker
            .answer(Some(&self.replica), request, &mut || 0.0, &Cancel::default())
            .map(|reply| Answer::Motion(Box::new(reply)))
            .map_err(NoAnswer::Refused)
    }

    fn map_answer(&mut self, request: &MapRequest) -> Answer {
        match request.action {
            // There is no disk here.
            MapAction::Get | MapAction::List | MapAction::Load => {}
            MapAction::Save => self.mapping.mark_stored(),
            MapAction::Reset => self.mapping.reset(format!("lockstep-{}", self.ticks)),
            MapAction::Resume => self.mapping.mapper.resume(),
            MapAction::Hold => self.mapping.mapper.hold(),
            MapAction::Forget => self.mapping.mapper.decay_now(),
        }
        let mut reply = self.mapping.mapper.reply();
        if request.action != MapAction::Get {
            reply.values.clear();
            self.inputs.map_info = Some(reply.info.clone());
        }
        Answer::Map(Box::new(reply))
    }

    /// Time of the robot's last tick.
    #[must_use]
    pub fn now(&self) -> Stamp {
        self.now
    }

    /// Processor time of [`ClosedLoop::tick`] for this robot so far, without the simulator: robot, mapper, mission and motion.
    #[must_use]
    pub fn cpu(&self) -> Duration {
        self.cpu
    }

    /// The newest state of the goal.
    #[must_use]
    pub fn goal(&self) -> Option<&GoalState> {
        self.goal.as_ref()
    }

    /// What the mission has answered so far.
    pub fn replies(&self) -> &[Result<MissionReply, Refusal>] {
        &self.replies
    }
}

fn answer_of(reply: Result<EdgeReply, Refusal>) -> Result<Answer, NoAnswer> {
    match reply {
        Ok(EdgeReply::Lease(reply)) => Ok(Answer::Lease(reply)),
        Ok(EdgeReply::Info(reply)) => Ok(Answer::EdgeInfo(Box::new(reply))),
        Ok(EdgeReply::Behaviour(reply)) => Ok(Answer::Behaviour(reply)),
        Ok(_) => Err(NoAnswer::Silent("an answer to another question".to_owned())),
        Err(refusal) => Err(NoAnswer::Refused(refusal)),
    }
}
