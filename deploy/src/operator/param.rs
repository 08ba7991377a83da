//! `zenav param`. Reads and sets the gains of a running robot by name, within the bounds of the robot file. A set value lasts until the
//! edge restarts.

use std::collections::BTreeMap;

use serde::Serialize;
use zenav_cloud::operator;
use zenav_protocol::bus::AskError;
use zenav_protocol::messages::{ParamRequest, Refusal};
use zenav_protocol::topics;

use super::holder;
use crate::arguments::finite;
use crate::completion;
use crate::connect::{self, RobotArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Parameters of a running robot.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav param list\n  zenav param get heading_gain\n  zenav param set heading_gain 2.5\n\nWhat is set lasts until the edge restarts; the robot file keeps it for good."
)]
pub struct ParamArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: ParamCommand,
}

#[derive(Debug, clap::Subcommand)]
enum ParamCommand {
    /// List all parameters with their values
    List,
    /// Print the value of a parameter
    Get {
        /// Name of the parameter
        #[arg(add = completion::params())]
        name: String,
    },
    /// Set a parameter; takes effect at once, a value out of bounds is refused
    Set {
        /// Name of the parameter
        #[arg(add = completion::params())]
        name: String,
        /// New value, in the unit of the robot file
        #[arg(value_parser = finite)]
        value: f64,
    },
}

/// A parameter that was set.
#[derive(Debug, Serialize)]
struct Set {
    robot: String,
    name: String,
    before: f64,
    value: f64,
}

/// Lists, prints and sets parameters.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for an unknown name, [`exit_code::REJECTED`] for a value out of bounds.
pub fn param(args: &ParamArgs) -> Outcome {
    let patience = args.robot.link.patience();
    let format = args.output;
    connect::on_robot(&args.robot, async |bus, robot| {
        let read = async |name: Option<&String>| -> Result<BTreeMap<String, f64>, Failure> {
            let request = ParamRequest {
                name: name.cloned(),
                ..ParamRequest::default()
            };
            match (bus.ask(&topics::PARAM, &[&robot], &request, patience).await, name) {
                (Ok(reply), _) => Ok(reply.params),
                (Err(AskError::Refused(Refusal::NotFound { .. })), Some(name)) => {
                    let all = ParamRequest::default();
                    let known = bus.ask(&topics::PARAM, &[&robot], &all, patience).await?.params;
                    let perhaps = output::perhaps(name, known.keys().map(String::as_str));
                    Err(Failure::not_found(format!(
                        "{robot} has no parameter `{name}`{perhaps} (`zenav param list --robot {robot}` lists all)"
                    )))
                }
                (Err(error), _) => Err(error.into()),
            }
        };
        match &args.command {
            ParamCommand::List => {
                output::value(format, &read(None).await?, table)?;
            }
            ParamCommand::Get { name } => {
                let value = value_of(&read(Some(name)).await?, name)?;
                output::value(format, &serde_json::json!({ name: value }), |_| value.to_string())?;
            }
            ParamCommand::Set { name, value } => {
                let before = value_of(&read(Some(name)).await?, name)?;
                let ask = async |epoch| {
                    let request = ParamRequest {
                        name: Some(name.clone()),
                        value: Some(*value),
                        epoch,
                    };
                    bus.ask(&topics::PARAM, &[&robot], &request, patience).await
                };
                let reply = operator::in_force_or_own(&bus, &robot, &holder(), patience, ask).await?;
                let set = Set {
                    value: value_of(&reply.params, name)?,
                    robot,
                    name: name.clone(),
                    before,
                };
                output::value(format, &set, |set| {
                    format!("{} of {}: {} (before: {})", set.name, set.robot, set.value, set.before)
                })?;
            }
        }
        Ok(exit_code::OK)
    })
}

fn value_of(params: &BTreeMap<String, f64>, name: &str) -> Result<f64, Failure> {
    let value = params.get(name).copied();
    value.ok_or_else(|| Failure::failed(format!("the robot's answer has no `{name}`")))
}

fn table(params: &BTreeMap<String, f64>) -> String {
    let rows = params.iter().map(|(name, value)| [name.clone(), value.to_string()]);
    output::table(&["PARAMETER", "VALUE"], rows)
}
