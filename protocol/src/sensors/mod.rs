//! Sensors, one file per kind: the model in the robot's file with bounds and defaults, the reading, and the message.
//!
//! | kind | model | reading | message |
//! |---|---|---|---|
//! | [`lidar`] | [`LidarModel`], any number by name | [`Sweep`] | [`Scan`] |
//! | [`encoders`] | [`EncoderModel`] | wheel angles | in `Odometry` |
//! | [`imu`] | [`ImuModel`] | [`Imu`] | [`Imu`] |
//! | [`gps`], and every further row of [`sensor_kinds!`](crate::sensor_kinds!) | [`GpsModel`] | [`Gps`] | [`Gps`] |
//! | [`bump`] | none | [`Bump`] | [`Bump`] |
//! | [`battery`] | [`BatteryModel`] | [`Battery`] | [`Battery`] |
//!
//! A kind with at most one sensor per robot is a file and a row of [`sensor_kinds!`](crate::sensor_kinds!) here, plus a file in the
//! simulator: see `CONTRIBUTING.md`. The other kinds predate the table, or have a special form.

pub mod battery;
pub mod bump;
pub mod encoders;
pub mod fix;
pub mod gps;
pub mod imu;
pub mod lidar;

pub use battery::{Battery, BatteryModel};
pub use bump::Bump;
pub use encoders::EncoderModel;
pub use fix::{Absolute, Fix};
pub use gps::{Gps, GpsModel};
pub use imu::{Imu, ImuModel};
pub use lidar::{DEFAULT_LIDAR, LidarModel, Scan, Sweep};

use crate::config_text::Expected;

/// The kinds of sensor with at most one per robot.
///
/// A row is the field in [`RobotModel`](crate::robot::RobotModel) and [`Readings`](crate::readings::Readings), the model with its bounds,
/// the reading, which is also the message, and its topic. Code for every kind is a macro that takes the rows:
/// `sensor_kinds!(each [arguments])` becomes `each! { [arguments] rows }`. There are seven: the robot's file, the readings, the key table,
/// the simulator, the edge's publishers, the recorder of lockstep runs, and the test of the wire.
#[macro_export]
macro_rules! sensor_kinds {
    ($each:ident [$($arguments:tt)*]) => {
        $each! {
            [$($arguments)*]
            /// GPS or beacons: positions in the map frame.
            gps: GpsModel => Gps, GPS = "zenav/{robot}/edge/gps";
        }
    };
}

/// Longest time from a measurement to its delivery, s.
pub(crate) const LATENCY: Expected = Expected::Range(0.0, 10.0, "0 to 10 s");
/// An unsigned angle, rad: as [`Expected::Angle`].
pub(crate) const TURN: Expected = Expected::Range(0.0, std::f64::consts::TAU, "0 to 2 pi rad");
