//! The libraries on the bus: each service feeds one core from Zenoh and carries its effects out.

pub mod dispatch;
pub mod map_subscriber;
pub mod mapping;
pub mod mission;
pub mod planning;
pub mod smoothing;
pub mod worker_host;
