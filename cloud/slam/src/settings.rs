//! Settings. Which numbers of SLAM can be tuned?

use zenav_pose_graph::{DescentSettings, RobustSettings};
use zenav_scan_matching::{FieldSettings, OdometrySettings, RefineSettings, ScanSettings, VerdictSettings};

zenav_protocol::settings! {
    /// How scans and odometry become a map.
    #[derive(Copy)]
    pub struct SlamSettings {
        /// Which points of a scan count.
        pub scan: ScanSettings;
        /// How well odometry is known.
        pub odometry: OdometrySettings;
        /// How a scan is matched to the map around it.
        pub front: FrontSettings;
        /// How places are recognised.
        pub closure: ClosureSettings;
        /// How all scans are matched anew once the log has ended.
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
        /// A scan is inserted after so much way.
        pub distance: f64 = 0.1, "m", 0.01..=5.0;
        /// A scan is inserted after so much turning.
        pub turn: f64 = 0.05, "rad", 0.005..=3.0;
        /// Scans in a submap; the next one begins at half of them.
        pub submap_scans: u32 = 40, "", 4..=1000;
        /// A match that scores less, or less than this share of the usual, is doubtful: it is searched for in a wide window.
        pub doubtful: f64 = 0.8, "", 0.0..=1.0;
        /// Window of that search, to each side.
        pub reach: f64 = 0.4, "m", 0.0..=5.0;
        /// Window of that search, to each side.
        pub search_turn: f64 = 0.4, "rad", 0.0..=3.15;
        /// A match that scores less does not count: odometry alone does.
        pub min_score: f64 = 0.35, "", 0.0..=1.0;
        /// Standard deviation that a match has at least: the map is not exact.
        pub floor: f64 = 0.01, "m", 0.0001..=1.0;
        /// Standard deviation of the heading that a match has at least.
        pub floor_turn: f64 = 0.003, "rad", 0.0001..=1.0;
    }
}

zenav_protocol::settings! {
    /// How places are recognised.
    #[derive(Copy)]
    pub struct ClosureSettings {
        /// Of so many inserted scans one is searched for in older submaps.
        pub every: u32 = 6, "", 1..=1000;
        /// Submaps that are searched for a scan, at most, nearest first.
        pub submaps: u32 = 1, "", 1..=100;
        /// Inserted scans between a submap and a scan, at least.
        pub gap: u32 = 80, "", 1..=100_000;
        /// Submaps whose middle is farther away than this, beyond the window, are not searched. A window so wide is a usual one; one that is
        /// larger by a factor is searched that much more rarely, and none is wider than ten of these.
        pub near: f64 = 5.0, "m", 0.1..=100.0;
        /// Window, to each side, beyond three standard deviations of the position; a match farther off needs a second one that confirms it.
        pub reach: f64 = 0.6, "m", 0.0..=50.0;
        /// Window of headings, to each side, at least.
        pub turn: f64 = 0.35, "rad", 0.0..=3.15;
        /// A closure scores at least this.
        pub min_score: f64 = 0.6, "", 0.0..=1.0;
        /// Share of points that are explained, at least.
        pub explained: f64 = 0.65, "", 0.0..=1.0;
        /// Share of beams through walls, at most.
        pub through_walls: f64 = 0.15, "", 0.0..=1.0;
        /// Blocks that the search of a usual window may score; that of a larger one may score as many more as it is rarer.
        pub budget: u32 = 60_000, "", 100..=100_000_000;
    }
}

zenav_protocol::settings! {
    /// How all scans are matched anew once the log has ended.
    #[derive(Copy)]
    pub struct FinishSettings {
        /// Rounds of matching and solving.
        pub rounds: u32 = 1, "", 0..=100;
        /// Submaps that a scan is matched to in a round, at most, nearest first.
        pub submaps: u32 = 4, "", 1..=100;
        /// A scan is matched to submaps whose middle is nearer than this.
        pub near: f64 = 4.0, "m", 0.1..=100.0;
        /// A match that moves a scan by more than this is another place.
        pub max_move: f64 = 0.3, "m", 0.001..=5.0;
    }
}
