//! First figures. What did the same commands measure at first?
//!
//! The repository's history has them: the first page with all benches, and for BARN the README of the day before. They were measured on
//! other machines under other load, so where a peer ran beside, its time over ours is compared, not the time.

use std::fmt::Write as _;

use zenav_fixtures::Row;
use zenav_tests::provenance::output;

use crate::RUNS;
use crate::page::{figure, own_figure, ratio, read, seconds, section};

/// Title of the section.
pub const TITLE: &str = "Beside the first figures";

/// The pages in the repository's history that hold the first figures.
const PAGES: [&str; 2] = ["536e4186:BENCHMARKS.md", "dfdc322:README.md"];

/// A number of a text: in the line that begins with these words, so many words after them.
type Word = (&'static str, usize);

/// Where on a page a figure stands.
enum Figure {
    /// In the row whose name begins so.
    Of(&'static str),
    /// In a text.
    Word(Word),
    /// Rows of a peer and of ours: its time over ours.
    Times(&'static str, &'static str),
    /// The same in texts.
    WordTimes(Word, Word),
    /// In texts: at first, and now.
    Moved(Word, Word),
}

use Figure::{Moved, Of, Times, WordTimes};

macro_rules! compared {
    ($($run:literal: $what:literal, $place:expr;)*) => {
        &[$(($run, $what, $place)),*]
    };
}

/// The figures that are compared: their run, what they are, and where they stand.
const COMPARED: &[(&str, &str, Figure)] = compared! {
    "kitchen": "seeds that succeed, of 20", Of("kitchen: seeds that succeed");
    "kitchen": "largest error", Of("kitchen: largest error");
    "kitchen": "least clearance", Of("kitchen: least clearance");
    "online": "seeds that succeed, of 20", Of("online: seeds that succeed");
    "online": "largest error", Of("online: largest error");
    "online": "least clearance", Of("online: least clearance");
    "drive_s1": "BARN's score in 50 worlds, at most 0.5", Moved(BARN_FIRST, BARN);
    "guard": "worlds that pass, of 10,000", Of("worlds that pass, of 10000");
    "guard": "hardest contact", Of("hardest contact");
    "pose": "NEES in its band, all sensors", Of("all sensors: NEES");
    "pose": "NEES in its band, GPS lost", Of("GPS lost for 30 s: NEES");
    "pose": "NEES in its band, IMU lost", Of("IMU lost for 30 s: NEES");
    "track": "path error of the time law, p95", Of("kitchen time_law: path error");
    "kills": "goals acknowledged", Of("goals acknowledged");
    "kills": "goals that succeeded, each once", Of("goals that succeeded");
    "handover": "another mission leads, longest", Of("another mission leads, longest");
    "fleet": "processor of 100 missions", Of("100 robots: processor");
    "fleet": "memory a robot", Of("100 robots: memory a robot");
    "fleet": "heartbeat off by, p99", Of("100 robots: heartbeat off by, p99");
    "footprint": "binary", Of("zenav-edge: binary");
    "footprint": "processor", Of("zenav-edge: processor");
    "footprint": "memory", Of("zenav-edge: memory");
    "search": "50 queries in an office, A*", Of("office/astar");
    "search": "50 queries in an office, JPS", Of("office/jps");
    "search": "clutter of 25 %, JPS over A*", Times("clutter-25/jps", "clutter-25/astar");
    "sampling": "caves, RRT-Connect, OMPL's time over ours", WordTimes(CAVES_OMPL, CAVES);
    "sampling": "caves, RRT*, length over the grid's shortest", Figure::Word(CAVES_STAR);
    "smoothing": "TIAGo, smoothed of 200", Figure::Word(("tiago 200", 0));
    "smoothing": "TIAGo, ms for 100 m", Figure::Word(("tiago 200", 7));
    "smoothing": "Jackal, smoothed of 200", Figure::Word(("jackal 200", 0));
    "smoothing": "Jackal, ms for 100 m", Figure::Word(("jackal 200", 7));
    "timing": "1,000 points, linear program over sweep", Times(PROGRAM, "time law/sweep/1000");
    "mapping": "667 beams, beam by beam over fast", Times(BY_BEAM, FAST);
    "space": "distances to 10 cells, textbook over ours", Times(TEXTBOOK, TRUNCATED);
    "space": "a changed tile, in place", Of("space 1000x1000, radius 0.25 m/a tile, in place");
    "tick": "tree of 1,000 nodes", Of("tick/nodes/1000");
    "tick": "Nav2's default tree", Of("tick/nav2_default_driving");
    "pipeline": "insertion of a scan", Of("map insertion of a scan");
    "pipeline": "scan to plan", Of("scan to plan");
    "pipeline": "tick of the edge", Of("tick of the edge");
    "bus": "scan, raw Zenoh's time over ours", Times("", "scan, publish to receive");
    "bus": "ask, raw Zenoh's time over ours", Times("", "ask, question to answer");
};

const BARN_FIRST: Word = (
    "BARN, 50 worlds, Jackal, no map, 100 ms of cloud delay 50 of 50 reached, 0 collisions, mean score",
    0,
);
const BARN: Word = ("S1 BARN, noise 1 cm zenav", 8);
const CAVES: Word = ("caves zenav rrt_connect", 1);
const CAVES_OMPL: Word = ("caves ompl rrt_connect", 1);
const CAVES_STAR: Word = ("caves zenav rrt_star", 3);
const PROGRAM: &str = "time law/linear program/1000";
const BY_BEAM: &str = "insert flat, 667 beams, 5.6 m/reference";
const FAST: &str = "insert flat, 667 beams, 5.6 m/fast";
const TRUNCATED: &str = "distance 1000x1000/to 10 cells/random 20 %";
const TEXTBOOK: &str = "distance 1000x1000/textbook, to 10 cells/random 20 %";

/// The pages with the first figures; `None` without the repository's history.
pub fn figures() -> Option<String> {
    let pages = PAGES.into_iter().map(|page| output("git", &["show", page]));
    Some(pages.collect::<Option<Vec<String>>>()?.join("\n"))
}

/// The first figures beside those of a page.
pub fn table(first: &str, now: &str) -> String {
    let [page, readme] = PAGES;
    let mut table = format!(
        "At first: `git show {page}`, for BARN `git show {readme}`. Other machines, other load: times are not comparable, ratios to a peer \
         of the same run are. Now: the sections above.\n\n| run | what | at first | now |\n|---|---|---|---|\n"
    );
    for (run, what, place) in COMPARED {
        let cell = |found: Option<String>| found.unwrap_or_else(|| "-".to_owned());
        let at_first = cell(place.on(first, true));
        let now = match place.on(now, false) {
            Some(_) if origin(now, run).is_some_and(|origin_now| origin(first, run) == Some(origin_now)) => {
                "not run again".to_owned()
            }
            found => cell(found),
        };
        let _ = writeln!(table, "| {run} | {what} | {at_first} | {now} |");
    }
    table
}

/// Commit and machine of a run's section.
fn origin<'a>(page: &'a str, run: &str) -> Option<&'a str> {
    let title = RUNS.iter().find(|known| known.name == run)?.title;
    section(page, title)?.lines().find(|line| line.starts_with("commit "))
}

