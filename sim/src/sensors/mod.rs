//! Simulated sensors. What a robot's sensors measure, and when, one file per kind.
//!
//! Each reports the truth with bias, noise and steps, from its own random stream; readings get lost, and arrive late with the stamp of
//! their measurement.

pub mod battery;
pub mod bump;
pub mod encoders;
pub mod imu;
pub mod lidar;
pub mod random;
pub mod timing;

use std::fmt::Debug;

use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::chassis::{Chassis, Moved, Surroundings};
use crate::faults::{Fault, FaultModel};
use random::{Stream, stream};

/// A moment for a sensor, after everything has moved.
#[derive(Clone, Copy)]
pub struct Moment<'a> {
    /// Simulated time.
    pub now: Stamp,
    /// The robot's true state.
    pub chassis: &'a Chassis,
    /// Everything around the robot.
    pub around: Surroundings<'a>,
    /// Fault of this sensor now.
    pub fault: Fault,
}

impl Moment<'_> {
    /// True pose of the robot.
    #[must_use]
    pub fn map_from_base(&self) -> Pose2 {
        self.chassis.truth().map_from_base
    }
}

/// A sensor of a robot.
pub trait Sensor: Debug + Send + Sync + CloneSensor {
    /// Called after the robot has moved, with the motion since the last call.
    fn moved(&mut self, _moved: &Moved, _fault: &Fault) {}

    /// Takes the measurement that is due, and writes what arrives now into the readings.
    fn sense(&mut self, moment: &Moment<'_>, readings: &mut Readings);
}

/// Cloning behind a box: a robot's sensors have many types in one list, and a simulation can be cloned.
pub trait CloneSensor {
    /// A copy in its present state.
    fn boxed(&self) -> Box<dyn Sensor>;
}

impl<S: Sensor + Clone + 'static> CloneSensor for S {
    fn boxed(&self) -> Box<dyn Sensor> {
        Box::new(self.clone())
    }
}

impl Clone for Box<dyn Sensor> {
    fn clone(&self) -> Self {
        self.as_ref().boxed()
    }
}

/// Simulation of a model of [`sensor_kinds!`](zenav_protocol::sensor_kinds!).
pub trait Simulate {
    /// A sensor before its first reading, with its own random stream.
    fn simulate(&self, rng: Pcg64Mcg) -> Box<dyn Sensor>;
}

/// Each kind's file is named after its row.
macro_rules! simulated {
    ([] $($(#[doc = $doc:literal])* $(#[serde $serde:tt])* $kind:ident: $Model:ident => $Reading:ident, $TOPIC:ident = $key:literal;)*) => {
        $(pub mod $kind;)*

        fn of_kinds(id: &Id, model: &RobotModel, seed: u64) -> Vec<(&'static str, Box<dyn Sensor>)> {
            let mut sensors = Vec::new();
            $(
                let rng = || stream(seed, id, Stream::Kind(stringify!($kind)));
                sensors.extend(model.$kind.as_ref().map(|model| (stringify!($kind), model.simulate(rng()))));
            )*
            sensors
        }
    };
}

zenav_protocol::sensor_kinds!(simulated []);

/// A sensor on a robot, with its faults.
#[derive(Clone, Debug)]
pub struct Fitted {
    name: String,
    faults: Vec<FaultModel>,
    sensor: Box<dyn Sensor>,
}

impl Fitted {
    /// Its name, as faults refer to it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The robot has moved; see [`Sensor::moved`].
    pub fn moved(&mut self, moved: &Moved, now: Stamp) {
        self.sensor.moved(moved, &Fault::at(&self.faults, now));
    }

    /// Measures what is due; see [`Sensor::sense`].
    pub fn sense(&mut self, now: Stamp, chassis: &Chassis, around: Surroundings<'_>, readings: &mut Readings) {
        let fault = Fault::at(&self.faults, now);
        let moment = Moment {
            now,
            chassis,
            around,
            fault,
        };
        self.sensor.sense(&moment, readings);
    }
}

/// All sensors of a robot, each with its own faults of the world.
#[must_use]
pub fn sensors(id: &Id, model: &RobotModel, seed: u64, faults: &[FaultModel]) -> Vec<Fitted> {
    let stream = |source| stream(seed, id, source);
    let fitted = |name: &str, sensor: Box<dyn Sensor>| {
        let own = |fault: &&FaultModel| fault.sensor == name && fault.robot.as_ref().is_none_or(|robot| robot == id);
        Fitted {
            name: name.to_owned(),
            faults: faults.iter().filter(own).cloned().collect(),
            sensor,
        }
    };
    let encoders = encoders::Encoders::new(model.encoders.clone(), stream(Stream::Encoders));
    let imu = imu::InertialUnit::new(model.imu.clone(), stream(Stream::Imu));
    let mut sensors = vec![
        fitted("encoders", Box::new(encoders)),
        fitted("imu", Box::new(imu)),
        fitted("bump", Box::new(bump::Bumper)),
        fitted("battery", Box::new(battery::BatteryGauge(model.battery.clone()))),
    ];
    sensors.extend(
        of_kinds(id, model, seed)
            .into_iter()
            .map(|(kind, sensor)| fitted(kind, sensor)),
    );
    for (index, (name, lidar)) in model.all_lidars().enumerate() {
        let source = if index == 0 { Stream::Lidar } else { Stream::Named(name) };
        let lidar = lidar::Lidar::new(name, lidar.clone(), stream(source));
        sensors.push(fitted(name, Box::new(lidar)));
    }
    sensors
}

/// Rounds to a sensor's steps; a step of zero leaves the value.
pub(crate) fn stepped(value: f64, step: f64) -> f64 {
    if step > 0.0 {
        (value / step).round() * step
    } else {
        value
    }
}
