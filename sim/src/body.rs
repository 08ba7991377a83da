//! What does one robot do in a tick? Its chassis moves, then its sensors measure.

use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{Battery, Bump, Gps, Imu};
use zenav_protocol::readings::{Readings, Sweep};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::chassis::{Chassis, Moved, Surroundings};
use crate::lidar::{AngularBuffer, measure};
use crate::sensors::{Delay, Encoders, Inertial, Positioning, Schedule, Sensor, stream};

/// One robot: chassis and sensors.
#[derive(Clone, Debug)]
pub struct Body {
    model: RobotModel,
    /// How it moves.
    pub chassis: Chassis,
    encoders: Encoders,
    inertial: Inertial,
    positioning: Option<Positioning>,
    lidar: AngularBuffer,
    lidar_rng: Pcg64Mcg,
    lidar_schedule: Schedule,
    ranges: Vec<f32>,
    sweeps: Delay<Sweep>,
    sweep: Option<Sweep>,
    wheels: [f64; 2],
    imu: Option<Imu>,
    gps: Option<Gps>,
    now: Stamp,
}

impl Body {
    /// At rest at a pose.
    #[must_use]
    pub fn new(id: &Id, model: RobotModel, map_from_base: Pose2, seed: u64) -> Self {
        Self {
            chassis: Chassis::new(&model, map_from_base, stream(seed, id, Sensor::Slip)),
            encoders: Encoders::new(model.encoders.clone(), stream(seed, id, Sensor::Encoders)),
            inertial: Inertial::new(model.imu.clone(), stream(seed, id, Sensor::Imu)),
            positioning: model
                .gps
                .clone()
                .map(|gps| Positioning::new(gps, stream(seed, id, Sensor::Gps))),
            lidar: AngularBuffer::new(&model.lidar),
            lidar_rng: stream(seed, id, Sensor::Lidar),
            lidar_schedule: Schedule::new(model.lidar.rate_hz),
            ranges: Vec::with_capacity(model.lidar.beams),
            sweeps: Delay::new(model.lidar.latency),
            sweep: None,
            wheels: [0.0; 2],
            imu: None,
            gps: None,
            now: Stamp::ZERO,
            model,
        }
    }

    /// What its file says.
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
        self.encoders.turn(moved.wheels);
        self.inertial.turn(moved.turn);
        moved
    }

    /// Measures what is due, when everybody has moved.
    pub fn sense(&mut self, around: Surroundings<'_>, now: Stamp) {
        self.now = now;
        self.chassis.settle(&self.model, around, now);
        let map_from_base = self.chassis.truth().map_from_base;
        self.imu = self.inertial.read(now, map_from_base);
        self.gps = self.positioning.as_mut().and_then(|gps| gps.read(now, map_from_base));
        self.wheels = self.encoders.read(now);
        let due = self.lidar_schedule.due(now);
        if due {
            self.lidar.begin(map_from_base * self.model.lidar.mount);
            self.lidar.scene(around.scene);
            self.lidar.crowd(around.crowd, around.own);
            measure(
                &self.model.lidar,
                self.lidar.ranges(),
                &mut self.lidar_rng,
                &mut self.ranges,
            );
        }
        let swept = due.then(|| Sweep {
            stamp: now,
            ranges: self.ranges.clone(),
        });
        self.sweep = self.sweeps.pass(now, swept);
    }

    /// What the sensors said in the last step.
    #[must_use]
    pub fn readings(&self) -> Readings {
        let bearing = self.chassis.bump();
        Readings {
            stamp: self.now,
            wheels: self.wheels,
            imu: self.imu.clone(),
            gps: self.gps.clone(),
            sweep: self.sweep.clone(),
            bump: Bump {
                stamp: self.now,
                pressed: bearing.is_some(),
                bearing,
            },
            battery: Battery {
                stamp: self.now,
                charge: self.chassis.charge(&self.model),
                drawn_j: self.chassis.truth().drawn_j,
            },
        }
    }
}
