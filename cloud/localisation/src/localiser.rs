//! Localiser. Tracks the robot's pose in a known map, and judges whether it is right.

use nalgebra::{Matrix3, Point2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{Health, Scan};
use zenav_protocol::time::Stamp;
use zenav_scan_matching::{
    ExpectedStep, OdometryFilter, Prior, Refined, Window, floored, points, refine, search, turned,
};

use crate::evidence::{Evidence, evidence};
use crate::faces::Faces;
use crate::global::{Found, Hypothesis, find, find_in_view, is_one_place};
use crate::known_map::KnownMap;
use crate::settings::LocalisationSettings;
use crate::track_record::{Fit, TrackRecord};
use crate::view::{View, is_apart};

/// Most points used by a search around the expected pose.
const SEARCH_POINTS: usize = 120;
/// Variance of a pose given by an operator, m² and rad².
const GUESSED: [f64; 3] = [0.25, 0.25, 0.1];
/// Odometry is compared with matches after this much travel, m, and turning, rad: closer matches share their errors.
const APART: (f64, f64) = (0.1, 0.05);
/// A place less likely by odometry than this (chi squared, three degrees of freedom) is a jump.
const JUMP: f64 = 16.0;
/// The search around the expected pose is widened by this many standard deviations, and by no more than this, m.
const WIDER: (f64, f64) = (3.0, 3.0);
/// Most places returned by such a search.
const RIVALS: usize = 8;
/// A place with which at least this share of what is seen agrees is taken at once; in a crowd and among moved furniture, another search
/// has to confirm it.
const SURE: f64 = 0.9;
/// If the robot does not move, a later search confirms a place only after this time, s: an earlier one would use the same view.
const LATER: f64 = 2.0;
/// Interval between two global searches, s.
const SEARCH_PERIOD: f64 = 0.5;
/// Pause until the whole map is searched again while the scans contradict the place; it doubles from the first to the second value, s.
const DOUBT: (f64, f64) = (0.5, 30.0);

/// Result of a scan.
///
/// ```
#[doc = include_str!("doc_setup/room.txt")]
/// # use zenav_localisation::{LocalisationSettings, Localiser};
/// let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
/// let located = localiser.step(&look(0.1, Pose2::IDENTITY)).unwrap();
/// let deviation = located.covariance.unwrap().diagonal().map(f64::sqrt);
/// // Never better than `tracking.floor`, 0.01 m: the map is not exact.
/// assert!((0.01..0.05).contains(&deviation.x) && deviation.z < 0.05, "{deviation}");
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// The best estimate of `map_from_base` at the scan's stamp.
    pub pose: Pose2,
    /// Uncertainty of the pose by the scan: covariance of x, y (m²) and yaw (rad²) along the map's axes. `None` if the scan was not
    /// matched.
    pub covariance: Option<Matrix3<f64>>,
    /// Whether the pose can be trusted.
    pub health: Health,
    /// Evidence of the scan on the pose.
    pub evidence: Evidence,
    /// Whether the pose was just found by a search of the whole map, or farther off than the usual window: the robot then adopts it instead
    /// of its own.
    pub is_found_anew: bool,
}

/// Tracks a robot in a known map.
#[derive(Clone, Debug)]
pub struct Localiser {
    settings: LocalisationSettings,
    map: KnownMap,
    last: Option<Last>,
    /// Pose given by an operator before the first scan.
    told: Option<Pose2>,
    health: Health,
    /// Learned quality of odometry.
    odometry: OdometryFilter,
    /// Scans in a row that contradict the map.
    contradictions: u32,
    searched_at: Option<Stamp>,
    /// Pause before the next search in doubt, s.
    doubt: f64,
    evidence: Evidence,
    /// The scans of a lost robot.
    view: View,
    /// A place that another search has to confirm; all searches since have found it, too.
    hoped: Option<Hope>,
    faces: Faces,
    record: TrackRecord,
}

