//! Lease of an operator. Kept by heartbeats until it is released; when they stop, it expires on the robot.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use tokio::task::JoinHandle;
use tokio::time::MissedTickBehavior;
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{Heartbeat, LeaseAction, LeaseReply, LeaseRequest, LeaseRole};
use zenav_protocol::topics;

/// Period of the heartbeats; the robot waits up to a second for one.
const PERIOD: Duration = Duration::from_millis(50);
/// Releasing is a courtesy: the lease expires by itself.
const RELEASE_WITHIN: Duration = Duration::from_millis(800);

/// Acquires or releases the operator's lease.
///
/// # Errors
/// [`AskError::Refused`] if the present holder keeps the lease; no answer in time.
pub async fn ask_lease(
    bus: &Bus,
    robot: &str,
    holder: &str,
    action: LeaseAction,
    within: Duration,
) -> Result<LeaseReply, AskError> {
    let request = LeaseRequest::new(holder, LeaseRole::Operator, action, format!("lease-{}", Id::unique()));
    bus.ask(&topics::LEASE, &[robot], &request, within).await
}

/// A lease, renewed until it is released or dropped.
#[derive(Debug)]
pub struct LeaseSession {
    bus: Bus,
    robot: String,
    holder: String,
    /// The robot's grant.
    pub grant: LeaseReply,
    heartbeats: JoinHandle<()>,
}

impl LeaseSession {
    /// Acquires the lease and begins to renew it.
    ///
    /// # Errors
    /// As [`ask_lease`].
    pub async fn acquire(bus: &Bus, robot: &str, holder: &str, within: Duration) -> Result<Self, AskError> {
        let publisher = bus.publisher(&topics::HEARTBEAT, &[robot])?;
        let grant = ask_lease(bus, robot, holder, LeaseAction::Acquire, within).await?;
        // A holder that acquires again, maybe from another process, may get the same epoch: the counter must exceed all sent before.
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let mut heartbeat = Heartbeat {
            holder: holder.to_owned(),
            epoch: grant.epoch,
            counter: u64::try_from(since.as_micros()).unwrap_or_default(),
            echo: None,
        };
        let heartbeats = tokio::spawn(async move {
            let mut pace = tokio::time::interval(PERIOD);
            pace.set_missed_tick_behavior(MissedTickBehavior::Skip);
            loop {
                pace.tick().await;
                heartbeat.counter += 1;
                publisher.put(&heartbeat);
            }
        });
        Ok(Self {
            bus: bus.clone(),
            robot: robot.to_owned(),
            holder: holder.to_owned(),
            grant,
            heartbeats,
        })
    }

    /// Releases the lease.
    ///
    /// # Errors
    /// As [`ask_lease`]; the lease then expires by itself.
    pub async fn release(self) -> Result<(), AskError> {
        self.heartbeats.abort();
        let (bus, robot, holder) = (&self.bus, &self.robot, &self.holder);
        ask_lease(bus, robot, holder, LeaseAction::Release, RELEASE_WITHIN).await?;
        Ok(())
    }
}

impl Drop for LeaseSession {
    fn drop(&mut self) {
        self.heartbeats.abort();
    }
}
