//! `zenav config show`: every value of a deployment, with unit, default, bounds and origin.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::Value;
use zenav_edge::config::TICK;
use zenav_protocol::settings::{Bounds, Row, Settings as _};

use super::layers::Layers;
use super::{Deployment, HostSection, RobotSection};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{Format, table, value, values};

/// Prints the configuration.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav config show --origin       where each value comes from\n  zenav config show > mine.toml    all defaults, as a file to begin with"
)]
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
        /// Add unit, default, bounds and origin of each value
        #[arg(long)]
        origin: bool,
        /// Output format
        #[arg(short, long, value_enum, default_value_t)]
        output: Format,
    },
}

/// A value and its origin.
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
    let layers = Layers::load_as_written(file.as_deref())?;
    if *origin {
        values(*output, &origins(&layers)?, |rows| {
            let header = ["KEY", "VALUE", "UNIT", "DEFAULT", "BOUNDS", "ORIGIN"];
            table(&header, rows.iter().map(Origin::cells))
        })?;
    } else {
        // The deployment as a file that reproduces it.
        value(*output, &layers.deployment, |deployment| {
            toml::to_string(deployment).unwrap_or_default()
        })?;
    }
    Ok(exit_code::OK)
}

fn origins(layers: &Layers) -> Result<Vec<Origin>, Failure> {
    // By way of the text: a conversion into values would be compiled for every section once more.
    let text = serde_json::to_string(&layers.deployment).map_err(Failure::failed)?;
    let values: Value = serde_json::from_str(&text).map_err(Failure::failed)?;
    let resolved = layers.resolved();
    let mut origins = Vec::new();
    let mut push = |row: Row, value: Option<Value>| {
        origins.push(Origin {
            origin: layers.origin(&row.key),
            value: value.unwrap_or_default(),
            key: row.key,
            unit: row.unit,
            default: row.default,
            bounds: row.bounds,
            doc: row.doc,
        });
    };
    for row in Deployment::rows() {
        let Some(rows) = rows_of_each(&row.key) else {
            let value = values.pointer(&pointer(&row.key)).cloned();
            push(row, value);
            continue;
        };
        for (name, section) in values.get(&row.key).and_then(Value::as_object).into_iter().flatten() {
            let robot = resolved.robots.get(name).filter(|_| row.key == "robots");
            for inner in rows.clone() {
                let value = section.pointer(&pointer(&inner.key)).filter(|value| !value.is_null());
                let value = value.cloned().or_else(|| derived(robot?, &inner.key));
                push(inner.within(name).within(&row.key), value);
            }
        }
    }
    Ok(origins)
}

/// What an unset value of a robot amounts to, where it follows from the robot's model alone and this can be read here.
fn derived(robot: &RobotSection, key: &str) -> Option<Value> {
    let model = files::robot(&robot.model).ok()?;
    let secs = match key {
        "edge.collision_monitor.scan_timeout" => robot.edge.scan_timeout(&model),
        "edge.collision_monitor.rest_after_silence" => robot.edge.rest_after_silence(&model, TICK),
        _ => return None,
    };
    Some(((1e3 * secs).round() / 1e3).into())
}

/// The rows of one section, for a key that holds named sections.
fn rows_of_each(key: &str) -> Option<Vec<Row>> {
    match key {
        "robots" => Some(RobotSection::rows()),
        "hosts" => Some(HostSection::rows()),
        _ => None,
    }
}

fn pointer(key: &str) -> String {
    format!("/{}", key.replace('.', "/"))
}

impl Origin {
    fn cells(&self) -> [String; 6] {
        let shown = |value: &Value| match value {
            Value::Null => "-".to_owned(),
            value => value.to_string(),
        };
        [
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
mod tests {
    use zenav_protocol::robot::ControllerGains;
    use zenav_protocol::wall_following::WallFollowing;

    use super::*;

    /// `docs/settings.md`, generated from the declared settings.
    fn reference() -> String {
        let mut page = "# Settings\n\n\
            Every setting with its unit, default and bounds. The first part is what a deployment file sets (`zenav up FILE`), the second what a robot file\n\
            sets; [tuning](tuning.md) says how. This page is made from the declarations:\n\
            `WRITE_DOCS=1 cargo test -p zenav --lib reference` writes it.\n"
            .to_owned();
        let robot_file = |section: &str, rows: Vec<Row>| rows.into_iter().map(|row| row.within(section)).collect();
        let each = |section: &'static str| {
            let rows = rows_of_each(section).unwrap_or_default().into_iter();
            rows.map(move |row| row.within("NAME").within(section))
        };
        let deployment = Deployment::rows()
            .into_iter()
            .filter(|row| rows_of_each(&row.key).is_none());
        let parts: [(&str, Vec<Row>); 3] = [
            (
                "Deployment file",
                deployment.chain(each("robots")).chain(each("hosts")).collect(),
            ),
            (
                "Robot file: trackers",
                robot_file("controller", ControllerGains::rows()),
            ),
            (
                "Robot file: wall follower",
                robot_file("wall_following", WallFollowing::rows()),
            ),
        ];
        for (title, rows) in parts {
            page += &format!("\n## {title}\n");
            let mut section = None;
            for row in rows {
                let (within, name) = row.key.rsplit_once('.').unwrap_or(("", &row.key));
                if section.as_deref() != Some(within) {
                    page += &format!(
                        "\n### `[{within}]`\n\n| key | default | unit | bounds | does |\n|---|---|---|---|---|\n"
                    );
                    section = Some(within.to_owned());
                }
                let default = match &row.default {
                    Value::Null => "-".to_owned(),
                    value => format!("`{value}`"),
                };
                let bounds = row.bounds.map_or_else(String::new, |bounds| bounds.to_string());
                page += &format!("| `{name}` | {default} | {} | {bounds} | {} |\n", row.unit, row.doc);
            }
        }
        page
    }

    #[test]
    fn the_reference_shows_what_is_declared() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/settings.md");
        if std::env::var_os("WRITE_DOCS").is_some() {
            std::fs::write(path, reference()).unwrap();
        }
        let page = std::fs::read_to_string(path).unwrap();
        assert!(
            page == reference(),
            "docs/settings.md is not what is declared; WRITE_DOCS=1 writes it"
        );
    }

    #[test]
    fn every_setting_stands_in_the_list_with_its_doc_and_the_file_that_is_printed_makes_the_same() {
        let layers = Layers::read(None, std::iter::empty()).unwrap();
        let origins = origins(&layers).unwrap();
        assert!(origins.iter().all(|row| !row.doc.is_empty() && row.origin == "default"));
        for key in [
            "robots.tiago.edge.collision_monitor.hysteresis",
            "mission.latency_budget",
            "data.dir",
        ] {
            assert!(origins.iter().any(|row| row.key == key), "{key}");
        }
        let rest = "robots.tiago.edge.collision_monitor.rest_after_silence";
        let rest = origins.iter().find(|row| row.key == rest).unwrap();
        assert_eq!(
            (&rest.value, &rest.default),
            (&Value::from(0.7), &Value::Null),
            "it follows from the model"
        );
        let unset = |row: &&Origin| row.value.is_null() && !row.default.is_null();
        assert_eq!(origins.iter().find(unset).map(|row| &row.key), None);
        let text = toml::to_string(&layers.deployment).unwrap();
        assert_eq!(toml::from_str::<Deployment>(&text).unwrap(), layers.deployment);
    }
}
