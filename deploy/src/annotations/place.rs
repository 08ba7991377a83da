//! `zenav place`. Which named goals has the map of a robot?

use std::collections::BTreeMap;

use zenav_protocol::messages::{AnnotateAction, GoalPoint};

use super::{change, read};
use crate::completion;
use crate::connect::{self, RobotArgs, finite, heading};
use crate::exit_code;
use crate::failure::Outcome;
use crate::output::{self, Format};

/// Named places.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav place add fridge 1.2 -0.4 1.57\n  zenav goal submit --place fridge --wait\n  zenav place remove fridge\n\nPlaces are kept in the data folder of mapping, beside those of the world, and outlive a restart."
)]
pub struct PlaceArgs {
    /// Connection and robot.
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: PlaceCommand,
}

#[derive(Debug, clap::Subcommand)]
enum PlaceCommand {
    /// List the places that a goal may name
    List,
    /// Add a place, or move the one of this name
    Add {
        /// Name of the place
        name: String,
        /// Map x, m
        #[arg(value_parser = finite)]
        x: f64,
        /// Map y, m
        #[arg(value_parser = finite)]
        y: f64,
        /// Heading of a robot that goes there, rad [default: any]
        #[arg(value_parser = heading)]
        yaw: Option<f64>,
    },
    /// Remove a place, also one of the world
    Remove {
        /// Name of the place
        #[arg(add = completion::places())]
        name: String,
    },
}

/// Lists, adds and removes places.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for an unknown place, [`exit_code::USAGE`] for a name or numbers that cannot be.
pub fn place(args: &PlaceArgs) -> Outcome {
    let patience = args.robot.link.patience();
    connect::on_robot(&args.robot, async |bus, robot| {
        let action = match &args.command {
            PlaceCommand::List => {
                let places = read(&bus, &robot, patience).await?.places;
                output::value(args.output, &places, table)?;
                return Ok(exit_code::OK);
            }
            PlaceCommand::Add { name, x, y, yaw } => AnnotateAction::AddPlace {
                name: name.clone(),
                at: GoalPoint {
                    x: *x,
                    y: *y,
                    yaw: *yaw,
                },
            },
            PlaceCommand::Remove { name } => AnnotateAction::RemovePlace { name: name.clone() },
        };
        let places = change(&bus, &robot, patience, action).await?.places;
        output::value(args.output, &places, |places| match &args.command {
            PlaceCommand::Add { name, x, y, .. } => {
                format!("{robot} knows {name} at ({x}, {y}): `zenav goal submit --place {name}` goes there")
            }
            _ => format!("{robot} knows {}", output::counted(places.len(), "place")),
        })?;
        Ok(exit_code::OK)
    })
}

fn table(places: &BTreeMap<String, GoalPoint>) -> String {
    let rows: Vec<Vec<String>> = places
        .iter()
        .map(|(name, at)| {
            let yaw = at.yaw.map_or_else(|| "any".to_owned(), |yaw| format!("{yaw:.3}"));
            vec![name.clone(), format!("{:.2}", at.x), format!("{:.2}", at.y), yaw]
        })
        .collect();
    output::table(&["PLACE", "X m", "Y m", "YAW rad"], &rows)
}
