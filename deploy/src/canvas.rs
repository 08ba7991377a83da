//! How is something in the world painted? Pixels over a part of the plane, and a PNG of them.

use nalgebra::Point2;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};

use crate::failure::Failure;

/// Red, green, blue.
pub type Color = [u8; 3];

/// What is free.
pub const FREE: Color = [255, 255, 255];
/// What has not been seen.
pub const UNKNOWN: Color = [205, 208, 212];
/// What is solid.
pub const OCCUPIED: Color = [30, 34, 40];

/// Most steps of a line: what reaches far beyond a picture is cut off there.
const MOST_STEPS: f64 = 5000.0;

/// Pixels, rows from the top.
pub struct Canvas {
    low: Point2<f64>,
    /// Pixels a metre.
    scale: f64,
    width: u32,
    height: u32,
    pixels: Vec<u8>,
}

impl Canvas {
    /// A canvas of `width` by `height` pixels whose lower left corner lies at `low`, with `scale` pixels a metre.
    #[must_use]
    pub fn new(low: Point2<f64>, scale: f64, width: u32, height: u32, color: Color) -> Self {
        Self {
            low,
            scale,
            width,
            height,
            pixels: color.repeat(width as usize * height as usize),
        }
    }

    /// Paints a map wherever it lies on the canvas.
    pub fn map(&mut self, map: &OccupancyGrid) {
        for y in 0..self.height {
            for x in 0..self.width {
                let middle = self.point(f64::from(x) + 0.5, f64::from(y) + 0.5);
                if let Some(value) = map.at(middle) {
                    let color = match Occupancy::of(*value) {
                        Occupancy::Free => FREE,
                        Occupancy::Occupied => OCCUPIED,
                        Occupancy::Unknown => UNKNOWN,
                    };
                    self.set(i64::from(x), i64::from(y), color);
                }
            }
        }
    }

    /// Where a point lies, in pixels from the top left.
    fn pixel(&self, point: Point2<f64>) -> (f64, f64) {
        let off = (point - self.low) * self.scale;
        (off.x, f64::from(self.height) - off.y)
    }

    fn point(&self, x: f64, y: f64) -> Point2<f64> {
        self.low + nalgebra::Vector2::new(x, f64::from(self.height) - y) / self.scale
    }

    fn set(&mut self, x: i64, y: i64, color: Color) {
        let inside = (0..i64::from(self.width)).contains(&x) && (0..i64::from(self.height)).contains(&y);
        if inside {
            let at = (y as usize * self.width as usize + x as usize) * 3;
            if let Some(pixel) = self.pixels.get_mut(at..at + 3) {
                pixel.copy_from_slice(&color);
            }
        }
    }

    /// A dot of a radius in pixels.
    pub fn dot(&mut self, at: Point2<f64>, color: Color, radius: i64) {
        let (x, y) = self.pixel(at);
        // Casts saturate, and what is not a number is zero.
        let (x, y) = (x.floor() as i64, y.floor() as i64);
        for dy in -radius..=radius {
            for dx in -radius..=radius {
                if dx * dx + dy * dy <= radius * radius {
                    self.set(x.saturating_add(dx), y.saturating_add(dy), color);
                }
            }
        }
    }

    /// A line, half as thick as `radius` pixels.
    pub fn line(&mut self, from: Point2<f64>, to: Point2<f64>, color: Color, radius: i64) {
        let way = (to - from) * self.scale;
        let steps = way.amax().ceil().clamp(1.0, MOST_STEPS);
        for step in 0..=steps as u32 {
            self.dot(from + (to - from) * (f64::from(step) / steps), color, radius);
        }
    }

    /// Lines from point to point.
    pub fn polyline(&mut self, points: &[Point2<f64>], color: Color, radius: i64) {
        for pair in points.windows(2) {
            self.line(pair[0], pair[1], color, radius);
        }
    }

    /// Lines from point to point, and back to the first.
    pub fn outline(&mut self, corners: &[Point2<f64>], color: Color, radius: i64) {
        for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            self.line(*from, *to, color, radius);
        }
    }

    /// A filled polygon.
    pub fn polygon(&mut self, corners: &[Point2<f64>], color: Color) {
        let corners: Vec<(f64, f64)> = corners.iter().map(|corner| self.pixel(*corner)).collect();
        let rows = corners.iter().map(|(_, y)| *y);
        let (top, bottom) = (
            rows.clone().fold(f64::INFINITY, f64::min),
            rows.fold(f64::NEG_INFINITY, f64::max),
        );
        for row in top.floor().max(0.0) as i64..=bottom.ceil().min(f64::from(self.height)) as i64 {
            let middle = row as f64 + 0.5;
            let edges = corners.iter().zip(corners.iter().cycle().skip(1));
            let mut crossings: Vec<f64> = edges
                .filter(|((_, from), (_, to))| (*from > middle) != (*to > middle))
                .map(|((x, from), (to_x, to))| x + (to_x - x) * (middle - from) / (to - from))
                .collect();
            crossings.sort_by(f64::total_cmp);
            for pair in crossings.chunks_exact(2) {
                let (first, last) = (pair[0].round().max(0.0), pair[1].round().min(f64::from(self.width)));
                for x in first as i64..last as i64 {
                    self.set(x, row, color);
                }
            }
        }
    }

    /// A filled disc of a radius in metres.
    pub fn disc(&mut self, center: Point2<f64>, radius: f64, color: Color) {
        self.polygon(&circle(center, radius), color);
    }

    /// A PNG.
    ///
    /// # Errors
    /// A canvas without pixels.
    pub fn png(&self) -> Result<Vec<u8>, Failure> {
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

/// A circle as a polygon.
#[must_use]
pub fn circle(center: Point2<f64>, radius: f64) -> Vec<Point2<f64>> {
    const CORNERS: u32 = 48;
    (0..CORNERS)
        .map(|corner| std::f64::consts::TAU * f64::from(corner) / f64::from(CORNERS))
        .map(|angle| center + nalgebra::Vector2::new(angle.cos(), angle.sin()) * radius)
        .collect()
}
