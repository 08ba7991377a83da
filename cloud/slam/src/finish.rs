//! Finish. The final poses, once all scans are known.

use nalgebra::Vector3;
use zenav_pose_graph::{Edge, EdgeKind, GraphError, RobustSolution};
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{Prior, Refinable, RefineSettings, Refined, floored};

use crate::session::laser_of;
use crate::slam::Slam;
use crate::step::SlamError;
use crate::submap::Submap;

/// Information that holds a scan in place along a direction, 1/m².
const HELD: f64 = 1e6;

/// Time of the solves, s by the caller's clock.
struct Solving<'c> {
    clock: &'c mut dyn FnMut() -> f64,
    time: f64,
}

impl Solving<'_> {
    fn measure<T>(&mut self, solve: impl FnOnce() -> T) -> T {
        let begin = (self.clock)();
        let result = solve();
        self.time += (self.clock)() - begin;
        result
    }
}

/// Decides on the closures, then in rounds: redraws submaps at the present poses, matches each scan to nearby submaps, and solves. Returns
/// also the time of the solves, s by `clock`.
pub(crate) fn finish(slam: &mut Slam, clock: &mut dyn FnMut() -> f64) -> Result<(RobustSolution, f64), SlamError> {
    let settings = slam.settings;
    let mut solving = Solving { clock, time: 0.0 };
    let points = slam.scans.clone();
    let seen_from = |(node, scan)| Refinable::seen_from(slam.laser_of(node), scan);
    let scans: Vec<Refinable<'_>> = points
        .iter()
        .map(|scan| scan.as_slice())
        .enumerate()
        .map(seen_from)
        .collect();
    slam.drop_solve();
    slam.back_end.drop_final()?;
    let mut solved = solving.measure(|| slam.back_end.solve(&settings.descent, &settings.robust))?;
    for _ in 0..settings.finish.rounds {
        redraw(slam, &scans);
        // Matches of the previous round belong to other submaps.
        slam.back_end.drop_final()?;
        for (node, scan) in scans.iter().enumerate() {
            rematch(slam, node, scan)?;
        }
        solving.measure(|| slam.back_end.settle(&settings.descent, &settings.robust))?;
    }
    if settings.finish.rounds > 0 {
        redraw(slam, &scans);
        replace(slam);
        solved = solving.measure(|| slam.back_end.solved(&settings.descent))?;
    }
    Ok((solved, solving.time))
}

/// Redraws all submaps.
fn redraw(slam: &mut Slam, scans: &[Refinable<'_>]) {
    let poses = slam.back_end.poses().to_vec();
    let field = slam.settings.field;
    for submap in &mut slam.submaps {
        let mut drawn = Submap::new(submap.anchor, &field);
        for node in submap.nodes() {
            drawn.insert(poses[submap.anchor].inverse() * poses[node], &scans[node]);
        }
        *submap = drawn;
    }
}

/// Matches a scan to the nearest submaps that it is not part of.
fn rematch(slam: &mut Slam, node: usize, scan: &Refinable<'_>) -> Result<(), GraphError> {
    let settings = slam.settings;
    let here = slam.back_end.poses()[node];
    let mut near: Vec<(f64, usize)> = (0..slam.submaps.len())
        .filter(|index| !slam.submaps[*index].nodes().contains(&node))
        .map(|index| {
            (
                slam.back_end.poses()[slam.submaps[index].middle()].distance(&here),
                index,
            )
        })
        .filter(|(distance, _)| *distance < settings.finish.near)
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(settings.finish.submaps as usize);
    for (_, index) in near {
        let submap = &slam.submaps[index];
        let expected = slam.back_end.poses()[submap.anchor].inverse() * here;
        let refined = refine_here(submap, scan, expected, &settings.refine);
        let is_near = refined.pose.distance(&expected) < settings.finish.max_move;
        if refined.score < settings.closure.min_score || !is_near || submap.anchor == node {
            continue;
        }
        let edge = Edge {
            from: submap.anchor,
            to: node,
            measurement: refined.pose,
            information: floored(&refined.information, settings.front.floor, settings.front.floor_turn),
            kind: EdgeKind::Closure,
        };
        slam.back_end.add_weighted(edge, 1.0, true)?;
    }
    Ok(())
}

/// Matches scans that are not nodes to their submaps.
fn replace(slam: &mut Slam) {
    let settings = slam.settings;
    let Slam {
        submaps,
        stands,
        sessions,
        ..
    } = slam;
    for stand in stands.iter_mut().filter(|stand| !stand.points.is_empty()) {
        let Ok(index) = submaps.binary_search_by_key(&stand.node, |submap| submap.anchor) else {
            continue;
        };
        let scan = Refinable::seen_from(laser_of(sessions, stand.node), &stand.points);
        let refined = refine_here(&submaps[index], &scan, stand.node_from_base, &settings.refine);
        let is_near = refined.pose.distance(&stand.node_from_base) < settings.finish.max_move;
        if is_near && refined.score >= settings.closure.min_score {
            stand.node_from_base = refined.pose;
        }
    }
}

/// Matches a scan around its present pose. Along a direction that the scan does not constrain there, the pose is held: elsewhere the ends
/// of the visible walls may fit each other and seem to constrain it.
fn refine_here(submap: &Submap, scan: &Refinable<'_>, here: Pose2, settings: &RefineSettings) -> Refined {
    let unmoved = RefineSettings {
        max_iterations: 0,
        ..*settings
    };
    let held = submap.refine(scan, here, None, &unmoved).degenerate.map(|along| {
        let along = Vector3::new(along.x, along.y, 0.0);
        Prior {
            pose: here,
            information: along * along.transpose() * HELD,
        }
    });
    submap
        .refine(scan, here, held.as_ref(), settings)
        .expected_where_degenerate(here)
}
