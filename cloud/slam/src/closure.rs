//! Loop closure. Was the robot here before?
//!
//! How far about a node is searched follows from how well it is known as seen from the old submap ([`drift`](crate::drift)). A wide window is
//! searched as much more rarely as it is larger, so that the work for each scan stays the same. A match far from where the node was
//! expected is taken only where a second scan, from a few metres before, is found on the same place.

use nalgebra::Point2;
use zenav_pose_graph::{Edge, EdgeKind, GraphError, Uncertain};
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{Refinable, Refined, Window, floored, judge, search};

use crate::drift::spread;
use crate::settings::{ClosureSettings, SlamSettings};
use crate::slam::Slam;
use crate::submap::{SEARCH_POINTS, Submap, thinned};

/// A place that scores less below the best one is as good: the closure is ambiguous.
const AMBIGUOUS: f64 = 0.03;
/// The same for a match far from where it was expected: along a row of equal doors the place that is seen whole beats the true one by some.
const FAR_AMBIGUOUS: f64 = 0.1;
/// Places nearer than this, m and rad, are one.
const APART: (f64, f64) = (0.5, 0.3);
/// A closure is known this much less well than a match with a submap that grows: its submap moved since.
pub(crate) const DOUBT: f64 = 2.0;
/// Standard deviations that a window reaches to each side.
const DEVIATIONS: f64 = 3.0;
/// No window reaches farther than this many times [`ClosureSettings::near`].
const WIDEST: f64 = 10.0;
/// A window is as large as so many usual ones, at most.
const LARGEST: f64 = 100.0;
/// Scans that may confirm a match lie at least this far from it and from each other, m: each sees something else.
const WITNESS: f64 = 3.0;
/// How many are asked, at most: a person, or a door that was open then, hides the place from one.
const WITNESSES: usize = 4;
/// They are searched for in submaps so many before or after that of the match: how these lie to each other is well known.
const NEIGHBOURS: usize = 3;

/// Where a node is searched for.
#[derive(Clone, Copy, Debug)]
struct Place {
    submap: usize,
    /// From the node to the middle of the submap, m.
    distance: f64,
    around: Around,
    /// A search takes about so many times as long as a usual one: bounds leave most of the plane out, work grows with its width alone.
    size: u64,
}

/// A window about where a scan is expected.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Around {
    /// To each side, m.
    pub(crate) reach: f64,
    /// To each side, rad.
    pub(crate) turn: f64,
    /// Blocks that the search may score.
    pub(crate) budget: usize,
}

/// A node, the submap in which it was found, and its pose there.
type Match = (usize, usize, Refined);

/// What a search says.
pub(crate) enum Seen {
    /// Nothing fits well, or another place about as well.
    No,
    /// The budget was spent before that was known.
    Cut,
    /// The scan's pose in the submap, and by how much it scores higher than any other place.
    At(Refined, f64),
}

/// Searches a node's scan in older submaps, and adds what is found to the graph; returns how many closures that is. `laser`: where the
/// beams begin, in the frame of the base.
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

/// The match of a node in a place, and where it lies far off the one that confirms it: nodes, each with its submap and its pose there.
fn matches(slam: &mut Slam, node: usize, place: &Place, laser: Point2<f64>) -> Vec<Match> {
    let Some((refined, margin)) = searched(slam, node, place.submap, place.around, laser) else {
        return Vec::new();
    };
    let own = (node, place.submap, refined);
    if distance(slam, node, place.submap, refined.pose) <= slam.settings.closure.reach {
        return vec![own];
    }
    if margin < FAR_AMBIGUOUS {
        return Vec::new();
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
    // A large window that has its turn goes first: the others have theirs each time.
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
        },
        size,
    }
}

/// Whether a submap was left behind long ago: what another session saw always was.
fn is_left(slam: &Slam, submap: usize, node: usize) -> bool {
    let end = slam.submaps[submap].end();
    end <= slam.session_start() || end + slam.settings.closure.gap as usize <= node
}

