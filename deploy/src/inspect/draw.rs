//! Map in a terminal. How is it drawn? Half-block characters, two cells' heights to a row, scaled to a width; the robot as an arrow.
//! Pure: text out of a grid.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};

/// How to draw.
#[derive(Clone, Copy, Debug)]
pub(super) struct Canvas {
    /// Columns at most.
    pub(super) width: usize,
    /// Rows at most; the map is scaled to fit both.
    pub(super) height: usize,
    /// Whether the terminal shows colours.
    pub(super) colors: bool,
}

/// Arrows from east, counter-clockwise.
const ARROWS: [char; 8] = ['→', '↗', '↑', '↖', '←', '↙', '↓', '↘'];

/// The known part of a map, highest row first, and a line that gives its place and scale.
pub(super) fn map(grid: &OccupancyGrid, robot: Option<Pose2>, canvas: Canvas) -> String {
    let Some(window) = Window::around(grid, robot) else {
        return "(the map is empty)".to_owned();
    };
    let scale = window.scale(canvas);
    let pixels = window.pixels(grid, scale);
    let (columns, rows) = (pixels.spec().width, pixels.spec().height);
    let mark = robot.and_then(|pose| {
        let cell = pixels.spec().cell_at(pose.position())?;
        let eighth = (pose.yaw / std::f64::consts::FRAC_PI_4).round() as i64;
        Some((cell.x, cell.y / 2, ARROWS[eighth.rem_euclid(8) as usize]))
    });
    let mut text = String::new();
    for row in (0..rows.div_ceil(2)).rev() {
        for x in 0..columns {
            let at = |y: u32| pixels.get(Cell::new(x, y)).copied().unwrap_or(Occupancy::Unknown);
            let (upper, lower) = (at(2 * row + 1), at(2 * row));
            match mark {
                Some((mark_x, mark_row, arrow)) if (mark_x, mark_row) == (x, row) => {
                    push_mark(&mut text, arrow, lower, canvas.colors)
                }
                _ if canvas.colors => push_colored(&mut text, upper, lower),
                _ => text.push(plain(upper, lower)),
            }
        }
        if canvas.colors {
            text.push_str("\x1b[0m");
        }
        text.push('\n');
    }
    let spec = pixels.spec();
    let upper = spec.upper();
    let robot = robot
        .map(|pose| format!(", robot at ({:.2}, {:.2}) heading {:.2} rad", pose.x, pose.y, pose.yaw))
        .unwrap_or_default();
    text.push_str(&format!(
        "x {:.2} to {:.2} m, y {:.2} to {:.2} m, a column is {:.2} m{robot}",
        spec.origin.x, upper.x, spec.origin.y, upper.y, spec.resolution
    ));
    text
}

/// Without colours only obstacles have edges; between them half a cell of doubt is no news.
fn plain(upper: Occupancy, lower: Occupancy) -> char {
    use Occupancy::{Free, Occupied};
    match (upper, lower) {
        (Occupied, Occupied) => '█',
        (Occupied, _) => '▀',
        (_, Occupied) => '▄',
        (Free, _) | (_, Free) => ' ',
        _ => '░',
    }
}

/// A shade of the 256-colour palette, much like a map file's picture.
const fn shade(occupancy: Occupancy) -> u8 {
    match occupancy {
        Occupancy::Free => 255,
        Occupancy::Unknown => 244,
        Occupancy::Occupied => 16,
    }
}

fn push_colored(text: &mut String, upper: Occupancy, lower: Occupancy) {
    text.push_str(&format!("\x1b[38;5;{};48;5;{}m▀", shade(upper), shade(lower)));
}

fn push_mark(text: &mut String, arrow: char, ground: Occupancy, colors: bool) {
    if colors {
        text.push_str(&format!("\x1b[1;38;5;196;48;5;{}m", shade(ground)));
    }
    text.push(arrow);
}

/// The part of a grid that is worth drawing, cells, ends excluded.
#[derive(Clone, Copy, Debug)]
struct Window {
    x: (u32, u32),
    y: (u32, u32),
}

impl Window {
    fn around(grid: &OccupancyGrid, robot: Option<Pose2>) -> Option<Self> {
        let spec = grid.spec();
        let known = grid
            .values()
            .iter()
            .enumerate()
            .filter(|(_, value)| Occupancy::of(**value) != Occupancy::Unknown)
            .map(|(index, _)| spec.cell(index));
        let cells = known.chain(robot.and_then(|pose| spec.cell_at(pose.position())));
        let bounds = cells.fold(None, |bounds: Option<Self>, cell| {
            let Self { x, y } = bounds.unwrap_or(Self {
                x: (cell.x, cell.x + 1),
                y: (cell.y, cell.y + 1),
            });
            Some(Self {
                x: (x.0.min(cell.x), x.1.max(cell.x + 1)),
                y: (y.0.min(cell.y), y.1.max(cell.y + 1)),
            })
        });
        // All is unknown: the whole of it.
        bounds.or_else(|| {
            (!spec.is_empty()).then_some(Self {
                x: (0, spec.width),
                y: (0, spec.height),
            })
        })
    }

