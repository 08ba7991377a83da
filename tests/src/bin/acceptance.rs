//! The long runs that the test suite leaves out: many seeds of a scenario, each as a process of its own.
//!
//! `cargo build --release -p zenav-tests --bins && target/release/acceptance kitchen 20 --speed 4`

#![expect(clippy::print_stdout, reason = "a command that prints its findings")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};
use serde_json::Value;
use zenav_cloud::mapping::map_file::read_map;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::DrivingProfile;
use zenav_protocol::robot::TrackerKind;
use zenav_sim::World;
use zenav_tests::proving::fleet;
use zenav_tests::proving::ground::robot;
use zenav_tests::proving::guard::GENTLE;
use zenav_tests::proving::handover::Blow;
use zenav_tests::proving::pose;
use zenav_tests::proving::tracking::{self, percentile};
use zenav_tests::proving::witness::Findings;

/// Largest true distance from a goal that counts as reached, m; where nothing corrects odometry, it drifts.
fn max_error(scenario: &str) -> f64 {
    if scenario == "online" { 0.25 } else { 0.15 }
}
/// Least distance to anything, m.
const MIN_CLEARANCE: f64 = 0.02;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words.as_slice() {
        ["track", maps @ ..] => verdict(tracked(maps)),
        ["economy", maps @ ..] => verdict(economy(maps)),
        ["pose", runs, rest @ ..] if runs.parse::<u64>().is_ok() => pose(runs.parse().unwrap_or(0), rest),
        ["footprint"] => footprint(60),
        ["footprint", secs] if secs.parse::<u64>().is_ok() => footprint(secs.parse().unwrap_or(0)),
        ["guard", worlds, rest @ ..] if worlds.parse::<u64>().is_ok() => guard(worlds.parse().unwrap_or(0), rest),
        ["replay", seed] if seed.parse::<u64>().is_ok() => replay(seed.parse().unwrap_or(0)),
        ["kills", kills, rest @ ..] if kills.parse::<usize>().is_ok() => kill(kills.parse().unwrap_or(0), rest),
        ["handover", deaths, rest @ ..] if deaths.parse::<usize>().is_ok() => {
            handover(deaths.parse().unwrap_or(0), rest)
        }
        ["fleet", robots, rest @ ..] if robots.parse::<usize>().is_ok() => fleet(robots.parse().unwrap_or(0), rest),
        [scenario, seeds, rest @ ..] if seeds.parse::<u64>().is_ok() => {
            demo(scenario, seeds.parse().unwrap_or(0), rest)
        }
        _ => {
            eprintln!(
                "usage: acceptance SCENARIO SEEDS [arguments of `zenav demo`…], such as: acceptance kitchen 20 --speed 4\n       \
                 acceptance guard WORLDS [FIRST_SEED]\n       acceptance replay SEED\n       acceptance track [MAP.yaml…]\n       acceptance pose RUNS [FIRST_SEED]\n       acceptance kills KILLS [SEED]\n       \
                 acceptance handover DEATHS [PAUSES [SEED]]\n       \
                 acceptance fleet ROBOTS [SECONDS]\n       acceptance footprint [SECONDS]\n       acceptance economy [MAP.yaml…]"
            );
            ExitCode::from(2)
        }
    }
}

/// Share of steps that must lie within the 95 % band.
const CONSISTENT: f64 = 0.9;
/// Share of steps at which the error is within three standard deviations.
const WITHIN: f64 = 0.99;
/// How long each drive takes, s.
const DRIVE_SECS: f64 = 300.0;

