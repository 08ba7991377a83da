//! The robot, the workers and the store that the claims are tested with.

use std::collections::BTreeMap;
use std::time::Duration;

use nalgebra::Point2;
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::id::Id;
use zenav_protocol::lease::LeaseArbiter;
use zenav_protocol::messages::*;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{MissionReply, MissionRequest};

use crate::io::{Answer, Ask, Client, Effect, Inputs, NoAnswer, Ticket};
use crate::records::{Record, Restored, StoredGoal};
use crate::{Mission, MissionConfig};
use zenav_smoothing::SAMPLE_PERIOD;
use zenav_smoothing::unsmoothed;

pub const DT: f64 = 0.05;

pub fn model() -> RobotModel {
    zenav_fixtures::robot("tiago")
}

/// A robot that drives every plan perfectly.
pub struct Edge {
    pub boot_id: String,
    pub book: LeaseArbiter,
    pub pose: Pose2,
    pub velocity: Twist2,
    pub plan: Option<Plan>,
    pub expiry: Stamp,
    pub time: f64,
    pub finished: bool,
    pub mode: Mode,
    /// Refuses every plan with this reason.
    pub refuse: Option<String>,
    /// Stands whatever the plan says.
    pub stuck: bool,
    waypoint: usize,
    newest: Revision,
    sequence: u64,
    events: Vec<Event>,
    /// Path driven, m.
    pub driven: f64,
}

impl Edge {
    fn new() -> Self {
        Self {
            boot_id: "boot-1".into(),
            book: LeaseArbiter::new(Duration::from_secs(1), 0, None),
            pose: Pose2::new(0.0, 0.0, 0.0),
            velocity: Twist2::ZERO,
            plan: None,
            expiry: Stamp::ZERO,
            time: 0.0,
            finished: false,
            mode: Mode::Idle,
            refuse: None,
            stuck: false,
            waypoint: 0,
            newest: Revision::default(),
            sequence: 0,
            events: Vec::new(),
            driven: 0.0,
        }
    }

    pub fn reboot(&mut self) {
        let (epoch, leader, pose) = (self.book.epoch(), self.book.leader().cloned(), self.pose);
        *self = Self {
            boot_id: format!("{}+", self.boot_id),
            book: LeaseArbiter::new(Duration::from_secs(1), epoch, leader),
            pose,
            ..Self::new()
        };
    }

    fn tell(&mut self, now: Stamp, kind: EventKind) {
        self.sequence += 1;
        self.events.push(Event {
            stamp: now,
            boot_id: self.boot_id.clone(),
            sequence: self.sequence,
            kind,
        });
    }

    pub fn discard(&mut self, now: Stamp, reason: &str) {
        if let Some(plan) = self.plan.take() {
            self.tell(
                now,
                EventKind::PlanDiscarded {
                    goal_id: plan.goal_id,
                    reason: reason.into(),
                },
            );
        }
    }

    fn take(&mut self, now: Stamp, plan: Plan) {
        let good =
            self.book.admits(now, plan.epoch) && plan.based_on.boot_id == self.boot_id && plan.revision > self.newest;
        let reason = self
            .refuse
            .clone()
            .or((!good).then(|| "stale".to_owned()))
            .or((self.mode == Mode::Stopped).then(|| "stopped".to_owned()));
        let (goal_id, revision, trajectory_id) = (plan.goal_id.clone(), plan.revision, plan.trajectory_id);
        if let Some(reason) = reason {
            self.tell(
                now,
                EventKind::PlanRejected {
                    goal_id,
                    revision,
                    trajectory_id,
                    reason,
                },
            );
            return;
        }
        self.newest = plan.revision;
        self.expiry = plan.based_on.stamp.plus_secs(plan.valid_for);
        if self.plan.as_ref().is_none_or(|old| old.trajectory_id != trajectory_id) {
            self.time = match (plan.splice, &self.plan) {
                (Some(splice), Some(old)) if old.trajectory_id == splice.trajectory_id => self.time - splice.time,
                _ => 0.0,
            };
            if self.time <= 0.0 && !plan.trajectory.is_empty() {
                // The rest of the motion before is driven in no time at all.
                self.time = 0.0;
            }
            self.waypoint = 0;
            self.finished = false;
            self.tell(
                now,
                EventKind::PlanAccepted {
                    goal_id,
                    revision,
                    trajectory_id,
                },
            );
        }
        self.plan = Some(plan);
    }

