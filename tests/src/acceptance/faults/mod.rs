//! Fault suite. Missions, robot and goals under bad links, and with parts that die, freeze or start in any order: real processes, one table
//! row per fault.
//!
//! As root, every row runs in its own network namespace (`unshare`): the kernel impairs the robot's link (`iptables` drops segments, all of
//! them during a cut), and so does `zenav netem` (delay, rate). Otherwise a cut stops the proxy, and a loss is a stall of the proxy for the
//! time of a retransmission.
//!
//! | file | answers |
//! |---|---|
//! | `rows` | which faults are there, in which order? |
//! | `flood` | which messages make a flood? |
//! | `rig` | how are the parts started, cut off, killed and frozen? |
//! | `copies` | which of two mapping services leads, and has the other one taken over? |
//! | `watch` | does the robot move without a valid horizon meanwhile? |
//! | `run` | how does one row run? |
//! | `result` | what was found, and which limits were missed? |
//! | `table` | how are the results reported? |

mod copies;
mod flood;
mod result;
mod rig;
mod rows;
mod run;
mod table;
mod watch;

pub use result::{Memory, Result, Slowdown, compare};
pub use rows::{Row, all, select, short};
pub use run::run;
pub use table::{OwnNetwork, markdown};
pub use watch::Watch;

/// Environment variable that is set if a row runs in its own network.
pub const OWN_NETWORK: &str = "ZENAV_OWN_NETWORK";
