//! How would it go, exactly, every time? The same cores as over the network, in a fixed order, from a seed.
//!
//! | file | answers |
//! |---|---|
//! | `stage` | how do body, pilot, mapper, workers and mission take turns? |
//! | `delay` | when does a message arrive? |
//! | `command` | what does `zenav run` do and print? |

mod command;
mod delay;
mod stage;

pub use command::{RunArgs, run};
pub use stage::{Stage, StageConfig};
