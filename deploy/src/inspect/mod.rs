//! Inspection. What is going on? Topics, maps, trees and health, seen from any machine.
//!
//! | file | answers |
//! |---|---|
//! | `topic`, `listen`, `meter`, `payload` | which keys carry what, how often, how much |
//! | `ask`, `schema` | requests and messages typed by hand, and what may stand in them |
//! | `map`, `convert`, `build` | maps: saved, shown, watched, converted, built from logs |
//! | `map_control` | which map a robot drives by: loaded, stored, held |
//! | `bt` | behaviour trees: valid? what do they look like, do now, and under a script? |
//! | `doctor`, `diagnosis`, `hosts`, `check` | is everything there and well? |
//! | `logs` | what did the parts say last? |
//! | `ps`, `parts` | which parts run where, in which version, and what do they take? |

mod ask;
pub(crate) mod bt;
mod build;
mod check;
mod convert;
mod diagnosis;
mod doctor;
mod hosts;
mod listen;
mod logs;
mod map;
mod map_control;
mod meter;
mod parts;
mod payload;
mod ps;
mod schema;
mod topic;

pub use ask::{AskArgs, ask};
pub use bt::{BtArgs, bt};
pub(crate) use build::read_log;
pub use doctor::{DoctorArgs, doctor};
pub use logs::{LogsArgs, logs};
pub use map::{MapArgs, map};
pub use ps::{PsArgs, ps};
pub(crate) use schema::json_schema;
pub use schema::{SchemaArgs, schema};
pub(crate) use topic::pattern;
pub use topic::{TopicArgs, topic};
