//! The typed bus over real Zenoh sessions: its guarantees.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod asks;
mod bad_input;
mod limits;
mod links;
mod rig;
mod topics;
