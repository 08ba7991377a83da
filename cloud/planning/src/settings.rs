//! Settings of planning: the section `[planning]` of a deployment file.

zenav_protocol::settings! {
    /// Tuning of the planners.
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
        /// How a robot leaves a place where, by the map, it does not fit.
        pub leaving: LeavingSettings;
        /// The search over positions and headings, for footprints that are longer than wide.
        pub se2: Se2Settings;
        /// Sampling planners.
        pub sampling: SamplingSettings;
        /// Paths past robots that have right of way.
        pub space_time: SpaceTimeSettings;
        /// Reuse of an earlier answer.
        pub replanning: ReplanningSettings;
    }
}

zenav_protocol::settings! {
    /// Distance from obstacles, for planners that take clearance into account (A*).
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_planning::{Budget, PlanOptions, Searcher, plan};
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::messages::PlanOutcome;
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 80 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// # (0..60).for_each(|y| map[Cell::new(50, y)] = Occupancy::OCCUPIED);
    /// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
    /// // Round the end of a wall: how far is the robot's centre from it?
    /// let least = |weight| {
    ///     let mut options = PlanOptions::default();
    ///     options.settings.clearance.weight = weight;
    ///     let (start, goal) = (Pose2::new(1.0, 1.0, 0.0), Pose2::new(4.0, 1.0, 0.0));
    ///     let mut searcher = Searcher::new(space.free()).unwrap();
    ///     let planned = plan(&space, &mut searcher, start, goal, &options, Budget::UNLIMITED);
    ///     let PlanOutcome::Found { path, .. } = planned.outcome else { panic!("no path") };
    ///     path.windows(2).map(|leg| space.segment_clearance(leg[0], leg[1])).fold(f64::INFINITY, f64::min)
    /// };
    /// assert!(least(0.0) > 0.25 && least(3.0) > least(0.0) + 0.05);
    /// ```
    pub struct ClearanceSettings {
        /// A path keeps this far from obstacles where there is room, beyond the robot's inscribed radius; no farther than the distance
        /// field reaches, which is about 1 m from obstacles, or 63 cells if that is less.
        pub distance: f64 = 0.4, "m", 0.0..=10.0;
        /// Metres of detour that a metre along an obstacle is worth; 0 asks for the shortest path.
        pub weight: f64 = 3.0, "", 0.0..=7.0;
    }
}

zenav_protocol::settings! {
    /// How a robot leaves a place where, by the map, it does not fit.
    pub struct LeavingSettings {
        /// How far a mapped obstacle may reach into the footprint at the start: poses err, and mapped walls are some cells too thick.
        pub depth: f64 = 0.075, "m", 0.0..=1.0;
        /// How far such a robot may move to reach a free place.
        pub distance: f64 = 0.6, "m", 0.0..=10.0;
    }
}

zenav_protocol::settings! {
    /// The search over positions and headings.
    pub struct Se2Settings {
        /// Cost of a turn to the next of sixteen headings, as metres of driving.
        pub turn_cost: f64 = 0.08, "m", 0.0..=10.0;
        /// Cost of a metre backwards, as metres forwards: most robots see less behind them.
        pub reverse_cost: f64 = 2.0, "", 1.0..=100.0;
        /// Cost of a change between forwards and backwards, as metres of driving.
        pub cusp_cost: f64 = 0.5, "m", 0.0..=100.0;
        /// How far a robot that cannot turn on the spot drives straight on, or straight back, to a place where it can.
        pub straight_on: f64 = 2.0, "m", 0.0..=20.0;
        /// Weight of the cost-to-go: more finds a path sooner. A path costs at most about 1.1 times this many times the least: the
        /// cost-to-go counts steps to eight neighbours, which are up to 8 % longer than the way.
        pub heuristic_weight: f64 = 1.5, "", 1.0..=10.0;
        /// Nodes that one search may expand: some seconds' worth.
        pub max_nodes: u64 = 2_000_000, "", 1..;
        /// A path with room to turn everywhere replaces the search if it is at most this many times as long as the inscribed disc's path:
        /// it is found in milliseconds, the search may take a thousand times as long.
        pub detour: f64 = 1.1, "", 1.0..=10.0;
    }
}

zenav_protocol::settings! {
    /// Sampling planners. Shares and counts hold on maps of any size.
    pub struct SamplingSettings {
        /// Longest edge, as a share of the map's diagonal (OMPL's default).
        pub step: f64 = 0.2, "", 0.001..=1.0;
        /// Share of samples that are the goal, in a single tree (OMPL's default).
        pub goal_bias: f64 = 0.05, "", 0.0..=1.0;
        /// Samples before trees are steered out of the region they cover: across open ground plain sampling finds a path sooner.
        pub patience: u64 = 64;
        /// Exits drawn at a time; the one nearest to the other tree's root, or to the goal, is taken.
        pub exits: usize = 8, "", 1..=1000;
        /// Share of samples at obstacle corners once a path is known: shortest paths bend nowhere else.
        pub corners: f64 = 0.5, "", 0.0..=1.0;
        /// Largest number of samples spent on improving a path: some tenths of a second's worth; more would gain less than the wait
        /// costs.
        pub improving: u64 = 20_000;
    }
}

zenav_protocol::settings! {
    /// Paths past robots that have right of way, in space and time.
    pub struct SpaceTimeSettings {
        /// Spacing of the search grid.
        pub cell: f64 = 0.2, "m", 0.05..=1.0;
        /// Speed along the path, as a share of the robot's top speed: the rest allows for turning and accelerating.
        pub speed: f64 = 0.8, "", 0.1..=1.0;
        /// Distance kept between the discs of two robots. Below the robot's own `right_of_way.clearance` (0.3 m) it waits all the same.
        pub clearance: f64 = 0.35, "m", 0.0..=2.0;
        /// Time between leaving a place and the arrival of another robot there.
        pub before: f64 = 1.5, "s", 0.0..=20.0;
        /// Time between the departure of another robot and entering the place that it left.
        pub after: f64 = 1.0, "s", 0.0..=20.0;
        /// Extra cost of each second in the way of another robot.
        pub taken_cost: f64 = 8.0, "s", 0.0..=100.0;
        /// Longest detour that is considered.
        pub slack: f64 = 10.0, "s", 0.0..=120.0;
        /// Most nodes that a search expands, and most of those that its cost to go does: some tenths of a second's worth each.
        pub max_nodes: u64 = 200_000, "", 1..;
    }
}

zenav_protocol::settings! {
    /// Reuse of an earlier answer when the map changes or the robot moves on.
    pub struct ReplanningSettings {
        /// A repaired path is taken if it is proven to cost at most this share more than the cheapest.
        pub slack: f64 = 0.02, "", 0.0..=1.0;
        /// Cells before and after a cut that are searched again with it.
        pub around: usize = 24, "cells", 1..=1000;
        /// Expansions that the search for such a piece may take: about a millisecond's worth.
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
