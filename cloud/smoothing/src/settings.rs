//! Settings. Which numbers of smoothing can be tuned?
//!
//! The section `[smoothing]` of a deployment file. Tolerances of solvers and bounds on memory are private constants beside their use.

zenav_protocol::settings! {
    /// How a path becomes a trajectory.
    #[derive(Copy)]
    pub struct SmoothingSettings {
        /// Length over which the robot likes to turn: weighs curvature against length.
        pub turning_length: f64 = 0.25, "m", 0.01..=10.0;
        /// Distance between samples of the curve; the curvature is linear between them.
        pub step: f64 = 0.02, "m", 0.002..=0.5;
        /// Iterations of the geometry solver for each quadratic programme, at most.
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
        /// Longest piece of the path in one polygon at the ends of a leg; in the middle of a leg twice as long. Shorter ones give the
        /// curve more freedom and the solver more unknowns.
        pub length: f64 = 1.5, "m", 0.1..=20.0;
        /// How far a polygon may reach beyond its piece.
        pub reach: f64 = 1.0, "m", 0.1..=20.0;
        /// Distance to obstacles beyond the robot's own shape, where the path has it; half of what is there is left to the curve.
        pub clearance: f64 = 0.3, "m", 0.0..=5.0;
    }
}

zenav_protocol::settings! {
    /// Where the robot stops and turns on the spot instead of following a curve.
    #[derive(Copy)]
    pub struct StopSettings {
        /// Sharper corners are turned on the spot (2.0: 115 degrees; a curve around one swings out wide).
        pub sharp_corner: f64 = 2.0, "rad", 0.1..=3.15;
        /// A robot at rest whose heading differs by less from the path begins without turning on the spot.
        pub aligned: f64 = 0.3, "rad", 0.0..=1.5;
        /// A moving robot goes on along its arc where the path lies ahead to within this, else it stops first.
        pub ahead: f64 = 1.2, "rad", 0.0..=1.5;
        /// Sharpest arc that a moving robot goes on along.
        pub sharpest_arc: f64 = 3.0, "1/m", 0.0..=100.0;
        /// A heading wanted at the end that differs by less from the path's is arrived with, else turned to on the spot.
        pub arriving: f64 = 0.8, "rad", 0.0..=1.5;
    }
}