    fn drive(&mut self, now: Stamp) {
        let before = self.pose;
        self.velocity = Twist2::ZERO;
        if let Some(plan) = self
            .plan
            .clone()
            .filter(|_| now < self.expiry && !self.finished && !self.stuck && self.mode != Mode::Stopped)
        {
            if plan.trajectory.is_empty() {
                let target = plan.waypoints[self.waypoint];
                let (dx, dy) = (target.x - self.pose.x, target.y - self.pose.y);
                let left = dx.hypot(dy);
                let way = (0.5 * DT).min(left);
                self.pose = Pose2::new(
                    self.pose.x + dx / left.max(1e-9) * way,
                    self.pose.y + dy / left.max(1e-9) * way,
                    dy.atan2(dx),
                );
                self.velocity = Twist2::new(0.5, 0.0);
                if left - way < 1e-6 {
                    self.waypoint += 1;
                    self.finished = self.waypoint == plan.waypoints.len();
                }
            } else {
                self.time += DT;
                let point = plan.trajectory.sample(self.time);
                (self.pose, self.velocity) = (point.pose(), point.twist());
                if plan.trajectory.last().is_none_or(|last| self.time >= last.t) {
                    self.finished = true;
                }
            }
            self.mode = Mode::Follow;
            if self.finished {
                self.velocity = Twist2::ZERO;
                self.tell(
                    now,
                    EventKind::PlanFinished {
                        goal_id: plan.goal_id.clone(),
                        trajectory_id: plan.trajectory_id,
                    },
                );
            }
        } else if self.mode == Mode::Follow {
            self.mode = Mode::Idle;
        }
        self.driven += before.distance(&self.pose);
    }

    fn state(&self, now: Stamp) -> EdgeState {
        let progress = |plan: &Plan| PlanProgress {
            goal_id: plan.goal_id.clone(),
            epoch: plan.epoch,
            revision: plan.revision,
            trajectory_id: plan.trajectory_id,
            time: self.time,
            waypoint: self.waypoint,
            distance_left: 1.0,
            time_left: 1.0,
            valid_for: self.expiry.secs_since(now).max(0.0),
            finished: self.finished,
        };
        EdgeState {
            stamp: now,
            boot_id: self.boot_id.clone(),
            mode: self.mode,
            link: Link::Connected,
            lease: self.book.state(now),
            plan: self.plan.as_ref().map(progress),
            velocity: self.velocity,
            guard: GuardZone::Clear,
            battery: 1.0,
            behaviour: None,
            wall_follower: None,
            missed_ticks: 0,
        }
    }
}

/// What a mission's store keeps, in memory.
#[derive(Clone, Default)]
pub struct Kept {
    pub goals: BTreeMap<String, StoredGoal>,
    pub restored: Restored,
    /// How often each goal was stored as ended.
    pub ends: BTreeMap<String, usize>,
}

impl Kept {
    fn write(&mut self, records: Vec<Record>) {
        for record in records {
            match record {
                Record::Goal(goal) => {
                    if goal.state.state.is_end() {
                        *self.ends.entry(goal.state.id.clone()).or_default() += 1;
                    }
                    // What cannot be read back is as good as lost.
                    let text = serde_json::to_string(&goal).unwrap();
                    self.goals
                        .insert(goal.state.id.clone(), serde_json::from_str(&text).unwrap());
                }
                Record::ForgetGoal(id) => drop(self.goals.remove(&id)),
                Record::Tree(tree) => {
                    let text = serde_json::to_string(&tree).unwrap();
                    self.restored.tree = serde_json::from_str::<Option<_>>(&text).unwrap();
                }
                Record::Motion(motion) => self.restored.motion = motion.map(|plan| *plan),
                Record::Answer(id, reply) => self.restored.answers.push((id, reply)),
                Record::Now(now) => self.restored.now = now,
                Record::ForgetAnswer(id) => self.restored.answers.retain(|(known, _)| *known != id),
            }
        }
    }

