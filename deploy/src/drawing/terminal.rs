//! Map in a terminal. Half-block characters, two cells per row, scaled to the terminal; over it marks: robots as arrows, paths, scans,
//! places. Pure except for the terminal's size: a grid in, text out.

use std::collections::HashMap;
use std::io::IsTerminal as _;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};

use crate::output::{hundredths, piece};

/// Drawing options.
#[derive(Clone, Copy, Debug)]
pub struct Screen {
    /// Most columns.
    pub width: usize,
    /// Most rows; the map is scaled to fit both.
    pub height: usize,
    /// Whether the terminal supports colours.
    pub colors: bool,
}

impl Screen {
    /// The terminal on stdout, with some rows left free; `None` if stdout is no terminal or its size is unknown.
    pub fn of_terminal(free: usize) -> Option<Self> {
        let (columns, rows) = size()?;
        (std::io::stdout().is_terminal() && rows > free + 1).then(|| Self {
            width: columns,
            height: rows - free,
            colors: has_colors(),
        })
    }
}

/// Columns and rows of the terminal, if they are known: a window of size zero is one whose size is not.
pub fn size() -> Option<(usize, usize)> {
    let (columns, rows) = crossterm::terminal::size().ok()?;
    (columns > 0 && rows > 0).then(|| (columns.into(), rows.into()))
}

/// Whether the user wants colours on a terminal.
pub fn has_colors() -> bool {
    std::env::var_os("NO_COLOR").is_none()
}

/// A colour of the 256-colour palette.
type Color = u8;
const RED: Color = 196;
const ORANGE: Color = 208;
const BLUE: Color = 27;
const GREEN: Color = 28;
const MAGENTA: Color = 164;

