//! How is a mission fed from the bus, and how are its effects carried out? The one file of the mission that knows both.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use thiserror::Error;
use tokio::sync::mpsc;
use tokio::time::Instant;
use zenav_protocol::bus::{AliveWatch, AskError, Bus, BusError, Clock, Publisher, Request as Query, Server, Shutdown};
use zenav_protocol::messages::*;
use zenav_protocol::topics;

use super::config::MissionConfig;
use super::exchange::{Answer, Ask, Client, Effect, Inputs, NoAnswer, Request, Response, Ticket};
use super::orchestrator::Mission;
use super::records::Record;
use super::store::{Store, StoreError};

/// Time between two steps.
const PERIOD: Duration = Duration::from_millis(50);
/// Answers that wait for the next step.
const MAX_ANSWERS: usize = 512;
/// Events and patches that wait for the next step.
const MAX_WAITING: usize = 512;
/// Goals whose last state is kept for late joiners.
const MAX_GOAL_PUBLISHERS: usize = 64;
/// Pause before workers are looked for again.
const NO_WORKER: Duration = Duration::from_millis(100);

/// Why a mission ended by itself.
#[derive(Debug, Error)]
pub enum MissionError {
    /// The bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The store: nothing more may be promised to anybody.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// This mission and the robot do not speak the same language.
    #[error("{0}")]
    Mismatch(String),
}

/// Runs one robot's mission until `shutdown`, or until it can go on no longer.
///
/// # Errors
/// [`MissionError`]; [`StoreError::Locked`] at once when another process has the store.
pub async fn run(bus: Bus, clock: Clock, config: MissionConfig, shutdown: Shutdown) -> Result<(), MissionError> {
    let path = config.store.clone();
    let (store, restored) = blocking(move || Store::open(&path)).await??;
    tracing::info!(robot = %config.robot, incarnation = restored.incarnation, goals = restored.goals.len(), "mission begins");
    let mut shell = Shell::open(bus, &config, store)?;
    let mut mission = Mission::new(config, restored);
    let mut ticks = clock.interval(PERIOD);
    loop {
        let mut inputs = Inputs::default();
        tokio::select! {
            () = shutdown.wait() => break,
            _ = ticks.tick() => {}
            request = shell.desk.next() => match request {
                Some(request) => shell.receive(request, &mut inputs),
                None => return Err(BusError::Closed.into()),
            },
            Some(answer) = shell.answers.recv() => inputs.answers.push(answer),
        }
        shell.drain(&mut inputs);
        let effects = mission.step(clock.now(), inputs);
        shell.carry_out(effects).await?;
    }
    let effects = mission.leave();
    shell.carry_out(effects).await
}

/// Runs what may wait for a disk away from the others.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, StoreError> {
    let failed = |error: tokio::task::JoinError| StoreError::Io {
        path: "mission store".to_owned(),
        reason: error.to_string(),
    };
    tokio::task::spawn_blocking(work).await.map_err(failed)
}

/// Everything between the mission and the bus.
struct Shell {
    bus: Bus,
    robot: String,
    store: Arc<Store>,
    desk: Desk,
    clients: BTreeMap<Client, Waiting>,
    next_client: u64,
    state: zenav_protocol::bus::Latest<EdgeState>,
    pose: zenav_protocol::bus::Latest<PoseEstimate>,
    events: zenav_protocol::bus::Subscription<Event>,
    map_info: zenav_protocol::bus::Latest<MapInfo>,
    map_patches: zenav_protocol::bus::Subscription<MapPatch>,
    heartbeat: Publisher<Heartbeat>,
    plan: Publisher<Plan>,
    status: Publisher<MissionStatus>,
    goals: Vec<(String, Publisher<GoalState>)>,
    workers: [Workers; 2],
    answers: mpsc::Receiver<(Ticket, Result<Answer, NoAnswer>)>,
    answered: mpsc::Sender<(Ticket, Result<Answer, NoAnswer>)>,
    _alive: zenav_protocol::bus::AliveToken,
}

/// Where clients' requests come in.
struct Desk {
    goal: Server<GoalRequest, GoalReply>,
    cancel: Server<CancelRequest, GoalReply>,
    pause: Server<PauseRequest, GoalReply>,
    goals: Server<GoalsRequest, GoalsReply>,
    info: Server<InfoRequest, InfoReply>,
}

/// A client that waits for its answer.
enum Waiting {
    Goal(Query<GoalRequest, GoalReply>),
    Cancel(Query<CancelRequest, GoalReply>),
    Pause(Query<PauseRequest, GoalReply>),
    Goals(Query<GoalsRequest, GoalsReply>),
    Info(Query<InfoRequest, InfoReply>),
}

