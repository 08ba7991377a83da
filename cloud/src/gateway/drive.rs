//! Hand control. A browser drives a robot under its own operator lease, by twists that echo the robot's newest stamp.
//!
//! Two dead-man's switches: a command acts for 0.3 s after the browser sent it ([`zenav_gateway::Hold`]), and the robot applies a twist
//! until the stamp it echoes is 0.3 s old. When the browser releases the drive, the robot is stopped and the lease released.

use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior, interval};
use zenav_gateway::{AskFailure, Drive, Hold, Hub};
use zenav_protocol::bus::{Bus, BusError, Latest, Publisher};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{EdgeState, Heartbeat, LeaseAction, Odometry, Teleop};
use zenav_protocol::topics::{HEARTBEAT, ODOMETRY, STATE, TELEOP};

use super::asks::failure;
use crate::operator::ask_lease;

/// Period of twists and heartbeats.
const PERIOD: Duration = Duration::from_millis(50);
/// Longest wait for the lease.
const TAKE_WITHIN: Duration = Duration::from_secs(2);
/// Releasing is a courtesy: the lease expires by itself.
const GIVE_WITHIN: Duration = Duration::from_millis(800);
/// A robot that reports another lease holder for longer than this has revoked our lease.
const LOST_AFTER: Duration = Duration::from_millis(400);

/// Acquires the operator lease and drives until the [`Drive`] is dropped or the robot grants the lease to another holder.
pub(super) async fn begin(bus: Bus, hub: Arc<Hub>, robot: String, by: String) -> Result<Drive, AskFailure> {
    // A unique holder name: when two browsers drive one robot, each sees that the other has taken the lease.
    let unique = Id::unique().to_string();
    let holder = format!("{by}-{}", unique.get(..8).unwrap_or(&unique));
    let closed = |error: BusError| AskFailure::Unavailable {
        reason: error.to_string(),
    };
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let (commands, asked) = watch::channel(None);
    let (end, ended) = watch::channel(None);
    let states = bus.latest(&STATE, &[&robot]).map_err(closed)?;
    let odometry = bus.latest(&ODOMETRY, &[&robot]).map_err(closed)?;
    let teleop = bus.publisher(&TELEOP, &[&robot]).map_err(closed)?;
    let heartbeats = bus.publisher(&HEARTBEAT, &[&robot]).map_err(closed)?;
    let grant = ask_lease(&bus, &robot, &holder, LeaseAction::Acquire, TAKE_WITHIN)
        .await
        .map_err(failure)?;
    let hand = Hand {
        states,
        odometry,
        teleop,
        heartbeats,
        heartbeat: Heartbeat {
            holder: holder.clone(),
            epoch: grant.epoch,
            counter: u64::try_from(since.as_micros()).unwrap_or_default(),
            echo: None,
        },
        echo: None,
        foreign: None,
        hub,
        asked,
    };
    tokio::spawn(async move {
        let why = hand.run().await;
        if why.is_none() {
            // Without renewal the lease expires by itself.
            let _ = ask_lease(&bus, &robot, &holder, LeaseAction::Release, GIVE_WITHIN).await;
        }
        end.send_replace(why);
    });
    Ok(Drive { commands, ended })
}

/// A hand-control session.
struct Hand {
    states: Latest<EdgeState>,
    /// For its stamps: odometry comes every tick of the robot, five times as often as the state.
    odometry: Latest<Odometry>,
    teleop: Publisher<Teleop>,
    heartbeats: Publisher<Heartbeat>,
    heartbeat: Heartbeat,
    echo: Option<zenav_protocol::time::Stamp>,
    /// Since when the robot has reported another holder.
    foreign: Option<Instant>,
    hub: Arc<Hub>,
    asked: watch::Receiver<Option<Hold>>,
}

impl Hand {
    /// Drives until the browser releases the drive (`None`); otherwise returns why it cannot go on.
    async fn run(mut self) -> Option<String> {
        let mut pace = interval(PERIOD);
        pace.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            pace.tick().await;
            let twist = self
                .asked
                .borrow()
                .map_or(Twist2::ZERO, |hold| hold.twist(self.hub.now()));
            // Dropped by the browser's session: no key is held.
            let let_go = self.asked.has_changed().is_err();
            if let Some(why) = self.hear() {
                return Some(why);
            }
            self.heartbeat.counter += 1;
            self.heartbeats.put(&self.heartbeat);
            if let Some(echo) = self.echo {
                self.teleop.put(&Teleop {
                    epoch: self.heartbeat.epoch,
                    twist: if let_go { Twist2::ZERO } else { twist },
                    echo,
                });
            }
            if let_go {
                return None;
            }
        }
    }

    /// Takes in the robot's state, which is authoritative for the lease. Returns a reason if another holder commands the robot.
    fn hear(&mut self) -> Option<String> {
        let odometry = self.odometry.take().map(|odometry| odometry.stamp);
        let state = self.states.take();
        self.echo = odometry.max(state.as_ref().map(|state| state.stamp)).or(self.echo);
        let state = state?;
        let ours = state.lease.epoch == self.heartbeat.epoch && state.lease.live;
        if ours {
            self.foreign = None;
            return None;
        }
        let since = *self.foreign.get_or_insert_with(Instant::now);
        let holder = state.lease.holder.unwrap_or_else(|| "nobody".to_owned());
        (since.elapsed() > LOST_AFTER).then(|| format!("{holder} commands the robot now"))
    }
}
