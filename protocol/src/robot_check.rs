//! Validation of robot files. Which values are allowed? A value out of bounds is reported with file, line and key.

use std::ops::RangeInclusive;

use nalgebra::Point2;
use thiserror::Error;

use crate::config_text::{Expected, Number, OutOfBounds, check_all, line_of};
use crate::id::Id;
use crate::polygon::{cross, edges, is_convex};
use crate::robot::{Footprint, RobotModel};
use crate::sensors::DEFAULT_LIDAR;
use crate::settings::Settings as _;

/// Greatest reach of a footprint from the base, m.
const MAX_REACH: f64 = 10.0;
/// Numbers of corners that a polygon may have.
const CORNERS: RangeInclusive<usize> = 3..=64;
/// Most lidars of one robot.
const MAX_LIDARS: usize = 16;

/// Names under which the faults of a world refer to the sensors of every robot; no lidar may use them, nor those of
/// [`sensor_kinds!`](crate::sensor_kinds!).
const OTHER_SENSORS: [&str; 4] = ["encoders", "imu", "bump", "battery"];

/// Why a robot file was refused.
#[derive(Debug, Error)]
pub enum RobotError {
    /// The TOML does not match the model: the message names line and key.
    #[error("{name}: {source}")]
    Toml {
        /// The file.
        name: String,
        /// Problem and position.
        source: Box<toml::de::Error>,
    },
    /// No robot or option has this name.
    #[error("`{name}`: {reason}")]
    Unknown {
        /// The requested name.
        name: String,
        /// Why it is not available.
        reason: String,
    },
    /// A value is out of bounds.
    #[error("{at}: `{key}` {problem}")]
    Value {
        /// The file and, if known, the line: `my.toml:7`.
        at: String,
        /// The key with its enclosing tables.
        key: String,
        /// The value, and what was expected.
        problem: String,
    },
}

impl RobotError {
    /// [`RobotError::Toml`].
    pub(crate) fn toml(name: &str, source: toml::de::Error) -> Self {
        Self::Toml {
            name: name.to_owned(),
            source: Box::new(source),
        }
    }

    /// [`RobotError::Value`], with its line if the text is known.
    pub(crate) fn value(error: OutOfBounds, name: &str, text: Option<&str>) -> Self {
        let OutOfBounds { key, problem } = error;
        let line = text.and_then(|text| line_of(text, &key));
        Self::Value {
            at: line.map_or_else(|| name.to_owned(), |line| format!("{name}:{line}")),
            key,
            problem,
        }
    }
}

impl RobotModel {
    /// Checks all values; the first one out of bounds.
    pub(crate) fn check(&self) -> Result<(), OutOfBounds> {
        self.check_footprint()?;
        self.drive.check().map_err(|error| error.within("drive"))?;
        self.check_lidars()?;
        self.check_kinds()?;
        let reach = self.footprint.circumscribed_radius();
        for (table, check) in [
            ("encoders", self.encoders.check()),
            ("imu", self.imu.check()),
            ("battery", self.battery.check()),
            ("motors", self.motors.check()),
            ("controller", self.controller.check()),
            ("wall_following", self.wall_following.check_for(reach)),
        ] {
            check.map_err(|error| error.within(table))?;
        }
        Ok(())
    }

    fn check_footprint(&self) -> Result<(), OutOfBounds> {
        if let Footprint::Polygon(corners) = &self.footprint {
            let is_around_base =
                || self.footprint.distance(Point2::origin()) == 0.0 && self.footprint.inscribed_radius() > 0.0;
            let problem = outline_problem(corners).or_else(|| {
                let outside = "does not enclose the base: expected the base, (0, 0), inside the outline";
                (!is_around_base()).then(|| outside.to_owned())
            });
            if let Some(problem) = problem {
                return Err(OutOfBounds {
                    key: "footprint.polygon".to_owned(),
                    problem,
                });
            }
        }
        check_all(&[(
            "footprint.radius",
            self.footprint.inscribed_radius(),
            Expected::Positive,
        )])?;
        let reach = self.footprint.circumscribed_radius();
        if reach <= MAX_REACH {
            return Ok(());
        }
        let expected = format!("metres, at most {MAX_REACH}");
        Err(match self.footprint {
            Footprint::Radius(radius) => OutOfBounds::unlike("footprint.radius", radius, expected),
            Footprint::Polygon(_) => OutOfBounds {
                key: "footprint.polygon".to_owned(),
                problem: format!("reaches {} from the base: expected {expected}", Number(reach)),
            },
        })
    }

    fn check_lidars(&self) -> Result<(), OutOfBounds> {
        let refused = |name: &str, problem: &str| {
            Err(OutOfBounds {
                key: name.to_owned(),
                problem: problem.to_owned(),
            })
        };
        if self.lidar.is_none() && self.lidars.is_empty() {
            return refused(
                "lidar",
                "is missing: expected `[lidar]`, or `[lidars.NAME]` for each of several",
            );
        }
        if self.lidars.len() >= MAX_LIDARS {
            return refused("lidars", "has too many tables: expected at most 16 lidars");
        }
        if let Some(lidar) = &self.lidar {
            lidar.check().map_err(|error| error.within("lidar"))?;
        }
        for (name, lidar) in &self.lidars {
            let table = format!("lidars.{name}");
            let is_taken = OTHER_SENSORS.iter().chain(Self::KINDS).any(|other| other == name)
                || (name == DEFAULT_LIDAR && self.lidar.is_some());
            if Id::new(name.clone()).is_err() || is_taken {
                return refused(
                    &table,
                    "is no name of a further lidar: expected letters, digits, `_` or `-`, and not that of `[lidar]` or of another sensor",
                );
            }
            lidar.check().map_err(|error| error.within(&table))?;
        }
        Ok(())
    }
}

