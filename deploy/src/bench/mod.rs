//! Benchmarks. How fast is the bus, and how well does the robot drive?
//!
//! | module | answers |
//! |---|---|
//! | `bus` | what does the typed bus cost beside raw Zenoh? |
//! | `drive` | `zenav bench drive`: how well does it drive, beside its anchors? |
//! | `suites` | in which worlds? (made in code, from seeds) |
//! | `anchors` | how do others drive there? (dynamic windows, and a planner that knows all) |

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
    /// The typed bus beside raw Zenoh: identical bytes, the same codec, taking turns
    Bus(BusArgs),
    /// Driving in lockstep, judged by truth, beside anchors in the same worlds
    Drive(DriveArgs),
}

/// Runs a bench.
///
/// # Errors
/// [`exit_code::USAGE`](crate::exit_code::USAGE) for wrong names; a bus that this machine does not allow.
pub fn bench(args: &BenchArgs) -> Outcome {
    match &args.command {
        BenchCommand::Bus(args) => bus::bus(args),
        BenchCommand::Drive(args) => drive::drive(args),
    }
}
