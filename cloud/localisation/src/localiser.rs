//! Localiser. Where is the robot now, and is that right?

use nalgebra::{Matrix3, Point2};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{Health, Scan};
use zenav_protocol::time::Stamp;
use zenav_scan_matching::{Prior, Refined, Window, floored, odometry_information, points, refine, search, turned};

use crate::evidence::{Evidence, evidence};
use crate::global::{Found, Hypothesis, find};
use crate::known_map::KnownMap;
use crate::settings::LocalisationSettings;

/// Points that a search about the expected place uses, at most.
const SEARCH_POINTS: usize = 120;
/// Variance of a pose that somebody told, m² and rad².
const GUESSED: [f64; 3] = [0.25, 0.25, 0.1];
/// Time between two global searches, s.
const SEARCH_PERIOD: f64 = 0.5;
/// Time until the whole map is looked at again while the scans contradict the place: it doubles from the first to the second, s.
const DOUBT: (f64, f64) = (0.5, 30.0);

/// What a scan tells of the robot's place.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// `map_from_base` at the scan's stamp, the best there is.
    pub pose: Pose2,
    /// How well the scan knows it: covariance of x, y (m²) and yaw (rad²) along the map's axes. `None` where the scan was not matched.
    pub covariance: Option<Matrix3<f64>>,
    /// Whether the pose can be trusted.
    pub health: Health,
    /// What the scan says of the pose.
    pub evidence: Evidence,
    /// Whether the pose was just found by a search of the whole map: it has nothing to do with the one before.
    pub is_found_anew: bool,
}

/// Follows a robot in a known map.
#[derive(Clone, Debug)]
pub struct Localiser {
    settings: LocalisationSettings,
    map: KnownMap,
    last: Option<Last>,
    /// Where the robot was told to be, before a scan.
    told: Option<Pose2>,
    health: Health,
    /// Scans in a row that contradict the map.
    contradictions: u32,
    searched_at: Option<Stamp>,
    /// How long the last doubt keeps the next one away, s.
    doubt: f64,
    evidence: Evidence,
}

/// The last scan.
#[derive(Clone, Copy, Debug)]
struct Last {
    stamp: Stamp,
    odom_from_base: Pose2,
    pose: Pose2,
    /// Odometry at the last scan that was matched.
    matched: Pose2,
    /// Covariance of the pose in its own frame.
    covariance: Matrix3<f64>,
}

impl Localiser {
    /// A robot somewhere in a map.
    #[must_use]
    pub fn new(settings: LocalisationSettings, map: &OccupancyGrid) -> Self {
        Self {
            map: KnownMap::new(map, settings.tracking.sigma),
            settings,
            last: None,
            told: None,
            health: Health::Tracking,
            contradictions: 0,
            searched_at: None,
            doubt: DOUBT.0,
            evidence: Evidence::default(),
        }
    }

