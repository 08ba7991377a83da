//! Sensors, one file a kind: its model in the robot's file with bounds and defaults, its reading, and its message.
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
//! A kind of which a robot has one or none is a file and a row of [`sensor_kinds!`](crate::sensor_kinds!) here, and a file in the
//! simulator: see `CONTRIBUTING.md`. The others are older than the table, or of a form of their own.

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

/// The kinds of sensor of which a robot has one or none.
///
/// A row is the field in [`RobotModel`](crate::robot::RobotModel) and [`Readings`](crate::readings::Readings), the model with its bounds,
/// the reading, which is the message too, and its topic. Whoever does something for each kind is a macro that takes the rows:
/// `sensor_kinds!(each [arguments])` becomes `each! { [arguments] rows }`. There are six: the robot's file, the readings, the key table, the
/// simulator, the edge's publishers, and the test of the wire.
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
/// An angle without a sign, rad: as [`Expected::Angle`].
pub(crate) const TURN: Expected = Expected::Range(0.0, std::f64::consts::TAU, "0 to 2 pi rad");
