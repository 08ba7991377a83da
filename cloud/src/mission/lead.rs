//! How is the mission stepped that keeps the robot's goals? Everything that has come since goes in; what comes out is stored, here and with
//! the standbys, and then told.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior};
use zenav_protocol::bus::{Bus, BusError, Latest, Publisher, Subscription};
use zenav_protocol::messages::*;
use zenav_protocol::topics::{self, MissionRequest};

use super::requests::Waiting;
use super::standbys::Standbys;
use super::workers::{Workers, carry};
use super::{End, MissionError, Post, Turn, blocking};
use zenav_mission::io::{Answer, Ask, Client, Effect, Inputs, NoAnswer, Ticket};
use zenav_mission::orchestrator::Mission;
use zenav_mission::records::{Leadership, Record};

/// Time between two steps.
const PERIOD: Duration = Duration::from_millis(50);
/// Answers that wait for the next step.
const MAX_ANSWERS: usize = 512;
/// Events and patches that wait for the next step.
const MAX_WAITING: usize = 512;
/// Goals whose last state is kept for late joiners.
const MAX_GOAL_PUBLISHERS: usize = 64;
/// Time between two signs of life while something is stored.
const BEAT: Duration = Duration::from_millis(100);
/// Time for other missions to say that they are there.
const ROLL_CALL: Duration = Duration::from_millis(300);
/// Time between two looks at whether this process was held up.
const PULSE: Duration = Duration::from_millis(200);
/// A leader with standbys that was held up for longer tells nothing more before the robot has said that it leads: others may have led since.
pub(super) const HELD_UP: Duration = Duration::from_secs(1);

/// Leads, or asks to, until the end or until another mission does.
pub(super) async fn lead(post: &mut Post) -> Result<Turn, MissionError> {
    let store = post.store.clone();
    let mut restored = blocking(move || store.begin_life()).await??;
    restored.ahead = post.ahead;
    if restored.standing.epoch == 0 && another_leads(post).await {
        return Ok(Turn::Follow);
    }
    tracing::info!(robot = %post.config.robot, store = post.store.name(), incarnation = restored.incarnation, goals = restored.goals.len(), "mission begins");
    let mut shell = Shell::open(post, restored.standing, restored.incarnation)?;
    let mut mission = Mission::new(post.config.clone(), restored);
    let mut ticks = post.clock.interval(PERIOD);
    // The robot's clock may stand still; this one does not.
    let mut pulse = tokio::time::interval(PULSE);
    pulse.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut last = Instant::now();
    loop {
        let mut inputs = Inputs::default();
        tokio::select! {
            _ = pulse.tick() => {}
            () = post.shutdown.wait() => {
                if shell.standbys.are_any() && last.elapsed() > HELD_UP {
                    return Ok(Turn::Over);
                }
                break;
            }
            _ = ticks.tick() => {}
            request = post.requests.next() => match request {
                Some(request) => shell.receive(request, &mut inputs),
                None => return Err(BusError::Closed.into()),
            },
            entry = post.journal.next() => match entry {
                // Who hands over to a leader has been deposed, and will hear it from the robot.
                Some(entry) => entry.refuse(&Refusal::NotLeader),
                None => return Err(BusError::Closed.into()),
            },
            Some(answer) = shell.answers.recv() => inputs.answers.push(answer),
        }
        if shell.standbys.are_any() && last.elapsed() > HELD_UP {
            tracing::warn!(robot = %post.config.robot, "this mission was held up: others may have led since");
            shell.dismiss();
            return Ok(Turn::Follow);
        }
        last = Instant::now();
        shell.drain(&mut inputs);
        let effects = mission.step(post.clock.now(), inputs);
        match shell.carry_out(&mut mission, effects, last).await {
            Ok(()) => {}
            Err(End::Deposed) => {
                tracing::warn!(robot = %post.config.robot, why = mission.why_not(), "stands by");
                shell.dismiss();
                return Ok(Turn::Follow);
            }
            Err(End::Failed(error)) => return Err(error),
        }
    }
    let effects = mission.leave();
    match shell.carry_out(&mut mission, effects, Instant::now()).await {
        Err(End::Failed(error)) => Err(error),
        // Whoever leads next goes on from what is stored.
        Ok(()) | Err(End::Deposed) => Ok(Turn::Over),
    }
}

