//! How does a robot follow its plan? The tracker and its gains, part of the robot's file, and the bounds of each gain: the same for the
//! file and for whoever sets one while the robot runs.

use serde::{Deserialize, Serialize};

use crate::config_text::OutOfBounds;

/// The law that follows a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrackerKind {
    /// The trajectory's own time law as feed-forward, feedback on the pose error.
    #[default]
    TimeLaw,
    /// Wheel speeds in proportion to bearing and distance of the next waypoint.
    WheelLaw,
    /// Turns to the next waypoint, then drives at it.
    HeadingFirst,
    /// PID on the distance from the path.
    Pid,
    /// Regulated pure pursuit.
    PurePursuit,
}

/// Gains of the trackers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerGains {
    /// The law that follows a plan.
    pub tracker: TrackerKind,
    /// Waypoint law: wheel speed for the heading error, rad/s for each rad.
    pub heading_gain: f64,
    /// Waypoint law: wheel speed for the distance, rad/s for each m.
    pub distance_gain: f64,
    /// Waypoint law: a waypoint nearer than this is passed, m.
    pub waypoint_threshold: f64,
    /// Trajectory tracker: gain along the track, 1/s.
    pub along_gain: f64,
    /// Trajectory tracker: gain across the track, 1/m².
    pub cross_gain: f64,
    /// Trajectory tracker: gain of the heading, 1/m.
    pub yaw_gain: f64,
    /// Heading-first law (`Kv`): speed for the distance, 1/s.
    pub go_gain: f64,
    /// Heading-first law (`Kw`): yaw rate for the bearing, 1/s.
    pub turn_gain: f64,
    /// PID law: yaw rate for the distance from the path, rad/s for each m.
    pub pid_p: f64,
    /// PID law: for its integral, rad/s for each m s.
    pub pid_i: f64,
    /// PID law: for its rate, rad for each m.
    pub pid_d: f64,
    /// Pure pursuit: time to the point ahead, s.
    pub lookahead_secs: f64,
    /// Distance at which the guard stops, beyond the braking distance, m.
    pub guard_margin: f64,
    /// Fastest speed to where the lidar does not look, over floor that it saw before, m/s: more than zero only where nobody
    /// comes up behind. Recoveries back up slowly all the same.
    pub blind_speed: f64,
}

impl Default for ControllerGains {
    fn default() -> Self {
        Self {
            tracker: TrackerKind::default(),
            heading_gain: 4.0,
            distance_gain: 2.0,
            waypoint_threshold: 0.3,
            along_gain: 1.5,
            cross_gain: 8.0,
            yaw_gain: 4.0,
            go_gain: 1.0,
            turn_gain: 2.0,
            pid_p: 6.0,
            pid_i: 0.5,
            pid_d: 6.0,
            lookahead_secs: 1.5,
            guard_margin: 0.03,
            blind_speed: 0.0,
        }
    }
}

/// A gain's name, its least and greatest value, and its place.
type Gain = (&'static str, f64, f64, fn(&mut ControllerGains) -> &mut f64);

const GAINS: [Gain; 14] = [
    ("heading_gain", 0.0, 20.0, |gains| &mut gains.heading_gain),
    ("distance_gain", 0.0, 20.0, |gains| &mut gains.distance_gain),
    ("waypoint_threshold", 0.05, 2.0, |gains| &mut gains.waypoint_threshold),
    ("along_gain", 0.0, 5.0, |gains| &mut gains.along_gain),
    ("cross_gain", 0.0, 50.0, |gains| &mut gains.cross_gain),
    ("yaw_gain", 0.0, 20.0, |gains| &mut gains.yaw_gain),
    ("go_gain", 0.0, 10.0, |gains| &mut gains.go_gain),
    ("turn_gain", 0.0, 10.0, |gains| &mut gains.turn_gain),
    ("pid_p", 0.0, 100.0, |gains| &mut gains.pid_p),
    ("pid_i", 0.0, 100.0, |gains| &mut gains.pid_i),
    ("pid_d", 0.0, 100.0, |gains| &mut gains.pid_d),
    ("lookahead_secs", 0.1, 5.0, |gains| &mut gains.lookahead_secs),
    ("guard_margin", 0.01, 0.5, |gains| &mut gains.guard_margin),
    ("blind_speed", 0.0, 5.0, |gains| &mut gains.blind_speed),
];

impl ControllerGains {
    /// The names of all gains, in the order of the file.
    pub fn names() -> impl Iterator<Item = &'static str> {
        GAINS.iter().map(|(name, ..)| *name)
    }

    /// A gain by name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<f64> {
        let (.., place) = GAINS.iter().find(|(known, ..)| *known == name)?;
        Some(*place(&mut self.clone()))
    }

    /// These gains with another value for one of them; `None` when there is none of that name.
    ///
    /// # Errors
    /// The bounds that the value is not within.
    pub fn with(&self, name: &str, value: f64) -> Option<Result<Self, OutOfBounds>> {
        let (.., place) = GAINS.iter().find(|(known, ..)| *known == name)?;
        let mut changed = self.clone();
        *place(&mut changed) = value;
        Some(changed.check().map(|()| changed))
    }

    /// Whether all gains are within their bounds.
    ///
    /// # Errors
    /// The first that is not.
    pub fn check(&self) -> Result<(), OutOfBounds> {
        let mut gains = self.clone();
        for (name, least, most, place) in &GAINS {
            let value = *place(&mut gains);
            if !(*least..=*most).contains(&value) {
                return Err(OutOfBounds::outside(*name, value, *least, *most));
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
    fn every_gain_has_bounds_that_its_default_lies_within() {
        let defaults = ControllerGains::default();
        let mut keys: Vec<String> = toml::Table::try_from(&defaults).unwrap().keys().cloned().collect();
        keys.retain(|key| key != "tracker");
        let mut names: Vec<&str> = ControllerGains::names().collect();
        names.sort_unstable();
        assert_eq!(keys, names);
        defaults.check().unwrap();
        for name in names {
            let value = defaults.get(name).unwrap();
            assert_eq!(defaults.with(name, value).unwrap().unwrap(), defaults, "{name}");
            for value in [f64::NAN, f64::INFINITY, -1e9] {
                assert_eq!(defaults.with(name, value).unwrap().unwrap_err().name, name);
            }
        }
        assert!(defaults.with("gain", 1.0).is_none() && defaults.get("gain").is_none());
    }

    #[test]
    fn a_gain_that_would_let_the_robot_touch_or_stand_still_is_refused() {
        let defaults = ControllerGains::default();
        for (name, words) in [("guard_margin", "0.01 to 0.5"), ("lookahead_secs", "0.1 to 5")] {
            let error = defaults.with(name, 0.0).unwrap().unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(words), "{error}");
        }
    }
}
