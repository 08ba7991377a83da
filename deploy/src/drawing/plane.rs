//! A part of the plane. The plane on the left, scaled to pixels; beside it a panel with title, notes, a legend and a scale bar.

use std::ops::Range;

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{Plan, Scan};
use zenav_protocol::robot::Footprint;

use super::canvas::{Anchor, Canvas, Color, Face, GREY, INK, Pixel, WHITE, text_width};
use crate::failure::Failure;

/// Free space.
pub const FREE: Color = WHITE;
/// Unknown space.
pub const UNKNOWN: Color = [205, 208, 212];
/// Obstacles.
pub const OCCUPIED: Color = [30, 34, 40];
/// Named places.
pub const PLACE: Color = [30, 130, 76];
/// Robots.
pub const ROBOT: Color = [40, 110, 220];
/// Stretches of a way where scans leave a direction undetermined.
pub const DEGENERATE: Color = [150, 60, 190];

/// Width of the panel, px.
pub const PANEL: u32 = 172;
/// Smallest height of a picture: that of the panel.
const LEAST_HEIGHT: u32 = 320;
const PAPER: Color = [247, 248, 250];
/// Margin inside the panel, px.
const INSET: f32 = 12.0;
/// Line height in the panel, and size of its letters, px.
const LINE: f32 = 19.0;
const LETTERS: f32 = 12.0;
/// Size of the title's letters, px.
const TITLE: f32 = 14.0;
/// Leading digits of scale bar lengths.
const ROUND: [f64; 3] = [5.0, 2.0, 1.0];

/// Symbol of a legend entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A line.
    Line,
    /// A dot.
    Dot,
    /// An area.
    Area,
}

/// A part of the plane, and a panel.
pub struct Plane {
    canvas: Canvas,
    panel: Canvas,
    low: Point2<f64>,
    /// Pixels per metre.
    scale: f64,
    /// Position of the panel's next line.
    line: f32,
}

impl Plane {
    /// The plane from `low` to `high` with `size` pixels on its longer side, on a background colour.
    ///
    /// # Errors
    /// A part without extent.
    pub fn new(low: Point2<f64>, high: Point2<f64>, size: u32, title: &str, color: Color) -> Result<Self, Failure> {
        let extent = high - low;
        let scale = f64::from(size) / extent.amax();
        if !scale.is_finite() || extent.amin() < 0.0 {
            return Err(Failure::failed("there is nothing to draw"));
        }
        let pixels = |metres: f64| ((metres * scale).round() as u32).max(1);
        let canvas = Canvas::new(pixels(extent.x), pixels(extent.y), color)?;
        let mut plane = Self {
            panel: Canvas::new(PANEL, canvas.height().max(LEAST_HEIGHT), PAPER)?,
            canvas,
            low,
            scale,
            line: 26.0,
        };
        let (first, second) = two_lines(title, PANEL as f32 - 1.5 * INSET);
        for line in [first, second].into_iter().filter(|line| !line.is_empty()) {
            plane.word(line, TITLE, INK, Face::Bold, 0.0);
        }
        plane.line += 6.0;
        Ok(plane)
    }

    /// The picture.
    ///
    /// # Errors
    /// Too many pixels.
    pub fn finish(mut self) -> Result<Canvas, Failure> {
        self.scale_bar();
        self.canvas.beside(&self.panel, PAPER)
    }

    /// Position of a point, in pixels from the top left.
    fn pixel(&self, point: Point2<f64>) -> Pixel {
        let off = (point - self.low) * self.scale;
        [off.x as f32, (f64::from(self.canvas.height()) - off.y) as f32]
    }

    fn pixels(&self, points: &[Point2<f64>]) -> Vec<Pixel> {
        points.iter().map(|point| self.pixel(*point)).collect()
    }

    /// A map, at its own position. Where a pixel has several cells, it shows an occupied one if there is one, else a free one, as
    /// [`OccupancyGrid::coarse`] does: thin walls stay.
    pub fn map(&mut self, map: &OccupancyGrid) {
        let (width, height) = (self.canvas.width(), self.canvas.height());
        let spec = map.spec();
        let (low, per_pixel) = (spec.to_cells(self.low), 1.0 / (self.scale * spec.resolution));
        let columns = cells_under(width, low.x, per_pixel, spec.width);
        let rows = cells_under(height, low.y, per_pixel, spec.height);
        for (rows, y) in rows.into_iter().zip((0..height).rev()) {
            for (columns, x) in columns.iter().zip(0..) {
                let cells = rows.clone().flat_map(|row| {
                    let start = spec.index(Cell::new(0, row));
                    &map.values()[start + columns.start as usize..start + columns.end as usize]
                });
                if let Some(most) = cells.map(|value| Occupancy::of(*value)).max() {
                    let color = match most {
                        Occupancy::Free => FREE,
                        Occupancy::Occupied => OCCUPIED,
                        Occupancy::Unknown => UNKNOWN,
                    };
                    self.canvas.set(x, y, color);
                }
            }
        }
    }

