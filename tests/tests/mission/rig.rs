//! Test rig for the claims: a closed loop in lockstep whose parts fail on demand, with the mission's store and all messages recorded.

use std::collections::BTreeMap;

use nalgebra::Point2;
use tempfile::TempDir;
use zenav::components::places;
use zenav::lockstep::{ClosedLoop, ClosedLoopConfig};
use zenav_cloud::mapping::PoseSettings;
use zenav_cloud::motion::MotionSettings;
use zenav_edge::{EdgeConfig, Persisted, Pilot, Publication, Ticket};
use zenav_mapping::MappingSettings;
use zenav_mission::{Answer, Ask, Client, Effect, Mission, MissionConfig, MissionStore, NoAnswer, Record};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{GridSpec, OccupancyGrid};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    Annotations, CancelRequest, EdgeState, EventKind, GoalPhase, GoalPoint, GoalReply, GoalRequest, GoalState,
    Heartbeat, LeaseAction, LeaseRequest, LeaseRole, MapAction, MissionStatus, PauseRequest, Plan, Refusal,
    RemoteReply, RemoteRequest,
};
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_protocol::topics::{EdgeReply, EdgeRequest, MissionReply, MissionRequest};
use zenav_sim::{RobotSpec, Simulation, Truth, World};

/// Key of the remote action that a program carries out.
pub const GRIPPER: &str = "kitchen/gripper";
/// Ticket of requests to the robot that are not the mission's.
const OPERATOR: Ticket = Ticket(u64::MAX);
/// Ticks per heartbeat.
const BEAT: u64 = 5;
const SPEC: GridSpec = GridSpec {
    origin: Point2::new(-5.0, -5.0),
    resolution: 0.1,
    width: 128,
    height: 128,
};

/// Answers remote actions.
pub type RemoteServer = Box<dyn FnMut(&RemoteRequest) -> RemoteReply>;

/// A shipped robot that also looks behind itself, so it may back up. Few beams are enough for a known room of coarse cells.
fn model(beams: usize) -> RobotModel {
    let mut model = zenav_fixtures::robot("tiago");
    let lidar = model.lidar.as_mut().unwrap();
    (lidar.field_of_view, lidar.beams) = (std::f64::consts::TAU, beams);
    model
}

/// Beams in a known room, and for a robot that maps.
const BEAMS: [usize; 2] = [180, 720];

/// A walled room from (-4.9, -4.9) to (7.7, 7.7), with additional walls at these points.
pub fn room(is_wall: impl Fn(Point2<f64>) -> bool) -> OccupancyGrid {
    zenav_fixtures::walled_room(SPEC, is_wall)
}

pub struct Rig {
    pub stage: ClosedLoop,
    /// Configuration of the mission's next process.
    pub config: MissionConfig,
    edge: EdgeConfig,
    world: World,
    folder: TempDir,
    store: Option<MissionStore>,
    persisted: Persisted,
    boots: u32,
    ticks: u64,

    /// All plans published.
    pub plans: Vec<Plan>,
    /// The last published state of each goal.
    pub goals: BTreeMap<String, GoalState>,
    /// Number of times each goal was stored as ended.
    pub ends: BTreeMap<String, usize>,
    /// Requests of the mission.
    pub asked: Vec<Ask>,
    pub replies: BTreeMap<Client, Result<MissionReply, Refusal>>,
    pub status: Option<MissionStatus>,
    /// The robot's published state and events.
    pub state: Option<EdgeState>,
    pub events: Vec<EventKind>,
    robot_reply: Option<Result<EdgeReply, Refusal>>,
    /// Number of writes by the mission.
    pub writes: usize,

