//! Join. Combines two graphs into one.

use nalgebra::{Matrix3, Vector3};
use zenav_pose_graph::{Edge, EdgeKind, GraphError};
use zenav_protocol::geometry::Pose2;

use crate::closure::{Around, Seen, closure, seen_again};
use crate::fixes::Factor;
use crate::slam::Slam;
use crate::submap::Scans;

/// Standard deviation of one map's pose in the other by votes alone, m and rad. This measurement is trusted and holds the graph together;
/// the closures beside it are a hundred times as exact and determine the pose.
const SIGMA: (f64, f64) = (0.5, 0.2);
/// Least share of the scans looked for that are seen again. Many are not, even in true matches: people stand in the way, and a submap
/// covers only a few metres.
const SEEN_AGAIN: f64 = 0.05;

/// Closures between the nodes of two maps: scans of `newer` found again in submaps of `older`, near where `older_from_newer` predicts. Ends
/// are indices in their own maps. Empty if too few were found.
pub(crate) fn closures(older: &mut Slam, newer: &Slam, older_from_newer: Pose2) -> Vec<Edge> {
    let settings = older.settings;
    let limits = &settings.closure;
    let (mut asked, mut found) = (0.0, Vec::new());
    for node in (0..newer.scans.len()).step_by(limits.every as usize) {
        let here = older_from_newer * newer.nodes()[node];
        let Some(index) = older.nearest_submap(here) else {
            continue;
        };
        asked += 1.0;
        let expected = older.nodes()[older.submaps[index].anchor].inverse() * here;
        let submap = &mut older.submaps[index];
        let scans = Scans {
            sessions: &older.sessions,
            points: &older.scans,
        };
        let (laser, scan) = (newer.laser_of(node), &newer.scans[node]);
        let around = Around::near(limits);
        if let Seen::At(refined) = seen_again(submap, scans, expected, around, laser, scan, &settings) {
            found.push(closure(submap.anchor, node, &refined, &settings));
        }
    }
    if (found.len() as f64) < SEEN_AGAIN * asked {
        found.clear();
    }
    found
}

/// Joins two maps: `newer`, the current one, after `older`, with the closures between them.
pub(crate) fn joined(older: Slam, newer: Slam, older_from_newer: Pose2, closures: &[Edge]) -> Result<Slam, GraphError> {
    let offset = older.scans.len();
    let mut back_end = older.back_end;
    for pose in newer.back_end.poses() {
        back_end.add_node(older_from_newer * *pose)?;
    }
    let (sigma, turn) = SIGMA;
    if let Some(first) = closures.first() {
        let to = offset + first.to;
        back_end.add_edge(Edge {
            to,
            measurement: back_end.poses()[first.from].inverse() * back_end.poses()[to],
            information: Matrix3::from_diagonal(&Vector3::new(sigma, sigma, turn).map(|sigma| sigma.powi(-2))),
            kind: EdgeKind::Odometry,
            ..*first
        })?;
    }
    for (edge, weight, is_final) in newer.back_end.edges() {
        let moved = Edge {
            from: offset + edge.from,
            to: offset + edge.to,
            ..*edge
        };
        back_end.add_weighted(moved, weight, is_final)?;
    }
    for edge in closures {
        back_end.add_edge(Edge {
            to: offset + edge.to,
            ..*edge
        })?;
    }
    for factor in newer.back_end.factors() {
        let node = offset + factor.node;
        back_end.add_factor(Factor { node, ..*factor });
    }
    let submaps = newer.submaps.into_iter().map(|mut submap| {
        submap.anchor += offset;
        submap
    });
    let mut stands = older.stands;
    stands.extend(newer.stands.into_iter().map(|mut stand| {
        stand.node += offset;
        stand
    }));
    let mut counts = newer.counts;
    counts.found += closures.len();
    Ok(Slam {
        settings: older.settings,
        back_end,
        scans: older.scans.into_iter().chain(newer.scans).collect(),
        submaps: older.submaps.into_iter().chain(submaps).collect(),
        stands,
        sessions: older.sessions.into_iter().chain(newer.sessions).collect(),
        older: None,
        start: older.start,
        is_dirty: true,
        solve: None,
        adopts_at: None,
        counts,
        ..newer
    })
}
