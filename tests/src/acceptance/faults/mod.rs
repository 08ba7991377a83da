//! Fault suite. What becomes of missions, robot and goals when links are bad and parts die, freeze or start in any order? Real processes, one
//! row of a table for each fault.
//!
//! Every row runs in a network of its own where that may be made (`unshare`, by root): there the robot's link is impaired by the kernel
//! (`iptables` drops segments, all of them during a cut) and by `zenav netem` (delay, rate). Without it a cut stops the proxy, and a loss is a
//! stall of the proxy for as long as a retransmission takes.
//!
//! | file | answers |
//! |---|---|
//! | `rows` | which faults are there, in which order? |
//! | `flood` | what is a flood made of? |
//! | `rig` | how are the parts started, cut off, killed and frozen? |
//! | `watch` | what does the robot do meanwhile, seen over a link that is not impaired? |
//! | `run` | how does one row go? |
//! | `table` | how is it all written down? |

mod flood;
mod rig;
mod rows;
mod run;
mod table;
mod watch;

pub use rows::{Row, all, short};
pub use run::{Result, run};
pub use table::{OwnNetwork, markdown};

/// Set where a row runs in a network of its own.
pub const OWN_NETWORK: &str = "ZENAV_OWN_NETWORK";