    /// Takes in a scan. Its `odom_from_base` is the odometry at its stamp; its `map_from_odom` is the guess with which the first scan begins,
    /// and is not looked at later. `None` for a scan that is malformed or older than the last.
    pub fn step(&mut self, scan: &Scan) -> Option<Located> {
        let odometry = scan.odom_from_base;
        if !scan.is_sane() || !odometry.is_finite() {
            return None;
        }
        let last = match self.last {
            Some(last) if scan.stamp <= last.stamp => return None,
            Some(last) => last,
            None => Last {
                stamp: scan.stamp,
                odom_from_base: odometry,
                pose: self.told.take().unwrap_or(scan.map_from_odom * odometry),
                matched: Pose2::new(f64::INFINITY, 0.0, 0.0),
                covariance: Matrix3::from_diagonal(&GUESSED.into()),
            },
        };
        let step = last.odom_from_base.inverse() * odometry;
        let elapsed = scan.stamp.secs_since(last.stamp);
        let seen = points(scan, step, elapsed, &self.settings.scan);
        let laser = scan.base_from_laser.position();
        let expected = last.pose * step;
        let drift = odometry_information(step, &self.settings.odometry)
            .try_inverse()
            .unwrap_or_else(Matrix3::identity);
        let mut now = Last {
            stamp: scan.stamp,
            odom_from_base: odometry,
            pose: expected,
            covariance: last.covariance + drift,
            ..last
        };
        if matches!(self.health, Health::Lost | Health::Ambiguous { .. }) {
            return Some(self.search(now, laser, &seen));
        }
        let since = last.matched.inverse() * odometry;
        let tracking = &self.settings.tracking;
        let is_near = since.x.hypot(since.y) < tracking.distance && since.yaw.abs() < tracking.turn;
        // A robot at rest may be carried away, too: what contradicts the map is looked at however little it has moved.
        let is_near = is_near && !self.is_doubtful(laser, &seen, expected);
        let mut covariance = None;
        if !is_near {
            let (refined, is_jump) = self.matched(&now, laser, &seen);
            let scan_information = floored(&refined.information, tracking.floor, tracking.floor_turn);
            let prior = now.covariance.try_inverse().unwrap_or_else(Matrix3::zeros);
            now.covariance = (prior + scan_information).try_inverse().unwrap_or(now.covariance);
            now.pose = refined.pose;
            now.matched = odometry;
            covariance = scan_information
                .try_inverse()
                .map(|covariance| turned(&covariance, refined.pose.yaw));
            self.note(laser, &seen, &refined);
            if self.is_elsewhere(&now, laser, &seen, is_jump) {
                // The robot brakes and drops its plan; it is looked for with the next scan.
                self.health = Health::Lost;
                self.searched_at = None;
            }
            if self.health == Health::Lost {
                covariance = None;
            }
        }
        self.last = Some(now);
        Some(Located {
            pose: now.pose,
            covariance,
            health: self.health.clone(),
            evidence: self.evidence,
            is_found_anew: false,
        })
    }

    /// Whether less of a scan agrees with the map than should.
    fn is_doubtful(&self, laser: Point2<f64>, seen: &[Point2<f64>], pose: Pose2) -> bool {
        let settings = &self.settings;
        let here = evidence(&self.map, laser, seen, pose, &settings.evidence);
        here.points >= settings.evidence.least_points as usize && here.agreeing < settings.tracking.doubtful
    }

    /// The scan matched about the expected pose, and whether that took a search beyond what odometry says: a jump.
    fn matched(&self, now: &Last, laser: Point2<f64>, seen: &[Point2<f64>]) -> (Refined, bool) {
        let settings = &self.settings;
        let information = now.covariance.try_inverse().unwrap_or_else(Matrix3::zeros);
        let prior = Prior::of_odometry(now.pose, &information);
        let field = self.map.field();
        let near = refine(field, seen, now.pose, Some(&prior), &settings.refine);
        let weigh = |pose: Pose2| evidence(&self.map, laser, seen, pose, &settings.evidence);
        let agreeing = weigh(near.pose);
        if agreeing.agreeing >= settings.tracking.doubtful || agreeing.points < settings.evidence.least_points as usize
        {
            return (near, false);
        }
        let stride = seen.len().div_ceil(SEARCH_POINTS).max(1);
        let thinned: Vec<Point2<f64>> = seen.iter().copied().step_by(stride).collect();
        let window = Window {
            min_score: near.score,
            budget: settings.tracking.budget as usize,
            ..Window::around(now.pose, settings.tracking.reach, settings.tracking.search_turn)
        };
        let found = search(self.map.pyramid(), &thinned, &window);
        let wide = found
            .found
            .first()
            .map(|best| refine(field, seen, best.pose, None, &settings.refine));
        match wide.filter(|wide| weigh(wide.pose).agreeing > agreeing.agreeing + settings.global.margin) {
            Some(wide) => (wide, true),
            None => (near, false),
        }
    }

