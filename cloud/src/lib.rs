//! zenav's off-board services: each feeds one library's core from the bus and carries its effects out.
//!
//! | service | of | answers |
//! |---|---|---|
//! | [`mapping`] | [`zenav_mapping`] | what does the world look like? |
//! | [`planning`] | [`zenav_planning`] | is there a path? |
//! | [`smoothing`] | [`zenav_smoothing`] | how is a path driven, in time? |
//! | [`mission`] | [`zenav_mission`] | which goal is driven, and how is none lost? |
//! | [`dispatch`] | | which robot of a group does a goal? |
//!
//! | shared | |
//! |---|---|
//! | [`worker_host`] | how does a worker that answers requests live on the network? |
//! | [`map_subscriber`] | how does a service keep up with every robot's map? |

pub mod dispatch;
pub mod map_subscriber;
pub mod mapping;
pub mod mission;
pub mod planning;
pub mod smoothing;
pub mod worker_host;
