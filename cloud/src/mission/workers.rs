//! Workers. Sends the mission's own requests: to the robot, to mapping, and to the motion workers that [`WorkerPool`] chooses, until one
//! answers.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::task::JoinSet;
use tokio::time::Instant;
use zenav_mission::{Answer, Ask, NoAnswer};
use zenav_observability::metrics::MOTION_ROUND_TRIP;
use zenav_protocol::bus::{AliveWatch, AskError, Bus, BusError};
use zenav_protocol::messages::{MotionReply, MotionRequest, Refusal};
use zenav_protocol::topics;

use super::worker_pool::WorkerPool;

/// Time allowed for a worker's answer beyond its budget.
const ANSWERED: Duration = Duration::from_millis(500);
/// Most workers asked the same request at once.
const AT_ONCE: usize = 2;
/// Pause before workers are tried again.
const NO_WORKER: Duration = Duration::from_millis(100);

/// Sends one request to its server.
pub(super) async fn carry(bus: &Bus, robot: &str, workers: &Workers, ask: Ask) -> Result<Answer, NoAnswer> {
    let patience = Duration::from_secs_f64(ask.patience_secs());
    let name = [robot];
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
        Ask::Localise(request) => bus
            .ask(&topics::LOCALISE, &name, &request, patience)
            .await
            .map(Answer::Localised)
            .map_err(no),
        Ask::Remote(server, request) => bus
            .ask(&topics::REMOTE_ACTION, &[&server], &request, patience)
            .await
            .map(|reply| Answer::Remote(Box::new(reply)))
            .map_err(no),
        Ask::Motion(request) => {
            let begun = Instant::now();
            let reply = workers.ask(bus, robot, Arc::new(*request), patience).await;
            let outcome = match &reply {
                Ok(_) => "answered",
                Err(NoAnswer::Refused(_)) => "refused",
                Err(_) => "silent",
            };
            let seconds = begun.elapsed().as_secs_f64();
            MOTION_ROUND_TRIP.with_label_values(&[robot, outcome]).observe(seconds);
            reply.map(|reply| Answer::Motion(Box::new(reply)))
        }
    }
}

/// Translates a bus error for the mission.
fn no(error: AskError) -> NoAnswer {
    match error {
        AskError::Refused(refusal @ (Refusal::Busy { .. } | Refusal::NotLeader)) => {
            NoAnswer::Silent(refusal.to_string())
        }
        AskError::Refused(refusal) => NoAnswer::Refused(refusal),
        other => NoAnswer::Silent(other.to_string()),
    }
}

/// The live workers of a service, as seen by one of its clients.
#[derive(Clone)]
pub struct Workers {
    watch: Arc<Mutex<AliveWatch>>,
    pool: Arc<Mutex<WorkerPool>>,
    began: Instant,
}

/// One worker's answer or failure, and how long it took.
struct Answered {
    worker: String,
    took: Duration,
    reply: Result<MotionReply, AskError>,
}

/// Asks one worker, until the deadline at most; reports the time that it took.
async fn ask_one(bus: Bus, worker: String, request: Arc<MotionRequest>, deadline: Duration) -> Answered {
    let began = Instant::now();
    let reply = bus.ask(&topics::MOTION_SERVICE, &[&worker], &*request, deadline).await;
    Answered {
        worker,
        took: began.elapsed(),
        reply,
    }
}

impl fmt::Debug for Workers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Workers").finish_non_exhaustive()
    }
}

impl Workers {
    /// Watches workers join and leave.
    ///
    /// # Errors
    /// [`BusError::Closed`].
    pub fn watch(bus: &Bus, service: &str) -> Result<Self, BusError> {
        let watch = bus.watch_alive(topics::alive_key(topics::ALIVE_WORKER, &[service, "*"]))?;
        Ok(Self {
            watch: Arc::new(Mutex::new(watch)),
            pool: Arc::default(),
            began: Instant::now(),
        })
    }

