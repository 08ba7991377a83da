//! zenav's off-board services: each feeds one library's core from the bus and carries out its effects.
//!
//! | service | of | answers |
//! |---|---|---|
//! | [`mapping`] | [`zenav_mapping`] | what does the world look like? |
//! | [`motion`] | [`zenav_planning`], [`zenav_smoothing`] | which path can the robot drive, and what is its trajectory? |
//! | [`mission`] | [`zenav_mission`] | which goal is driven, and how is no goal lost? |
//! | [`dispatch`] | | which robot of a group gets a goal? |
//! | [`gateway`] | [`zenav_gateway`] | how do people see and command robots in a browser? |
//!
//! | shared | |
//! |---|---|
//! | [`map_subscriber`] | how does a service keep up with every robot's map? |
//! | [`operator`] | under which epoch does an operator's command change a robot? |
//! | `requests` | where do clients' requests to a part arrive? |

pub mod dispatch;
pub mod gateway;
pub mod map_subscriber;
pub mod mapping;
pub mod mission;
pub mod motion;
pub mod operator;
mod requests;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod testing;
