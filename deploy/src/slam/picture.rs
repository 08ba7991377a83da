//! Picture. The path by odometry, and the path in the map.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;

use crate::drawing::canvas::{Canvas, Color};
use crate::drawing::plane::{Mark, Plane, ROBOT, UNKNOWN};
use crate::failure::Failure;

const BEFORE: Color = [240, 150, 0];
const KEPT: Color = [30, 130, 76];
const FALSE: Color = [215, 60, 40];
/// Length of the longer side, px.
const SIZE: u32 = 1400;

/// The map, the path by odometry from the same start, the path in the map, and the loop closures: kept, and rejected.
pub(super) fn draw(
    map: &OccupancyGrid,
    before: &[Pose2],
    after: &[Pose2],
    kept: &[[Point2<f64>; 2]],
    dropped: &[[Point2<f64>; 2]],
) -> Result<Canvas, Failure> {
    let spec = map.spec();
    // The picture is limited to the surroundings of the map: odometry with much drift would shrink it to a speck.
    let margin = Vector2::repeat(0.05 * (spec.upper() - spec.origin).amax());
    let mut plane = Plane::new(spec.origin - margin, spec.upper() + margin, SIZE, "SLAM", UNKNOWN)?;
    plane.map(map);
    for [from, to] in kept {
        plane.polyline(&[*from, *to], KEPT, 0.5);
    }
    for [from, to] in dropped {
        plane.polyline(&[*from, *to], FALSE, 1.0);
    }
    if let (Some(first), Some(start)) = (before.first(), after.first()) {
        let moved = *start * first.inverse();
        let way: Vec<Point2<f64>> = before.iter().map(|pose| (moved * *pose).position()).collect();
        plane.polyline(&way, BEFORE, 1.0);
    }
    let way: Vec<Point2<f64>> = after.iter().map(Pose2::position).collect();
    plane.polyline(&way, ROBOT, 1.5);
    plane.map_legend();
    plane.gap();
    plane.legend(Mark::Line, BEFORE, "way by odometry");
    plane.legend(Mark::Line, ROBOT, "way in the map");
    plane.legend(Mark::Line, KEPT, "match kept");
    plane.legend(Mark::Line, FALSE, "match held false");
    plane.finish()
}