/// The last scan.
#[derive(Clone, Copy, Debug)]
struct Last {
    stamp: Stamp,
    odom_from_base: Pose2,
    pose: Pose2,
    /// Odometry at the last matched scan, if there was one since the pose was set.
    matched: Option<Pose2>,
    /// Odometry and pose at the last match that odometry was compared with, or where the pose was set.
    held: (Pose2, Pose2),
}

/// A place that a search found.
#[derive(Clone, Copy, Debug)]
struct Hope {
    stamp: Stamp,
    /// The pose by dead reckoning there.
    reckoned: Pose2,
    place: Pose2,
}

/// A matched scan.
struct Match {
    refined: Refined,
    /// Whether it took a search around the expected pose.
    is_wide: bool,
    /// Whether it is off the prediction of odometry, or has a rival within it.
    is_jump: bool,
}

/// The prediction of odometry: from the last pose, and corrected by what was learned.
struct Expected {
    start: Pose2,
    pose: Pose2,
    step: ExpectedStep,
}

impl Localiser {
    /// A robot somewhere in a map.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// use zenav_localisation::{LocalisationSettings, Localiser};
    ///
    /// let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    /// let truth = Pose2::new(0.2, 0.1, 0.3);
    /// // The guess for the first scan is 0.1 m off.
    /// let guess = Pose2::new(0.3, 0.1, 0.3);
    /// let located = localiser.step(&Scan { map_from_odom: guess, ..look(0.1, truth) }).unwrap();
    /// assert!(located.pose.distance(&truth) < 0.05 && located.health.is_trusted(), "{located:?}");
    /// ```
    #[must_use]
    pub fn new(settings: LocalisationSettings, map: &OccupancyGrid) -> Self {
        Self {
            map: KnownMap::new(map, settings.tracking.sigma),
            settings,
            last: None,
            told: None,
            health: Health::Tracking,
            odometry: OdometryFilter::UNSEEN,
            contradictions: 0,
            searched_at: None,
            doubt: DOUBT.0,
            evidence: Evidence::default(),
            view: View::default(),
            hoped: None,
            faces: Faces::default(),
            record: TrackRecord::default(),
        }
    }

