//! Workers. Who answers the mission's own requests? The robot, mapping, and of several workers one after another until one answers.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::time::Instant;
use zenav_protocol::bus::{AliveWatch, AskError, Bus, BusError};
use zenav_protocol::messages::Refusal;
use zenav_protocol::topics;

use zenav_mission::io::{Answer, Ask, NoAnswer};

/// What a worker's answer may take beyond its budget.
const ANSWERED: Duration = Duration::from_millis(500);
/// Pause before workers are looked for again.
const NO_WORKER: Duration = Duration::from_millis(100);

/// Sends one request to its server.
pub(super) async fn carry(bus: &Bus, robot: &str, workers: &Workers, ask: Ask) -> Result<Answer, NoAnswer> {
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
        Ask::Motion(request) => {
            let each = request.budget() + ANSWERED;
            let end = Instant::now() + patience;
            let mut last = NoAnswer::Silent("no motion worker is there".to_owned());
            while let Some((worker, deadline)) = workers.next(end, each).await {
                match bus.ask(&topics::MOTION_SERVICE, &[&worker], &*request, deadline).await {
                    Ok(reply) => return Ok(Answer::Motion(Box::new(reply))),
                    Err(error) => match no(error) {
                        refused @ NoAnswer::Refused(_) => return Err(refused),
                        silent => last = workers.failed(&worker, silent),
                    },
                }
            }
            Err(last)
        }
    }
}

/// The live workers of a service, and whose turn it is.
#[derive(Clone)]
pub(super) struct Workers {
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
    pub(super) fn watch(bus: &Bus, service: &str) -> Result<Self, BusError> {
        let watch = bus.watch_alive(topics::alive_key(topics::ALIVE_WORKER, &[service, "*"]))?;
        Ok(Self {
            watch: Arc::new(Mutex::new(watch)),
            pool: Arc::default(),
        })
    }

    pub(super) fn update(&self) {
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
        tracing::info!(worker, %why, "trying another worker");
        self.pool
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .failed
            .insert(worker.to_owned());
        why
    }
}
