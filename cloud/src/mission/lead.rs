//! Leading mission. Each step takes everything that has arrived; its effects are persisted, here and with the standbys, then published.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::Instant;
use zenav_protocol::bus::{AliveWatch, Bus, BusError, Clock, KeyedPublisher, Latest, Publisher, Subscription};
use zenav_protocol::messages::{
    Annotations, EdgeState, Event, GoalState, Heartbeat, InfoRequest, Localisation, MapFrame, MapInfo, MapPatch,
    MappingLeader, MissionStatus, Plan, PoseEstimate, Refusal, Yield,
};
use zenav_protocol::topics::{self, MissionReply, MissionRequest};

use super::metrics::{self, MissionMetrics};
use super::standbys::Standbys;
use super::trace::MissionTrace;
use super::workers::{Workers, carry};
use super::{End, MissionError, Pending, Service, Turn, blocking};
use zenav_mission::{Answer, Ask, Client, Effect, Inputs, Leadership, Membership, Mission, NoAnswer, Record, Ticket};

/// Period of the steps.
const PERIOD: Duration = Duration::from_millis(50);
/// Answers queued for the next step.
const MAX_ANSWERS: usize = 512;
/// Events and patches queued for the next step.
const MAX_WAITING: usize = 512;
/// Goals whose last state is kept for late joiners.
const MAX_KEPT_GOALS: usize = 64;
/// A step that takes longer than this loses the lease: this mission hangs, and a standby may take over.
const LONGEST_STEP: Duration = Duration::from_secs(20);
/// Interval between heartbeats during a step or a write.
const BEAT: Duration = Duration::from_millis(100);
/// Time for other missions to answer.
const ROLL_CALL: Duration = Duration::from_millis(300);
/// Time after which mapping that was not heard is silent: many times the interval of its beats, and a late link.
const MAPPING_SILENT: Duration = Duration::from_secs(5);
/// Longest time between two checks whether this process was suspended, if a standby may have led meanwhile.
const PULSE: Duration = Duration::from_millis(200);
/// Longest time between two steps, while the robot's clock stands still or is slow.
const STILL: Duration = Duration::from_secs(1);

/// Leads, or requests to, until shutdown or until another mission leads.
pub(super) async fn lead(service: &mut Service) -> Result<Turn, MissionError> {
    let store = service.store.clone();
    let mut restored = blocking(move || store.begin_life()).await??;
    restored.ahead = service.ahead;
    if restored.leadership.epoch == 0 && another_leads(service).await {
        return Ok(Turn::Follow);
    }
    tracing::info!(robot = %service.config.robot, store = service.store.name(), incarnation = restored.incarnation, goals = restored.goals.len(), "mission begins");
    let mut shell = Shell::open(service, restored.leadership, restored.incarnation)?;
    // Boxed: it moves to another thread and back for every step.
    let mut mission = Box::new(Mission::new(service.config.clone(), restored));
    metrics::leads(&shell.robot, true);
    service.role.met();
    let mut ticks = service.clock.interval(PERIOD);
    let (mut last, mut stepped) = (Instant::now(), Instant::now());
    let shutdown = service.shutdown.clone();
    let ending = shutdown.wait();
    tokio::pin!(ending);
    loop {
        let mut inputs = Inputs::default();
        let mut is_due = true;
        let pulse = if shell.standbys.are_any() { PULSE } else { STILL };
        tokio::select! {
            // The robot's clock may stop; this one does not.
            () = tokio::time::sleep_until(last + pulse) => is_due = stepped.elapsed() >= STILL,
            () = &mut ending => {
                if shell.standbys.is_held_up(last) {
                    return Ok(Turn::Over);
                }
                break;
            }
            _ = ticks.tick() => {}
            request = service.requests.next() => match request {
                Some(request) => shell.receive(request, &mut inputs),
                None => return Err(BusError::Closed.into()),
            },
            entry = service.journal.next() => match entry {
                // A leader that replicates to a leader has been deposed; the robot will tell it.
                Some(entry) => entry.refuse(&Refusal::NotLeader),
                None => return Err(BusError::Closed.into()),
            },
            Some(answer) = shell.answers.recv() => inputs.answers.push(answer),
        }
        if shell.standbys.is_held_up(last) {
            tracing::warn!(robot = %service.config.robot, "this process was suspended: another mission may have led since");
            shell.dismiss();
            return Ok(Turn::Follow);
        }
        last = Instant::now();
        if !is_due {
            continue;
        }
        stepped = last;
        shell.drain(&mut inputs);
        let effects;
        (mission, effects) = shell.step(mission, &service.clock, inputs, &mut last).await?;
        match shell.carry_out(&mut mission, effects, last).await {
            Ok(()) => {}
            Err(End::Deposed) => {
                tracing::warn!(robot = %service.config.robot, why = mission.why_not(), "becomes a standby");
                shell.dismiss();
                return Ok(Turn::Follow);
            }
            Err(End::Failed(error)) => return Err(error),
        }
    }
    let effects = mission.leave();
    match shell.carry_out(&mut mission, effects, Instant::now()).await {
        Err(End::Failed(error)) => Err(error),
        // The next leader continues from what is stored.
        Ok(()) | Err(End::Deposed) => Ok(Turn::Over),
    }
}

