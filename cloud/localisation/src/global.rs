//! Global search. Finds the places in the whole map from which a scan may have been taken.

use nalgebra::{Matrix3, Point2, Rotation2, Vector2};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_scan_matching::{Refinable, Search, Window, floored, search_among, turned};

use crate::evidence::{Beam, Evidence, beam, evidence_elsewhere};
use crate::known_map::KnownMap;
use crate::settings::{GlobalSettings, LocalisationSettings};
use crate::view::Sight;

/// Least standard deviation of a found place, m and rad: one scan determines it no better.
const FOUND: (f64, f64) = (0.05, 0.02);

/// Wall thicknesses at which the far face may be mistaken for the near one, m.
const THICKNESSES: [f64; 3] = [0.06, 0.12, 0.18];
/// Another pose is preferred only if this share more of the beams ends at the first wall.
const BETTER: f64 = 0.02;
/// Poses closer than this, m and rad, are equivalent to the beams.
const SAME: (f64, f64) = (5e-4, 2e-4);
/// If this share of the beams ends at the first wall, the faces are the right ones.
const NEAR_FACES: f64 = 0.9;
/// Number of places whose faces are checked, best first: each takes some milliseconds.
const FACED: usize = 8;
/// Least likelihood of a point in a wall's own cell.
const A_WALL: f64 = 0.99;

/// Maxima closer than this share of the distance at which places are one are one maximum: a scan may agree best at the lower of two.
const NEAR: f64 = 0.5;
/// Widest door, m.
const DOOR: f64 = 1.5;
/// A place explains less if another one explains at least this many points of the scan that end in free space there, ...
const MORE: usize = 12;
/// ... and this many times as many as are explained by the first place only.
const TIMES: usize = 4;

/// A place where the scan may have been taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hypothesis {
    /// `map_from_base`.
    pub pose: Pose2,
    /// Covariance of x, y (m²) and yaw (rad²) along the map's axes: large along a corridor.
    pub covariance: Matrix3<f64>,
    /// Evidence of the scan on this pose.
    pub evidence: Evidence,
}

/// Result of a search.
///
/// ```
#[doc = include_str!("doc_setup/room.txt")]
/// use zenav_localisation::{Found, KnownMap, LocalisationSettings, find};
///
/// // The same room without pillars looks alike from two poses.
/// let (empty, settings) = (KnownMap::new(&walled_room(spec, |_| false), 0.08), LocalisationSettings::default());
/// let (truth, rotated) = (Pose2::new(0.5, 0.3, 0.0), Pose2::new(-0.5, -0.3, std::f64::consts::PI));
/// let ranges = sweep_in_room(&lidar, 0.1, truth, (3.0, 2.0), &[]).ranges;
/// let now = Scan { ranges, ..look(0.1, truth) };
/// let seen = zenav_scan_matching::points(&now, Pose2::IDENTITY, 0.0, &settings.scan);
/// let found = find(&empty, now.base_from_laser.position(), &seen, &settings);
/// let Found::Ambiguous(places) = &found else { panic!("{found:?}") };
/// assert!([truth, rotated].iter().all(|pose| places.iter().any(|place| place.pose.distance(pose) < 0.1)));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub enum Found {
    /// One place, with no other about as good.
    Unique(Hypothesis),
    /// Several places agree about equally well; best first.
    Ambiguous(Vec<Hypothesis>),
    /// No place agrees well enough, or the scan sees too little.
    Nowhere,
    /// The budget ran out before it was known whether there is a better place.
    OutOfBudget,
}

/// Searches the whole map for the place of a scan, at all headings. `laser`: where the beams begin, `points`: where they end, both in the
/// frame of the base, m.
///
/// ```
#[doc = include_str!("doc_setup/room.txt")]
/// use zenav_localisation::{Found, GlobalSettings, KnownMap, LocalisationSettings, find};
///
/// let settings = LocalisationSettings::default();
/// let known = KnownMap::new(&map, settings.tracking.sigma);
/// let (truth, laser) = (Pose2::new(0.2, 0.1, 2.0), lidar.mount.position());
/// let seen = zenav_scan_matching::points(&look(0.1, truth), Pose2::IDENTITY, 0.0, &settings.scan);
/// let found = find(&known, laser, &seen, &settings);
/// let Found::Unique(place) = &found else { panic!("{found:?}") };
/// assert!(place.pose.distance(&truth) < 0.1 && place.evidence.agreeing > 0.8);
/// assert_eq!(find(&known, laser, &seen[..10], &settings), Found::Nowhere, "ten points say too little");
/// let hasty = LocalisationSettings { global: GlobalSettings { budget: 1000, ..settings.global }, ..settings };
/// assert_eq!(find(&known, laser, &seen, &hasty), Found::OutOfBudget);
/// ```
#[must_use]
pub fn find(map: &KnownMap, laser: Point2<f64>, points: &[Point2<f64>], settings: &LocalisationSettings) -> Found {
    let sight = Sight {
        laser,
        points: points.to_vec(),
    };
    find_in_view(map, &[sight], settings)
}

