//! Cost. What does a count cost the stage that counts, and a scrape the process? `cargo run --release -p zenav-observability --example cost`

#![allow(clippy::print_stdout, reason = "an example")]

use std::hint::black_box;
use std::time::Instant;

use zenav_observability::metrics::{self, BUS_PUBLISHED, BUS_RECEIVED, CONTROL_TICK, SCAN_INSERTION, SCANS};

/// Robots of a site, each with its own series.
const ROBOTS: usize = 10;
/// Topics that a part hears and publishes.
const TOPICS: usize = 25;

fn main() {
    let counter = SCANS.with_label_values(&["tiago", "inserted"]);
    println!("a counter: {:.1} ns", nanos(10_000_000, || counter.inc()));
    let histogram = CONTROL_TICK.with_label_values(&["tiago"]);
    println!(
        "a duration: {:.1} ns",
        nanos(10_000_000, || histogram.observe(black_box(0.0007)))
    );
    for robot in 0..ROBOTS {
        let robot = format!("robot-{robot}");
        CONTROL_TICK.with_label_values(&[&robot]).observe(0.001);
        SCAN_INSERTION.with_label_values(&[&robot]).observe(0.001);
        for topic in 0..TOPICS {
            let topic = format!("zenav/{{robot}}/edge/topic-{topic}");
            BUS_PUBLISHED.with_label_values(&[&robot, &topic]).inc();
            BUS_RECEIVED.with_label_values(&[&robot, &topic]).inc();
        }
    }
    let series = metrics::text().lines().filter(|line| !line.starts_with('#')).count();
    let scrape = nanos(500, || {
        black_box(metrics::text());
    });
    println!("a scrape of {series} lines: {:.2} ms", scrape / 1e6);
}

/// Time of one round, ns.
fn nanos(rounds: u32, mut round: impl FnMut()) -> f64 {
    let began = Instant::now();
    for _ in 0..rounds {
        round();
    }
    began.elapsed().as_secs_f64() * 1e9 / f64::from(rounds)
}
