//! Writes `BENCHMARKS.md`: the figures of every bench and acceptance run, with machine and commit.
//!
//! `cargo run --release -p zenav-tests --bin benchmarks [NAME…]` runs all benches, or those named, and writes the page; sections of other
//! runs stay unchanged. Each run's own output is kept in `target/benchmarks/NAME.txt`. A figure is a line `row: NAME | VALUE | UNIT [| PEER
//! | PEER'S VALUE]` ([`zenav_fixtures::Row`]) or criterion's `NAME time: [LOW ESTIMATE HIGH]`; each becomes a row of the page.

#![expect(clippy::print_stdout, reason = "a command that says what it runs")]

use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use clap::Parser;
use zenav::parallel;
use zenav_fixtures::Row;
use zenav_tests::provenance::{field, output, processor};

/// A bench or an acceptance run.
struct Run {
    name: &'static str,
    /// What it measures.
    title: &'static str,
    /// Arguments of `cargo`, or a binary of the workspace with its arguments.
    arguments: &'static str,
}

macro_rules! runs {
    ($($name:literal: $title:literal, $arguments:literal;)*) => {
        &[$(Run { name: $name, title: $title, arguments: $arguments }),*]
    };
}

/// Everything that the page shows, in its order.
const RUNS: &[Run] = runs! {
    "kitchen": "The kitchen mission, 20 seeds over real Zenoh sessions", "acceptance kitchen 20 --speed 8";
    "online": "A house that nobody has mapped, 20 seeds", "acceptance online 20 --speed 6";
    "guard": "The collision monitor in random worlds with movers and adversarial commands", "acceptance guard 10000";
    "pose": "Consistency of the pose estimate", "acceptance pose 100 1000001";
    "localise": "Localisation from random places without a guess", "acceptance localise 1000 --seed 1001";
    "kidnapped": "Robots that are carried away while they drive in a known map", "acceptance kidnapped 260 1001";
    "kidnapped_slam": "Robots that are carried away while they map", "acceptance kidnapped 60 1001 --slam";
    "corrections": "Localisation in changed houses, and robots that it corrects over a bad link", "acceptance corrections 20 1001";
    "closure": "A loop closure that moves the map by a metre under a driving robot", "acceptance closure 20 11";
    "track": "Path error of the trackers", "acceptance track";
    "economy": "Energy of the fastest and the most economical drives", "acceptance economy";
    "kills": "A mission killed at random instants", "acceptance kills 200";
    "handover": "Two missions, the leader killed and paused", "acceptance handover 14 2 77";
    "fleet": "100 robots' missions on one core", "acceptance fleet 100 30";
    "footprint": "The robot's binary alone", "acceptance footprint";
    "drive_s2": "Driving among discs on random polylines", "zenav bench drive --suite s2";
    "drive_s3": "Driving among people who do not look", "zenav bench drive --suite s3";
    "drive_s4": "Driving among people who make way", "zenav bench drive --suite s4";
    "drive_s5": "Driving in tight places", "zenav bench drive --suite s5";
    "drive_s6": "Driving among clutter, in traps and an office", "zenav bench drive --suite s6";
    "drive_s7": "Waiting for what may leave", "zenav bench drive --suite s7";
    "drive_s8": "Office and hall without GPS and compass", "zenav bench drive --suite s8 --first-seed 140";
    "drive_s9": "Driving with broken sensors", "zenav bench drive --suite s9";
    "drive_s11": "Robots among robots, one seed", "zenav bench drive --suite s11 --seeds 1";
    "drive_s12": "Processor time on long ways", "zenav bench drive --suite s12";
    "search": "A* and JPS beside the crate pathfinding", "bench -p zenav-planning --bench search";
    "sampling": "Sampling planners beside OMPL", "bench -p zenav-planning --bench sampling";
    "smoothing": "Trajectories from planned paths, each checked", "bench -p zenav-smoothing --bench smoothing";
    "timing": "Time laws", "bench -p zenav-smoothing --bench timing";
    "mapping": "Scan insertion", "bench -p zenav-mapping --bench mapping";
    "space": "Distance fields, and footprints beside parry", "bench -p zenav-space --bench space";
    "sight": "Lines of sight", "bench -p zenav-space --bench sight";
    "solve": "Pose graphs", "bench -p zenav-pose-graph --bench solve";
    "tick": "Behaviour trees", "bench -p zenav-behaviour-tree --bench tick";
    "avoidance": "One decision of predictive control among people", "bench -p zenav-edge --bench avoidance";
    "collision_monitor": "One decision of the collision monitor, and its geometry beside parry", "bench -p zenav-edge --bench collision_monitor";
    "lidar": "The simulated lidar beside parry's ray cast", "bench -p zenav-sim --bench lidar";
    "simulator": "The simulator beside IR-SIM", "bench -p zenav-tests --bench simulator";
    "pipeline": "Each stage from scan to plan", "bench -p zenav-tests --bench pipeline";
    "bus": "The typed bus beside raw Zenoh", "bench -p zenav-tests --bench bus";
};

