//! Lockstep runs. How would it go, exactly, every time? The same cores as over the network, in a fixed order, from a seed.
//!
//! | file | answers |
//! |---|---|
//! | `closed_loop` | how do body, pilot, mapper, workers and mission take turns? |
//! | `delay` | when does a message arrive? |
//! | `scenario` | how does a goal go, or one for each of several robots, to the end? |
//! | `referee` | how did it go, by truth? |
//! | `command` | what does `zenav run` do and print? |

mod closed_loop;
mod command;
mod delay;
mod referee;
mod scenario;

pub use closed_loop::{ClosedLoop, ClosedLoopConfig, RobotLoop};
pub(crate) use command::worst;
pub use command::{RunArgs, RunOutcome, RunReport, run};
pub use referee::{ContactKind, ContactReport, Referee};
pub(crate) use scenario::{Entrant, Scenario, true_map};