    pub worker_up: bool,
    mapper_up: bool,
    /// Forced wheel speeds, whatever the robot commands, rad/s.
    pub wheels: Option<[f64; 2]>,
    /// Whether plans are corrupted on their way to the robot.
    pub plans_are_spoiled: bool,
    /// Whether heartbeats to the robot are lost.
    pub is_mute: bool,
    /// Another holder of the lease, its epoch, and the number of its heartbeats.
    other: Option<(String, u64, u64)>,
    /// Server of the remote actions on [`GRIPPER`].
    pub remote: Option<RemoteServer>,
    /// Number of writes, from the next one on, after which the process dies once.
    pub dies_after_writes: Option<usize>,
}

impl Rig {
    /// A rig in an empty room with a known map.
    pub fn new() -> Self {
        Self::on(room(|_| false))
    }

    /// A rig in a world made of this map, which is known.
    pub fn on(map: OccupancyGrid) -> Self {
        Self::with(map.clone(), map, 0.1)
    }

    /// A rig in a world made of one map, with another one as the known map; `delay` from scan to plan, s.
    pub fn with(map: OccupancyGrid, known: OccupancyGrid, delay: f64) -> Self {
        let world = World::from_map("room", map, Pose2::IDENTITY);
        let mut rig = Self::of(world, Some(known), delay);
        let sink = GoalPoint {
            x: 3.0,
            y: 0.0,
            yaw: None,
        };
        rig.config.places.insert("sink".to_owned(), sink);
        rig.start();
        rig
    }

    /// A rig in a shipped world, without a map.
    pub fn within(world: &str) -> Self {
        Self::of(World::shipped(world).unwrap(), None, 0.1)
    }

    /// A rig in a world from a file's text, without a map.
    pub fn in_world(text: &str) -> Self {
        let world = World::from_toml(text, "world", &|_| Err("no map".to_owned())).unwrap();
        Self::of(world, None, 0.1)
    }

    fn of(world: World, known_map: Option<OccupancyGrid>, delay: f64) -> Self {
        let (id, start) = (Id::robot("tiago").unwrap(), world.start());
        let model = model(BEAMS[usize::from(known_map.is_none())]);
        let edge = EdgeConfig::new(id.clone(), model.clone(), start);
        let mut config = MissionConfig::new(id.clone(), "mission-a", "unused".into());
        config.places = places(&world);
        let mut mapping = MappingSettings::default();
        if let Some(map) = &known_map {
            mapping.resolution = map.spec().resolution;
        }
        let simulation = Simulation::new(&world, vec![RobotSpec { id, model, start }], 1).unwrap();
        let stage = ClosedLoopConfig {
            edge: edge.clone(),
            mission: config.clone(),
            mapping,
            poses: PoseSettings::default(),
            motion: MotionSettings::default(),
            known_map,
            cloud_delay: delay,
            seed: 1,
        };
        let mut rig = Self {
            stage: ClosedLoop::new(simulation, vec![stage]),
            config,
            edge,
            world,
            folder: tempfile::tempdir().unwrap(),
            store: None,
            persisted: Persisted::default(),
            boots: 0,
            ticks: 0,
            plans: Vec::new(),
            goals: BTreeMap::new(),
            ends: BTreeMap::new(),
            asked: Vec::new(),
            replies: BTreeMap::new(),
            status: None,
            state: None,
            events: Vec::new(),
            robot_reply: None,
            writes: 0,
            worker_up: true,
            mapper_up: true,
            wheels: None,
            plans_are_spoiled: false,
            is_mute: false,
            other: None,
            remote: None,
            dies_after_writes: None,
        };
        rig.start();
        rig
    }

    /// Starts a new process of the mission.
    pub fn start(&mut self) {
        self.kill();
        let store = MissionStore::open(&self.folder.path().join("mission.redb"), self.config.robot.as_str()).unwrap();
        let restored = store.begin_life().unwrap();
        self.stage.robots[0].start(Mission::new(self.config.clone(), restored));
        self.store = Some(store);
    }

    pub fn kill(&mut self) {
        self.stage.robots[0].mission = None;
        self.store = None;
    }

