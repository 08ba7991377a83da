//! Floor. One SVG of the final map as an image, with the driven path over it.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Point2, Vector2};
use zenav_protocol::grid::{Cell, Occupancy, OccupancyGrid};

use super::super::run::RobotRun;
use super::super::words;
use super::page::escape;
use crate::failure::Failure;

/// Margin around the drawn area, m.
const MARGIN: f64 = 0.3;
/// Picture units per metre: letters smaller than one unit would be drawn badly.
const SCALE: f64 = 100.0;
/// Most points of a path.
const POINTS: usize = 1500;
/// Longest side of the image, px: in larger maps a pixel covers several cells.
const LONGEST: u32 = 2000;
/// Lengths of scale bars, m.
const BARS: [f64; 8] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];

/// A rectangle of the plane, m.
#[derive(Clone, Copy, Debug)]
struct Area {
    low: Point2<f64>,
    high: Point2<f64>,
}

impl Area {
    fn around(points: impl Iterator<Item = Point2<f64>>) -> Option<Self> {
        let finite = points.filter(|point| point.x.is_finite() && point.y.is_finite());
        let area = finite.fold(None, |area: Option<Self>, point| {
            let area = area.unwrap_or(Self {
                low: point,
                high: point,
            });
            Some(Self {
                low: area.low.inf(&point),
                high: area.high.sup(&point),
            })
        })?;
        let margin = Vector2::repeat(MARGIN);
        Some(Self {
            low: area.low - margin,
            high: area.high + margin,
        })
    }
}

/// Bounds of the known cells: the first and the last column and row.
fn known(map: &OccupancyGrid) -> Option<(Cell, Cell)> {
    let spec = map.spec();
    let cells = map.values().iter().enumerate();
    let known = cells.filter(|(_, value)| Occupancy::of(**value) != Occupancy::Unknown);
    known.map(|(index, _)| spec.cell(index)).fold(None, |found, cell| {
        let (low, high) = found.unwrap_or((cell, cell));
        Some((
            Cell::new(low.x.min(cell.x), low.y.min(cell.y)),
            Cell::new(high.x.max(cell.x), high.y.max(cell.y)),
        ))
    })
}

