//! Layers of a deployment. The last layer that sets a key wins: defaults, deployment file, environment variables `ZENAV_SECTION__KEY`,
//! then the flags of commands.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use toml::{Table, Value};
use zenav_edge::config::TICK;
use zenav_protocol::config_text::{OutOfBounds, line_if_written};
use zenav_protocol::id::Id;
use zenav_protocol::robot;
use zenav_protocol::settings::{Row, Settings as _};
use zenav_sim::{World, world};

use super::{Deployment, HostSection, RobotSection};
use crate::exit_code;
use crate::failure::Failure;
use crate::files;
use crate::hosts;
use crate::output::{listed, nearest};

/// Origin of a value that no layer sets.
const DEFAULT: &str = "default";
/// Prefix of environment variables that set values.
const PREFIX: &str = "ZENAV_";
/// Largest edit distance between an unknown key and the known one that is suggested for it.
const SLIPS: usize = 2;

/// Reads a deployment: defaults, then the file, then the environment. A relative path in the file means a file beside it.
///
/// # Errors
/// Exit code 3 for a missing file, 2 for a bad one, with the key and where it is written.
pub fn load(file: Option<&Path>) -> Result<Deployment, Failure> {
    Ok(Layers::load(file)?.deployment)
}

/// A deployment and the layers it was built from.
pub(crate) struct Layers {
    pub(crate) deployment: Deployment,
    file: Option<(PathBuf, String)>,
    /// Keys that the environment sets.
    environment: BTreeMap<String, String>,
}

impl Layers {
    /// Like [`load`], with the origins.
    pub(crate) fn load(file: Option<&Path>) -> Result<Self, Failure> {
        Self::load_as_written(file).map(Self::with_paths)
    }

    /// As [`Self::load`], with the paths as the file writes them.
    pub(crate) fn load_as_written(file: Option<&Path>) -> Result<Self, Failure> {
        Self::read(file, std::env::vars())
    }

    /// As [`Self::load_as_written`], from a file alone: the environment is ignored.
    pub(crate) fn load_file(file: &Path) -> Result<Self, Failure> {
        Self::read(Some(file), std::iter::empty())
    }

    /// Whether the file or the environment sets a key.
    pub(crate) fn sets(&self, key: &str) -> bool {
        self.origin(key) != DEFAULT
    }

    fn with_paths(mut self) -> Self {
        self.deployment = self.resolved();
        self
    }

    /// The deployment with the paths of its file as the working directory sees them. Shipped names stay; paths from the environment are
    /// relative to the working directory already.
    pub(super) fn resolved(&self) -> Deployment {
        let mut deployment = self.deployment.clone();
        let Some(folder) = self.folder() else { return deployment };
        let is_ours = |key: &str| !self.environment.contains_key(key);
        let beside = |name: &str| folder.join(name).to_string_lossy().into_owned();
        let place = &mut deployment.simulation.world;
        if is_ours("simulation.world") && !place.is_empty() && world::shipped(place).is_none() {
            *place = beside(place);
        }
        for (name, section) in &mut deployment.robots {
            if is_ours(&format!("robots.{name}.model")) {
                let parts = section.model.split('+').enumerate().map(|(index, part)| {
                    let shipped = if index == 0 { robot::SHIPPED } else { robot::OPTIONS };
                    let is_shipped = files::names(shipped).any(|known| known == part);
                    if is_shipped { part.to_owned() } else { beside(part) }
                });
                section.model = parts.collect::<Vec<_>>().join("+");
            }
        }
        for (key, file) in [
            ("mapping.map", &mut deployment.mapping.run.map),
            ("zones.file", &mut deployment.zones.file),
        ] {
            if let Some(file) = file.as_mut().filter(|_| is_ours(key)) {
                *file = folder.join(&*file);
            }
        }
        deployment
    }

    /// Folder of the deployment file, unless it is the working directory.
    fn folder(&self) -> Option<&Path> {
        let (path, _) = self.file.as_ref()?;
        path.parent().filter(|folder| !folder.as_os_str().is_empty())
    }