/// Whether a mission whose store never led yields to another one. Until the robot confirms a leader, the first of several new missions by
/// store name leads.
async fn another_leads(service: &mut Service) -> bool {
    let (bus, robot) = (service.bus.clone(), service.config.robot.to_string());
    let chunks = [robot.as_str()];
    // Two calls: a mission that started at the same time may have missed the first.
    for _ in 0..2 {
        let all = bus.ask_all(&topics::CLOUD_INFO, &chunks, &InfoRequest {}, ROLL_CALL);
        let (all, end) = (async { all.await.unwrap_or_default() }, tokio::time::sleep(ROLL_CALL));
        let called = async { tokio::join!(all, end).0 };
        tokio::pin!(called);
        // Other new missions call too and must get an answer.
        let others = loop {
            tokio::select! {
                others = &mut called => break others,
                Some(request) = service.requests.next() => service.answer_as_standby(request),
            }
        };
        let yields = others.into_iter().filter_map(|answer| answer.result.ok()).any(|other| {
            let store = other.store.as_deref().filter(|store| *store != service.store.name());
            store.is_some_and(|store| other.leads || store < service.store.name())
        });
        if yields {
            return true;
        }
    }
    false
}

/// Heartbeats: the mission's own, plus extra ones while it computes a step or waits for its disk or standbys.
struct Pulse {
    publisher: Publisher<Heartbeat>,
    /// The newest heartbeat.
    beats: Option<Heartbeat>,
    /// Number of extra heartbeats sent, added to the counter so that it keeps growing.
    more: u64,
}

impl Pulse {
    fn beat(&mut self, mut heartbeat: Heartbeat) {
        heartbeat.counter += self.more;
        self.publisher.put(&heartbeat);
        self.beats = Some(heartbeat);
    }

    fn beat_again(&mut self) {
        if let Some(heartbeat) = &mut self.beats {
            self.more += 1;
            heartbeat.counter += 1;
            // No echo: it waited here, so it would misstate the link's delay.
            heartbeat.echo = None;
            self.publisher.put(heartbeat);
        }
    }
}

/// Everything between the mission and the bus.
struct Shell {
    bus: Bus,
    robot: String,
    standbys: Standbys,
    clients: BTreeMap<Client, Pending>,
    next_client: u64,
    state: Latest<EdgeState>,
    pose: Latest<PoseEstimate>,
    yields: Latest<Yield>,
    events: Subscription<Event>,
    map_info: Latest<MapInfo>,
    map_patches: Subscription<MapPatch>,
    mapping_beats: Latest<MappingLeader>,
    /// When anything that mapping publishes last came.
    mapping_heard: Option<Instant>,
    localisation: Latest<Localisation>,
    map_frame: Latest<MapFrame>,
    annotations: Latest<Annotations>,
    mapper: AliveWatch,
    pulse: Pulse,
    plan: Publisher<Plan>,
    status: Publisher<MissionStatus>,
    goals: KeyedPublisher<GoalState>,
    workers: Workers,
    answers: mpsc::Receiver<(Ticket, Result<Answer, NoAnswer>)>,
    answered: mpsc::Sender<(Ticket, Result<Answer, NoAnswer>)>,
    metrics: MissionMetrics,
    trace: MissionTrace,
}