/// Whether a mission with a store that no robot ever let lead leaves the lead to another one that is there. Without the robot's word one of
/// several new ones leads, the first by its store's name.
async fn another_leads(post: &mut Post) -> bool {
    let (bus, robot) = (post.bus.clone(), post.config.robot.to_string());
    let chunks = [robot.as_str()];
    // Twice: one that began at the same time may not have been there for the first call.
    for _ in 0..2 {
        let all = bus.ask_all(&topics::CLOUD_INFO, &chunks, &InfoRequest {}, ROLL_CALL);
        let (all, end) = (async { all.await.unwrap_or_default() }, tokio::time::sleep(ROLL_CALL));
        let called = async { tokio::join!(all, end).0 };
        tokio::pin!(called);
        // Others that are new call, too, and are to hear of this one.
        let others = loop {
            tokio::select! {
                others = &mut called => break others,
                Some(request) = post.requests.next() => post.answer_as_standby(request),
            }
        };
        let yields = others.into_iter().filter_map(|answer| answer.result.ok()).any(|other| {
            let store = other.store.as_deref().filter(|store| *store != post.store.name());
            store.is_some_and(|store| other.leads || store < post.store.name())
        });
        if yields {
            return true;
        }
    }
    false
}

/// The signs of life: the mission's own, and more while it waits for its disk or its standbys.
struct Pulse {
    publisher: Publisher<Heartbeat>,
    /// The newest.
    beats: Option<Heartbeat>,
    /// How many were sent besides the mission's own: each is to be newer than the one before.
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
            self.publisher.put(heartbeat);
        }
    }
}

/// Everything between the mission and the bus.
struct Shell {
    bus: Bus,
    robot: String,
    standbys: Standbys,
    clients: BTreeMap<Client, Waiting>,
    next_client: u64,
    state: Latest<EdgeState>,
    pose: Latest<PoseEstimate>,
    events: Subscription<Event>,
    map_info: Latest<MapInfo>,
    map_patches: Subscription<MapPatch>,
    pulse: Pulse,
    plan: Publisher<Plan>,
    status: Publisher<MissionStatus>,
    goals: Vec<(String, Publisher<GoalState>)>,
    workers: Workers,
    answers: mpsc::Receiver<(Ticket, Result<Answer, NoAnswer>)>,
    answered: mpsc::Sender<(Ticket, Result<Answer, NoAnswer>)>,
}

impl Shell {
    fn open(post: &Post, standing: Leadership, incarnation: u64) -> Result<Self, BusError> {
        let (bus, robot) = (&post.bus, post.config.robot.to_string());
        let name = [robot.as_str()];
        let (answered, answers) = mpsc::channel(MAX_ANSWERS);
        Ok(Self {
            standbys: Standbys::new(bus, &post.config, post.store.clone(), standing, incarnation),
            state: bus.latest(&topics::STATE, &name)?,
            pose: bus.latest(&topics::POSE, &name)?,
            events: bus.subscribe(&topics::EVENT, &name, MAX_WAITING)?,
            map_info: bus.latest(&topics::MAP_INFO, &name)?,
            map_patches: bus.subscribe(&topics::MAP_PATCH, &name, MAX_WAITING)?,
            pulse: Pulse {
                publisher: bus.publisher(&topics::HEARTBEAT, &name)?,
                beats: None,
                more: 0,
            },
            plan: bus.publisher(&topics::PLAN, &name)?,
            status: bus.publisher(&topics::MISSION, &name)?,
            goals: Vec::new(),
            workers: Workers::watch(bus, crate::motion::SERVICE)?,
            clients: BTreeMap::new(),
            next_client: 0,
            bus: bus.clone(),
            robot,
            answers,
            answered,
        })
    }

    fn receive(&mut self, waiting: Waiting, inputs: &mut Inputs) {
        self.next_client += 1;
        let client = Client(self.next_client);
        inputs.requests.push((client, waiting.request.clone()));
        self.clients.insert(client, waiting);
    }