impl Desk {
    /// The next request; `None` when the bus was closed.
    async fn next(&mut self) -> Option<Waiting> {
        tokio::select! {
            request = self.goal.next() => request.map(Waiting::Goal),
            request = self.cancel.next() => request.map(Waiting::Cancel),
            request = self.pause.next() => request.map(Waiting::Pause),
            request = self.goals.next() => request.map(Waiting::Goals),
            request = self.info.next() => request.map(Waiting::Info),
        }
    }
}

impl Waiting {
    fn request(&self) -> Request {
        match self {
            Self::Goal(query) => Request::Goal(Box::new(query.body.clone())),
            Self::Cancel(query) => Request::Cancel(query.body.clone()),
            Self::Pause(query) => Request::Pause(query.body.clone()),
            Self::Goals(query) => Request::Goals(query.body.clone()),
            Self::Info(query) => Request::Info(query.body.clone()),
        }
    }

    fn answer(self, answer: Result<Response, Refusal>) {
        match (self, answer) {
            (Self::Goal(query), Ok(Response::Goal(reply))) => query.reply(&reply),
            (Self::Cancel(query), Ok(Response::Goal(reply))) => query.reply(&reply),
            (Self::Pause(query), Ok(Response::Goal(reply))) => query.reply(&reply),
            (Self::Goals(query), Ok(Response::Goals(reply))) => query.reply(&reply),
            (Self::Info(query), Ok(Response::Info(reply))) => query.reply(&reply),
            (waiting, answer) => {
                let refusal = answer.err().unwrap_or_else(|| Refusal::Internal {
                    reason: "an answer of another kind".to_owned(),
                });
                match waiting {
                    Self::Goal(query) => query.refuse(&refusal),
                    Self::Cancel(query) => query.refuse(&refusal),
                    Self::Pause(query) => query.refuse(&refusal),
                    Self::Goals(query) => query.refuse(&refusal),
                    Self::Info(query) => query.refuse(&refusal),
                }
            }
        }
    }
}

impl Shell {
    fn open(bus: Bus, config: &MissionConfig, store: Store) -> Result<Self, BusError> {
        let robot = config.robot.to_string();
        let name = [robot.as_str()];
        let (answered, answers) = mpsc::channel(MAX_ANSWERS);
        Ok(Self {
            desk: Desk {
                goal: bus.serve(&topics::GOAL, &name)?,
                cancel: bus.serve(&topics::CANCEL, &name)?,
                pause: bus.serve(&topics::PAUSE, &name)?,
                goals: bus.serve(&topics::GOALS, &name)?,
                info: bus.serve(&topics::CLOUD_INFO, &name)?,
            },
            state: bus.latest(&topics::STATE, &name)?,
            pose: bus.latest(&topics::POSE, &name)?,
            events: bus.subscribe(&topics::EVENT, &name, MAX_WAITING)?,
            map_info: bus.latest(&topics::MAP_INFO, &name)?,
            map_patches: bus.subscribe(&topics::MAP_PATCH, &name, MAX_WAITING)?,
            heartbeat: bus.publisher(&topics::HEARTBEAT, &name)?,
            plan: bus.publisher(&topics::PLAN, &name)?,
            status: bus.publisher(&topics::MISSION, &name)?,
            goals: Vec::new(),
            workers: [Workers::watch(&bus, "plan")?, Workers::watch(&bus, "smooth")?],
            _alive: bus.declare_alive(topics::alive_key(topics::ALIVE_COMPONENT, &[&robot, "mission"]))?,
            clients: BTreeMap::new(),
            next_client: 0,
            store: Arc::new(store),
            robot,
            bus,
            answers,
            answered,
        })
    }

    fn receive(&mut self, waiting: Waiting, inputs: &mut Inputs) {
        self.next_client += 1;
        let client = Client(self.next_client);
        inputs.requests.push((client, waiting.request()));
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
        for workers in &mut self.workers {
            workers.update();
        }
    }

    async fn carry_out(&mut self, effects: Vec<Effect>) -> Result<(), MissionError> {
        for effect in effects {
            match effect {
                Effect::Persist(records) => self.store(records).await?,
                Effect::Heartbeat(heartbeat) => self.heartbeat.put(&heartbeat),
                Effect::Plan(plan) => self.plan.put(&plan),
                Effect::Status(status) => self.status.put(&status),
                Effect::Goal(goal) => self.publish_goal(&goal)?,
                Effect::Ask(ticket, ask) => self.ask(ticket, ask),
                Effect::Reply(client, answer) => {
                    if let Some(waiting) = self.clients.remove(&client) {
                        waiting.answer(answer);
                    }
                }
                Effect::Fatal(why) => return Err(MissionError::Mismatch(why)),
            }
        }
        Ok(())
    }

    async fn store(&self, records: Vec<Record>) -> Result<(), StoreError> {
        let store = Arc::clone(&self.store);
        blocking(move || store.write(&records)).await?
    }

