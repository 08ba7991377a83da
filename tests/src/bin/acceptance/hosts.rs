//! Hosts. What do robots do while parts of a deployment of many hosts die, freeze, are cut off and replaced?

use std::path::Path;
use std::time::Instant;

use tokio::runtime::Runtime;
use zenav_tests::hosts::{self, trial};

use crate::{Verdict, zenav};

/// Starts the deployment, and lets everything happen to each of its parts, so many times.
pub fn compose(rounds: usize) -> Verdict {
    let begun = Instant::now();
    let runtime = Runtime::new()?;
    let binary = zenav();
    let mut site = hosts::open(Path::new(&binary))?;
    println!("{}", site.kind());
    let faults = if rounds == 0 {
        trial::short()
    } else {
        trial::long(rounds)
    };
    // In a task: the site's commands block a thread of the runtime.
    let findings = runtime.block_on(async move {
        let trial = tokio::spawn(async move { trial::run(site.as_mut(), &faults, begun).await });
        trial.await.map_err(|error| error.to_string())?
    })?;
    println!(
        "three robots have finished a goal each {:.1} s after the first command",
        findings.first_mission
    );
    println!("| fault | longest rest of a robot, s | whose |\n|---|---|---|");
    for row in &findings.rows {
        println!("| {} | {:.1} | {} |", row.fault, row.rest, row.robot);
    }
    let ends: Vec<String> = findings
        .ends
        .iter()
        .map(|(end, count)| format!("{count} {end}"))
        .collect();
    println!("{} goals acknowledged: {}", findings.goals, ends.join(", "));
    for failure in &findings.failures {
        println!("FAILED: {failure}");
    }
    Ok(findings.failures.is_empty())
}
