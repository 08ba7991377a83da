//! Acceptance runs: long runs that the test suite leaves out.
//!
//! `cargo build --release -p zenav-tests --bins && target/release/acceptance kitchen 20 --speed 4`

#![expect(clippy::print_stdout, reason = "a command that prints its findings")]

mod demo;
mod drives;
mod faults;
mod footprint;
mod guard;
mod hosts;
mod missions;
mod page;
mod pose;
mod whereabouts;

use std::panic::{self, AssertUnwindSafe, PanicHookInfo};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Parser;
use zenav_tests::acceptance::fleet::Fleet;

/// Whether the results are as expected.
type Verdict = Result<bool, Box<dyn std::error::Error>>;

/// Long runs: each prints its results, and exits with 0 if they are as expected
#[derive(Debug, Parser)]
enum Run {
    /// Missions in the kitchen
    Kitchen(Seeds),
    /// Missions in an unmapped house
    Online(Seeds),
    /// Path error of every tracker on the same paths
    Track {
        /// More maps to drive in
        maps: Vec<String>,
    },
    /// Energy of the fastest drives compared with the most economical ones
    Economy {
        /// More maps to drive in
        maps: Vec<String>,
    },
    /// Consistency of the pose estimate: NEES and NIS
    Pose {
        runs: u64,
        #[arg(default_value_t = 1)]
        first_seed: u64,
    },
    /// Loop closures that move the map by a metre while the robot drives
    Closure {
        runs: u64,
        #[arg(default_value_t = 1)]
        first_seed: u64,
    },
    /// Robots that are kidnapped while they drive
    Kidnapped {
        runs: u64,
        #[arg(default_value_t = 1)]
        first_seed: u64,
        /// Without a known map: the robots map by SLAM
        #[arg(long)]
        slam: bool,
    },
    /// Localisation in houses with moved furniture and people, and robots that it corrects late and with losses
    Corrections {
        runs: u64,
        #[arg(default_value_t = 1)]
        first_seed: u64,
    },
    /// Global localisation from random places in an office of 100 m by 100 m, and in the given maps
    Localise {
        places: usize,
        maps: Vec<PathBuf>,
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// The collision monitor in random worlds with movers and adversarial commands
    Guard {
        worlds: u64,
        #[arg(default_value_t = 1)]
        first_seed: u64,
    },
    /// One of the worlds of `guard`, tick by tick
    Replay { seed: u64 },
    /// A mission that is killed repeatedly
    Kills {
        kills: usize,
        #[arg(default_value_t = 1)]
        seed: u64,
    },
    /// Two missions: the leader is killed repeatedly, then paused for 20 s and its standby for 5 s
    Handover {
        deaths: usize,
        #[arg(default_value_t = 0)]
        pauses: usize,
        #[arg(default_value_t = 1)]
        seed: u64,
    },
    /// Bad links, and parts that are killed, frozen, or started in any order: a table
    Faults(faults::Faults),
    /// Missions of many robots, in one process on one core or in several
    Fleet(Fleet),
    /// Motion requests of many robots, to one worker and to two, of which one freezes
    Workers {
        robots: usize,
        #[arg(default_value_t = 20.0)]
        secs: f64,
        #[arg(default_value_t = 1)]
        seed: u64,
    },
    /// A multi-host deployment as containers, or in network namespaces: every part killed, frozen, cut off and replaced, for a number of
    /// rounds; 0 is the short trial of the tests
    Compose {
        #[arg(default_value_t = 1)]
        rounds: usize,
    },
    /// The same deployment for some minutes, with faults in a random order: checks that the parts that run throughout do not grow
    Soak {
        minutes: f64,
        #[arg(long, default_value_t = 1.0)]
        speed: f64,
        #[arg(default_value_t = 1)]
        seed: u64,
    },
    /// The mission-control page with many robots: processor time of the gateway, frames of a headless Chromium
    Page {
        #[arg(default_value_t = 20)]
        robots: usize,
        #[arg(default_value_t = 20)]
        secs: u64,
    },
    /// Browsers that watch and never read: memory of the gateway
    SlowSockets {
        #[arg(default_value_t = 1000)]
        sockets: usize,
        #[arg(default_value_t = 60)]
        secs: u64,
    },
    /// Size, processor time, memory and loop jitter of the robot's own binary
    Footprint {
        #[arg(default_value_t = 60)]
        secs: u64,
    },
}

#[derive(Debug, clap::Args)]
struct Seeds {
    seeds: u64,
    /// Arguments of `zenav demo`
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    more: Vec<String>,
}

/// Whether nobody reads the findings any more (`acceptance guard 10 | head -1`).
static IS_UNREAD: AtomicBool = AtomicBool::new(false);

/// Whether `println!` found the pipe closed.
fn is_closed_pipe(why: &PanicHookInfo<'_>) -> bool {
    let why = why.payload().downcast_ref::<String>();
    why.is_some_and(|why| why.starts_with("failed printing to stdout: Broken pipe"))
}

fn main() -> ExitCode {
    let run = Run::parse();
    // A closed pipe ends the run without an error. It still unwinds, which ends the processes that the run has started.
    let tell = panic::take_hook();
    panic::set_hook(Box::new(move |why| {
        IS_UNREAD.fetch_or(is_closed_pipe(why), Ordering::Relaxed);
        if !IS_UNREAD.load(Ordering::Relaxed) {
            tell(why);
        }
    }));
    match panic::catch_unwind(AssertUnwindSafe(|| carry_out(run))) {
        _ if IS_UNREAD.load(Ordering::Relaxed) => ExitCode::SUCCESS,
        Ok(Ok(true)) => ExitCode::SUCCESS,
        Ok(Ok(false)) => ExitCode::FAILURE,
        Ok(Err(error)) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
        Err(why) => panic::resume_unwind(why),
    }
}

fn carry_out(run: Run) -> Verdict {
    match run {
        Run::Kitchen(Seeds { seeds, more }) => demo::demo("kitchen", seeds, &more),
        Run::Online(Seeds { seeds, more }) => demo::demo("online", seeds, &more),
        Run::Track { maps } => drives::track(&maps),
        Run::Economy { maps } => drives::economy(&maps),
        Run::Pose { runs, first_seed } => pose::pose(runs, first_seed),
        Run::Closure { runs, first_seed } => whereabouts::closure(runs, first_seed),
        Run::Kidnapped { runs, first_seed, slam } => whereabouts::kidnapped(runs, first_seed, slam),
        Run::Corrections { runs, first_seed } => whereabouts::corrections(runs, first_seed),
        Run::Localise { places, maps, seed } => whereabouts::localise(places, &maps, seed),
        Run::Guard { worlds, first_seed } => guard::guard(worlds, first_seed),
        Run::Replay { seed } => guard::replay(seed),
        Run::Kills { kills, seed } => missions::kills(kills, seed),
        Run::Handover { deaths, pauses, seed } => missions::handover(deaths, pauses, seed),
        Run::Fleet(fleet) => missions::fleet(fleet),
        Run::Workers { robots, secs, seed } => missions::workers(robots, secs, seed),
        Run::Compose { rounds } => hosts::compose(rounds),
        Run::Soak { minutes, speed, seed } => hosts::soak(minutes, speed, seed),
        Run::Page { robots, secs } => page::page(robots, secs),
        Run::SlowSockets { sockets, secs } => page::slow_sockets(sockets, secs),
        Run::Faults(arguments) => faults::run(&arguments),
        Run::Footprint { secs } => footprint::footprint(secs),
    }
}

/// The `zenav` binary that was built with this one.
fn zenav() -> PathBuf {
    beside("zenav-under-test")
}

/// A binary in the same folder.
fn beside(name: &str) -> PathBuf {
    let own = std::env::current_exe().unwrap_or_default();
    own.with_file_name(format!("{name}{}", std::env::consts::EXE_SUFFIX))
}
