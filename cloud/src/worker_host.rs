//! How does a worker live on the network? One host for every kind: questions in, answers out, each worked on away from the async threads,
//! on a copy of the robot's map, within a budget.
//!
//! A new kind of worker is a pure core that implements [`Work`] and a service that hands it to [`host`].

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde::de::DeserializeOwned;
use zenav_protocol::bus::{Bus, BusError, Shutdown};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{MapRef, Refusal};
use zenav_protocol::topics::{ALIVE_WORKER, Ask, alive_key};

use crate::map_subscriber::MapSubscriber;
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::padding::Extent;

/// How long the whole map may take to come.
const MAP_DEADLINE: Duration = Duration::from_millis(1500);
/// Longest time that an answer may take, whatever is asked for.
const MAX_BUDGET: Duration = Duration::from_secs(60);

/// What the core of a worker does: it answers one question after the other, and keeps what it prepared.
pub trait Work: Send + 'static {
    /// What is asked.
    type Question: DeserializeOwned + Clone + Send + Sync + 'static;
    /// What is answered.
    type Answer: Serialize + Send + 'static;

    /// Under which key.
    const ASK: Ask<Self::Question, Self::Answer>;
    /// Name of the service, as in its workers' alive tokens.
    const SERVICE: &'static str;

    /// Whose map is needed, and of which state at least.
    fn map_of(question: &Self::Question) -> (&str, &MapRef);

    /// How far beyond the map its copy must reach; `None` where nobody may go where nobody has looked.
    fn outlook(question: &Self::Question) -> Option<Extent>;

    /// Time that the answer may take; then `cancel` is set.
    fn budget(question: &Self::Question) -> Duration;

    /// The answer. `clock` (s) tells times for statistics only.
    ///
    /// # Errors
    /// A [`Refusal`], for a question that is none.
    fn answer(
        &mut self,
        map: Option<&MapReplica>,
        question: &Self::Question,
        clock: &mut dyn FnMut() -> f64,
        cancel: &AtomicBool,
    ) -> Result<Self::Answer, Refusal>;
}

/// Answers under a worker's name until shutdown, or until the bus is closed. `begun` makes a core; `told` sees every answer after it was
/// sent, with the core that gave it.
///
/// # Errors
/// [`BusError`] when a key cannot be declared.
pub async fn host<W: Work>(
    bus: Bus,
    worker: Id,
    shutdown: Shutdown,
    begun: impl Fn() -> W,
    mut told: impl FnMut(&W, &W::Question, &W::Answer),
) -> Result<(), BusError> {
    let mut follower = MapSubscriber::new(&bus)?;
    let mut server = bus.serve(&W::ASK, &[worker.as_str()])?;
    let _alive = bus.declare_alive(alive_key(ALIVE_WORKER, &[W::SERVICE, worker.as_str()]))?;
    let mut core = begun();
    loop {
        let request = tokio::select! {
            () = shutdown.wait() => return Ok(()),
            open = follower.follow() => { debug_assert!(!open); return Ok(()) }
            request = server.next() => match request {
                Some(request) => request,
                None => return Ok(()),
            },
        };
        let (robot, wanted) = W::map_of(&request.body);
        let map = follower.map(robot, wanted, MAP_DEADLINE).await.map(|mirror| {
            if let Some(outlook) = W::outlook(&request.body) {
                mirror.reach(&outlook);
            }
            mirror.clone()
        });
        let question = Arc::new(request.body.clone());
        let (back, answer) = work(core, &begun, map, Arc::clone(&question), &shutdown).await;
        core = back;
        match answer {
            Ok(answer) => {
                request.reply(&answer);
                told(&core, &question, &answer);
            }
            Err(refusal) => request.refuse(&refusal),
        }
    }
}

