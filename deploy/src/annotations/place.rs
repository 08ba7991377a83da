//! `zenav place`. Named goals on a robot's map.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::time::Duration;

use nalgebra::Point2;
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{AnnotateAction, GoalPoint, InfoRequest, MapRequest};
use zenav_protocol::topics;
use zenav_space::{ConfigurationSpace, UnknownPolicy};

use super::{change, read};
use crate::arguments::{finite, heading};
use crate::completion;
use crate::connect::{self, RobotArgs};
use crate::failure::Outcome;
use crate::output::{self, Format};

/// Longest wait for map and robot, to check a place against them.
const LOOK_WITHIN: Duration = Duration::from_secs(2);

/// Named places.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav place add fridge 1.2 -0.4 1.57\n  zenav goal submit --place fridge --wait\n  zenav place remove fridge\n\nPlaces are kept in the data folder of mapping, beside those of the world, and outlive a restart."
)]
pub struct PlaceArgs {
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
    /// List the places that goals may name
    List,
    /// Add a place, or move the existing one of this name
    Add {
        /// Name of the place
        name: String,
        /// Map x, m
        #[arg(value_parser = finite)]
        x: f64,
        /// Map y, m
        #[arg(value_parser = finite)]
        y: f64,
        /// Heading of the robot at the place, rad [default: any]
        #[arg(value_parser = heading)]
        yaw: Option<f64>,
    },
    /// Remove a place, including one that the world file defines
    Remove {
        /// Name of the place
        #[arg(add = completion::places())]
        name: String,
    },
}

/// Lists, adds and removes places.
///
/// # Errors
/// [`crate::exit_code::NOT_FOUND`] for an unknown place, [`crate::exit_code::USAGE`] for an invalid name or number.
pub fn place(args: &PlaceArgs) -> Outcome {
    let patience = args.robot.link.patience();
    connect::on_robot(&args.robot, async |bus, robot| {
        let action = match &args.command {
            PlaceCommand::List => {
                let places = read(&bus, &robot, patience).await?.places;
                return output::value(args.output, &places, table);
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
        let PlaceCommand::Add { name, x, y, .. } = &args.command else {
            return output::value(args.output, &places, |places| {
                format!("{robot} knows {}", output::counted(places.len(), "place"))
            });
        };
        let looked_at = doubt(&bus, &robot, Point2::new(*x, *y)).await;
        if let Some(Some(doubt)) = looked_at {
            crate::output::note(format_args!("zenav: ({x}, {y}) {doubt}: a goal there may be refused"));
        }
        let goes_there = match looked_at {
            Some(None) => format!(
                ": `zenav goal submit --place {} --robot {robot}` goes there",
                quoted(name)
            ),
            _ => String::new(),
        };
        output::value(args.output, &places, |_| {
            format!("{robot} knows {name} at ({x}, {y}){goes_there}")
        })
    })
}

/// Why a goal at this point would fail, if it would; outer `None` if map or robot do not answer.
async fn doubt(bus: &Bus, robot: &str, at: Point2<f64>) -> Option<Option<&'static str>> {
    let map = bus
        .ask(&topics::MAP, &[robot], &MapRequest::default(), LOOK_WITHIN)
        .await;
    let grid = map.ok()?.grid().ok()?;
    if grid.spec().cell_at(at).is_none() {
        return Some(Some("lies outside the map"));
    }
    let info = bus
        .ask(&topics::EDGE_INFO, &[robot], &InfoRequest {}, LOOK_WITHIN)
        .await;
    let model = info.ok()?.model?;
    let space = ConfigurationSpace::new(&grid, &model.footprint, UnknownPolicy::Free, 0.0);
    let fits = space.clearance(at) > space.radius();
    Some((!fits).then_some("is where the robot does not fit"))
}

/// A name quoted so that a shell takes it as one word.
fn quoted(name: &str) -> Cow<'_, str> {
    let plain = |letter: char| letter.is_alphanumeric() || "-_.".contains(letter);
    match name.chars().all(plain) {
        true => name.into(),
        false => format!("'{}'", name.replace('\'', r"'\''")).into(),
    }
}

fn table(places: &BTreeMap<String, GoalPoint>) -> String {
    let rows = places.iter().map(|(name, at)| {
        let yaw = at.yaw.map_or_else(|| "any".to_owned(), |yaw| format!("{yaw:.3}"));
        [name.clone(), format!("{:.2}", at.x), format!("{:.2}", at.y), yaw]
    });
    output::table(&["PLACE", "X m", "Y m", "YAW rad"], rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_of_several_words_is_one_to_a_shell() {
        assert_eq!(["sink", "a b", "it's"].map(quoted), ["sink", "'a b'", r"'it'\''s'"]);
    }
}
