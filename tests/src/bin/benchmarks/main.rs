//! Writes `BENCHMARKS.md`: the figures of every bench and acceptance run, with machine and commit.
//!
//! `cargo run --release -p zenav-tests --bin benchmarks [NAME…]` runs all benches, or those named, and writes the page; sections of other
//! runs stay unchanged. Each run's own output is kept in `target/benchmarks/NAME.txt`. A figure is a line `row: NAME | VALUE | UNIT [| PEER
//! | PEER'S VALUE]` ([`zenav_fixtures::Row`]) or criterion's `NAME time: [LOW ESTIMATE HIGH]`; each becomes a row of the page. A line
//! `pair: OURS | PEER | THEIRS` ([`zenav_fixtures::Pair`]) puts the figure of one row beside that of another.
//!
//! | module | answers |
//! |---|---|
//! | `page` | what stands on the page? |
//! | `earlier` | what were the figures at first? |

#![expect(clippy::print_stdout, reason = "a command that says what it runs")]

mod earlier;
mod page;

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use clap::Parser;
use zenav::parallel;
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

/// The folder with BARN's worlds, which are not shipped; all benches are run without it too.
const BARN: &str = "barn";

/// Everything that the page shows, in its order.
const RUNS: &[Run] = runs! {
    "kitchen": "The kitchen mission, 20 seeds over real Zenoh sessions", "acceptance kitchen 20 --speed 8";
    "online": "A house that nobody has mapped, 20 seeds", "acceptance online 20 --speed 6";
    "guard": "The collision monitor in random worlds with movers and adversarial commands", "acceptance guard 10000";
    "pose": "Consistency of the pose estimate", "acceptance pose 100 1000001";
    "localise": "Localisation from random places without a guess", "acceptance localise 1000 --seed 1001";
    "kidnapped": "Robots that are carried away while they drive in a known map", "acceptance kidnapped 260 1001";
    "kidnapped_slam": "Robots that are carried away while they map", "acceptance kidnapped 60 1001 --slam";
    "corrections": "Localisation in changed houses, and robots that it corrects over a bad link", "acceptance corrections 20 4001";
    "closure": "A loop closure that moves the map by a metre under a driving robot", "acceptance closure 20 11";
    "track": "Path error of the trackers", "acceptance track";
    "economy": "Energy of the fastest and the most economical drives", "acceptance economy";
    "kills": "A mission killed at random instants", "acceptance kills 200";
    "handover": "Two missions, the leader killed and paused", "acceptance handover 14 2 77";
    "fleet": "100 robots' missions on one core", "acceptance fleet 100 30";
    "workers": "Motion requests of 100 robots, one worker of two frozen", "acceptance workers 100";
    "footprint": "The robot's binary alone", "acceptance footprint";
    "drive_s1": "Driving in BARN's worlds, ranges noisy to 1 cm", "zenav bench drive --suite s1 --worlds barn --noise 1";
    "drive_s2": "Driving among discs on random polylines", "zenav bench drive --suite s2";
    "drive_s3": "Driving among people who do not look", "zenav bench drive --suite s3";
    "drive_s4": "Driving among people who make way", "zenav bench drive --suite s4";
    "drive_s5": "Driving in tight places", "zenav bench drive --suite s5";
    "drive_s6": "Driving among clutter, in traps and an office", "zenav bench drive --suite s6";
    "drive_s7": "Waiting for what may leave", "zenav bench drive --suite s7";
    "drive_s8": "Office and hall without GPS and compass", "zenav bench drive --suite s8 --first-seed 300";
    "drive_s9": "Driving with broken sensors", "zenav bench drive --suite s9";
    "drive_s11": "Robots among robots, one seed", "zenav bench drive --suite s11 --seeds 1";
    "drive_s12": "Processor time on long ways", "zenav bench drive --suite s12";
    "search": "A* and JPS beside the crate pathfinding", "bench -p zenav-planning --bench search";
    "sampling": "Sampling planners beside OMPL", "bench -p zenav-planning --bench sampling";
    "space_time": "A path past other robots", "bench -p zenav-planning --bench space_time";
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
    "metrics": "A counter, and a scrape of ten robots", "run --release -q -p zenav-observability --example cost";
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
    let is_wanted = |run: &&Run| match &args.names[..] {
        [] => run.name != "drive_s1" || Path::new(BARN).is_dir(),
        names => names.iter().any(|name| name == run.name),
    };
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
    std::fs::write(&args.out, page::page(folder, &last, earlier::figures().as_deref()))?;
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
