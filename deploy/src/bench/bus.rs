//! Costs of the typed bus, compared with raw Zenoh, over plain TCP and over QUIC with certificates on both sides.

use zenav_protocol::bus::{Security, overhead};

use crate::arguments;
use crate::connect;
use crate::failure::Outcome;
use crate::keys;
use crate::output::{self, Format};

/// Arguments of `zenav bench bus`.
#[derive(Debug, clap::Args)]
pub struct BusArgs {
    /// Samples of each kind
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = arguments::whole_in(1..=1_000_000_u32))]
    samples: u32,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Measures the bus.
///
/// # Errors
/// This machine does not allow listening or connecting.
pub(super) fn bus(args: &BusArgs) -> Outcome {
    let samples = args.samples as usize;
    let folder = std::env::temp_dir().join(format!("zenav-bench-{}", std::process::id()));
    let rows = keys::make(&folder, "router.bench").and_then(|identity| {
        let mtls = Security::of(Some(&identity), false)?;
        connect::block_on(async {
            let mut rows = overhead::measure(samples, &Security::Loopback).await?;
            rows.extend(overhead::measure(samples, &mtls).await?);
            Ok(rows)
        })
    });
    // Throwaway keys.
    let _ = std::fs::remove_dir_all(&folder);
    let rows = rows?;
    output::values(args.output, &rows, |rows| {
        let row = |row: &overhead::Comparison| {
            let us = |value: f64| format!("{value:.1}");
            [
                row.what.clone(),
                row.over.to_owned(),
                row.bytes.to_string(),
                us(row.typed.p50_us),
                us(row.raw.p50_us),
                format!("{:.3}", row.ratio_p50),
                us(row.typed.p99_us),
                us(row.raw.p99_us),
                format!("{:.3}", row.ratio_p99),
            ]
        };
        output::table(
            &[
                "WHAT",
                "OVER",
                "BYTES",
                "TYPED p50 us",
                "RAW p50 us",
                "RATIO",
                "TYPED p99 us",
                "RAW p99 us",
                "RATIO",
            ],
            rows.iter().map(row),
        )
    })
}