impl Shell {
    fn open(service: &Service, leadership: Leadership, incarnation: u64) -> Result<Self, BusError> {
        let (bus, robot) = (&service.bus, service.config.robot.to_string());
        let name = [robot.as_str()];
        let (answered, answers) = mpsc::channel(MAX_ANSWERS);
        Ok(Self {
            standbys: Standbys::new(bus, &service.config, service.store.clone(), leadership, incarnation),
            state: bus.latest(&topics::STATE, &name)?,
            pose: bus.latest(&topics::POSE, &name)?,
            yields: bus.latest(&topics::YIELD, &name)?,
            events: bus.subscribe(&topics::EVENT, &name, MAX_WAITING)?,
            map_info: bus.latest(&topics::MAP_INFO, &name)?,
            map_patches: bus.subscribe(&topics::MAP_PATCH, &name, MAX_WAITING)?,
            mapping_beats: bus.latest(&topics::MAPPING_LEADER, &name)?,
            mapping_heard: None,
            localisation: bus.latest(&topics::LOCALISATION, &name)?,
            map_frame: bus.latest(&topics::MAP_FRAME, &name)?,
            annotations: bus.latest(&topics::ANNOTATIONS, &name)?,
            mapper: bus.watch_alive(topics::alive_key(topics::ALIVE_COMPONENT, &[&robot, "mapping"]))?,
            pulse: Pulse {
                publisher: bus.publisher(&topics::HEARTBEAT, &name)?,
                beats: None,
                more: 0,
            },
            plan: bus.publisher(&topics::PLAN, &name)?,
            status: bus.publisher(&topics::MISSION, &name)?,
            goals: bus.keyed_publisher(&topics::GOAL_STATE, &[&robot, "*"], MAX_KEPT_GOALS)?,
            workers: Workers::watch(bus, crate::motion::SERVICE)?,
            clients: BTreeMap::new(),
            next_client: 0,
            bus: bus.clone(),
            metrics: MissionMetrics::new(&robot),
            trace: MissionTrace::new(&robot),
            robot,
            answers,
            answered,
        })
    }

    fn receive(&mut self, pending: Pending, inputs: &mut Inputs) {
        self.next_client += 1;
        let client = Client(self.next_client);
        if matches!(pending.request, MissionRequest::Goal(_)) {
            self.metrics.asked(client);
        }
        inputs.requests.push((client, pending.request.clone()));
        self.clients.insert(client, pending);
    }

    /// Steps the mission: on a blocking thread, unless the step is brief. Configuration spaces, floods and tree files may take a while;
    /// heartbeats are sent meanwhile, for [`LONGEST_STEP`] at most, so that a huge map or goal does not cost the lease. `last` is when this
    /// process was last known to run.
    async fn step(
        &mut self,
        mut mission: Box<Mission>,
        clock: &Clock,
        inputs: Inputs,
        last: &mut Instant,
    ) -> Result<(Box<Mission>, Vec<Effect>), MissionError> {
        let now = clock.now();
        let begun = Instant::now();
        if mission.is_brief(&inputs) {
            // Without the two changes of thread, which take longer than such a step.
            let stepped = catch_unwind(AssertUnwindSafe(|| mission.step(now, inputs)));
            let effects = stepped.map_err(|_| MissionError::Step("it panicked".to_owned()))?;
            self.metrics.tick.observe(begun.elapsed().as_secs_f64());
            return Ok((mission, effects));
        }
        let mut stepping = tokio::task::spawn_blocking(move || {
            let effects = mission.step(now, inputs);
            (mission, effects)
        });
        let mut kept_alive = false;
        loop {
            tokio::select! {
                stepped = &mut stepping => {
                    let (mut mission, effects) = stepped.map_err(|error| MissionError::Step(error.to_string()))?;
                    self.metrics.tick.observe(begun.elapsed().as_secs_f64());
                    if kept_alive {
                        mission.was_kept_alive(clock.now());
                    }
                    return Ok((mission, effects));
                }
                () = tokio::time::sleep(BEAT) => {
                    kept_alive = last.elapsed() < Membership::HELD_UP && begun.elapsed() < LONGEST_STEP;
                    if kept_alive {
                        self.pulse.beat_again();
                        *last = Instant::now();
                    }
                }
            }
        }
    }

