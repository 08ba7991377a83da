//! How is a search drawn? Map, tree, way, motion and drive on one canvas, as a PNG.

use nalgebra::Point2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::SearchTree;

use crate::canvas::{Canvas, Color, UNKNOWN};
use crate::failure::Failure;

const TREE: Color = [150, 190, 235];
const WAY: Color = [40, 110, 220];
const PLANNED: Color = [30, 160, 80];
const DRIVEN: Color = [215, 60, 40];
const GOAL: Color = [240, 150, 0];
const START: Color = [120, 60, 170];

/// A picture's longer side is about so many pixels.
const SIZE: u32 = 1200;
/// Most pixels a cell.
const MAX_ZOOM: u32 = 8;

/// What is drawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scene<'a> {
    pub map: &'a OccupancyGrid,
    /// What the planner searched, and its way.
    pub tree: Option<&'a SearchTree>,
    /// The motion in force.
    pub planned: &'a [Point2<f64>],
    /// The true way from the start.
    pub driven: &'a [Point2<f64>],
    pub goal: Option<Point2<f64>>,
}

/// Draws a scene.
///
/// # Errors
/// A map without cells.
pub(super) fn draw(scene: &Scene<'_>) -> Result<Vec<u8>, Failure> {
    let spec = *scene.map.spec();
    let longer = spec.width.max(spec.height).max(1);
    let zoom = (SIZE / longer).clamp(1, MAX_ZOOM);
    let scale = f64::from(zoom) / spec.resolution;
    let mut canvas = Canvas::new(spec.origin, scale, spec.width * zoom, spec.height * zoom, UNKNOWN);
    canvas.map(scene.map);
    if let Some(tree) = scene.tree {
        for [from, to] in &tree.edges {
            canvas.line(*from, *to, TREE, 0);
        }
        canvas.polyline(&tree.path, WAY, 1);
    }
    canvas.polyline(scene.planned, PLANNED, 1);
    canvas.polyline(scene.driven, DRIVEN, 1);
    if let Some(start) = scene.driven.first() {
        canvas.dot(*start, START, 4);
    }
    if let Some(goal) = scene.goal {
        canvas.dot(goal, GOAL, 5);
    }
    canvas.png()
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_mapping::image;
    use zenav_protocol::grid::{Cell, GridSpec, Occupancy};

    fn map() -> OccupancyGrid {
        let spec = GridSpec {
            origin: Point2::new(-1.0, -1.0),
            resolution: 0.1,
            width: 40,
            height: 20,
        };
        let mut map = OccupancyGrid::filled(spec, Occupancy::FREE);
        map[Cell::new(39, 0)] = Occupancy::OCCUPIED;
        map
    }

    #[test]
    fn a_drive_lies_where_it_was_driven() {
        let map = map();
        let driven = [Point2::new(-0.95, -0.95), Point2::new(2.5, -0.95)];
        let scene = Scene {
            map: &map,
            tree: None,
            planned: &[],
            driven: &driven,
            goal: None,
        };
        let bytes = draw(&scene).unwrap();
        let picture = image::decode(bytes).unwrap();
        assert_eq!((picture.width, picture.height), (40 * MAX_ZOOM, 20 * MAX_ZOOM));
        let gray = |x: u32, y: u32| picture.gray[(y * picture.width + x) as usize];
        let bottom = picture.height - 1;
        assert!(gray(100, bottom - 4) < 200, "the drive runs along the lowest row");
        assert_eq!(gray(100, 4), 255);
        assert!(
            gray(picture.width - 1, bottom) < 60,
            "the obstacle stands at the lower right"
        );
    }

    #[test]
    fn what_lies_beyond_the_map_or_nowhere_does_no_harm() {
        let far = [
            Point2::new(1e300, -1e300),
            Point2::new(f64::NAN, 0.0),
            Point2::new(0.0, 1e9),
        ];
        let tree = SearchTree {
            stamp: zenav_protocol::time::Stamp::ZERO,
            edges: vec![[far[0], far[1]], [far[2], Point2::origin()]],
            path: far.to_vec(),
        };
        let map = map();
        let scene = Scene {
            map: &map,
            tree: Some(&tree),
            planned: &far,
            driven: &far,
            goal: Some(far[0]),
        };
        assert!(draw(&scene).is_ok());
    }
}
