//! The off-board side of zenav: what a robot's readings and goals become.
//!
//! | module | answers |
//! |---|---|
//! | [`space`] | where may the robot be? configuration space, distances, exact checks |
//! | [`planning`] | is there a way? searches |
//! | [`smoothing`] | how does it drive a way, in time? |
//! | [`behaviour_tree`] | what comes next? an engine that knows no robot |
//! | [`worker_host`] | how does a worker that answers questions live on the network? |
//! | [`mission`] | which goal is driven, and how is none lost? |
//! | [`dispatch`] | which robot of a group does a goal? |

pub mod behaviour_tree;
pub mod dispatch;
pub mod mapping;
pub mod mission;
pub mod planning;
pub mod smoothing;
pub mod space;
pub mod worker_host;
