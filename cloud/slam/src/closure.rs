//! Loop closure. Was the robot here before?

use nalgebra::Point2;
use zenav_pose_graph::{Edge, EdgeKind, GraphError};
use zenav_scan_matching::{Window, floored, judge, refine, search};

use crate::slam::Slam;
use crate::submap::thinned;

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
    let closure = &settings.closure;
    let here = slam.back_end.poses()[node];
    let reach = (closure.reach + closure.reach_per_metre * slam.since_closure).min(closure.max_reach);
    let mut near: Vec<(f64, usize)> = (0..slam.submaps.len())
        .filter(|index| slam.submaps[*index].end() + closure.gap as usize <= node)
        .map(|index| {
            (
                slam.back_end.poses()[slam.submaps[index].middle()].distance(&here),
                index,
            )
        })
        .filter(|(distance, _)| *distance <= closure.near + reach)
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(closure.submaps as usize);
    let mut count = 0;
    for (_, index) in near {
        slam.counts.searched += 1;
        let submap = &mut slam.submaps[index];
        let window = Window {
            min_score: closure.min_score,
            count: 2,
            apart: APART.0,
            apart_turn: APART.1,
            budget: closure.budget as usize,
            ..Window::around(
                slam.back_end.poses()[submap.anchor].inverse() * here,
                reach,
                closure.turn,
            )
        };
        let found = search(submap.pyramid(), &thinned(&slam.scans[node]), &window);
        let Some(best) = found.found.first() else {
            continue;
        };
        // A search that was cut does not know the second best place.
        if !found.is_exact || found.margin().is_some_and(|margin| margin < AMBIGUOUS) {
            continue;
        }
        let refined = refine(&submap.field, &slam.scans[node], best.pose, None, &settings.refine);
        let verdict = judge(&submap.field, laser, &slam.scans[node], refined.pose, &settings.verdict);
        if verdict.explained < closure.explained || verdict.through_walls > closure.through_walls {
            continue;
        }
        slam.back_end.add_edge(Edge {
            from: submap.anchor,
            to: node,
            measurement: refined.pose,
            information: floored(
                &refined.information,
                DOUBT * settings.front.floor,
                DOUBT * settings.front.floor_turn,
            ),
            kind: EdgeKind::Closure,
        })?;
        count += 1;
    }
    slam.counts.found += count;
    if count > 0 {
        slam.is_dirty = true;
        slam.since_closure = 0.0;
    }
    Ok(count)
}