    /// Restarts the edge, with the robot at its present pose.
    pub fn reboot(&mut self) {
        self.boots += 1;
        let edge = EdgeConfig {
            start: self.pose(),
            ..self.edge.clone()
        };
        self.stage.robots[0].pilot = Pilot::new(edge, format!("boot-{}", self.boots), self.persisted.clone());
    }

    /// Adds a permanent disc to the room.
    pub fn occupy(&mut self, x: f64, y: f64, radius: f64) {
        let mut model = model(BEAMS[0]);
        model.footprint = Footprint::Radius(radius);
        model.lidar.as_mut().unwrap().rate_hz = 0.01;
        let (id, start) = (Id::unique(), Pose2::new(x, y, 0.0));
        let spec = RobotSpec { id, model, start };
        self.stage.simulation.add(&self.world, spec).unwrap();
    }

    /// Stops or starts the mapper's process.
    pub fn set_mapper(&mut self, is_up: bool) {
        self.mapper_up = is_up;
        self.stage.robots[0].inputs.mapper_alive = Some(is_up);
        self.stage.robots[0].inputs.map_info = is_up.then(|| self.stage.robots[0].mapping.mapper.info());
    }

    pub fn ask(&mut self, request: MissionRequest) -> Client {
        self.stage.robots[0].ask(request)
    }

    /// Sends a request and runs until the answer; repeats it, as a client does, while the mission does not know whether it leads.
    pub fn answer(&mut self, request: MissionRequest) -> Result<MissionReply, Refusal> {
        for _ in 0..10 {
            let client = self.ask(request.clone());
            assert!(
                self.run_until(1.0, |rig| rig.replies.contains_key(&client)),
                "no answer"
            );
            match self.replies.remove(&client).unwrap() {
                Err(Refusal::NotLeader) => self.run(0.1),
                answer => return answer,
            }
        }
        panic!("the mission does not lead");
    }

    /// Delivers the map's places and zones.
    pub fn annotate(&mut self, annotations: Annotations) {
        self.stage.robots[0].inputs.annotations = Some(annotations);
    }

    /// Submits a goal, and returns the mission's answer.
    pub fn submit(&mut self, request: GoalRequest) -> Result<GoalReply, Refusal> {
        match self.answer(MissionRequest::Goal(request))? {
            MissionReply::Goal(reply) => Ok(reply),
            other => panic!("{other:?}"),
        }
    }

    pub fn pause(&mut self, resume: bool) {
        let request = PauseRequest {
            resume,
            ..PauseRequest::default()
        };
        self.answer(MissionRequest::Pause(request)).unwrap();
    }

    /// Sends a request to the robot itself.
    pub fn ask_robot(&mut self, request: EdgeRequest) -> Result<EdgeReply, Refusal> {
        self.stage.robots[0].inbox.requests.push((OPERATOR, request));
        self.step();
        self.robot_reply.take().expect("the robot answers in its next tick")
    }

    /// Lets another holder take the lease and keep it alive; returns its epoch.
    pub fn take_lease(&mut self, holder: &str, role: LeaseRole) -> u64 {
        let request = LeaseRequest::new(holder, role, LeaseAction::Acquire, "1");
        let EdgeReply::Lease(granted) = self.ask_robot(EdgeRequest::Lease(request)).unwrap() else {
            panic!("no lease")
        };
        self.other = Some((holder.to_owned(), granted.epoch, 0));
        granted.epoch
    }

    /// Stops the other holder's heartbeats.
    pub fn drop_lease(&mut self) {
        self.other = None;
    }

    pub fn truth(&self) -> Truth {
        self.stage.truth(0)
    }

    pub fn pose(&self) -> Pose2 {
        self.truth().map_from_base
    }

    /// Distance of the robot from a point, m.
    pub fn distance(&self, x: f64, y: f64) -> f64 {
        (self.pose().x - x).hypot(self.pose().y - y)
    }

