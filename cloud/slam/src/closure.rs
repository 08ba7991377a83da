//! Loop closure. Finds a scan again in older submaps.
//!
//! The search window of a node follows from its uncertainty relative to the old submap ([`drift`](crate::drift)). A wider window is
//! searched proportionally less often, so the work per scan stays constant. A match far from the expected pose is accepted only if a second
//! scan, from a few metres before, is found at the same place.

use nalgebra::Point2;
use zenav_pose_graph::{Edge, EdgeKind, GraphError, Uncertain};
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{Refinable, Refined, Window, floored, judge, search};

use crate::drift::spread;
use crate::settings::{ClosureSettings, SlamSettings};
use crate::slam::Slam;
use crate::submap::{SEARCH_POINTS, Scans, Submap, thinned};

/// A second place within this much of the best score is as good: the closure is ambiguous.
pub(crate) const AMBIGUOUS: f64 = 0.03;
/// The same for a match far from its expected pose: along a row of equal doors, a fully visible wrong place outscores the true one by a
/// little.
const FAR_AMBIGUOUS: f64 = 0.1;
/// Places closer than this, m and rad, count as one.
const APART: (f64, f64) = (0.5, 0.3);
/// The floor of a closure's standard deviation is this multiple of that in a growing submap: the old submap may have moved since.
pub(crate) const DOUBT: f64 = 2.0;
/// Half width of a window, standard deviations.
const DEVIATIONS: f64 = 3.0;
/// Largest half width, as a multiple of [`ClosureSettings::near`].
const WIDEST: f64 = 10.0;
/// Largest size of a window, in usual windows.
const LARGEST: f64 = 100.0;
/// Scans that may confirm a match lie at least this far from it and from each other, m, so that each sees something else.
const WITNESS: f64 = 3.0;
/// Most such scans tried: a person, or a door that was open then, can hide the place from one scan.
const WITNESSES: usize = 4;
/// They are searched for in this many submaps before and after the match's: the relative poses of these are well known.
const NEIGHBOURS: usize = 3;

/// A submap in which a node is searched for.
#[derive(Clone, Copy, Debug)]
struct Place {
    submap: usize,
    /// From the node to the middle of the submap, m.
    distance: f64,
    around: Around,
    /// Duration of the search relative to a usual one: bounds prune most of the plane, so the work grows only with the window's width.
    size: u64,
}

/// A window around a scan's expected pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Around {
    /// Half width, m.
    pub(crate) reach: f64,
    /// Half width of the headings, rad.
    pub(crate) turn: f64,
    /// Blocks that the search may score.
    pub(crate) budget: usize,
    /// Least score margin over any other place of a match farther away than [`ClosureSettings::reach`]; a nearer one needs [`AMBIGUOUS`].
    pub(crate) far_margin: f64,
}

/// A node, the submap in which it was found, and its pose there.
type Match = (usize, usize, Refined);

/// Result of a search.
pub(crate) enum Seen {
    /// Nothing fits well, or a second place fits about as well.
    No,
    /// The budget ran out first.
    Cut,
    /// The scan's pose in the submap.
    At(Refined),
}

/// Searches for a node's scan in older submaps and adds closures to the graph; returns their number. `laser`: origin of the beams in the
/// base frame.
pub(crate) fn close(slam: &mut Slam, node: usize, laser: Point2<f64>) -> Result<usize, GraphError> {
    let mut count = 0;
    for place in places(slam, node) {
        for (node, submap, refined) in matches(slam, node, &place, laser) {
            let edge = closure(slam.submaps[submap].anchor, node, &refined, &slam.settings);
            slam.back_end.add_edge(edge)?;
            count += 1;
        }
    }
    slam.counts.found += count;
    slam.is_dirty |= count > 0;
    Ok(count)
}

/// The match of a node in a place, and, if it lies far from the expected pose, its confirmation: nodes, each with its submap and its pose
/// there.
fn matches(slam: &mut Slam, node: usize, place: &Place, laser: Point2<f64>) -> Vec<Match> {
    let Some(refined) = searched(slam, node, place.submap, place.around, laser) else {
        return Vec::new();
    };
    let own = (node, place.submap, refined);
    if distance(slam, node, place.submap, refined.pose) <= slam.settings.closure.reach {
        return vec![own];
    }
    let second = witness(slam, node, place, &refined, laser);
    second.map_or_else(Vec::new, |second| vec![own, second])
}

