//! Missions. What becomes of goals when missions die or freeze, and how many robots does one process serve?

use tokio::runtime::Runtime;
use zenav_fixtures::Row;
use zenav_tests::acceptance::handover::Fault;
use zenav_tests::acceptance::invariants::Findings;
use zenav_tests::acceptance::tracking::percentile;
use zenav_tests::acceptance::{fleet, handover, kills};

use crate::{Verdict, zenav};

/// Kills the mission again and again while goals come in.
pub fn kills(kills: usize, seed: u64) -> Verdict {
    tell(kills::run(&zenav().to_string_lossy(), kills, seed))
}

/// How long a leader is paused, s.
const LEADER_PAUSED: f64 = 20.0;

/// How long a standby is paused, s.
const STANDBY_PAUSED: f64 = 5.0;

/// Kills the leader of two missions again and again, then pauses it, and its standby, while goals come in.
pub fn handover(deaths: usize, pauses: usize, seed: u64) -> Verdict {
    let mut faults = vec![Fault::LeaderKilled; deaths];
    for _ in 0..pauses {
        faults.extend([Fault::LeaderPaused(LEADER_PAUSED), Fault::StandbyPaused(STANDBY_PAUSED)]);
    }
    tell(handover::run(&zenav().to_string_lossy(), &faults, seed))
}

/// Largest median and 99th percentile of the lateness of a mission's step, s.
const JITTER: (f64, f64) = (0.01, 0.1);

/// Runs the mission of one robot, then those of many, in one process on one core.
pub fn fleet(robots: usize, secs: f64) -> Verdict {
    let run = async {
        let alone = fleet::run(&zenav().to_string_lossy(), 1, 10.0).await?;
        let many = fleet::run(&zenav().to_string_lossy(), robots, secs).await?;
        Ok::<_, String>((alone, many))
    };
    let (alone, mut many) = Runtime::new()?.block_on(run)?;
    let each = (many.memory - alone.memory) / (robots.saturating_sub(1).max(1) as f64);
    let mut jitter = |share| percentile(&mut many.jitter, share);
    let (p50, p99, most) = (jitter(0.5), jitter(0.99), jitter(1.0));
    println!(
        "{robots} robots: {:.0} % of a core; a step is off by {:.1} ms (p50), {:.1} ms (p99), {:.1} ms (most); {:.0} MiB, {each:.2} MiB a robot; \
         {} goals driven; {} ticks without a lease, {} plans refused, {} goals failed",
        100.0 * many.load,
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

/// Prints what was found when missions died or froze.
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
