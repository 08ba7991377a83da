//! Contact sensor. The contacts that the robot feels.

use zenav_protocol::readings::Readings;
use zenav_protocol::sensors::Bump;

use super::{Moment, Sensor};

/// A bumper all around the outline: it reports every contact with its direction.
#[derive(Clone, Copy, Debug)]
pub struct Bumper;

impl Sensor for Bumper {
    fn sense(&mut self, moment: &Moment<'_>, readings: &mut Readings) {
        let bearing = moment.chassis.bump();
        readings.bump = Bump {
            stamp: moment.now,
            pressed: bearing.is_some(),
            bearing,
        };
    }
}
