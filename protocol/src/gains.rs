//! Gains of the trackers. How does a robot follow its plan? Part of the robot's file; the bounds are the same for the file and for
//! `ask/edge/param` while the robot runs.

crate::settings! {
    /// Gains of the trackers.
    pub struct ControllerGains {
        /// The law that follows a plan, by name: `time_law`, `pure_pursuit`, `pid`, `wheel_law`, `heading_first`. The edge checks it.
        pub tracker: String = "time_law".to_owned();
        /// Waypoint law: wheel speed for each radian of heading error.
        pub heading_gain: f64 = 4.0, "1/s", 0.0..=20.0;
        /// Waypoint law: wheel speed for each metre of distance.
        pub distance_gain: f64 = 2.0, "rad/(m s)", 0.0..=20.0;
        /// Waypoint law: a waypoint nearer than this is passed.
        pub waypoint_threshold: f64 = 0.3, "m", 0.05..=2.0;
        /// Trajectory tracker: gain along the track.
        pub along_gain: f64 = 1.5, "1/s", 0.0..=5.0;
        /// Trajectory tracker: gain across the track.
        pub cross_gain: f64 = 8.0, "1/m²", 0.0..=50.0;
        /// Trajectory tracker: gain of the heading.
        pub yaw_gain: f64 = 4.0, "1/m", 0.0..=20.0;
        /// Heading-first law (`Kv`): speed for the distance.
        pub go_gain: f64 = 1.0, "1/s", 0.0..=10.0;
        /// Heading-first law (`Kw`): yaw rate for the bearing.
        pub turn_gain: f64 = 2.0, "1/s", 0.0..=10.0;
        /// PID law: yaw rate for the distance from the path.
        pub pid_p: f64 = 6.0, "rad/(m s)", 0.0..=100.0;
        /// PID law: yaw rate for the integral of that distance.
        pub pid_i: f64 = 0.5, "rad/(m s²)", 0.0..=100.0;
        /// PID law: yaw rate for the rate of that distance.
        pub pid_d: f64 = 6.0, "rad/m", 0.0..=100.0;
        /// Pure pursuit: time to the point ahead.
        pub lookahead_secs: f64 = 1.5, "s", 0.1..=5.0;
        /// Distance from an obstacle at which the collision monitor stops, beyond the braking distance.
        pub guard_margin: f64 = 0.03, "m", 0.01..=0.5;
        /// Greatest speed into the lidar's blind spot, over floor that was seen free before: more than zero only where nobody
        /// comes up behind. Recoveries back up slowly all the same.
        pub blind_speed: f64 = 0.0, "m/s", 0.0..=5.0;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::settings::Settings;

    #[test]
    fn a_gain_that_would_let_the_robot_touch_or_stand_still_is_refused() {
        let defaults = ControllerGains::default();
        for (name, words) in [("guard_margin", "0.01 to 0.5 m"), ("lookahead_secs", "0.1 to 5 s")] {
            let error = defaults.with_number(name, 0.0).unwrap().unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(words), "{error}");
        }
        for name in ControllerGains::numbers() {
            for value in [f64::NAN, f64::INFINITY, -1e9] {
                assert_eq!(defaults.with_number(&name, value).unwrap().unwrap_err().key, name);
            }
        }
    }
}
