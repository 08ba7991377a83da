//! Lockstep runs. How would it go, exactly, every time? The same cores as over the network, in a fixed order, from a seed.
//!
//! | file | answers |
//! |---|---|
//! | `closed_loop` | how do body, pilot, mapper, workers and mission take turns? |
//! | `delay` | when does a message arrive? |
//! | `command` | what does `zenav run` do and print? |

mod closed_loop;
mod command;
mod delay;

pub use closed_loop::{ClosedLoop, ClosedLoopConfig};
pub use command::{RunArgs, run};