    /// Whether the robot is rather somewhere else: the whole map is looked at where the scan contradicts the place that was matched, or that is
    /// a jump, for the robot may have been carried away, or told a wrong place. While no other place explains the scan clearly better the
    /// building has changed.
    fn is_elsewhere(&mut self, now: &Last, laser: Point2<f64>, seen: &[Point2<f64>], is_jump: bool) -> bool {
        let (here, settings) = (self.evidence, &self.settings);
        let says_much = here.points >= settings.evidence.least_points as usize;
        let agrees = here.agreeing >= settings.global.agrees && here.through_walls <= settings.tracking.through_walls;
        if !is_jump && (agrees || !says_much) {
            self.doubt = DOUBT.0;
            return false;
        }
        let is_due = |then: Stamp| now.stamp.secs_since(then) >= self.doubt;
        if !is_jump && !self.searched_at.is_none_or(is_due) {
            return false;
        }
        self.searched_at = Some(now.stamp);
        self.doubt = (2.0 * self.doubt).min(DOUBT.1);
        let is_better = |place: &Hypothesis| {
            let apart = place.pose.distance(&now.pose) >= settings.global.apart
                || wrap_angle(place.pose.yaw - now.pose.yaw).abs() >= settings.global.apart_turn;
            apart && place.evidence.agreeing >= here.agreeing + settings.tracking.elsewhere
        };
        match find(&self.map, laser, seen, settings) {
            Found::Unique(place) => is_better(&place),
            // After a jump none of several places is believed; without one, whoever was right until now still is.
            Found::Ambiguous(places) => is_jump || places.iter().all(is_better),
            Found::Nowhere | Found::OutOfBudget => false,
        }
    }

    /// Notes what a match says of the robot's health.
    fn note(&mut self, laser: Point2<f64>, seen: &[Point2<f64>], refined: &Refined) {
        let settings = &self.settings;
        self.evidence = evidence(&self.map, laser, seen, refined.pose, &settings.evidence);
        let says_much = self.evidence.points >= settings.evidence.least_points as usize;
        if says_much && self.evidence.agreeing < settings.evidence.lost_below {
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

    /// Looks for a robot that is lost.
    fn search(&mut self, now: Last, laser: Point2<f64>, seen: &[Point2<f64>]) -> Located {
        let mut located = Located {
            pose: now.pose,
            covariance: None,
            health: self.health.clone(),
            evidence: self.evidence,
            is_found_anew: false,
        };
        self.last = Some(now);
        if self
            .searched_at
            .is_some_and(|then| now.stamp.secs_since(then) < SEARCH_PERIOD)
        {
            return located;
        }
        self.searched_at = Some(now.stamp);
        match find(&self.map, laser, seen, &self.settings) {
            Found::Unique(place) => {
                self.health = Health::Tracking;
                self.contradictions = 0;
                self.evidence = place.evidence;
                self.last = Some(Last {
                    pose: place.pose,
                    matched: now.odom_from_base,
                    covariance: turned(&place.covariance, -place.pose.yaw),
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
            Found::Nowhere | Found::OutOfBudget => self.health = Health::Lost,
        }
        located.health = self.health.clone();
        located.evidence = self.evidence;
        located
    }

    /// The robot is somewhere else, or its odometry begins anew: it is looked for in the whole map with the next scan.
    pub fn lose(&mut self) {
        (self.last, self.told) = (None, None);
        self.health = Health::Lost;
        self.searched_at = None;
    }

    /// The robot's place is told, `map_from_base` at its last scan or, before the first, at that.
    pub fn place(&mut self, map_from_base: Pose2) {
        self.health = Health::Tracking;
        self.contradictions = 0;
        self.doubt = DOUBT.0;
        if self.last.is_none() {
            self.told = Some(map_from_base);
        }
        if let Some(last) = &mut self.last {
            last.pose = map_from_base;
            last.matched = Pose2::new(f64::INFINITY, 0.0, 0.0);
            last.covariance = Matrix3::from_diagonal(&GUESSED.into());
        }
    }

    /// Whether the last pose can be trusted.
    #[must_use]
    pub fn health(&self) -> &Health {
        &self.health
    }
}
