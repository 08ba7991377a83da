//! A mission with the real edge code, mapper and motion worker in a simulated room: claims about its effects on the robot.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod drives;
mod glass;
mod goals;
mod kitchen;
mod lost;
mod maneuvers;
mod nav2_trees;
mod patience;
mod remote;
mod rig;
mod slow_links;
mod survival;
