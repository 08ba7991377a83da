//! Missions. Goals when missions die or freeze, and the number of robots that one process serves.

use tokio::runtime::Runtime;
use zenav_fixtures::Row;
use zenav_tests::acceptance::fleet::Fleet;
use zenav_tests::acceptance::handover::Fault;
use zenav_tests::acceptance::invariants::Findings;
use zenav_tests::acceptance::tracking::percentile;
use zenav_tests::acceptance::{fleet, handover, kills, workers};

use crate::{Verdict, zenav};

/// Kills the mission repeatedly while goals are submitted.
pub fn kills(kills: usize, seed: u64) -> Verdict {
    tell(kills::run(&zenav().to_string_lossy(), kills, seed))
}

/// Pause of a leader, s.
const LEADER_PAUSED: f64 = 20.0;

/// Pause of a standby, s.
const STANDBY_PAUSED: f64 = 5.0;

/// Kills the leader of two missions repeatedly, then pauses it and its standby, while goals are submitted.
pub fn handover(deaths: usize, pauses: usize, seed: u64) -> Verdict {
    let mut faults = vec![Fault::LeaderKilled; deaths];
    for _ in 0..pauses {
        faults.extend([Fault::LeaderPaused(LEADER_PAUSED), Fault::StandbyPaused(STANDBY_PAUSED)]);
    }
    tell(handover::run(&zenav().to_string_lossy(), &faults, seed))
}

/// Largest median and 99th percentile of the lateness of a mission's step, s.
const JITTER: (f64, f64) = (0.01, 0.1);

/// Runs the mission of one robot, then those of many, in one process on one core or in shards.
pub fn fleet(fleet: Fleet) -> Verdict {
    let Fleet {
        robots, shards, speed, ..
    } = fleet;
    let one = Fleet {
        robots: 1,
        shards: 1,
        speed: 1.0,
        secs: 10.0,
    };
    let run = async {
        let alone = fleet::run(&zenav().to_string_lossy(), one).await?;
        let many = fleet::run(&zenav().to_string_lossy(), fleet).await?;
        Ok::<_, String>((alone, many))
    };
    let (alone, mut many) = Runtime::new()?.block_on(run)?;
    let added = many.memory - shards as f64 * alone.memory;
    let each = added / (robots.saturating_sub(shards).max(1) as f64);
    let mut jitter = |share| percentile(&mut many.jitter, share);
    let (p50, p99, most) = (jitter(0.5), jitter(0.99), jitter(1.0));
    println!(
        "{robots} robots in {shards} processes, at {speed} x: {:.0} % of a core, and the router {:.0} %; a step is off by {:.1} ms (p50), \
         {:.1} ms (p99), {:.1} ms (most); {:.0} MiB, {each:.2} MiB a robot; {} goals driven; {} ticks without a lease, {} plans refused, \
         {} goals failed",
        100.0 * many.load,
        100.0 * many.router,
        1e3 * p50,
        1e3 * p99,
        1e3 * most,
        many.memory,
        many.goals,
        many.faults[0],
        many.faults[1],
        many.faults[2]
    );
    let rows = [
        ("processor", 100.0 * many.load, "% of a core"),
        ("processor of the router", 100.0 * many.router, "% of a core"),
        ("memory a robot", each, "MiB"),
        ("heartbeat off by, p50", 1e3 * p50, "ms"),
        ("heartbeat off by, p99", 1e3 * p99, "ms"),
        ("heartbeat off by, most", 1e3 * most, "ms"),
    ];
    for (name, value, unit) in rows {
        Row::new(format!("{robots} robots: {name}"), value, unit).print();
    }
    Ok(many.faults == [0; 3] && many.goals > 0 && p50 < JITTER.0 && p99 < JITTER.1)
}

/// Longest 99th percentile of the time to a trajectory with two workers, s.
const ANSWERED: f64 = 0.25;

/// Measures many robots with one motion worker, then with two, of which one is frozen in the end.
pub fn workers(robots: usize, secs: f64, seed: u64) -> Verdict {
    let mut is_good = true;
    let binary = zenav().to_string_lossy().into_owned();
    for count in [1, 2] {
        let run = workers::run(&binary, count, robots, secs, seed);
        let mut found = Runtime::new()?.block_on(run)?;
        let mut time = |share| percentile(&mut found.answers, share);
        let (p50, p99) = (time(0.5), time(0.99));
        println!(
            "{count} workers, {robots} robots: {:.1} ms (p50), {:.1} ms (p99), {:.0} trajectories a second, {} requests lost",
            1e3 * p50,
            1e3 * p99,
            found.throughput,
            found.lost
        );
        let rows = [
            ("trajectory, p50", 1e3 * p50, "ms"),
            ("trajectory, p99", 1e3 * p99, "ms"),
            ("trajectories a second", found.throughput, "1/s"),
        ];
        for (name, value, unit) in rows {
            Row::new(format!("{count} workers, {robots} robots: {name}"), value, unit).print();
        }
        if !found.frozen.is_empty() {
            let mut time = |share| percentile(&mut found.frozen, share);
            let (p99, most) = (time(0.99), time(1.0));
            println!(
                "one of {count} workers frozen: {:.1} ms (p99), {:.1} ms (most)",
                1e3 * p99,
                1e3 * most
            );
            Row::new("one of two workers frozen: trajectory, p99", 1e3 * p99, "ms").print();
        }
        is_good &= found.lost == 0 && (count == 1 || p99 < ANSWERED);
    }
    Ok(is_good)
}

/// Prints the results of a run in which missions died or froze.
fn tell(run: impl Future<Output = Result<Findings, String>>) -> Verdict {
    let mut findings = Runtime::new()?.block_on(run)?;
    let failures = findings.failures();
    println!(
        "{} kills, {} pauses: {} goals acknowledged, ends {:?}, {} motions, {} violations",
        findings.kills,
        findings.pauses,
        findings.goals,
        findings.ends,
        findings.motions,
        findings.violations.len()
    );
    let succeeded = findings.ends.get("Succeeded").copied().unwrap_or_default();
    Row::new("goals acknowledged", findings.goals as f64, "").print();
    Row::new("goals that succeeded, each once", succeeded as f64, "").print();
    Row::new("violations", findings.violations.len() as f64, "").print();
    if !findings.takeovers.is_empty() {
        let mut secs = |share| percentile(&mut findings.takeovers, share);
        Row::new("another mission leads, p50", secs(0.5), "s").print();
        Row::new("another mission leads, longest", secs(1.0), "s").print();
        println!(
            "the other mission led after {:.2} s (p50), {:.2} s (p95), {:.2} s (longest)",
            secs(0.5),
            secs(0.95),
            secs(1.0)
        );
    }
    failures.iter().for_each(|failure| println!("FAILED {failure}"));
    Ok(failures.is_empty())
}
