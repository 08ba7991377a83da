//! Gains of the trackers. How does a robot follow its plan? Part of the robot's file; the bounds are the same for the file and for
//! `ask/edge/param` while the robot runs.

use crate::config_text::OutOfBounds;

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
        /// Turning on the spot: yaw rate for the heading error.
        pub spin_gain: f64 = 2.0, "1/s", 0.1..=20.0;
        /// Laws on a path: the end is reached within this.
        pub end_distance: f64 = 0.05, "m", 0.005..=1.0;
        /// Waypoint laws: the last waypoint, a place to be at, is reached within this at most.
        pub last_waypoint: f64 = 0.03, "m", 0.01..=2.0;
        /// Trajectory tracker, beyond its gains.
        pub time_law: TimeLawGains;
        /// Pure pursuit.
        pub pure_pursuit: PurePursuitGains;
        /// PID law, beyond its gains.
        pub pid: PidGains;
        /// Wheel law.
        pub wheel_law: WheelLawGains;
        /// Heading-first law.
        pub heading_first: HeadingFirstGains;
        /// Distance from an obstacle at which the collision monitor stops, beyond the braking distance.
        pub guard_margin: f64 = 0.03, "m", 0.01..=0.5;
        /// Greatest speed into the lidar's blind spot, over floor that was seen free before: more than zero only where nobody
        /// comes up behind. Recoveries back up slowly all the same.
        pub blind_speed: f64 = 0.0, "m/s", 0.0..=5.0;
    }
}

crate::settings! {
    /// Trajectory tracker: when plan time waits for the robot, and how the end is settled.
    #[derive(Copy)]
    pub struct TimeLawGains {
        /// Lag along the track up to which plan time runs at full rate.
        pub lag: f64 = 0.05, "m", 0.0..=2.0;
        /// And at which it stands.
        pub lag_stop: f64 = 0.20, "m", 0.01..=5.0;
        /// The same for the error across the track.
        pub cross: f64 = 0.10, "m", 0.0..=2.0;
        /// And where plan time stands.
        pub cross_stop: f64 = 0.40, "m", 0.01..=5.0;
        /// The same for the heading error.
        pub turn: f64 = 0.15, "rad", 0.0..=3.0;
        /// And where plan time stands.
        pub turn_stop: f64 = 0.60, "rad", 0.01..=3.2;
        /// Lead along the track beyond which the reference is moved up to the robot.
        pub lead: f64 = 0.03, "m", 0.0..=1.0;
        /// Fastest correction at the end.
        pub settle_speed: f64 = 0.10, "m/s", 0.0..=1.0;
        /// Distance at which the end counts as reached.
        pub settle_distance: f64 = 0.015, "m", 0.001..=1.0;
        /// Heading error at which it does.
        pub settle_angle: f64 = 0.03, "rad", 0.001..=1.0;
        /// Time to settle at the end; then where the robot stands is the end.
        pub settle_secs: f64 = 2.0, "s", 0.0..=60.0;
    }
    check = |law: &TimeLawGains| {
        ordered(("lag", law.lag), ("lag_stop", law.lag_stop))?;
        ordered(("cross", law.cross), ("cross_stop", law.cross_stop))?;
        ordered(("turn", law.turn), ("turn_stop", law.turn_stop))
    };
}

crate::settings! {
    /// Regulated pure pursuit: where the point ahead is, and where the robot slows down.
    #[derive(Copy)]
    pub struct PurePursuitGains {
        /// The point ahead is at least this far.
        pub lookahead: f64 = 0.3, "m", 0.05..=5.0;
        /// And at most this far.
        pub lookahead_most: f64 = 0.9, "m", 0.06..=20.0;
        /// Bends of a smaller radius are driven slower.
        pub slow_radius: f64 = 0.9, "m", 0.0..=10.0;
        /// Slowest in a bend.
        pub least_speed: f64 = 0.1, "m/s", 0.01..=2.0;
        /// The end is approached slower from here on.
        pub approach: f64 = 0.6, "m", 0.01..=10.0;
        /// Bearing of the point ahead beyond which the robot turns on the spot.
        pub turn_first: f64 = 0.785, "rad", 0.1..=3.2;
    }
    check = |law: &PurePursuitGains| ordered(("lookahead", law.lookahead), ("lookahead_most", law.lookahead_most));
}

crate::settings! {
    /// PID law: its limits.
    #[derive(Copy)]
    pub struct PidGains {
        /// The integral is held within this.
        pub windup: f64 = 0.3, "m s", 0.0..=10.0;
        /// Least speed before the end.
        pub least_speed: f64 = 0.08, "m/s", 0.01..=2.0;
        /// Heading error beyond which the robot turns on the spot.
        pub turn_first: f64 = 0.8, "rad", 0.1..=3.2;
        /// Deceleration towards the end, as a share of what the robot can.
        pub braking_share: f64 = 0.5, "", 0.05..=1.0;
    }
}

crate::settings! {
    /// Wheel law.
    #[derive(Copy)]
    pub struct WheelLawGains {
        /// Bearing beyond which the robot turns on the spot.
        pub turn_first: f64 = 1.0, "rad", 0.1..=3.2;
        /// Least distance that the law counts with before the end: it would creep towards every waypoint.
        pub least_distance: f64 = 0.6, "m", 0.0..=10.0;
    }
}

crate::settings! {
    /// Heading-first law.
    #[derive(Copy)]
    pub struct HeadingFirstGains {
        /// Bearing within which the robot drives.
        pub aligned: f64 = 0.1, "rad", 0.01..=1.5;
        /// A waypoint nearer than this is reached.
        pub waypoint: f64 = 0.2, "m", 0.02..=2.0;
    }
}

/// Whether the first of two settings is less than the second.
fn ordered((than, less): (&str, f64), (key, more): (&str, f64)) -> Result<(), OutOfBounds> {
    if less < more {
        Ok(())
    } else {
        Err(OutOfBounds::unlike(key, more, format!("more than `{than}`, {less}")))
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
        let error = defaults
            .with_number("pure_pursuit.lookahead", 1.0)
            .unwrap()
            .unwrap_err();
        assert_eq!(
            error.to_string(),
            "`pure_pursuit.lookahead_most` is 0.9: expected more than `lookahead`, 1"
        );
    }
}