/// The older submaps in which a node is searched for now.
fn places(slam: &mut Slam, node: usize) -> Vec<Place> {
    let limits = slam.settings.closure;
    let widest = WIDEST * limits.near;
    let anchors: Vec<usize> = slam.submaps.iter().map(|submap| submap.anchor).collect();
    let known = slam
        .back_end
        .as_seen_from(&anchors, &slam.settings.front, widest / DEVIATIONS);
    let turn = (node / limits.every as usize) as u64;
    let mut places: Vec<Place> = known
        .iter()
        .filter(|(submap, _)| is_left(slam, **submap, node))
        .map(|(submap, anchor_from_node)| place(slam, node, *submap, anchor_from_node))
        .filter(|place| place.distance <= limits.near + place.around.reach && turn.is_multiple_of(place.size))
        .collect();
    // A large window whose turn it is goes first: the others get theirs every time.
    places.sort_by(|a, b| {
        (a.size == 1)
            .cmp(&(b.size == 1))
            .then(a.distance.total_cmp(&b.distance))
    });
    places.truncate(limits.submaps as usize);
    places
}

fn place(slam: &Slam, node: usize, submap: usize, anchor_from_node: &Uncertain) -> Place {
    let limits = &slam.settings.closure;
    let reach = (limits.reach + DEVIATIONS * spread(anchor_from_node)).min(WIDEST * limits.near);
    let turn = DEVIATIONS * anchor_from_node.covariance[(2, 2)].max(0.0).sqrt();
    let turn = turn.max(limits.turn).min(std::f64::consts::PI);
    let poses = slam.back_end.poses();
    let size = (reach / limits.near * turn / limits.turn.max(f64::MIN_POSITIVE)).ceil();
    let size = size.clamp(1.0, LARGEST) as u64;
    Place {
        submap,
        distance: poses[slam.submaps[submap].middle()].distance(&poses[node]),
        around: Around {
            reach,
            turn,
            budget: (u64::from(limits.budget) * size) as usize,
            far_margin: FAR_AMBIGUOUS,
        },
        size,
    }
}

/// Whether a submap was left long enough ago; submaps of other sessions always are.
fn is_left(slam: &Slam, submap: usize, node: usize) -> bool {
    let end = slam.submaps[submap].end();
    end <= slam.session_start() || end + slam.settings.closure.gap as usize <= node
}

/// Searches for a node's scan in a submap, around its expected pose.
fn searched(slam: &mut Slam, node: usize, submap: usize, around: Around, laser: Point2<f64>) -> Option<Refined> {
    slam.counts.searched += 1;
    let poses = slam.back_end.poses();
    let submap = &mut slam.submaps[submap];
    let expected = poses[submap.anchor].inverse() * poses[node];
    let scans = Scans {
        sessions: &slam.sessions,
        points: &slam.scans,
    };
    match seen_again(
        submap,
        scans,
        expected,
        around,
        laser,
        &slam.scans[node],
        &slam.settings,
    ) {
        Seen::At(refined) => Some(refined),
        Seen::No => None,
        Seen::Cut => {
            slam.counts.cut += 1;
            None
        }
    }
}

/// How far a node's pose in a submap lies from the expected one, m.
fn distance(slam: &Slam, node: usize, submap: usize, anchor_from_node: Pose2) -> f64 {
    let poses = slam.back_end.poses();
    (poses[slam.submaps[submap].anchor] * anchor_from_node).distance(&poses[node])
}

/// A second match, of a node a few metres before, found in an equally large window at the place that the first match predicts.
fn witness(slam: &mut Slam, node: usize, place: &Place, refined: &Refined, laser: Point2<f64>) -> Option<Match> {
    let poses = slam.back_end.poses();
    let new_from_old = poses[slam.submaps[place.submap].anchor] * refined.pose * poses[node].inverse();
    // A witness is far from its expected pose, too, but the first match says where it must be: the usual margin is enough.
    let around = Around {
        far_margin: AMBIGUOUS,
        ..place.around
    };
    let mut last = node;
    for _ in 0..WITNESSES {
        let poses = slam.back_end.poses();
        let mut before = (slam.session_start()..last).rev();
        last = before.find(|second| poses[*second].distance(&poses[last]) >= WITNESS)?;
        let predicted = new_from_old * poses[last];
        let submap = neighbour(slam, last, place.submap, predicted)?;
        let Some(found) = searched(slam, last, submap, around, laser) else {
            continue;
        };
        let off = predicted.inverse() * slam.back_end.poses()[slam.submaps[submap].anchor] * found.pose;
        let agrees = off.x.hypot(off.y) <= APART.0 && off.yaw.abs() <= APART.1;
        return agrees.then_some((last, submap, found));
    }
    None
}