    fn publish_goal(&mut self, goal: &GoalState) -> Result<(), BusError> {
        let place = match self.goals.iter().position(|(id, _)| *id == goal.id) {
            Some(place) => place,
            None => {
                if self.goals.len() == MAX_GOAL_PUBLISHERS {
                    self.goals.remove(0);
                }
                let publisher = self.bus.publisher(&topics::GOAL_STATE, &[&self.robot, &goal.id])?;
                self.goals.push((goal.id.clone(), publisher));
                self.goals.len() - 1
            }
        };
        if let Some((_, publisher)) = self.goals.get(place) {
            publisher.put(goal);
        }
        Ok(())
    }

    fn ask(&self, ticket: Ticket, ask: Ask) {
        let (bus, robot, answered) = (self.bus.clone(), self.robot.clone(), self.answered.clone());
        let [planners, smoothers] = self.workers.clone();
        tokio::spawn(async move {
            let answer = carry(&bus, &robot, &planners, &smoothers, ask).await;
            // The receiver lives as long as the mission does.
            let _ = answered.send((ticket, answer)).await;
        });
    }
}

/// Carries one question to whom it is for.
async fn carry(bus: &Bus, robot: &str, planners: &Workers, smoothers: &Workers, ask: Ask) -> Result<Answer, NoAnswer> {
    let patience = Duration::from_secs_f64(ask.patience_secs());
    let name = [robot];
    let no = |error: AskError| match error {
        AskError::Refused(refusal @ (Refusal::Busy { .. } | Refusal::NotLeader)) => {
            NoAnswer::Silent(refusal.to_string())
        }
        AskError::Refused(refusal) => NoAnswer::Refused(refusal),
        other => NoAnswer::Silent(other.to_string()),
    };
    match ask {
        Ask::Lease(request) => bus
            .ask(&topics::LEASE, &name, &request, patience)
            .await
            .map(Answer::Lease)
            .map_err(no),
        Ask::EdgeInfo(request) => bus
            .ask(&topics::EDGE_INFO, &name, &request, patience)
            .await
            .map(|info| Answer::EdgeInfo(Box::new(info)))
            .map_err(no),
        Ask::Behaviour(request) => bus
            .ask(&topics::BEHAVIOUR, &name, &request, patience)
            .await
            .map(Answer::Behaviour)
            .map_err(no),
        Ask::Map(request) => bus
            .ask(&topics::MAP, &name, &request, patience)
            .await
            .map(|map| Answer::Map(Box::new(map)))
            .map_err(no),
        Ask::Remote(server, request) => bus
            .ask(&topics::REMOTE_ACTION, &[&server], &request, patience)
            .await
            .map(|reply| Answer::Remote(Box::new(reply)))
            .map_err(no),
        Ask::Plan(request) => {
            let each = Duration::from_millis(request.budget_ms.min(60_000)) + Duration::from_millis(500);
            let end = Instant::now() + patience;
            let mut last = NoAnswer::Silent("no planning worker is there".to_owned());
            while let Some((worker, deadline)) = planners.next(end, each).await {
                match bus.ask(&topics::PLAN_SERVICE, &[&worker], &*request, deadline).await {
                    Ok(reply) => return Ok(Answer::Plan(reply)),
                    Err(error) => match no(error) {
                        refused @ NoAnswer::Refused(_) => return Err(refused),
                        silent => last = planners.failed(&worker, silent),
                    },
                }
            }
            Err(last)
        }
        Ask::Smooth(request) => {
            let end = Instant::now() + patience;
            let mut last = NoAnswer::Silent("no smoothing worker is there".to_owned());
            while let Some((worker, deadline)) = smoothers.next(end, patience / 2).await {
                match bus.ask(&topics::SMOOTH_SERVICE, &[&worker], &*request, deadline).await {
                    Ok(reply) => return Ok(Answer::Smooth(Box::new(reply))),
                    Err(error) => match no(error) {
                        refused @ NoAnswer::Refused(_) => return Err(refused),
                        silent => last = smoothers.failed(&worker, silent),
                    },
                }
            }
            Err(last)
        }
    }
}

/// The live workers of a service, and whose turn it is.
#[derive(Clone)]
struct Workers {
    watch: Arc<Mutex<AliveWatch>>,
    pool: Arc<Mutex<Pool>>,
}

#[derive(Default)]
struct Pool {
    live: BTreeSet<String>,
    /// Asked last, and the reason why it is not to be asked first again.
    failed: BTreeSet<String>,
}

impl Workers {
    fn watch(bus: &Bus, service: &str) -> Result<Self, BusError> {
        let watch = bus.watch_alive(topics::alive_key(topics::ALIVE_WORKER, &[service, "*"]))?;
        Ok(Self {
            watch: Arc::new(Mutex::new(watch)),
            pool: Arc::default(),
        })
    }