    fn restored(&self, incarnation: u64) -> Restored {
        Restored {
            incarnation,
            goals: self.goals.values().cloned().collect(),
            ..self.restored.clone()
        }
    }
}
/// Answers remote actions.
pub type RemoteServer = Box<dyn FnMut(&RemoteRequest) -> RemoteReply>;

pub struct Rig {
    pub now: Stamp,
    pub mission: Option<Mission>,
    pub edge: Edge,
    pub kept: Kept,
    pub config: MissionConfig,
    pub grid: OccupancyGrid,
    pub map: MapInfo,
    map_told: u64,
    pub incarnation: u64,
    pub plans: Vec<(Stamp, Plan)>,
    pub replies: BTreeMap<u64, Result<MissionReply, Refusal>>,
    pub asked: Vec<Ask>,
    pub published: Vec<GoalState>,
    pub status: Option<MissionStatus>,
    /// News of the mapper, once.
    pub mapper_alive: Option<bool>,
    pub worker_up: bool,
    /// The robot's own motions do not end.
    pub behaviours_run: bool,
    /// The planner finds no way.
    pub plans_none: bool,
    /// So near to (0, 0) the planner takes a start for occupied, and (0, 0.55) for the nearest free place, m.
    pub start_occupied_within: f64,
    /// Time from an ask to its answer, s.
    pub latency: f64,
    waiting: Vec<(Stamp, Ticket, Result<Answer, NoAnswer>)>,
    requests: Vec<(Client, MissionRequest)>,
    next_client: u64,
    /// Does the remote actions on the key `kitchen/gripper`.
    pub remote: Option<RemoteServer>,
    /// Writes after which the process dies, once; counted from the next one.
    pub dies_after_writes: Option<usize>,
}

pub const SPEC: GridSpec = GridSpec {
    origin: Point2::new(-5.0, -5.0),
    resolution: 0.1,
    width: 128,
    height: 128,
};

impl Rig {
    pub fn new() -> Self {
        let mut config = MissionConfig::new(Id::robot("tiago").unwrap(), "mission-a", "unused".into());
        config.places.insert(
            "sink".into(),
            GoalPoint {
                x: 3.0,
                y: 0.0,
                yaw: None,
            },
        );
        let map = MapRef {
            id: "m".into(),
            revision: 1,
        };
        let info = MapInfo {
            stamp: Stamp(1),
            map,
            spec: SPEC,
            free: 1,
            occupied: 1,
            unknown: 0,
            scans: 1,
            stored: true,
        };
        let mut rig = Self {
            now: Stamp::from_secs(100.0),
            mission: None,
            edge: Edge::new(),
            kept: Kept::default(),
            config,
            grid: OccupancyGrid::filled(SPEC, Occupancy::FREE),
            map: info,
            map_told: 0,
            incarnation: 0,
            plans: Vec::new(),
            replies: BTreeMap::new(),
            asked: Vec::new(),
            published: Vec::new(),
            status: None,
            mapper_alive: None,
            worker_up: true,
            behaviours_run: false,
            plans_none: false,
            start_occupied_within: 0.0,
            latency: 0.1,
            waiting: Vec::new(),
            requests: Vec::new(),
            next_client: 0,
            remote: None,
            dies_after_writes: None,
        };
        rig.start();
        rig
    }