    /// Takes everything that has come since.
    fn drain(&mut self, inputs: &mut Inputs) {
        inputs.state = self.state.take();
        inputs.pose = self.pose.take();
        inputs.map_info = self.map_info.take();
        inputs.events.extend(
            std::iter::from_fn(|| self.events.try_next())
                .map(|received| received.message)
                .take(MAX_WAITING),
        );
        inputs.map_patches.extend(
            std::iter::from_fn(|| self.map_patches.try_next())
                .map(|received| received.message)
                .take(MAX_WAITING),
        );
        inputs
            .answers
            .extend(std::iter::from_fn(|| self.answers.try_recv().ok()).take(MAX_ANSWERS));
        self.workers.update();
    }

    /// `begun` is when the step's inputs were taken.
    async fn carry_out(&mut self, mission: &mut Mission, effects: Vec<Effect>, begun: Instant) -> Result<(), End> {
        self.standbys.lead(mission.term(), mission.now()).await?;
        let held_up = |standbys: &Standbys| standbys.are_any() && begun.elapsed() > HELD_UP;
        for effect in &effects {
            if let Effect::Heartbeat(heartbeat) = effect
                && !held_up(&self.standbys)
            {
                self.pulse.beat(heartbeat.clone());
            }
        }
        if mission.epoch().is_none() {
            self.pulse.beats = None;
        }
        for effect in effects {
            if held_up(&self.standbys) {
                return Err(End::Deposed);
            }
            match effect {
                Effect::Persist(records) => self.store(records).await?,
                Effect::Heartbeat(_) => {}
                Effect::Plan(plan) => self.plan.put(&plan),
                Effect::Status(status) => self.status.put(&status),
                Effect::Goal(goal) => self.publish_goal(&goal),
                Effect::Ask(ticket, ask) => self.ask(ticket, ask),
                Effect::Reply(client, answer) => {
                    if let Some(waiting) = self.clients.remove(&client) {
                        if let (MissionRequest::Join(request), Ok(_)) = (&waiting.request, &answer) {
                            self.standbys.join(request).await?;
                        }
                        waiting.responder.send(answer);
                    }
                }
                Effect::StandBy => return Err(End::Deposed),
                Effect::Fatal(why) => return Err(MissionError::Mismatch(why).into()),
            }
        }
        self.standbys.tend().await?;
        mission.share(self.standbys.names(), self.standbys.are_any());
        Ok(())
    }

    /// Stores here and with the standbys; a slow disk or link does not cost the lease.
    async fn store(&mut self, records: Vec<Record>) -> Result<(), End> {
        let Self { standbys, pulse, .. } = self;
        let begun = Instant::now();
        let storing = async {
            let store = standbys.store();
            let writes = blocking(move || store.write(&records)).await??;
            standbys.hand_over(writes).await
        };
        tokio::pin!(storing);
        loop {
            tokio::select! {
                stored = &mut storing => return stored,
                () = tokio::time::sleep(BEAT) => if begun.elapsed() < HELD_UP {
                    pulse.beat_again();
                },
            }
        }
    }

    /// Whoever still waits for an answer is sent to the leader.
    fn dismiss(&mut self) {
        for (_, waiting) in std::mem::take(&mut self.clients) {
            waiting.responder.send(Err(Refusal::NotLeader));
        }
    }

    fn publish_goal(&mut self, goal: &GoalState) {
        let place = match self.goals.iter().position(|(id, _)| *id == goal.id) {
            Some(place) => place,
            None => {
                if self.goals.len() == MAX_GOAL_PUBLISHERS {
                    self.goals.remove(0);
                }
                match self.bus.publisher(&topics::GOAL_STATE, &[&self.robot, &goal.id]) {
                    Ok(publisher) => self.goals.push((goal.id.clone(), publisher)),
                    Err(error) => return tracing::error!(goal = goal.id, %error, "its state cannot be told"),
                }
                self.goals.len() - 1
            }
        };
        if let Some((_, publisher)) = self.goals.get(place) {
            publisher.put(goal);
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
