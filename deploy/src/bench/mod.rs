//! Benchmarks. Costs of the bus, and driving quality.
//!
//! | module | answers |
//! |---|---|
//! | `bus` | what does the typed bus cost, compared with raw Zenoh? |
//! | `drive` | `zenav bench drive`: how well does zenav drive, compared with anchors? |
//! | `suites` | the worlds (generated in code, from seeds) |
//! | `anchors` | how does a reference driver get on in the same worlds? |

mod anchors;
mod bus;
mod drive;
mod suites;

pub use bus::BusArgs;
pub use drive::DriveArgs;

use crate::failure::Outcome;

/// Benchmarks.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  zenav bench bus\n  zenav bench drive --suite s2 --seeds 3 --no-anchors")]
pub struct BenchArgs {
    #[command(subcommand)]
    command: BenchCommand,
}

#[derive(Debug, clap::Subcommand)]
enum BenchCommand {
    /// Measure the typed bus against raw Zenoh: identical bytes, the same codec, alternating
    Bus(BusArgs),
    /// Measure driving in lockstep, judged by ground truth, beside anchors in the same worlds
    Drive(DriveArgs),
}

/// Runs a bench.
///
/// # Errors
/// [`exit_code::USAGE`](crate::exit_code::USAGE) for unknown names; a bus that this machine does not allow.
pub fn bench(args: &BenchArgs) -> Outcome {
    match &args.command {
        BenchCommand::Bus(args) => bus::bus(args),
        BenchCommand::Drive(args) => drive::drive(args),
    }
}