    /// Takes in a scan. Its `odom_from_base` is the odometry at its stamp; its `map_from_odom` is the initial guess for the first scan, and
    /// ignored later. `None` for a scan that is malformed or older than the last.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// # use zenav_localisation::{LocalisationSettings, Localiser};
    /// let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    /// for i in 1..=10 {
    ///     // Odometry says 5.5 cm for each step of 5 cm.
    ///     let (truth, odometry) = (Pose2::new(0.05 * f64::from(i), 0.0, 0.0), Pose2::new(0.055 * f64::from(i), 0.0, 0.0));
    ///     let located = localiser.step(&Scan { odom_from_base: odometry, ..look(0.1 * f64::from(i), truth) }).unwrap();
    ///     assert!(located.pose.distance(&truth) < 0.05, "{located:?}");
    /// }
    /// assert!(localiser.step(&look(0.5, Pose2::IDENTITY)).is_none(), "older than the last scan");
    /// ```
    pub fn step(&mut self, scan: &Scan) -> Option<Located> {
        let odometry = scan.odom_from_base;
        if !scan.is_sane() || !odometry.is_finite() {
            return None;
        }
        let last = match self.last {
            Some(last) if scan.stamp <= last.stamp => return None,
            Some(last) => last,
            None => {
                let pose = self.told.take().unwrap_or(scan.map_from_odom * odometry);
                self.begin(scan.stamp, odometry, pose)
            }
        };
        let step = last.odom_from_base.inverse() * odometry;
        let elapsed = scan.stamp.secs_since(last.stamp);
        let seen = points(scan, step, elapsed, &self.settings.scan);
        let laser = scan.base_from_laser.position();
        let seen = self.faces.in_map(laser, seen);
        let start = last.pose * self.odometry.corrected(step);
        let mut now = Last {
            stamp: scan.stamp,
            odom_from_base: odometry,
            pose: start,
            ..last
        };
        if !self.health.is_trusted() {
            return Some(self.search(now, laser, &seen));
        }
        let tracking = &self.settings.tracking;
        let is_within = |from: Pose2, (way, turn): (f64, f64)| {
            let since = from.inverse() * odometry;
            since.x.hypot(since.y) < way && since.yaw.abs() < turn
        };
        let is_near = now
            .matched
            .is_some_and(|matched| is_within(matched, (tracking.distance, tracking.turn)));
        // A robot at rest may be carried away, too: contradictions with the map are examined however little it has moved.
        let is_near = is_near && !self.is_doubtful(laser, &seen, start);
        let (mut covariance, mut is_found_anew) = (None, false);
        if !is_near {
            let (held, held_pose) = last.held;
            let since = held.inverse() * odometry;
            let expected = Expected {
                start,
                pose: held_pose * self.odometry.corrected(since),
                step: self.odometry.expected(since, &self.settings.odometry),
            };
            let Match {
                refined,
                is_wide,
                is_jump,
            } = self.matched(&expected, laser, &seen);
            let scan_information = floored(&refined.information, tracking.floor, tracking.floor_turn);
            now.pose = refined.pose;
            now.matched = Some(odometry);
            covariance = scan_information
                .try_inverse()
                .map(|covariance| turned(&covariance, refined.pose.yaw));
            self.evidence = evidence(&self.map, laser, &seen, refined.pose, &self.settings.evidence);
            self.record.take(odometry, &seen, self.fit(&refined));
            self.note(&refined);
            if refined.degenerate.is_none() && self.evidence.agreeing >= self.settings.global.agrees {
                self.faces.learn(self.map.field(), laser, &seen, refined.pose);
            }
            let contradicts = self.says_much() && self.evidence.agreeing < self.settings.tracking.doubtful;
            if contradicts && self.record.vouches() {
                // Odometry tells more than such a match.
                covariance = None;
            }
            if is_jump {
                self.odometry.begin_anew(&scan_information);
            } else if is_wide || !is_within(held, APART) && !contradicts {
                let off = expected.pose.inverse() * refined.pose;
                let tells_all = refined.degenerate.is_none();
                self.odometry.learn(&expected.step, off, &scan_information, tells_all);
            } else if !is_within(held, APART) {
                self.odometry.go_on(&expected.step);
            }
            if is_wide || !is_within(held, APART) {
                now.held = (odometry, refined.pose);
            }
            // The robot would reject a place so far off as an outlier.
            is_found_anew = is_wide && refined.pose.distance(&start) > self.settings.tracking.reach;
            if self.is_elsewhere(&now, laser, &seen, is_jump) {
                // The robot brakes and drops its plan; the next scan is searched for.
                self.health = Health::Lost;
                self.searched_at = None;
            }
            if !self.health.is_trusted() {
                if self.is_search_due(now.stamp) {
                    self.health = Health::Searching;
                }
                covariance = None;
                is_found_anew = false;
            }
        }
        self.last = Some(now);
        Some(Located {
            pose: now.pose,
            covariance,
            health: self.health.clone(),
            evidence: self.evidence,
            is_found_anew,
        })
    }

    /// Starts at a given pose, with the odometry there.
    fn begin(&mut self, stamp: Stamp, odom_from_base: Pose2, pose: Pose2) -> Last {
        self.record.clear();
        self.odometry
            .begin_anew(&Matrix3::from_diagonal(&GUESSED.map(f64::recip).into()));
        Last {
            stamp,
            odom_from_base,
            pose,
            matched: None,
            held: (odom_from_base, pose),
        }
    }