/// Runs benches and writes BENCHMARKS.md from their own output
#[derive(Debug, Parser)]
struct Args {
    /// Benches to run; all by default
    names: Vec<String>,
    /// Run nothing: write the page from the last outputs
    #[arg(long)]
    write_only: bool,
    /// The page
    #[arg(long, default_value = "BENCHMARKS.md")]
    out: PathBuf,
}

fn main() -> ExitCode {
    match write(&Args::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn write(args: &Args) -> Result<bool, Box<dyn std::error::Error>> {
    let known = |name: &String| RUNS.iter().any(|run| run.name == name);
    if let Some(name) = args.names.iter().find(|name| !known(name)) {
        let all: Vec<&str> = RUNS.iter().map(|run| run.name).collect();
        return Err(format!("no bench `{name}`; there are {}", all.join(", ")).into());
    }
    let folder = Path::new("target/benchmarks");
    std::fs::create_dir_all(folder)?;
    let mut good = true;
    let is_wanted = |run: &&Run| args.names.is_empty() || args.names.iter().any(|name| name == run.name);
    if !args.write_only {
        let wanted: Vec<&Run> = RUNS.iter().filter(is_wanted).collect();
        if wanted.iter().any(|run| run.arguments.starts_with("acceptance ")) {
            good &= cargo(&["build", "--release", "-p", "zenav-tests", "--bins"])?.1;
        }
        if wanted.iter().any(|run| run.name == "footprint") {
            good &= cargo(&["build", "--profile", "dist", "-p", "zenav-edge"])?.1;
        }
        for run in wanted {
            println!("== {}: {}", run.name, command_line(run));
            let (mut output, succeeded) = cargo(&cargo_arguments(run))?;
            good &= succeeded;
            if !succeeded {
                output.push_str("FAILED\n");
            }
            std::fs::write(
                folder.join(format!("{}.txt", run.name)),
                format!("{}\n{output}", provenance()),
            )?;
        }
    }
    let last = std::fs::read_to_string(&args.out).unwrap_or_default();
    std::fs::write(&args.out, page(folder, &last))?;
    println!("{} is written", args.out.display());
    Ok(good)
}

fn cargo_arguments(run: &Run) -> Vec<&'static str> {
    let words: Vec<&str> = run.arguments.split(' ').collect();
    match &words[..] {
        ["acceptance", rest @ ..] => built("zenav-tests", "acceptance", rest),
        ["zenav", rest @ ..] => built("zenav", "zenav", rest),
        arguments => arguments.to_vec(),
    }
}

/// Arguments with which cargo runs a binary of a package.
fn built(package: &'static str, binary: &'static str, arguments: &[&'static str]) -> Vec<&'static str> {
    let cargo = ["run", "--release", "-q", "-p", package, "--bin", binary, "--"];
    [&cargo, arguments].concat()
}

/// The command as it is typed.
fn command_line(run: &Run) -> String {
    let program = match run.arguments.split_once(' ') {
        Some(("acceptance" | "zenav", _)) => "target/release/",
        _ => "cargo ",
    };
    format!("{program}{}", run.arguments)
}

/// Runs cargo, shows its output as it comes, and returns it.
fn cargo(arguments: &[&str]) -> std::io::Result<(String, bool)> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut child = Command::new(cargo).args(arguments).stdout(Stdio::piped()).spawn()?;
    let mut output = String::new();
    if let Some(stdout) = child.stdout.take() {
        for line in BufReader::new(stdout).lines() {
            let line = line?;
            println!("{line}");
            output.push_str(&line);
            output.push('\n');
        }
    }
    Ok((output, child.wait()?.success()))
}

/// Machine, its load after a run, toolchain and commit.
fn provenance() -> String {
    let commit = output("git", &["rev-parse", "--short", "HEAD"]).unwrap_or_else(|| "unknown".to_owned());
    let changed = output("git", &["status", "--porcelain", "--untracked-files=no"]).map_or("", |_| " with changes");
    let date = output("date", &["-u", "+%F"]).unwrap_or_default();
    let rust = output("rustc", &["--version"]).unwrap_or_default();
    let processor = processor();
    let memory = field("/proc/meminfo", "MemTotal").unwrap_or_default();
    let system = field("/etc/os-release", "PRETTY_NAME").unwrap_or_default();
    let cores = parallel::cores();
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let load = load.split(' ').next().unwrap_or_default();
    format!("commit {commit}{changed}, {date}; {cores} x {processor}, load {load}, {memory}, {system}; {rust}")
}

/// The section of a run on an earlier page, without its title.
fn section<'a>(page: &'a str, title: &str) -> Option<&'a str> {
    let (_, after) = page.split_once(&format!("\n## {title}\n"))?;
    let end = after.find("\n## ").or_else(|| after.find("\nNot run here:"));
    Some(&after[..end.unwrap_or(after.len())])
}