    fn update(&self) {
        let mut watch = self.watch.lock().unwrap_or_else(PoisonError::into_inner);
        let mut pool = self.pool.lock().unwrap_or_else(PoisonError::into_inner);
        while let Some((key, up)) = watch.try_next() {
            let Some(worker) = topics::alive_chunks(topics::ALIVE_WORKER, &key)
                .and_then(|chunks| chunks.get(1).map(|worker| (*worker).to_owned()))
            else {
                continue;
            };
            pool.failed.remove(&worker);
            if up {
                pool.live.insert(worker);
            } else {
                pool.live.remove(&worker);
            }
        }
    }

    /// The next worker to ask and for how long; `None` when time is up. One that failed is asked after all others.
    async fn next(&self, end: Instant, each: Duration) -> Option<(String, Duration)> {
        loop {
            let left = end
                .checked_duration_since(Instant::now())
                .filter(|left| !left.is_zero())?;
            self.update();
            let worker = {
                let mut pool = self.pool.lock().unwrap_or_else(PoisonError::into_inner);
                let worker = pool.live.iter().find(|worker| !pool.failed.contains(*worker)).cloned();
                if worker.is_none() {
                    // All have failed: after a pause they all get another chance.
                    pool.failed.clear();
                }
                worker
            };
            match worker {
                Some(worker) => return Some((worker, each.min(left))),
                None => tokio::time::sleep(NO_WORKER.min(left)).await,
            }
        }
    }

    fn failed(&self, worker: &str, why: NoAnswer) -> NoAnswer {
        tracing::info!(worker, %why, "moves on to another worker");
        self.pool
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .failed
            .insert(worker.to_owned());
        why
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::bus::{BusConfig, Router, RouterConfig};
    use zenav_protocol::id::Id;

    const DEADLINE: Duration = Duration::from_secs(10);

    fn to(id: &str) -> GoalRequest {
        GoalRequest {
            id: Some(id.into()),
            x: Some(1.0),
            y: Some(2.0),
            ..GoalRequest::default()
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_goal_is_answered_kept_over_a_restart_and_told_to_whoever_listens() {
        let config = RouterConfig {
            listen: vec!["tcp/127.0.0.1:0".into()],
            ..RouterConfig::default()
        };
        let router = Router::open(&config).await.unwrap();
        let endpoint = router.endpoints().await.remove(0);
        let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
        let folder = tempfile::tempdir().unwrap();
        let config = MissionConfig::new(
            Id::robot("tiago").unwrap(),
            "mission",
            folder.path().join("mission.redb"),
        );
        let (client, chunks) = (open("client").await.unwrap(), ["tiago"]);
        let begin = async || {
            let shutdown = Shutdown::new();
            let bus = open("mission").await.unwrap();
            (
                tokio::spawn(run(bus, Clock::wall(), config.clone(), shutdown.clone())),
                shutdown,
            )
        };

        let (service, shutdown) = begin().await;
        let reply = client.ask(&topics::GOAL, &chunks, &to("a"), DEADLINE).await.unwrap();
        assert_eq!((reply.id.as_str(), reply.state), ("a", GoalPhase::Accepted));
        let second = run(
            open("second").await.unwrap(),
            Clock::wall(),
            config.clone(),
            Shutdown::new(),
        )
        .await;
        assert!(matches!(second, Err(MissionError::Store(StoreError::Locked { .. }))));
        let bad = client
            .ask(&topics::GOAL, &chunks, &GoalRequest::default(), DEADLINE)
            .await;
        assert!(matches!(bad, Err(AskError::Refused(Refusal::BadRequest { .. }))));
        shutdown.trigger();
        service.await.unwrap().unwrap();

        let (service, shutdown) = begin().await;
        let again = client.ask(&topics::GOAL, &chunks, &to("a"), DEADLINE).await.unwrap();
        assert_eq!(again.state, GoalPhase::Active);
        let mut states = client.latest(&topics::GOAL_STATE, &["tiago", "a"]).unwrap();
        let cancel = CancelRequest {
            id: None,
            request_id: Some("c".into()),
        };
        let ended = client.ask(&topics::CANCEL, &chunks, &cancel, DEADLINE).await.unwrap();
        assert_eq!(ended.state, GoalPhase::Canceled);
        let told = async {
            loop {
                let state = states.next().await.unwrap().message;
                if state.state.is_end() {
                    return state;
                }
            }
        };
        assert_eq!(
            tokio::time::timeout(DEADLINE, told).await.unwrap().state,
            GoalPhase::Canceled
        );
        let goals = client
            .ask(&topics::GOALS, &chunks, &GoalsRequest::default(), DEADLINE)
            .await
            .unwrap();
        assert_eq!(goals.goals.len(), 1);
        shutdown.trigger();
        service.await.unwrap().unwrap();
        router.close().await;
    }
}