/// Estimates poses in many drives, and prints how often the mean error was as the covariance says.
fn pose(runs: u64, rest: &[&str]) -> ExitCode {
    let first: u64 = rest.first().and_then(|first| first.parse().ok()).unwrap_or(1);
    let clock = || Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).unwrap_or_default();
    let mut good = true;
    println!("seeds {first} to {}", first + runs.saturating_sub(1));
    println!(
        "{:20} {:16} {:>16} {:>10} {:>8}",
        "conditions", "quantity", "band", "in band, %", "mean"
    );
    for conditions in pose::CONDITIONS {
        let mut sums = pose::Sums::default();
        for seed in first..first.saturating_add(runs) {
            if let Err(error) = pose::drive(&mut sums, &conditions, seed, DRIVE_SECS, &clock) {
                eprintln!("{error}");
                return ExitCode::FAILURE;
            }
        }
        let count = runs as f64;
        let mut line = |name: &str, means: &[f64], freedom: f64, of: f64| {
            let band = pose::band(freedom, of);
            let (share, mean) = pose::share(means, band);
            good &= share >= CONSISTENT;
            let band = format!("[{:.2}, {:.2}]", band.0, band.1);
            println!(
                "{:20} {name:16} {band:>16} {:10.1} {mean:8.2}",
                conditions.name,
                100.0 * share
            );
        };
        let nees: Vec<f64> = sums.nees.iter().map(|sum| sum / count).collect();
        line("NEES", &nees, 3.0, count);
        for (name, freedom, sums) in [
            ("NIS compass", 1.0, &sums.nis[0]),
            ("NIS GPS", 2.0, &sums.nis[1]),
            ("NIS correction", 3.0, &sums.nis[2]),
        ] {
            let (means, readings) = pose::means(sums, runs);
            if !means.is_empty() {
                line(name, &means, freedom, readings);
            }
        }
        good &= f64::from(sums.within.0) >= WITHIN * f64::from(sums.within.1);
        println!(
            "{:20} position error within three standard deviations in {:.2} % of steps, at most {:.3} m where up to {:.3} m were allowed for",
            conditions.name,
            100.0 * f64::from(sums.within.0) / f64::from(sums.within.1.max(1)),
            sums.worst,
            sums.allowed,
        );
        println!(
            "{:20} a step takes {:.1} us, p99 {:.1} us; {} fused, {} outliers, {} too late",
            conditions.name,
            1e6 * percentile(&mut sums.took, 0.5),
            1e6 * percentile(&mut sums.took, 0.99),
            sums.tally.fused,
            sums.tally.outliers,
            sums.tally.too_late,
        );
    }
    match pose::latest(&clock) {
        Ok(mut took) => println!(
            "a step with a correction that is as late as may be takes {:.0} us, p99 {:.0} us",
            1e6 * percentile(&mut took, 0.5),
            1e6 * percentile(&mut took, 0.99)
        ),
        Err(error) => {
            eprintln!("{error}");
            good = false;
        }
    }
    if good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Ways a map that every tracker drives.
const WAYS: usize = 12;