    /// A dot; `radius` in pixels.
    pub fn dot(&mut self, at: Point2<f64>, color: Color, radius: f32) {
        let at = self.pixel(at);
        self.canvas.disc(at, radius, color);
    }

    /// Lines from point to point; `width` in pixels.
    pub fn polyline(&mut self, points: &[Point2<f64>], color: Color, width: f32) {
        let pixels = self.pixels(points);
        self.canvas.stroke(&pixels, false, color, width);
    }

    /// Lines from point to point, and back to the first; `width` in pixels.
    pub fn outline(&mut self, corners: &[Point2<f64>], color: Color, width: f32) {
        let pixels = self.pixels(corners);
        self.canvas.stroke(&pixels, true, color, width);
    }

    /// A filled polygon.
    pub fn polygon(&mut self, corners: &[Point2<f64>], color: Color) {
        let pixels = self.pixels(corners);
        self.canvas.fill(&pixels, color, 255);
    }

    /// A filled disc; `radius` in metres.
    pub fn disc(&mut self, center: Point2<f64>, radius: f64, color: Color) {
        self.polygon(&circle(center, radius), color);
    }

    /// A robot: its footprint, and a line from its centre to its front.
    pub fn robot(&mut self, pose: Pose2, footprint: &Footprint) {
        let outline: Vec<Point2<f64>> = outline(footprint)
            .into_iter()
            .map(|corner| pose.transform_point(corner))
            .collect();
        self.polygon(&outline, ROBOT);
        self.outline(&outline, [15, 50, 120], 1.0);
        let front = pose.position() + pose.heading() * footprint.inscribed_radius();
        self.polyline(&[pose.position(), front], WHITE, 2.0);
    }

    /// A named place.
    pub fn place(&mut self, name: &str, at: Point2<f64>) {
        self.dot(at, PLACE, 4.0);
        let [x, y] = self.pixel(at);
        let width = text_width(name, 11.0, Face::Regular);
        // Beside its dot, on the side with space.
        let left = if x + width + 12.0 > self.canvas.width() as f32 {
            x - width - 12.0
        } else {
            x + 6.0
        };
        let top = (y - 8.0).clamp(0.0, (self.canvas.height() as f32 - 16.0).max(0.0));
        if x.is_finite() && y.is_finite() {
            self.canvas.card([left, top], [width + 6.0, 16.0], 3.0, WHITE, 215);
            let at = [left + 3.0, top + 12.0];
            self.canvas.text(at, name, 11.0, PLACE, Anchor::Start, Face::Regular);
        }
    }

    /// A line in the panel.
    pub fn note(&mut self, text: &str) {
        self.word(text, LETTERS, GREY, Face::Regular, 0.0);
    }

    /// A line of the legend in the panel.
    pub fn legend(&mut self, mark: Mark, color: Color, text: &str) {
        let (left, middle) = (INSET, self.line - 4.0);
        match mark {
            Mark::Line => {
                let line = [[left, middle], [left + 18.0, middle]];
                self.panel.stroke(&line, false, color, 3.0);
            }
            Mark::Dot => self.panel.disc([left + 9.0, middle], 4.5, color),
            Mark::Area => {
                let (corner, size) = ([left + 1.0, middle - 6.0], [16.0, 12.0]);
                self.panel
                    .card([corner[0] - 0.5, corner[1] - 0.5], [17.0, 13.0], 2.0, GREY, 255);
                self.panel.card(corner, size, 2.0, color, 255);
            }
        }
        self.word(text, LETTERS, INK, Face::Regular, 26.0);
    }

    /// The legend entries of a map.
    pub fn map_legend(&mut self) {
        self.legend(Mark::Area, OCCUPIED, "occupied");
        self.legend(Mark::Area, FREE, "free");
        self.legend(Mark::Area, UNKNOWN, "unknown");
    }

    /// Vertical space in the panel.
    pub fn gap(&mut self) {
        self.line += 0.5 * LINE;
    }