/// The same for several scans, all in the frame of the base at the newest, which comes first.
pub(crate) fn find_in_view(map: &KnownMap, view: &[Sight], settings: &LocalisationSettings) -> Found {
    let global = &settings.global;
    let points: Vec<Point2<f64>> = view.iter().flat_map(|sight| sight.points.iter().copied()).collect();
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
        apart: NEAR * global.apart,
        apart_turn: NEAR * global.apart_turn,
        budget: global.budget as usize,
        across: 0.5 * height,
        within: global.within,
        lever: global.lever,
        min_score: global.good_score.max(global.min_score),
        ..Window::around(center, 0.5 * width, std::f64::consts::PI)
    };
    let look = |window: &Window| search_among(map.pyramid(), Some(map.places()), &thinned, window);
    let searched = candidates(&window, global, look);
    // If the list of places is full, some were dropped.
    let is_exact = searched.is_exact && searched.found.len() < window.count;
    let scan = Refinable::new(&points);
    let mut places: Vec<Hypothesis> = Vec::new();
    for candidate in &searched.found {
        let refined = scan.refine(map.field(), candidate.pose, None, &settings.refine);
        let pose = refined.pose;
        if !map.knows(pose.position()) {
            continue;
        }
        let evidence = weigh(map, view, pose, settings);
        // Of several maxima at one place the one that the scan agrees with best is meant.
        let is_same = |place: &Hypothesis| is_one_place(place.pose, pose, settings);
        if places
            .iter()
            .any(|place| is_same(place) && place.evidence.agreeing >= evidence.agreeing)
        {
            continue;
        }
        places.retain(|place| !is_same(place));
        let known = floored(&refined.information, FOUND.0, FOUND.1);
        let covariance = known.try_inverse().unwrap_or_else(Matrix3::identity);
        places.push(Hypothesis {
            pose,
            covariance: turned(&covariance, pose.yaw),
            evidence,
        });
    }
    places.sort_by(|a, b| b.evidence.agreeing.total_cmp(&a.evidence.agreeing));
    let is_good = |place: &Hypothesis| {
        place.evidence.agreeing >= global.agrees && place.evidence.points >= settings.evidence.least_points as usize
    };
    let Some(best) = places.first().copied().filter(is_good) else {
        return if is_exact { Found::Nowhere } else { Found::OutOfBudget };
    };
    places.retain(|place| place.evidence.agreeing > best.evidence.agreeing - global.margin);
    // If not all places were examined, the best one is no measure for the others.
    if places.len() > 1 && is_exact {
        let of_best = ends(map, view, best.pose, &scan, settings);
        let is_rival = |pose: Pose2| !explains_less(&ends(map, view, pose, &scan, settings), &of_best);
        places.retain(|place| place.pose == best.pose || is_rival(place.pose));
    }
    for place in places.iter_mut().take(FACED) {
        place.pose = at_near_faces(map, view, &scan, place.pose, settings);
    }
    match places[..] {
        [place] if is_exact => Found::Unique(place),
        [] | [_] => Found::OutOfBudget,
        _ => Found::Ambiguous(places),
    }
}

/// The places that may count: all about as good as the best one, which scores enough. `look` searches a window.
fn candidates(window: &Window, global: &GlobalSettings, mut look: impl FnMut(&Window) -> Search) -> Search {
    // A place that scores well is found quickly. If none does, all that score enough are searched for.
    let (mut searched, mut bound) = (look(window), window.min_score);
    if searched.found.is_empty() && global.min_score < bound {
        bound = global.min_score;
        searched = look(&Window {
            min_score: bound,
            ..*window
        });
    }
    // Places about as good as the best one count even if they score less than it had to. A budget that was too small for the higher bound
    // is too small for this one.
    let best = searched.found.first().filter(|_| searched.is_exact);
    let rival = best.map(|best| best.score - global.within);
    if let Some(min_score) = rival.filter(|rival| *rival < bound) {
        searched = look(&Window { min_score, ..*window });
    }
    searched
}

