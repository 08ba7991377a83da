//! The typed bus beside raw Zenoh. What does it cost?

use zenav_protocol::bus::overhead;

use crate::connect;
use crate::exit_code;
use crate::failure::Outcome;
use crate::output::{self, Format};

/// Arguments of `zenav bench bus`.
#[derive(Debug, clap::Args)]
pub struct BusArgs {
    /// Samples of each kind
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Measures it.
///
/// # Errors
/// When this machine does not let it listen and connect.
pub(super) fn bus(args: &BusArgs) -> Outcome {
    let rows = connect::block_on(async { Ok(overhead::measure(args.samples as usize).await?) })?;
    output::values(args.output, &rows, |rows| {
        let row = |row: &overhead::Comparison| {
            let us = |value: f64| format!("{value:.1}");
            vec![
                row.what.clone(),
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
                "BYTES",
                "TYPED p50 us",
                "RAW p50 us",
                "RATIO",
                "TYPED p99 us",
                "RAW p99 us",
                "RATIO",
            ],
            &rows.iter().map(row).collect::<Vec<_>>(),
        )
    })?;
    Ok(exit_code::OK)
}