    /// Whether less of a scan agrees with the map than it should.
    fn is_doubtful(&self, laser: Point2<f64>, seen: &[Point2<f64>], pose: Pose2) -> bool {
        let settings = &self.settings;
        let here = evidence(&self.map, laser, seen, pose, &settings.evidence);
        here.points >= settings.evidence.least_points as usize && here.agreeing < settings.tracking.doubtful
    }

    /// Matches the scan around the expected pose.
    fn matched(&self, expected: &Expected, laser: Point2<f64>, seen: &[Point2<f64>]) -> Match {
        let settings = &self.settings;
        let prior = Prior::of_odometry(expected.pose, &expected.step.information());
        let field = self.map.field();
        let near = refine(field, seen, expected.start, Some(&prior), &settings.refine);
        let near = Match {
            refined: near.expected_where_degenerate(expected.pose),
            is_wide: false,
            is_jump: false,
        };
        let weigh = |refined: &Refined| evidence(&self.map, laser, seen, refined.pose, &settings.evidence);
        let here = weigh(&near.refined);
        if here.agreeing >= settings.tracking.doubtful || here.points < settings.evidence.least_points as usize {
            return near;
        }
        let stride = seen.len().div_ceil(SEARCH_POINTS).max(1);
        let thinned: Vec<Point2<f64>> = seen.iter().copied().step_by(stride).collect();
        let look = |reach: f64| {
            let window = Window {
                count: RIVALS,
                within: settings.global.within,
                apart: settings.global.apart,
                apart_turn: settings.global.apart_turn,
                min_score: near.refined.score,
                budget: settings.tracking.budget as usize,
                ..Window::around(expected.pose, reach, settings.tracking.search_turn)
            };
            search(self.map.pyramid(), &thinned, &window)
        };
        let (deviations, most) = WIDER;
        let reach = settings.tracking.reach;
        let mut searched = look(reach + (deviations * expected.step.deviation()).min(most));
        if !searched.is_exact {
            searched = look(reach);
        }
        let refined_at = |pose: Pose2| {
            let refined = refine(field, seen, pose, None, &settings.refine).expected_where_degenerate(expected.pose);
            (weigh(&refined).agreeing, refined)
        };
        let mut places: Vec<(f64, Refined)> = searched.found.iter().map(|found| refined_at(found.pose)).collect();
        places.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some((agreeing, refined)) = places.first().copied() else {
            return near;
        };
        if agreeing <= here.agreeing + settings.global.margin {
            return near;
        }
        // If odometry allows several places and the scan fits them about equally, none is trusted.
        let is_rival = |(other, place): &(f64, Refined)| {
            *other > agreeing - settings.global.margin
                && place.pose.distance(&refined.pose) >= settings.global.apart
                && prior.chi_squared(place.pose) <= JUMP
        };
        let (is_leap, has_rival) = (prior.chi_squared(refined.pose) > JUMP, places.iter().any(is_rival));
        // Where the building has changed, the scan may fit another place a little better. A robot that was pushed fits its new place well.
        if is_leap && !has_rival && agreeing < SURE && self.record.vouches() {
            return near;
        }
        Match {
            refined,
            is_wide: true,
            is_jump: is_leap || has_rival,
        }
    }

    /// Whether the robot is more likely elsewhere. The whole map is searched if the scan contradicts the matched place, or if that is a
    /// jump, since the robot may have been carried away or given a wrong pose. As long as no other place explains the scan clearly better,
    /// the building has changed.
    fn is_elsewhere(&mut self, now: &Last, laser: Point2<f64>, seen: &[Point2<f64>], is_jump: bool) -> bool {
        let (here, settings) = (self.evidence, &self.settings);
        if !is_jump && (self.agrees() || !self.says_much()) {
            self.doubt = DOUBT.0;
            return false;
        }
        if !is_jump && self.record.vouches() {
            return false;
        }
        let is_due = |then: Stamp| now.stamp.secs_since(then) >= self.doubt;
        if !is_jump && !self.searched_at.is_none_or(is_due) {
            return false;
        }
        self.searched_at = Some(now.stamp);
        self.doubt = (2.0 * self.doubt).min(DOUBT.1);
        let is_better = |place: &Hypothesis| {
            !is_one_place(place.pose, now.pose, settings)
                && place.evidence.agreeing >= here.agreeing + settings.tracking.elsewhere
        };
        match find(&self.map, laser, seen, settings) {
            Found::Unique(place) => is_better(&place),
            // After a jump none of several places is trusted; without one the present place still is.
            Found::Ambiguous(places) => is_jump || places.iter().all(is_better),
            Found::Nowhere | Found::OutOfBudget => false,
        }
    }

