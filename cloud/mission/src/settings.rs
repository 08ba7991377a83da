//! Mission settings: the section `[mission]` of a deployment file.
//!
//! Bounds on memory, and retry periods for silent components, are private constants beside their use.

use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::messages::DrivingProfile;

zenav_protocol::settings! {
    /// Settings of missions.
    ///
    /// ```
    /// use zenav_mission::MissionSettings;
    /// use zenav_protocol::settings::Settings;
    ///
    /// let patient = MissionSettings::default().with_number("patience", 600.0).unwrap()?;
    /// assert_eq!(patient.patience, 600.0);
    /// let refused = patient.with_number("renew_period", 5.0).unwrap().unwrap_err();
    /// assert_eq!(refused.to_string(), "`renew_period` is 5: expected less than `plan_valid`, 5");
    /// # Ok::<(), zenav_protocol::config_text::OutOfBounds>(())
    /// ```
    pub struct MissionSettings {
        /// Driving profile of goals without their own: `fastest` or `economy`.
        pub profile: DrivingProfile = DrivingProfile::Fastest;
        /// Distance at which a goal without its own tolerance counts as reached.
        pub tolerance: f64 = 0.15, "m", 0.02..=10.0;
        /// Whether paths may lead through unknown cells; the robot replans when they turn out to be occupied.
        pub unknown_is_free: bool = true;
        /// Greatest distance of a goal outside a growing map.
        pub explore: f64 = 20.0, "m", 0.0..=1000.0;
        /// Time limit of a search.
        pub search_budget: f64 = 2.0, "s", 0.01..=60.0;
        /// How far ahead of the robot a replan starts, in addition to the measured round trip to the robot: covers the computation of a
        /// plan.
        pub latency_budget: f64 = 0.3, "s", 0.0..=10.0;
        /// Validity of a plan: a robot without further plans keeps driving for this long.
        pub plan_valid: f64 = 5.0, "s", 0.5..=60.0;
        /// Age at which a plan is rechecked on the newest map and renewed.
        pub renew_period: f64 = 1.0, "s", 0.05..=30.0;
        /// Time without a live mapper after which plans are no longer renewed, because the map may be outdated.
        pub map_timeout: f64 = 10.0, "s", 0.1..=600.0;
        /// Distance within which a robot that stands in an obstacle according to the map may leave it for a free position.
        pub escape: f64 = 0.6, "m", 0.0..=5.0;
        /// Longest wait for a transient obstacle on the only path or at the goal. If there is a way round, this is the upper bound. A goal
        /// with a deadline waits until its deadline instead; 0 disables waiting (120: longer than people talk in a doorway, shorter than
        /// somebody needs to come and clear it).
        pub patience: f64 = 120.0, "s", 0.0..=86_400.0;
        /// A way round an obstacle that may leave is taken at once if it costs less time than this; otherwise the robot waits at least this
        /// long, while the way round stays open.
        pub least_wait: f64 = 5.0, "s", 0.0..=3600.0;
        /// Least time after its start before a goal is given up as unreachable or occupied: a closed door looks like a wall until it opens,
        /// and a distant person is only a beam or two. After the same time the robot drives to look behind an obstacle that hides the goal.
        pub linger: f64 = 30.0, "s", 0.0..=3600.0;
        /// Time for which a bump counts as recent (`IsStuck`).
        pub bump_memory: f64 = 1.0, "s", 0.0..=60.0;
        /// Period of the mission's status while nothing changes.
        pub status_period: f64 = 0.5, "s", 0.05..=10.0;
        /// When a drive counts as stuck.
        pub progress: ProgressSettings;
        /// When a drive with problems is given up.
        pub retries: RetrySettings;
        /// Reaction to an obstacle on the trajectory.
        pub obstacle: ObstacleSettings;
    }
    check = |mission: &MissionSettings| match mission.renew_period < mission.plan_valid {
        true => Ok(()),
        false => Err(OutOfBounds::unlike("renew_period", mission.renew_period, format!("less than `plan_valid`, {}", mission.plan_valid))),
    };
}

zenav_protocol::settings! {
    /// When a drive counts as stuck (Nav2's `PoseProgressChecker`).
    pub struct ProgressSettings {
        /// The robot must either move by this …
        pub distance: f64 = 0.2, "m", 0.01..=10.0;
        /// … or turn by this …
        pub angle: f64 = 0.2, "rad", 0.01..=3.2;
        /// … within this time; otherwise its drive fails.
        pub timeout: f64 = 10.0, "s", 0.5..=3600.0;
    }
}

zenav_protocol::settings! {
    /// When a drive with problems is given up.
    pub struct RetrySettings {
        /// Consecutive plans that the robot may refuse.
        pub refusals: u32 = 5, "", 0..=1000;
        /// Wait after a refusal.
        pub refusal_wait: f64 = 0.3, "s", 0.0..=60.0;
        /// Number of times that a drive may end outside the goal's tolerance.
        pub misses: u32 = 3, "", 0..=1000;
        /// Wait before asking again after a worker did not answer or found nothing.
        pub worker_wait: f64 = 0.5, "s", 0.05..=60.0;
        /// Time to wait for a map that the worker does not have yet.
        pub map_wait: f64 = 20.0, "s", 0.0..=600.0;
        /// Time to wait for the robot to come to rest, for a plan that starts from rest.
        pub rest_wait: f64 = 10.0, "s", 0.0..=600.0;
    }
}

zenav_protocol::settings! {
    /// Reaction to an obstacle on the trajectory.
    pub struct ObstacleSettings {
        /// Obstacles that the robot reaches later than this need no immediate replan …
        pub far: f64 = 4.0, "s", 0.0..=60.0;
        /// … until the last replan is this old: a growing map reveals one obstacle after the other.
        pub gather: f64 = 2.0, "s", 0.0..=60.0;
        /// Lead with which the robot is brought to rest, in addition to braking and the latency budget.
        pub brake_early: f64 = 0.4, "s", 0.0..=10.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_protocol::settings::Settings as _;

    #[test]
    fn a_plan_outlives_its_renewal() {
        let settings = MissionSettings::default();
        settings.check().unwrap();
        let refused = settings.with_number("plan_valid", 0.9).unwrap().unwrap_err();
        assert_eq!(
            refused.to_string(),
            "`renew_period` is 1: expected less than `plan_valid`, 0.9"
        );
    }
}