/// Of the submaps around one that a node has left behind, the one whose middle is nearest to a pose in the map.
fn neighbour(slam: &Slam, node: usize, submap: usize, pose: Pose2) -> Option<usize> {
    let distance = |submap: &usize| slam.back_end.poses()[slam.submaps[*submap].middle()].distance(&pose);
    let about = submap.saturating_sub(NEIGHBOURS)..(submap + NEIGHBOURS + 1).min(slam.submaps.len());
    let left = about.filter(|submap| is_left(slam, *submap, node));
    left.min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// Finds a scan's pose in a submap, around its expected pose, `anchor_from_base`. `scans`: those of the submap's map; `laser`: origin of
/// the beams in the base frame.
pub(crate) fn seen_again(
    submap: &mut Submap,
    scans: Scans<'_>,
    expected: Pose2,
    around: Around,
    laser: Point2<f64>,
    scan: &[Point2<f64>],
    settings: &SlamSettings,
) -> Seen {
    let closure = &settings.closure;
    let window = Window {
        min_score: closure.min_score,
        count: 2,
        apart: APART.0,
        apart_turn: APART.1,
        budget: around.budget,
        ..Window::around(expected, around.reach, around.turn)
    };
    let few = thinned(scan, SEARCH_POINTS);
    let mut found = search(submap.pyramid(), &few, &window);
    let Some(best) = found.found.first().copied().filter(|_| found.is_exact) else {
        return if found.is_exact { Seen::No } else { Seen::Cut };
    };
    let refined = submap.refine(&Refinable::seen_from(laser, scan), best.pose, None, &settings.refine);
    let is_far = refined.pose.distance(&expected) > closure.reach;
    let least_margin = if is_far { around.far_margin } else { AMBIGUOUS };
    let min_score = best.score - least_margin;
    if found.found.len() == 1 && min_score < closure.min_score {
        // A second place about as good counts even if it scores too little for a closure.
        found = search(submap.pyramid(), &few, &Window { min_score, ..window });
        if !found.is_exact {
            return Seen::Cut;
        }
    }
    if found.margin().unwrap_or_default() < least_margin {
        return Seen::No;
    }
    let verdict = judge(&submap.field, laser, scan, refined.pose, &settings.verdict);
    // Somebody who walked ahead of the robot has drawn a trail that looks like walls.
    let passes_what_stands = |submap: &mut Submap| {
        let standing = submap.standing(scans, &settings.verdict);
        judge(standing, laser, scan, refined.pose, &settings.verdict).through_walls > closure.through_walls
    };
    let fits = verdict.explained >= closure.explained
        && (verdict.through_walls <= closure.through_walls || !passes_what_stands(submap));
    if fits { Seen::At(refined) } else { Seen::No }
}

impl Around {
    /// The window within which a single scan is trusted.
    pub(crate) fn near(limits: &ClosureSettings) -> Self {
        Self {
            reach: limits.reach,
            turn: limits.turn,
            budget: limits.budget as usize,
            far_margin: AMBIGUOUS,
        }
    }
}

/// The measurement of a node in a submap of another time.
pub(crate) fn closure(anchor: usize, node: usize, refined: &Refined, settings: &SlamSettings) -> Edge {
    let front = &settings.front;
    Edge {
        from: anchor,
        to: node,
        measurement: refined.pose,
        information: floored(&refined.information, DOUBT * front.floor, DOUBT * front.floor_turn),
        kind: EdgeKind::Closure,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_scan_matching::Search;

    /// What a robot sees of a room of 4 m by 3 m with its left wall at `x`, except for the first `gap` m of the upper wall. In the lower left
    /// corner stands a pillar.
    fn room(x: f64, gap: f64) -> Vec<Point2<f64>> {
        let along = |from: f64, to: f64| {
            let count = ((to - from) / 0.05).round() as u32;
            (0..count).map(move |nth| from + 0.05 * f64::from(nth))
        };
        let lower = along(1.0, 4.0).map(|at| Point2::new(at, 0.0));
        let upper = along(gap, 4.0).map(|at| Point2::new(at, 3.0));
        let left = along(1.0, 3.0).map(|at| Point2::new(0.0, at));
        let right = along(0.0, 3.0).map(|at| Point2::new(4.0, at));
        let pillar = along(0.0, 1.0).flat_map(|at| [Point2::new(1.0, at), Point2::new(at, 1.0)]);
        let points = lower.chain(upper).chain(left).chain(right).chain(pillar);
        // Not on the edges of cells.
        points
            .map(|point| Point2::new(point.x + x + 0.02, point.y + 0.02))
            .collect()
    }

    /// The two best places of at least a score.
    fn two_best(submap: &mut Submap, scan: &[Point2<f64>], expected: Pose2, around: Around, min_score: f64) -> Search {
        let window = Window {
            min_score,
            count: 2,
            apart: APART.0,
            apart_turn: APART.1,
            budget: around.budget,
            ..Window::around(expected, around.reach, around.turn)
        };
        search(submap.pyramid(), &thinned(scan, SEARCH_POINTS), &window)
    }

    #[test]
    fn a_second_place_makes_a_closure_ambiguous_even_if_it_scores_too_little_for_one() {
        let scan = room(0.0, 0.0);
        // Beside the room stands one that lacks a bit of a wall.
        let seen = |has_second: bool, settings: &SlamSettings| {
            let mut submap = Submap::new(0, &settings.field);
            let second = has_second.then(|| room(6.0, 0.3));
            let walls: Vec<Point2<f64>> = scan.iter().copied().chain(second.into_iter().flatten()).collect();
            submap.insert(Pose2::IDENTITY, &Refinable::new(&walls));
            let around = Around {
                reach: 8.0,
                turn: 0.1,
                budget: 10_000_000,
                far_margin: FAR_AMBIGUOUS,
            };
            let scans = Scans {
                sessions: &[],
                points: &[],
            };
            let laser = Point2::new(2.0, 1.5);
            let expected = Pose2::IDENTITY;
            let best = two_best(&mut submap, &scan, expected, around, 0.0);
            let seen = seen_again(&mut submap, scans, expected, around, laser, &scan, settings);
            (best.found, seen)
        };
        let mut settings = SlamSettings::default();
        let (places, _) = seen(true, &settings);
        let [best, second] = places.as_slice() else {
            panic!("{places:?}")
        };
        let margin = best.score - second.score;
        assert!(margin > 0.0 && margin < AMBIGUOUS, "{places:?}");
        assert!(second.pose.distance(&Pose2::new(6.0, 0.0, 0.0)) < 0.1, "{places:?}");
        settings.closure.min_score = second.score + 0.5 * margin;
        assert!(matches!(seen(true, &settings).1, Seen::No));
        assert!(matches!(seen(false, &settings).1, Seen::At(..)), "without one");
    }

    #[test]
    fn a_place_elsewhere_is_searched_for_only_as_deep_as_the_margin_requires() {
        let (scan, laser, expected) = (room(0.0, 0.0), Point2::new(2.0, 1.5), Pose2::new(3.0, 0.0, 0.0));
        let mut settings = SlamSettings::default();
        // Far from where the scan is expected are its room, and one that lacks a metre of a wall.
        let mut submap = Submap::new(0, &settings.field);
        let walls: Vec<Point2<f64>> = scan.iter().copied().chain(room(6.0, 1.0)).collect();
        submap.insert(Pose2::IDENTITY, &Refinable::new(&walls));
        let ample = Around {
            reach: 8.0,
            turn: 0.1,
            budget: 10_000_000,
            far_margin: AMBIGUOUS,
        };
        let places = two_best(&mut submap, &scan, expected, ample, 0.0);
        let (best, margin) = (places.found[0].score, places.margin().unwrap_or_default());
        assert!((AMBIGUOUS..FAR_AMBIGUOUS).contains(&margin), "{places:?}");
        settings.closure.min_score = best - 0.01;
        // A budget that suffices for places within the smaller margin only.
        let budget = two_best(&mut submap, &scan, expected, ample, best - AMBIGUOUS).scored;
        let mut seen = |far_margin, budget| {
            let around = Around {
                far_margin,
                budget,
                ..ample
            };
            let scans = Scans {
                sessions: &[],
                points: &[],
            };
            seen_again(&mut submap, scans, expected, around, laser, &scan, &settings)
        };
        assert!(matches!(seen(AMBIGUOUS, budget), Seen::At(..)));
        assert!(matches!(seen(FAR_AMBIGUOUS, budget), Seen::Cut));
        assert!(matches!(seen(FAR_AMBIGUOUS, ample.budget), Seen::No));
    }
}
