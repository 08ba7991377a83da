//! `zenav config show`: every value of a deployment, with unit, default, bounds and origin.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::Value;
use zenav_protocol::messages::exit_code;
use zenav_protocol::settings::{Bounds, Row, Settings as _};

use super::layers::Layers;
use super::{Deployment, RobotSection};
use crate::failure::{Failure, Outcome};
use crate::output::{Format, table, value, values};

/// Prints the configuration.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    #[command(subcommand)]
    command: ConfigCommand,
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// Print every value of a deployment
    Show {
        /// Deployment file; without it, the defaults
        file: Option<PathBuf>,
        /// With unit, default, bounds and origin of each value
        #[arg(long)]
        origin: bool,
        /// Output format
        #[arg(short, long, value_enum, default_value_t)]
        output: Format,
    },
}

/// One value and where it came from.
#[derive(Debug, Serialize)]
struct Origin {
    key: String,
    value: Value,
    unit: &'static str,
    default: Value,
    bounds: Option<Bounds>,
    origin: String,
    doc: &'static str,
}

/// `zenav config`.
///
/// # Errors
/// As [`load`](super::load).
pub fn run(args: &ConfigArgs) -> Outcome {
    let ConfigCommand::Show { file, origin, output } = &args.command;
    let layers = Layers::read(file.as_deref(), std::env::vars())?;
    if *origin {
        values(*output, &origins(&layers)?, |rows| {
            let cells: Vec<Vec<String>> = rows.iter().map(Origin::cells).collect();
            table(&["KEY", "VALUE", "UNIT", "DEFAULT", "BOUNDS", "ORIGIN"], &cells)
        })?;
    } else {
        // The deployment as a file that would make it.
        value(*output, &layers.deployment, |deployment| {
            toml::to_string(deployment).unwrap_or_default()
        })?;
    }
    Ok(exit_code::OK)
}

fn origins(layers: &Layers) -> Result<Vec<Origin>, Failure> {
    let values = serde_json::to_value(&layers.deployment).map_err(|error| Failure::failed(error.to_string()))?;
    let mut origins = Vec::new();
    let mut push = |row: Row, value: Option<&Value>| {
        origins.push(Origin {
            origin: layers.origin(&row.key),
            value: value.cloned().unwrap_or_default(),
            key: row.key,
            unit: row.unit,
            default: row.default,
            bounds: row.bounds,
            doc: row.doc,
        });
    };
    for row in Deployment::rows() {
        if row.key == "robots" {
            for (name, robot) in values.get("robots").and_then(Value::as_object).into_iter().flatten() {
                for row in RobotSection::rows() {
                    let value = robot.pointer(&pointer(&row.key));
                    push(row.within(name).within("robots"), value);
                }
            }
        } else {
            let value = values.pointer(&pointer(&row.key));
            push(row, value);
        }
    }
    Ok(origins)
}

fn pointer(key: &str) -> String {
    format!("/{}", key.replace('.', "/"))
}

impl Origin {
    fn cells(&self) -> Vec<String> {
        let shown = |value: &Value| match value {
            Value::Null => "-".to_owned(),
            value => value.to_string(),
        };
        vec![
            self.key.clone(),
            shown(&self.value),
            self.unit.to_owned(),
            shown(&self.default),
            self.bounds.map_or_else(String::new, |bounds| bounds.to_string()),
            self.origin.clone(),
        ]
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_setting_stands_in_the_list_with_its_doc_and_the_file_that_is_printed_makes_the_same() {
        let layers = Layers::read(None, std::iter::empty()).unwrap();
        let origins = origins(&layers).unwrap();
        assert!(origins.iter().all(|row| !row.doc.is_empty() && row.origin == "default"));
        for key in ["robots.tiago.listen", "mission.latency_budget_secs", "data.dir"] {
            assert!(origins.iter().any(|row| row.key == key), "{key}");
        }
        let unset = |row: &&Origin| row.value.is_null() && !row.default.is_null();
        assert_eq!(origins.iter().find(unset).map(|row| &row.key), None);
        let text = toml::to_string(&layers.deployment).unwrap();
        assert_eq!(toml::from_str::<Deployment>(&text).unwrap(), layers.deployment);
    }
}
