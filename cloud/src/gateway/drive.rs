//! Hand control. How does a browser drive a robot? Under an operator's lease of its own, by twists that echo the newest stamp of the robot.
//!
//! Two dead man's switches: a command acts for 0.3 s after the browser sent it ([`zenav_gateway::Hold`]), and the robot lets a twist act until
//! the stamp that it echoes is 0.3 s old. When the browser lets go of the drive the robot is at rest and the lease is given back.

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

/// Twists and heartbeats a second.
const PERIOD: Duration = Duration::from_millis(50);
/// Longest wait for the lease.
const TAKE_WITHIN: Duration = Duration::from_secs(2);
/// Giving back is a courtesy: the lease ends by itself.
const GIVE_WITHIN: Duration = Duration::from_millis(800);
/// A robot that says for longer that another one holds the lease has taken it away.
const LOST_AFTER: Duration = Duration::from_millis(400);

/// Takes the operator's lease and drives until the [`Drive`] is dropped, or the robot gives the lease to another.
pub(super) async fn begin(bus: Bus, hub: Arc<Hub>, robot: String, by: String) -> Result<Drive, AskFailure> {
    // A name of its own: two browsers that drive one robot take the lease from each other, and see it.
    let unique = Id::unique().to_string();
    let holder = format!("{by}-{}", unique.get(..8).unwrap_or(&unique));
    let grant = ask_lease(&bus, &robot, &holder, LeaseAction::Acquire, TAKE_WITHIN)
        .await
        .map_err(failure)?;
    let closed = |error: BusError| AskFailure::Unavailable {
        reason: error.to_string(),
    };
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let (commands, asked) = watch::channel(None);
    let (end, ended) = watch::channel(None);
    let hand = Hand {
        states: bus.latest(&STATE, &[&robot]).map_err(closed)?,
        odometry: bus.latest(&ODOMETRY, &[&robot]).map_err(closed)?,
        teleop: bus.publisher(&TELEOP, &[&robot]).map_err(closed)?,
        heartbeats: bus.publisher(&HEARTBEAT, &[&robot]).map_err(closed)?,
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
            // It ends by itself when nobody renews it.
            let _ = ask_lease(&bus, &robot, &holder, LeaseAction::Release, GIVE_WITHIN).await;
        }
        end.send_replace(why);
    });
    Ok(Drive { commands, ended })
}

/// What drives.
struct Hand {
    states: Latest<EdgeState>,
    /// For its stamps: they come every tick of the robot, five times as often as its state.
    odometry: Latest<Odometry>,
    teleop: Publisher<Teleop>,
    heartbeats: Publisher<Heartbeat>,
    heartbeat: Heartbeat,
    echo: Option<zenav_protocol::time::Stamp>,
    /// Since when the robot says that another one commands it.
    foreign: Option<Instant>,
    hub: Arc<Hub>,
    asked: watch::Receiver<Option<Hold>>,
}

impl Hand {
    /// Drives until the browser lets go (`None`), or says why it cannot go on.
    async fn run(mut self) -> Option<String> {
        let mut pace = interval(PERIOD);
        pace.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            pace.tick().await;
            let twist = self
                .asked
                .borrow()
                .map_or(Twist2::ZERO, |hold| hold.twist(self.hub.now()));
            // Dropped by the browser's session: nobody holds the key.
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

    /// Takes in what the robot says: its word counts on who commands.
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