fn verdict(good: Result<bool, Box<dyn std::error::Error>>) -> ExitCode {
    match good {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// Shipped worlds and maps to drive in.
fn worlds(shipped: &[&str], maps: &[&str]) -> Result<Vec<World>, Box<dyn std::error::Error>> {
    let mut worlds = Vec::new();
    for name in shipped {
        worlds.push(World::shipped(name)?);
    }
    for name in maps {
        let map = read_map(Path::new(name), 0.05)?;
        worlds.push(World::from_map(name, map, Pose2::IDENTITY));
    }
    Ok(worlds)
}

/// Drives the same ways as fast as the robot may and with the least energy, and prints what the battery gave for it.
fn economy(maps: &[&str]) -> Result<bool, Box<dyn std::error::Error>> {
    let mut good = true;
    println!(
        "{:30} {:18} {:8} {:>8} {:>8} {:>9} {:>11} {:>8} {:>8}",
        "map", "robot", "profile", "way, m", "time, s", "energy, J", "forecast, J", "J/m", "reached"
    );
    for world in &worlds(&["kitchen", "house"], maps)? {
        let map = tracking::true_map(world);
        for name in ["tiago", "jackal", "turtlebot3_waffle", "neato"] {
            let model = robot(name)?;
            let mut sums = Vec::new();
            for (profile, label) in [
                (DrivingProfile::Fastest, "fastest"),
                (DrivingProfile::Economy, "economy"),
            ] {
                let ways = tracking::ways(&map, &model, 1, WAYS, profile);
                let (mut metres, mut secs, mut joules, mut forecast, mut reached) = (0.0, 0.0, 0.0, 0.0, 0);
                for (seed, way) in ways.iter().enumerate() {
                    let drive = tracking::drive(world, &model, TrackerKind::TimeLaw, way, seed as u64 + 1)?;
                    reached += usize::from(drive.secs.is_some() && drive.contacts == 0);
                    metres += drive.length;
                    secs += drive.secs.unwrap_or(f64::NAN);
                    joules += drive.drawn_j;
                    forecast += way.forecast_j;
                }
                good &= reached == ways.len() && !ways.is_empty();
                println!(
                    "{:30} {name:18} {label:8} {metres:8.1} {secs:8.1} {joules:9.0} {forecast:11.0} {:8.2} {:>8}",
                    world.name(),
                    joules / metres,
                    format!("{reached}/{}", ways.len()),
                );
                sums.push((secs, joules));
            }
            if let [(secs, joules), (longer, fewer)] = sums[..] {
                println!(
                    "{:30} {name:18} {:8} {:>8} {:+7.1}% {:+8.1}%",
                    world.name(),
                    "",
                    "",
                    100.0 * (longer / secs - 1.0),
                    100.0 * (fewer / joules - 1.0)
                );
                // Where the electronics take the most, as in a small slow robot, the fastest is the cheapest, and both are one.
                good &= (fewer < joules && longer > secs) || (fewer == joules && longer == secs);
            }
        }
    }
    Ok(good)
}

/// Drives the same ways by every tracker, in the kitchen and in maps, and prints a table.
fn tracked(maps: &[&str]) -> Result<bool, Box<dyn std::error::Error>> {
    let model = robot("tiago")?;
    let worlds = worlds(&["kitchen"], maps)?;
    let mut good = true;
    println!(
        "{:30} {:14} {:>8} {:>8} {:>8} {:>9} {:>9} {:>8} {:>8}",
        "map", "tracker", "p50, cm", "p95, cm", "max, cm", "reached", "time, s", "J/m", "guarded"
    );
    for world in &worlds {
        let ways = tracking::ways(&tracking::true_map(world), &model, 1, WAYS, DrivingProfile::Fastest);
        let mut least = f64::INFINITY;
        for (name, law) in tracking::LAWS {
            let mut errors = Vec::new();
            let (mut reached, mut secs, mut joules, mut metres, mut guarded) = (0, 0.0, 0.0, 0.0, 0);
            for (seed, way) in ways.iter().enumerate() {
                let drive = tracking::drive(world, &model, law, way, seed as u64 + 1)?;
                errors.extend(drive.errors);
                reached += usize::from(drive.secs.is_some() && drive.contacts == 0);
                secs += drive.secs.unwrap_or(f64::NAN);
                joules += drive.drawn_j;
                metres += drive.length;
                guarded += drive.interventions;
            }
            let mut cm = |share| 100.0 * percentile(&mut errors, share);
            let (p50, p95, most) = (cm(0.5), cm(0.95), cm(1.0));
            println!(
                "{:30} {name:14} {p50:8.2} {p95:8.2} {most:8.2} {:>9} {secs:9.1} {:8.1} {guarded:8}",
                world.name(),
                format!("{reached}/{}", ways.len()),
                joules / metres,
            );
            if law == TrackerKind::TimeLaw {
                least = p95;
                good &= p95 < 3.0 && reached == ways.len() && ways.len() == WAYS;
            } else {
                good &= least < p95;
            }
        }
    }
    Ok(good)
}

/// Drives in one of the guard's random worlds, and prints every tick of it as it truly was.
fn replay(seed: u64) -> ExitCode {
    let (mut tick, mut told) = (0, 0);
    let outcome = zenav_tests::proving::guard::drive_watched(seed, |ground| {
        let truth = ground.truth();
        let (pose, twist) = (truth.map_from_base, truth.twist);
        let movers: Vec<_> = ground
            .sim
            .movers()
            .map(|mover| {
                let local = pose.inverse().transform_point(mover);
                format!("({:.2} {:.2})", local.x, local.y)
            })
            .collect();
        println!(
            "{tick:4} at {:.3} {:.3} {:.3}, {:.3} m/s {:.3} rad/s, clearance {:.4}, hardest {:.4}, movers off {} {:?}",
            pose.x,
            pose.y,
            pose.yaw,
            twist.v,
            twist.w,
            truth.clearance,
            truth.hardest_contact,
            movers.join(" "),
            ground.events.iter().skip(told).collect::<Vec<_>>()
        );
        tick += 1;
        told = ground.events.len();
    });
    match outcome {
        Ok(outcome) => {
            println!("{outcome:?}");
            if outcome.is_good() {
                ExitCode::SUCCESS
            } else {
                ExitCode::FAILURE
            }
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// Drives in random worlds on every core, and prints a table by command.
fn guard(worlds: u64, rest: &[&str]) -> ExitCode {
    let first: u64 = rest.first().and_then(|word| word.parse().ok()).unwrap_or(1);
    let next = AtomicU64::new(first);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let work = || {
        let mut done = Vec::new();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= first + worlds {
                return done;
            }
            done.push((seed, zenav_tests::proving::guard::drive(seed)));
        }
    };
    let mut results: Vec<_> = std::thread::scope(|scope| {
        let hands: Vec<_> = (0..cores).map(|_| scope.spawn(work)).collect();
        hands
            .into_iter()
            .filter_map(|hand| hand.join().ok())
            .flatten()
            .collect()
    });
    results.sort_by_key(|(seed, _)| *seed);
    let mut outcomes = Vec::new();
    let mut failed = worlds.abs_diff(results.len() as u64);
    for (seed, result) in results {
        match result {
            Ok(outcome) => {
                if !outcome.is_good() {
                    failed += 1;
                    println!("FAILED {outcome:?}");
                }
                outcomes.push(outcome);
            }
            Err(error) => {
                failed += 1;
                println!("FAILED seed {seed}: {error}");
            }
        }
    }
    println!(
        "{:15} {:>7} {:>9} {:>10} {:>9} {:>13} {:>9} {:>12}",
        "command", "worlds", "of movers", "contacts", "hard ones", "hardest, m/s", "way, m", "interventions"
    );
    let mut by_command: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for outcome in &outcomes {
        by_command.entry(outcome.command).or_default().push(outcome);
    }
    for (command, outcomes) in by_command {
        println!(
            "{:15} {:7} {:9} {:10} {:9} {:13.4} {:9.1} {:12}",
            format!("{command:?}"),
            outcomes.len(),
            outcomes.iter().filter(|outcome| outcome.movers).count(),
            outcomes.iter().map(|outcome| outcome.contacts).sum::<u32>(),
            outcomes.iter().filter(|outcome| outcome.hardest > GENTLE).count(),
            outcomes.iter().map(|outcome| outcome.hardest).fold(0.0, f64::max),
            outcomes.iter().map(|outcome| outcome.length).sum::<f64>(),
            outcomes
                .iter()
                .map(|outcome| outcome.interventions.len())
                .sum::<usize>(),
        );
    }
    println!("{} of {worlds} worlds passed", worlds - failed.min(worlds));
    if failed == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// Kills the orchestrator again and again while goals come in.
fn kill(kills: usize, rest: &[&str]) -> ExitCode {
    let seed = rest.first().and_then(|word| word.parse().ok()).unwrap_or(1);
    tell(zenav_tests::proving::kills::run(
        &zenav().to_string_lossy(),
        kills,
        seed,
    ))
}

/// How long a frozen leader is held, s.
const FROZEN: f64 = 20.0;

/// Kills the leader of two orchestrators again and again, then freezes it, while goals come in.
fn handover(deaths: usize, rest: &[&str]) -> ExitCode {
    let number = |index: usize, otherwise| rest.get(index).and_then(|word| word.parse().ok()).unwrap_or(otherwise);
    let (pauses, seed) = (number(0, 0), number(1, 1));
    let mut blows = vec![Blow::Death; deaths];
    blows.resize(deaths + pauses as usize, Blow::Pause(FROZEN));
    tell(zenav_tests::proving::handover::run(
        &zenav().to_string_lossy(),
        &blows,
        seed,
    ))
}

/// Largest median and 99th percentile of the lateness of a mission's step, s.
const JITTER: (f64, f64) = (0.005, 0.05);

/// Runs the missions of one robot, then of many, with one orchestrator on one core.
fn fleet(robots: usize, rest: &[&str]) -> ExitCode {
    let secs = rest.first().and_then(|word| word.parse().ok()).unwrap_or(60.0);
    let run = async {
        let alone = fleet::run(&zenav().to_string_lossy(), 1, 10.0).await?;
        let many = fleet::run(&zenav().to_string_lossy(), robots, secs).await?;
        Ok::<_, String>((alone, many))
    };
    let found = tokio::runtime::Runtime::new()
        .map_err(|error| error.to_string())
        .and_then(|runtime| runtime.block_on(run));
    let (alone, mut many) = match found {
        Ok(found) => found,
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::FAILURE;
        }
    };
    let each = (many.memory - alone.memory) / (robots.saturating_sub(1).max(1) as f64);
    let mut jitter = |share| percentile(&mut many.jitter, share);
    let (p50, p99, most) = (jitter(0.5), jitter(0.99), jitter(1.0));
    println!(
        "{robots} robots: {:.0} % of a core; a step is off by {:.1} ms (p50), {:.1} ms (p99), {:.1} ms (most); {:.0} MiB, {each:.2} MiB a robot; \
         {} goals driven, {} faults",
        100.0 * many.load,
        1e3 * p50,
        1e3 * p99,
        1e3 * most,
        many.memory,
        many.goals,
        many.faults
    );
    if many.faults == 0 && many.goals > 0 && p50 < JITTER.0 && p99 < JITTER.1 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// Prints what was found when orchestrators died or froze.
fn tell(run: impl Future<Output = Result<Findings, String>>) -> ExitCode {
    let runtime = match tokio::runtime::Runtime::new() {
        Ok(runtime) => runtime,
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::FAILURE;
        }
    };
    match runtime.block_on(run) {
        Ok(mut findings) => {
            println!(
                "{} kills, {} pauses: {} goals acknowledged, ends {:?}, {} motions, {} faults",
                findings.kills,
                findings.pauses,
                findings.goals,
                findings.ends,
                findings.motions,
                findings.faults.len()
            );
            if !findings.takeovers.is_empty() {
                let mut secs = |share| percentile(&mut findings.takeovers, share);
                println!(
                    "another orchestrator led after {:.2} s (p50), {:.2} s (p95), {:.2} s (longest)",
                    secs(0.5),
                    secs(0.95),
                    secs(1.0)
                );
            }
            findings.faults.iter().for_each(|fault| println!("FAULT {fault}"));
            if findings.faults.is_empty() && findings.goals > 0 {
                ExitCode::SUCCESS
            } else {
                ExitCode::FAILURE
            }
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// What the robot's side may cost: size and memory in MB, share of a core, lateness in ms that one tick in a hundred may exceed.
const AFFORDABLE: [f64; 4] = [12.0, 0.05, 40.0, 2.0];

/// Measures size, processor time, memory and punctuality of the robot's own binary.
fn footprint(secs: u64) -> ExitCode {
    let edge = beside("zenav-edge");
    if !edge.exists() {
        eprintln!(
            "{}: build it alone first, as for a robot: cargo build --release -p zenav-edge",
            edge.display()
        );
        return ExitCode::FAILURE;
    }
    let measured = tokio::runtime::Runtime::new()
        .map_err(|error| error.to_string())
        .and_then(|runtime| {
            let time = std::time::Duration::from_secs(secs);
            let zenav = zenav();
            let measuring = zenav_tests::proving::footprint::measure(&zenav, &edge, time);
            runtime.block_on(measuring).map_err(|error| error.to_string())
        });
    let found = match measured {
        Ok(found) => found,
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::FAILURE;
        }
    };
    const MB: f64 = 1e6;
    let figures = [
        found.size as f64 / MB,
        found.core,
        found.memory as f64 / MB,
        found.pacing.late_p99_ms,
    ];
    println!(
        "zenav-edge attached to a served kitchen for {secs} s: {:.1} ticks/s, {:.1} scans/s of {} beams; other processes kept {:.2} cores busy",
        found.ticks_hz, found.scans.0, found.scans.1, found.others
    );
    println!("{:24} {:>8} {:>8}", "", "is", "at most");
    for ((name, scale), (figure, most)) in [
        ("binary, MB", 1.0),
        ("processor, % of a core", 100.0),
        ("memory, MB", 1.0),
        ("tick late, p99, ms", 1.0),
    ]
    .into_iter()
    .zip(figures.into_iter().zip(AFFORDABLE))
    {
        println!("{name:24} {:8.2} {:8.2}", scale * figure, scale * most);
    }
    println!(
        "{:24} {:8.2}\n{:24} {:8.2}",
        "tick late, p50, ms", found.pacing.late_p50_ms, "tick late, worst, ms", found.pacing.late_max_ms
    );
    if figures.iter().zip(AFFORDABLE).all(|(figure, most)| *figure <= most) {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// The binary that this one was built with.
fn zenav() -> PathBuf {
    beside("zenav-under-test")
}

/// A binary in the same folder.
fn beside(name: &str) -> PathBuf {
    let own = std::env::current_exe().unwrap_or_default();
    own.with_file_name(format!("{name}{}", std::env::consts::EXE_SUFFIX))
}

fn demo(scenario: &str, seeds: u64, more: &[&str]) -> ExitCode {
    let mut failed = Vec::new();
    let mut worst: BTreeMap<&str, f64> = BTreeMap::new();
    for seed in 1..=seeds {
        let out = std::env::temp_dir().join(format!("zenav-acceptance-{}-{scenario}-{seed}", std::process::id()));
        let output = Command::new(zenav())
            .args([
                "demo",
                scenario,
                "--no-ui",
                "-o",
                "json",
                "--seed",
                &seed.to_string(),
                "--out",
            ])
            .arg(&out)
            .args(more)
            .env("RUST_LOG", "warn")
            .stdin(Stdio::null())
            .output();
        let _ = std::fs::remove_dir_all(&out);
        let output = match output {
            Ok(output) => output,
            Err(error) => {
                eprintln!("{}: {error}; build the workspace first", zenav().display());
                return ExitCode::FAILURE;
            }
        };
        let report: Value = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
        let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
        let error = report["goals"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|goal| goal["final_error_m"].as_f64())
            .fold(0.0, f64::max);
        let clearance = number(&report["min_clearance_m"]);
        let good = output.status.code() == Some(0)
            && report["collisions"] == 0
            && clearance > MIN_CLEARANCE
            && error <= max_error(scenario);
        println!(
            "seed {seed:3}: {} exit {:?}, collisions {}, clearance {clearance:.3} m, error {error:.3} m, simulated {:.1} s, wall {:.1} s",
            if good { "ok    " } else { "FAILED" },
            output.status.code(),
            report["collisions"],
            number(&report["sim_time_s"]),
            number(&report["wall_time_s"])
        );
        let mut note = |name, value: f64, pick: fn(f64, f64) -> f64| {
            let entry = worst.entry(name).or_insert(value);
            *entry = pick(*entry, value);
        };
        note("least clearance, m", clearance, f64::min);
        note("largest error, m", error, f64::max);
        note("longest wall time, s", number(&report["wall_time_s"]), f64::max);
        if !good {
            eprintln!("{}", String::from_utf8_lossy(&output.stderr));
            failed.push(seed);
        }
    }
    for (name, value) in worst {
        println!("{name}: {value:.3}");
    }
    println!(
        "{} of {seeds} seeds passed{}",
        seeds - failed.len() as u64,
        if failed.is_empty() {
            String::new()
        } else {
            format!(", failed: {failed:?}")
        }
    );
    if failed.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
