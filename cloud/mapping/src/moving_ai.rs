//! Moving AI benchmarks. Reads grid maps (`.map`) and queries (`.scen`).
//!
//! In these files rows count from the top; they are converted here.
//!
//! Sturtevant, "Benchmarks for Grid-Based Pathfinding", 2012: `.`, `G` and `S` are passable here, everything else is not.

use nalgebra::Point2;
use thiserror::Error;
use zenav_protocol::grid::{Cell, GridError, GridSpec, MAX_SIDE, Occupancy, OccupancyGrid};

/// Why a file could not be read.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MovingAiError {
    /// A line is malformed.
    #[error("line {line}: expected {expected}, found {found}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// What was expected on this line.
        expected: String,
        /// What was found on this line.
        found: String,
    },
    /// The size is out of bounds.
    #[error(transparent)]
    Grid(#[from] GridError),
}

/// A query as in the file, with columns and rows counted from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct MovingAiScenario {
    /// Class of difficulty: the optimum divided by 4.
    pub bucket: u32,
    /// Name of the map.
    pub map: String,
    /// Column and row of the start.
    pub start: [u32; 2],
    /// Column and row of the goal.
    pub goal: [u32; 2],
    /// Length of the shortest path, cells; a diagonal step counts √2 and cuts no corner.
    pub optimum: f64,
}

/// The cell at a column and row counted from the top left; `None` outside the grid.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_mapping::cell_from_top;
/// use zenav_protocol::grid::{Cell, GridSpec};
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 1.0, width: 4, height: 3 };
/// assert_eq!(cell_from_top(&spec, [1, 0]), Some(Cell::new(1, 2)));
/// assert_eq!(cell_from_top(&spec, [1, 3]), None);
/// ```
#[must_use]
pub fn cell_from_top(spec: &GridSpec, [x, y]: [u32; 2]) -> Option<Cell> {
    (x < spec.width && y < spec.height).then(|| Cell::new(x, spec.height - 1 - y))
}

fn wrong(index: usize, expected: impl Into<String>, found: &[u8]) -> MovingAiError {
    let found: String = String::from_utf8_lossy(found).chars().take(60).collect();
    MovingAiError::Line {
        line: index + 1,
        expected: expected.into(),
        found: if found.is_empty() {
            "nothing".to_owned()
        } else {
            format!("`{found}`")
        },
    }
}

fn lines(text: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    text.split(|byte| *byte == b'\n')
        .map(<[u8]>::trim_ascii_end)
        .enumerate()
}

/// Reads a `.map`; cells get this side (m), and the origin is the lower-left corner.
///
/// ```
/// use zenav_mapping::parse_moving_ai_map;
///
/// let map = parse_moving_ai_map(b"type octile\nheight 2\nwidth 3\nmap\n.@.\n...\n", 1.0).unwrap();
/// assert_eq!(map.values(), [0, 0, 0, 0, 100, 0]);
/// ```
///
/// # Errors
/// [`MovingAiError`] with the line.
pub fn parse_moving_ai_map(text: &[u8], resolution: f64) -> Result<OccupancyGrid, MovingAiError> {
    let mut lines = lines(text);
    let (mut width, mut height) = (None, None);
    loop {
        let (index, line) = lines.next().ok_or_else(|| wrong(0, "a line `map`", b""))?;
        let words: Vec<&[u8]> = line
            .split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty())
            .collect();
        let number = |word: &[u8]| std::str::from_utf8(word).ok().and_then(|word| word.parse::<u32>().ok());
        match words.as_slice() {
            [] | [b"type", ..] => {}
            [b"width", value] => width = Some(number(value).ok_or_else(|| wrong(index, "`width N`", line))?),
            [b"height", value] => height = Some(number(value).ok_or_else(|| wrong(index, "`height N`", line))?),
            [b"map"] => break,
            _ => return Err(wrong(index, "`type`, `width N`, `height N` or `map`", line)),
        }
    }
    let (Some(width), Some(height)) = (width, height) else {
        return Err(wrong(0, "`width N` and `height N` before `map`", b""));
    };
    let spec = GridSpec {
        origin: Point2::origin(),
        resolution,
        width,
        height,
    }
    .checked()?;
    if spec.len() > text.len() {
        return Err(wrong(
            lines.count(),
            format!("{height} rows of {width} cells"),
            b"the end of the file",
        ));
    }
    let mut grid = OccupancyGrid::filled(spec, Occupancy::OCCUPIED);
    let columns = (width as usize).max(1);
    for values in grid.values_mut().chunks_exact_mut(columns).rev() {
        let (index, line) = lines.next().unwrap_or((0, b""));
        if line.len() != columns {
            return Err(wrong(index, format!("a row of {width} cells"), line));
        }
        for (value, terrain) in values.iter_mut().zip(line) {
            if matches!(terrain, b'.' | b'G' | b'S') {
                *value = Occupancy::FREE;
            }
        }
    }
    Ok(grid)
}

