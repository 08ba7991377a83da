//! Whereabouts. Loop closures under a driving robot, kidnappings, and global localisation.

use std::path::PathBuf;

use zenav_cloud::mapping::PoseSource;
use zenav_fixtures::{Row, thread_time};
use zenav_localisation::LocalisationSettings;
use zenav_mapping::read_map;
use zenav_tests::acceptance::{closure, everywhere, kidnapped};

use crate::Verdict;

/// Runs drives with a closure of a metre, and prints each drive that the closure harmed.
pub fn closure(runs: u64, first: u64) -> Verdict {
    let mut good = 0;
    let mut all = Vec::new();
    for seed in first..first.saturating_add(runs) {
        let closing = closure::drive(seed)?;
        if closing.is_good() {
            good += 1;
        } else {
            println!("{closing:?}");
        }
        all.push(closing);
    }
    let most = |of: fn(&closure::Closing) -> f64| all.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
    println!(
        "{good} of {runs} drives unharmed: at most {:.3} m beside the way, {:.3} m from the goal's spot ({:.3} m without the closure), {:.2} s later and {:.2} s more at rest than without the closure",
        most(|closing| closing.beside),
        most(|closing| closing.error),
        most(|closing| closing.error_without),
        most(|closing| closing.later),
        most(|closing| closing.stood),
    );
    Row::new(format!("drives unharmed, of {runs}"), good as f64, "").print();
    for (name, value, unit) in [
        ("farthest beside the way", most(|closing| closing.beside), "m"),
        ("farthest from the goal's spot", most(|closing| closing.error), "m"),
        (
            "farthest from it without the closure",
            most(|closing| closing.error_without),
            "m",
        ),
        ("longest time more at rest", most(|closing| closing.stood), "s"),
    ] {
        Row::new(name, value, unit).print();
    }
    Ok(good == runs)
}

/// Kidnaps robots in a known map, or with SLAM in their own, and prints each kidnapping that was not handled as expected.
pub fn kidnapped(runs: u64, first: u64, slam: bool) -> Verdict {
    let source = if slam { PoseSource::Slam } else { PoseSource::Localise };
    let mut all = Vec::new();
    for seed in first..first.saturating_add(runs) {
        match kidnapped::kidnap(seed, source) {
            Ok(told) => {
                if !told.is_good() {
                    println!("{told:?}");
                }
                all.push(told);
            }
            // The robot did not drive long enough to be kidnapped.
            Err(why) => println!("left out: {why}"),
        }
    }
    let count = |is: fn(&kidnapped::Kidnapping) -> bool| all.iter().filter(|told| is(told)).count();
    let mut found: Vec<f64> = all.iter().filter_map(|told| told.found_after).collect();
    found.sort_by(f64::total_cmp);
    let at = |share: f64| {
        found
            .get((share * found.len().saturating_sub(1) as f64) as usize)
            .copied()
    };
    println!(
        "{} kidnappings: {} noticed within 1 s or 0.5 m, {} right again within 3 s of that, {} trusted a wrong place, {} drove a plan while lost, {} goals reached, {} contacts; right again after {:.1} s (median), {:.1} s (95 %)",
        all.len(),
        count(|told| told.is_noticed()),
        count(|told| told.is_found()),
        count(|told| told.trusted_wrong),
        count(|told| told.drove_lost > 0.0),
        count(|told| told.succeeded),
        all.iter().map(|told| told.collisions).sum::<u32>(),
        at(0.5).unwrap_or(f64::NAN),
        at(0.95).unwrap_or(f64::NAN),
    );
    let total = all.len();
    for (name, many) in [
        ("noticed within 1 s or 0.5 m", count(|told| told.is_noticed())),
        ("right again within 3 s of that", count(|told| told.is_found())),
        ("trusted a wrong place", count(|told| told.trusted_wrong)),
        ("drove a plan while lost", count(|told| told.drove_lost > 0.0)),
    ] {
        Row::new(format!("{name}, of {total}"), many as f64, "").print();
    }
    Row::new("right again, median", at(0.5).unwrap_or(f64::NAN), "s").print();
    Row::new("right again, 95 %", at(0.95).unwrap_or(f64::NAN), "s").print();
    Ok(all.iter().all(kidnapped::Kidnapping::is_good))
}

/// Localises globally from random places, and prints each unique but wrong answer.
pub fn localise(places: usize, files: &[PathBuf], seed: u64) -> Verdict {
    let mut maps = vec![("office".to_owned(), everywhere::office(seed))];
    for file in files {
        maps.push((file.display().to_string(), read_map(file, 0.05)?));
    }
    let mut good = true;
    for (name, map) in maps {
        let settings = LocalisationSettings::default();
        let tally = everywhere::ask_everywhere(&map, places, seed, &settings, &thread_time);
        println!("{name}: {}", tally.line());
        for (truth, found, agreeing) in &tally.wrong {
            println!(
                "  wrong: {truth:?} was taken for {found:?}, {:.0} % agree",
                100.0 * agreeing
            );
        }
        for (what, many) in [
            ("right", tally.right),
            ("ambiguous", tally.ambiguous + tally.ambiguous_wrong),
            ("ambiguous without the right place", tally.ambiguous_wrong),
            ("without an answer", tally.nowhere + tally.out_of_budget),
            ("wrong", tally.wrong.len()),
        ] {
            Row::new(format!("{name}: {what}, of {}", tally.took.len()), many as f64, "").print();
        }
        Row::new(format!("{name}: processor time, 95 %"), tally.within(0.95), "s").print();
        good &= tally.wrong.is_empty() && tally.within(0.95) <= 1.0;
    }
    Ok(good)
}
