//! Which values may a robot's file hold? Those of a robot that can be; whatever is wrong is named with file, line and key.

use std::f64::consts::TAU;

use nalgebra::Point2;
use thiserror::Error;

use crate::config_text::{OutOfBounds, line_of};
use crate::robot::{Footprint, RobotModel};
use crate::settings::Settings as _;

/// Why a robot file was refused.
#[derive(Debug, Error)]
pub enum RobotError {
    /// The TOML does not fit: the message names line and key.
    #[error("{name}: {source}")]
    Toml {
        /// The file.
        name: String,
        /// What and where.
        source: Box<toml::de::Error>,
    },
    /// A value that no robot has.
    #[error("{at}: `{key}` {problem}")]
    Value {
        /// The file, and the line where it is written in one: `my.toml:7`.
        at: String,
        /// The key, its tables before it.
        key: String,
        /// What it is, and what was expected.
        problem: String,
    },
}

/// A value that no robot has, wherever it came from.
pub(crate) struct Wrong {
    key: String,
    problem: String,
}

impl Wrong {
    /// The error, with the line where there is a text.
    pub(crate) fn of(self, name: &str, text: Option<&str>) -> RobotError {
        let Self { key, problem } = self;
        let line = text.and_then(|text| line_of(text, &key));
        RobotError::Value {
            at: line.map_or_else(|| name.to_owned(), |line| format!("{name}:{line}")),
            key,
            problem,
        }
    }
}

fn wrong(key: &'static str, value: f64, expected: &str) -> Result<(), Wrong> {
    let OutOfBounds { key, problem } = OutOfBounds::unlike(key, value, expected);
    Err(Wrong { key, problem })
}