    /// Path driven, m.
    pub fn driven(&self) -> f64 {
        self.truth().length
    }

    pub fn is_at_rest(&self) -> bool {
        let twist = self.truth().twist;
        twist.v.abs() < 0.01 && twist.w.abs() < 0.02
    }

    #[track_caller]
    pub fn goal(&self, id: &str) -> &GoalState {
        self.goals.get(id).unwrap_or_else(|| panic!("goal {id} is lost"))
    }

    #[track_caller]
    pub fn phase(&self, id: &str) -> GoalPhase {
        self.goal(id).state
    }

    /// Requests of the mission to the mapper, except for the map itself.
    pub fn map_actions(&self) -> Vec<MapAction> {
        let actions = self.asked.iter().filter_map(|ask| match ask {
            Ask::Map(request) if request.action != MapAction::Get => {
                assert!(request.epoch.is_some() && request.request_id.is_some(), "{request:?}");
                Some(request.action)
            }
            _ => None,
        });
        actions.collect()
    }

    /// Number of trajectories published.
    pub fn trajectories(&self) -> usize {
        let mut ids: Vec<u64> = self.plans.iter().map(|plan| plan.trajectory_id).collect();
        ids.dedup();
        ids.len()
    }

    pub fn run(&mut self, secs: f64) {
        self.run_until(secs, |_| false);
    }

    /// Runs until a condition holds; returns whether it did in time.
    pub fn run_until(&mut self, secs: f64, holds: impl Fn(&Self) -> bool) -> bool {
        let end = self.stage.now().plus_secs(secs);
        while self.stage.now() < end {
            if holds(self) {
                return true;
            }
            self.step();
        }
        holds(self)
    }

    /// Runs until a goal has ended; it must end in time.
    #[track_caller]
    pub fn end_of(&mut self, id: &str, secs: f64) -> GoalState {
        let ends = self.run_until(secs, |rig| rig.phase(id).is_end());
        assert!(ends, "{:#?}\n{:#?}\n{:?}", self.goal(id), self.status, self.events);
        self.goal(id).clone()
    }

    /// Runs until a goal has succeeded, without any contact.
    #[track_caller]
    pub fn success_of(&mut self, id: &str, secs: f64) -> GoalState {
        let goal = self.end_of(id, secs);
        assert_eq!(goal.state, GoalPhase::Succeeded, "{goal:#?}\n{:?}", self.events);
        assert_eq!(self.truth().collisions, 0);
        goal
    }

    /// Drives to a goal; returns the smallest distance to each of these points on the way, m.
    #[track_caller]
    pub fn success_past(&mut self, id: &str, secs: f64, points: &[(f64, f64)]) -> Vec<f64> {
        let mut nearest = vec![f64::INFINITY; points.len()];
        let end = self.stage.now().plus_secs(secs);
        while self.stage.now() < end && !self.phase(id).is_end() {
            self.step();
            for (near, (x, y)) in nearest.iter_mut().zip(points) {
                *near = near.min(self.distance(*x, *y));
            }
        }
        self.success_of(id, 0.0);
        nearest
    }

    /// One control tick.
    pub fn step(&mut self) {
        self.ticks += 1;
        if let Some((holder, epoch, counter)) = &mut self.other
            && self.ticks.is_multiple_of(BEAT)
        {
            *counter += 1;
            self.stage.robots[0].inbox.heartbeats.push(Heartbeat {
                holder: holder.clone(),
                epoch: *epoch,
                counter: *counter,
                echo: None,
            });
        }
        let out = self.stage.advance().remove(0);
        if let Some(wheels) = self.wheels {
            self.stage.simulation.drive(0, wheels);
        }
        if !self.mapper_up {
            self.stage.robots[0].inputs.map_patches.clear();
            self.stage.robots[0].inputs.map_info = None;
        }
        self.persisted = out.persist.unwrap_or_else(|| self.persisted.clone());
        let reply = out.replies.into_iter().find(|(ticket, _)| *ticket == OPERATOR);
        self.robot_reply = reply.map(|(_, reply)| reply).or(self.robot_reply.take());
        for publication in out.publications {
            match publication {
                Publication::State(state) => self.state = Some(*state),
                Publication::Event(event) => self.events.push(event.kind),
                _ => {}
            }
        }
        for (index, effect) in self.stage.robots[0].step_mission().into_iter().enumerate() {
            self.carry_out(index, effect);
            if self.stage.robots[0].mission.is_none() {
                return;
            }
        }
    }