/// Why corners are no convex outline; none if they are one.
fn outline_problem(corners: &[Point2<f64>]) -> Option<String> {
    let at = |corner: Point2<f64>| format!("({}, {})", Number(corner.x), Number(corner.y));
    if !CORNERS.contains(&corners.len()) {
        let (least, most) = CORNERS.into_inner();
        return Some(format!("has {} corners: expected {least} to {most}", corners.len()));
    }
    if let Some(corner) = corners
        .iter()
        .find(|corner| !(corner.x.is_finite() && corner.y.is_finite()))
    {
        return Some(format!("has a corner at {}: expected finite numbers", at(*corner)));
    }
    if corners.first() == corners.last() {
        return Some(format!(
            "ends with its first corner, {}: expected each corner once",
            at(corners[0])
        ));
    }
    if let Some(edge) = edges(corners).find(|edge| edge.a == edge.b) {
        return Some(format!(
            "has the corner {} twice in a row: expected each corner once",
            at(edge.a)
        ));
    }
    if is_convex(corners) {
        return None;
    }
    let following = corners.iter().cycle().skip(2);
    let mut turns = edges(corners).zip(following);
    let not_left = turns.find(|(edge, next)| cross(edge.b - edge.a, **next - edge.b) <= 0.0);
    Some(not_left.map_or_else(
        || "crosses itself: expected a convex outline".to_owned(),
        |(edge, _)| {
            format!(
                "is not convex at {}: expected a turn to the same side at every corner",
                at(edge.b)
            )
        },
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{SHIPPED, shipped};

    /// Error message for the shipped TIAGo with a line replaced, or with lines appended.
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
                "radius = 0.265",
                "radius = 265",
                line_of("radius = 0.265"),
                "`footprint.radius` is 265: expected metres, at most 10",
            ),
            (
                "radius = 0.265",
                "polygon = [[300, 200], [-300, 200], [-300, -200], [300, -200]]",
                line_of("radius = 0.265"),
                "from the base: expected metres, at most 10",
            ),
            (
                "wheel_separation = 0.4044",
                "wheel_separation = 404.4",
                line_of("wheel_separation = 0.4044"),
                "`drive.wheel_separation` is 404.4: expected a positive number of metres, at most 10",
            ),
            (
                "max_wheel_speed = 6.28",
                "max_wheel_speed = 8000",
                line_of("max_wheel_speed = 6.28"),
                "`drive.max_wheel_speed` is 8000: expected rad/s, at most 507",
            ),
            (
                "motor_lag = 0.05",
                "motor_lag = 50",
                line_of("motor_lag = 0.05"),
                "`drive.motor_lag` is 50: expected 0 to 1 s",
            ),
            (
                "mount = { x = 0.2, y = 0.0, yaw = 0.0 }",
                "mount = { x = 20, y = 0.0, yaw = 0.0 }",
                line_of("mount = { x = 0.2, y = 0.0, yaw = 0.0 }"),
                "`lidar.mount.x` is 20: expected metres, -10 to 10",
            ),
            (
                "range_max = 5.6",
                "range_max = 5600",
                line_of("range_max = 5.6"),
                "`lidar.range_max` is 5600: expected a positive number of metres, at most 1000",
            ),
            (
                "capacity = 2.0e6",
                "capacity = 5",
                line_of("capacity = 2.0e6"),
                "`battery.capacity` is 5: expected J, at least 100",
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
                "mount = { x = 0.2, y = 0.0, yaw = 0.0 }",
                "mount = { x = 0.2, y = 0.0, yaw = 90 }",
                line_of("mount = { x = 0.2, y = 0.0, yaw = 0.0 }"),
                "`lidar.mount.yaw` is 90: expected radians within a full turn",
            ),
            (
                "compass_noise = 0.01",
                "compass_bias = -10",
                line_of("compass_noise = 0.01"),
                "`imu.compass_bias` is -10: expected radians within a full turn",
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
                "`footprint.polygon` does not enclose the base",
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
    fn each_fault_of_a_polygon_is_told_by_itself() {
        for (polygon, words) in [
            ("[[1, 0], [-1, 0]]", "has 2 corners: expected 3 to 64"),
            (
                "[[1, 0], [nan, 1], [-1, 0]]",
                "has a corner at (NaN, 1): expected finite numbers",
            ),
            (
                "[[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]",
                "ends with its first corner, (1, 1): expected each corner once",
            ),
            (
                "[[1, 1], [-1, 1], [-1, 1], [-1, -1], [1, -1]]",
                "has the corner (-1, 1) twice in a row: expected each corner once",
            ),
            (
                "[[1, 1], [0.2, 0], [-1, 1], [-1, -1], [1, -1]]",
                "is not convex at (0.2, 0): expected a turn to the same side at every corner",
            ),
            (
                "[[1, 1], [0, 1], [-1, 1], [-1, -1], [1, -1]]",
                "is not convex at (0, 1): expected a turn to the same side at every corner",
            ),
            (
                "[[0, 10], [-6, -8], [9.5, 3], [-9.5, 3], [6, -8]]",
                "crosses itself: expected a convex outline",
            ),
            (
                "[[2, 1], [1, 1], [1, -1], [2, -1]]",
                "does not enclose the base: expected the base, (0, 0), inside the outline",
            ),
        ] {
            let said = said("radius = 0.265", &format!("polygon = {polygon}"));
            assert!(
                said.ends_with(&format!("`footprint.polygon` {words}")),
                "{polygon}: {said}"
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