impl RobotModel {
    /// The first value that no robot has.
    pub(crate) fn check(&self) -> Result<(), Wrong> {
        if let Footprint::Polygon(corners) = &self.footprint {
            let edges: Vec<_> = corners
                .iter()
                .zip(corners.iter().cycle().skip(1))
                .map(|(a, b)| b - a)
                .collect();
            let convex = edges
                .iter()
                .zip(edges.iter().cycle().skip(1))
                .all(|(a, b)| a.x * b.y - a.y * b.x > 0.0);
            let around_base =
                self.footprint.distance(Point2::origin()) == 0.0 && self.footprint.inscribed_radius() > 0.0;
            if corners.len() < 3 || corners.len() > 64 || !convex || !around_base {
                return Err(Wrong {
                    key: "footprint.polygon".to_owned(),
                    problem: "encloses no base: expected 3 to 64 corners of a convex polygon around the base, counter-clockwise".to_owned(),
                });
            }
        }
        let positive = [
            ("footprint.radius", self.footprint.inscribed_radius()),
            ("drive.wheel_radius", self.drive.wheel_radius),
            ("drive.wheel_separation", self.drive.wheel_separation),
            ("drive.max_wheel_speed", self.drive.max_wheel_speed),
            ("drive.max_wheel_acceleration", self.drive.max_wheel_acceleration),
            ("drive.hard_braking", self.drive.hard_braking),
            ("drive.max_lateral_acceleration", self.drive.max_lateral_acceleration),
            ("drive.max_yaw_rate", self.drive.max_yaw_rate),
            ("drive.max_speed", self.drive.max_speed),
            ("drive.max_jerk", self.drive.max_jerk.unwrap_or(1.0)),
            ("lidar.rate_hz", self.lidar.rate_hz),
            ("lidar.range_max", self.lidar.range_max),
            ("lidar.field_of_view", self.lidar.field_of_view),
            ("imu.rate_hz", self.imu.rate_hz),
            ("gps.rate_hz", self.gps.as_ref().map_or(1.0, |gps| gps.rate_hz)),
            ("encoders.rate_hz", self.encoders.rate_hz.unwrap_or(1.0)),
            ("battery.capacity", self.battery.capacity),
            ("motors.mass", self.motors.mass),
            ("motors.motor_constant", self.motors.motor_constant),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, value, "a positive number");
            }
        }
        let not_negative = [
            ("drive.motor_lag", self.drive.motor_lag),
            ("lidar.range_min", self.lidar.range_min),
            ("lidar.noise", self.lidar.noise),
            ("encoders.noise", self.encoders.noise),
            ("encoders.resolution", self.encoders.resolution),
            ("imu.gyro_noise", self.imu.gyro_noise),
            ("imu.compass_noise", self.imu.compass_noise.unwrap_or(0.0)),
            ("gps.noise", self.gps.as_ref().map_or(0.0, |gps| gps.noise)),
            ("gps.resolution", self.gps.as_ref().map_or(0.0, |gps| gps.resolution)),
            ("lidar.resolution", self.lidar.resolution),
            ("imu.resolution", self.imu.resolution),
            ("drive.errors.slip", self.drive.errors.slip),
            ("battery.idle_power", self.battery.idle_power),
            ("motors.inertia", self.motors.inertia),
            ("motors.rolling_resistance", self.motors.rolling_resistance),
            ("motors.viscous_friction", self.motors.viscous_friction),
        ];
        for (field, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return wrong(field, value, "zero or a positive number");
            }
        }
        let gps = self.gps.as_ref();
        for (field, share) in [
            ("battery.low", self.battery.low),
            ("lidar.dropout", self.lidar.dropout),
            ("encoders.dropout", self.encoders.dropout),
            ("imu.dropout", self.imu.dropout),
            ("gps.dropout", gps.map_or(0.0, |gps| gps.dropout)),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return wrong(field, share, "a share, 0 to 1");
            }
        }
        for (field, secs) in [
            ("lidar.latency", self.lidar.latency),
            ("encoders.latency", self.encoders.latency),
            ("imu.latency", self.imu.latency),
            ("gps.latency", gps.map_or(0.0, |gps| gps.latency)),
        ] {
            if !(0.0..=10.0).contains(&secs) {
                return wrong(field, secs, "0 to 10 s");
            }
        }
        let [left, right] = self.drive.errors.wheel_radius;
        for (field, share) in [
            ("drive.errors.wheel_radius", left),
            ("drive.errors.wheel_radius", right),
            ("drive.errors.wheel_separation", self.drive.errors.wheel_separation),
        ] {
            if !(-0.5..=0.5).contains(&share) {
                return wrong(field, share, "a share, -0.5 to 0.5");
            }
        }
        for (field, value) in [
            ("lidar.bias", self.lidar.bias),
            ("imu.gyro_bias", self.imu.gyro_bias),
            ("imu.compass_bias", self.imu.compass_bias),
            ("gps.bias", gps.map_or(0.0, |gps| gps.bias[0] + gps.bias[1])),
        ] {
            if !value.is_finite() {
                return wrong(field, value, "a finite number");
            }
        }
        if !self.lidar.mount.is_finite() {
            return wrong("lidar.mount", f64::NAN, "finite numbers");
        }
        if !(1..=100_000).contains(&self.lidar.beams) {
            return wrong("lidar.beams", self.lidar.beams as f64, "1 to 100000");
        }
        if self.lidar.field_of_view > TAU + 1e-6 {
            return wrong("lidar.field_of_view", self.lidar.field_of_view, "at most 2 pi");
        }
        if self.lidar.range_min >= self.lidar.range_max {
            return wrong("lidar.range_min", self.lidar.range_min, "less than range_max");
        }
        let reach = self.footprint.circumscribed_radius();
        for (table, check) in [
            ("controller", self.controller.check()),
            ("wall_following", self.wall_following.check_for(reach)),
        ] {
            check.map_err(|error| {
                let OutOfBounds { key, problem } = error.within(table);
                Wrong { key, problem }
            })?;
        }
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::robot::{SHIPPED, shipped};

    /// What is said of the shipped TIAGo with a line replaced, or with lines at its end.
    fn said(line: &str, by: &str) -> String {
        let text = shipped("tiago").unwrap();
        let text = if line.is_empty() {
            format!("{text}{by}\n")
        } else {
            assert!(text.contains(line), "{line}");
            text.replacen(line, by, 1)
        };
        RobotModel::from_toml(&text, "my.toml").unwrap_err().to_string()
    }

    #[test]
    fn a_value_that_no_robot_has_is_named_with_file_line_and_key() {
        let text = shipped("tiago").unwrap();
        let (end, line_of) = (text.lines().count(), |line| {
            1 + text.lines().position(|one| one == line).unwrap()
        });
        for (line, by, at, words) in [
            (
                "radius = 0.265",
                "radius = -1",
                line_of("radius = 0.265"),
                "`footprint.radius` is -1: expected a positive number",
            ),
            (
                "wheel_radius = 0.0985",
                "wheel_radius = 0",
                line_of("wheel_radius = 0.0985"),
                "`drive.wheel_radius` is 0: expected a positive",
            ),
            (
                "beams = 667",
                "beams = 0",
                line_of("beams = 667"),
                "`lidar.beams` is 0: expected 1 to 100000",
            ),
            (
                "rate_hz = 10.0",
                "rate_hz = inf",
                line_of("rate_hz = 10.0"),
                "`lidar.rate_hz`",
            ),
            (
                "",
                "[controller]\ncross_gain = nan",
                end + 2,
                "`controller.cross_gain` is NaN: expected 0 to 50",
            ),
            (
                "",
                "[controller]\ncross_gain = -1e9",
                end + 2,
                "`controller.cross_gain` is -1e9: expected 0 to 50",
            ),
            ("", "[controller]\npid_p = nan", end + 2, "`controller.pid_p`"),
            (
                "",
                "[controller]\nlookahead_secs = 0",
                end + 2,
                "`controller.lookahead_secs` is 0: expected 0.1 to 5",
            ),
            (
                "",
                "[controller]\nguard_margin = 0",
                end + 2,
                "`controller.guard_margin`",
            ),
            (
                "",
                "[wall_following]\ntarget_distance = 0.1",
                end + 2,
                "at least the robot's own reach, 0.265",
            ),
            (
                "radius = 0.265",
                "polygon = [[0.1, 0], [0.2, 0], [0.2, 0.1]]",
                line_of("radius = 0.265"),
                "`footprint.polygon` encloses no base",
            ),
        ] {
            let said = said(line, by);
            assert!(
                said.contains(&format!("my.toml:{at}:")) && said.contains(words),
                "{by}: {said}"
            );
        }
    }

    #[test]
    fn what_is_written_twice_or_too_long_is_told_in_words() {
        let both = said("radius = 0.265", "radius = 0.265\npolygon = [[0, 0], [1, 0], [0, 1]]");
        assert!(
            both.contains("both `radius` and `polygon`") && both.contains("line 4"),
            "{both}"
        );
        let neither = said("radius = 0.265", "");
        assert!(neither.contains("either `radius` or `polygon`"), "{neither}");
        let corner = said("radius = 0.265", "polygon = [[-1, -1], [1, -1, 7], [0, 1]]");
        assert!(
            corner.contains("expected 2 numbers, found 3") && corner.contains("line 5"),
            "{corner}"
        );
        let bias = said(
            "rate_hz = 10.0\nnoise = 0.02",
            "rate_hz = 10.0\nnoise = 0.02\nbias = [1, 2, 3]",
        );
        assert!(bias.contains("expected 2 numbers, found 3"), "{bias}");
    }

    #[test]
    fn every_shipped_robot_can_be_and_is_the_same_on_the_wire() {
        for (name, text) in SHIPPED {
            let model = RobotModel::from_toml(text, name).unwrap();
            let wire = serde_json::to_string(&model).unwrap();
            assert_eq!(
                serde_json::from_str::<RobotModel>(&wire)
                    .unwrap()
                    .checked("wire")
                    .unwrap(),
                model
            );
        }
        let jackal = RobotModel::from_toml(shipped("jackal").unwrap(), "jackal").unwrap();
        let footprint = serde_json::to_string(&jackal.footprint).unwrap();
        assert!(footprint.starts_with(r#"{"polygon":[[-0.21,"#), "{footprint}");
    }
}
