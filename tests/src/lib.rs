//! The rig that tests and benches across parts stand on: processes of the binary under test, on free ports.
//!
//! | module | answers |
//! |---|---|
//! | [`process`] | how does a test start and end real processes? |
//! | [`deployment`] | how do a router, a robot and a cloud stand, each as a process of its own? |
//! | [`observer`] | what does a test see of a robot, and how does it wait for it? |
//! | [`acceptance`] | how does the robot's side fare in many simulated worlds, and a mission under many kills? |
//! | [`usage`] | what do processes use of the machine? |

pub mod acceptance;
pub mod deployment;
pub mod observer;
pub mod process;
pub mod usage;
