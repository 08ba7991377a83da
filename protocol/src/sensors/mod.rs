//! Sensors, one file a kind: its model in the robot's file with bounds and defaults, its reading, and its message.
//!
//! | kind | model | reading | message |
//! |---|---|---|---|
//! | [`lidar`] | [`LidarModel`], any number by name | [`Sweep`] | [`Scan`] |
//! | [`encoders`] | [`EncoderModel`] | wheel angles | in `Odometry` |
//! | [`imu`] | [`ImuModel`] | [`Imu`] | [`Imu`] |
//! | [`gps`] | [`GpsModel`] | [`Gps`] | [`Gps`] |
//! | [`bump`] | none | [`Bump`] | [`Bump`] |
//! | [`battery`] | [`BatteryModel`] | [`Battery`] | [`Battery`] |
//!
//! Where to add one: see `ARCHITECTURE.md`.

pub mod battery;
pub mod bump;
pub mod encoders;
pub mod gps;
pub mod imu;
pub mod lidar;

pub use battery::{Battery, BatteryModel};
pub use bump::Bump;
pub use encoders::EncoderModel;
pub use gps::{Gps, GpsModel};
pub use imu::{Imu, ImuModel};
pub use lidar::{DEFAULT_LIDAR, LidarModel, Scan, Sweep};

use crate::config_text::Expected;

/// Longest time from a measurement to its delivery, s.
pub(crate) const LATENCY: Expected = Expected::Range(0.0, 10.0, "0 to 10 s");