/// The known part of a map as an image, with its extent.
fn image(map: &OccupancyGrid) -> Result<Option<(Vec<u8>, Area)>, Failure> {
    let Some((low, high)) = known(map) else {
        return Ok(None);
    };
    let spec = map.spec();
    let (columns, rows) = (high.x - low.x + 1, high.y - low.y + 1);
    let each = columns.max(rows).div_ceil(LONGEST);
    let (width, height) = (columns.div_ceil(each), rows.div_ceil(each));
    let mut pixels = Vec::with_capacity(width as usize * height as usize);
    for row in (0..height).rev() {
        for column in 0..width {
            // The most occupied of a pixel's cells, so that thin walls do not vanish.
            let mut worst = 0;
            for dy in 0..each {
                for dx in 0..each {
                    let cell = Cell::new(low.x + column * each + dx, low.y + row * each + dy);
                    let class = map.get(cell).map_or(Occupancy::Unknown, |value| Occupancy::of(*value));
                    worst = worst.max(match class {
                        Occupancy::Unknown => 0,
                        Occupancy::Free => 1,
                        Occupancy::Occupied => 2,
                    });
                }
            }
            pixels.push(worst);
        }
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(vec![0, 0, 0, 255, 255, 255, 40, 44, 52]);
    encoder.set_trns(vec![0, 255, 255]);
    encoder.set_compression(png::Compression::High);
    let mut writer = encoder.write_header().map_err(Failure::failed)?;
    writer.write_image_data(&pixels).map_err(Failure::failed)?;
    writer.finish().map_err(Failure::failed)?;
    let at = |x: u32, y: u32| spec.from_cells(Point2::new(f64::from(x), f64::from(y)));
    let corner = at(low.x, low.y);
    let area = Area {
        low: corner,
        high: at(low.x + width * each, low.y + height * each),
    };
    Ok(Some((bytes, area)))
}

/// The map with path, plan, goals and robot.
///
/// # Errors
/// The image cannot be made.
pub fn svg(robot: &RobotRun) -> Result<String, Failure> {
    let image = robot.map.as_ref().map(image).transpose()?.flatten();
    let goals = goals(robot);
    let points = robot.poses.iter().map(|(_, pose)| pose.position());
    let corners = image.iter().flat_map(|(_, area)| [area.low, area.high]);
    let all = points.chain(corners).chain(goals.iter().map(|(_, at)| *at));
    let Some(area) = Area::around(all) else {
        return Ok(String::new());
    };
    let extent = SCALE * (area.high - area.low);
    // Picture rows run downwards.
    let at = |point: Point2<f64>| (SCALE * (point.x - area.low.x), SCALE * (area.high.y - point.y));
    let unit = extent.amax() / 100.0;
    let mut svg = format!(
        "<svg class=\"floor\" viewBox=\"0 0 {:.1} {:.1}\" role=\"img\" aria-label=\"map with the path driven\">",
        extent.x, extent.y
    );
    if let Some((bytes, place)) = &image {
        let (x, y) = at(Point2::new(place.low.x, place.high.y));
        let size = SCALE * (place.high - place.low);
        let _ = write!(
            svg,
            "<image x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" preserveAspectRatio=\"none\" href=\"data:image/png;base64,{}\"/>",
            size.x,
            size.y,
            STANDARD.encode(bytes)
        );
    }
    let line = |class: &str, points: &mut dyn Iterator<Item = Point2<f64>>, width: f64| {
        let points: Vec<String> = points
            .map(|point| {
                let (x, y) = at(point);
                format!("{x:.1},{y:.1}")
            })
            .collect();
        format!(
            "<polyline class=\"{class}\" stroke-width=\"{width:.3}\" points=\"{}\"/>",
            points.join(" ")
        )
    };
    let step = robot.poses.len().div_ceil(POINTS).max(1);
    let last = robot.poses.last().map(|(_, pose)| pose.position());
    let mut path = robot
        .poses
        .iter()
        .step_by(step)
        .map(|(_, pose)| pose.position())
        .chain(last);
    svg.push_str(&line("plan", &mut robot.plan.iter().copied(), 0.4 * unit));
    svg.push_str(&line("path", &mut path, 0.6 * unit));
    let mut dot = |class: &str, point: Point2<f64>, radius: f64| {
        let (x, y) = at(point);
        let _ = write!(
            svg,
            "<circle class=\"{class}\" cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{radius:.3}\"/>"
        );
    };
    if let Some((_, start)) = robot.poses.first() {
        dot("start", start.position(), unit);
    }
    for (_, goal) in &goals {
        dot("goal", *goal, unit);
    }
    if let (Some((_, pose)), Some(model)) = (robot.poses.last(), &robot.model) {
        let corners: Vec<String> = words::outline(&model.footprint, 24)
            .into_iter()
            .map(|corner| {
                let (x, y) = at(pose.transform_point(corner));
                format!("{x:.1},{y:.1}")
            })
            .collect();
        let _ = write!(
            svg,
            "<polygon class=\"robot\" stroke-width=\"{:.3}\" points=\"{}\"/>",
            0.3 * unit,
            corners.join(" ")
        );
    }
    for (name, goal) in &goals {
        let (x, y) = at(*goal);
        let _ = write!(
            svg,
            "<text class=\"name\" style=\"font-size:{:.1}px\" x=\"{:.3}\" y=\"{:.3}\">{}</text>",
            2.6 * unit,
            x + 1.6 * unit,
            y - 1.2 * unit,
            escape(name)
        );
    }
    let bar = BARS
        .into_iter()
        .rev()
        .find(|bar| SCALE * *bar <= 0.25 * extent.x)
        .unwrap_or(BARS[0]);
    let (x, y) = (2.0 * unit, extent.y - 2.0 * unit);
    let _ = write!(
        svg,
        "<line class=\"bar\" stroke-width=\"{:.3}\" x1=\"{x:.3}\" x2=\"{:.3}\" y1=\"{y:.3}\" y2=\"{y:.3}\"/>\
         <text class=\"name\" style=\"font-size:{:.1}px\" x=\"{x:.3}\" y=\"{:.3}\">{bar} m</text></svg>",
        0.5 * unit,
        x + SCALE * bar,
        2.6 * unit,
        y - 1.2 * unit
    );
    Ok(svg)
}

/// Goal positions of the robot, each once.
fn goals(robot: &RobotRun) -> Vec<(String, Point2<f64>)> {
    let mut goals: Vec<(String, Point2<f64>)> = Vec::new();
    for goal in robot.goals.values() {
        let request = &goal.state.request;
        let asked = request.x.zip(request.y).map(|(x, y)| Point2::new(x, y));
        let legs = goal.state.legs.iter();
        let driven = legs.filter_map(|leg| Some((leg.name.clone(), leg.goal.map(|at| Point2::new(at.x, at.y))?)));
        let name = request.place.clone().unwrap_or_else(|| goal.state.id.clone());
        for (name, at) in driven.chain(asked.map(|at| (name, at))) {
            if !goals.iter().any(|(_, known)| (known - at).norm() < 0.05) {
                goals.push((name, at));
            }
        }
    }
    goals
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_protocol::geometry::Pose2;

    use super::*;

    #[test]
    fn the_image_is_of_what_is_known_with_the_highest_row_first() {
        let spec = zenav_fixtures::spec(6, 5, 0.5);
        let mut map = OccupancyGrid::filled(spec, Occupancy::UNKNOWN);
        (map[Cell::new(1, 1)], map[Cell::new(3, 2)]) = (Occupancy::FREE, Occupancy::OCCUPIED);
        let (bytes, area) = image(&map).unwrap().unwrap();
        assert_eq!((area.low, area.high), (Point2::new(0.5, 0.5), Point2::new(2.0, 1.5)));
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let info = reader.info();
        assert_eq!((info.width, info.height), (3, 2));
        let mut pixels = vec![0; 64];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels[..6], [0, 0, 2, 1, 0, 0]);
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
