//! Battery gauge. The reported charge.

use zenav_protocol::readings::Readings;
use zenav_protocol::sensors::{Battery, BatteryModel};

use super::{Moment, Sensor};

/// An exact gauge.
#[derive(Clone, Debug)]
pub struct BatteryGauge(pub BatteryModel);

impl Sensor for BatteryGauge {
    fn sense(&mut self, moment: &Moment<'_>, readings: &mut Readings) {
        readings.battery = Battery {
            stamp: moment.now,
            charge: moment.chassis.charge(&self.0),
            drawn_j: moment.chassis.truth().drawn_j,
        };
    }
}
