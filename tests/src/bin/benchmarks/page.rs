//! The page. One section per run: the figures in its output as a table, or the output as printed if it has none.

use std::fmt::Write as _;
use std::path::Path;

use zenav_fixtures::{Pair, Row};

use crate::{RUNS, command_line, earlier};

/// Header of every table of figures.
const HEADER: &str = "| what | zenav | unit | peer | its figure | ratio |\n|---|---|---|---|---|---|\n";

/// The section of a run on an earlier page, without its title.
pub fn section<'a>(page: &'a str, title: &str) -> Option<&'a str> {
    let (_, after) = page.split_once(&format!("\n## {title}\n"))?;
    let end = after.find("\n## ").or_else(|| after.find("\nNot run here:"));
    Some(&after[..end.unwrap_or(after.len())])
}

/// The page, from the runs' outputs; sections without an output are taken from the last page. `first` holds the first figures.
pub fn page(folder: &Path, last: &str, first: Option<&str>) -> String {
    let mut page = String::from(
        "# Benchmarks\n\nWritten by `cargo run --release -p zenav-tests --bin benchmarks` from the output of the commands below: every row that they print, \
         losing ones too. A peer was measured in the same run on the same machine. `ratio`: how many times faster zenav is, or how many \
         times more it does per second; below 1 the peer is better. `load`: mean number of running threads at the end of the run; above \
         those of the bench, its wall times are longer for other work, processor times only little.\n",
    );
    let mut missing = Vec::new();
    for run in RUNS {
        let Ok(output) = std::fs::read_to_string(folder.join(format!("{}.txt", run.name))) else {
            match section(last, run.title) {
                Some(section) => {
                    let again = |line: &str| read(line).map_or_else(|| line.to_owned(), |row| written(&row));
                    let lines: Vec<String> = section.lines().map(again).collect();
                    let _ = write!(page, "\n## {}\n{}\n", run.title, lines.join("\n"));
                }
                None => missing.push(run.name),
            }
            continue;
        };
        let (provenance, output) = output.split_once('\n').unwrap_or_default();
        let _ = write!(
            page,
            "\n## {}\n\n`{}`\n\n{provenance}\n\n",
            run.title,
            command_line(run)
        );
        let rows = rows(output);
        if rows.is_empty() {
            let _ = write!(page, "```text\n{}\n```\n", output.trim_end());
            continue;
        }
        page.push_str(HEADER);
        for row in &rows {
            let _ = writeln!(page, "{}", written(row));
        }
        if output.trim_end().ends_with("FAILED") {
            page.push_str("\nThis run did not pass.\n");
        }
    }
    match (first, section(last, earlier::TITLE)) {
        (Some(first), _) => {
            let table = earlier::table(first, &page);
            let _ = write!(page, "\n## {}\n\n{table}", earlier::TITLE);
        }
        (None, Some(section)) => {
            let _ = write!(page, "\n## {}\n{section}", earlier::TITLE);
        }
        (None, None) => {}
    }
    if !missing.is_empty() {
        let _ = write!(page, "\nNot run here: {}.\n", missing.join(", "));
    }
    page
}

/// A row as a line of a table.
fn written(row: &Row) -> String {
    let (peer, theirs, ratio) = match &row.peer {
        Some((peer, value)) => (peer.as_str(), figure(*value), figure(ratio(row).unwrap_or(f64::NAN))),
        None => ("", String::new(), String::new()),
    };
    let Row { name, unit, .. } = row;
    format!(
        "| {name} | {} | {unit} | {peer} | {theirs} | {ratio} |",
        own_figure(row)
    )
}

/// A row from a line that [`written`] wrote, to its digits.
pub fn read(line: &str) -> Option<Row> {
    let cells: Vec<&str> = line.split('|').map(str::trim).collect();
    let ["", name, value, unit, peer, theirs, _, ""] = cells[..] else {
        return None;
    };
    let row = Row::new(name, value.parse().ok()?, unit);
    Some(match theirs.parse() {
        Ok(theirs) => row.beside(peer, theirs),
        Err(_) => row,
    })
}

/// How many times better zenav is than the peer.
pub fn ratio(row: &Row) -> Option<f64> {
    let theirs = row.peer.as_ref()?.1;
    let is_rate = row.unit.ends_with("/s") || row.unit == "x real time";
    Some(if is_rate {
        row.value / theirs
    } else {
        theirs / row.value
    })
}

/// Our figure; a count in full.
pub fn own_figure(row: &Row) -> String {
    if row.unit.is_empty() && row.value.fract() == 0.0 {
        row.value.to_string()
    } else {
        figure(row.value)
    }
}

/// Three significant digits.
pub fn figure(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let digits = 2 - value.abs().log10().floor() as i32;
    format!("{value:.*}", usize::try_from(digits).unwrap_or(0))
}

