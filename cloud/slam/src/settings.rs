//! Settings. The tunable numbers of SLAM.

use zenav_pose_graph::{DescentSettings, RobustSettings};
use zenav_scan_matching::{FieldSettings, OdometrySettings, RefineSettings, ScanSettings, VerdictSettings};

zenav_protocol::settings! {
    /// How scans and odometry become a map.
    ///
    /// ```
    /// use zenav_protocol::settings::Settings;
    /// use zenav_slam::SlamSettings;
    ///
    /// let settings = SlamSettings::default().with_number("front.submap_scans", 60.0).unwrap()?;
    /// assert_eq!((settings.front.submap_scans, settings.front.distance), (60, 0.1));
    /// let refused = settings.with_number("front.distance", 0.0).unwrap().unwrap_err();
    /// assert_eq!(refused.to_string(), "`front.distance` is 0: expected 0.01 to 5 m");
    /// # Ok::<(), zenav_protocol::config_text::OutOfBounds>(())
    /// ```
    #[derive(Copy)]
    pub struct SlamSettings {
        /// Which points of a scan count.
        pub scan: ScanSettings;
        /// Uncertainty of odometry.
        pub odometry: OdometrySettings;
        /// How a scan is matched to the map around it.
        pub front: FrontSettings;
        /// How places are recognised.
        pub closure: ClosureSettings;
        /// How all scans are matched again once the log has ended.
        pub finish: FinishSettings;
        /// Likelihood fields of submaps.
        pub field: FieldSettings;
        /// Refinement beyond cells.
        pub refine: RefineSettings;
        /// When a scan fits.
        pub verdict: VerdictSettings;
        /// Descent of the graph.
        pub descent: DescentSettings;
        /// False closures.
        pub robust: RobustSettings;
    }
}

zenav_protocol::settings! {
    /// How a scan is matched to the map around it.
    #[derive(Copy)]
    pub struct FrontSettings {
        /// Distance driven after which a scan is inserted, as a node of the graph.
        pub distance: f64 = 0.1, "m", 0.01..=5.0;
        /// Turn after which a scan is inserted.
        pub turn: f64 = 0.05, "rad", 0.005..=3.0;
        /// Nodes (inserted scans) in a submap; the next submap begins at half of them.
        pub submap_scans: u32 = 40, "", 4..=1000;
        /// A match that scores less than this, or than this share of the usual score, is doubtful: a wide window is searched.
        pub doubtful: f64 = 0.8, "", 0.0..=1.0;
        /// Half width of that search window.
        pub reach: f64 = 0.4, "m", 0.0..=5.0;
        /// Half width of that search window.
        pub search_turn: f64 = 0.4, "rad", 0.0..=3.15;
        /// A match that scores less is ignored: odometry alone counts.
        pub min_score: f64 = 0.35, "", 0.0..=1.0;
        /// Least standard deviation of a match: the map is not exact.
        pub floor: f64 = 0.01, "m", 0.0001..=1.0;
        /// Least standard deviation of a match's heading.
        pub floor_turn: f64 = 0.003, "rad", 0.0001..=1.0;
    }
}

zenav_protocol::settings! {
    /// How places are recognised.
    #[derive(Copy)]
    pub struct ClosureSettings {
        /// One node (inserted scan) in this many is searched for in older submaps.
        pub every: u32 = 6, "", 1..=1000;
        /// Most submaps searched for a node, nearest first.
        pub submaps: u32 = 1, "", 1..=100;
        /// Least number of nodes (inserted scans) between a submap and the node that is searched for in it.
        pub gap: u32 = 80, "", 1..=100_000;
        /// Submaps whose middle is farther away than this plus the window are not searched. A window this wide is a usual one; a larger one
        /// is searched more rarely by its size factor, and none is wider than ten of these.
        pub near: f64 = 5.0, "m", 0.1..=100.0;
        /// Half width of the window beyond three standard deviations of the position; a match farther off needs a second one that confirms
        /// it.
        pub reach: f64 = 0.6, "m", 0.0..=50.0;
        /// Least half width of the window of headings.
        pub turn: f64 = 0.35, "rad", 0.0..=3.15;
        /// Least score of a closure.
        pub min_score: f64 = 0.6, "", 0.0..=1.0;
        /// Least share of explained points.
        pub explained: f64 = 0.65, "", 0.0..=1.0;
        /// Largest share of beams through walls.
        pub through_walls: f64 = 0.15, "", 0.0..=1.0;
        /// Blocks that the search of a usual window may score; for a larger window, times its size factor.
        pub budget: u32 = 60_000, "", 100..=100_000_000;
    }
}

zenav_protocol::settings! {
    /// How all scans are matched again once the log has ended.
    #[derive(Copy)]
    pub struct FinishSettings {
        /// Rounds of matching and solving.
        pub rounds: u32 = 1, "", 0..=100;
        /// Most submaps that a node is matched to in a round, nearest first.
        pub submaps: u32 = 4, "", 1..=100;
        /// A node is matched to submaps whose middle is nearer than this.
        pub near: f64 = 4.0, "m", 0.1..=100.0;
        /// A match that moves a node by more than this is a different place.
        pub max_move: f64 = 0.3, "m", 0.001..=5.0;
    }
}
