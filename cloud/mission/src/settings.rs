//! Mission settings: the section `[mission]` of a deployment file.
//!
//! Bounds on memory, and how often a silent part is asked again, are private constants beside their use.

use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::messages::DrivingProfile;

zenav_protocol::settings! {
    /// What can be tuned about missions.
    pub struct MissionSettings {
        /// Driving profile of goals that name none: `fastest` or `economy`.
        pub profile: DrivingProfile = DrivingProfile::Fastest;
        /// Distance that counts as reached where a goal does not say.
        pub tolerance: f64 = 0.15, "m", 0.02..=10.0;
        /// Whether paths may lead through unknown cells; the robot replans when they turn out to be occupied.
        pub unknown_is_free: bool = true;
        /// How far outside a growing map a goal may be.
        pub explore: f64 = 20.0, "m", 0.0..=1000.0;
        /// Time that a search may take.
        pub search_budget: f64 = 2.0, "s", 0.01..=60.0;
        /// How far ahead of the robot a replan starts, beyond the round trip to the robot, which it measures: the time that a plan takes to compute.
        pub latency_budget: f64 = 0.3, "s", 0.0..=10.0;
        /// Validity of a plan: a robot that hears no more drives on for so long.
        pub plan_valid: f64 = 5.0, "s", 0.5..=60.0;
        /// Age at which a plan is rechecked on the newest map and renewed.
        pub renew_period: f64 = 1.0, "s", 0.05..=30.0;
        /// Without a live mapper for this long plans are no longer renewed: the map says nothing new.
        pub map_timeout: f64 = 10.0, "s", 0.1..=600.0;
        /// A robot that by the map stands in an obstacle may leave it for a free place this near.
        pub escape: f64 = 0.6, "m", 0.0..=5.0;
        /// How long something that may leave is waited for while it bars the only way or the goal. A goal's own deadline comes first; 0
        /// waits for nothing (120: longer than people talk in a door, shorter than somebody needs to see to it).
        pub patience: f64 = 120.0, "s", 0.0..=86_400.0;
        /// A goal is not given up as closed off or taken sooner than this after it began: a shut door looks like a wall until it opens, and
        /// somebody far off is a beam or two. Behind what stands before the goal, and hides it, the robot looks after as long.
        pub linger: f64 = 30.0, "s", 0.0..=3600.0;
        /// A bump counts as recent for this long (`IsStuck`).
        pub bump_memory: f64 = 1.0, "s", 0.0..=60.0;
        /// Period of the mission's status where nothing changes.
        pub status_period: f64 = 0.5, "s", 0.05..=10.0;
        /// Whether a drive gets on.
        pub progress: ProgressSettings;
        /// When a drive that meets trouble is given up.
        pub retries: RetrySettings;
        /// What happens when the map shows an obstacle on the trajectory.
        pub obstacle: ObstacleSettings;
    }
    check = |mission: &MissionSettings| match mission.renew_period < mission.plan_valid {
        true => Ok(()),
        false => Err(OutOfBounds::unlike("renew_period", mission.renew_period, format!("less than `plan_valid`, {}", mission.plan_valid))),
    };
}

zenav_protocol::settings! {
    /// Whether a drive gets on (Nav2's `PoseProgressChecker`).
    pub struct ProgressSettings {
        /// Either the robot moves by this …
        pub distance: f64 = 0.2, "m", 0.01..=10.0;
        /// … or turns by this …
        pub angle: f64 = 0.2, "rad", 0.01..=3.2;
        /// … within this time, or its drive fails.
        pub timeout: f64 = 10.0, "s", 0.5..=3600.0;
    }
}

zenav_protocol::settings! {
    /// When a drive that meets trouble is given up.
    pub struct RetrySettings {
        /// Plans in a row that the robot may refuse.
        pub refusals: u32 = 5, "", 0..=1000;
        /// Wait after a refusal.
        pub refusal_wait: f64 = 0.3, "s", 0.0..=60.0;
        /// Times that the end of a drive may lie beyond the goal's tolerance.
        pub misses: u32 = 3, "", 0..=1000;
        /// Wait before a worker is asked again that did not answer or found nothing.
        pub worker_wait: f64 = 0.5, "s", 0.05..=60.0;
        /// Time to wait for a map that the worker does not have yet.
        pub map_wait: f64 = 20.0, "s", 0.0..=600.0;
        /// Time to wait for the robot to stand where a plan has to start from rest.
        pub rest_wait: f64 = 10.0, "s", 0.0..=600.0;
    }
}

zenav_protocol::settings! {
    /// What happens when the map shows an obstacle on the trajectory.
    pub struct ObstacleSettings {
        /// What the robot reaches later than this may wait …
        pub far: f64 = 4.0, "s", 0.0..=60.0;
        /// … until the last replan is this old: a map that grows shows one thing after the other.
        pub gather: f64 = 2.0, "s", 0.0..=60.0;
        /// The robot is brought to rest this much earlier than braking and the latency budget need.
        pub brake_early: f64 = 0.4, "s", 0.0..=10.0;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
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
