//! Search of SLAM's map. Finds the robot in the whole map when it is not where SLAM holds it to be.
//!
//! The search is that of localisation in a known map ([`find`]), on the drawn map. A lost robot is searched for continuously. A robot whose
//! scans fit badly is searched for now and then, since it may have been carried to a place with similar walls: another place must then
//! explain the scan clearly better than the current one.

use zenav_localisation::{Found, Hypothesis, KnownMap, LocalisationSettings, evidence, find, is_one_place};
use zenav_mapping::Mapper;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{Health, MapRef, Scan};
use zenav_protocol::time::Stamp;
use zenav_scan_matching::points;

/// Interval between searches for a lost robot, s.
const PERIOD: f64 = 0.5;
/// Badly fitting scans in a row before the whole map is searched.
const DOUBTS: u32 = 3;
/// Searches in a row that confirm the current place before its surroundings count as changed.
const SURE: u32 = 3;
/// Pause between searches while scans keep fitting badly; it doubles from the first to the second value, s.
const PAUSE: (f64, f64) = (0.5, 30.0);

/// Result of a search: the robot's pose, `map_from_base` in the drawn map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Whereabouts {
    /// Another place than the current one explains the scan.
    Elsewhere(Pose2),
    /// The robot is where it is held to be, and its surroundings have changed.
    Here,
    /// No conclusion.
    Unknown,
}

/// Searches for the robot when it is lost, may be elsewhere, or on request.
#[derive(Clone, Debug)]
pub(super) struct Search {
    settings: LocalisationSettings,
    /// The map to search; `None` while the robot's place is not in doubt.
    map: Option<(MapRef, KnownMap)>,
    searched_at: Option<Stamp>,
    /// Badly fitting scans in a row.
    doubts: u32,
    /// Pause before the next search, s.
    pause: f64,
    is_asked: bool,
    /// Searches in a row that confirmed the current place.
    here: u32,
    /// Places that explain the last scan of a lost robot about equally well, in the drawn map.
    hypotheses: Vec<Pose2>,
}

impl Search {
    pub(super) fn new(settings: LocalisationSettings) -> Self {
        Self {
            settings,
            map: None,
            searched_at: None,
            doubts: 0,
            pause: PAUSE.0,
            is_asked: false,
            here: 0,
            hypotheses: Vec::new(),
        }
    }

    pub(super) fn settings(&self) -> &LocalisationSettings {
        &self.settings
    }

    /// Requests a search with the next scan.
    pub(super) fn ask(&mut self) {
        self.is_asked = true;
    }

    /// Whether a search is due with this scan. `fits`: the scan fits as well as scans that determine the robot's place.
    pub(super) fn is_due(&mut self, is_lost: bool, fits: bool, now: Stamp) -> bool {
        self.doubts = if fits { 0 } else { self.doubts.saturating_add(1) };
        if !is_lost {
            self.hypotheses.clear();
        }
        let pause = if is_lost { PERIOD } else { self.pause };
        let is_over = self
            .searched_at
            .is_none_or(|then| now.secs_since(then) >= pause || now < then);
        if is_over && self.doubts == 0 {
            (self.map, self.searched_at, self.pause) = (None, None, PAUSE.0);
            self.here = 0;
        }
        let is_due = is_over && (is_lost || self.doubts >= DOUBTS) || self.is_asked;
        if is_due {
            self.pause = (2.0 * pause).min(PAUSE.1);
            self.searched_at = Some(now);
        }
        is_due
    }

    /// Searches the whole drawn map for the place of a scan. `here`: the current place; `is_lost`: the scans contradict it.
    pub(super) fn find(&mut self, mapper: &Mapper, scan: &Scan, here: Pose2, is_lost: bool) -> Whereabouts {
        let settings = &self.settings;
        if self.map.as_ref().is_none_or(|(known, _)| known != mapper.map()) {
            let map = KnownMap::new(&mapper.grid(), settings.tracking.sigma);
            self.map = Some((mapper.map().clone(), map));
        }
        let Some((_, map)) = &self.map else {
            return Whereabouts::Unknown;
        };
        // The motion since the last scan is unknown here; sweeps are straightened where they are made.
        let seen = points(scan, Pose2::IDENTITY, 0.0, &settings.scan);
        let laser = scan.base_from_laser.position();
        let weighed = evidence(map, laser, &seen, here, &settings.evidence);
        let says_much = weighed.points >= settings.evidence.least_points as usize;
        let agrees =
            weighed.agreeing >= settings.global.agrees && weighed.through_walls <= settings.tracking.through_walls;
        let is_asked = std::mem::take(&mut self.is_asked);
        if !is_asked && !is_lost && (agrees || !says_much) {
            return Whereabouts::Unknown;
        }
        self.hypotheses.clear();
        let is_here = |place: &Hypothesis| is_one_place(here, place.pose, settings);
        let is_better = |place: &Hypothesis| place.evidence.agreeing >= weighed.agreeing + settings.tracking.elsewhere;
        // If much agrees here and no other place explains the scan as well, the building has changed.
        let may_be_here = says_much && weighed.agreeing >= settings.tracking.doubtful;
        let found = find(map, laser, &seen, settings);
        let is_here = match &found {
            Found::Unique(place) if is_better(place) => return Whereabouts::Elsewhere(place.pose),
            Found::Unique(place) if is_lost && !(may_be_here && is_here(place)) => {
                return Whereabouts::Elsewhere(place.pose);
            }
            Found::Ambiguous(places) if places.iter().any(is_better) || !places.iter().any(is_here) => {
                self.hypotheses.extend(places.iter().map(|place| place.pose));
                false
            }
            Found::Unique(_) | Found::Ambiguous(_) | Found::Nowhere => may_be_here,
            Found::OutOfBudget => false,
        };
        self.here = if is_here { self.here + 1 } else { 0 };
        if self.here < SURE {
            return Whereabouts::Unknown;
        }
        self.here = 0;
        Whereabouts::Here
    }

    /// Whether the search counts two poses as one place.
    pub(super) fn is_one_place(&self, a: Pose2, b: Pose2) -> bool {
        is_one_place(a, b, &self.settings)
    }

    /// The health of a lost robot: it is being searched for until the first search has a result, and while another one was requested.
    pub(super) fn health(&self) -> Health {
        if self.is_asked || self.searched_at.is_none() {
            return Health::Searching;
        }
        if self.hypotheses.is_empty() {
            return Health::Lost;
        }
        Health::Ambiguous {
            hypotheses: self.hypotheses.clone(),
        }
    }
}