    /// Whether enough of the last matched scan is in known surroundings.
    fn says_much(&self) -> bool {
        self.evidence.points >= self.settings.evidence.least_points as usize
    }

    /// How the last matched scan fits the map.
    fn fit(&self, refined: &Refined) -> Fit {
        if self.says_much() && self.evidence.agreeing < self.settings.global.agrees {
            Fit::Contradicts
        } else if self.says_much() && refined.degenerate.is_none() {
            Fit::Agrees
        } else {
            Fit::SaysLittle
        }
    }

    /// Whether the last matched scan agrees with the map.
    fn agrees(&self) -> bool {
        let Evidence {
            agreeing,
            through_walls,
            ..
        } = self.evidence;
        agreeing >= self.settings.global.agrees && through_walls <= self.settings.tracking.through_walls
    }

    /// Derives the robot's health from a match.
    fn note(&mut self, refined: &Refined) {
        let settings = &self.settings;
        let contradicts = self.says_much() && self.evidence.agreeing < settings.evidence.lost_below;
        if contradicts && !self.record.vouches() {
            self.contradictions += 1;
        } else {
            self.contradictions = 0;
        }
        self.health = if self.contradictions >= settings.tracking.patience {
            Health::Lost
        } else {
            match refined.degenerate {
                Some(along) => Health::Degraded {
                    direction: along.y.atan2(along.x),
                },
                None => Health::Tracking,
            }
        };
    }

    /// Searches for a lost robot.
    fn search(&mut self, now: Last, laser: Point2<f64>, seen: &[Point2<f64>]) -> Located {
        let mut located = Located {
            pose: now.pose,
            covariance: None,
            health: self.health.clone(),
            evidence: self.evidence,
            is_found_anew: false,
        };
        self.last = Some(now);
        if seen.len() >= self.settings.evidence.least_points as usize {
            self.view.keep(now.pose, laser, seen);
        }
        if !self.is_search_due(now.stamp) {
            return located;
        }
        self.searched_at = Some(now.stamp);
        let view = self.view.joined(now.pose, laser, seen);
        let hoped = self.hoped.take();
        match find_in_view(&self.map, &view, &self.settings) {
            Found::Unique(place) if !self.is_sure(&place, hoped, &now) => {
                self.health = Health::Searching;
                self.hoped = Some(self.same_hope(hoped, &place, &now).unwrap_or(Hope {
                    stamp: now.stamp,
                    reckoned: now.pose,
                    place: place.pose,
                }));
            }
            Found::Unique(place) => {
                self.health = Health::Tracking;
                self.contradictions = 0;
                self.view.clear();
                self.record.clear();
                self.evidence = place.evidence;
                let own = turned(&place.covariance, -place.pose.yaw);
                self.odometry
                    .begin_anew(&own.try_inverse().unwrap_or_else(Matrix3::zeros));
                self.last = Some(Last {
                    pose: place.pose,
                    matched: Some(now.odom_from_base),
                    held: (now.odom_from_base, place.pose),
                    ..now
                });
                located.pose = place.pose;
                located.covariance = Some(place.covariance);
                located.is_found_anew = true;
            }
            Found::Ambiguous(places) => {
                self.health = Health::Ambiguous {
                    hypotheses: places.iter().map(|place| place.pose).collect(),
                };
            }
            Found::Nowhere | Found::OutOfBudget => {
                self.health = Health::Lost;
                // Scans of a robot that is being carried do not belong together.
                self.view.clear();
            }
        }
        located.health = self.health.clone();
        located.evidence = self.evidence;
        located
    }

