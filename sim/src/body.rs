//! Body of one robot. What does a robot do in a tick? Its chassis moves, then its sensors measure.

use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::chassis::{Chassis, Moved, Surroundings};
use crate::sensors::random::{Stream, stream};
use crate::sensors::{Moment, Sensor, sensors};

/// One robot: chassis and sensors.
#[derive(Clone)]
pub struct Body {
    model: RobotModel,
    /// How it moves.
    pub chassis: Chassis,
    sensors: Vec<Box<dyn Sensor>>,
    readings: Readings,
}

impl Body {
    /// At rest at a pose.
    #[must_use]
    pub fn new(id: &Id, model: RobotModel, map_from_base: Pose2, seed: u64) -> Self {
        Self {
            chassis: Chassis::new(&model, map_from_base, stream(seed, id, Stream::Slip)),
            sensors: sensors(id, &model, seed),
            readings: Readings::new(Stamp::ZERO),
            model,
        }
    }

    /// The robot's model.
    #[must_use]
    pub fn model(&self) -> &RobotModel {
        &self.model
    }

    /// Commands the wheels (left, right; rad/s).
    pub fn command(&mut self, wheels: [f64; 2]) {
        self.chassis.command(&self.model, wheels);
    }

    /// Moves for a time; see [`Chassis::advance`].
    pub fn advance(&mut self, around: Surroundings<'_>, secs: f64, others: f64, now: Stamp) -> Moved {
        let moved = self.chassis.advance(&self.model, around, secs, others, now);
        for sensor in &mut self.sensors {
            sensor.moved(&moved);
        }
        moved
    }

    /// Measures what is due, when everybody has moved.
    pub fn sense(&mut self, around: Surroundings<'_>, now: Stamp) {
        self.chassis.settle(around, now);
        let moment = Moment {
            now,
            chassis: &self.chassis,
            around,
        };
        self.readings = Readings::new(now);
        for sensor in &mut self.sensors {
            sensor.sense(&moment, &mut self.readings);
        }
    }

    /// What the sensors reported in the last step.
    #[must_use]
    pub fn readings(&self) -> Readings {
        self.readings.clone()
    }
}