/// The pose near a found one from which most beams end at the first wall on their way. A thin wall has two faces, and a scan that sees only
/// one of them also fits the other, off by a wall's thickness.
fn at_near_faces(
    map: &KnownMap,
    view: &[Sight],
    scan: &Refinable,
    found: Pose2,
    settings: &LocalisationSettings,
) -> Pose2 {
    let (mut best, mut most) = (found, first_hits(map, view, found));
    if most >= NEAR_FACES {
        return found;
    }
    let mut asked = vec![found];
    for direction in 0..8 {
        let (sin, cos) = (f64::from(direction) * std::f64::consts::FRAC_PI_4).sin_cos();
        for shift in THICKNESSES {
            let shifted = Pose2::new(found.x + shift * cos, found.y + shift * sin, found.yaw);
            let pose = scan.refine(map.field(), shifted, None, &settings.refine).pose;
            let is_near = is_one_place(pose, found, settings);
            let is_asked = |known: &Pose2| known.distance(&pose) < SAME.0 && turns_less(pose, *known, SAME.1);
            if !is_near || asked.iter().any(is_asked) {
                continue;
            }
            asked.push(pose);
            let hits = first_hits(map, view, pose);
            if hits > most + BETTER {
                (best, most) = (pose, hits);
            }
        }
    }
    best
}

/// Evidence of all scans of a view on a pose of the newest.
fn weigh(map: &KnownMap, view: &[Sight], map_from_base: Pose2, settings: &LocalisationSettings) -> Evidence {
    let mut all = Evidence::default();
    let (mut agreeing, mut through) = (0.0, 0.0);
    for sight in view {
        let one = evidence_elsewhere(map, sight.laser, &sight.points, map_from_base, &settings.evidence);
        let points = one.points as f64;
        all.points += one.points;
        agreeing += one.agreeing * points;
        through += one.through_walls * points;
    }
    let points = all.points.max(1) as f64;
    Evidence {
        agreeing: agreeing / points,
        through_walls: through / points,
        ..all
    }
}

/// How a beam ends in the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// At a wall.
    Wall,
    /// In free space, where nothing was.
    Free,
    /// In free space, between two walls: a door may be closed.
    Gap,
    /// Behind a wall: it may have been taken away.
    Behind,
    /// Where the map knows nothing.
    Unknown,
}

/// How each beam of a view ends, from a pose of the newest scan.
fn ends(
    map: &KnownMap,
    view: &[Sight],
    map_from_base: Pose2,
    scan: &Refinable,
    settings: &LocalisationSettings,
) -> Vec<End> {
    let (field, rules) = (map.field(), &settings.evidence);
    let resolution = map.spec().resolution;
    let turn = Rotation2::new(map_from_base.yaw);
    let lasers = view
        .iter()
        .flat_map(|sight| std::iter::repeat_n(sight.laser, sight.points.len()));
    let end = |laser: Point2<f64>, point: &Point2<f64>, normal: Option<Vector2<f64>>| {
        let at = map_from_base.transform_point(*point);
        match beam(map, map_from_base.transform_point(laser), at, rules) {
            None => return End::Unknown,
            Some(Beam { passes: true, .. }) => return End::Behind,
            Some(Beam { ends: true, .. }) => return End::Wall,
            Some(_) => {}
        }
        let steps = (DOOR / resolution) as usize;
        let meets = |along: Vector2<f64>| {
            (1..=steps).find(|count| field.at(at + along * (resolution * *count as f64)) >= rules.wall)
        };
        let is_gap = normal.is_some_and(|normal| {
            let along = turn * Vector2::new(-normal.y, normal.x);
            let sides = meets(along).zip(meets(-along));
            sides.is_some_and(|(left, right)| left + right <= steps)
        });
        if is_gap { End::Gap } else { End::Free }
    };
    lasers
        .zip(scan.points())
        .zip(scan.normals())
        .map(|((laser, point), normal)| end(laser, point, *normal))
        .collect()
}

/// Whether a place explains the scan less than another, and nothing that this one does not.
fn explains_less(ends: &[End], better: &[End]) -> bool {
    let count = |is: fn(End, End) -> bool| {
        ends.iter()
            .zip(better)
            .filter(|(end, better)| is(**end, **better))
            .count()
    };
    let by_better = count(|end, better| better == End::Wall && end == End::Free);
    let by_this = count(|end, better| end == End::Wall && !matches!(better, End::Wall | End::Unknown));
    by_better >= MORE && by_better >= TIMES * by_this
}