/// A node's scan in a submap, about where it is expected.
fn searched(slam: &mut Slam, node: usize, submap: usize, around: Around, laser: Point2<f64>) -> Option<(Refined, f64)> {
    slam.counts.searched += 1;
    let poses = slam.back_end.poses();
    let submap = &mut slam.submaps[submap];
    let expected = poses[submap.anchor].inverse() * poses[node];
    match seen_again(submap, expected, around, laser, &slam.scans[node], &slam.settings) {
        Seen::At(refined, margin) => Some((refined, margin)),
        Seen::No => None,
        Seen::Cut => {
            slam.counts.cut += 1;
            None
        }
    }
}

/// How far from where it was expected, m, a node lies in a submap.
fn distance(slam: &Slam, node: usize, submap: usize, anchor_from_node: Pose2) -> f64 {
    let poses = slam.back_end.poses();
    (poses[slam.submaps[submap].anchor] * anchor_from_node).distance(&poses[node])
}

/// The match of a node a few metres before, searched for in as large a window, that puts it where the match of this one says.
fn witness(slam: &mut Slam, node: usize, place: &Place, refined: &Refined, laser: Point2<f64>) -> Option<Match> {
    let poses = slam.back_end.poses();
    let new_from_old = poses[slam.submaps[place.submap].anchor] * refined.pose * poses[node].inverse();
    let mut last = node;
    for _ in 0..WITNESSES {
        let poses = slam.back_end.poses();
        let mut before = (slam.session_start()..last).rev();
        last = before.find(|second| poses[*second].distance(&poses[last]) >= WITNESS)?;
        let predicted = new_from_old * poses[last];
        let submap = neighbour(slam, last, place.submap, predicted)?;
        let Some((found, _)) = searched(slam, last, submap, place.around, laser) else {
            continue;
        };
        let off = predicted.inverse() * slam.back_end.poses()[slam.submaps[submap].anchor] * found.pose;
        let agrees = off.x.hypot(off.y) <= APART.0 && off.yaw.abs() <= APART.1;
        return agrees.then_some((last, submap, found));
    }
    None
}

/// Of the submaps about one, those that a node left behind, the one whose middle lies nearest to a pose in the map.
fn neighbour(slam: &Slam, node: usize, submap: usize, pose: Pose2) -> Option<usize> {
    let distance = |submap: &usize| slam.back_end.poses()[slam.submaps[*submap].middle()].distance(&pose);
    let about = submap.saturating_sub(NEIGHBOURS)..(submap + NEIGHBOURS + 1).min(slam.submaps.len());
    let left = about.filter(|submap| is_left(slam, *submap, node));
    left.min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// A scan's pose in a submap, about where it is expected, `anchor_from_base`. `laser`: where the beams begin, in the frame of the base.
pub(crate) fn seen_again(
    submap: &mut Submap,
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
    let found = search(submap.pyramid(), &thinned(scan, SEARCH_POINTS), &window);
    if !found.is_exact {
        // The second best place is not known.
        return Seen::Cut;
    }
    let Some(best) = found.found.first() else {
        return Seen::No;
    };
    let margin = found.margin().unwrap_or_default();
    if margin < AMBIGUOUS {
        return Seen::No;
    }
    let refined = submap.refine(&Refinable::seen_from(laser, scan), best.pose, None, &settings.refine);
    let verdict = judge(&submap.field, laser, scan, refined.pose, &settings.verdict);
    let fits = verdict.explained >= closure.explained && verdict.through_walls <= closure.through_walls;
    if fits { Seen::At(refined, margin) } else { Seen::No }
}

impl Around {
    /// No farther than a scan is trusted alone.
    pub(crate) fn near(limits: &ClosureSettings) -> Self {
        Self {
            reach: limits.reach,
            turn: limits.turn,
            budget: limits.budget as usize,
        }
    }
}

/// The measurement of a node in the submap of another time.
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
