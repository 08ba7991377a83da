//! What does the typed bus cost over raw Zenoh, and a protected link over plain TCP?
//! `cargo bench -p zenav-tests --bench bus`; the aim is a ratio of 1.15 at the median.
//!
//! Not criterion's loop: the two ways take turns within one run, and the 99th percentile counts. Under `cargo test` a short run
//! shows that it works.

use zenav_fixtures::Row;
use zenav_protocol::bus::{Security, overhead};

#[tokio::main(flavor = "multi_thread")]
#[allow(clippy::print_stdout, reason = "a bench prints its numbers")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let samples = if std::env::args().any(|argument| argument == "--bench") {
        4000
    } else {
        20
    };
    println!(
        "{:26} {:4} {:>6} {:>7} {:>10} {:>10} {:>6} {:>10} {:>10} {:>6}",
        "", "over", "bytes", "samples", "typed p50", "raw p50", "ratio", "typed p99", "raw p99", "ratio"
    );
    let folder = tempfile::tempdir()?;
    let identity = zenav::keys::make(&folder.path().join("fleet"), "router.bench")?;
    let mtls = Security::of(Some(&identity), false)?;
    let mut rows = overhead::measure(samples, &Security::Loopback).await?;
    rows.extend(overhead::measure(samples, &mtls).await?);
    for row in rows {
        println!(
            "{:26} {:4} {:>6} {:>7} {:>7.1} us {:>7.1} us {:>6.3} {:>7.0} us {:>7.0} us {:>6.3}",
            row.what,
            row.over,
            row.bytes,
            row.samples,
            row.typed.p50_us,
            row.raw.p50_us,
            row.ratio_p50,
            row.typed.p99_us,
            row.raw.p99_us,
            row.ratio_p99
        );
        let over = if row.over == "TCP" {
            String::new()
        } else {
            format!(" over {}", row.over)
        };
        for (share, typed, raw) in [
            ("p50", row.typed.p50_us, row.raw.p50_us),
            ("p99", row.typed.p99_us, row.raw.p99_us),
        ] {
            let name = format!("{} of {} bytes{over}, {share}", row.what, row.bytes);
            Row::new(name, typed, "us").beside("raw Zenoh", raw).print();
        }
    }
    Ok(())
}
