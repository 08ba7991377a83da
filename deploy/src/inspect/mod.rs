//! Inspection. Topics, maps, trees and health of a deployment, from any machine.
//!
//! | file | answers |
//! |---|---|
//! | `topic`, `listen`, `meter`, `payload` | which messages, how often and how large, are on which keys? |
//! | `ask`, `schema`, `unknown_field` | requests and messages typed by hand, and their schemas |
//! | `map`, `convert`, `build` | maps: save, show, watch, convert, build from logs |
//! | `map_control` | which map does a robot drive by? load, store, hold |
//! | `bt` | behaviour trees: validate, draw, watch, simulate |
//! | `doctor`, `diagnosis`, `check` | is the deployment complete and healthy? |
//! | `logs` | what did the parts log last? |
//! | `ps`, `parts` | which parts run where, in which version, with which load? |

mod ask;
pub(crate) mod bt;
mod build;
mod check;
mod convert;
mod diagnosis;
mod doctor;
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
mod unknown_field;

pub use ask::{AskArgs, ask};
pub use bt::{BtArgs, bt};
pub(crate) use build::read_log;
pub use doctor::{DoctorArgs, doctor};
pub use logs::{LogsArgs, logs};
pub use map::{MapArgs, map};
pub(crate) use parts::check_admitted;
pub use ps::{PsArgs, ps};
pub use schema::{SchemaArgs, schema};
pub(crate) use schema::{json_schema, message_names, serve_schemas};
pub(crate) use topic::pattern;
pub use topic::{TopicArgs, topic};