/// A mark over a map, map frame; later ones cover earlier ones.
#[derive(Clone, Copy, Debug)]
pub enum Mark<'a> {
    /// A path to drive.
    Path(&'a [Point2<f64>]),
    /// End points of a lidar's beams.
    Scan(&'a [Point2<f64>]),
    /// A named place.
    Place(&'a str, Point2<f64>),
    /// A robot's goal.
    Goal(Point2<f64>),
    /// A robot, as an arrow.
    Robot(Pose2),
    /// Another robot, with its name.
    OtherRobot(&'a str, Pose2),
}

/// Arrows counter-clockwise from east.
const ARROWS: [char; 8] = ['→', '↗', '↑', '↖', '←', '↙', '↓', '↘'];

/// The known part of a map and its robots, highest row first, with a line for position and scale.
pub fn map(grid: &OccupancyGrid, marks: &[Mark<'_>], screen: Screen) -> String {
    let robots = marks.iter().filter_map(|mark| match mark {
        Mark::Robot(pose) | Mark::OtherRobot(_, pose) => Some(pose.position()),
        _ => None,
    });
    let Some(window) = window(grid, robots) else {
        return "(the map is empty)".to_owned();
    };
    let pixels = grid.coarse(window, scale(window, screen));
    let (columns, rows) = (pixels.spec().width, pixels.spec().height);
    let signs = signs(pixels.spec(), marks);
    let mut text = String::new();
    for row in (0..rows.div_ceil(2)).rev() {
        for x in 0..columns {
            let at = |y: u32| pixels.get(Cell::new(x, y)).copied().unwrap_or(Occupancy::Unknown);
            let (upper, lower) = (at(2 * row + 1), at(2 * row));
            match signs.get(&(x, row)) {
                Some((sign, color)) if screen.colors => {
                    text.push_str(&format!("\x1b[1;38;5;{color};48;5;{}m{sign}\x1b[22m", shade(lower)));
                }
                Some((sign, _)) => text.push(*sign),
                None if screen.colors => push_colored(&mut text, upper, lower),
                None => text.push(plain(upper, lower)),
            }
        }
        if screen.colors {
            text.push_str("\x1b[0m");
        }
        text.push('\n');
    }
    let spec = pixels.spec();
    let upper = spec.upper();
    let robot = marks.iter().find_map(|mark| match mark {
        Mark::Robot(pose) => Some(pose),
        _ => None,
    });
    let robot = piece(robot, |pose| {
        let [x, y, yaw] = [pose.x, pose.y, pose.yaw].map(hundredths);
        format!("\nrobot at ({x:.2}, {y:.2}), heading {yaw:.2} rad")
    });
    text.push_str(&format!(
        "x {:.2} to {:.2} m, y {:.2} to {:.2} m, a column is {:.2} m{robot}",
        spec.origin.x, upper.x, spec.origin.y, upper.y, spec.resolution
    ));
    text
}

/// Characters over the map, by column and row from below.
fn signs(pixels: &GridSpec, marks: &[Mark<'_>]) -> HashMap<(u32, u32), (char, Color)> {
    let mut signs = HashMap::new();
    let at = |point: Point2<f64>| pixels.cell_at(point).map(|cell| (cell.x, cell.y / 2));
    for mark in marks {
        match mark {
            Mark::Path(points) => {
                for pair in points.windows(2) {
                    // Two steps per column leave no gap.
                    let steps = ((pair[1] - pair[0]).norm() / (0.5 * pixels.resolution))
                        .ceil()
                        .clamp(1.0, 1e4);
                    for step in 0..=steps as u32 {
                        let point = pair[0] + (pair[1] - pair[0]) * (f64::from(step) / steps);
                        signs.extend(at(point).map(|at| (at, ('·', BLUE))));
                    }
                }
            }
            Mark::Scan(points) => {
                signs.extend(points.iter().filter_map(|point| Some((at(*point)?, ('▪', ORANGE)))));
            }
            Mark::Place(name, point) => label(&mut signs, at(*point), pixels.width, ('◆', name), GREEN),
            Mark::Goal(point) => signs.extend(at(*point).map(|at| (at, ('✕', MAGENTA)))),
            Mark::Robot(pose) => signs.extend(at(pose.position()).map(|at| (at, (arrow(*pose), RED)))),
            Mark::OtherRobot(name, pose) => {
                label(&mut signs, at(pose.position()), pixels.width, (arrow(*pose), name), RED);
            }
        }
    }
    signs
}

/// A sign with a name to its right, as far as it fits.
fn label(
    signs: &mut HashMap<(u32, u32), (char, Color)>,
    at: Option<(u32, u32)>,
    width: u32,
    (sign, name): (char, &str),
    color: Color,
) {
    let Some((x, row)) = at else { return };
    let name = name.chars().map(|c| if c.is_control() { ' ' } else { c });
    for (column, sign) in (x..width).zip(std::iter::once(sign).chain(name)) {
        signs.insert((column, row), (sign, color));
    }
}

fn arrow(pose: Pose2) -> char {
    let eighth = (pose.yaw / std::f64::consts::FRAC_PI_4).round() as i64;
    ARROWS[eighth.rem_euclid(8) as usize]
}

/// Without colours only obstacles are drawn with half-cell edges; between free and unknown half a cell does not matter.
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

/// A shade of the 256-colour palette, similar to a map file's picture.
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

/// The box around the known cells and the robots; around the whole grid if nothing is known.
fn window(grid: &OccupancyGrid, robots: impl Iterator<Item = Point2<f64>>) -> Option<[Cell; 2]> {
    let spec = grid.spec();
    let known = grid.known().into_iter().flatten();
    let window = Cell::around(known.chain(robots.filter_map(|robot| spec.cell_at(robot))));
    let whole = || [Cell::new(0, 0), Cell::new(spec.width - 1, spec.height - 1)];
    window.or_else(|| (!spec.is_empty()).then(whole))
}

/// Cells per column; a row shows twice as many.
fn scale([low, high]: [Cell; 2], screen: Screen) -> u32 {
    let most = |side: usize| u32::try_from(side.max(1)).unwrap_or(u32::MAX);
    let across = (high.x - low.x + 1).div_ceil(most(screen.width));
    let along = (high.y - low.y + 1).div_ceil(most(screen.height).saturating_mul(2));
    across.max(along)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From rows counted from the top: `#` occupied, `.` free, `?` unknown; cells of 1 m from the origin.
    fn grid(rows: &[&str]) -> OccupancyGrid {
        zenav_fixtures::drawn_map(1.0, rows)
    }

    const PLAIN: Screen = Screen {
        width: 80,
        height: 40,
        colors: false,
    };

    fn lines(grid: &OccupancyGrid, marks: &[Mark<'_>], screen: Screen) -> Vec<String> {
        map(grid, marks, screen).lines().map(str::to_owned).collect()
    }

    #[test]
    fn two_cells_make_a_character_and_north_is_up() {
        let drawn = lines(&grid(&["####", "#...", "#..#", "...."]), &[], PLAIN);
        assert_eq!(drawn[..2], ["█▀▀▀", "▀  ▀"]);
    }

    #[test]
    fn the_robot_is_an_arrow_where_it_stands() {
        let drawn = lines(
            &grid(&["....", "....", "....", "...."]),
            &[Mark::Robot(Pose2::new(2.5, 0.5, std::f64::consts::FRAC_PI_2))],
            PLAIN,
        );
        assert_eq!(drawn[..2], ["    ", "  ↑ "]);
        assert_eq!(drawn[3], "robot at (2.50, 0.50), heading 1.57 rad");
    }

    #[test]
    fn marks_cover_the_map_the_later_the_more() {
        let path = [Point2::new(0.5, 0.5), Point2::new(5.5, 0.5)];
        let marks = [
            Mark::Path(&path),
            Mark::Goal(path[1]),
            Mark::Place("sink", Point2::new(1.5, 3.5)),
            Mark::Place("far", Point2::new(-9.0, 0.0)),
            Mark::Robot(Pose2::new(0.5, 0.5, 0.0)),
        ];
        let drawn = lines(&grid(&["......", "......", "......", "......"]), &marks, PLAIN);
        assert_eq!(drawn[..2], [" ◆sink", "→····✕"]);
    }

    #[test]
    fn a_large_map_is_scaled_and_no_wall_gets_lost() {
        let mut rows = vec![".".repeat(100); 60];
        rows[17].replace_range(0..100, &"#".repeat(100));
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        let drawn = lines(&grid(&rows), &[], Screen { width: 20, ..PLAIN });
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
        assert_eq!(lines(&grid(&["????", "?#.?", "?..?", "????"]), &[], PLAIN)[0], "▀ ");
        assert_eq!(lines(&grid(&["??"]), &[], PLAIN)[0], "░░");
        let empty = zenav_fixtures::free_map(zenav_fixtures::spec(0, 0, 1.0));
        assert_eq!(map(&empty, &[], PLAIN), "(the map is empty)");
    }
}