    pub(super) fn read(
        path: Option<&Path>,
        variables: impl Iterator<Item = (String, String)>,
    ) -> Result<Self, Failure> {
        // By way of the text: a conversion into tables, or from them, would be compiled for every section once more.
        let defaults = toml::to_string(&Deployment::default()).map_err(Failure::failed)?;
        let mut table: Table = toml::from_str(&defaults).map_err(Failure::failed)?;
        let mut file = None;
        if let Some(path) = path {
            if !path.is_file() {
                let missing = format!("{}: no such deployment file", path.display());
                return Err(Failure::not_found(missing));
            }
            let text = files::text(path)?;
            // Parsed on its own first, so that an error carries the line in this file.
            toml::from_str::<Deployment>(&text).map_err(|error| unreadable(path, &error))?;
            let own: Table = toml::from_str(&text).map_err(|error| unreadable(path, &error))?;
            if own.contains_key("robots") {
                table.remove("robots");
            }
            merge(&mut table, own);
            file = Some((path.to_owned(), text));
        }
        let mut environment = BTreeMap::new();
        for (variable, text) in variables {
            // Without a section it is the variable of a flag, such as ZENAV_IDENTITY.
            let Some(name) = variable.strip_prefix(PREFIX).filter(|name| name.contains("__")) else {
                continue;
            };
            let key = name.to_lowercase().replace("__", ".");
            let value = parsed(&key, text);
            let inner = key.split('.').rev().fold(value, |value, part| {
                Value::Table([(part.to_owned(), value)].into_iter().collect())
            });
            if let Value::Table(inner) = inner {
                merge(&mut table, inner);
            }
            environment.insert(key, variable);
        }
        // By way of the text again.
        let text = toml::to_string(&table).map_err(Failure::failed)?;
        let deployment: Deployment = toml::from_str(&text).map_err(|mut error: toml::de::Error| {
            // Nobody wrote this text: the error names the key instead of the line.
            error.set_input(None);
            Failure::usage(format!("{}: {}", listed(environment.values()), told(&error)))
        })?;
        let layers = Self {
            deployment,
            file,
            environment,
        };
        layers.check()?;
        Ok(layers)
    }

    fn check(&self) -> Result<(), Failure> {
        let checked = self.deployment.check();
        checked.map_err(|error: OutOfBounds| Failure::usage(format!("{}: {error}", self.origin(&error.key))))?;
        let misnamed = self
            .deployment
            .robots
            .keys()
            .find(|name| Id::robot(name.as_str()).is_err());
        let robot = misnamed.map_or_else(|| "robots".to_owned(), |name| format!("robots.{name}"));
        self.deployment.robot_ids().map_err(self.at(&robot))?;
        for (name, robots) in &self.deployment.groups {
            let group = self.deployment.group(name, robots);
            let known = group.and_then(|_| self.deployment.has_robots(name, robots));
            known.map_err(self.at(&format!("groups.{name}")))?;
        }
        let holder = Id::new(self.deployment.mission.run.holder.as_str()).map_err(Failure::usage);
        holder.map_err(self.at("mission.holder"))?;
        Ok(())
    }

    /// Checks that the file named by a key exists, and the image that this file names. Only a part that reads the file checks it: not
    /// every host has it.
    ///
    /// # Errors
    /// Exit code 3, with the key, its origin, and the path that was tried.
    pub(crate) fn check_file(&self, key: &str) -> Result<(), Failure> {
        let mut files = self.deployment.files().into_iter();
        let Some((_, Some(file))) = files.find(|(named, _)| *named == key) else {
            return Ok(());
        };
        let images = hosts::images(file).into_iter().map(|image| file.with_file_name(image));
        let mut paths = std::iter::once(file.to_owned()).chain(images);
        let Some(missing) = paths.find(|path| !path.exists()) else {
            return Ok(());
        };
        let path = std::path::absolute(&missing)?;
        Err(Failure::not_found(format!(
            "{}: `{key}` is `{}`: there is no file {}{}",
            self.origin(key),
            file.display(),
            path.display(),
            self.elsewhere(&missing)
        )))
    }