    /// In a world with the kitchen's places.
    pub fn in_the_kitchen() -> Self {
        let mut rig = Self::new();
        let table = [
            (-1.3, -1.1),
            (-1.3, -2.4),
            (-0.9, -3.1),
            (0.0, -3.2),
            (0.9, -2.95),
            (1.3, -2.3),
            (1.3, -1.3),
            (1.0, -0.5),
            (0.0, -0.25),
            (-1.0, -0.45),
        ];
        let numbered = (1..)
            .zip(table)
            .map(|(number, place)| (format!("table_{number}"), place));
        let named = [("sink", (0.88, 0.09)), ("corner", (-1.46, -3.12))].map(|(name, place)| (name.to_owned(), place));
        for (name, (x, y)) in numbered.chain(named) {
            rig.config.places.insert(name, GoalPoint { x, y, yaw: None });
        }
        rig.start();
        rig
    }

    /// A (new) process of the mission.
    pub fn start(&mut self) {
        self.incarnation += 1;
        self.mission = Some(Mission::new(self.config.clone(), self.kept.restored(self.incarnation)));
        self.map_told = 0;
    }

    pub fn kill(&mut self) {
        self.mission = None;
        self.waiting.clear();
        self.requests.clear();
    }

    pub fn occupy(&mut self, x: f64, y: f64) {
        let cell = SPEC.cell_at(Point2::new(x, y)).unwrap();
        self.grid[cell] = Occupancy::OCCUPIED;
    }

    /// Tells everybody the map as it stands.
    pub fn remap(&mut self) {
        self.map.map.revision += 1;
    }

    pub fn ask(&mut self, request: MissionRequest) -> u64 {
        self.next_client += 1;
        self.requests.push((Client(self.next_client), request));
        self.next_client
    }

    /// Asks and runs until the answer.
    pub fn answer(&mut self, request: MissionRequest) -> Result<MissionReply, Refusal> {
        let client = self.ask(request);
        for _ in 0..10 {
            self.step();
            if let Some(reply) = self.replies.remove(&client) {
                return reply;
            }
        }
        panic!("no answer");
    }

    pub fn submit(&mut self, request: GoalRequest) -> Result<GoalReply, Refusal> {
        match self.answer(MissionRequest::Goal(request))? {
            MissionReply::Goal(reply) => Ok(reply),
            other => panic!("{other:?}"),
        }
    }

    pub fn state(&self, id: &str) -> GoalPhase {
        self.kept
            .goals
            .get(id)
            .unwrap_or_else(|| panic!("goal {id} is lost"))
            .state
            .state
    }

    pub fn goal(&self, id: &str) -> &GoalState {
        &self.kept.goals[id].state
    }

    pub fn run(&mut self, secs: f64) {
        self.run_until(secs, |_| false);
    }

    /// Runs until something holds; whether it came to hold in time.
    pub fn run_until(&mut self, secs: f64, holds: impl Fn(&Self) -> bool) -> bool {
        let end = self.now.plus_secs(secs);
        while self.now < end {
            if holds(self) {
                return true;
            }
            self.step();
        }
        holds(self)
    }

    pub fn step(&mut self) {
        self.now = self.now.plus_secs(DT);
        let now = self.now;
        self.edge.drive(now);
        let Some(mut mission) = self.mission.take() else { return };
        let mut inputs = Inputs {
            state: Some(self.edge.state(now)),
            pose: Some(PoseEstimate {
                stamp: now,
                map_from_base: self.edge.pose,
                covariance: [0.0; 9],
                velocity: self.edge.velocity,
            }),
            events: std::mem::take(&mut self.edge.events),
            requests: std::mem::take(&mut self.requests),
            mapper_alive: self.mapper_alive.take(),
            ..Inputs::default()
        };
        if self.map_told != self.map.map.revision {
            self.map_told = self.map.map.revision;
            inputs.map_info = Some(self.map.clone());
            inputs.map_patches.push(self.patch());
        }
        let (due, later) = std::mem::take(&mut self.waiting)
            .into_iter()
            .partition(|(at, ..)| *at <= now);
        self.waiting = later;
        inputs.answers = Vec::from_iter::<Vec<_>>(due)
            .into_iter()
            .map(|(_, ticket, answer)| (ticket, answer))
            .collect();
        let effects = mission.step(now, inputs);
        self.mission = Some(mission);
        for (index, effect) in effects.into_iter().enumerate() {
            if self.carry_out(index, effect) {
                self.kill();
                return;
            }
        }
    }

