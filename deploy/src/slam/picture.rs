//! Picture. The path by odometry, and the path in the map.

use nalgebra::{Point2, Vector2};
use zenav_pose_graph::EdgeKind;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_slam::Slam;

use crate::drawing::canvas::{Canvas, Color};
use crate::drawing::plane::{DEGENERATE, Mark, Plane, ROBOT, UNKNOWN};
use crate::failure::Failure;

const BEFORE: Color = [240, 150, 0];
const CLOSURE: Color = [30, 130, 76];
const REMATCH: Color = [178, 218, 196];
const FALSE: Color = [215, 60, 40];
/// Length of the longer side, px.
const SIZE: u32 = 1400;

/// The ways of a robot.
pub(super) struct Ways<'w> {
    /// By odometry; empty if it is not known.
    pub(super) before: &'w [Pose2],
    /// In the map.
    pub(super) after: &'w [Pose2],
    /// For each pose in the map whether its scan left a direction undetermined; empty if it is not known.
    pub(super) degenerate: &'w [bool],
}

/// The map, the path by odometry from the same start, the path in the map with its degenerate stretches, and the matches: loop closures,
/// matches of the finish, and those of either that are held to be false.
pub(super) fn draw(map: &OccupancyGrid, ways: &Ways<'_>, slam: &Slam) -> Result<Canvas, Failure> {
    let spec = map.spec();
    // The picture is limited to the surroundings of the map: odometry with much drift would shrink it to a speck.
    let margin = Vector2::repeat(0.05 * (spec.upper() - spec.origin).amax());
    let mut plane = Plane::new(spec.origin - margin, spec.upper() + margin, SIZE, "SLAM", UNKNOWN)?;
    plane.map(map);
    let matches = matches(slam);
    // Matches of the finish are many: what tells more is drawn over them.
    for (color, width) in [(REMATCH, 0.5), (CLOSURE, 1.0), (FALSE, 1.0)] {
        for (_, ends) in matches.iter().filter(|(kind, _)| *kind == color) {
            plane.polyline(ends, color, width);
        }
    }
    if let (Some(first), Some(start)) = (ways.before.first(), ways.after.first()) {
        let moved = *start * first.inverse();
        let way: Vec<Point2<f64>> = ways.before.iter().map(|pose| (moved * *pose).position()).collect();
        plane.polyline(&way, BEFORE, 1.0);
    }
    let way: Vec<Point2<f64>> = ways.after.iter().map(Pose2::position).collect();
    plane.polyline(&way, ROBOT, 1.5);
    for stretch in stretches(&way, ways.degenerate) {
        plane.polyline(stretch, DEGENERATE, 2.5);
    }
    plane.map_legend();
    plane.gap();
    if !ways.before.is_empty() {
        plane.legend(Mark::Line, BEFORE, "odometry trajectory");
    }
    plane.legend(Mark::Line, ROBOT, "SLAM trajectory");
    if !ways.degenerate.is_empty() {
        plane.legend(Mark::Line, DEGENERATE, "degenerate stretch");
    }
    plane.legend(Mark::Line, CLOSURE, "loop closure");
    plane.legend(Mark::Line, REMATCH, "match at the end");
    plane.legend(Mark::Line, FALSE, "rejected match");
    plane.finish()
}

/// The ends of all closures and matches of the finish, with their colours.
fn matches(slam: &Slam) -> Vec<(Color, [Point2<f64>; 2])> {
    let poses = slam.graph().poses();
    let flags = slam.weights().iter().zip(slam.rematches());
    let edges = slam.graph().edges().iter().zip(flags);
    edges
        .filter(|(edge, _)| edge.kind == EdgeKind::Closure)
        .map(|(edge, (weight, is_rematch))| {
            let color = match (*weight > 0.0, is_rematch) {
                (false, _) => FALSE,
                (true, true) => REMATCH,
                (true, false) => CLOSURE,
            };
            (color, [poses[edge.from].position(), poses[edge.to].position()])
        })
        .collect()
}

/// The degenerate stretches of a way, each from the pose before it.
fn stretches<'w>(way: &'w [Point2<f64>], is_degenerate: &[bool]) -> Vec<&'w [Point2<f64>]> {
    let mut begin = 0;
    let mut found = Vec::new();
    for run in is_degenerate.chunk_by(|a, b| a == b) {
        let end = begin + run.len();
        if run[0] {
            found.extend(way.get(begin.saturating_sub(1)..end));
        }
        begin = end;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degenerate_stretches_begin_at_the_pose_before_them() {
        let way: Vec<Point2<f64>> = (0..6).map(|x| Point2::new(f64::from(x), 0.0)).collect();
        let found = stretches(&way, &[true, false, false, true, true, false]);
        assert_eq!(found, [&way[..1], &way[2..5]]);
        assert!(stretches(&way, &[]).is_empty());
    }
}
