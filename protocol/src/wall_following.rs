//! How does a robot follow walls? Distances, speeds and gains of the wall follower, part of the robot's file.

use serde::{Deserialize, Serialize};

use crate::config_text::OutOfBounds;

/// Settings of the wall follower. Distances are from the base's origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WallFollowing {
    /// Distance that is kept from the wall, m.
    pub target_distance: f64,
    /// Distance at which an approached wall counts as reached, m.
    pub identify_wall_distance: f64,
    /// Neighbouring returns that make a wall: fewer are noise.
    pub wall_min_points: usize,
    /// Heading error within which a wall that was searched is approached, rad.
    pub search_tolerance: f64,
    /// Approach: speed for each metre left, 1/s.
    pub approach_gain: f64,
    /// Approach: least speed, m/s.
    pub least_speed: f64,
    /// Greatest speed, m/s.
    pub greatest_speed: f64,
    /// Yaw rate of turns on the spot, rad/s.
    pub turn_rate: f64,
    /// Half the opening of the cone ahead in which obstacles widen the distance, rad.
    pub cone_angle: f64,
    /// Length of that cone, m.
    pub cone_reach: f64,
    /// Distance from the wall up to which the robot goes around an obstacle; what needs more is a corner, m.
    pub widest_distance: f64,
    /// Yaw rate for the distance error, rad/s for each m.
    pub wall_p: f64,
    /// Yaw rate for the sum of the distance error, rad/s for each m s.
    pub wall_i: f64,
    /// Yaw rate for the change of the distance error, rad for each m.
    pub wall_d: f64,
}

impl Default for WallFollowing {
    fn default() -> Self {
        Self {
            target_distance: 0.55,
            identify_wall_distance: 0.75,
            wall_min_points: 5,
            search_tolerance: 0.1,
            approach_gain: 0.8,
            least_speed: 0.05,
            greatest_speed: 0.3,
            turn_rate: 0.8,
            cone_angle: 0.6,
            cone_reach: 1.1,
            widest_distance: 0.85,
            wall_p: 4.0,
            wall_i: 0.2,
            wall_d: 8.0,
        }
    }
}

/// A setting's name, its bounds, and how it is read and written.
struct Setting {
    name: &'static str,
    least: f64,
    most: f64,
    get: fn(&WallFollowing) -> f64,
    set: fn(&mut WallFollowing, f64),
}

macro_rules! setting {
    ($field:ident, $least:expr, $most:expr) => {
        Setting {
            name: stringify!($field),
            least: $least,
            most: $most,
            get: |wall| wall.$field,
            set: |wall, value| wall.$field = value,
        }
    };
}

const SETTINGS: [Setting; 14] = [
    setting!(target_distance, 0.05, 5.0),
    setting!(identify_wall_distance, 0.05, 5.0),
    Setting {
        name: "wall_min_points",
        least: 2.0,
        most: 100.0,
        get: |wall| wall.wall_min_points as f64,
        set: |wall, value| wall.wall_min_points = value as usize,
    },
    setting!(search_tolerance, 0.01, 0.5),
    setting!(approach_gain, 0.05, 10.0),
    setting!(least_speed, 0.01, 2.0),
    setting!(greatest_speed, 0.01, 2.0),
    setting!(turn_rate, 0.1, 5.0),
    setting!(cone_angle, 0.1, 1.2),
    setting!(cone_reach, 0.1, 5.0),
    setting!(widest_distance, 0.05, 5.0),
    setting!(wall_p, 0.0, 200.0),
    setting!(wall_i, 0.0, 50.0),
    setting!(wall_d, 0.0, 200.0),
];

impl WallFollowing {
    /// The names of all settings, in the order of the file.
    pub fn names() -> impl Iterator<Item = &'static str> {
        SETTINGS.iter().map(|setting| setting.name)
    }

    /// A setting by name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<f64> {
        let setting = SETTINGS.iter().find(|setting| setting.name == name)?;
        Some((setting.get)(self))
    }

    /// These settings with another value for one of them, for a robot whose outline reaches `reach` m from its origin;
    /// `None` when there is no setting of that name.
    ///
    /// # Errors
    /// What was expected: a value within bounds, and settings that fit one another.
    pub fn with(&self, name: &str, value: f64, reach: f64) -> Option<Result<Self, OutOfBounds>> {
        let setting = SETTINGS.iter().find(|setting| setting.name == name)?;
        // `2.5 as usize` would hide what was asked for.
        if name == "wall_min_points" && value.fract() != 0.0 {
            return Some(Err(OutOfBounds::unlike(setting.name, value, "a whole number")));
        }
        let mut changed = self.clone();
        if (setting.least..=setting.most).contains(&value) {
            (setting.set)(&mut changed, value);
        } else {
            return Some(Err(OutOfBounds::outside(
                setting.name,
                value,
                setting.least,
                setting.most,
            )));
        }
        Some(changed.check(reach).map(|()| changed))
    }

    /// Whether all settings are within bounds and fit one another, for a robot whose outline reaches `reach` m from its
    /// origin.
    ///
    /// # Errors
    /// Names the setting and what was expected.
    pub fn check(&self, reach: f64) -> Result<(), OutOfBounds> {
        for setting in &SETTINGS {
            let value = (setting.get)(self);
            if !(setting.least..=setting.most).contains(&value) {
                return Err(OutOfBounds::outside(setting.name, value, setting.least, setting.most));
            }
        }
        let ordered = [
            ("target_distance", self.target_distance, "the robot's own reach", reach),
            (
                "identify_wall_distance",
                self.identify_wall_distance,
                "the robot's own reach",
                reach,
            ),
            (
                "widest_distance",
                self.widest_distance,
                "`target_distance`",
                self.target_distance,
            ),
            ("cone_reach", self.cone_reach, "`target_distance`", self.target_distance),
            ("greatest_speed", self.greatest_speed, "`least_speed`", self.least_speed),
        ];
        for (name, value, than, least) in ordered {
            if value < least {
                return Err(OutOfBounds::unlike(name, value, format!("at least {than}, {least}")));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_setting_can_be_read_and_written_by_the_name_of_its_key() {
        let defaults = WallFollowing::default();
        let keys: Vec<String> = toml::Table::try_from(&defaults).unwrap().keys().cloned().collect();
        let mut names: Vec<&str> = WallFollowing::names().collect();
        names.sort_unstable();
        assert_eq!(keys, names);
        for name in names {
            let value = defaults.get(name).unwrap();
            assert_eq!(defaults.with(name, value, 0.3).unwrap().unwrap(), defaults, "{name}");
        }
        assert!(defaults.with("speed", 1.0, 0.3).is_none() && defaults.get("speed").is_none());
    }

    #[test]
    fn what_cannot_be_is_refused_with_its_name_and_what_was_expected() {
        let defaults = WallFollowing::default();
        for (name, value, words) in [
            ("target_distance", 0.1, "at least the robot's own reach"),
            ("target_distance", f64::NAN, "expected 0.05 to 5"),
            ("target_distance", 0.9, "`widest_distance`"),
            ("least_speed", 0.5, "`greatest_speed` is 0.3"),
            ("wall_min_points", 2.5, "a whole number"),
            ("wall_p", -1.0, "expected 0 to 200"),
        ] {
            let error = defaults.with(name, value, 0.3).unwrap().unwrap_err().to_string();
            assert!(error.contains(words), "{name} {value}: {error}");
        }
    }
}
