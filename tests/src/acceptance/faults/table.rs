//! Table. The results in Markdown, with the machine and the commit of the run.

use std::fmt::Write as _;

use zenav::parallel;

use super::result::{Memory, Result};
use crate::acceptance::tracking::percentile;
use crate::provenance::{output, processor};

/// What each row must keep, as [`Result::missed`] judges it.
const LIMITS: &str = "The limits: every mission succeeds, no goal is lost, nothing is touched, and the robot moves only within a valid horizon. \
                      It drives again less than 1.5 s after the end of a fault (p95). Over a round trip of 1 s missions take at most 1.2 times as \
                      long as without a fault, over 2 s at most twice as long. After the first mission no part grows by more than a tenth and \
                      2 MiB.";

/// What the rows do not show, and where it is tested.
const ELSEWHERE: &str = "Parts are linked over plain TCP, with the profile `open`; in rows with `mTLS` over QUIC, with identities. Parts with \
                         identities are killed, frozen and replaced by `acceptance compose` ([deployment](deployment.md#a-rolling-update)). A disk that turns read-only under goals \
                         and maps, and a store or a map that is torn, changed or another robot's, have no rows, because a mission that finds one \
                         rightly does not drive: [what happens when](faults.md#a-disk-is-full-or-read-only) names their tests.";

/// Whether rows ran in their own networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OwnNetwork {
    /// The kernel impaired their links.
    Yes,
    /// Proxies did.
    No,
}

/// The page of a run: the faults and how they were injected, and a line for each row.
#[must_use]
pub fn markdown(command: &str, found: &[Result], network: OwnNetwork) -> String {
    let commit = output("git", &["describe", "--always", "--dirty"]).unwrap_or_else(|| "an unknown commit".to_owned());
    let cores = parallel::cores();
    let how = match network {
        OwnNetwork::Yes => {
            "each row in a network of its own, where the kernel drops segments of the robot's link (`iptables`) and `zenav netem` delays and \
             slows it"
        }
        OwnNetwork::No => {
            "without a network of its own (that needs root): `zenav netem` between robot and router, stopped for a cut, stalled for 200 ms for \
             a loss"
        }
    };
    let mut page = format!(
        "# Faults\n\nWritten by `{command}` at {commit}, on {} with {cores} cores; {how}.\n\n\
         Router, robot, mapper, motion worker and orchestrator are separate processes; the fault is injected while the robot drives. The client is \
         on the cloud's side, and the robot is watched over an unimpaired link. A killed robot restarts where its simulation begins. In rows with a \
         copy, a second mapper follows the first, with a disk of its own; the fault hits the one that leads, and the other must take over. A flood \
         republishes recent messages on every key at ten times their rate. The policy is `finish_horizon` unless named. *Resume* is the time from \
         the end of the fault until the robot drives or turns again, 0 if it had not come to rest; *at rest* is the share of the missions' time in \
         which it did neither.\n\n\
         {ELSEWHERE}\n\n\
         {LIMITS}\n\n\
         One row: `cargo build --release -p zenav-tests --bins && target/release/acceptance faults --only \"depot: loss 5 %\"`; a part of a name runs \
         all rows that contain it.\n\n\
         | fault | missions | collisions | goals lost | motion without a valid horizon | resume p50 / p95 (n) | mission, mean (times that without a \
         fault, if limited) | at rest | memory at the end (growth since the first mission), MiB: router, edge, mapping, motion, mission, \
         copy of mapping |\n\
         |---|---|---|---|---|---|---|---|---|\n",
        processor()
    );
    for row in found {
        let _ = writeln!(page, "{}", line(row));
    }
    let floods: Vec<String> = found
        .iter()
        .filter(|row| row.flooded > 0)
        .map(|row| format!("{}: {}", row.name, row.flooded))
        .collect();
    if !floods.is_empty() {
        let _ = writeln!(page, "\nMessages of the floods: {}.", floods.join("; "));
    }
    let mut all: Vec<f64> = found.iter().flat_map(|row| row.resumes.iter().copied()).collect();
    if !all.is_empty() {
        let (p50, p95) = (percentile(&mut all, 0.5), percentile(&mut all, 0.95));
        let _ = writeln!(
            page,
            "\nOver all {} faults the robot drove again after {p50:.2} s (p50), {p95:.2} s (p95).",
            all.len()
        );
    }
    page.push_str("\n## What fell short\n\n");
    let short: Vec<String> = found.iter().filter(|row| !row.is_good()).map(shortfall).collect();
    match short.is_empty() {
        true => page.push_str("Nothing.\n"),
        false => page.push_str(&short.concat()),
    }
    page
}

/// A row's line of the table.
fn line(row: &Result) -> String {
    let (asked, succeeded) = row.missions;
    let resume = row.resume().map_or_else(
        || "–".to_owned(),
        |(p50, p95)| format!("{p50:.2} / {p95:.2} s ({})", row.resumes.len()),
    );
    let slowdown = row
        .slowdown
        .map_or_else(String::new, |slowdown| format!(" ({:.2})", slowdown.times));
    let memory: Vec<String> = row.memory.iter().map(held).collect();
    format!(
        "| {} | {succeeded} of {asked} | {} | {} | {} | {resume} | {:.1} s{slowdown} | {:.0} % | {} |",
        row.name,
        row.collisions,
        row.lost,
        row.invalid.len(),
        row.mean_secs(),
        100.0 * row.rest,
        memory.join(", ")
    )
}

fn held(memory: &Memory) -> String {
    let growth = memory.settled.map(|settled| memory.end - settled);
    growth.map_or_else(
        || format!("{:.0}", memory.end),
        |growth| format!("{:.0} ({growth:+.0})", memory.end),
    )
}

fn shortfall(row: &Result) -> String {
    format!("- {}: {}\n", row.name, row.missed().join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_that_misses_a_limit_is_told_with_its_figures() {
        let good = Result {
            name: "depot: flood for 5 s".into(),
            missions: (2, 2),
            flooded: 41_976,
            memory: vec![Memory {
                part: "router".into(),
                settled: Some(30.0),
                end: 31.0,
            }],
            ..Result::default()
        };
        let bad = Result {
            name: "depot: loss 20 %".into(),
            invalid: vec!["it moves".into()],
            resumes: vec![2.0],
            ..good.clone()
        };
        let page = markdown("acceptance faults", &[good.clone(), bad], OwnNetwork::Yes);
        assert!(page.contains("| depot: flood for 5 s | 2 of 2 | 0 | 0 | 0 |"), "{page}");
        assert!(
            page.contains("| 31 (+1) |") && page.contains("depot: flood for 5 s: 41976"),
            "{page}"
        );
        assert!(
            page.contains("- depot: loss 20 %: it moves; it drives again after 2.00 s"),
            "{page}"
        );
        let page = markdown("acceptance faults", &[good], OwnNetwork::Yes);
        assert!(page.ends_with("## What fell short\n\nNothing.\n"), "{page}");
    }
}