/// Every figure of an output: rows, and criterion's estimates; peers beside ours.
fn rows(output: &str) -> Vec<Row> {
    let (mut found, mut pairs) = (Vec::new(), Vec::new());
    let mut last = "";
    for line in output.lines() {
        if let Some(row) = Row::parse(line) {
            found.push(row);
        } else if let Some(pair) = Pair::parse(line).filter(|pair| !pairs.contains(pair)) {
            pairs.push(pair);
        } else if let Some((name, times)) = line.split_once("time:") {
            let name = if name.trim().is_empty() {
                last.trim()
            } else {
                name.trim()
            };
            found.extend(estimate(name, times));
        }
        if !line.trim().is_empty() {
            last = line;
        }
    }
    let beside = |row: &Row| -> Vec<Row> {
        let own = pairs.iter().filter(|pair| pair.ours == row.name);
        let with_peer = own.filter_map(|pair| {
            let theirs = found.iter().find(|other| other.name == pair.theirs)?;
            let theirs = theirs.value * (seconds(&theirs.unit)? / seconds(&row.unit)?);
            Some(row.clone().beside(&pair.peer, theirs))
        });
        with_peer.collect()
    };
    let is_a_peers = |row: &&Row| pairs.iter().any(|pair| pair.theirs == row.name);
    let own = found.iter().filter(|row| !is_a_peers(row));
    own.flat_map(|row| match beside(row) {
        rows if rows.is_empty() => vec![row.clone()],
        rows => rows,
    })
    .collect()
}

/// The middle one of `[1.23 us 1.25 us 1.27 us]`.
fn estimate(name: &str, times: &str) -> Option<Row> {
    let times = times.trim().strip_prefix('[')?.strip_suffix(']')?;
    let words: Vec<&str> = times.split_whitespace().collect();
    let (value, unit) = (words.get(2)?.parse().ok()?, words.get(3)?.replace('µ', "u"));
    Some(Row::new(name, value, &unit))
}

/// A unit of time, s.
pub fn seconds(unit: &str) -> Option<f64> {
    match unit {
        "ps" => Some(1e-12),
        "ns" => Some(1e-9),
        "us" => Some(1e-6),
        "ms" => Some(1e-3),
        "s" => Some(1.0),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_and_criterion_s_estimates_are_found() {
        let output = "tick/30 nodes            time:   [358.1 ns 360.4 ns 363.0 ns]\nBenchmarking a long name\na long name\n   \
                      time:   [1.0000 µs 1.2000 µs 1.4000 µs]\nrow: A* | 1.5 | ms | pathfinding | 6\nnothing\n";
        let found = rows(output);
        let expected = [
            Row::new("tick/30 nodes", 360.4, "ns"),
            Row::new("a long name", 1.2, "us"),
            Row::new("A*", 1.5, "ms").beside("pathfinding", 6.0),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn peers_stand_beside_ours_in_our_unit() {
        let output = "rays/ours time: [1 ms 2 ms 3 ms]\nrays/parry time: [1 s 4 s 9 s]\nrays/alone time: [5 ns 5 ns 5 ns]\n\
                      pair: rays/ours | parry | rays/parry\npair: rays/ours | nobody | rays/nobody\n";
        let found = rows(output);
        let expected = [
            Row::new("rays/ours", 2.0, "ms").beside("parry", 4000.0),
            Row::new("rays/alone", 5.0, "ns"),
        ];
        assert_eq!(found, expected);
        assert_eq!(ratio(&found[0]), Some(2000.0));
        let rate = Row::new("steps", 50.0, "steps/s").beside("IR-SIM", 100.0);
        assert_eq!(ratio(&rate), Some(0.5), "the peer does twice as many");
    }

    #[test]
    fn a_row_of_the_page_is_read_again() {
        let alone = Row::new("worlds that pass, of 10000", 9999.0, "");
        let beside = Row::new("A*", 1.5, "ms").beside("pathfinding", 6.0);
        for row in [alone, beside] {
            assert_eq!(read(&written(&row)), Some(row));
        }
        assert_eq!(read(HEADER.lines().next().unwrap()), None);
    }

    #[test]
    fn figures_have_three_digits() {
        for (value, text) in [
            (1.23456, "1.23"),
            (123_456.7, "123457"),
            (0.001_234, "0.00123"),
            (0.0, "0"),
            (20.0, "20.0"),
            (98.76, "98.8"),
        ] {
            assert_eq!(figure(value), text);
        }
        assert_eq!(own_figure(&Row::new("seeds that succeed", 20.0, "")), "20");
    }

    #[test]
    fn what_was_not_run_stays_on_the_page() {
        let last =
            "# Benchmarks\n\n## Time laws\n\nthe first\n\n## Scan insertion\n\nthe second\n\nNot run here: bus.\n";
        let again = page(Path::new("no such folder"), last, None);
        assert_eq!(section(&again, "Time laws"), Some("\nthe first\n"));
        assert_eq!(section(&again, "Scan insertion"), Some("\nthe second\n"));
        assert_eq!(section(&again, "Behaviour trees"), None);
        assert_eq!(section(&again, earlier::TITLE), None);
        assert!(again.contains("\nNot run here: kitchen, "), "{again}");
        let compared = page(Path::new("no such folder"), last, Some("nothing"));
        let later = page(Path::new("no such folder"), &compared, None);
        assert_eq!(compared, later, "without the first figures their table stays as it is");
    }
}