    fn pool(&self) -> MutexGuard<'_, WorkerPool> {
        self.pool.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of workers.
    pub(super) fn count(&self) -> usize {
        self.pool().len()
    }

    pub(super) fn update(&self) {
        let mut watch = self.watch.lock().unwrap_or_else(PoisonError::into_inner);
        let mut pool = self.pool();
        while let Some((key, up)) = watch.try_next() {
            let chunks = topics::alive_chunks(topics::ALIVE_WORKER, &key);
            if let Some(worker) = chunks.and_then(|chunks| chunks.get(1).copied()) {
                pool.set_live(worker, up);
            }
        }
    }

    /// Asks for a robot's motion: one worker after another, a second one in parallel when the first takes long, until one answers or time
    /// is up.
    ///
    /// # Errors
    /// A worker's refusal, or why none answered.
    pub async fn ask(
        &self,
        bus: &Bus,
        robot: &str,
        request: Arc<MotionRequest>,
        patience: Duration,
    ) -> Result<MotionReply, NoAnswer> {
        let each = request.budget() + ANSWERED;
        let end = Instant::now() + patience;
        let mut last = NoAnswer::Silent("no motion worker is there".to_owned());
        // Dropping this cancels the requests that are still open.
        let mut asked = JoinSet::new();
        let (mut tried, mut running) = (BTreeSet::new(), BTreeSet::new());
        loop {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(last);
            }
            self.update();
            let next = self
                .pool()
                .choose(robot, &tried, self.began.elapsed())
                .map(str::to_owned);
            let may_hedge = match next {
                Some(worker) => {
                    tried.insert(worker.clone());
                    running.insert(worker.clone());
                    asked.spawn(ask_one(bus.clone(), worker, Arc::clone(&request), each.min(left)));
                    running.len() < AT_ONCE
                }
                // Every live worker has failed, the last one with an internal error.
                None if running.is_empty() && matches!(last, NoAnswer::Refused(_)) => return Err(last),
                None if running.is_empty() => {
                    // All have failed, or there is none: after a pause all are tried again.
                    tried.clear();
                    tokio::time::sleep(NO_WORKER.min(left)).await;
                    continue;
                }
                None => false,
            };
            let hedge = self.pool().hedge_after();
            let done = tokio::select! {
                done = asked.join_next() => done,
                () = tokio::time::sleep(hedge), if may_hedge => continue,
            };
            let Some(Ok(answered)) = done else {
                last = NoAnswer::Silent("a request broke off".to_owned());
                running.clear();
                continue;
            };
            running.remove(&answered.worker);
            match answered.reply.map_err(no) {
                Ok(reply) => {
                    let mut pool = self.pool();
                    pool.answered(&answered.worker, answered.took);
                    // A worker asked earlier that still has not answered is slow or frozen.
                    running
                        .iter()
                        .for_each(|worker| pool.failed(worker, self.began.elapsed()));
                    return Ok(reply);
                }
                Err(NoAnswer::Refused(refusal)) if !matches!(refusal, Refusal::Internal { .. }) => {
                    return Err(NoAnswer::Refused(refusal));
                }
                Err(none) => {
                    tracing::info!(worker = answered.worker, why = %none, "trying another worker");
                    self.pool().failed(&answered.worker, self.began.elapsed());
                    last = none;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::bus::{AliveToken, BusConfig};
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::messages::{MapRef, PlanOutcome, PlanReply, PlanRequest};

    use super::*;
    use crate::testing::router;

    const ROBOT: &str = "tiago";
    const SERVICE: &str = "motion";
    const LONG: Duration = Duration::from_secs(20);

    /// A worker under a name, until its session closes.
    struct Fake {
        bus: Bus,
        _alive: AliveToken,
    }

    impl Fake {
        /// Answers each request after a time, by the worker's name; never without one.
        async fn start(
            endpoint: &str,
            name: &'static str,
            takes: impl Fn(&str) -> Option<Duration> + Send + 'static,
        ) -> Self {
            let bus = Bus::open(BusConfig::service(name, endpoint)).await.unwrap();
            let mut server = bus.serve(&topics::MOTION_SERVICE, &[name]).unwrap();
            let alive = topics::alive_key(topics::ALIVE_WORKER, &[SERVICE, name]);
            tokio::spawn(async move {
                let mut unanswered = Vec::new();
                while let Some(request) = server.next().await {
                    match takes(name) {
                        Some(time) => {
                            tokio::spawn(async move {
                                tokio::time::sleep(time).await;
                                let map = MapRef {
                                    id: name.to_owned(),
                                    ..MapRef::default()
                                };
                                let reply = PlanReply::without_path(map, PlanOutcome::NoPath);
                                request.reply(&MotionReply::Plan(reply));
                            });
                        }
                        None => unanswered.push(request),
                    }
                }
            });
            Self {
                _alive: bus.declare_alive(alive).unwrap(),
                bus,
            }
        }
    }

    fn request() -> Arc<MotionRequest> {
        Arc::new(MotionRequest::Plan(PlanRequest {
            robot: ROBOT.to_owned(),
            model: zenav_fixtures::robot(ROBOT),
            map: MapRef::default(),
            start: Pose2::IDENTITY,
            via: Vec::new(),
            goal: Pose2::IDENTITY,
            planner: "astar".to_owned(),
            unknown_is_free: false,
            cleared: Vec::new(),
            yield_to: Vec::new(),
            escape: 0.0,
            goal_tolerance: 0.0,
            budget_ms: 3000,
            seed: 1,
        }))
    }

    /// Asks once; returns which worker answered, and after what time.
    async fn ask(workers: &Workers, bus: &Bus) -> (String, Duration) {
        let begun = Instant::now();
        match workers.ask(bus, ROBOT, request(), LONG).await {
            Ok(MotionReply::Plan(reply)) => (reply.map.id, begun.elapsed()),
            other => panic!("{other:?}"),
        }
    }

    /// The robot's own worker takes this long, or for ever, and the other one answers at once: who answers the first two requests?
    async fn answers(own_takes: Option<Duration>) -> [(bool, Duration); 2] {
        let (router, endpoint) = router().await;
        let bus = Bus::open(BusConfig::service("mission", &endpoint)).await.unwrap();
        let workers = Workers::watch(&bus, SERVICE).unwrap();
        // Who is the robot's own follows from the names alone.
        let mut pool = WorkerPool::default();
        ["a", "b"].iter().for_each(|name| pool.set_live(name, true));
        let own = pool.choose(ROBOT, &BTreeSet::new(), Duration::ZERO).unwrap().to_owned();
        let takes = move |own: String| {
            move |name: &str| match name == own {
                true => own_takes,
                false => Some(Duration::ZERO),
            }
        };
        let fakes = [
            Fake::start(&endpoint, "a", takes(own.clone())).await,
            Fake::start(&endpoint, "b", takes(own.clone())).await,
        ];
        let both = async {
            while workers.count() < 2 {
                workers.update();
                tokio::task::yield_now().await;
            }
        };
        tokio::time::timeout(LONG, both).await.unwrap();
        let mut found = Vec::new();
        for _ in 0..2 {
            let (name, took) = ask(&workers, &bus).await;
            found.push((name == own, took));
        }
        for fake in fakes {
            fake.bus.close().await;
        }
        bus.close().await;
        router.close().await;
        found.try_into().unwrap()
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_worker_that_is_slow_or_silent_costs_one_deadline_and_then_nothing() {
        for takes in [Some(Duration::from_secs(8)), None] {
            let [(first_is_own, first), (second_is_own, second)] = answers(takes).await;
            assert!(!first_is_own && !second_is_own, "{takes:?}");
            // The hedge while no answer times are known is half a second; the limit is far from the slow worker's time.
            assert!(
                first >= Duration::from_millis(400) && first < Duration::from_secs(4),
                "{takes:?}: {first:?}"
            );
            assert!(second < first, "{takes:?}: {second:?} after {first:?}");
        }
    }
}
