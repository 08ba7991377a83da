//! What is going on? Topics, maps, trees and health, seen from any machine.
//!
//! | file | answers |
//! |---|---|
//! | `topic`, `meter`, `payload` | which keys carry what, how often, how much |
//! | `map`, `draw` | maps: saved, drawn in the terminal, converted, built from logs |
//! | `bt`, `simulate` | behaviour trees: valid? what do they look like, do now, and under a script? |
//! | `doctor`, `diagnosis` | is everything there and well? |

mod bt;
mod diagnosis;
mod doctor;
mod draw;
mod map;
mod meter;
mod payload;
mod topic;

pub use bt::{BtArgs, bt};
pub use doctor::{DoctorArgs, doctor};
pub use map::{MapArgs, map};
pub use topic::{TopicArgs, topic};