    fn carry_out(&mut self, index: usize, mut effect: Effect) {
        match &mut effect {
            Effect::Persist(records) => {
                assert_eq!(index, 0, "what is stored is stored first");
                if self.dies_after_writes == Some(0) {
                    self.dies_after_writes = None;
                    return self.kill();
                }
                self.dies_after_writes = self.dies_after_writes.map(|left| left - 1);
                self.writes += 1;
                self.store.as_ref().unwrap().write(records).unwrap();
                for record in records {
                    if let Record::Goal(goal) = record
                        && goal.state.state.is_end()
                    {
                        *self.ends.entry(goal.state.id.clone()).or_default() += 1;
                    }
                }
            }
            Effect::Plan(plan) => {
                self.plans.push((**plan).clone());
                if self.plans_are_spoiled {
                    plan.frame = "odom".to_owned();
                }
            }
            Effect::Status(status) => self.status = Some((**status).clone()),
            Effect::Goal(goal) => {
                let before = self.goals.insert(goal.id.clone(), (**goal).clone());
                if let Some(before) = before.filter(|before| before.state.is_end()) {
                    assert_eq!(before.state, goal.state, "{} ended twice", goal.id);
                }
            }
            Effect::Reply(client, reply) => {
                self.replies.insert(*client, reply.clone());
            }
            Effect::StandBy => panic!("another mission leads"),
            Effect::Heartbeat(_) if self.is_mute => return,
            Effect::Heartbeat(_) => {}
            Effect::Ask(ticket, ask) => {
                self.asked.push(ask.clone());
                let answer = match (ask, &mut self.remote) {
                    (Ask::Motion(_), _) if !self.worker_up => Some(Err(NoAnswer::Silent("nobody".to_owned()))),
                    (Ask::Remote(server, request), Some(serve)) if server == GRIPPER => {
                        Some(Ok(Answer::Remote(Box::new(serve(request)))))
                    }
                    _ => None,
                };
                if let Some(answer) = answer {
                    return self.stage.robots[0].inputs.answers.push((*ticket, answer));
                }
            }
        }
        self.stage.robots[0].carry_out(effect);
    }
}

/// A goal at a point.
pub fn to(x: f64, y: f64, id: &str) -> GoalRequest {
    GoalRequest {
        id: Some(id.into()),
        x: Some(x),
        y: Some(y),
        ..GoalRequest::default()
    }
}

/// A goal that consists of a tree.
pub fn tree(tree: &str, id: &str) -> GoalRequest {
    GoalRequest {
        id: Some(id.into()),
        tree: Some(tree.into()),
        ..GoalRequest::default()
    }
}

/// A goal through points.
pub fn through(points: &[(f64, f64)], id: &str) -> GoalRequest {
    GoalRequest {
        id: Some(id.into()),
        waypoints: points
            .iter()
            .map(|(x, y)| GoalPoint {
                x: *x,
                y: *y,
                yaw: None,
            })
            .collect(),
        ..GoalRequest::default()
    }
}

pub fn cancel(id: Option<&str>, request_id: &str) -> MissionRequest {
    MissionRequest::Cancel(CancelRequest {
        id: id.map(str::to_owned),
        request_id: Some(request_id.to_owned()),
    })
}
