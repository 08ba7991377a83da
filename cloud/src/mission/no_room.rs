//! Full disk. A mission that cannot store anything refuses requests and waits for room.
//!
//! Nothing is acknowledged, and requests are refused with the reason, also by a mission that starts on a full disk. State that was only in
//! memory is given up, as in a crash, so nothing is ever reported that is not stored. The heartbeats stop, so a standby whose disk has room
//! may lead; otherwise the robot is at rest by its plan's expiry. Once there is room, the mission continues from what is stored.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval, sleep};
use zenav_mission::{MissionConfig, MissionStore, StoreError};
use zenav_protocol::bus::{AliveToken, Bus, BusError, Shutdown};
use zenav_protocol::messages::{InfoReply, Refusal};
use zenav_protocol::topics::{MissionReply, MissionRequest};

use super::{MissionError, Pending, Requests, Service, Turn, announce, blocking, identity, metrics};

/// Interval between attempts to store something: a robot at rest waits for the next one once there is room.
const AGAIN: Duration = Duration::from_millis(250);

/// An open store, and the mission's requests and token if it already shows itself.
type Opened = (Arc<MissionStore>, Option<(Requests, AliveToken)>);

/// Opens the store once there is room for it; `None` after a shutdown. While it waits, it shows itself and refuses everything. A mission
/// that waits for nothing does not: its store may be another process's.
pub(super) async fn open(
    bus: &Bus,
    config: &MissionConfig,
    shutdown: &Shutdown,
) -> Result<Option<Opened>, MissionError> {
    let mut announced: Option<(Requests, AliveToken)> = None;
    loop {
        let (path, robot) = (config.store.clone(), config.robot.to_string());
        let error = match blocking(move || MissionStore::open(&path, &robot)).await? {
            Ok(store) => return Ok(Some((Arc::new(store), announced))),
            Err(error @ StoreError::NoRoom { .. }) => error,
            Err(error) => return Err(error.into()),
        };
        let (requests, _) = match &mut announced {
            Some(shown) => shown,
            None => {
                let shown = announced.insert(announce(bus, config)?);
                tracing::error!(robot = %config.robot, %error, "no store: the mission waits for room");
                shown
            }
        };
        let again = sleep(AGAIN);
        tokio::pin!(again);
        loop {
            tokio::select! {
                () = shutdown.wait() => return Ok(None),
                () = &mut again => break,
                request = requests.next() => match request {
                    Some(request) => answer(request, &error, || InfoReply {
                        not_stored: Some(error.to_string()),
                        ..identity(bus, config)
                    }),
                    None => return Err(BusError::Closed.into()),
                },
            }
        }
    }
}

/// Answers who this mission is, and refuses everything else.
fn answer(call: Pending, error: &StoreError, info: impl FnOnce() -> InfoReply) {
    call.responder.send(match call.request {
        MissionRequest::Info(_) => Ok(MissionReply::Info(info())),
        _ => Err(busy(error)),
    });
}

fn busy(error: &StoreError) -> Refusal {
    Refusal::Busy {
        reason: format!("nothing can be stored, so nothing is acknowledged: {error}"),
    }
}

/// Refuses everything until something can be stored again.
pub(super) async fn wait(service: &mut Service, error: &StoreError) -> Result<Turn, MissionError> {
    let robot = service.config.robot.clone();
    service.role.unmet();
    metrics::leads(robot.as_str(), false);
    tracing::error!(%robot, %error, "nothing can be stored: the mission waits for room");
    let mut again = interval(AGAIN);
    again.set_missed_tick_behavior(MissedTickBehavior::Skip);
    again.tick().await;
    loop {
        tokio::select! {
            () = service.shutdown.wait() => return Ok(Turn::Over),
            request = service.requests.next() => match request {
                Some(request) => answer(request, error, || service.info(Some(error.to_string()))),
                None => return Err(BusError::Closed.into()),
            },
            entry = service.journal.next() => match entry {
                Some(entry) => entry.refuse(&busy(error)),
                None => return Err(BusError::Closed.into()),
            },
            _ = again.tick() => {
                let store = Arc::clone(&service.store);
                match blocking(move || store.reopen().and_then(|()| store.try_to_write())).await? {
                    Ok(()) => {
                        tracing::info!(%robot, "there is room again: the mission goes on");
                        return Ok(Turn::Lead);
                    }
                    Err(StoreError::NoRoom { .. }) => {}
                    Err(error) => return Err(error.into()),
                }
            }
        }
    }
}
