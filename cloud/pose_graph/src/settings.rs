//! Settings. Which numbers of the pose graph can be tuned?
//!
//! Tolerances of linear algebra are private constants beside their use.

zenav_protocol::settings! {
    /// How the cost is brought down.
    #[derive(Copy)]
    pub struct DescentSettings {
        /// Steps, at most.
        pub max_iterations: u32 = 60, "", 1..=10_000;
        /// The descent ends where the next step would lower the cost by less than this share of it.
        pub tolerance: f64 = 1e-10, "", 1e-15..=0.1;
    }
}

zenav_protocol::settings! {
    /// How false loop closures are told from true ones.
    #[derive(Copy)]
    pub struct RobustSettings {
        /// A closure that fits worse than this is false, and so is one that disagrees with its neighbours by more (30: one true closure in
        /// 700,000 fits worse, by chi squared with three degrees of freedom).
        pub max_chi_squared: f64 = 30.0, "", 1.0..=1000.0;
        /// How much less convex each round is than the one before; smaller is slower and surer.
        pub step: f64 = 1.6, "", 1.01..=10.0;
        /// Rounds, at most.
        pub max_rounds: u32 = 80, "", 1..=1000;
        /// Nodes apart, at most, of the ends of two closures that are held against each other.
        pub window: u32 = 10, "", 0..=1000;
        /// Closures that do not fit of which the covariance is asked, smallest gap first, each time the others are settled.
        pub reconsidered: u32 = 50, "", 0..=100_000;
    }
}
