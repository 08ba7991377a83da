//! Search of SLAM's map. Where in the whole of it does the robot stand, if not where SLAM holds it to be?
//!
//! The search is that of localisation in a known map ([`find`]), in the map as it is drawn. A robot that is lost is looked for all the time; one
//! whose scans fit badly now and then, for it may have been carried to where the same walls stand: there another place must explain the scan
//! clearly better than the one where it is held to be.

use zenav_localisation::{Evidence, Found, KnownMap, LocalisationSettings, evidence, find, is_one_place};
use zenav_mapping::Mapper;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{Health, Scan};
use zenav_protocol::time::Stamp;
use zenav_scan_matching::points;

/// Time between two searches for a robot that is lost, s.
const PERIOD: f64 = 0.5;
/// Scans in a row that fit badly before the whole map is looked at.
const DOUBTS: u32 = 3;
/// Time until it is looked at again while they do: it doubles from the first to the second, s.
const PAUSE: (f64, f64) = (0.5, 30.0);

/// Looks for the robot where it is lost, or may be elsewhere, or when somebody asks.
#[derive(Clone, Debug)]
pub(super) struct Search {
    settings: LocalisationSettings,
    /// The map in which the robot is looked for, with its frame; nothing while its place is not in doubt.
    map: Option<(u64, KnownMap)>,
    searched_at: Option<Stamp>,
    /// Scans in a row that fit badly.
    doubts: u32,
    /// How long the last search keeps the next one away, s.
    pause: f64,
    is_asked: bool,
    /// Places that explain the last scan of a robot that is lost about as well, in the map as it is drawn.
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
            hypotheses: Vec::new(),
        }
    }

    pub(super) fn settings(&self) -> &LocalisationSettings {
        &self.settings
    }

    /// The next scan is searched for.
    pub(super) fn ask(&mut self) {
        self.is_asked = true;
    }

    /// Whether a scan is to be searched for. `fits`: as well as scans do that say where the robot is.
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
        }
        let is_due = is_over && (is_lost || self.doubts >= DOUBTS) || self.is_asked;
        if is_due {
            self.pause = (2.0 * pause).min(PAUSE.1);
            self.searched_at = Some(now);
        }
        is_due
    }

    /// The one place, `map_from_base` in the map as it is drawn, from which a scan may be, and that is not where the robot is held to be: `here`,
    /// where it is not lost. `None` where there is none, or another is about as good.
    pub(super) fn find(&mut self, mapper: &Mapper, scan: &Scan, here: Option<Pose2>) -> Option<Pose2> {
        let settings = &self.settings;
        let frame = mapper.map().frame;
        if self.map.as_ref().is_none_or(|(known, _)| *known != frame) {
            self.map = Some((frame, KnownMap::new(&mapper.grid(), settings.tracking.sigma)));
        }
        let (_, map) = self.map.as_ref()?;
        // How the robot moved since the last scan is not known: its sweeps are straightened where they are made.
        let seen = points(scan, Pose2::IDENTITY, 0.0, &settings.scan);
        let laser = scan.base_from_laser.position();
        let weighed = here.map(|here| (here, evidence(map, laser, &seen, here, &settings.evidence)));
        let is_asked = std::mem::take(&mut self.is_asked);
        let is_here = |evidence: &Evidence| {
            let says_much = evidence.points >= settings.evidence.least_points as usize;
            let agrees = evidence.agreeing >= settings.global.agrees
                && evidence.through_walls <= settings.tracking.through_walls;
            agrees || !says_much
        };
        if !is_asked && weighed.as_ref().is_some_and(|(_, evidence)| is_here(evidence)) {
            return None;
        }
        self.hypotheses.clear();
        match find(map, laser, &seen, settings) {
            Found::Unique(place) => {
                let is_elsewhere = weighed.is_none_or(|(here, evidence)| {
                    !is_one_place(here, place.pose, settings)
                        && place.evidence.agreeing >= evidence.agreeing + settings.tracking.elsewhere
                });
                is_elsewhere.then_some(place.pose)
            }
            Found::Ambiguous(places) => {
                self.hypotheses.extend(places.iter().map(|place| place.pose));
                None
            }
            Found::Nowhere | Found::OutOfBudget => None,
        }
    }

    /// The health of a robot that is looked for.
    pub(super) fn health(&self) -> Health {
        if self.hypotheses.is_empty() {
            return Health::Lost;
        }
        Health::Ambiguous {
            hypotheses: self.hypotheses.clone(),
        }
    }
}
