//! Handover. A mission that takes over must hold everything that was acknowledged. Two orchestrators with a store each, and the robot as
//! their arbiter: join, catch up, take over, wake.
//!
//! The robot is a [`LeaseArbiter`](zenav_protocol::lease::LeaseArbiter). A mission requests the lease by its
//! [`LeaseClient`](zenav_mission::LeaseClient), tracks its standby by its [`Membership`](zenav_mission::Membership), and judges its leader's
//! journal by [`judge_entry`](zenav_mission::judge_entry) and [`may_lead`](zenav_mission::may_lead). A store is the content of the disk: goals,
//! and how each ended. A paused mission does nothing for a while; its clock runs on. A request for the lease echoes the robot's time when it was
//! sent: the later it arrives, the longer the grant waits for its first heartbeat.
//!
//! | file | holds |
//! |---|---|
//! | `mission` | a mission: its disk, and its state while it leads and while it follows |
//! | `state` | the missions, the robot and their messages, and the effect of each step |
//! | `system` | the actions and the claims |
//! | `bounds` | the bounds of each search, and those in which the contract breaks without a rule |

mod bounds;
mod mission;
mod state;
mod system;

pub use bounds::{Bounds, Handover};
pub use state::{Message, State};
pub use system::{Action, System};

use std::time::Duration;

use zenav_protocol::messages::Leader;
use zenav_protocol::time::Stamp;

/// Length of a tick, s: the lease (1 s) survives one tick and lapses with the second.
const TICK: f64 = 0.6;

/// Rules that keep an acknowledged goal from being lost when another mission takes over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// The leader waits for every standby on the robot's list before it tells.
    Wait,
    /// A late standby is off the robot's list before anything is told without it.
    OffList,
    /// A standby is off the robot's list before it is handed everything anew.
    OffListAnew,
    /// Only a standby that has caught up gets onto the list.
    CaughtUp,
    /// The robot lets only a mission on the list lead.
    Listed,
    /// The list is on the robot's disk.
    ListOnDisk,
    /// Reports are numbered.
    Numbered,
    /// A report carries the epoch of its leader's grant.
    ReportEpoch,
    /// Writes under a number that is already stored are refused.
    StoredOnce,
    /// The leader stores that others may have newer goals before the robot lists them.
    SharedOnDisk,
    /// A leader with standbys that was held up publishes nothing more.
    HeldUp,
    /// A standby stores with each entry that others may have newer goals.
    StandbyShared,
    /// An entry of an older session is refused.
    Session,
    /// A grant makes the new leader the only one on the list.
    Alone,
}

/// The robot's record of who leads and who has caught up, with missions as numbers.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct List {
    store: u8,
    epoch: u64,
    caught_up: Vec<u8>,
    revision: u64,
}

impl List {
    fn of(leader: &Leader) -> Self {
        Self {
            store: number(&leader.store),
            epoch: leader.epoch,
            caught_up: leader.caught_up.iter().map(|store| number(store)).collect(),
            revision: leader.revision,
        }
    }

    fn leader(&self) -> Leader {
        Leader {
            store: store(self.store),
            epoch: self.epoch,
            caught_up: self.caught_up.iter().map(|number| store(*number)).collect(),
            revision: self.revision,
        }
    }
}

/// Name of a mission's store.
fn store(number: u8) -> String {
    (if number == 0 { "a" } else { "b" }).to_owned()
}

fn number(store: &str) -> u8 {
    u8::from(store != "a")
}

/// Every clock after a number of ticks: all run equally fast.
fn clock(ticks: u8) -> Stamp {
    Stamp::from_secs(10.0 + TICK * f64::from(ticks))
}

fn elapsed(from: u8, to: u8) -> Duration {
    Duration::from_secs_f64(TICK * f64::from(to - from))
}
