//! Floor. One SVG of the final map as an image, with the driven path over it.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use nalgebra::Point2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{GoalState, Leg};

use super::super::run::RobotRun;
use crate::drawing::plane::{around, outline, round_below};
use crate::failure::Failure;
use crate::goal::target;
use crate::output::escape;

/// Margin around the drawn area, m.
const MARGIN: f64 = 0.3;
/// Picture units per metre: letters smaller than one unit would be drawn badly.
const SCALE: f64 = 100.0;
/// Most points of a path.
const POINTS: usize = 1500;
/// Longest side of the image, px: in larger maps a pixel covers several cells.
const LONGEST: u32 = 2000;
/// Name of a drive whose node has none of its own.
const UNNAMED: &str = "FollowPath";

/// Lower-left and upper-right corner of a part of the plane, m.
type Area = (Point2<f64>, Point2<f64>);

/// The known part of a map as an image, with its extent.
fn image(map: &OccupancyGrid) -> Result<Option<(Vec<u8>, Area)>, Failure> {
    let Some([low, high]) = map.known() else {
        return Ok(None);
    };
    let side = (high.x - low.x).max(high.y - low.y) + 1;
    // A pixel is occupied if any of its cells is, so that thin walls do not vanish.
    let pixels = map.coarse([low, high], side.div_ceil(LONGEST));
    let spec = pixels.spec();
    let rows = pixels.values().chunks_exact(spec.width as usize).rev();
    let indices: Vec<u8> = rows.flatten().map(|class| *class as u8).collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, spec.width, spec.height);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    // Unknown, free, occupied.
    encoder.set_palette(vec![0, 0, 0, 255, 255, 255, 40, 44, 52]);
    encoder.set_trns(vec![0, 255, 255]);
    encoder.set_compression(png::Compression::High);
    let mut writer = encoder.write_header().map_err(Failure::failed)?;
    writer.write_image_data(&indices).map_err(Failure::failed)?;
    writer.finish().map_err(Failure::failed)?;
    Ok(Some((bytes, (spec.origin, spec.upper()))))
}

/// The map with path, plan, goals and robot.
///
/// # Errors
/// The image cannot be made.
pub fn svg(robot: &RobotRun) -> Result<String, Failure> {
    let image = robot.map.as_ref().map(image).transpose()?.flatten();
    let goals = places(robot.goals.values().map(|goal| &goal.state));
    let points = robot.poses.iter().map(|(_, pose)| pose.position());
    let corners = image.iter().flat_map(|(_, (low, high))| [*low, *high]);
    let all = points.chain(corners).chain(goals.iter().map(|(_, at)| *at));
    let Some((low, high)) = around(all, MARGIN) else {
        return Ok(String::new());
    };
    let extent = SCALE * (high - low);
    // Picture rows run downwards.
    let at = |point: Point2<f64>| (SCALE * (point.x - low.x), SCALE * (high.y - point.y));
    let unit = extent.amax() / 100.0;
    // The scale bar is below the drawn area.
    let height = extent.y + 4.0 * unit;
    let mut svg = format!(
        "<svg class=\"floor\" viewBox=\"0 0 {:.1} {height:.1}\" role=\"img\" aria-label=\"map with the path driven\">",
        extent.x
    );
    if let Some((bytes, (low, high))) = &image {
        let (x, y) = at(Point2::new(low.x, high.y));
        let size = SCALE * (high - low);
        let _ = write!(
            svg,
            "<image x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" preserveAspectRatio=\"none\" href=\"data:image/png;base64,{}\"/>",
            size.x,
            size.y,
            STANDARD.encode(bytes)
        );
    }
    let traced = |element: &str, class: &str, points: &mut dyn Iterator<Item = Point2<f64>>, width: f64| {
        let points = points.map(at).map(|(x, y)| format!("{x:.1},{y:.1}"));
        let points = points.collect::<Vec<_>>().join(" ");
        let width = width * unit;
        format!("<{element} class=\"{class}\" stroke-width=\"{width:.3}\" points=\"{points}\"/>")
    };
    let dot = |class: &str, point: Point2<f64>, radius: f64| {
        let (x, y) = at(point);
        format!("<circle class=\"{class}\" cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{radius:.3}\"/>")
    };
    let words = |x: f64, y: f64, words: &str| {
        let size = 2.6 * unit;
        format!("<text class=\"name\" style=\"font-size:{size:.1}px\" x=\"{x:.3}\" y=\"{y:.3}\">{words}</text>")
    };
    let path = robot.poses.iter().map(|(_, pose)| pose.position());
    let step = robot.poses.len().div_ceil(POINTS).max(1);
    let mut thinned = path.clone().step_by(step).chain(path.clone().next_back());
    svg.push_str(&traced("polyline", "plan", &mut robot.plan.iter().copied(), 0.4));
    svg.push_str(&traced("polyline", "path", &mut thinned, 0.6));
    svg.extend(
        robot
            .poses
            .first()
            .map(|(_, start)| dot("start", start.position(), unit)),
    );
    svg.extend(goals.iter().map(|(_, goal)| dot("goal", *goal, unit)));
    if let (Some((_, pose)), Some(model)) = (robot.poses.last(), &robot.model) {
        let mut corners = outline(&model.footprint)
            .into_iter()
            .map(|corner| pose.transform_point(corner));
        svg.push_str(&traced("polygon", "robot", &mut corners, 0.3));
    }
    for (name, goal) in &goals {
        let (x, y) = at(*goal);
        svg.push_str(&words(x + 1.6 * unit, y - 1.2 * unit, &escape(name)));
    }
    let bar = round_below(0.25 * extent.x / SCALE);
    let (x, y) = (2.0 * unit, height - 2.0 * unit);
    let _ = write!(
        svg,
        "<line class=\"bar\" stroke-width=\"{:.3}\" x1=\"{x:.3}\" x2=\"{:.3}\" y1=\"{y:.3}\" y2=\"{y:.3}\"/>{}</svg>",
        0.5 * unit,
        x + SCALE * bar,
        words(x, y - 1.2 * unit, &format!("{bar} m"))
    );
    Ok(svg)
}