    /// Cells to a column; a row shows twice as many.
    fn scale(&self, canvas: Canvas) -> u32 {
        let across = (self.x.1 - self.x.0).div_ceil(u32::try_from(canvas.width.max(1)).unwrap_or(u32::MAX));
        let along = (self.y.1 - self.y.0).div_ceil(
            u32::try_from(canvas.height.max(1))
                .unwrap_or(u32::MAX)
                .saturating_mul(2),
        );
        across.max(along).max(1)
    }

    /// Blocks of cells as one: occupied wherever one is, free where one is and none is occupied.
    fn pixels(&self, grid: &OccupancyGrid, scale: u32) -> Grid<Occupancy> {
        let from = grid.spec();
        let origin = Point2::new(
            from.origin.x + f64::from(self.x.0) * from.resolution,
            from.origin.y + f64::from(self.y.0) * from.resolution,
        );
        let side = |(low, high): (u32, u32)| (high - low).div_ceil(scale);
        let spec = GridSpec {
            origin,
            resolution: from.resolution * f64::from(scale),
            width: side(self.x),
            height: side(self.y),
        };
        let mut pixels = Grid::filled(spec, Occupancy::Unknown);
        for y in self.y.0..self.y.1 {
            for x in self.x.0..self.x.1 {
                let seen = grid
                    .get(Cell::new(x, y))
                    .map_or(Occupancy::Unknown, |value| Occupancy::of(*value));
                let pixel = &mut pixels[Cell::new((x - self.x.0) / scale, (y - self.y.0) / scale)];
                *pixel = match (*pixel, seen) {
                    (Occupancy::Occupied, _) | (_, Occupancy::Occupied) => Occupancy::Occupied,
                    (Occupancy::Free, _) | (_, Occupancy::Free) => Occupancy::Free,
                    _ => Occupancy::Unknown,
                };
            }
        }
        pixels
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use super::*;

    /// From rows counted from the top: `#` occupied, `.` free, `?` unknown; cells of 1 m from the origin.
    fn grid(rows: &[&str]) -> OccupancyGrid {
        zenav_fixtures::drawn_map(1.0, rows)
    }

    const PLAIN: Canvas = Canvas {
        width: 80,
        height: 40,
        colors: false,
    };

    fn lines(grid: &OccupancyGrid, robot: Option<Pose2>, canvas: Canvas) -> Vec<String> {
        map(grid, robot, canvas).lines().map(str::to_owned).collect()
    }

    #[test]
    fn two_cells_make_a_character_and_north_is_up() {
        let drawn = lines(&grid(&["####", "#...", "#..#", "...."]), None, PLAIN);
        assert_eq!(drawn[..2], ["█▀▀▀", "▀  ▀"]);
    }

    #[test]
    fn the_robot_is_an_arrow_where_it_stands() {
        let drawn = lines(
            &grid(&["....", "....", "....", "...."]),
            Some(Pose2::new(2.5, 0.5, std::f64::consts::FRAC_PI_2)),
            PLAIN,
        );
        assert_eq!(drawn[..2], ["    ", "  ↑ "]);
        assert!(drawn[2].contains("robot at (2.50, 0.50)"), "{}", drawn[2]);
    }

    #[test]
    fn a_large_map_is_scaled_and_no_wall_gets_lost() {
        let mut rows = vec![".".repeat(100); 60];
        rows[17].replace_range(0..100, &"#".repeat(100));
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        let drawn = lines(&grid(&rows), None, Canvas { width: 20, ..PLAIN });
        assert!(
            drawn
                .iter()
                .take(drawn.len() - 1)
                .all(|line| line.chars().count() == 20)
        );
        assert!(
            drawn.iter().any(|line| line.chars().all(|c| c == '▀' || c == '▄')),
            "{drawn:?}"
        );
    }

    #[test]
    fn unknown_margins_are_left_out_and_nothing_is_said_of_an_empty_map() {
        assert_eq!(lines(&grid(&["????", "?#.?", "?..?", "????"]), None, PLAIN)[0], "▀ ");
        assert_eq!(lines(&grid(&["??"]), None, PLAIN)[0], "░░");
        let empty = GridSpec {
            origin: Point2::origin(),
            resolution: 1.0,
            width: 0,
            height: 0,
        };
        assert_eq!(map(&OccupancyGrid::filled(empty, 0), None, PLAIN), "(the map is empty)");
    }
}
