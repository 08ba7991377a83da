//! Whereabouts. Loop closures under a driving robot, kidnappings, global localisation, and corrections over a bad link.

use std::path::PathBuf;

use zenav_cloud::mapping::PoseSource;
use zenav_fixtures::{Row, thread_time};
use zenav_localisation::LocalisationSettings;
use zenav_mapping::read_map;
use zenav_tests::acceptance::tracking::percentile;
use zenav_tests::acceptance::{closure, corrections, everywhere, kidnapped, pose};

use crate::Verdict;

/// 95 % of chi-square with three degrees of freedom.
const COVERED: f64 = 7.815;
/// Duration of each drive with corrections over a bad link, s.
const DRIVE_SECS: f64 = 180.0;
/// Largest error of 95 % of the poses, m and degrees.
const EXACT: (f64, f64) = (0.03, 0.5);
/// Most processor time of a scan on average, s.
const FAST: f64 = 0.5e-3;
/// Least share of steps in which the robot's error lies in the 95 % band of its covariance.
const CONSISTENT: f64 = 0.9;

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

/// Localises robots in changed houses and corrects them over a bad link; prints the errors of both, and whether the robots' covariance
/// covers theirs.
pub fn corrections(runs: u64, first: u64) -> Verdict {
    let mut tally = corrections::Tally::default();
    for seed in first..first.saturating_add(runs) {
        corrections::drive(&mut tally, seed, DRIVE_SECS, &thread_time)?;
    }
    let [metres, radians] = &mut tally.errors;
    let [half, most, worst] = [0.5, 0.95, 1.0].map(|share| percentile(metres, share));
    let turned = percentile(radians, 0.95).to_degrees();
    let took = tally.took.iter().sum::<f64>() / tally.took.len().max(1) as f64;
    let [trusted, wrong, scans] = tally.trusted;
    let (means, drives) = pose::means(&tally.nees, runs);
    let band = pose::band(3.0, drives);
    let (share, mean) = pose::share(&means, band);
    let matches = tally.matched.len().max(1) as f64;
    let own = tally.matched.iter().sum::<f64>() / matches;
    let covered = tally.matched.iter().filter(|nees| **nees <= COVERED).count() as f64 / matches;
    println!(
        "{runs} drives, {:.0} m: localised {half:.3} m off (median), {most:.3} m and {turned:.2} deg (95 %), {worst:.3} m at most; {trusted} of {scans} scans trusted, {wrong} of them wrong; {:.2} ms a scan; NEES of corrections {own:.2} (mean), {:.1} % within 95 % of their covariance; NEES of the robot in [{:.2}, {:.2}] in {:.1} % of steps, mean {mean:.2}",
        tally.length,
        1e3 * took,
        100.0 * covered,
        band.0,
        band.1,
        100.0 * share,
    );
    for (name, value, unit) in [
        ("error of a scan's pose, 95 %", most, "m"),
        ("error of its heading, 95 %", turned, "deg"),
        ("processor time of a scan, mean", 1e3 * took, "ms"),
        ("scans without a trusted pose", (scans - trusted) as f64, ""),
        ("trusted poses that are wrong", wrong as f64, ""),
        ("NEES of corrections, mean", own, ""),
        ("corrections within 95 % of their covariance", 100.0 * covered, "%"),
        ("NEES of the robot, mean", mean, ""),
        ("NEES of the robot in its 95 % band", 100.0 * share, "% of steps"),
    ] {
        Row::new(name, value, unit).print();
    }
    let ours = [
        ("error of a scan's pose, median", half, "m"),
        ("error of a scan's pose, 95 %", most, "m"),
        ("error of its heading, 95 %", turned, "deg"),
        ("processor time of a scan, mean", 1e3 * took, "ms"),
    ];
    for ((_, peer), sums) in corrections::amcl::USES.iter().zip(&mut tally.amcl) {
        let (scans, [metres, radians]) = (sums.took.len(), &mut sums.errors);
        if scans == 0 {
            continue;
        }
        let theirs = [
            percentile(metres, 0.5),
            percentile(metres, 0.95),
            percentile(radians, 0.95).to_degrees(),
            1e3 * sums.took.iter().sum::<f64>() / scans as f64,
        ];
        for ((what, ours, unit), theirs) in ours.into_iter().zip(theirs) {
            Row::new(what, ours, unit).beside(peer, theirs).print();
        }
        let (worst, updates) = (percentile(metres, 1.0), sums.updates);
        println!("{peer}: {worst:.3} m at most, {updates} of {scans} scans updated the filter");
    }
    Ok(most <= EXACT.0 && turned <= EXACT.1 && took <= FAST && wrong == 0 && share >= CONSISTENT)
}
