//! Global search. Where in the whole map could this scan be from?

use nalgebra::{Matrix3, Point2};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_scan_matching::{Window, floored, refine, search_among, turned};

use crate::evidence::{Evidence, evidence};
use crate::known_map::KnownMap;
use crate::settings::LocalisationSettings;

/// Standard deviation of a place that was found, at least, m and rad: one scan says no more.
const FOUND: (f64, f64) = (0.05, 0.02);

/// A place from which the scan could be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hypothesis {
    /// `map_from_base`.
    pub pose: Pose2,
    /// Covariance of x, y (m²) and yaw (rad²) along the map's axes: large along a corridor.
    pub covariance: Matrix3<f64>,
    /// How much of the scan agrees with the map from there.
    pub evidence: Evidence,
}

/// What a search found.
#[derive(Clone, Debug, PartialEq)]
pub enum Found {
    /// One place, and no other is about as good.
    Unique(Hypothesis),
    /// Several places agree about as well; the best first.
    Ambiguous(Vec<Hypothesis>),
    /// No place agrees well enough, or the scan sees too little.
    Nowhere,
    /// The budget was used up before it was known whether there is a better place.
    OutOfBudget,
}

/// Looks for the place of a scan in the whole map, at all headings. `laser`: where the beams begin, `points`: where they end, both in the
/// frame of the base, m.
#[must_use]
pub fn find(map: &KnownMap, laser: Point2<f64>, points: &[Point2<f64>], settings: &LocalisationSettings) -> Found {
    let global = &settings.global;
    if points.len() < settings.evidence.least_points as usize {
        return Found::Nowhere;
    }
    let spec = map.spec();
    let (width, height) = (
        f64::from(spec.width) * spec.resolution,
        f64::from(spec.height) * spec.resolution,
    );
    let center = Pose2::new(spec.origin.x + 0.5 * width, spec.origin.y + 0.5 * height, 0.0);
    let stride = points.len().div_ceil(global.points as usize).max(1);
    let thinned: Vec<Point2<f64>> = points.iter().copied().step_by(stride).collect();
    let window = Window {
        count: global.places as usize,
        apart: global.apart,
        apart_turn: global.apart_turn,
        budget: global.budget as usize,
        across: 0.5 * height,
        within: global.within,
        lever: global.lever,
        min_score: global.good_score.max(global.min_score),
        ..Window::around(center, 0.5 * width, std::f64::consts::PI)
    };
    let look = |window: &Window| search_among(map.pyramid(), Some(map.places()), &thinned, window);
    // A place that scores well is found soon. Where none does, or others may be about as good, all are looked at that may count.
    let mut searched = look(&window);
    let best = searched.found.first().map_or(0.0, |best| best.score);
    if best - global.within < window.min_score && global.min_score < window.min_score {
        let min_score = (best - global.within).max(global.min_score);
        searched = look(&Window { min_score, ..window });
    }
    // With so many places some were not looked at.
    let is_exact = searched.is_exact && searched.found.len() < window.count;
    let mut places: Vec<Hypothesis> = Vec::new();
    for candidate in &searched.found {
        let refined = refine(map.field(), points, candidate.pose, None, &settings.refine);
        let pose = refined.pose;
        let is_known = places
            .iter()
            .any(|place| place.pose.distance(&pose) < global.apart && turns_less(place.pose, pose, global.apart_turn));
        if !is_known && map.knows(pose.position()) {
            let evidence = evidence(map, laser, points, pose, &settings.evidence);
            let known = floored(&refined.information, FOUND.0, FOUND.1);
            let covariance = known.try_inverse().unwrap_or_else(Matrix3::identity);
            places.push(Hypothesis {
                pose,
                covariance: turned(&covariance, pose.yaw),
                evidence,
            });
        }
    }
    places.sort_by(|a, b| b.evidence.agreeing.total_cmp(&a.evidence.agreeing));
    let Some(best) = places.first().copied() else {
        return if is_exact { Found::Nowhere } else { Found::OutOfBudget };
    };
    if best.evidence.agreeing < global.agrees || best.evidence.points < settings.evidence.least_points as usize {
        return if is_exact { Found::Nowhere } else { Found::OutOfBudget };
    }
    places.retain(|place| place.evidence.agreeing > best.evidence.agreeing - global.margin);
    if places.len() > 1 {
        return Found::Ambiguous(places);
    }
    if is_exact {
        Found::Unique(best)
    } else {
        Found::OutOfBudget
    }
}

fn turns_less(a: Pose2, b: Pose2, turn: f64) -> bool {
    wrap_angle(a.yaw - b.yaw).abs() < turn
}
