//! Settings. The tunable numbers of localisation.

use zenav_scan_matching::{OdometrySettings, RefineSettings, ScanSettings};

zenav_protocol::settings! {
    /// How a robot is found in a known map.
    ///
    /// ```
    /// use zenav_localisation::LocalisationSettings;
    /// use zenav_protocol::settings::Settings;
    ///
    /// let settings = LocalisationSettings::default().with_number("tracking.sigma", 0.05).unwrap()?;
    /// assert_eq!((settings.tracking.sigma, settings.tracking.reach), (0.05, 0.4));
    /// let refused = settings.with_number("tracking.sigma", 0.0).unwrap().unwrap_err();
    /// assert_eq!(refused.to_string(), "`tracking.sigma` is 0: expected 0.005 to 2 m");
    /// # Ok::<(), zenav_protocol::config_text::OutOfBounds>(())
    /// ```
    #[derive(Copy)]
    pub struct LocalisationSettings {
        /// Which points of a scan count.
        pub scan: ScanSettings;
        /// Uncertainty of odometry.
        pub odometry: OdometrySettings;
        /// Tracking of the robot.
        pub tracking: TrackingSettings;
        /// When a scan agrees with the map.
        pub evidence: EvidenceSettings;
        /// Finding the robot without a guess.
        pub global: GlobalSettings;
        /// Refinement beyond cells.
        pub refine: RefineSettings;
    }
}

zenav_protocol::settings! {
    /// Tracking of the robot.
    ///
    /// ```
    /// use zenav_localisation::{LocalisationSettings, TrackingSettings};
    /// use zenav_protocol::settings::Settings;
    ///
    /// let tracking = TrackingSettings { reach: 6.0, ..TrackingSettings::default() };
    /// let settings = LocalisationSettings { tracking, ..LocalisationSettings::default() };
    /// assert_eq!(settings.check().unwrap_err().to_string(), "`tracking.reach` is 6: expected 0 to 5 m");
    /// ```
    #[derive(Copy)]
    pub struct TrackingSettings {
        /// Standard deviation of a point around its wall: the likelihood falls off with it.
        pub sigma: f64 = 0.08, "m", 0.005..=2.0;
        /// Distance driven after which a scan is matched.
        pub distance: f64 = 0.02, "m", 0.0..=5.0;
        /// Turn after which a scan is matched.
        pub turn: f64 = 0.01, "rad", 0.0..=3.0;
        /// A match of which a smaller share agrees with the map is doubtful: a window around the expected pose is searched.
        pub doubtful: f64 = 0.6, "", 0.0..=1.0;
        /// Half width of that search window.
        pub reach: f64 = 0.4, "m", 0.0..=5.0;
        /// Half width of that search window.
        pub search_turn: f64 = 0.3, "rad", 0.0..=3.15;
        /// Blocks that this search may score.
        pub budget: u32 = 60_000, "", 100..=100_000_000;
        /// Least standard deviation of a match: the map is not exact.
        pub floor: f64 = 0.01, "m", 0.0001..=1.0;
        /// Least standard deviation of a match's heading.
        pub floor_turn: f64 = 0.003, "rad", 0.0001..=1.0;
        /// If a larger share of a scan goes through walls, the whole map is searched for a place that explains it better: people and added
        /// objects do not cause this, a wrong place does.
        pub through_walls: f64 = 0.1, "", 0.0..=1.0;
        /// By how much larger a share of the scan must agree with the map at the other place.
        pub elsewhere: f64 = 0.15, "", 0.0..=1.0;
        /// Scans in a row that contradict the map before the robot is lost.
        pub patience: u32 = 4, "", 1..=1000;
    }
}

zenav_protocol::settings! {
    /// When a scan agrees with the map.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_localisation::{EvidenceSettings, KnownMap, evidence};
    /// # use zenav_protocol::{geometry::Pose2, grid::{Cell, GridSpec, Occupancy, OccupancyGrid}};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 40, height: 3 };
    /// # let mut map = OccupancyGrid::filled(spec, Occupancy::FREE);
    /// # (0..3).for_each(|y| map[Cell::new(39, y)] = Occupancy::OCCUPIED);
    /// // A wall at x = 1.95, and a beam along the x axis that ends 2 cm in front of it.
    /// let known = KnownMap::new(&map, 0.08);
    /// let agreeing = |settings| evidence(&known, Point2::new(0.5, 0.07), &[Point2::new(1.93, 0.07)], Pose2::IDENTITY, &settings).agreeing;
    /// assert_eq!(agreeing(EvidenceSettings::default()), 1.0);
    /// assert_eq!(agreeing(EvidenceSettings { explained: 0.9, ..EvidenceSettings::default() }), 0.0);
    /// ```
    #[derive(Copy)]
    pub struct EvidenceSettings {
        /// A point agrees where the likelihood of a wall is at least this.
        pub explained: f64 = 0.5, "", 0.0..=1.0;
        /// A beam goes through a wall if the likelihood along it is at least this.
        pub wall: f64 = 0.9, "", 0.0..=1.0;
        /// The last stretch of a beam, in which a wall is the beam's own end.
        pub own_end: f64 = 0.3, "m", 0.0..=5.0;
        /// With a smaller share of agreeing points the scan contradicts the map.
        pub lost_below: f64 = 0.4, "", 0.0..=1.0;
        /// With fewer points in known cells the scan is no evidence.
        pub least_points: u32 = 20, "", 1..=10_000;
    }
}

zenav_protocol::settings! {
    /// Finding the robot without a guess.
    ///
    /// ```
    /// use zenav_localisation::GlobalSettings;
    /// use zenav_protocol::settings::Settings;
    ///
    /// // A place is taken if three quarters of the scan agree with the map there, and fewer by a margin anywhere else.
    /// let global = GlobalSettings::default();
    /// assert_eq!((global.agrees, global.margin), (0.75, 0.15));
    /// let never = GlobalSettings { agrees: 1.5, ..global }.check().unwrap_err();
    /// assert_eq!(never.to_string(), "`agrees` is 1.5: expected 0 to 1");
    /// ```
    #[derive(Copy)]
    pub struct GlobalSettings {
        /// Least score of the best place.
        pub min_score: f64 = 0.45, "", 0.0..=1.0;
        /// Places that score at least this are searched for first: with a higher bound the search is much shorter.
        pub good_score: f64 = 0.8, "", 0.0..=1.0;
        /// The step of the headings moves points this far out by one cell.
        pub lever: f64 = 4.0, "m", 0.5..=1000.0;
        /// Places that score this much less than the best one are ignored.
        pub within: f64 = 0.1, "", 0.0..=1.0;
        /// Most places examined closely, best first.
        pub places: u32 = 200, "", 1..=1000;
        /// Places closer than this are one.
        pub apart: f64 = 0.5, "m", 0.01..=100.0;
        /// Headings closer than this are one.
        pub apart_turn: f64 = 0.3, "rad", 0.001..=3.15;
        /// Most points used by the search.
        pub points: u32 = 60, "", 10..=10_000;
        /// Blocks that the search may score.
        pub budget: u32 = 60_000_000, "", 1000..=1_000_000_000;
        /// The best place is accepted if at least this share of its points agrees with the map, ...
        pub agrees: f64 = 0.75, "", 0.0..=1.0;
        /// ... and every other place agrees less by at least this margin.
        pub margin: f64 = 0.15, "", 0.0..=1.0;
    }
}
