//! Settings. Which numbers of scan matching can be tuned?
//!
//! Tolerances of arithmetic are private constants beside their use.

zenav_protocol::settings! {
    /// How near to what is known a point has to lie.
    #[derive(Copy)]
    pub struct FieldSettings {
        /// Side of a cell.
        pub resolution: f64 = 0.05, "m", 0.005..=1.0;
        /// Standard deviation of a point about the surface that it belongs to: the likelihood falls off with it.
        pub sigma: f64 = 0.08, "m", 0.005..=2.0;
    }
}

zenav_protocol::settings! {
    /// How a pose is refined beyond cells.
    #[derive(Copy)]
    pub struct RefineSettings {
        /// Steps of Gauss and Newton, at most.
        pub max_iterations: u32 = 12, "", 1..=1000;
        /// The refinement ends with a step shorter than this (turns count 1 m a radian).
        pub tolerance: f64 = 1e-4, "m", 1e-9..=0.1;
        /// Standard deviation of one point's distance to its surface: scales the information.
        pub point_sigma: f64 = 0.03, "m", 0.001..=1.0;
        /// Neighbouring points share their errors: so many points tell as much as one that is independent.
        pub points_per_independent: f64 = 5.0, "", 1.0..=1000.0;
        /// A direction in which the scan alone knows the position worse than this is degenerate.
        pub degenerate_sigma: f64 = 0.05, "m", 0.001..=10.0;
    }
}

zenav_protocol::settings! {
    /// When a scan fits.
    #[derive(Copy)]
    pub struct VerdictSettings {
        /// A point is explained where the likelihood is at least this (0.6: one standard deviation from a surface).
        pub explained: f64 = 0.6, "", 0.0..=1.0;
        /// A beam goes through a wall where the likelihood on its way is at least this.
        pub wall: f64 = 0.9, "", 0.0..=1.0;
        /// The last stretch of a beam in which a wall is its own end.
        pub own_end: f64 = 0.4, "m", 0.0..=5.0;
    }
}