    /// Carries an effect out; whether the process dies now.
    fn carry_out(&mut self, index: usize, effect: Effect) -> bool {
        let now = self.now;
        match effect {
            Effect::Persist(records) => {
                assert_eq!(index, 0, "what is stored is stored first");
                if let Some(left) = &mut self.dies_after_writes {
                    if *left == 0 {
                        self.dies_after_writes = None;
                        return true;
                    }
                    *left -= 1;
                }
                self.kept.write(records);
            }
            Effect::Heartbeat(beat) => {
                self.edge.book.renew(now, &beat.holder, beat.epoch, beat.counter);
            }
            Effect::Plan(plan) => {
                self.plans.push((now, (*plan).clone()));
                self.edge.take(now, *plan);
            }
            Effect::Status(status) => self.status = Some(*status),
            Effect::Goal(goal) => self.published.push(*goal),
            Effect::Reply(client, reply) => {
                self.replies.insert(client.0, reply);
            }
            Effect::StandBy => panic!("another mission leads"),
            Effect::Fatal(why) => panic!("{why}"),
            Effect::Ask(ticket, ask) => {
                self.asked.push(ask.clone());
                let answer = self.answer_to(&ask);
                let wait = if answer.is_ok() || matches!(answer, Err(NoAnswer::Refused(_))) {
                    self.latency
                } else {
                    1.0
                };
                self.waiting.push((now.plus_secs(wait), ticket, answer));
            }
        }
        false
    }

    fn answer_to(&mut self, ask: &Ask) -> Result<Answer, NoAnswer> {
        let now = self.now;
        let silent = || Err(NoAnswer::Silent("nobody".into()));
        match ask {
            Ask::Lease(request) => match self.edge.book.request(now, request) {
                Ok(granted) => {
                    if granted.holder_changed {
                        self.edge.discard(now, "another holder");
                    }
                    Ok(Answer::Lease(LeaseReply {
                        epoch: granted.epoch,
                        ttl_secs: 1.0,
                        boot_id: self.edge.boot_id.clone(),
                    }))
                }
                Err(refusal) => Err(NoAnswer::Refused(refusal)),
            },
            Ask::EdgeInfo(_) => Ok(Answer::EdgeInfo(Box::new(InfoReply {
                component: "edge".into(),
                version: "0".into(),
                schema: SCHEMA_VERSION,
                robot: "tiago".into(),
                boot: Some(BasedOn {
                    stamp: now,
                    boot_id: self.edge.boot_id.clone(),
                }),
                model: Some(model()),
                ..InfoReply::default()
            }))),
            Ask::Behaviour(request) => {
                let state = match self.behaviours_run {
                    true => BehaviourState::Running,
                    false => BehaviourState::Succeeded,
                };
                let report = BehaviourReport {
                    id: request.id.clone(),
                    state,
                    reason: None,
                };
                Ok(Answer::Behaviour(BehaviourReply { report: Some(report) }))
            }
            Ask::Motion(_) if !self.worker_up => silent(),
            Ask::Motion(request) => Ok(Answer::Motion(Box::new(match &**request {
                MotionRequest::Plan(plan) => MotionReply::Plan(self.plan(plan)),
                MotionRequest::Smooth(smooth) => MotionReply::Smooth(smoothed(smooth)),
                MotionRequest::Trajectory(wanted) => {
                    let plan = self.plan(&wanted.plan);
                    let smooth = match &plan.outcome {
                        PlanOutcome::Found { path, .. } => {
                            Some(smoothed(&wanted.smooth(plan.map.clone(), path.clone())))
                        }
                        _ => None,
                    };
                    MotionReply::Trajectory(TrajectoryReply { plan, smooth })
                }
            }))),
            Ask::Remote(server, request) => match &mut self.remote {
                Some(done) if server == "kitchen/gripper" => Ok(Answer::Remote(Box::new(done(request)))),
                _ => silent(),
            },
            Ask::Map(request) => {
                match request.action {
                    MapAction::Reset => {
                        self.map.map = MapRef {
                            id: format!("{}+", self.map.map.id),
                            revision: 1,
                        };
                        self.map.stored = false;
                        self.map_told = 0;
                    }
                    MapAction::Save => {
                        self.map.stored = true;
                        self.map_told = 0;
                    }
                    _ => {}
                }
                Ok(Answer::Map(Box::new(MapReply {
                    info: self.map.clone(),
                    values: self.grid.values().to_vec(),
                    trajectory: Vec::new(),
                })))
            }
        }
    }