impl Figure {
    /// The figure on a page: that of the first figures, or today's.
    fn on(&self, page: &str, is_first: bool) -> Option<String> {
        match *self {
            Of(name) => row(page, name).map(|row| format!("{} {}", own_figure(&row), row.unit).trim().to_owned()),
            Self::Word(place) => word(page, place),
            Times(theirs, ours) => {
                let ours = row(page, ours)?;
                let beside = || {
                    let theirs = row(page, theirs)?;
                    Some(theirs.value * seconds(&theirs.unit)? / (ours.value * seconds(&ours.unit)?))
                };
                ratio(&ours).or_else(beside).map(figure)
            }
            WordTimes(theirs, ours) => {
                let number = |place| word(page, place)?.parse::<f64>().ok();
                Some(figure(number(theirs)? / number(ours)?))
            }
            Moved(first, now) => word(page, if is_first { first } else { now }),
        }
    }
}

/// The first row whose name begins so.
fn row(page: &str, name: &str) -> Option<Row> {
    page.lines().filter_map(read).find(|row| row.name.starts_with(name))
}

/// A number in a text, as it stands there.
fn word(page: &str, (begin, after): Word) -> Option<String> {
    let begin = words(begin);
    let line = page.lines().map(words).find(|line| line.starts_with(&begin))?;
    let found = line.get(begin.len() + after)?.trim_matches(['(', ')', ',']);
    found.split('/').next().map(str::to_owned)
}

/// The words of a line, or of a table's row.
fn words(line: &str) -> Vec<&str> {
    let words = line.split(|c: char| c.is_whitespace() || c == '|');
    words.filter(|word| !word.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIRST: &str = "\n## Behaviour trees\n\ncommit 1\n\n| tick/nodes/1000 | 10.3 | us |  |  |  |\n\n## Time laws\n\ncommit 1\n\n| time law/sweep/1000 | 25.0 | us |  |  |  |\n\
                         | time law/linear program/1000 | 10.0 | ms |  |  |  |\n\
                         caves   zenav rrt_connect   30/30   0.5   1.2\ncaves   ompl rrt_connect   30/30   20.0   30\n\
                         | BARN, 50 worlds, Jackal, no map, 100 ms of cloud delay | 50 of 50 reached, 0 collisions, mean score 0.494 (0.5 is |\n";
    const NOW: &str = "\n## Behaviour trees\n\ncommit 1\n\n| tick/nodes/1000 | 10.3 | us |  |  |  |\n\n## Time laws\n\ncommit 2\n\n| time law/sweep/1000 | 30.0 | us | linear program | 15000 | 500 |\n| tiago | 200 | 199 | x |\n\
                       S1 BARN, noise 1 cm  zenav  50  50  50  0  0  0  1.20  0.01  0.500  worst\n";

    #[test]
    fn figures_are_found_where_they_stand() {
        let table = table(FIRST, NOW);
        for line in [
            "| tick | tree of 1,000 nodes | 10.3 us | not run again |",
            "| tick | Nav2's default tree | - | - |",
            "| timing | 1,000 points, linear program over sweep | 400 | 500 |",
            "| sampling | caves, RRT-Connect, OMPL's time over ours | 40.0 | - |",
            "| smoothing | TIAGo, smoothed of 200 | - | 199 |",
            "| drive_s1 | BARN's score in 50 worlds, at most 0.5 | 0.494 | 0.500 |",
        ] {
            assert!(table.lines().any(|found| found == line), "{line}\n{table}");
        }
    }
}
