//! The off-board side of zenav: the libraries, and the services that put them on the bus.
//!
//! | library | answers |
//! |---|---|
//! | [`mapping`] | what does the world look like? |
//! | [`space`] | where may the robot be? configuration space, distances, exact checks |
//! | [`planning`] | is there a path? searches |
//! | [`smoothing`] | how is a path driven, in time? |
//! | [`behaviour_tree`] | what comes next? an engine that knows no robot |
//! | [`mission`] | which goal is driven, and how is none lost? |
//!
//! [`services`] holds one thin service for each of them.

pub use zenav_behaviour_tree as behaviour_tree;
pub use zenav_mapping as mapping;
pub use zenav_mission as mission;
pub use zenav_planning as planning;
pub use zenav_smoothing as smoothing;
pub use zenav_space as space;

pub mod services;
