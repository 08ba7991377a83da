//! Settings. The tunable numbers of scan matching.
//!
//! Numerical tolerances are private constants beside their use.

zenav_protocol::settings! {
    /// Which points of a scan count.
    #[derive(Copy)]
    pub struct ScanSettings {
        /// Beams longer than this are left out: their ends are far apart, and a small turn moves them far.
        pub max_range: f64 = 25.0, "m", 1.0..=200.0;
        /// Neighbouring returns within this distance are averaged into one point: a wall beside the robot has a hundred.
        pub spacing: f64 = 0.03, "m", 0.0..=1.0;
        /// Duration of a log's sweeps: points are moved to where they were at the stamp, the end of the sweep. 0: all at once, as a robot's
        /// scans are.
        pub sweep: f64 = 0.0, "s", 0.0..=1.0;
    }
}

zenav_protocol::settings! {
    /// Uncertainty of odometry: standard deviations of a step.
    #[derive(Copy)]
    pub struct OdometrySettings {
        /// Of the position, for each metre.
        pub per_metre: f64 = 0.1, "m/m", 0.0001..=1.0;
        /// Of the heading, for each radian turned.
        pub per_radian: f64 = 0.1, "rad/rad", 0.0001..=1.0;
        /// Of the heading, for each metre.
        pub turn_per_metre: f64 = 0.05, "rad/m", 0.0001..=1.0;
        /// Of the position, for each radian turned.
        pub slip_per_radian: f64 = 0.03, "m/rad", 0.0001..=1.0;
        /// Lower bound for the position.
        pub least: f64 = 0.005, "m", 0.0001..=1.0;
        /// Lower bound for the heading.
        pub least_turn: f64 = 0.003, "rad", 0.0001..=1.0;
    }
}

zenav_protocol::settings! {
    /// How close to a known surface a point has to lie.
    #[derive(Copy)]
    pub struct FieldSettings {
        /// Side of a cell.
        pub resolution: f64 = 0.05, "m", 0.005..=1.0;
        /// Standard deviation of a point around its surface: the likelihood falls off with it.
        pub sigma: f64 = 0.08, "m", 0.005..=2.0;
    }
}

zenav_protocol::settings! {
    /// How a pose is refined beyond cells.
    #[derive(Copy)]
    pub struct RefineSettings {
        /// Most Gauss-Newton steps.
        pub max_iterations: u32 = 12, "", 1..=1000;
        /// The refinement ends with a step shorter than this (turns count 1 m per radian).
        pub tolerance: f64 = 1e-4, "m", 1e-9..=0.1;
        /// Standard deviation of one point's distance to its surface in a likelihood field: scales the information.
        pub point_sigma: f64 = 0.03, "m", 0.001..=1.0;
        /// The same where the surfaces are surfels; in SLAM the other points count with it, too.
        pub surfel_sigma: f64 = 0.0125, "m", 0.001..=1.0;
        /// Neighbouring points share their errors: this many carry as much information as one independent point.
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
        /// A beam goes through a wall if the likelihood along it is at least this.
        pub wall: f64 = 0.9, "", 0.0..=1.0;
        /// The last stretch of a beam, in which a wall is the beam's own end.
        pub own_end: f64 = 0.4, "m", 0.0..=5.0;
    }
}