    /// Takes everything that has arrived.
    fn drain(&mut self, inputs: &mut Inputs) {
        inputs.state = self.state.take();
        if let Some(state) = &inputs.state {
            self.standbys.hear(state.lease.leader.as_ref());
        }
        inputs.pose = self.pose.take();
        inputs.yields = self.yields.take();
        inputs.map_info = self.map_info.take();
        inputs.localisation = self.localisation.take();
        inputs.map_frame = self.map_frame.take();
        inputs.annotations = self.annotations.take();
        inputs.events.extend(
            std::iter::from_fn(|| self.events.try_next())
                .map(|received| received.message)
                .take(MAX_WAITING),
        );
        self.metrics.heard(&inputs.events);
        inputs.map_patches.extend(
            std::iter::from_fn(|| self.map_patches.try_next())
                .map(|received| {
                    self.trace.heard(received.trace);
                    received.message
                })
                .take(MAX_WAITING),
        );
        inputs.mapping_leader = self.mapping_beats.take();
        if inputs.mapping_leader.is_some() || inputs.map_info.is_some() || !inputs.map_patches.is_empty() {
            self.mapping_heard = Some(Instant::now());
        }
        inputs.is_mapping_silent = self.mapping_heard.is_none_or(|heard| heard.elapsed() >= MAPPING_SILENT);
        while let Some((_, alive)) = self.mapper.try_next() {
            inputs.mapper_alive = Some(alive);
        }
        inputs
            .answers
            .extend(std::iter::from_fn(|| self.answers.try_recv().ok()).take(MAX_ANSWERS));
        self.trace.answers(&inputs.answers);
        self.workers.update();
    }

    /// `begun` is when the step's inputs were taken.
    async fn carry_out(&mut self, mission: &mut Mission, effects: Vec<Effect>, begun: Instant) -> Result<(), End> {
        self.standbys.lead(mission.term(), mission.now()).await?;
        for effect in &effects {
            if let Effect::Heartbeat(heartbeat) = effect
                && !self.standbys.is_held_up(begun)
            {
                self.pulse.beat(heartbeat.clone());
            }
        }
        if mission.epoch().is_none() {
            self.pulse.beats = None;
        }
        for effect in effects {
            if self.standbys.is_held_up(begun) {
                return Err(End::Deposed);
            }
            match effect {
                Effect::Persist(records) => {
                    self.metrics.stored(&records);
                    self.store(records).await?;
                }
                Effect::Heartbeat(_) => {}
                Effect::Plan(plan) => {
                    let is_new = self.metrics.published(&plan);
                    let trace = is_new
                        .then(|| self.trace.planned(&plan.goal_id, plan.trajectory_id))
                        .flatten();
                    self.plan.put_in(trace, &plan);
                }
                Effect::Status(status) => self.status.put(&status),
                Effect::Goal(goal) => self.goals.put(&[&self.robot, &goal.id], &goal),
                Effect::Ask(ticket, ask) => {
                    if matches!(ask, Ask::Motion(_)) {
                        self.trace.asked(ticket);
                    }
                    self.ask(ticket, ask);
                }
                Effect::Reply(client, mut answer) => {
                    if let Ok(MissionReply::Info(info)) = &mut answer {
                        info.process = Some(self.bus.process_info());
                    }
                    if let Some(pending) = self.clients.remove(&client) {
                        if let (MissionRequest::Join(request), Ok(_)) = (&pending.request, &answer) {
                            self.standbys.join(request).await?;
                        }
                        self.metrics.answered(client, answer.is_ok());
                        pending.responder.send(answer);
                    }
                }
                Effect::StandBy => return Err(End::Deposed),
            }
        }
        self.metrics.observe(mission, self.workers.count());
        self.standbys.maintain().await?;
        mission.share(self.standbys.names(), self.standbys.are_any());
        Ok(())
    }

    /// Persists here and with the standbys; heartbeats continue, so a slow disk or link does not cost the lease.
    async fn store(&mut self, records: Vec<Record>) -> Result<(), End> {
        let Self {
            standbys,
            pulse,
            metrics,
            ..
        } = self;
        let begun = Instant::now();
        let storing = async {
            let store = standbys.store();
            let writes = blocking(move || store.write(&records)).await??;
            standbys.replicate(writes).await
        };
        tokio::pin!(storing);
        loop {
            tokio::select! {
                stored = &mut storing => {
                    metrics.write.observe(begun.elapsed().as_secs_f64());
                    return stored;
                }
                () = tokio::time::sleep(BEAT) => if begun.elapsed() < Membership::HELD_UP {
                    pulse.beat_again();
                },
            }
        }
    }

    /// Refuses every pending request with `NotLeader`.
    fn dismiss(&mut self) {
        for (_, pending) in std::mem::take(&mut self.clients) {
            pending.responder.send(Err(Refusal::NotLeader));
        }
    }

    fn ask(&self, ticket: Ticket, ask: Ask) {
        let (bus, robot, answered) = (self.bus.clone(), self.robot.clone(), self.answered.clone());
        let workers = self.workers.clone();
        tokio::spawn(async move {
            let answer = carry(&bus, &robot, &workers, ask).await;
            // The receiver lives as long as the mission does.
            let _ = answered.send((ticket, answer)).await;
        });
    }
}
