//! Pose estimate. Consistency of its error with its covariance.

use zenav_fixtures::{Row, thread_time};
use zenav_tests::acceptance::pose;
use zenav_tests::acceptance::tracking::percentile;

use crate::Verdict;

/// Least share of steps within the 95 % band, where the filter's assumptions hold. Where one does not, the share is only printed: a filter
/// that keeps to a wrong assumption cannot be consistent.
const CONSISTENT: f64 = 0.9;
/// Least share of steps with a position error within three standard deviations, where the assumptions hold, and where one does not: there
/// errors grow, but stay of the order that the covariance says.
const WITHIN: [f64; 2] = [0.99, 0.9];
/// Duration of each drive, s.
const DRIVE_SECS: f64 = 600.0;

/// Estimates poses in many drives, and prints how often the mean error was within its band.
pub fn pose(runs: u64, first: u64) -> Verdict {
    let mut good = true;
    println!("seeds {first} to {}", first + runs.saturating_sub(1));
    println!(
        "{:28} {:16} {:>16} {:>10} {:>8}",
        "conditions", "quantity", "band", "in band, %", "mean"
    );
    let matched = pose::CONDITIONS.map(|conditions| (conditions, true));
    let mismatched = pose::MISMATCHED.map(|conditions| (conditions, false));
    for (conditions, is_matched) in matched.into_iter().chain(mismatched) {
        let mut sums = pose::Sums::default();
        for seed in first..first.saturating_add(runs) {
            pose::drive(&mut sums, &conditions, seed, DRIVE_SECS, &thread_time)?;
        }
        let count = runs as f64;
        let mut line = |name: &str, means: &[f64], freedom: f64, of: f64| {
            let band = pose::band(freedom, of);
            let (share, mean) = pose::share(means, band);
            good &= share >= CONSISTENT || !is_matched;
            Row::new(
                format!("{}: {name} in its 95 % band", conditions.name),
                100.0 * share,
                "% of steps",
            )
            .print();
            let band = format!("[{:.2}, {:.2}]", band.0, band.1);
            println!(
                "{:28} {name:16} {band:>16} {:10.1} {mean:8.2}",
                conditions.name,
                100.0 * share
            );
        };
        let nees: Vec<f64> = sums.nees.iter().map(|sum| sum / count).collect();
        line("NEES", &nees, 3.0, count);
        for (name, freedom, sums) in [
            ("NIS compass", 1.0, &sums.nis[0]),
            ("NIS GPS", 2.0, &sums.nis[1]),
            ("NIS correction", 3.0, &sums.nis[2]),
        ] {
            let (means, readings) = pose::means(sums, runs);
            if !means.is_empty() {
                line(name, &means, freedom, readings);
            }
        }
        let within = WITHIN[usize::from(!is_matched)];
        good &= f64::from(sums.within.0) >= within * f64::from(sums.within.1);
        println!(
            "{:28} position error within three standard deviations in {:.2} % of steps, at most {:.3} m where up to {:.3} m were allowed for",
            conditions.name,
            100.0 * f64::from(sums.within.0) / f64::from(sums.within.1.max(1)),
            sums.worst,
            sums.allowed,
        );
        println!(
            "{:28} a step takes {:.1} us, p99 {:.1} us; {} fused, {} outliers, {} too late",
            conditions.name,
            1e6 * percentile(&mut sums.took, 0.5),
            1e6 * percentile(&mut sums.took, 0.99),
            sums.tally.fused,
            sums.tally.outliers,
            sums.tally.too_late,
        );
    }
    let mut took = pose::latest(&thread_time)?;
    println!(
        "a step with a correction that is as late as may be takes {:.0} us, p99 {:.0} us",
        1e6 * percentile(&mut took, 0.5),
        1e6 * percentile(&mut took, 0.99)
    );
    Ok(good)
}
