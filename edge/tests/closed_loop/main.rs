//! Does the pilot keep its promises in the simulated world, sensors' noise and motors' lag included?
#![cfg(feature = "sim")]
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod driving;
mod estimate;
mod guarded;
mod rig;
