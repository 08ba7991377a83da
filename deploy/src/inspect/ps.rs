//! `zenav ps`. Which parts run, on which hosts, in which version, with which load.

use super::parts::{Part, parts};
use crate::connect::{self, LinkArgs};
use crate::exit_code;
use crate::failure::Outcome;
use crate::output::{self, Format};

/// Arguments of `zenav ps`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Load and memory are those of the process: parts that share one show the same. A clock is that of the part's host against this machine's; zenav compares no clocks, but whoever reads two logs does.\n\nExamples:\n  zenav ps\n  zenav ps -o ndjson --connect tcp/10.0.0.5:7447"
)]
pub struct PsArgs {
    #[command(flatten)]
    link: LinkArgs,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Lists the parts of a deployment.
///
/// # Errors
/// [`exit_code::CANNOT_CONNECT`] without a router.
pub fn ps(args: &PsArgs) -> Outcome {
    let parts = connect::on_bus(&args.link, async |bus| parts(&bus).await)?;
    output::values(args.output, &parts, table)?;
    Ok(exit_code::OK)
}

fn table(parts: &[Part]) -> String {
    let rows: Vec<Vec<String>> = parts.iter().map(row).collect();
    output::table(
        &[
            "host", "pid", "part", "role", "robot", "version", "schema", "up", "load", "memory", "clock",
        ],
        &rows,
    )
}

fn row(part: &Part) -> Vec<String> {
    let or_dash = |text: &str| {
        if text.is_empty() {
            "-".to_owned()
        } else {
            text.to_owned()
        }
    };
    let role = match part.leads {
        Some(true) => format!("{}, leads", part.component),
        Some(false) => format!("{}, stands by", part.component),
        None => part.component.clone(),
    };
    let clock = if part.host.is_empty() {
        "-".to_owned()
    } else if part.clock_is_off(0.0) {
        format!("{:+.2} s ± {:.2}", part.clock_ahead_secs, part.clock_uncertainty_secs)
    } else {
        format!("same ± {:.2} s", part.clock_uncertainty_secs)
    };
    vec![
        or_dash(&part.host),
        if part.host.is_empty() {
            "-".to_owned()
        } else {
            part.pid.to_string()
        },
        or_dash(&part.part),
        role,
        or_dash(&part.robot),
        part.version.clone(),
        part.schema.to_string(),
        age(part.uptime_secs),
        part.load
            .map_or_else(|| "-".to_owned(), |load| format!("{:.0} %", 100.0 * load)),
        format!("{:.0} MiB", part.memory_bytes as f64 / f64::from(1 << 20)),
        clock,
    ]
}

/// Time since a start, in its two largest units.
fn age(secs: f64) -> String {
    let secs = secs.max(0.0) as u64;
    match (secs / 86_400, secs / 3600 % 24, secs / 60 % 60, secs % 60) {
        (0, 0, 0, seconds) => format!("{seconds} s"),
        (0, 0, minutes, seconds) => format!("{minutes} min {seconds} s"),
        (0, hours, minutes, _) => format!("{hours} h {minutes} min"),
        (days, hours, ..) => format!("{days} d {hours} h"),
    }
}

#[cfg(test)]
mod tests {
    use super::age;

    #[test]
    fn an_age_is_told_in_two_units() {
        assert_eq!(
            [age(5.9), age(65.0), age(7260.0), age(90_000.0)],
            ["5 s", "1 min 5 s", "2 h 1 min", "1 d 1 h"]
        );
    }
}