    /// The world named by a flag, otherwise the deployment's.
    ///
    /// # Errors
    /// As [`files::world`], with the origin of the deployment's value.
    pub(crate) fn world(&self, flag: Option<&str>) -> Result<World, Failure> {
        match flag {
            Some(name) => files::world(name),
            None => {
                let name = &self.deployment.simulation.world;
                files::world(name).map_err(self.at_file("simulation.world", name))
            }
        }
    }

    /// Checks that the models of a deployment made from this one exist, and that its settings suit them.
    ///
    /// # Errors
    /// As [`files::robot`], with the origin of the model; exit code 2 for a setting, with its key and origin.
    pub(crate) fn check_models(&self, deployment: &Deployment) -> Result<(), Failure> {
        for (name, robot) in &deployment.robots {
            let key = format!("robots.{name}.model");
            let model = files::robot(&robot.model).map_err(self.at_file(&key, &robot.model))?;
            let suits = robot.edge.check_for(&model, TICK);
            suits.map_err(|error| {
                let error = error.within("edge").within(name).within("robots");
                Failure::usage(format!("{}: {error}", self.origin(&error.key)))
            })?;
        }
        Ok(())
    }

    /// Prefixes a failure with the origin of a key; for `map_err`.
    fn at(&self, key: &str) -> impl FnOnce(Failure) -> Failure + use<> {
        let origin = self.origin(key);
        move |failure| match origin.as_str() {
            DEFAULT => failure,
            origin => Failure::new(failure.code, format!("{origin}: {failure}")),
        }
    }

    /// As [`Self::at`], for a key that names a file.
    fn at_file(&self, key: &str, name: &str) -> impl FnOnce(Failure) -> Failure + use<> {
        let (at, elsewhere) = (self.at(key), self.elsewhere(Path::new(name)));
        move |failure| {
            let told = if failure.code == exit_code::NOT_FOUND {
                format!("{failure}{elsewhere}")
            } else {
                failure.message
            };
            at(Failure::new(failure.code, told))
        }
    }

    /// A hint at the file of this name in the working directory, for a file that is not beside the deployment file; otherwise empty.
    fn elsewhere(&self, missing: &Path) -> String {
        let name = self.folder().and_then(|folder| missing.strip_prefix(folder).ok());
        name.filter(|name| name.is_file()).map_or_else(String::new, |name| {
            let name = name.display();
            format!(" (a path in a deployment file is relative to that file; {name} is in the working directory)")
        })
    }

    /// Origin of a key, or of the section or the file that lacks it.
    pub(crate) fn nearest_origin(&self, key: &str) -> String {
        let sections = std::iter::successors(Some(key), |key| Some(key.rsplit_once('.')?.0));
        let written = sections.map(|key| self.origin(key)).find(|origin| origin != DEFAULT);
        let file = || self.file.as_ref().map(|(path, _)| path.display().to_string());
        written.or_else(file).unwrap_or_else(|| DEFAULT.to_owned())
    }

    /// Origin of a key's value.
    pub(crate) fn origin(&self, key: &str) -> String {
        if let Some(variable) = self.environment.get(key) {
            return format!("environment {variable}");
        }
        let written = |(path, text): &(PathBuf, String)| {
            let line = line_if_written(text, key)?;
            Some(format!("{}:{line}", path.display()))
        };
        self.file
            .as_ref()
            .and_then(written)
            .unwrap_or_else(|| DEFAULT.to_owned())
    }
}

/// Merges a table over another: the values of `over` win.
fn merge(under: &mut Table, over: Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(Value::Table(under)), Value::Table(over)) => merge(under, over),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}