/// Share of the beams that end at the first wall on their way, 0 to 1.
fn first_hits(map: &KnownMap, view: &[Sight], map_from_base: Pose2) -> f64 {
    let field = map.field();
    let step = 0.5 * map.spec().resolution;
    let is_first = |laser: Point2<f64>, point: Point2<f64>| {
        let from = map_from_base.transform_point(laser);
        let beam = map_from_base.transform_point(point) - from;
        let length = beam.norm();
        let along = beam / length.max(f64::MIN_POSITIVE);
        let steps = (length / step) as usize + 3;
        let first = (0..steps).find(|count| field.at(from + along * (step * *count as f64)) >= A_WALL);
        first.is_some_and(|count| (step * count as f64 - length).abs() <= 3.0 * step)
    };
    let (mut first, mut all) = (0_usize, 0_usize);
    for sight in view {
        all += sight.points.len();
        first += sight
            .points
            .iter()
            .filter(|point| is_first(sight.laser, **point))
            .count();
    }
    first as f64 / all.max(1) as f64
}

/// Whether a search counts two poses as one place.
///
/// ```
/// use zenav_localisation::{LocalisationSettings, is_one_place};
/// use zenav_protocol::geometry::Pose2;
///
/// let settings = LocalisationSettings::default();
/// assert_eq!((settings.global.apart, settings.global.apart_turn), (0.5, 0.3));
/// let is_same = |x, yaw| is_one_place(Pose2::IDENTITY, Pose2::new(x, 0.0, yaw), &settings);
/// assert!(is_same(0.4, 0.2) && !is_same(0.6, 0.0) && !is_same(0.0, 0.4));
/// ```
#[must_use]
pub fn is_one_place(a: Pose2, b: Pose2, settings: &LocalisationSettings) -> bool {
    let global = &settings.global;
    a.distance(&b) < global.apart && turns_less(a, b, global.apart_turn)
}

fn turns_less(a: Pose2, b: Pose2, turn: f64) -> bool {
    wrap_angle(a.yaw - b.yaw).abs() < turn
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_fixtures::{map_where, spec};
    use zenav_scan_matching::Candidate;

    #[test]
    fn rivals_are_searched_for_only_after_a_search_that_its_budget_sufficed_for() {
        let global = LocalisationSettings::default().global;
        let window = Window {
            min_score: global.good_score,
            ..Window::around(Pose2::IDENTITY, 1.0, 0.1)
        };
        // The only place scores enough, but not well, and a rival may score too little.
        let place = Candidate {
            pose: Pose2::IDENTITY,
            score: global.min_score + 0.5 * global.within,
        };
        for (is_exact, searches) in [(true, 3), (false, 2)] {
            let mut bounds = Vec::new();
            let searched = candidates(&window, &global, |window| {
                bounds.push(window.min_score);
                let is_found = place.score >= window.min_score;
                Search {
                    found: is_found.then_some(place).into_iter().collect(),
                    is_exact,
                    scored: window.budget,
                }
            });
            assert_eq!(bounds.len(), searches, "{bounds:?}");
            assert_eq!(searched.found, [place]);
        }
    }

    #[test]
    fn of_the_two_faces_of_a_thin_wall_the_near_one_is_meant() {
        let map = map_where(spec(120, 100, 0.05), |at| {
            (1.95..2.1).contains(&at.x) || (0.95..1.1).contains(&at.y)
        });
        let settings = LocalisationSettings::default();
        let map = KnownMap::new(&map, settings.tracking.sigma);
        // A corner seen from its inside: only the near faces.
        let truth = Pose2::new(3.0, 2.0, 0.0);
        let points: Vec<Point2<f64>> = (0..50)
            .map(|nth| 1.1 + 0.04 * f64::from(nth))
            .flat_map(|along| [Point2::new(2.1, along), Point2::new(along + 1.0, 1.1)])
            .map(|point| truth.inverse().transform_point(point))
            .collect();
        let behind = Pose2::new(2.88, 1.88, 0.0);
        let scan = Refinable::new(&points);
        let refined = scan.refine(map.field(), behind, None, &settings.refine).pose;
        assert!(refined.distance(&truth) > 0.1, "{refined:?}: refining alone would do");
        let sight = Sight {
            laser: Point2::origin(),
            points: points.clone(),
        };
        let near = at_near_faces(&map, &[sight], &scan, refined, &settings);
        assert!(near.distance(&truth) < 0.06, "{near:?}");
    }
}