/// Reads the queries of a `.scen`.
///
/// # Errors
/// [`MovingAiError`] with the line.
///
/// ```
/// use zenav_mapping::parse_moving_ai_scenarios;
///
/// let scenarios = parse_moving_ai_scenarios(b"version 1\n0\troom.map\t3\t2\t0\t0\t2\t1\t2.41421356\n").unwrap();
/// assert_eq!((&*scenarios[0].map, scenarios[0].goal), ("room.map", [2, 1]));
/// assert!(parse_moving_ai_scenarios(b"0 room.map 3 2\n").unwrap_err().to_string().starts_with("line 1: expected bucket, map"));
/// ```
pub fn parse_moving_ai_scenarios(text: &[u8]) -> Result<Vec<MovingAiScenario>, MovingAiError> {
    let mut scenarios = Vec::new();
    for (index, line) in lines(text) {
        let content = String::from_utf8_lossy(line);
        if content.trim().is_empty() || content.starts_with("version") {
            continue;
        }
        // The files use tabs; in hand-edited files with spaces, names contain no spaces.
        let words: Vec<&str> = if content.contains('\t') {
            content.split('\t').map(str::trim).collect()
        } else {
            content.split_whitespace().collect()
        };
        let expected = "bucket, map, width, height, start x, start y, goal x, goal y, optimum";
        let [bucket, map, _, _, sx, sy, gx, gy, optimum] = words.as_slice() else {
            return Err(wrong(index, expected, line));
        };
        let number = |word: &str| word.parse::<u32>().ok().filter(|value| *value <= MAX_SIDE);
        let read = || {
            let optimum = optimum.parse().ok().filter(|value: &f64| value.is_finite())?;
            Some(MovingAiScenario {
                bucket: bucket.parse().ok()?,
                map: (*map).to_owned(),
                start: [number(sx)?, number(sy)?],
                goal: [number(gx)?, number(gy)?],
                optimum,
            })
        };
        scenarios.push(read().ok_or_else(|| wrong(index, expected, line))?);
    }
    Ok(scenarios)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_count_from_the_top_and_the_first_is_the_highest() {
        let map = parse_moving_ai_map(b"type octile\r\nheight 2\r\nwidth 3\r\nmap\r\n.@G\r\nTS.\r\n", 1.0).unwrap();
        let free: Vec<bool> = map.values().iter().map(|value| *value == Occupancy::FREE).collect();
        assert_eq!(free, [false, true, true, true, false, true]);
        assert_eq!(cell_from_top(map.spec(), [1, 0]), Some(Cell::new(1, 1)));
        assert_eq!(cell_from_top(map.spec(), [1, 2]), None);
    }

    #[test]
    fn a_mistake_is_named_with_its_line() {
        let error = |text: &[u8]| parse_moving_ai_map(text, 1.0).unwrap_err().to_string();
        assert_eq!(
            error(b"type octile\nheight 2\nwidth 3\nmap\n...\n..\n"),
            "line 6: expected a row of 3 cells, found `..`"
        );
        assert_eq!(
            error(b"type octile\nheight x\n"),
            "line 2: expected `height N`, found `height x`"
        );
        assert!(error(b"height 30000\nwidth 30000\nmap\n.").contains("30000 rows of 30000 cells"));
        assert!(error(b"height 4000000000\nwidth 1\nmap\n").contains("at most"));
        assert!(
            parse_moving_ai_scenarios(b"version 1\n0\tm\t1\t1\t0\t0\t0\tx\t1.5\n")
                .unwrap_err()
                .to_string()
                .starts_with("line 2")
        );
    }

    #[test]
    fn queries_are_read_as_they_stand() {
        let scenarios =
            parse_moving_ai_scenarios(b"version 1\n7\tmaps/a b.map\t49\t49\t1\t11\t2\t12\t2.82842712\n").unwrap();
        assert_eq!(
            scenarios,
            vec![MovingAiScenario {
                bucket: 7,
                map: "maps/a b.map".into(),
                start: [1, 11],
                goal: [2, 12],
                optimum: 2.828_427_12
            }]
        );
    }
}
