//! How does a planning worker live on the network? Requests in, ways out. Thin: [`PlanWorker`] answers.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use zenav_protocol::bus::{Bus, BusError, Shutdown};
use zenav_protocol::id::Id;
use zenav_protocol::messages::Refusal;
use zenav_protocol::topics::{ALIVE_WORKER, PLAN_SERVICE, alive_key};

use super::worker::PlanWorker;
use crate::mapping::follower::MapFollower;

/// How long the whole map may take to come.
const MAP_DEADLINE: Duration = Duration::from_millis(1500);
/// Longest time that a search may take, whatever is asked for.
const MAX_BUDGET: Duration = Duration::from_secs(60);

/// Answers plan requests under a worker's name until shutdown, or until the bus is closed.
///
/// # Errors
/// [`BusError`] when a key cannot be declared.
pub async fn run(bus: Bus, worker: Id, shutdown: Shutdown) -> Result<(), BusError> {
    let mut follower = MapFollower::new(&bus)?;
    let mut server = bus.serve(&PLAN_SERVICE, &[worker.as_str()])?;
    let _alive = bus.declare_alive(alive_key(ALIVE_WORKER, &["plan", worker.as_str()]))?;
    let mut core = PlanWorker::default();
    loop {
        let request = tokio::select! {
            () = shutdown.wait() => return Ok(()),
            open = follower.follow() => { debug_assert!(!open); return Ok(()) }
            request = server.next() => match request {
                Some(request) => request,
                None => return Ok(()),
            },
        };
        let map = follower
            .map(&request.body.robot, &request.body.map, MAP_DEADLINE)
            .await
            .cloned();
        let cancel = Arc::new(AtomicBool::new(false));
        let budget = Duration::from_millis(request.body.budget_ms).min(MAX_BUDGET);
        let (body, flag) = (request.body.clone(), Arc::clone(&cancel));
        // A search is no work for an async thread; the core comes back with the answer.
        let search = tokio::task::spawn_blocking(move || {
            let began = Instant::now();
            let answer = core.answer(map.as_ref(), &body, Some(&flag)).map(|mut reply| {
                reply.search_ms = began.elapsed().as_secs_f64() * 1e3;
                reply
            });
            (core, answer)
        });
        let guarded = async {
            tokio::pin!(search);
            tokio::select! {
                done = &mut search => done,
                () = tokio::time::sleep(budget) => {
                    cancel.store(true, Ordering::Relaxed);
                    search.await
                }
            }
        };
        let answer = match guarded.await {
            Ok((back, answer)) => {
                core = back;
                answer
            }
            Err(error) => {
                core = PlanWorker::default();
                Err(Refusal::Internal {
                    reason: error.to_string(),
                })
            }
        };
        match answer {
            Ok(reply) => request.reply(&reply),
            Err(refusal) => request.refuse(&refusal),
        }
    }
}
