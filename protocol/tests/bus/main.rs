//! What does the typed bus promise over real Zenoh sessions?

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod asks;
mod bad_input;
mod links;
mod rig;
mod topics;
