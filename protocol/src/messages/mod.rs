//! Everything that crosses the wire: small plain structs, one file a part of the data way.
//!
//! Every message carries the stamp of its writer's own clock. Unknown fields are ignored; missing optional ones take
//! their default. Numbers are SI units; yaw in (-pi, pi].

mod body;
mod edge;
mod goal;
mod journal;
mod map;
mod mission;
mod plan;
mod refusal;
mod remote;
mod sense;

pub use body::*;
pub use edge::*;
pub use goal::*;
pub use journal::*;
pub use map::*;
pub use mission::*;
pub use plan::*;
pub use refusal::*;
pub use remote::*;
pub use sense::*;

pub(crate) use sense::no_return_as_null;
