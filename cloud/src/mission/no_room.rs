//! Full disk. A mission that cannot store anything refuses requests and waits for room.
//!
//! Nothing is acknowledged, and requests are refused with the reason. State that was only in memory is given up, as in a crash, so nothing
//! is ever reported that is not stored. The heartbeats stop, so a standby whose disk has room may lead; otherwise the robot is at rest by
//! its plan's expiry. Once there is room, the mission continues from what is stored.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval};
use zenav_mission::config::MissionConfig;
use zenav_mission::store::{Store, StoreError};
use zenav_protocol::bus::{BusError, Shutdown};
use zenav_protocol::messages::Refusal;
use zenav_protocol::topics::MissionRequest;

use super::requests::Pending;
use super::{MissionError, Service, Turn, blocking, metrics};

/// Interval between attempts to store something.
const AGAIN: Duration = Duration::from_secs(1);

/// Opens the store once there is room for it; `None` after a shutdown.
pub(super) async fn open(config: &MissionConfig, shutdown: &Shutdown) -> Result<Option<Arc<Store>>, MissionError> {
    let mut said = false;
    loop {
        let (path, robot) = (config.store.clone(), config.robot.to_string());
        let error = match blocking(move || Store::open(&path, &robot)).await? {
            Ok(store) => return Ok(Some(Arc::new(store))),
            Err(error @ StoreError::NoRoom { .. }) => error,
            Err(error) => return Err(error.into()),
        };
        if !std::mem::replace(&mut said, true) {
            tracing::error!(robot = %config.robot, %error, "no store: the mission waits for room");
        }
        tokio::select! {
            () = shutdown.wait() => return Ok(None),
            () = tokio::time::sleep(AGAIN) => {}
        }
    }
}

/// Refuses everything until something can be stored again.
pub(super) async fn wait(service: &mut Service, error: &StoreError) -> Result<Turn, MissionError> {
    let robot = service.config.robot.clone();
    service.role.unmet();
    metrics::leads(robot.as_str(), false);
    tracing::error!(%robot, %error, "nothing can be stored: the mission waits for room");
    let busy = || Refusal::Busy {
        reason: format!("nothing can be stored, so nothing is acknowledged: {error}"),
    };
    let mut again = interval(AGAIN);
    again.set_missed_tick_behavior(MissedTickBehavior::Skip);
    again.tick().await;
    loop {
        tokio::select! {
            () = service.shutdown.wait() => return Ok(Turn::Over),
            request = service.requests.next() => match request {
                Some(request @ Pending { request: MissionRequest::Info(_), .. }) => service.answer_as_standby(request),
                Some(request) => request.responder.send(Err(busy())),
                None => return Err(BusError::Closed.into()),
            },
            entry = service.journal.next() => match entry {
                Some(entry) => entry.refuse(&busy()),
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