/// One answer on a thread that may block. The core comes back with it; one that breaks off is replaced.
async fn work<W: Work>(
    mut core: W,
    begun: impl Fn() -> W,
    map: Option<MapReplica>,
    question: Arc<W::Question>,
    shutdown: &Shutdown,
) -> (W, Result<W::Answer, Refusal>) {
    let budget = W::budget(&question).min(MAX_BUDGET);
    let cancel = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&cancel);
    let mut working = tokio::task::spawn_blocking(move || {
        let began = Instant::now();
        let answer = core.answer(map.as_ref(), &question, &mut || began.elapsed().as_secs_f64(), &flag);
        (core, answer)
    });
    let done = tokio::select! {
        done = &mut working => done,
        () = async { tokio::select! { () = tokio::time::sleep(budget) => {} () = shutdown.wait() => {} } } => {
            cancel.store(true, Ordering::Relaxed);
            working.await
        }
    };
    done.unwrap_or_else(|error| {
        let reason = error.to_string();
        (begun(), Err(Refusal::Internal { reason }))
    })
}

#[cfg(test)]
#[allow(clippy::panic, reason = "tests")]
mod tests {
    use zenav_protocol::messages::{PlanReply, PlanRequest};
    use zenav_protocol::topics::PLAN_SERVICE;

    use super::*;

    /// Works until it is cancelled; breaks off when it is asked by a planner of that name.
    #[derive(Default)]
    struct Sisyphus {
        answers: u64,
    }

    impl Work for Sisyphus {
        type Question = PlanRequest;
        type Answer = PlanReply;
        const ASK: Ask<PlanRequest, PlanReply> = PLAN_SERVICE;
        const SERVICE: &'static str = "plan";

        fn map_of(question: &PlanRequest) -> (&str, &MapRef) {
            (&question.robot, &question.map)
        }

        fn outlook(_question: &PlanRequest) -> Option<Extent> {
            None
        }

        fn budget(question: &PlanRequest) -> Duration {
            Duration::from_millis(question.budget_ms)
        }

        fn answer(
            &mut self,
            _map: Option<&MapReplica>,
            question: &PlanRequest,
            _clock: &mut dyn FnMut() -> f64,
            cancel: &AtomicBool,
        ) -> Result<PlanReply, Refusal> {
            assert_ne!(question.planner, "broken");
            while !cancel.load(Ordering::Relaxed) {
                std::thread::yield_now();
            }
            self.answers += 1;
            Err(Refusal::bad_request(self.answers.to_string()))
        }
    }

    fn question(planner: &str, budget_ms: u64) -> PlanRequest {
        let text = serde_json::json!({
            "robot": "r", "map": {"id": "", "revision": 0}, "start": {"x": 0, "y": 0, "yaw": 0}, "goal": {"x": 0, "y": 0, "yaw": 0},
            "model": zenav_protocol::robot::RobotModel::from_toml(zenav_protocol::robot::shipped("tiago").unwrap_or_default(), "tiago").ok(),
            "planner": planner, "budget_ms": budget_ms,
        });
        serde_json::from_value(text).unwrap_or_else(|error| panic!("{error}"))
    }

    #[tokio::test]
    async fn an_answer_ends_with_its_budget_or_with_the_run() {
        let shutdown = Shutdown::new();
        let (core, answer) = work(
            Sisyphus::default(),
            Sisyphus::default,
            None,
            Arc::new(question("slow", 5)),
            &shutdown,
        )
        .await;
        assert_eq!((core.answers, answer), (1, Err(Refusal::bad_request("1"))));
        shutdown.trigger();
        let (core, answer) = work(
            core,
            Sisyphus::default,
            None,
            Arc::new(question("slow", 60_000)),
            &shutdown,
        )
        .await;
        assert_eq!((core.answers, answer), (2, Err(Refusal::bad_request("2"))));
    }

    #[tokio::test]
    async fn a_core_that_breaks_off_is_replaced() {
        let (core, answer) = work(
            Sisyphus { answers: 7 },
            Sisyphus::default,
            None,
            Arc::new(question("broken", 5)),
            &Shutdown::new(),
        )
        .await;
        assert!(matches!(answer, Err(Refusal::Internal { .. })), "{answer:?}");
        assert_eq!(core.answers, 0);
    }
}
