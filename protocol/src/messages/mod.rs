//! Everything that crosses the wire: small plain structs, one file a part of the data way.
//!
//! Every message carries the stamp of its writer's own clock. Unknown fields are ignored; missing optional ones take
//! their default. Numbers are SI units; yaw in (-pi, pi].

mod body;
mod edge;
mod estimate;
mod goal;
mod journal;
mod map;
mod mission;
mod plan;
mod refusal;
mod remote;

pub use body::*;
pub use edge::*;
pub use estimate::*;
pub use goal::*;
pub use journal::*;
pub use map::*;
pub use mission::*;
pub use plan::*;
pub use refusal::*;
pub use remote::*;

pub use crate::sensors::{Battery, Bump, Gps, Imu, Scan};