    /// Writes a line in the panel, cut to the panel's width.
    fn word(&mut self, text: &str, size: f32, color: Color, face: Face, indent: f32) {
        let room = PANEL as f32 - 1.5 * INSET - indent;
        let mut text: String = text.chars().filter(|letter| !letter.is_control()).collect();
        if text_width(&text, size, face) > room {
            while !text.is_empty() && text_width(&text, size, face) + size > room {
                text.pop();
            }
            text.push('…');
        }
        let at = [INSET + indent, self.line];
        self.panel.text(at, &text, size, color, Anchor::Start, face);
        self.line += LINE;
    }

    /// A bar of a round length in metres, at the bottom of the panel.
    fn scale_bar(&mut self) {
        let most = f64::from(PANEL) - 2.0 * f64::from(INSET);
        let metres = round_below(most / self.scale);
        let length = (metres * self.scale) as f32;
        let (left, y) = (INSET, self.panel.height() as f32 - 20.0);
        for line in [
            [[left, y], [left + length, y]],
            [[left, y - 4.0], [left, y + 4.0]],
            [[left + length, y - 4.0], [left + length, y + 4.0]],
        ] {
            self.panel.stroke(&line, false, INK, 1.5);
        }
        let at = [left, y - 9.0];
        self.panel
            .text(at, &format!("{metres} m"), LETTERS, INK, Anchor::Start, Face::Regular);
    }
}

/// Cells under each pixel along an axis that has `count` cells, where the first pixel begins at cell `first` and each has `per_pixel` cells:
/// those whose centres are in the pixel, or, if there is none, the one at the pixel's centre.
fn cells_under(pixels: u32, first: f64, per_pixel: f64, count: u32) -> Vec<Range<u32>> {
    let whole = |cells: f64| cells.clamp(0.0, f64::from(count)) as u32;
    let under = |pixel: u32| {
        let low = first + f64::from(pixel) * per_pixel;
        let centers = whole((low - 0.5).ceil())..whole((low + per_pixel - 0.5).ceil());
        if centers.is_empty() {
            let middle = (low + 0.5 * per_pixel).floor();
            whole(middle)..whole(middle + 1.0)
        } else {
            centers
        }
    };
    (0..pixels).map(under).collect()
}

/// A title over two lines, if it is wider than `room` px: broken after a space or a mark, if there is one.
fn two_lines(title: &str, room: f32) -> (&str, &str) {
    let fits = |end: &usize| text_width(title.get(..*end).unwrap_or_default(), TITLE, Face::Bold) <= room;
    let ends = || {
        title
            .char_indices()
            .map(|(at, letter)| (at + letter.len_utf8(), letter))
    };
    if fits(&title.len()) {
        return (title, "");
    }
    let fitting = || ends().take_while(|(end, _)| fits(end));
    let mark = fitting().filter(|(_, letter)| " _-.".contains(*letter)).last();
    let end = mark.or_else(|| fitting().last()).map_or(0, |(end, _)| end);
    let (first, second) = title.split_at(end);
    (first.trim_end(), second)
}

/// The largest of …, 0.5, 1, 2, 5, 10, … that does not exceed a number.
pub fn round_below(number: f64) -> f64 {
    let exponent = number.log10().floor();
    let (exponent, number) = if exponent.is_finite() {
        (exponent as i32, number)
    } else {
        (0, 1.0)
    };
    // Powers of ten parsed from text: 0.1, not 0.1000…01.
    let ten: f64 = format!("1e{exponent}").parse().unwrap_or(1.0);
    let share = ROUND.into_iter().find(|share| share * ten <= number * (1.0 + 1e-9));
    format!("{}e{exponent}", share.unwrap_or(1.0)).parse().unwrap_or(ten)
}

/// The box around points, `margin` m wider on all sides: its lower-left and upper-right corner. `None` without a finite point.
pub fn around(points: impl Iterator<Item = Point2<f64>>, margin: f64) -> Option<(Point2<f64>, Point2<f64>)> {
    let finite = points.filter(|point| point.x.is_finite() && point.y.is_finite());
    let (low, high) = finite.fold(None, |bounds: Option<(Point2<f64>, Point2<f64>)>, point| {
        let (low, high) = bounds.unwrap_or((point, point));
        Some((low.inf(&point), high.sup(&point)))
    })?;
    let margin = Vector2::repeat(margin);
    Some((low - margin, high + margin))
}

/// The points of a plan, map frame, m: those of its trajectory, or, in a plan without a time law, its waypoints.
#[must_use]
pub fn points_of(plan: &Plan) -> Vec<Point2<f64>> {
    match &*plan.trajectory {
        [] => plan.waypoints.clone(),
        trajectory => trajectory.iter().map(|point| point.position()).collect(),
    }
}

