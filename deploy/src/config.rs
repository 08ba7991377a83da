//! What is a deployment made of, and where did each value come from?
//!
//! Layers, later ones win: the built-in defaults (`single.toml`), a deployment file, environment variables
//! `ZENAV_SECTION__KEY`, command-line flags.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use figment::Figment;
use figment::providers::{Env, Format as _, Serialized, Toml};
use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{DrivingProfile, LostPolicy, exit_code};
use zenav_protocol::settings::Settings as _;
use zenav_smoothing::SmoothingSettings;

use crate::failure::{Failure, Outcome};
use crate::output::{Format, table, value};

/// The shipped deployment: one simulated robot, everything on this machine.
pub const SINGLE: &str = include_str!("../single.toml");

/// Which parts run, where they meet, and their limits and policies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deployment {
    /// The router.
    pub router: RouterSection,
    /// How the parts reach the router.
    pub bus: BusSection,
    /// The simulated world.
    pub simulation: SimulationSection,
    /// The robots, by id.
    pub robots: BTreeMap<String, RobotSection>,
    /// Groups of robots by name: a goal for a group is done by the nearest of its robots that is free.
    #[serde(default)]
    pub groups: BTreeMap<String, Vec<String>>,
    /// The mapping service.
    pub mapping: MappingSection,
    /// Motion workers.
    pub planning: PlanningSection,
    /// How paths become trajectories.
    #[serde(default)]
    pub smoothing: SmoothingSettings,
    /// Zones of the map.
    #[serde(default)]
    pub zones: ZonesSection,
    /// The mission orchestrator.
    pub mission: MissionSection,
    /// What is kept on disk.
    pub data: DataSection,
}

/// The router.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RouterSection {
    /// Whether `zenav up` runs one.
    pub enabled: bool,
    /// Endpoints.
    pub listen: Vec<String>,
    /// Other routers to link to.
    pub connect: Vec<String>,
}

/// How the parts reach the router.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BusSection {
    /// Its endpoint.
    pub connect: String,
}

/// The simulated world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulationSection {
    /// World file or shipped name.
    pub world: String,
    /// Seed of all noise.
    pub seed: u64,
    /// Simulated seconds a second of wall time.
    pub speed: f64,
}

/// A robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSection {
    /// Robot file or shipped name.
    pub model: String,
    /// The edge's own endpoint: works with router and cloud gone. Port 0 takes a free one.
    pub listen: String,
    /// What to do with an accepted plan when the lease has expired.
    #[serde(default)]
    pub on_lost: LostPolicy,
    /// Whether it is a robot of the world that `zenav sim serve` serves, instead of one simulated in the edge's process.
    #[serde(default)]
    pub attach: bool,
    /// Start in the world; without it, the world's own.
    #[serde(default)]
    pub start: Option<Pose2>,
}

/// The mapping service.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MappingSection {
    /// Whether it runs.
    pub enabled: bool,
    /// Side of a cell, m.
    pub resolution: f64,
}

/// Motion workers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanningSection {
    /// Workers of each kind.
    pub workers: usize,
    /// Planner that missions ask for.
    pub planner: String,
}

/// Zones of the map, in which all robots are: each robot's map frame is the same.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ZonesSection {
    /// A file of keep-out and speed zones; none without it.
    #[serde(default)]
    pub file: Option<PathBuf>,
}

/// The mission orchestrator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MissionSection {
    /// Whether it runs.
    pub enabled: bool,
    /// Its name as a lease holder.
    pub holder: String,
    /// How far ahead of the robot a replan starts, s.
    pub latency_budget_secs: f64,
    /// Validity of a plan, s.
    pub plan_valid_secs: f64,
    /// What motions are to be good at where a goal does not say: `fastest` or `economy`.
    pub profile: DrivingProfile,
}

/// What is kept on disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataSection {
    /// Folder for maps, goals, and the edges' epochs.
    pub dir: PathBuf,
}

impl Deployment {
    /// Folder for a robot's files.
    #[must_use]
    pub fn robot_dir(&self, robot: &Id) -> PathBuf {
        self.data.dir.join(robot.as_str())
    }