/// The page, from the runs' outputs; sections without an output are taken from the last page.
fn page(folder: &Path, last: &str) -> String {
    let mut page = String::from(
        "# Benchmarks\n\nWritten by `cargo run --release -p zenav-tests --bin benchmarks` from the output of the commands below: every row that they print, \
         losing ones too. Where a peer was measured, it was in the same run on the same machine; the ratio is its figure over ours. `load`: \
         mean number of running threads at the end of the run; above those of the bench, its times are longer for other work.\n",
    );
    let mut missing = Vec::new();
    for run in RUNS {
        let Ok(output) = std::fs::read_to_string(folder.join(format!("{}.txt", run.name))) else {
            match section(last, run.title) {
                Some(section) => {
                    let _ = write!(page, "\n## {}\n{section}", run.title);
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
        page.push_str("| what | zenav | unit | peer | its figure | ratio |\n|---|---|---|---|---|---|\n");
        for row in rows {
            let (peer, figure, ratio) = match &row.peer {
                Some((peer, value)) => (peer.as_str(), figure(*value), figure(value / row.value)),
                None => ("", String::new(), String::new()),
            };
            let _ = writeln!(
                page,
                "| {} | {} | {} | {peer} | {figure} | {ratio} |",
                row.name,
                self::figure(row.value),
                row.unit
            );
        }
        if output.trim_end().ends_with("FAILED") {
            page.push_str("\nThis run did not pass.\n");
        }
    }
    if !missing.is_empty() {
        let _ = write!(page, "\nNot run here: {}.\n", missing.join(", "));
    }
    page
}

/// Three significant digits.
fn figure(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let digits = 2 - value.abs().log10().floor() as i32;
    format!("{value:.*}", usize::try_from(digits).unwrap_or(0))
}

/// Every figure of an output: rows, and criterion's estimates.
fn rows(output: &str) -> Vec<Row> {
    let mut found = Vec::new();
    let mut last = "";
    for line in output.lines() {
        if let Some(row) = Row::parse(line) {
            found.push(row);
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
    found
}

/// The middle one of `[1.23 us 1.25 us 1.27 us]`.
fn estimate(name: &str, times: &str) -> Option<Row> {
    let times = times.trim().strip_prefix('[')?.strip_suffix(']')?;
    let words: Vec<&str> = times.split_whitespace().collect();
    let (value, unit) = (words.get(2)?.parse().ok()?, words.get(3)?.replace('µ', "u"));
    Some(Row::new(name, value, &unit))
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
    fn figures_have_three_digits() {
        for (value, text) in [
            (1.23456, "1.23"),
            (123_456.7, "123457"),
            (0.001_234, "0.00123"),
            (0.0, "0"),
            (98.76, "98.8"),
        ] {
            assert_eq!(figure(value), text);
        }
    }
    #[test]
    fn what_was_not_run_stays_on_the_page() {
        let last =
            "# Benchmarks\n\n## Time laws\n\nthe first\n\n## Scan insertion\n\nthe second\n\nNot run here: bus.\n";
        let again = page(Path::new("no such folder"), last);
        assert_eq!(section(&again, "Time laws"), Some("\nthe first\n"));
        assert_eq!(section(&again, "Scan insertion"), Some("\nthe second\n"));
        assert_eq!(section(&again, "Behaviour trees"), None);
        assert!(again.contains("\nNot run here: kitchen, "), "{again}");
    }
}
