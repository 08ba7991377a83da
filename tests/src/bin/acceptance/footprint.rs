//! Resources of the robot's binary: size, processor time, memory and loop jitter.

use std::time::Duration;

use tokio::runtime::Runtime;
use zenav_fixtures::Row;
use zenav_tests::acceptance::footprint::measure;

use crate::{Verdict, beside, zenav};

/// Limits of the robot's side: size, MB; share of a core; memory, MB; p99 of the loop jitter, ms.
const AFFORDABLE: [f64; 4] = [12.0, 0.05, 40.0, 2.0];

/// Measures size, processor time, memory and loop jitter of the robot's own binary.
pub fn footprint(secs: u64) -> Verdict {
    // The folder of the `dist` profile is beside that of this profile.
    let edge = beside("../dist/zenav-edge");
    if !edge.exists() {
        let name = edge.display();
        let build = "cargo build --profile dist -p zenav-edge";
        return Err(format!("{name}: build it alone first, as for a robot: {build}").into());
    }
    let zenav = zenav();
    let measuring = measure(&zenav, &edge, Duration::from_secs(secs));
    let found = Runtime::new()?.block_on(measuring)?;
    const MB: f64 = 1e6;
    let figures = [
        found.size as f64 / MB,
        found.core,
        found.memory as f64 / MB,
        found.pacing.late_p99_ms,
    ];
    println!(
        "zenav-edge attached to a served kitchen for {secs} s: {:.1} ticks/s, {:.1} scans/s of {} beams; other processes kept {:.2} cores busy",
        found.ticks_hz, found.scans.0, found.scans.1, found.others
    );
    println!("{:24} {:>8} {:>8}", "", "is", "at most");
    for ((name, scale), (figure, most)) in [
        ("binary, MB", 1.0),
        ("processor, % of a core", 100.0),
        ("memory, MB", 1.0),
        ("tick late p99, ms", 1.0),
    ]
    .into_iter()
    .zip(figures.into_iter().zip(AFFORDABLE))
    {
        println!("{name:24} {:8.2} {:8.2}", scale * figure, scale * most);
        let (what, unit) = name.split_once(", ").unwrap_or((name, ""));
        Row::new(format!("zenav-edge: {what}"), scale * figure, unit).print();
    }
    println!(
        "{:24} {:8.2}\n{:24} {:8.2}",
        "tick late, p50, ms", found.pacing.late_p50_ms, "tick late, worst, ms", found.pacing.late_max_ms
    );
    Ok(figures.iter().zip(AFFORDABLE).all(|(figure, most)| *figure <= most))
}