    /// The robots' checked ids with their sections.
    ///
    /// # Errors
    /// A usage failure that names the bad id.
    pub fn robot_ids(&self) -> Result<Vec<(Id, &RobotSection)>, Failure> {
        self.robots
            .iter()
            .map(|(name, section)| {
                Id::robot(name.clone())
                    .map(|id| (id, section))
                    .map_err(|error| Failure::usage(format!("[robots.{name}]: {error}")))
            })
            .collect()
    }
}

impl Deployment {
    /// The groups' names and robots, checked.
    ///
    /// # Errors
    /// A usage failure that names the bad group.
    pub fn group_ids(&self) -> Result<Vec<(Id, Vec<Id>)>, Failure> {
        let check = |(name, robots): (&String, &Vec<String>)| {
            let bad = |why: String| Failure::usage(format!("[groups] {name}: {why}"));
            let group = Id::robot(name.clone()).map_err(|error| bad(error.to_string()))?;
            if self.robots.contains_key(name) {
                return Err(bad("a robot has this name".to_owned()));
            }
            if robots.is_empty() {
                return Err(bad("expected names of robots".to_owned()));
            }
            let members: Result<Vec<Id>, _> = robots.iter().map(|robot| Id::robot(robot.clone())).collect();
            Ok((group, members.map_err(|error| bad(error.to_string()))?))
        };
        self.groups.iter().map(check).collect()
    }
}

fn layers(file: Option<&Path>) -> Result<Figment, Failure> {
    let mut figment = Figment::from(Toml::string(SINGLE));
    if let Some(path) = file {
        if !path.is_file() {
            return Err(Failure::not_found(format!(
                "{}: no such deployment file",
                path.display()
            )));
        }
        // A deployment that names robots means those and no others.
        let own = Figment::from(Toml::file_exact(path));
        if own.find_value("robots").is_ok() {
            let mut base: figment::value::Dict =
                figment.extract().map_err(|error| Failure::usage(error.to_string()))?;
            base.remove("robots");
            figment = Figment::from(Serialized::defaults(base));
        }
        figment = figment.merge(Toml::file_exact(path));
    }
    Ok(figment.merge(Env::prefixed("ZENAV_").split("__")))
}

/// Reads a deployment: defaults, then the file, then the environment.
///
/// # Errors
/// Exit code 3 for a missing file, 2 for a bad one, with the key and where it came from.
pub fn load(file: Option<&Path>) -> Result<Deployment, Failure> {
    let deployment: Deployment = layers(file)?.extract().map_err(|errors| {
        let lines: Vec<String> = errors.into_iter().map(|error| error.to_string()).collect();
        Failure::usage(lines.join("\n"))
    })?;
    let speed = deployment.simulation.speed;
    let checks = [
        (
            speed.is_finite() && speed > 0.0,
            "simulation.speed: expected a positive number",
        ),
        (
            deployment.mapping.resolution.is_finite() && deployment.mapping.resolution >= 0.005,
            "mapping.resolution: expected at least 0.005 m",
        ),
        (
            (0.0..=60.0).contains(&deployment.mission.plan_valid_secs),
            "mission.plan_valid_secs: expected 0 to 60 s",
        ),
        (
            (0.0..=10.0).contains(&deployment.mission.latency_budget_secs),
            "mission.latency_budget_secs: expected 0 to 10 s",
        ),
        (
            (1..=64).contains(&deployment.planning.workers),
            "planning.workers: expected 1 to 64",
        ),
        (
            !deployment.robots.is_empty(),
            "robots: expected at least one [robots.ID] section",
        ),
    ];
    if let Some((_, what)) = checks.iter().find(|(good, _)| !good) {
        return Err(Failure::usage((*what).to_owned()));
    }
    deployment
        .smoothing
        .check()
        .map_err(|error| Failure::usage(format!("smoothing: {error}")))?;
    deployment.robot_ids()?;
    deployment.group_ids()?;
    Ok(deployment)
}