    /// Whether a place that was found is taken: if most of what is seen agrees with the map, or if an earlier search found it, too, with
    /// another view or well before.
    fn is_sure(&self, place: &Hypothesis, hoped: Option<Hope>, now: &Last) -> bool {
        let is_confirmed = self.same_hope(hoped, place, now).is_some_and(|hope| {
            is_apart(hope.reckoned.inverse() * now.pose) || now.stamp.secs_since(hope.stamp) >= LATER
        });
        is_confirmed || place.evidence.agreeing >= SURE
    }

    /// The hope, if it is for the place that was found.
    fn same_hope(&self, hoped: Option<Hope>, place: &Hypothesis, now: &Last) -> Option<Hope> {
        hoped.filter(|hope| {
            let expected = hope.place * (hope.reckoned.inverse() * now.pose);
            is_one_place(expected, place.pose, &self.settings)
        })
    }

    /// Whether a lost robot may be searched for again at this stamp.
    fn is_search_due(&self, stamp: Stamp) -> bool {
        self.searched_at
            .is_none_or(|then| stamp.secs_since(then) >= SEARCH_PERIOD)
    }

    /// Declares the robot's pose unknown, because it is elsewhere or its odometry restarted: the next scan is searched for in the whole
    /// map.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// # use zenav_localisation::{LocalisationSettings, Localiser};
    /// let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    /// localiser.lose();
    /// let truth = Pose2::new(0.2, 0.1, 2.0);
    /// let located = localiser.step(&look(0.1, truth)).unwrap();
    /// assert!(located.is_found_anew && located.pose.distance(&truth) < 0.1, "{located:?}");
    /// ```
    pub fn lose(&mut self) {
        (self.last, self.told, self.hoped) = (None, None, None);
        self.view.clear();
        self.health = Health::Searching;
        self.searched_at = None;
    }

    /// Sets the robot's pose, `map_from_base` at its last scan or, before the first, at the first.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// # use zenav_localisation::{LocalisationSettings, Localiser};
    /// let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    /// let truth = Pose2::new(0.2, 0.1, 2.0);
    /// // An operator clicks on the map, 0.14 m beside the robot.
    /// localiser.place(Pose2::new(0.3, 0.2, 1.95));
    /// let located = localiser.step(&look(0.1, truth)).unwrap();
    /// assert!(located.pose.distance(&truth) < 0.05 && !located.is_found_anew, "{located:?}");
    /// ```
    pub fn place(&mut self, map_from_base: Pose2) {
        self.health = Health::Tracking;
        self.contradictions = 0;
        self.doubt = DOUBT.0;
        self.hoped = None;
        self.view.clear();
        match self.last {
            None => self.told = Some(map_from_base),
            Some(Last {
                stamp, odom_from_base, ..
            }) => self.last = Some(self.begin(stamp, odom_from_base, map_from_base)),
        }
    }

    /// Whether the last pose can be trusted.
    ///
    /// ```
    /// use zenav_localisation::{LocalisationSettings, Localiser};
    /// use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
    /// use zenav_protocol::messages::Health;
    ///
    /// let spec = GridSpec { origin: nalgebra::Point2::origin(), resolution: 0.05, width: 40, height: 40 };
    /// let mut localiser = Localiser::new(LocalisationSettings::default(), &OccupancyGrid::filled(spec, Occupancy::FREE));
    /// assert_eq!(localiser.health(), &Health::Tracking, "the initial guess is believed");
    /// localiser.lose();
    /// assert!(!localiser.health().is_trusted(), "the robot must not drive by this map");
    /// ```
    #[must_use]
    pub fn health(&self) -> &Health {
        &self.health
    }
}
