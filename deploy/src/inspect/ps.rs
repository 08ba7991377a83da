//! `zenav ps`. Which parts run, on which hosts, in which version, with which load.

use super::parts::{PartStatus, check_admitted, parts};
use crate::connect::{self, LinkArgs};
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
/// [`crate::exit_code::CANNOT_CONNECT`] without a router, [`crate::exit_code::TIMEOUT`] for an identity that it does not admit.
pub fn ps(args: &PsArgs) -> Outcome {
    let parts = connect::on_bus(&args.link, async |bus| parts(&bus).await)?;
    check_admitted(&args.link, parts.iter().any(|part| part.answers))?;
    output::values(args.output, &parts, table)
}

fn table(parts: &[PartStatus]) -> String {
    let header = [
        "host", "pid", "part", "role", "robot", "version", "schema", "up", "load", "memory", "clock",
    ];
    let rows = parts.iter().map(|part| row(part, is_contested(part, parts)));
    output::table(&header, rows)
}

/// Whether another copy of this part also means to lead: the robot, which decides, has not been heard yet.
fn is_contested(part: &PartStatus, parts: &[PartStatus]) -> bool {
    let is_rival = |other: &&PartStatus| {
        other.leads == Some(true) && (&other.component, &other.robot) == (&part.component, &part.robot)
    };
    part.leads == Some(true) && parts.iter().filter(is_rival).count() > 1
}

fn row(part: &PartStatus, is_contested: bool) -> [String; 11] {
    let or_dash = |text: &str| if text.is_empty() { "-" } else { text }.to_owned();
    let role = match part.leads {
        _ if !part.answers => format!("{}, no answer", part.component),
        _ if part.not_stored.is_some() => format!("{}, without room", part.component),
        Some(true) if is_contested => format!("{}, may lead", part.component),
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
    let pid = Some(part.pid).filter(|_| !part.host.is_empty());
    let if_told = |text: String| if part.answers { text } else { "-".to_owned() };
    [
        or_dash(&part.host),
        pid.map_or_else(|| "-".to_owned(), |pid| pid.to_string()),
        or_dash(&part.part),
        role,
        or_dash(&part.robot),
        or_dash(&part.version),
        if_told(part.schema.to_string()),
        if_told(age(part.uptime_secs)),
        part.load
            .map_or_else(|| "-".to_owned(), |load| format!("{:.0} %", 100.0 * load)),
        if_told(format!("{:.0} MiB", part.memory_bytes as f64 / f64::from(1 << 20))),
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
    use super::{PartStatus, age, is_contested, row};

    #[test]
    fn a_part_that_did_not_answer_and_one_without_room_say_so() {
        let mut part = PartStatus {
            component: "mission".to_owned(),
            robot: "a".to_owned(),
            ..PartStatus::default()
        };
        assert_eq!(row(&part, false).join(" "), "- - - mission, no answer a - - - - - -");
        part.answers = true;
        part.leads = Some(false);
        part.not_stored = Some("no space left on device".to_owned());
        assert_eq!(row(&part, false)[3], "mission, without room");
    }

    #[test]
    fn of_two_missions_that_mean_to_lead_one_robot_neither_is_said_to_lead() {
        let mission = |robot: &str, leads| PartStatus {
            component: "mission".to_owned(),
            robot: robot.to_owned(),
            answers: true,
            leads: Some(leads),
            ..PartStatus::default()
        };
        let roles = |parts: &[PartStatus]| -> Vec<String> {
            let role = |part: &PartStatus| row(part, is_contested(part, parts))[3].clone();
            parts.iter().map(role).collect()
        };
        assert_eq!(
            roles(&[mission("a", true), mission("a", true), mission("b", true)]),
            ["mission, may lead", "mission, may lead", "mission, leads"]
        );
        assert_eq!(
            roles(&[mission("a", true), mission("a", false)]),
            ["mission, leads", "mission, stands by"]
        );
    }

    #[test]
    fn an_age_is_told_in_two_units() {
        assert_eq!(
            [age(5.9), age(65.0), age(7260.0), age(90_000.0)],
            ["5 s", "1 min 5 s", "2 h 1 min", "1 d 1 h"]
        );
    }
}