/// The returns of a scan, map frame, m.
#[must_use]
pub fn returns_of(scan: &Scan) -> Vec<Point2<f64>> {
    let laser = scan.map_from_laser();
    scan.returns().map(|point| laser.transform_point(point)).collect()
}

/// A footprint as a polygon, base frame, m.
#[must_use]
pub fn outline(footprint: &Footprint) -> Vec<Point2<f64>> {
    match footprint {
        Footprint::Radius(radius) => circle(Point2::origin(), *radius),
        Footprint::Polygon(corners) => corners.clone(),
    }
}

/// A circle as a polygon.
#[must_use]
pub fn circle(center: Point2<f64>, radius: f64) -> Vec<Point2<f64>> {
    const CORNERS: u32 = 48;
    (0..CORNERS)
        .map(|corner| std::f64::consts::TAU * f64::from(corner) / f64::from(CORNERS))
        .map(|angle| center + Vector2::new(angle.cos(), angle.sin()) * radius)
        .collect()
}

#[cfg(test)]
mod tests {
    use zenav_protocol::grid::GridSpec;

    use super::*;

    #[test]
    fn a_scale_bar_is_a_round_number_of_metres() {
        for (number, bar) in [
            (1.0, 1.0),
            (0.73, 0.5),
            (4.99, 2.0),
            (49.0, 20.0),
            (0.1, 0.1),
            (0.0, 1.0),
        ] {
            assert_eq!(round_below(number), bar, "{number}");
        }
    }

    #[test]
    fn a_wall_of_one_cell_is_drawn_at_every_scale() {
        let spec = GridSpec {
            origin: Point2::new(-3.0, 2.0),
            ..zenav_fixtures::spec(1000, 40, 0.05)
        };
        let walls: Vec<u32> = (0..30).map(|nth| 5 + 33 * nth).collect();
        let cells: Vec<_> = walls
            .iter()
            .flat_map(|x| (0..spec.height).map(move |y| (*x, y)))
            .collect();
        let map = zenav_fixtures::map_with_occupied(spec, &cells);
        for pixels in [150, 480, 999, 1000, 1001, 3000] {
            let mut plane = Plane::new(spec.origin, spec.upper(), pixels, "", UNKNOWN).unwrap();
            plane.map(&map);
            let rgb = plane.canvas.rgb();
            let row: Vec<&[u8]> = rgb.chunks(3).take(plane.canvas.width() as usize).collect();
            let drawn = row.chunk_by(|a, b| a == b).filter(|run| run[0] == OCCUPIED).count();
            assert_eq!(drawn, walls.len(), "{pixels} pixels");
            assert!(!row.contains(&UNKNOWN.as_slice()));
        }
    }

    #[test]
    fn a_pixel_shows_the_cells_whose_centres_are_in_it() {
        assert_eq!(cells_under(3, 0.0, 2.0, 5), [0..2, 2..4, 4..5]);
        assert_eq!(cells_under(4, 0.0, 0.5, 2), [0..1, 0..1, 1..2, 1..2]);
        assert_eq!(cells_under(3, -1.0, 1.0, 1), [0..0, 0..1, 1..1]);
        assert_eq!(cells_under(2, 0.3, 0.1, 0), [0..0, 0..0]);
    }

    #[test]
    fn a_long_title_takes_two_lines() {
        let room = PANEL as f32 - 1.5 * INSET;
        assert_eq!(two_lines("kitchen", room), ("kitchen", ""));
        assert_eq!(
            two_lines("everything_of_the_first_run", room),
            ("everything_of_the_", "first_run")
        );
        assert_eq!(
            two_lines("zenav a_whole_afternoon", room),
            ("zenav a_whole_", "afternoon")
        );
        let (first, second) = two_lines("kitchenkitchenkitchen", room);
        assert!(!first.is_empty() && !second.is_empty());
        assert_eq!(format!("{first}{second}"), "kitchenkitchenkitchen");
    }

    #[test]
    fn a_name_of_any_length_and_a_place_anywhere_can_be_drawn() {
        let mut plane = Plane::new(Point2::origin(), Point2::new(4.0, 3.0), 200, &"long ".repeat(40), FREE).unwrap();
        for at in [
            Point2::new(3.9, 2.9),
            Point2::new(1e300, f64::NAN),
            Point2::new(-1e9, 0.0),
        ] {
            plane.place("a place", at);
            plane.dot(at, PLACE, 3.0);
        }
        plane.note("");
        let canvas = plane.finish().unwrap();
        assert_eq!((canvas.width(), canvas.height()), (200 + PANEL, LEAST_HEIGHT));
        assert!(Plane::new(Point2::origin(), Point2::origin(), 200, "", FREE).is_err());
    }
}