/// A value as written in the environment: TOML as in a file, or bare text for a text setting.
fn parsed(key: &str, text: String) -> Value {
    let is_text = row_of(key).is_some_and(|row| row.default.is_string());
    let quoted = text.starts_with(['"', '\'']);
    if is_text && !quoted {
        return Value::String(text);
    }
    let read = toml::from_str::<Table>(&format!("value = {text}")).ok();
    read.and_then(|mut table| table.remove("value"))
        .unwrap_or(Value::String(text))
}

/// The declaration of a key.
fn row_of(key: &str) -> Option<Row> {
    let within = |section: &str| key.strip_prefix(section).and_then(|rest| rest.split_once('.'));
    let (rows, key) = match (within("robots."), within("hosts.")) {
        (Some((_, key)), _) => (RobotSection::rows(), key),
        (_, Some((_, key))) => (HostSection::rows(), key),
        _ => (Deployment::rows(), key),
    };
    rows.into_iter().find(|row| row.key == key)
}

fn unreadable(path: &Path, error: &toml::de::Error) -> Failure {
    let expected = match files::ending(path).as_str() {
        "yaml" | "yml" => "expected a deployment file in TOML: ",
        _ => "",
    };
    Failure::usage(format!("{}: {expected}{}", path.display(), told(error)))
}