/// Prints the configuration.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    #[command(subcommand)]
    command: ConfigCommand,
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// Print every value
    Show {
        /// Deployment file; without it, the shipped one
        file: Option<PathBuf>,
        /// Say where each value came from
        #[arg(long)]
        origin: bool,
        /// Form of the output
        #[arg(short, long, value_enum, default_value_t)]
        output: Format,
    },
}

/// One value and where it came from.
#[derive(Debug, Serialize)]
struct Origin {
    key: String,
    value: String,
    origin: String,
}

/// `zenav config`.
///
/// # Errors
/// As [`load`].
pub fn run(args: &ConfigArgs) -> Outcome {
    let ConfigCommand::Show { file, origin, output } = &args.command;
    let deployment = load(file.as_deref())?;
    if !origin {
        value(*output, &deployment, toml_text)?;
        return Ok(exit_code::OK);
    }
    let figment = layers(file.as_deref())?;
    let mut rows = Vec::new();
    collect(
        &figment,
        file.as_deref(),
        "",
        &serde_json::to_value(&deployment).map_err(|error| Failure::failed(error.to_string()))?,
        &mut rows,
    );
    crate::output::values(*output, &rows, |rows| {
        let cells: Vec<Vec<String>> = rows
            .iter()
            .map(|row| vec![row.key.clone(), row.value.clone(), row.origin.clone()])
            .collect();
        table(&["KEY", "VALUE", "ORIGIN"], &cells)
    })?;
    Ok(exit_code::OK)
}

/// The deployment as a file that would make it.
fn toml_text(deployment: &Deployment) -> String {
    toml::to_string(deployment).unwrap_or_default()
}

fn collect(figment: &Figment, file: Option<&Path>, prefix: &str, value: &serde_json::Value, rows: &mut Vec<Origin>) {
    match value {
        serde_json::Value::Object(entries) => {
            for (name, inner) in entries {
                let key = if prefix.is_empty() {
                    name.clone()
                } else {
                    format!("{prefix}.{name}")
                };
                collect(figment, file, &key, inner, rows);
            }
        }
        leaf => rows.push(Origin {
            key: prefix.to_owned(),
            value: leaf.to_string(),
            origin: origin_of(figment, file, prefix),
        }),
    }
}

fn origin_of(figment: &Figment, file: Option<&Path>, key: &str) -> String {
    let found_in = |figment: Figment| figment.find_value(key).is_ok();
    if found_in(Figment::from(Env::prefixed("ZENAV_").split("__"))) {
        return format!("environment ZENAV_{}", key.to_uppercase().replace('.', "__"));
    }
    if let Some(path) = file
        && found_in(Figment::from(Toml::file_exact(path)))
    {
        return path.display().to_string();
    }
    if figment.find_value(key).is_ok() {
        "shipped single.toml".to_owned()
    } else {
        "default".to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_deployment_is_one_robot_on_this_machine() {
        let deployment: Deployment = Figment::from(Toml::string(SINGLE)).extract().unwrap();
        assert_eq!(deployment.robots.len(), 1);
        assert_eq!(deployment.router.listen, vec!["tcp/127.0.0.1:7447"]);
    }

    #[test]
    fn an_unknown_key_is_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("mine.toml");
        std::fs::write(&file, "[mapping]\nresolutoin = 0.1\n").unwrap();
        let failure = load(Some(&file)).unwrap_err();
        assert_eq!(failure.code, exit_code::USAGE);
        assert!(
            failure.message.contains("resolutoin") && failure.message.contains("mine.toml"),
            "{failure}"
        );
    }

    #[test]
    fn a_file_that_names_robots_means_those_alone() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("mine.toml");
        std::fs::write(
            &file,
            "[robots.neato7]\nmodel = \"neato\"\nlisten = \"tcp/127.0.0.1:0\"\n",
        )
        .unwrap();
        let deployment = load(Some(&file)).unwrap();
        assert_eq!(deployment.robots.keys().collect::<Vec<_>>(), vec!["neato7"]);
    }
}
