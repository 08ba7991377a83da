//! Collision monitor. Drives in random worlds under adversarial commands.

use std::collections::BTreeMap;

use zenav::parallel;
use zenav_fixtures::Row;
use zenav_tests::acceptance::guard::{Command, GENTLE, Outcome, Protection, drive, drive_watched};
use zenav_tests::acceptance::sim_rig::SimRigError;

use crate::Verdict;

/// Drives in one of the random worlds, and prints the true state at every tick.
pub fn replay(seed: u64) -> Verdict {
    let (mut tick, mut printed) = (0, 0);
    let outcome = drive_watched(seed, Protection::Monitored, |rig| {
        let truth = rig.truth();
        let (pose, twist) = (truth.map_from_base, truth.twist);
        let movers: Vec<_> = rig
            .sim
            .movers()
            .map(|mover| {
                let local = pose.inverse().transform_point(mover);
                format!("({:.2} {:.2})", local.x, local.y)
            })
            .collect();
        println!(
            "{tick:4} at {:.3} {:.3} {:.3}, {:.3} m/s {:.3} rad/s, clearance {:.4}, hardest {:.4}, movers at {} {:?}",
            pose.x,
            pose.y,
            pose.yaw,
            twist.v,
            twist.w,
            truth.clearance,
            truth.hardest_contact,
            movers.join(" "),
            rig.events.iter().skip(printed).collect::<Vec<_>>()
        );
        tick += 1;
        printed = rig.events.len();
    });
    let outcome = outcome?;
    println!("{outcome:?}");
    Ok(outcome.is_good())
}

/// Worlds of the negative control.
const CONTROL: u64 = 200;

/// Drives in random worlds on every core, and prints a table by command; then in some of them without the monitor, where it must fail.
pub fn guard(worlds: u64, first: u64) -> Verdict {
    let passed = table(all(worlds, first, Protection::Monitored), worlds);
    let control = all(worlds.min(CONTROL), first, Protection::Unprotected);
    let teleoperated = control.into_iter().filter_map(|(_, result)| result.ok());
    let teleoperated: Vec<Outcome> = teleoperated
        .filter(|outcome| !matches!(outcome.command, Command::Benign | Command::ThroughWalls))
        .collect();
    let hit = teleoperated.iter().filter(|outcome| !outcome.is_good()).count();
    println!(
        "negative control: without the collision monitor {hit} of {} teleoperated robots drive into something",
        teleoperated.len()
    );
    Row::new(
        "share that hits something without the monitor",
        hit as f64 / teleoperated.len().max(1) as f64,
        "",
    )
    .print();
    Ok(passed && 2 * hit > teleoperated.len())
}

/// Drives in a number of worlds on every core; results in the order of their seeds.
fn all(worlds: u64, first: u64, protection: Protection) -> Vec<(u64, Result<Outcome, SimRigError>)> {
    parallel::in_order(worlds as usize, parallel::cores(), |number| {
        let seed = first + number as u64;
        (seed, drive(seed, protection))
    })
}

/// Prints the results; returns whether every world passed.
fn table(results: Vec<(u64, Result<Outcome, SimRigError>)>, worlds: u64) -> bool {
    let mut outcomes = Vec::new();
    let mut failed: u64 = 0;
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
        "command", "worlds", "of movers", "contacts", "hard ones", "hardest, m/s", "driven, m", "interventions"
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
    let passed = worlds - failed.min(worlds);
    println!("{passed} of {worlds} worlds passed");
    Row::new(format!("worlds that pass, of {worlds}"), passed as f64, "").print();
    let hardest = outcomes.iter().map(|outcome| outcome.hardest).fold(0.0, f64::max);
    Row::new("hardest contact", hardest, "m/s").print();
    let unseen = outcomes
        .iter()
        .filter(|outcome| outcome.hardest_unseen > GENTLE)
        .count();
    Row::new("worlds with a contact with who was never in sight", unseen as f64, "").print();
    failed == 0
}
