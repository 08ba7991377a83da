//! Does the robot ever drive into anything, whatever it is told?

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use zenav_fixtures::Row;
use zenav_tests::acceptance::guard::{GENTLE, Protection, drive, drive_watched};

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

/// Drives in random worlds on every core, and prints a table by command.
pub fn guard(worlds: u64, first: u64) -> Verdict {
    let next = AtomicU64::new(first);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let work = || {
        let mut done = Vec::new();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= first + worlds {
                return done;
            }
            done.push((seed, drive(seed, Protection::Monitored)));
        }
    };
    let mut results: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..cores).map(|_| scope.spawn(work)).collect();
        threads
            .into_iter()
            .filter_map(|thread| thread.join().ok())
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
    Ok(failed == 0)
}
