//! Handover. Does who takes over have everything that was acknowledged? Two orchestrators with a store each, and the robot, which is their
//! arbiter: join, catch up, take over, wake.
//!
//! The robot is a [`LeaseArbiter`](zenav_protocol::lease::LeaseArbiter); a mission asks by its [`LeaseClient`](zenav_mission::lease::LeaseClient), knows its standby by its
//! [`Membership`](zenav_mission::membership::Membership), and judges its leader's journal by
//! [`judge`](zenav_mission::standby::judge) and [`may_lead`](zenav_mission::standby::may_lead). Stores are what is on disk: goals, and
//! how each ended. A mission that is paused is one that does nothing for a while; its clock runs on.
//!
//! | file | holds |
//! |---|---|
//! | `mission` | a mission: its disk, and what it does while it leads and while it follows |
//! | `state` | the missions, the robot and their messages, and what each step makes of them |
//! | `system` | what may happen, and what must hold |
//! | `bounds` | how much happens at most, and where it breaks without a rule |

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

/// Length of a tick, s: the lease (1 s) lives through one and lapses with the second.
const TICK: f64 = 0.6;

/// What keeps an acknowledged goal from being lost when another mission takes over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// The leader waits for every standby on the robot's list before it tells.
    Wait,
    /// A standby that is late is off the robot's list before anything is told without it.
    OffList,
    /// A standby is off the robot's list before it is handed everything anew.
    OffListAnew,
    /// Only who has caught up gets onto the list.
    CaughtUp,
    /// The robot lets only who is on the list lead.
    Listed,
    /// The list is on the robot's disk.
    ListOnDisk,
    /// Reports are numbered.
    Numbered,
    /// A report carries the epoch of its leader's grant.
    ReportEpoch,
    /// Writes under a number that is stored are refused.
    StoredOnce,
    /// That others may have newer goals is on the leader's disk before the robot lists them.
    SharedOnDisk,
    /// A leader with standbys that was held up says nothing more.
    HeldUp,
}

/// The robot's word on who leads and who has caught up, by numbers.
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

/// Every clock after so many ticks: they run equally fast.
fn clock(ticks: u8) -> Stamp {
    Stamp::from_secs(10.0 + TICK * f64::from(ticks))
}

fn elapsed(from: u8, to: u8) -> Duration {
    Duration::from_secs_f64(TICK * f64::from(to - from))
}
