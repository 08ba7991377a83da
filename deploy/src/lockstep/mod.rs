//! Lockstep runs. The same cores as over the network, run in a fixed order from a seed: exactly repeatable.
//!
//! | file | answers |
//! |---|---|
//! | `closed_loop` | in which order do body, pilot, mapper, workers and mission run? |
//! | `delay` | when does a message arrive? |
//! | `scenario` | one goal, or one per robot, driven to the end |
//! | `referee` | how did a run go, by ground truth? |
//! | `recorder` | which messages do the parts of a run exchange? |
//! | `command` | what does `zenav run` do and print? |

mod closed_loop;
mod command;
mod delay;
mod recorder;
mod referee;
mod scenario;

pub use closed_loop::{ClosedLoop, ClosedLoopConfig, Heard, RobotLoop};
pub(crate) use command::worst;
pub use command::{RunArgs, RunOutcome, RunReport, run};
pub use referee::{ContactKind, ContactReport, Referee};
pub(crate) use scenario::{Entrant, Scenario, true_map};
