//! `zenav zone`. Zones of a robot's map that it must not enter, or must drive through slowly.

use nalgebra::Point2;
use zenav_protocol::messages::{AnnotateAction, Zone, ZoneRule};

use super::{change, read};
use crate::arguments::{finite, positive};
use crate::completion;
use crate::connect::{self, RobotArgs};
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Keep-out and speed zones.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav zone add wet --keep-out 0.2 -1 0.8 -1 0.8 -0.4 0.2 -0.4\n  zenav zone add door --max-speed 0.2 1 0 2 0 2 1 1 1\n  zenav zone remove wet\n\nA zone acts on the plan that is driven too: the robot plans anew around it. Zones are kept in the data folder of mapping, beside those of\nthe deployment's file, and outlive a restart."
)]
pub struct ZoneArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: ZoneCommand,
}

#[derive(Debug, clap::Subcommand)]
enum ZoneCommand {
    /// List the zones
    List,
    /// Add a zone, or replace the existing one of this name
    Add(AddArgs),
    /// Remove a zone, including one from the deployment's file
    Remove {
        /// Name of the zone
        #[arg(add = completion::zones())]
        name: String,
    },
    /// Remove all zones
    Clear,
}

#[derive(Debug, clap::Args)]
#[command(group(clap::ArgGroup::new("rule").required(true).args(["keep_out", "max_speed"])))]
struct AddArgs {
    /// Name of the zone
    name: String,
    /// Keep every part of a robot out of the zone
    #[arg(long)]
    keep_out: bool,
    /// Largest speed while the robot's centre is inside, m/s
    #[arg(long, value_name = "M/S", value_parser = positive)]
    max_speed: Option<f64>,
    /// Corners of the zone in order, map frame, m: x and y of at least three
    #[arg(value_name = "X Y", required = true, num_args = 1.., value_parser = finite)]
    coordinates: Vec<f64>,
}

/// Lists, adds and removes zones.
///
/// # Errors
/// [`crate::exit_code::NOT_FOUND`] for an unknown zone, [`crate::exit_code::USAGE`] for an invalid polygon.
pub fn zone(args: &ZoneArgs) -> Outcome {
    let patience = args.robot.link.patience();
    connect::on_robot(&args.robot, async |bus, robot| {
        let action = match &args.command {
            ZoneCommand::List => {
                let zones = read(&bus, &robot, patience).await?.zones;
                return output::values(args.output, &zones, table);
            }
            ZoneCommand::Add(add) => AnnotateAction::AddZone { zone: add.zone()? },
            ZoneCommand::Remove { name } => AnnotateAction::RemoveZone { name: name.clone() },
            ZoneCommand::Clear => AnnotateAction::ClearZones,
        };
        let zones = change(&bus, &robot, patience, action).await?.zones;
        output::values(args.output, &zones, |zones| match zones {
            [] => format!("the map of {robot} has no zones"),
            zones => table(zones),
        })
    })
}

impl AddArgs {
    fn zone(&self) -> Result<Zone, Failure> {
        let rule = match self.max_speed {
            Some(max_speed) => ZoneRule::SpeedLimit { max_speed },
            None => ZoneRule::KeepOut,
        };
        let (pairs, odd) = self.coordinates.as_chunks::<2>();
        if !odd.is_empty() || pairs.len() < 3 {
            return Err(Failure::usage(format!(
                "{}: expected x and y of each of at least three corners",
                output::counted(self.coordinates.len() as u64, "coordinate")
            )));
        }
        let zone = Zone {
            name: self.name.clone(),
            rule,
            points: pairs.iter().copied().map(Point2::from).collect(),
        };
        // The mapping service makes the same check; here it runs before anything is sent.
        zenav_space::Zones::new(std::slice::from_ref(&zone)).map_err(Failure::usage)?;
        Ok(zone)
    }
}

fn table(zones: &[Zone]) -> String {
    let rows = zones.iter().map(|zone| {
        let rule = match zone.rule {
            ZoneRule::KeepOut => "keep out".to_owned(),
            ZoneRule::SpeedLimit { max_speed } => format!("at most {max_speed} m/s"),
        };
        let corners = zone.points.iter().map(|point| format!("{:.2},{:.2}", point.x, point.y));
        [zone.name.clone(), rule, corners.collect::<Vec<_>>().join(" ")]
    });
    output::table(&["ZONE", "RULE", "CORNERS m"], rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn added(words: &[&str]) -> Result<Zone, String> {
        let parsed = crate::cli::parsed(&[&["add"], words].concat());
        let args: ZoneArgs = parsed.map_err(|error| error.to_string())?;
        match args.command {
            ZoneCommand::Add(add) => add.zone().map_err(|failure| failure.to_string()),
            _ => Err("another command".to_owned()),
        }
    }

    #[test]
    fn a_zone_has_one_rule_and_a_simple_polygon() {
        let zone = added(&["wet", "--keep-out", "-1", "0", "1", "0", "1", "-1"]).unwrap();
        assert_eq!((zone.rule, zone.points[0]), (ZoneRule::KeepOut, Point2::new(-1.0, 0.0)));
        let zone = added(&["door", "--max-speed", "0.2", "0", "0", "1", "0", "1", "1"]).unwrap();
        assert_eq!(zone.rule, ZoneRule::SpeedLimit { max_speed: 0.2 });
        for (words, what) in [
            (
                &["a", "0", "0", "1", "0", "1", "1"][..],
                "<--keep-out|--max-speed <M/S>>",
            ),
            (
                &["a", "--keep-out", "--max-speed", "1", "0", "0", "1", "0", "1", "1"],
                "cannot be used with",
            ),
            (&["a", "--keep-out", "0", "0", "1", "0"], "4 coordinates"),
            (&["a", "--keep-out", "0", "0", "1", "0", "1", "1", "2"], "7 coordinates"),
            (&["a", "--keep-out", "0", "0", "1", "1", "1", "0", "0", "1"], "zone `a`"),
        ] {
            let error = added(words).unwrap_err();
            assert!(error.contains(what), "{words:?}: {error}");
        }
    }
}
