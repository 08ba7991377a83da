//! Settings of the wall follower. How does a robot follow walls? Part of the robot's file; distances are measured from the base's origin.

use crate::config_text::OutOfBounds;
use crate::settings::Settings as _;

/// Gap between robot and wall if no distance is configured, m.
const BESIDE: f64 = 0.15;

crate::settings! {
    /// Distances, speeds and gains of the wall follower.
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    pub struct WallFollowing {
        /// Distance kept from the wall. If it is not set, it is at least 0.15 m more than the robot's reach.
        pub target_distance: f64 = 0.55, "m", 0.05..=12.0;
        /// Distance at which an approached wall counts as reached. If it is not set, it grows with `target_distance`.
        pub identify_wall_distance: f64 = 0.75, "m", 0.05..=12.0;
        /// Fewest neighbouring returns that form a wall; fewer count as noise.
        pub wall_min_points: usize = 5, "", 2..=100;
        /// Gap between neighbouring returns above which they belong to different walls.
        pub wall_gap: f64 = 0.15, "m", 0.01..=2.0;
        /// Deviation below which a return belongs to the wall.
        pub wall_roughness: f64 = 0.05, "m", 0.0..=0.5;
        /// Heading error below which the robot drives up to the wall it searched.
        pub search_tolerance: f64 = 0.1, "rad", 0.01..=0.5;
        /// Approach: speed per metre left.
        pub approach_gain: f64 = 0.8, "1/s", 0.05..=10.0;
        /// Approach and turns on the spot: yaw rate per radian left.
        pub steering: f64 = 2.0, "1/s", 0.1..=20.0;
        /// Approach: least speed.
        pub least_speed: f64 = 0.05, "m/s", 0.01..=2.0;
        /// Greatest speed.
        pub greatest_speed: f64 = 0.3, "m/s", 0.01..=2.0;
        /// Yaw rate of turns on the spot.
        pub turn_rate: f64 = 0.8, "rad/s", 0.1..=5.0;
        /// Half the opening angle of the cone ahead in which obstacles widen the distance.
        pub cone_angle: f64 = 0.6, "rad", 0.1..=1.2;
        /// Length of that cone. If it is not set, it grows with `target_distance`.
        pub cone_reach: f64 = 1.1, "m", 0.1..=12.0;
        /// Greatest distance from the wall at which the robot still passes an obstacle; one that needs more counts as a corner. If it is
        /// not set, it grows with `target_distance`.
        pub widest_distance: f64 = 0.85, "m", 0.05..=12.0;
        /// Yaw rate per distance error.
        pub wall_p: f64 = 4.0, "rad/(m s)", 0.0..=200.0;
        /// Yaw rate per integral of the distance error.
        pub wall_i: f64 = 0.2, "rad/(m s²)", 0.0..=50.0;
        /// Yaw rate per rate of the distance error.
        pub wall_d: f64 = 8.0, "rad/m", 0.0..=200.0;
        /// Distance error below which it is integrated.
        pub wall_i_within: f64 = 0.1, "m", 0.0..=2.0;
        /// Limit of the integral's yaw rate.
        pub wall_i_most: f64 = 0.3, "rad/s", 0.0..=5.0;
        /// Steepest heading towards the wall, as a sine.
        pub wall_steepest: f64 = 0.45, "", 0.05..=1.0;
    }
}

impl WallFollowing {
    /// Adapts the distances to a robot whose outline reaches `reach` m from its origin: those not `written` grow for a robot too large for
    /// the defaults, and with a longer distance from the wall.
    #[must_use]
    pub(crate) fn fitted(self, reach: f64, written: impl Fn(&str) -> bool) -> Self {
        let grown = |key, distance: f64, by: f64| if written(key) { distance } else { distance + by.max(0.0) };
        let target_distance = grown(
            "target_distance",
            self.target_distance,
            reach + BESIDE - self.target_distance,
        );
        let by = target_distance - Self::default().target_distance;
        Self {
            target_distance,
            identify_wall_distance: grown("identify_wall_distance", self.identify_wall_distance, by),
            cone_reach: grown("cone_reach", self.cone_reach, by),
            widest_distance: grown("widest_distance", self.widest_distance, by),
            ..self
        }
    }

    /// Whether all settings are within bounds and consistent with one another, for a robot whose outline reaches `reach` m from its origin.
    ///
    /// # Errors
    /// Names the setting and what was expected.
    pub fn check_for(&self, reach: f64) -> Result<(), OutOfBounds> {
        self.check()?;
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
        for (key, value, than, least) in ordered {
            if value < least {
                return Err(OutOfBounds::unlike(key, value, format!("at least {than}, {least}")));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_that_nobody_wrote_grow_with_the_robot() {
        let usual = WallFollowing::default();
        assert_eq!(usual.clone().fitted(0.39, |_| false), usual);
        for reach in [0.72, 1.12, 10.0] {
            let fitted = usual.clone().fitted(reach, |_| false);
            fitted.check_for(reach).unwrap();
            assert!((fitted.target_distance - reach - BESIDE).abs() < 1e-9);
        }
        let far = WallFollowing {
            target_distance: 2.0,
            ..usual.clone()
        }
        .fitted(0.3, |key| key == "target_distance");
        assert_eq!((far.target_distance, far.check_for(0.3)), (2.0, Ok(())));
        let near = usual.fitted(1.0, |key| key == "target_distance").check_for(1.0);
        assert!(near.unwrap_err().to_string().contains("at least the robot's own reach"));
    }

    #[test]
    fn what_cannot_be_is_refused_with_its_name_and_what_was_expected() {
        let defaults = WallFollowing::default();
        defaults.check_for(0.3).unwrap();
        for (name, value, words) in [
            ("target_distance", 0.1, "at least the robot's own reach"),
            ("target_distance", f64::NAN, "expected 0.05 to 12 m"),
            ("target_distance", 0.9, "`widest_distance`"),
            ("least_speed", 0.5, "`greatest_speed` is 0.3"),
            ("wall_min_points", 2.5, "a whole number"),
            ("wall_p", -1.0, "expected 0 to 200"),
        ] {
            let changed = defaults.with_number(name, value).unwrap();
            let error = changed.and_then(|wall| wall.check_for(0.3)).unwrap_err().to_string();
            assert!(error.contains(words), "{name} {value}: {error}");
        }
    }
}
