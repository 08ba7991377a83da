//! A mission against a robot, workers and a store that are all in memory: claims about what it does to the robot.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod behaviours;
mod drives;
mod goal_validation;
mod kitchen;
mod nav2_trees;
mod remote;
mod rig;
mod semantics;
mod survival;
