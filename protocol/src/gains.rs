//! Gains of the trackers. How does a robot follow its plan? Part of the robot's file; the same bounds apply to the file and to
//! `ask/edge/param` at run time.

use crate::config_text::OutOfBounds;

crate::settings! {
    /// Gains of the trackers.
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    pub struct ControllerGains {
        /// Name of the tracking law: `time_law`, `pure_pursuit`, `pid`, `wheel_law`, `wheel_law_original`, `heading_first`. Checked by the
        /// edge.
        pub tracker: String = "time_law".to_owned();
        /// Waypoint law: wheel speed per radian of heading error.
        pub heading_gain: f64 = 4.0, "1/s", 0.0..=20.0;
        /// Waypoint law: wheel speed per metre of distance.
        pub distance_gain: f64 = 2.0, "rad/(m s)", 0.0..=20.0;
        /// Waypoint law: distance at which a waypoint counts as passed.
        pub waypoint_threshold: f64 = 0.3, "m", 0.05..=2.0;
        /// Trajectory tracker: gain on the along-track error.
        pub along_gain: f64 = 1.5, "1/s", 0.0..=5.0;
        /// Trajectory tracker: gain on the cross-track error.
        pub cross_gain: f64 = 8.0, "1/m²", 0.0..=50.0;
        /// Trajectory tracker: gain on the heading error.
        pub yaw_gain: f64 = 4.0, "1/m", 0.0..=20.0;
        /// Heading-first law (`Kv`): speed per metre of distance.
        pub go_gain: f64 = 1.0, "1/s", 0.0..=10.0;
        /// Heading-first law (`Kw`): yaw rate per radian of bearing.
        pub turn_gain: f64 = 2.0, "1/s", 0.0..=10.0;
        /// PID law: yaw rate per metre of cross-track error.
        pub pid_p: f64 = 6.0, "rad/(m s)", 0.0..=100.0;
        /// PID law: yaw rate per integral of the cross-track error.
        pub pid_i: f64 = 0.5, "rad/(m s²)", 0.0..=100.0;
        /// PID law: yaw rate per rate of the cross-track error.
        pub pid_d: f64 = 6.0, "rad/m", 0.0..=100.0;
        /// Pure pursuit: lookahead time.
        pub lookahead_secs: f64 = 1.5, "s", 0.1..=5.0;
        /// Turning on the spot: yaw rate per radian of heading error.
        pub spin_gain: f64 = 2.0, "1/s", 0.1..=20.0;
        /// Laws on a path: distance at which the end counts as reached.
        pub end_distance: f64 = 0.05, "m", 0.005..=1.0;
        /// Waypoint laws: greatest distance at which the last waypoint, a position to stop at, counts as reached.
        pub last_waypoint: f64 = 0.03, "m", 0.01..=2.0;
        /// Trajectory tracker: further parameters.
        pub time_law: TimeLawGains;
        /// Pure pursuit.
        pub pure_pursuit: PurePursuitGains;
        /// PID law: further parameters.
        pub pid: PidGains;
        /// Wheel law.
        pub wheel_law: WheelLawGains;
        /// Heading-first law.
        pub heading_first: HeadingFirstGains;
        /// Stopping distance of the collision monitor from an obstacle, on top of the braking distance.
        pub guard_margin: f64 = 0.03, "m", 0.01..=0.5;
        /// Greatest speed into the lidar's blind spot, over floor that was seen free before: above zero only where nobody approaches from
        /// behind. Recoveries back up slowly regardless.
        pub blind_speed: f64 = 0.0, "m/s", 0.0..=5.0;
    }
}

