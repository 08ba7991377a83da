//! How is a search drawn? Map, tree, way, motion and drive on one canvas, as a PNG.

use nalgebra::Point2;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::SearchTree;

use crate::failure::Failure;

/// Red, green, blue.
type Color = [u8; 3];

const FREE: Color = [255, 255, 255];
const UNKNOWN: Color = [205, 208, 212];
const OCCUPIED: Color = [30, 34, 40];
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
    let mut canvas = Canvas::of(scene.map);
    if let Some(tree) = scene.tree {
        for [from, to] in &tree.edges {
            canvas.line(*from, *to, TREE, 0);
        }
        canvas.polyline(&tree.path, WAY, 1);
    }
    canvas.polyline(scene.planned, PLANNED, 1);
    canvas.polyline(scene.driven, DRIVEN, 1);
    if let Some(start) = scene.driven.first() {
        canvas.dot(canvas.pixel(*start), START, 4);
    }
    if let Some(goal) = scene.goal {
        canvas.dot(canvas.pixel(goal), GOAL, 5);
    }
    canvas.png()
}

/// Pixels, rows from the top.
struct Canvas {
    spec: GridSpec,
    zoom: u32,
    width: u32,
    height: u32,
    pixels: Vec<u8>,
}

impl Canvas {
    /// The map's cells as squares; of a map that is larger than a picture, every so many cells.
    fn of(map: &OccupancyGrid) -> Self {
        let spec = *map.spec();
        let longer = spec.width.max(spec.height).max(1);
        let zoom = (SIZE / longer).clamp(1, MAX_ZOOM);
        let (width, height) = (spec.width * zoom, spec.height * zoom);
        let mut pixels = Vec::with_capacity(width as usize * height as usize * 3);
        for y in (0..height).rev() {
            for x in 0..width {
                let value = map.get(Cell::new(x / zoom, y / zoom)).copied();
                pixels.extend(match value.map(Occupancy::of) {
                    Some(Occupancy::Free) => FREE,
                    Some(Occupancy::Occupied) => OCCUPIED,
                    Some(Occupancy::Unknown) | None => UNKNOWN,
                });
            }
        }
        Self {
            spec,
            zoom,
            width,
            height,
            pixels,
        }
    }

    /// Where a point of the map lies, in pixels from the top left.
    fn pixel(&self, point: Point2<f64>) -> (f64, f64) {
        let cells = self.spec.to_cells(point) * f64::from(self.zoom);
        (cells.x, f64::from(self.height) - cells.y)
    }

    fn dot(&mut self, (x, y): (f64, f64), color: Color, radius: i64) {
        // Casts saturate, and what is not a number is zero.
        let (x, y) = (x.floor() as i64, y.floor() as i64);
        for dy in -radius..=radius {
            for dx in -radius..=radius {
                let (x, y) = (x.saturating_add(dx), y.saturating_add(dy));
                let inside = (0..i64::from(self.width)).contains(&x) && (0..i64::from(self.height)).contains(&y);
                if inside && dx * dx + dy * dy <= radius * radius {
                    let at = (y as usize * self.width as usize + x as usize) * 3;
                    if let Some(pixel) = self.pixels.get_mut(at..at + 3) {
                        pixel.copy_from_slice(&color);
                    }
                }
            }
        }
    }

    fn line(&mut self, from: Point2<f64>, to: Point2<f64>, color: Color, radius: i64) {
        let (from, to) = (self.pixel(from), self.pixel(to));
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        // What reaches far beyond the picture is cut off there.
        let steps = dx.abs().max(dy.abs()).ceil().clamp(1.0, 4.0 * f64::from(SIZE));
        for step in 0..=steps as u32 {
            let share = f64::from(step) / steps;
            self.dot((from.0 + share * dx, from.1 + share * dy), color, radius);
        }
    }

    fn polyline(&mut self, points: &[Point2<f64>], color: Color, radius: i64) {
        for pair in points.windows(2) {
            self.line(pair[0], pair[1], color, radius);
        }
    }

    fn png(&self) -> Result<Vec<u8>, Failure> {
        let failed = |error: png::EncodingError| Failure::failed(format!("a picture: {error}"));
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width, self.height);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_color(png::ColorType::Rgb);
        let mut writer = encoder.write_header().map_err(failed)?;
        writer.write_image_data(&self.pixels).map_err(failed)?;
        writer.finish().map_err(failed)?;
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_cloud::mapping::image;

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