/// Goal positions, each once: named after the node that drove there, or if that has no name of its own, after what was asked for.
fn places<'g>(states: impl Iterator<Item = &'g GoalState>) -> Vec<(String, Point2<f64>)> {
    let mut goals: Vec<(String, Point2<f64>)> = Vec::new();
    for GoalState { request, legs, .. } in states {
        let asked = request.x.zip(request.y).map(|(x, y)| Point2::new(x, y));
        let own = target(request);
        let named = |leg: &Leg| {
            if leg.name == UNNAMED {
                own.clone()
            } else {
                leg.name.clone()
            }
        };
        let driven = legs
            .iter()
            .filter_map(|leg| Some((named(leg), leg.goal.map(|at| Point2::new(at.x, at.y))?)));
        for (name, at) in driven.chain(asked.map(|at| (own.clone(), at))) {
            if !goals.iter().any(|(_, known)| (known - at).norm() < 0.05) {
                goals.push((name, at));
            }
        }
    }
    goals
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::grid::{Cell, Occupancy};

    use super::*;

    #[test]
    fn the_image_is_of_what_is_known_with_the_highest_row_first() {
        let spec = zenav_fixtures::spec(6, 5, 0.5);
        let mut map = OccupancyGrid::filled(spec, Occupancy::UNKNOWN);
        (map[Cell::new(1, 1)], map[Cell::new(3, 2)]) = (Occupancy::FREE, Occupancy::OCCUPIED);
        let (bytes, area) = image(&map).unwrap().unwrap();
        assert_eq!(area, (Point2::new(0.5, 0.5), Point2::new(2.0, 1.5)));
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let info = reader.info();
        assert_eq!((info.width, info.height), (3, 2));
        let mut pixels = vec![0; 64];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels[..6], [0, 0, 2, 1, 0, 0]);
    }

    #[test]
    fn a_goal_has_the_name_that_was_asked_for_unless_its_drive_has_one() {
        let goal = |request: serde_json::Value, drive: &str| -> GoalState {
            let leg =
                serde_json::json!({ "name": drive, "goal": { "x": 1.0, "y": 2.0 }, "started": 0, "state": "Active" });
            let state = serde_json::json!({
                "id": "g", "robot": "r", "state": "Active", "reason": null, "accepted": 0, "request": request, "legs": [leg]
            });
            serde_json::from_value(state).unwrap()
        };
        for (request, drive, name) in [
            (serde_json::json!({ "place": "sink" }), UNNAMED, "sink"),
            (serde_json::json!({ "x": 1.0, "y": 2.0 }), UNNAMED, "1.00, 2.00"),
            (serde_json::json!({ "tree": "kitchen" }), "to the table", "to the table"),
        ] {
            let found = places([goal(request, drive)].iter());
            assert_eq!(found, [(name.to_owned(), Point2::new(1.0, 2.0))]);
        }
    }

    #[test]
    fn a_robot_without_a_map_has_its_path() {
        let robot = RobotRun {
            poses: vec![(0.0, Pose2::IDENTITY), (1.0, Pose2::new(2.0, 1.0, 0.0))],
            ..RobotRun::default()
        };
        let svg = svg(&robot).unwrap();
        assert!(svg.contains("class=\"path\"") && !svg.contains("<image"), "{svg}");
        assert_eq!(super::svg(&RobotRun::default()).unwrap(), "");
    }
}
