//! Settings. The tunable numbers of smoothing.
//!
//! The section `[smoothing]` of a deployment file. Tolerances of solvers and bounds on memory are private constants beside their use.

zenav_protocol::settings! {
    /// How a path becomes a trajectory.
    ///
    /// ```
    /// use zenav_protocol::settings::Settings;
    /// use zenav_smoothing::SmoothingSettings;
    ///
    /// let wide = SmoothingSettings::default().with_number("turning_length", 0.5).unwrap()?;
    /// assert_eq!(wide.turning_length, 0.5);
    /// let refused = wide.with_number("corridor.clearance", -0.1).unwrap().unwrap_err();
    /// assert!(refused.to_string().contains("`corridor.clearance` is -0.1"));
    /// # Ok::<(), zenav_protocol::config_text::OutOfBounds>(())
    /// ```
    #[derive(Copy)]
    pub struct SmoothingSettings {
        /// Length over which the robot prefers to turn: weighs curvature against length.
        pub turning_length: f64 = 0.25, "m", 0.01..=10.0;
        /// Distance between samples of the curve; the curvature is linear between them.
        pub step: f64 = 0.02, "m", 0.002..=0.5;
        /// Largest number of iterations of the geometry solver for each quadratic programme.
        pub max_iterations: u32 = 60, "", 1..=1000;
        /// The free polygons around the path.
        pub corridor: CorridorSettings;
        /// Where the robot stops and turns instead of following a curve.
        pub stops: StopSettings;
    }
}

zenav_protocol::settings! {
    /// The free polygons around the path.
    #[derive(Copy)]
    pub struct CorridorSettings {
        /// Longest piece of the path in one polygon at the ends of a leg; in the middle of a leg twice as long. Shorter pieces give the
        /// curve more freedom and the solver more unknowns.
        pub length: f64 = 1.5, "m", 0.1..=20.0;
        /// How far a polygon may reach beyond its piece.
        pub reach: f64 = 1.0, "m", 0.1..=20.0;
        /// Wanted distance to obstacles beyond the robot's own shape; at most half of the room that the path has is kept, the rest is
        /// left to the curve.
        pub clearance: f64 = 0.3, "m", 0.0..=5.0;
    }
}

zenav_protocol::settings! {
    /// Where the robot stops and turns on the spot instead of following a curve.
    #[derive(Copy)]
    pub struct StopSettings {
        /// Sharper corners are turned on the spot (2.0: 115 degrees; a curve around such a corner swings out wide).
        pub sharp_corner: f64 = 2.0, "rad", 0.1..=3.15;
        /// A robot at rest whose heading differs from the path's by less than this starts without a turn on the spot.
        pub aligned: f64 = 0.3, "rad", 0.0..=1.5;
        /// A moving robot continues along its arc if the path lies ahead to within this; otherwise it stops first.
        pub ahead: f64 = 1.2, "rad", 0.0..=1.5;
        /// Sharpest arc on which a moving robot continues.
        pub sharpest_arc: f64 = 3.0, "1/m", 0.0..=100.0;
        /// A goal heading that differs from the path's by less than this is reached by the curve, otherwise by a turn on the spot.
        pub arriving: f64 = 0.8, "rad", 0.0..=1.5;
    }
}