/// The error text; for an unknown key with the most similar known one.
fn told(error: &toml::de::Error) -> String {
    let text = error.to_string();
    let text = text.trim_end();
    let mut names = error.message().split('`').skip(1).step_by(2);
    let perhaps = names
        .next()
        .filter(|_| error.message().starts_with("unknown field"))
        .and_then(|unknown| match unknown {
            "guard" | "collision_monitor" => Some("robots.NAME.edge.collision_monitor"),
            _ => nearest(unknown, names, SLIPS),
        });
    match perhaps {
        Some(known) => format!("{text}\nperhaps `{known}`"),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, variables: &[(&str, &str)]) -> Result<Layers, Failure> {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("mine.toml");
        std::fs::write(&file, text).unwrap();
        let variables = variables
            .iter()
            .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()));
        Layers::read(Some(&file), variables).map(Layers::with_paths)
    }

    /// The failure of a text that cannot be read; its message has all of these parts.
    #[track_caller]
    fn refused(text: &str, variables: &[(&str, &str)], told: &[&str]) -> Failure {
        let failure = read(text, variables).map(|_| ()).unwrap_err();
        assert_eq!(failure.code, exit_code::USAGE);
        for part in told {
            assert!(failure.message.contains(part), "{part}: {failure}");
        }
        failure
    }

    #[test]
    fn without_a_file_it_is_one_robot_on_this_machine() {
        let layers = Layers::read(None, std::iter::empty()).unwrap();
        assert_eq!(layers.deployment, Deployment::default());
        assert_eq!(layers.deployment.robots.len(), 1);
        assert_eq!(layers.deployment.router.listen, vec!["tcp/127.0.0.1:7447"]);
    }

    #[test]
    fn an_unknown_key_is_told_with_its_line_and_the_one_that_was_meant() {
        let told = ["mine.toml", "line 2", "^^^^", "perhaps `resolution`"];
        refused("[mapping]\nresolutoin = 0.1\n", &[], &told);
    }

    #[test]
    fn a_value_of_another_kind_is_told_with_its_line_in_every_section() {
        for (line, told) in [
            (
                "poses = \"gps\"",
                "unknown variant `gps`, expected one of `edge`, `slam`, `localise`",
            ),
            ("enabled = 1", "expected true or false"),
            ("resolution = true", "expected a number"),
        ] {
            let text = format!("[mapping]\nlive = true\n{line}\n");
            refused(&text, &[], &["mine.toml", "line 3", line, told]);
        }
        refused("", &[("ZENAV_MAPPING__POSES", "gps")], &["`mapping.poses`"]);
    }

    #[test]
    fn a_library_s_settings_stand_in_the_section_of_its_service() {
        let text = "[mapping]\nenabled = false\nresolution = 0.1\n[mapping.sensor_model]\nhit = 0.7\n";
        let mapping = read(text, &[]).unwrap().deployment.mapping;
        assert_eq!((mapping.run.enabled, mapping.settings.resolution), (false, 0.1));
        assert_eq!(mapping.settings.sensor_model.hit, 0.7);
        let text = "[planning]\nworkers = 2\n[planning.clearance]\nweight = 1\n[robots.a.edge.collision_monitor]\n";
        let planning = read(text, &[]).unwrap().deployment.planning;
        assert_eq!((planning.run.workers, planning.settings.clearance.weight), (2, 1.0));
        refused("[guard]\n", &[], &["perhaps `robots.NAME.edge.collision_monitor`"]);
        let told = ["mine.toml:2: `mapping.sensor_model.hit` is 0.1"];
        refused("[mapping.sensor_model]\nhit = 0.1\n", &[], &told);
    }

    #[test]
    fn a_value_out_of_bounds_is_told_with_its_line_or_its_variable() {
        let told = "mine.toml:2: `mapping.resolution` is 0.001: expected 0.005 to 10 m";
        let failure = refused("[mapping]\nresolution = 0.001\n", &[], &[told]);
        assert!(failure.message.ends_with(told), "{failure}");
        let told = "mine.toml:2: `robots.a.start.yaw` is 90: expected radians within a full turn";
        refused("[robots.a]\nstart = { x = 1, y = 2, yaw = 90 }\n", &[], &[told]);
        let told = "environment ZENAV_SIMULATION__SPEED: ";
        let failure = refused("", &[("ZENAV_SIMULATION__SPEED", "-1")], &[told]);
        assert!(failure.message.starts_with(told), "{failure}");
        assert!(read("", &[("ZENAV_SIMULATION__SPED", "1")]).is_err());
        assert!(
            read("", &[("ZENAV_IMAGE", "zenav:next")]).is_ok(),
            "no setting of a deployment"
        );
    }

    #[test]
    fn a_file_that_is_not_there_is_told_with_its_line_and_its_path() {
        let layers = read(
            "[zones]\nfile = \"no/wet.toml\"\n[mapping]\nmap = \"/no/map.yaml\"\n",
            &[],
        )
        .unwrap();
        let wet = layers.folder().unwrap().join("no/wet.toml");
        for (key, line, path) in [
            ("zones.file", 2, wet.as_path()),
            ("mapping.map", 4, Path::new("/no/map.yaml")),
        ] {
            let failure = layers.check_file(key).unwrap_err();
            assert_eq!(failure.code, exit_code::NOT_FOUND);
            let at = format!("mine.toml:{line}: `{key}` is `");
            let end = format!("there is no file {}", path.display());
            assert!(
                failure.message.contains(&at) && failure.message.ends_with(&end),
                "{failure}"
            );
        }
    }

    #[test]
    fn the_image_of_a_map_that_is_not_there_is_told_as_its_description_is() {
        let folder = tempfile::tempdir().unwrap();
        let map = folder.path().join("floor.yaml");
        std::fs::write(&map, "image: floor.pgm\n").unwrap();
        let layers = read(&format!("[mapping]\nmap = '{}'\n", map.display()), &[]).unwrap();
        let image = folder.path().join("floor.pgm");
        let failure = layers.check_file("mapping.map").unwrap_err();
        let end = format!("there is no file {}", image.display());
        assert!(
            failure.message.contains("mine.toml:2") && failure.message.ends_with(&end),
            "{failure}"
        );
        std::fs::write(image, "").unwrap();
        layers.check_file("mapping.map").unwrap();
    }

    #[test]
    fn a_file_that_names_robots_means_those_alone_and_needs_no_endpoint_for_them() {
        let layers = read("[robots.neato7]\nmodel = \"neato\"\n", &[]).unwrap();
        assert_eq!(layers.deployment.robots.keys().collect::<Vec<_>>(), vec!["neato7"]);
        assert_eq!(layers.deployment.robots["neato7"].listen, "tcp/127.0.0.1:0");
    }

    #[test]
    fn the_environment_wins_over_the_file_and_both_say_so() {
        let variables = [
            ("ZENAV_MISSION__HOLDER", "7"),
            ("ZENAV_ROBOTS__TIAGO__MODEL", "neato"),
            ("ZENAV_ROUTER__LISTEN", "[\"tcp/[::]:1\"]"),
            ("OTHER", "1"),
        ];
        let layers = read("[mission]\nholder = \"a\"\nplan_valid = 4\n", &variables).unwrap();
        let deployment = &layers.deployment;
        assert_eq!(
            (
                deployment.mission.run.holder.as_str(),
                deployment.mission.settings.plan_valid
            ),
            ("7", 4.0)
        );
        assert_eq!(deployment.robots["tiago"].model, "neato");
        assert_eq!(deployment.robots["tiago"].listen, "tcp/127.0.0.1:7450");
        assert_eq!(deployment.router.listen, ["tcp/[::]:1"]);
        assert_eq!(layers.origin("mission.holder"), "environment ZENAV_MISSION__HOLDER");
        assert!(layers.origin("mission.plan_valid").ends_with("mine.toml:3"));
        assert_eq!(layers.origin("mission.enabled"), "default");
    }

    #[test]
    fn a_name_that_nobody_may_have_is_told_with_its_line() {
        for (text, told) in [
            ("[robots.a]\n[robots.\"b/c\"]\n", "mine.toml:2: [robots.b/c]"),
            (
                "[mission]\nholder = \"a b\"\n",
                "mine.toml:2: `a b` is not a valid name",
            ),
            (
                "[groups]\na = [\"tiago\"]\nall = [\"x\"]\n",
                "mine.toml:3: [groups] all: no robot `x`",
            ),
        ] {
            refused(text, &[], &[told]);
        }
    }

    #[test]
    fn what_no_router_endpoint_or_planner_can_be_is_told_with_its_line() {
        for (text, told) in [
            (
                "[planning]\nplanner = \"SmacPlanner2D\"\n",
                "`planning.planner` is `SmacPlanner2D`: expected one of astar, jps, ",
            ),
            (
                "[robots.tiago]\nlisten = \"7450\"\n",
                "`robots.tiago.listen` is `7450`: expected an endpoint",
            ),
            (
                "[router]\nlisten = [\"7447\"]\n",
                "`router.listen` is `7447`: expected an endpoint",
            ),
            (
                "[router]\nconnect = [\"site\"]\n",
                "`router.connect` is `site`: expected an endpoint",
            ),
            (
                "[gateway]\nlisten = \"7480\"\n",
                "`gateway.listen` is `7480`: expected ADDRESS:PORT",
            ),
            (
                "[router]\nrest = \"8000\"\n",
                "`router.rest` is `8000`: expected ADDRESS:PORT",
            ),
            (
                "[router]\nscouting = true\nenabled = false\n",
                "`router.scouting` is set, and `router.enabled` is false: expected a router",
            ),
        ] {
            refused(text, &[], &[&format!("mine.toml:2: {told}")]);
        }
    }

    #[test]
    fn a_setting_that_does_not_suit_the_robot_is_told_with_its_line() {
        let text = "[robots.a]\nmodel = \"tiago\"\n[robots.a.edge.collision_monitor]\nrest_after_silence = 0.3\n";
        let layers = read(text, &[]).unwrap();
        let failure = layers.check_models(&layers.deployment).unwrap_err();
        let told = "mine.toml:4: `robots.a.edge.collision_monitor.rest_after_silence` is 0.3: expected at least 0.43 s";
        assert_eq!(failure.code, exit_code::USAGE);
        assert!(failure.message.contains(told), "{failure}");
    }

    #[test]
    fn a_path_in_the_file_means_a_file_beside_it_and_one_in_the_environment_the_working_directory() {
        let text = "[simulation]\nworld = \"room.toml\"\n[robots.a]\nmodel = \"mine.toml+rear_lidar+worn.toml\"\n[robots.b]\n\
                    model = \"tiago\"\n[mapping]\nmap = \"maps/floor.yaml\"\n[zones]\nfile = \"/site/wet.toml\"\n";
        let layers = read(text, &[]).unwrap();
        let (deployment, folder) = (&layers.deployment, layers.folder().unwrap());
        let beside = |name: &str| folder.join(name).display().to_string();
        assert_eq!(deployment.simulation.world, beside("room.toml"));
        let model = format!("{}+rear_lidar+{}", beside("mine.toml"), beside("worn.toml"));
        assert_eq!(deployment.robots["a"].model, model);
        assert_eq!(deployment.robots["b"].model, "tiago");
        assert_eq!(
            deployment.files(),
            [
                ("mapping.map", Some(folder.join("maps/floor.yaml").as_path())),
                ("zones.file", Some(Path::new("/site/wet.toml"))),
            ]
        );
        assert_eq!(read("", &[]).unwrap().deployment.simulation.world, "kitchen");
        let variables = [
            ("ZENAV_SIMULATION__WORLD", "room.toml"),
            ("ZENAV_ROBOTS__A__MODEL", "mine.toml"),
            ("ZENAV_MAPPING__MAP", "maps/floor.yaml"),
        ];
        let deployment = read(text, &variables).unwrap().deployment;
        assert_eq!(deployment.simulation.world, "room.toml");
        assert_eq!(deployment.robots["a"].model, "mine.toml");
        assert_eq!(
            deployment.mapping.run.map.as_deref(),
            Some(Path::new("maps/floor.yaml"))
        );
    }

    #[test]
    fn a_file_in_the_working_directory_is_pointed_out_when_it_is_not_beside_the_deployment_file() {
        let hint = "is relative to that file; Cargo.toml is in the working directory)";
        let told = |name: &str| {
            let text = format!("[simulation]\nworld = \"{name}\"\n[zones]\nfile = \"{name}\"\n");
            let layers = read(&text, &[]).unwrap();
            let world = layers.world(None).map(|_| ()).unwrap_err();
            [world, layers.check_file("zones.file").unwrap_err()]
        };
        for failure in told("Cargo.toml") {
            assert_eq!(failure.code, exit_code::NOT_FOUND);
            assert!(failure.message.ends_with(hint), "{failure}");
        }
        for failure in told("no_such.toml") {
            assert!(!failure.message.contains("working directory"), "{failure}");
        }
    }

    #[test]
    fn parameters_of_another_stack_are_told_that_a_deployment_is_toml() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("nav2_params.yaml");
        std::fs::write(&file, "amcl:\n  ros__parameters:\n    alpha1: 0.2\n").unwrap();
        let failure = Layers::read(Some(&file), std::iter::empty()).map(|_| ()).unwrap_err();
        assert_eq!(failure.code, exit_code::USAGE);
        let told = "nav2_params.yaml: expected a deployment file in TOML: ";
        assert!(failure.message.contains(told), "{failure}");
    }

    #[test]
    fn a_model_and_a_world_that_nobody_knows_are_told_with_their_line() {
        let layers = read(
            "[robots.a]\nmodel = \"tiagoo\"\n[simulation]\nworld = \"nowhere\"\n",
            &[],
        )
        .unwrap();
        let model = layers.check_models(&layers.deployment).unwrap_err();
        let world = layers.world(None).map(|_| ()).unwrap_err();
        for (failure, told) in [(model, "mine.toml:2: no robot"), (world, "mine.toml:4: no world")] {
            assert_eq!(failure.code, exit_code::NOT_FOUND);
            assert!(failure.message.contains(told), "{failure}");
        }
        assert!(layers.nearest_origin("robots.a.listen").ends_with("mine.toml:1"));
        assert!(layers.nearest_origin("hosts").ends_with("mine.toml"));
        let layers = read("[hosts.a]\n[hosts.\"fleet.b\"]\nrole = \"cloud\"\n", &[]).unwrap();
        assert!(layers.nearest_origin("hosts.fleet.b.role").ends_with("mine.toml:3"));
        assert!(layers.nearest_origin("hosts.fleet.b.address").ends_with("mine.toml:2"));
    }
}
