//! What does a body give its pilot each tick, whether it is real or simulated?

use serde::{Deserialize, Serialize};

use crate::messages::{Battery, Bump, Gps, Imu, no_return_as_null};
use crate::time::Stamp;

/// Raw readings of one control tick. What did not come since the last tick is `None`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Readings {
    /// Now, on the edge's own clock.
    pub stamp: Stamp,
    /// Angles of the left and right wheel since start, rad.
    pub wheels: [f64; 2],
    /// Gyro and compass.
    pub imu: Option<Imu>,
    /// Position by GPS or beacons, map frame.
    pub gps: Option<Gps>,
    /// A finished lidar sweep.
    pub sweep: Option<Sweep>,
    /// Contact sensor.
    pub bump: Bump,
    /// Energy.
    pub battery: Battery,
}

impl Readings {
    /// These readings and later ones as those of one tick: nothing that was sensed in between is lost.
    #[must_use]
    pub fn followed_by(self, later: Self) -> Self {
        let bump = if self.bump.pressed && !later.bump.pressed {
            self.bump
        } else {
            later.bump
        };
        Self {
            imu: later.imu.or(self.imu),
            gps: later.gps.or(self.gps),
            sweep: later.sweep.or(self.sweep),
            bump,
            ..later
        }
    }
}

/// Ranges of one lidar sweep; the robot's model says where the beams point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    /// When it was taken: at or before the tick.
    pub stamp: Stamp,
    /// Distance a beam, m; no return is infinity in memory and `null` on the wire.
    #[serde(with = "no_return_as_null")]
    pub ranges: Vec<f32>,
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn readings(ms: u64, sweep: Option<f32>, pressed: bool) -> Readings {
        let stamp = Stamp(ms * 1_000_000);
        Readings {
            stamp,
            wheels: [ms as f64, 0.0],
            imu: None,
            gps: None,
            sweep: sweep.map(|range| Sweep {
                stamp,
                ranges: vec![range, f32::INFINITY],
            }),
            bump: Bump {
                stamp,
                pressed,
                bearing: None,
            },
            battery: Battery {
                stamp,
                charge: 1.0,
                drawn_j: 0.0,
            },
        }
    }

    #[test]
    fn nothing_sensed_between_two_ticks_is_lost() {
        let both = readings(20, Some(1.0), true).followed_by(readings(40, None, false));
        assert_eq!(
            (both.stamp, both.wheels[0], both.bump.pressed),
            (Stamp(40_000_000), 40.0, true)
        );
        assert_eq!(both.sweep, readings(20, Some(1.0), false).sweep);
        let newer = readings(20, Some(1.0), false).followed_by(readings(40, Some(2.0), true));
        assert_eq!(newer, readings(40, Some(2.0), true));
    }

    #[test]
    fn readings_cross_the_wire_as_they_are() {
        let sent = readings(20, Some(1.5), false);
        let text = serde_json::to_string(&sent).unwrap();
        assert!(text.contains("[1.5,null]"), "{text}");
        assert_eq!(serde_json::from_str::<Readings>(&text).unwrap(), sent);
    }
}
