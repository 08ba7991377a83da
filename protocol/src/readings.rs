//! Readings. What does a body send to its edge each tick, real or simulated?

use serde::{Deserialize, Serialize};

pub use crate::sensors::Sweep;
use crate::sensors::lidar::none_one_or_many;
use crate::sensors::{Battery, Bump, Imu};
use crate::time::Stamp;

macro_rules! readings {
    ([] $($(#[doc = $doc:literal])* $(#[serde $serde:tt])* $kind:ident: $Model:ident => $Reading:ident, $TOPIC:ident = $key:literal;)*) => {
        /// Raw readings of one control tick. A sensor without a new reading since the last tick is `None`.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub struct Readings {
            /// Now, on the edge's own clock.
            pub stamp: Stamp,
            /// Angles of the left and right wheel since start, rad.
            pub wheels: [f64; 2],
            /// Gyro and compass.
            pub imu: Option<Imu>,
            $(
                $(#[doc = $doc])*
                $(#[serde $serde])*
                pub $kind: Option<$crate::sensors::$Reading>,
            )*
            /// Finished lidar sweeps, at most one per lidar. On the wire `sweep`: `null`, a sweep, or a list of sweeps.
            #[cfg_attr(feature = "schema", schemars(schema_with = "none_one_or_many::schema"))]
            #[serde(rename = "sweep", default, with = "none_one_or_many")]
            pub sweeps: Vec<Sweep>,
            /// Contact sensor.
            pub bump: Bump,
            /// Energy.
            pub battery: Battery,
        }

        impl Readings {
            /// Initial readings: wheels at zero, no contact, a full battery.
            #[must_use]
            pub fn new(stamp: Stamp) -> Self {
                Self {
                    stamp,
                    wheels: [0.0; 2],
                    imu: None,
                    $($kind: None,)*
                    sweeps: Vec::new(),
                    bump: Bump::none(stamp),
                    battery: Battery {
                        stamp,
                        charge: 1.0,
                        drawn_j: 0.0,
                    },
                }
            }

            /// Merges these readings with later ones into those of one tick, without losing a measurement.
            ///
            /// ```
            /// use zenav_protocol::{readings::{Readings, Sweep}, time::Stamp};
            ///
            /// let (first, second) = (Stamp::from_secs(0.02), Stamp::from_secs(0.04));
            /// let mut earlier = Readings::new(first);
            /// earlier.sweeps.push(Sweep::new(first, vec![1.5]));
            /// earlier.bump.pressed = true;
            /// let both = earlier.followed_by(Readings::new(second));
            /// assert_eq!((both.stamp, both.sweeps.len(), both.bump.pressed), (second, 1, true));
            /// ```
            #[must_use]
            pub fn followed_by(self, mut later: Self) -> Self {
                let bump = if self.bump.pressed && !later.bump.pressed {
                    self.bump
                } else {
                    later.bump
                };
                for sweep in self.sweeps {
                    if !later.sweeps.iter().any(|newer| newer.lidar == sweep.lidar) {
                        later.sweeps.push(sweep);
                    }
                }
                Self {
                    imu: later.imu.or(self.imu),
                    $($kind: later.$kind.or(self.$kind),)*
                    bump,
                    ..later
                }
            }

            /// New measurements of the sensors of the table's kinds since the last tick.
            #[must_use]
            pub fn of_kinds(&self) -> Vec<KindReading> {
                [$(self.$kind.clone().map(KindReading::$Reading)),*].into_iter().flatten().collect()
            }
        }

        /// Reading of a sensor of one of the table's kinds.
        #[derive(Clone, Debug, PartialEq)]
        pub enum KindReading {
            $(
                $(#[doc = $doc])*
                $Reading($crate::sensors::$Reading),
            )*
        }
    };
}

crate::sensor_kinds!(readings []);

#[cfg(test)]
mod tests {
    use super::*;

    fn readings(ms: u64, sweep: Option<f32>, pressed: bool) -> Readings {
        let stamp = Stamp(ms * 1_000_000);
        Readings {
            stamp,
            wheels: [ms as f64, 0.0],
            sweeps: sweep
                .map(|range| Sweep::new(stamp, vec![range, f32::INFINITY]))
                .into_iter()
                .collect(),
            bump: Bump {
                stamp,
                pressed,
                bearing: None,
            },
            ..Readings::new(stamp)
        }
    }

    #[test]
    fn nothing_sensed_between_two_ticks_is_lost() {
        let both = readings(20, Some(1.0), true).followed_by(readings(40, None, false));
        assert_eq!(
            (both.stamp, both.wheels[0], both.bump.pressed),
            (Stamp(40_000_000), 40.0, true)
        );
        assert_eq!(both.sweeps, readings(20, Some(1.0), false).sweeps);
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

    #[test]
    fn the_sweeps_of_two_lidars_do_not_replace_one_another() {
        let mut rear = readings(20, Some(3.0), false);
        rear.sweeps[0].lidar = "rear".to_owned();
        let both = rear.followed_by(readings(40, Some(1.0), false));
        let heard: Vec<_> = both
            .sweeps
            .iter()
            .map(|sweep| (sweep.lidar.as_str(), sweep.ranges[0]))
            .collect();
        assert_eq!(heard, [("lidar", 1.0), ("rear", 3.0)]);
    }

    #[test]
    fn one_sweep_is_written_as_itself_and_several_as_a_list() {
        for count in 0..3 {
            let mut sent = readings(20, None, false);
            sent.sweeps = (0..count)
                .map(|nth| Sweep {
                    lidar: if nth == 0 { "lidar" } else { "rear" }.to_owned(),
                    ..Sweep::new(sent.stamp, vec![nth as f32, f32::INFINITY])
                })
                .collect();
            let text = serde_json::to_string(&sent).unwrap();
            let begins = ["\"sweep\":null", "\"sweep\":{\"stamp\"", "\"sweep\":[{"][count];
            assert!(text.contains(begins), "{text}");
            assert_eq!(serde_json::from_str::<Readings>(&text).unwrap(), sent);
            let mut binary = Vec::new();
            ciborium::into_writer(&sent, &mut binary).unwrap();
            assert_eq!(ciborium::from_reader::<Readings, _>(&binary[..]).unwrap(), sent);
        }
    }
}