crate::settings! {
    /// Trajectory tracker: slowing of plan time when the robot deviates, and settling at the end.
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[derive(Copy)]
    pub struct TimeLawGains {
        /// Along-track lag up to which plan time runs at full rate.
        pub lag: f64 = 0.05, "m", 0.0..=2.0;
        /// Along-track lag at which plan time stands still.
        pub lag_stop: f64 = 0.20, "m", 0.01..=5.0;
        /// Cross-track error up to which plan time runs at full rate.
        pub cross: f64 = 0.10, "m", 0.0..=2.0;
        /// Cross-track error at which plan time stands still.
        pub cross_stop: f64 = 0.40, "m", 0.01..=5.0;
        /// Heading error up to which plan time runs at full rate.
        pub turn: f64 = 0.15, "rad", 0.0..=3.0;
        /// Heading error at which plan time stands still.
        pub turn_stop: f64 = 0.60, "rad", 0.01..=3.2;
        /// Along-track lead beyond which the reference is advanced to the robot.
        pub lead: f64 = 0.03, "m", 0.0..=1.0;
        /// Fastest correction at the end.
        pub settle_speed: f64 = 0.10, "m/s", 0.0..=1.0;
        /// Distance at which the end counts as reached.
        pub settle_distance: f64 = 0.015, "m", 0.001..=1.0;
        /// Heading error at which the end counts as reached.
        pub settle_angle: f64 = 0.03, "rad", 0.001..=1.0;
        /// Time limit for settling at the end; after it, the robot's position counts as the end.
        pub settle_secs: f64 = 2.0, "s", 0.0..=60.0;
    }
    check = |law: &TimeLawGains| {
        ordered(("lag", law.lag), ("lag_stop", law.lag_stop))?;
        ordered(("cross", law.cross), ("cross_stop", law.cross_stop))?;
        ordered(("turn", law.turn), ("turn_stop", law.turn_stop))
    };
}

crate::settings! {
    /// Regulated pure pursuit: lookahead point, and where the robot slows down.
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[derive(Copy)]
    pub struct PurePursuitGains {
        /// Least lookahead distance.
        pub lookahead: f64 = 0.3, "m", 0.05..=5.0;
        /// Greatest lookahead distance.
        pub lookahead_most: f64 = 0.9, "m", 0.06..=20.0;
        /// Radius below which the robot slows down in a bend.
        pub slow_radius: f64 = 0.9, "m", 0.0..=10.0;
        /// Least speed in a bend.
        pub least_speed: f64 = 0.1, "m/s", 0.01..=2.0;
        /// Distance from the end at which the robot begins to slow down.
        pub approach: f64 = 0.6, "m", 0.01..=10.0;
        /// Bearing of the lookahead point beyond which the robot turns on the spot.
        pub turn_first: f64 = 0.785, "rad", 0.1..=3.2;
    }
    check = |law: &PurePursuitGains| ordered(("lookahead", law.lookahead), ("lookahead_most", law.lookahead_most));
}

crate::settings! {
    /// PID law: limits.
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[derive(Copy)]
    pub struct PidGains {
        /// Limit of the integral.
        pub windup: f64 = 0.3, "m s", 0.0..=10.0;
        /// Least speed on the approach to the end.
        pub least_speed: f64 = 0.08, "m/s", 0.01..=2.0;
        /// Heading error beyond which the robot turns on the spot.
        pub turn_first: f64 = 0.8, "rad", 0.1..=3.2;
        /// Deceleration towards the end, as a share of the robot's own.
        pub braking_share: f64 = 0.5, "", 0.05..=1.0;
    }
}

crate::settings! {
    /// Wheel law.
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[derive(Copy)]
    pub struct WheelLawGains {
        /// Bearing beyond which the robot turns on the spot.
        pub turn_first: f64 = 1.0, "rad", 0.1..=3.2;
        /// Least distance in the law before the end; without it, the robot would creep towards every waypoint.
        pub least_distance: f64 = 0.6, "m", 0.0..=10.0;
    }
}

crate::settings! {
    /// Heading-first law.
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[derive(Copy)]
    pub struct HeadingFirstGains {
        /// Bearing below which the robot drives.
        pub aligned: f64 = 0.1, "rad", 0.01..=1.5;
        /// Distance at which a waypoint counts as reached.
        pub waypoint: f64 = 0.2, "m", 0.02..=2.0;
    }
}

/// Checks that the first of two settings is less than the second.
fn ordered((than, less): (&str, f64), (key, more): (&str, f64)) -> Result<(), OutOfBounds> {
    if less < more {
        Ok(())
    } else {
        Err(OutOfBounds::unlike(key, more, format!("more than `{than}`, {less}")))
    }
}

#[cfg(test)]
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
