//! Hosts. Robots of a multi-host deployment while parts die, freeze, are cut off and replaced.

use std::path::Path;
use std::time::{Duration, Instant};

use tokio::runtime::Runtime;
use zenav_tests::hosts::trial::{Fault, Findings};
use zenav_tests::hosts::{self, soak, trial};

use crate::{Verdict, zenav};

/// Starts the deployment, and injects every fault into each of its parts, `rounds` times.
pub fn compose(rounds: usize) -> Verdict {
    let faults = if rounds == 0 {
        trial::short()
    } else {
        trial::long(rounds)
    };
    let findings = run(faults, 1.0)?;
    println!("| fault | longest rest of a robot, s | whose |\n|---|---|---|");
    for row in &findings.rows {
        println!("| {} | {:.1} | {} |", row.fault, row.rest, row.robot);
    }
    Ok(findings.failures.is_empty())
}

/// Starts the deployment, injects random faults into its parts for a time, and reports the resources of the parts that ran throughout.
pub fn soak(minutes: f64, speed: f64, seed: u64) -> Verdict {
    let time = Duration::from_secs_f64(60.0 * minutes);
    let findings = run(soak::faults(time, seed), speed)?;
    let growth = soak::growth(&findings)?;
    println!(
        "{} faults in {minutes} min, {:.0} min of the world's time; medians of the second third and of the last, and the slope over both",
        findings.rows.len(),
        minutes * speed
    );
    println!(
        "| part | memory, MiB | MiB an hour | handles | threads | waiting | cores |\n|---|---|---|---|---|---|---|"
    );
    for part in &growth {
        let [then, now] = part.memory();
        let ([before, after], waiting) = (part.held, part.waiting);
        println!(
            "| {} | {then:.1}, {now:.1} | {:+.1} | {}, {} | {}, {} | {}, {} | {:.3} |",
            part.part,
            part.hourly,
            before.handles,
            after.handles,
            before.threads,
            after.threads,
            waiting[0],
            waiting[1],
            part.cores
        );
    }
    let grown = growth.iter().filter(|part| !part.is_flat());
    let grown: Vec<&str> = grown.map(|part| part.part).collect();
    if !grown.is_empty() {
        println!("FAILED: {} grows", grown.join(", "));
    }
    Ok(findings.failures.is_empty() && grown.is_empty())
}

fn run(
    faults: impl IntoIterator<Item = Fault, IntoIter: Send> + Send + 'static,
    speed: f64,
) -> Result<Findings, Box<dyn std::error::Error>> {
    let begun = Instant::now();
    let runtime = Runtime::new()?;
    let binary = zenav();
    let mut site = hosts::open(Path::new(&binary), speed)?;
    println!("{}", site.kind());
    // In a task: the site's commands block a thread of the runtime.
    let findings = runtime.block_on(async move {
        let trial = tokio::spawn(async move { trial::run(site.as_mut(), faults, begun).await });
        trial.await.map_err(|error| error.to_string())?
    })?;
    println!(
        "three robots have finished a goal each {:.1} s after the first command",
        findings.first_mission
    );
    let ends: Vec<String> = findings
        .ends
        .iter()
        .map(|(end, count)| format!("{count} {end}"))
        .collect();
    println!("{} goals acknowledged: {}", findings.goals, ends.join(", "));
    for failure in &findings.failures {
        println!("FAILED: {failure}");
    }
    Ok(findings)
}
