//! Settings of planning: the section `[planning]` of a deployment file.

zenav_protocol::settings! {
    /// What can be tuned about planning.
    ///
    /// ```
    /// use zenav_planning::PlanningSettings;
    /// use zenav_protocol::settings::Settings;
    ///
    /// let wide = PlanningSettings::default().with_number("clearance.distance", 0.8).unwrap()?;
    /// assert_eq!(wide.clearance.distance, 0.8);
    /// assert!(wide.with_number("clearance.weight", 9.0).unwrap().is_err(), "out of its bounds");
    /// # Ok::<(), zenav_protocol::config_text::OutOfBounds>(())
    /// ```
    pub struct PlanningSettings {
        /// Nodes that one search may expand: some seconds' worth.
        pub max_expansions: u64 = 50_000_000, "", 1..;
        /// Samples that one search may draw: seconds' worth.
        pub max_samples: u64 = 1_000_000, "", 1..;
        /// How far paths keep from obstacles.
        pub clearance: ClearanceSettings;
        /// How a robot leaves a place where it does not fit by the map.
        pub leaving: LeavingSettings;
        /// The search over positions and headings, for footprints that are longer than wide.
        pub se2: Se2Settings;
        /// Planners that draw samples.
        pub sampling: SamplingSettings;
        /// Paths past robots that go first.
        pub space_time: SpaceTimeSettings;
        /// What of an earlier answer is kept.
        pub replanning: ReplanningSettings;
    }
}

zenav_protocol::settings! {
    /// Distance from obstacles, for planners that keep clear of them (A*).
    pub struct ClearanceSettings {
        /// A path keeps this far from obstacles where there is room, beyond the robot's inscribed radius.
        pub distance: f64 = 0.4, "m", 0.0..=10.0;
        /// Metres of detour that a metre along an obstacle is worth; 0 asks for the shortest path.
        pub weight: f64 = 3.0, "", 0.0..=7.0;
    }
}

zenav_protocol::settings! {
    /// How a robot leaves a place where it does not fit by the map.
    pub struct LeavingSettings {
        /// How deep an obstacle may reach into a robot that stands: poses err, and mapped walls are some cells too thick.
        pub depth: f64 = 0.075, "m", 0.0..=1.0;
        /// How far such a robot may go for a free place.
        pub distance: f64 = 0.6, "m", 0.0..=10.0;
    }
}

zenav_protocol::settings! {
    /// The search over positions and headings.
    pub struct Se2Settings {
        /// What a turn to the next of sixteen headings costs, as metres of driving.
        pub turn_cost: f64 = 0.08, "m", 0.0..=10.0;
        /// What a metre backwards costs, as metres forwards: most robots see less behind them.
        pub reverse_cost: f64 = 2.0, "", 1.0..=100.0;
        /// What a change between forwards and backwards costs, as metres of driving.
        pub cusp_cost: f64 = 0.5, "m", 0.0..=100.0;
        /// How far a robot that cannot turn where it stands goes straight on, or straight back, to where it can.
        pub straight_on: f64 = 2.0, "m", 0.0..=20.0;
        /// Weight of the cost to go: 1 finds the cheapest path, more finds one sooner that may cost this many times as much.
        pub heuristic_weight: f64 = 1.5, "", 1.0..=10.0;
        /// Nodes that are expanded at most: some seconds.
        pub max_nodes: u64 = 2_000_000, "", 1..;
        /// A path with room to turn everywhere is taken instead of the search when it is at most this many times as long as one for the
        /// inscribed disc: it is found in milliseconds, where the search may take a thousand times as long.
        pub detour: f64 = 1.1, "", 1.0..=10.0;
    }
}

zenav_protocol::settings! {
    /// Planners that draw samples. Shares and counts hold on maps of any size.
    pub struct SamplingSettings {
        /// Longest edge, as a share of the map's diagonal (OMPL's default).
        pub step: f64 = 0.2, "", 0.001..=1.0;
        /// Share of samples that are the goal, in a single tree (OMPL's default).
        pub goal_bias: f64 = 0.05, "", 0.0..=1.0;
        /// Samples before trees are led out of what they have covered: a path across open ground is found sooner by chance alone.
        pub patience: u64 = 64;
        /// Exits that are drawn each time; the one nearest to the other tree is taken.
        pub exits: usize = 8, "", 1..=1000;
        /// Share of samples at the corners of obstacles once a path is known: shortest paths bend nowhere else.
        pub corners: f64 = 0.5, "", 0.0..=1.0;
        /// Samples with which a path is improved at most: some tenths of a second's worth, what more would gain is less than the wait
        /// costs.
        pub improving: u64 = 20_000;
    }
}

zenav_protocol::settings! {
    /// Paths past robots that go first, in space and time.
    pub struct SpaceTimeSettings {
        /// Spacing of the places that are searched.
        pub cell: f64 = 0.2, "m", 0.05..=1.0;
        /// Speed that is planned with, as a share of the robot's top speed: it also turns and speeds up.
        pub speed: f64 = 0.8, "", 0.1..=1.0;
        /// Distance kept from another robot's disc; at least what the right of way on the robot asks for (0.3 m), or it waits all the same.
        pub clearance: f64 = 0.4, "m", 0.0..=2.0;
        /// A place is left so long before another robot comes.
        pub before: f64 = 2.0, "s", 0.0..=20.0;
        /// And entered so long after it has left.
        pub after: f64 = 1.0, "s", 0.0..=20.0;
        /// What a second in another robot's way costs beyond itself, in seconds.
        pub taken_cost: f64 = 8.0, "s", 0.0..=100.0;
        /// Detours of up to this long are looked at.
        pub slack: f64 = 15.0, "s", 0.0..=120.0;
        /// Nodes that are expanded at most: some tenths of a second.
        pub max_nodes: u64 = 200_000, "", 1..;
    }
}

zenav_protocol::settings! {
    /// What of an earlier answer is kept when the map changes or the robot moves on.
    pub struct ReplanningSettings {
        /// A repaired path is taken when it is proven to cost at most this share more than the cheapest.
        pub slack: f64 = 0.02, "", 0.0..=1.0;
        /// Cells before and after a cut that are searched anew with it.
        pub around: usize = 24, "cells", 1..=1000;
        /// Expansions that such a piece may take: about a millisecond's.
        pub max_expansions: u64 = 20_000, "", 1..;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_protocol::settings::Settings as _;

    #[test]
    fn the_defaults_are_within_their_bounds_and_every_setting_says_what_it_does() {
        assert_eq!(PlanningSettings::default().check(), Ok(()));
        let rows = PlanningSettings::rows();
        assert!(rows.iter().all(|row| !row.doc.is_empty()));
        assert!(rows.iter().any(|row| row.key == "clearance.weight"));
    }
}
