//! Queries of a batch. Starts and goals as lines `sx sy gx gy [optimum]`, or as a Moving AI scenario: columns and rows of the map file,
//! rows counted from the top.

use std::path::Path;

use zenav_mapping::{cell_from_top, parse_moving_ai_scenarios};
use zenav_protocol::grid::{Cell, GridSpec};

use crate::failure::Failure;
use crate::files;

/// A planning query.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Query {
    /// Column and row of the start, from the top left.
    pub(super) start: [i64; 2],
    /// Column and row of the goal.
    pub(super) goal: [i64; 2],
    /// Length of the shortest path, cells, if known.
    pub(super) optimum: Option<f64>,
}

impl Query {
    /// Start and goal as grid cells; `None` if one is outside.
    pub(super) fn cells(&self, spec: &GridSpec) -> Option<(Cell, Cell)> {
        let cell = |[x, y]: [i64; 2]| cell_from_top(spec, [u32::try_from(x).ok()?, u32::try_from(y).ok()?]);
        Some((cell(self.start)?, cell(self.goal)?))
    }
}

/// Reads queries; a file with the extension `.scen` is a Moving AI scenario.
///
/// # Errors
/// Exit code 3 for a missing file, 2 with the line for a bad one.
pub(super) fn read(path: &Path) -> Result<Vec<Query>, Failure> {
    let text = files::text(path)?;
    let bad = |error: &dyn std::fmt::Display| Failure::usage(format!("{}: {error}", path.display()));
    if path.extension().is_some_and(|ending| ending == "scen") || text.starts_with("version") {
        let scenarios = parse_moving_ai_scenarios(text.as_bytes()).map_err(|error| bad(&error))?;
        let wide = |[x, y]: [u32; 2]| [i64::from(x), i64::from(y)];
        return Ok(scenarios
            .into_iter()
            .map(|scenario| Query {
                start: wide(scenario.start),
                goal: wide(scenario.goal),
                optimum: Some(scenario.optimum),
            })
            .collect());
    }
    parse(&text).map_err(|error| bad(&error))
}

fn parse(text: &str) -> Result<Vec<Query>, String> {
    let mut queries = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let content = line.split('#').next().unwrap_or_default();
        let words: Vec<&str> = content.split_whitespace().collect();
        if words.is_empty() {
            continue;
        }
        let is_decimal = |word: &&str| word.parse::<i64>().is_err() && word.parse::<f64>().is_ok_and(f64::is_finite);
        let wrong = || {
            let expected = if words.iter().take(4).any(is_decimal) {
                "whole numbers, the columns and rows of cells of the map file"
            } else {
                "`sx sy gx gy [optimum]`"
            };
            let found: String = line.chars().take(60).collect();
            format!("line {}: expected {expected}, found `{found}`", index + 1)
        };
        let whole = |word: &str| word.parse::<i64>().map_err(|_| wrong());
        let (cells, optimum) = match words.as_slice() {
            [cells @ .., optimum] if cells.len() == 4 => (
                cells,
                Some(
                    optimum
                        .parse::<f64>()
                        .ok()
                        .filter(|value| value.is_finite())
                        .ok_or_else(wrong)?,
                ),
            ),
            cells => (cells, None),
        };
        let [sx, sy, gx, gy] = cells else { return Err(wrong()) };
        queries.push(Query {
            start: [whole(sx)?, whole(sy)?],
            goal: [whole(gx)?, whole(gy)?],
            optimum,
        });
    }
    Ok(queries)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_with_and_without_an_optimum() {
        let queries = parse("# a comment\n0 0 3 2 4.5\n\n1 1 1 1\n-1 0 0 0\n").unwrap();
        assert_eq!(
            queries[0],
            Query {
                start: [0, 0],
                goal: [3, 2],
                optimum: Some(4.5)
            }
        );
        assert_eq!((queries.len(), queries[1].optimum), (3, None));
    }

    #[test]
    fn rows_count_from_the_top() {
        let query = &parse("0 0 3 2").unwrap()[0];
        let spec = zenav_fixtures::spec(4, 3, 1.0);
        assert_eq!(query.cells(&spec), Some((Cell::new(0, 2), Cell::new(3, 0))));
        assert_eq!(parse("-1 0 0 0").unwrap()[0].cells(&spec), None, "outside the map");
        assert_eq!(parse("0 0 4 0").unwrap()[0].cells(&spec), None);
    }

    #[test]
    fn a_bad_line_is_named() {
        for bad in ["1 2 3", "1 2 3 x", "1 2 3 4 5 6", "1 2 3 4 inf", "1.5 2 3 4"] {
            let error = parse(&format!("0 0 1 1\n{bad}")).unwrap_err();
            assert!(error.starts_with("line 2"), "{error}");
            let is_told = error.contains("expected whole numbers, the columns and rows of cells");
            assert_eq!(is_told, bad.starts_with("1.5"), "{error}");
        }
    }
}
