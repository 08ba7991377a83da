//! Fixes. Which measurements of its pose in the world does the robot send with its next scan?
//!
//! The newest of GPS and of the compass, once each: the estimator fuses all of them, SLAM needs some.

use zenav_protocol::readings::Readings;
use zenav_protocol::robot::{GpsModel, RobotModel};
use zenav_protocol::sensors::{Absolute, Fix};
use zenav_protocol::time::Stamp;

use crate::estimator::Estimator;

/// The newest measurements that were not sent yet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Fixes {
    position: Option<Fix>,
    heading: Option<Fix>,
}

impl Fixes {
    /// Takes in the readings of a tick, after the estimator did.
    pub(crate) fn take_in(&mut self, readings: &Readings, model: &RobotModel, estimator: &Estimator) {
        let fix = |stamp: Stamp, measured: Absolute| {
            let odom_from_base = estimator.odom_from_base_at(stamp)?;
            Some(Fix {
                odom_from_base,
                measured,
            })
            .filter(Fix::is_sane)
        };
        let position = readings.gps.as_ref().and_then(|gps| {
            let rounding = model.gps.as_ref().map_or(0.0, GpsModel::rounding);
            let (x, y, std_dev) = (gps.x, gps.y, gps.std_dev.hypot(rounding.sqrt()));
            fix(gps.stamp, Absolute::Position { x, y, std_dev })
        });
        let heading = readings.imu.as_ref().and_then(|imu| {
            let (yaw, std_dev) = (imu.yaw?, model.imu.compass_noise?);
            fix(imu.stamp, Absolute::Heading { yaw, std_dev })
        });
        self.position = position.or(self.position);
        self.heading = heading.or(self.heading);
    }

    /// Those to send now.
    pub(crate) fn take(&mut self) -> Vec<Fix> {
        [self.position.take(), self.heading.take()]
            .into_iter()
            .flatten()
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::sensors::{Gps, Imu};

    use super::*;
    use crate::settings::EstimatorSettings;

    #[test]
    fn the_newest_reading_of_each_sensor_is_sent_once_and_none_of_a_robot_without_them() {
        let mut model = zenav_fixtures::robot("tiago");
        model.imu.compass_noise = Some(0.02);
        if let Some(gps) = &mut model.gps {
            gps.resolution = 0.6;
        }
        let mut estimator = Estimator::new(&model, Pose2::IDENTITY, &EstimatorSettings::default());
        let reading = |second: f64, x: f64| {
            let stamp = Stamp::from_secs(second);
            let gps = Gps {
                stamp,
                x,
                y: 2.0,
                std_dev: 0.5,
            };
            let imu = Imu {
                stamp,
                yaw_rate: 0.0,
                yaw: Some(0.1),
            };
            Readings {
                gps: Some(gps),
                imu: Some(imu),
                ..Readings::new(stamp)
            }
        };
        let mut fixes = Fixes::default();
        for (second, x) in [(1.0, 5.0), (1.02, 6.0), (1.04, f64::NAN)] {
            let readings = reading(second, x);
            estimator.step(&readings, []);
            fixes.take_in(&readings, &model, &estimator);
        }
        let measured: Vec<Absolute> = fixes.take().iter().map(|fix| fix.measured).collect();
        // With the rounding of its coordinates.
        let (x, y, std_dev) = (6.0, 2.0, 0.5_f64.hypot(0.03_f64.sqrt()));
        let position = Absolute::Position { x, y, std_dev };
        let heading = Absolute::Heading {
            yaw: 0.1,
            std_dev: 0.02,
        };
        assert_eq!(measured, [position, heading]);
        assert_eq!(fixes.take(), []);
        model.imu.compass_noise = None;
        fixes.take_in(&reading(1.06, 7.0), &model, &estimator);
        assert_eq!(fixes.take().len(), 1, "a robot without a compass");
    }
}
