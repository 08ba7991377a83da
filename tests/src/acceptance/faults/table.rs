//! Table. The results in Markdown, with the machine and the commit of the run.

use std::fmt::Write as _;
use std::process::Command;

use super::run::Result;
use crate::acceptance::tracking::percentile;

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
    let commit = output("git", &["describe", "--always", "--dirty"]);
    let cores = std::thread::available_parallelism().map_or(0, std::num::NonZero::get);
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
         Router, robot, mapper, motion worker and orchestrator are processes of their own; the fault hits while the robot drives. The client is on \
         the cloud's side, and the robot is watched over a link that is not impaired. A robot that is killed starts anew where its simulation \
         begins. A flood is everything that was just heard, said again at ten times its rate on every key. Policy `finish_horizon`, where none is \
         named. *Resume* is the time from the end of the fault until the robot drives again, 0 where it had not come to rest; *at rest* is \
         the share of the missions' time in which it did not drive.\n\n\
         | fault | missions | collisions | goals lost | motion without a valid horizon | resume p50 / p95 (n) | mission, mean | at rest | \
         memory at the end, MiB: router, edge, mapping, motion, mission |\n\
         |---|---|---|---|---|---|---|---|---|\n",
        machine()
    );
    for row in found {
        let (asked, succeeded) = row.missions;
        let mut resumes = row.resumes.clone();
        let resume = if resumes.is_empty() {
            "–".to_owned()
        } else {
            let (p50, p95) = (percentile(&mut resumes, 0.5), percentile(&mut resumes, 0.95));
            format!("{p50:.2} / {p95:.2} s ({})", resumes.len())
        };
        let mean = row.secs.iter().sum::<f64>() / (row.secs.len().max(1) as f64);
        let memory: Vec<String> = row.memory.iter().map(|(_, mib)| format!("{mib:.0}")).collect();
        let name = match row.flooded {
            0 => row.name.clone(),
            messages => format!("{}, {messages} messages", row.name),
        };
        let _ = writeln!(
            page,
            "| {name} | {succeeded} of {asked} | {} | {} | {} | {resume} | {mean:.1} s | {:.0} % | {} |",
            row.collisions,
            row.lost,
            row.invalid.len(),
            100.0 * row.rest,
            memory.join(", ")
        );
    }
    let mut all: Vec<f64> = found.iter().flat_map(|row| row.resumes.iter().copied()).collect();
    if !all.is_empty() {
        let (p50, p95) = (percentile(&mut all, 0.5), percentile(&mut all, 0.95));
        let _ = writeln!(
            page,
            "\nOf all {} faults: the robot drove again after {p50:.2} s (p50), {p95:.2} s (p95).",
            all.len()
        );
    }
    let short: Vec<String> = found.iter().filter(|row| !row.is_good()).map(shortfall).collect();
    if !short.is_empty() {
        let _ = write!(page, "\n## What fell short\n\n{}", short.concat());
    }
    page
}

fn shortfall(row: &Result) -> String {
    let mut what = row.failures.clone();
    what.extend(row.invalid.first().cloned());
    format!("- {}: {}\n", row.name, what.join("; "))
}

/// The processor's name.
fn machine() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split(": ").nth(1));
    name.unwrap_or("an unknown processor").trim().to_owned()
}

fn output(command: &str, arguments: &[&str]) -> String {
    let output = Command::new(command).args(arguments).output();
    let text = output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned());
    text.ok()
        .filter(|text| !text.is_empty())
        .unwrap_or_else(|| "an unknown commit".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_that_breaks_a_promise_is_told_with_its_reason() {
        let good = Result {
            name: "depot: no fault".into(),
            missions: (2, 2),
            ..Result::default()
        };
        let bad = Result {
            name: "depot: loss 20 %".into(),
            invalid: vec!["it moves".into()],
            ..good.clone()
        };
        let page = markdown("acceptance faults", &[good, bad], OwnNetwork::Yes);
        assert!(page.contains("| depot: no fault | 2 of 2 | 0 | 0 | 0 |"), "{page}");
        assert!(page.contains("- depot: loss 20 %: it moves"), "{page}");
    }
}
