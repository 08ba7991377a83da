//! Loop closure. Was the robot here before?

use nalgebra::Point2;
use zenav_pose_graph::{Edge, EdgeKind, GraphError};
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{Refined, Window, floored, judge, refine, search};

use crate::settings::SlamSettings;
use crate::slam::Slam;
use crate::submap::{SEARCH_POINTS, Submap, thinned};

/// A place that scores less below the best one is as good: the closure is ambiguous.
const AMBIGUOUS: f64 = 0.03;
/// Places nearer than this, m and rad, are one.
const APART: (f64, f64) = (0.5, 0.3);
/// A closure is known this much less well than a match with a submap that grows: its submap moved since.
const DOUBT: f64 = 2.0;

/// Searches a node's scan in older submaps, and adds what is found to the graph; returns how many closures that is. `laser`: where the
/// beams begin, in the frame of the base.
pub(crate) fn close(slam: &mut Slam, node: usize, laser: Point2<f64>) -> Result<usize, GraphError> {
    let settings = slam.settings;
    let limits = &settings.closure;
    let here = slam.back_end.poses()[node];
    let reach = (limits.reach + limits.reach_per_metre * slam.since_closure).min(limits.max_reach);
    let session = slam.session_start();
    let mut near: Vec<(f64, usize)> = (0..slam.submaps.len())
        .filter(|index| {
            let end = slam.submaps[*index].end();
            // What another session saw was left behind long ago.
            end <= session || end + limits.gap as usize <= node
        })
        .map(|index| {
            (
                slam.back_end.poses()[slam.submaps[index].middle()].distance(&here),
                index,
            )
        })
        .filter(|(distance, _)| *distance <= limits.near + reach)
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(limits.submaps as usize);
    let mut count = 0;
    for (_, index) in near {
        slam.counts.searched += 1;
        let submap = &mut slam.submaps[index];
        let expected = slam.back_end.poses()[submap.anchor].inverse() * here;
        if let Some(refined) = seen_again(submap, expected, reach, laser, &slam.scans[node], &settings) {
            let edge = closure(submap.anchor, node, &refined, &settings);
            slam.back_end.add_edge(edge)?;
            count += 1;
        }
    }
    slam.counts.found += count;
    if count > 0 {
        slam.is_dirty = true;
        slam.since_closure = 0.0;
    }
    Ok(count)
}

/// A scan's pose in a submap, as far as `reach`, m, from where it is expected, `anchor_from_base`. `None` where it does not fit well, or
/// elsewhere about as well. `laser`: where the beams begin, in the frame of the base.
pub(crate) fn seen_again(
    submap: &mut Submap,
    expected: Pose2,
    reach: f64,
    laser: Point2<f64>,
    scan: &[Point2<f64>],
    settings: &SlamSettings,
) -> Option<Refined> {
    let closure = &settings.closure;
    let window = Window {
        min_score: closure.min_score,
        count: 2,
        apart: APART.0,
        apart_turn: APART.1,
        budget: closure.budget as usize,
        ..Window::around(expected, reach, closure.turn)
    };
    let found = search(submap.pyramid(), &thinned(scan, SEARCH_POINTS), &window);
    let best = found.found.first()?;
    // A search that was cut does not know the second best place.
    if !found.is_exact || found.margin().is_some_and(|margin| margin < AMBIGUOUS) {
        return None;
    }
    let refined = refine(&submap.field, scan, best.pose, None, &settings.refine);
    let verdict = judge(&submap.field, laser, scan, refined.pose, &settings.verdict);
    let fits = verdict.explained >= closure.explained && verdict.through_walls <= closure.through_walls;
    fits.then_some(refined)
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
