//! Body of one robot. In a tick its chassis moves, then its sensors measure.

use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::chassis::{Chassis, Moved, Surroundings};
use crate::faults::FaultModel;
use crate::sensors::random::{Stream, stream};
use crate::sensors::{Fitted, sensors};

/// One robot: chassis and sensors.
#[derive(Clone)]
pub struct Body {
    model: RobotModel,
    /// Wheels, footprint and battery.
    pub chassis: Chassis,
    sensors: Vec<Fitted>,
    readings: Readings,
}

impl Body {
    /// At rest at a pose; of the world's faults, its own apply.
    #[must_use]
    pub fn new(id: &Id, model: RobotModel, map_from_base: Pose2, seed: u64, faults: &[FaultModel]) -> Self {
        Self {
            chassis: Chassis::new(&model, map_from_base, stream(seed, id, Stream::Slip)),
            sensors: sensors(id, &model, seed, faults),
            readings: Readings::new(Stamp::ZERO),
            model,
        }
    }

    /// The model that the body was made from.
    #[must_use]
    pub fn model(&self) -> &RobotModel {
        &self.model
    }

    /// Names of the sensors that can have faults.
    pub fn sensors(&self) -> impl Iterator<Item = &str> {
        let fallible = |name: &&str| !["bump", "battery"].contains(name);
        self.sensors.iter().map(Fitted::name).filter(fallible)
    }

    /// Commands the wheels (left, right; rad/s).
    pub fn command(&mut self, wheels: [f64; 2]) {
        self.chassis.command(&self.model, wheels);
    }

    /// Moves for a time; see [`Chassis::advance`].
    pub fn advance(&mut self, around: Surroundings<'_>, secs: f64, others: f64, now: Stamp) -> Moved {
        let moved = self.chassis.advance(&self.model, around, secs, others, now);
        for sensor in &mut self.sensors {
            sensor.moved(&moved, now);
        }
        moved
    }

    /// Takes the measurements that are due, after everything has moved.
    pub fn sense(&mut self, around: Surroundings<'_>, now: Stamp) {
        self.chassis.settle(around, now);
        self.readings = Readings::new(now);
        for sensor in &mut self.sensors {
            sensor.sense(now, &self.chassis, around, &mut self.readings);
        }
    }

    /// Readings of the last step.
    #[must_use]
    pub fn readings(&self) -> Readings {
        self.readings.clone()
    }
}