    /// Straight from pose to pose, or round whatever is in the way.
    fn plan(&self, request: &PlanRequest) -> PlanReply {
        let mut reply = PlanReply {
            map: self.map.map.clone(),
            outcome: PlanOutcome::NoPath,
            leg: 0,
            escapes: false,
            search_ms: 1.0,
            expansions: 1,
            origin: PlanOrigin::Searched,
        };
        let mut path = vec![request.start.position()];
        if request.start.position().coords.norm() < self.start_occupied_within && request.escape > 0.55 {
            path.push(Point2::new(0.0, 0.55));
            reply.escapes = true;
        }
        for (leg, goal) in request.via.iter().chain([&request.goal]).enumerate() {
            let (start, goal) = (path[path.len() - 1], goal.position());
            let side = Point2::new(0.5 * (start.x + goal.x), 0.5 * (start.y + goal.y) + 3.0);
            let ways = [vec![start, goal], vec![start, side, goal]];
            let free = |way: &&Vec<Point2<f64>>| way.windows(2).all(|pair| self.is_free(pair[0], pair[1]));
            match ways.iter().find(free).filter(|_| !self.plans_none) {
                Some(way) => path.extend(&way[1..]),
                None => return PlanReply { leg, ..reply },
            }
        }
        let length = path.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        reply.outcome = PlanOutcome::Found { path, length };
        reply
    }

    fn is_free(&self, a: Point2<f64>, b: Point2<f64>) -> bool {
        let steps = ((b - a).norm() / 0.05).ceil() as u32;
        (0..=steps).all(|step| {
            let p = a + (b - a) * (f64::from(step) / f64::from(steps.max(1)));
            let reach = (-4..=4).flat_map(|dx| (-4..=4).map(move |dy| (f64::from(dx) * 0.1, f64::from(dy) * 0.1)));
            reach.into_iter().all(|(dx, dy)| {
                SPEC.cell_at(Point2::new(p.x + dx, p.y + dy))
                    .is_none_or(|cell| self.grid[cell] != Occupancy::OCCUPIED)
            })
        })
    }

    pub fn patch(&self) -> MapPatch {
        let mut tiles = Vec::new();
        for y in 0..SPEC.height / TILE {
            for x in 0..SPEC.width / TILE {
                let cells = (0..TILE * TILE).map(|index| Cell::new(x * TILE + index % TILE, y * TILE + index / TILE));
                tiles.push(Tile {
                    x,
                    y,
                    values: cells.map(|cell| self.grid[cell]).collect(),
                });
            }
        }
        let revision = self.map.map.revision;
        MapPatch {
            stamp: self.now,
            map: self.map.map.clone(),
            base_revision: revision - 1,
            spec: SPEC,
            tiles,
        }
    }
}

fn smoothed(request: &SmoothRequest) -> SmoothReply {
    let safe = unsmoothed(
        &request.path,
        request.start,
        request.start_velocity,
        request.goal_yaw,
        &request.model,
    );
    SmoothReply {
        map: request.map.clone(),
        trajectory: safe.sampled(SAMPLE_PERIOD),
        statistics: PlanStatistics {
            status: "smoothed".into(),
            ..PlanStatistics::default()
        },
    }
}

pub fn to(x: f64, y: f64, id: &str) -> GoalRequest {
    GoalRequest {
        id: Some(id.into()),
        x: Some(x),
        y: Some(y),
        ..GoalRequest::default()
    }
}
