//! Settings. The tunable numbers of the pose graph.
//!
//! Tolerances of linear algebra are private constants beside their use.

zenav_protocol::settings! {
    /// How the cost is minimised.
    #[derive(Copy)]
    pub struct DescentSettings {
        /// Most steps.
        pub max_iterations: u32 = 60, "", 1..=10_000;
        /// The descent ends when the next step would lower the cost by less than this share of it.
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
        /// Factor by which each round is less convex than the one before; smaller is slower and more reliable.
        pub step: f64 = 1.6, "", 1.01..=10.0;
        /// Most rounds.
        pub max_rounds: u32 = 80, "", 1..=1000;
        /// Largest distance, in nodes, between the ends of two closures that are compared with each other.
        pub window: u32 = 10, "", 0..=1000;
        /// Most rejected closures that are searched for ones that agree with each other, best fit first, each time the others are settled.
        pub reconsidered: u32 = 50, "", 0..=1000;
    }
}
