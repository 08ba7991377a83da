//! `zenav deploy render`, `check` and `health`: arguments, files and the bus around the pure parts.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, Subcommand};
use serde::Serialize;
use zenav_protocol::bus::Bus;
use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::messages::{InfoReply, InfoRequest};
use zenav_protocol::topics::{self, Ask};

use super::files::{self, Files, Target};
use super::layout::{Layout, ROUTER_PORT};
use super::running::{self, Finding, Seen, State};
use super::{health, named_files, readme};
use crate::config::{Layers, Profile};
use crate::connect::{self, LinkArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::inspect::check_admitted;
use crate::keys;
use crate::output::{self, Format};

/// Name of the deployment file on every host.
const DEPLOYMENT: &str = "deployment.toml";
/// List of rendered files: the next rendering deletes those that no longer belong to it.
const LIST: &str = "rendered.txt";
/// Largest contents of a ConfigMap, bytes; its metadata needs the rest.
const MOST_IN_CONFIG_MAP: u64 = 1_000_000;
/// Time limit of one query for liveliness tokens.
const GLANCE: Duration = Duration::from_millis(1500);

/// Arguments of `zenav deploy`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav deploy check site.toml\n  zenav deploy render site.toml --out rendered --target systemd"
)]
pub struct DeployArgs {
    #[command(subcommand)]
    command: DeployCommand,
}

#[derive(Debug, Subcommand)]
enum DeployCommand {
    /// Write units, compose files and manifests for the hosts of a deployment
    #[command(after_help = "Example:\n  zenav deploy render fleet.toml --out rendered --target systemd")]
    Render {
        /// Deployment file with [hosts.NAME] sections
        #[arg(value_name = "DEPLOYMENT.toml")]
        file: PathBuf,
        /// Folder to write into: a new one, or one written by an earlier rendering
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// What to render for
        #[arg(long, value_enum, default_value_t = Target::All)]
        target: Target,
    },
    /// Check the hosts of a deployment, and with --against-bus which of its parts run
    Check {
        /// Deployment file with [hosts.NAME] sections
        #[arg(value_name = "DEPLOYMENT.toml")]
        file: PathBuf,
        /// Compare it with the running parts, seen from its own routers, or from --connect
        #[arg(long)]
        against_bus: bool,
        /// Folder of the certificate authority, where the parts' keys are checked
        #[arg(long, value_name = "DIR", default_value = "fleet-keys")]
        keys: PathBuf,
        /// Folder that `zenav deploy render` has written: its files must be those that the deployment renders now
        #[arg(long, value_name = "DIR", conflicts_with = "against_bus")]
        rendered: Option<PathBuf>,
        #[command(flatten)]
        link: LinkArgs,
        /// Output format
        #[arg(short, long, value_enum, default_value_t)]
        output: Format,
    },
    /// Ask a part on this machine whether it is ready, for container health checks: exits with 0 if it is ready, 1 if not, 4 if nothing
    /// listens there, 5 without an answer within 2 s
    Health {
        /// Address at which the part serves its health
        #[arg(value_name = "ADDRESS:PORT", default_value = "127.0.0.1:9464", value_parser = socket)]
        address: SocketAddr,
    },
}

fn socket(text: &str) -> Result<SocketAddr, String> {
    let expected = || "expected ADDRESS:PORT, such as 127.0.0.1:9464".to_owned();
    text.parse().map_err(|_| expected())
}

/// `zenav deploy`.
///
/// # Errors
/// Bad files, each problem with its line; a missing part; a part that is not ready.
pub fn deploy(args: &DeployArgs) -> Outcome {
    match &args.command {
        DeployCommand::Render { file, out, target } => render(file, out, *target),
        DeployCommand::Check {
            file,
            against_bus,
            keys,
            rendered,
            link,
            output,
        } => {
            let layers = Layers::load_as_written(Some(file))
                .map_err(|error| refused(&[Problem::said(&error)], *output, error.code))?;
            let (layout, _) = laid_out(&layers, file, *output)?;
            if *against_bus {
                return compare(&layout, link, *output);
            }
            let mut problems = key_problems(&layout, keys);
            if let Some(out) = rendered {
                problems.extend(outdated(file, out)?);
            }
            report(&problems, &layout, *output)
        }
        DeployCommand::Health { address } => {
            output::line(&health::ready(*address)?);
            Ok(exit_code::OK)
        }
    }
}

/// A problem with a deployment.
#[derive(Serialize)]
struct Problem {
    /// Where it is in the file, or the section that lacks it.
    #[serde(skip_serializing_if = "Option::is_none")]
    at: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    key: Option<String>,
    problem: String,
}

impl Problem {
    fn of(layers: &Layers, error: &OutOfBounds) -> Self {
        Self {
            at: Some(layers.nearest_origin(&error.key)),
            key: Some(error.key.clone()),
            problem: error.problem.clone(),
        }
    }

    /// A problem without a key.
    fn said(problem: impl Display) -> Self {
        Self {
            at: None,
            key: None,
            problem: problem.to_string(),
        }
    }
}

impl Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(at) = &self.at {
            write!(f, "{at}: ")?;
        }
        if let Some(key) = &self.key {
            write!(f, "`{key}` ")?;
        }
        f.write_str(&self.problem)
    }
}

/// All problems, one per line; with JSON output also on stdout, for programs.
fn refused(problems: &[Problem], format: Format, code: u8) -> Failure {
    let lines: Vec<String> = problems.iter().map(Problem::to_string).collect();
    let printed = match format {
        Format::Table => Ok(exit_code::OK),
        format => output::values(format, problems, |_| String::new()),
    };
    printed.err().unwrap_or_else(|| Failure::new(code, lines.join("\n")))
}

/// The deployment's layout on its hosts, and the files that it names.
///
/// # Errors
/// All problems of the file, each with its line.
fn laid_out<'l>(layers: &'l Layers, file: &Path, format: Format) -> Result<(Layout<'l>, Vec<String>), Failure> {
    let told = |errors: Vec<OutOfBounds>| {
        let problems: Vec<Problem> = errors.iter().map(|error| Problem::of(layers, error)).collect();
        refused(&problems, format, exit_code::USAGE)
    };
    let layout = Layout::of(&layers.deployment).map_err(told)?;
    let named = named_files::of(&layers.deployment, &folder_of(file)).map_err(told)?;
    Ok((layout, named))
}

fn folder_of(file: &Path) -> PathBuf {
    file.parent().unwrap_or_else(|| Path::new("")).to_owned()
}

fn render(file: &Path, out: &Path, target: Target) -> Outcome {
    // The rendered files depend on the file alone: the parts read it again, without this shell's variables.
    let layers = Layers::load_file(file)?;
    let (layout, named) = laid_out(&layers, file, Format::Table)?;
    let config = [vec![DEPLOYMENT.to_owned()], named.clone()].concat();
    let (texts, folders) = texts(&layout, &config, target)?;
    if texts.keys().any(|path| path.starts_with("kubernetes")) {
        fit_a_config_map(&folder_of(file), file, &named)?;
    }
    let before = rendered_before(out)?;
    let mut paths = BTreeSet::new();
    for (path, text) in &texts {
        let to = out.join(path);
        if let Some(folder) = to.parent() {
            std::fs::create_dir_all(folder).map_err(Failure::failed_at(folder))?;
        }
        crate::files::write(&to, text)?;
        paths.insert(path.clone());
    }
    for folder in folders {
        named_files::copy(file, &named, &out.join(folder))?;
        paths.extend(config.iter().map(|name| format!("{folder}/{name}")));
    }
    for stale in before.difference(&paths) {
        let path = out.join(stale);
        std::fs::remove_file(&path).map_err(Failure::failed_at(&path))?;
    }
    let list: String = paths.iter().map(|path| format!("{path}\n")).collect();
    crate::files::write(&out.join(LIST), list)?;
    output::line(&format!(
        "{}: {}; README.md says what to do with them",
        out.display(),
        output::counted(paths.len(), "file")
    ));
    Ok(exit_code::OK)
}

/// The rendered texts, and the folders into which the deployment file and those that it names (`config`) are copied.
fn texts(layout: &Layout<'_>, config: &[String], target: Target) -> Result<(Files, Vec<&'static str>), Failure> {
    let texts = files::render(layout, config, target).map_err(Failure::failed)?;
    let is_needed = |folder: &&str| *folder == "etc" || texts.keys().any(|path| path.starts_with(*folder));
    let folders = ["etc", "kubernetes"].into_iter().filter(is_needed).collect();
    Ok((texts, folders))
}

/// What is wrong with files that an earlier rendering of a deployment wrote into a folder: they are missing, were edited, or are of another
/// version of the deployment.
fn outdated(file: &Path, out: &Path) -> Result<Vec<Problem>, Failure> {
    let list = std::fs::read_to_string(out.join(LIST)).map_err(|_| {
        Failure::usage(format!(
            "--rendered {}: expected a folder that `zenav deploy render` has written",
            out.display()
        ))
    })?;
    let written: BTreeSet<&str> = list.lines().collect();
    let layers = Layers::load_file(file)?;
    let (layout, named) = laid_out(&layers, file, Format::Table)?;
    let config = [vec![DEPLOYMENT.to_owned()], named].concat();
    let (texts, folders) = texts(&layout, &config, Target::of(&written))?;
    let mut expected: BTreeMap<String, Vec<u8>> = texts
        .into_iter()
        .map(|(path, text)| (path, text.into_bytes()))
        .collect();
    for name in &config {
        let source = match name.as_str() {
            DEPLOYMENT => file.to_owned(),
            name => folder_of(file).join(name),
        };
        let bytes = std::fs::read(&source).map_err(Failure::failed_at(&source))?;
        expected.extend(folders.iter().map(|folder| (format!("{folder}/{name}"), bytes.clone())));
    }
    let mut problems = Vec::new();
    for (path, bytes) in &expected {
        let why = match std::fs::read(out.join(path)) {
            Ok(found) if found == *bytes => continue,
            Ok(_) => "is not what the deployment renders",
            Err(_) => "is missing",
        };
        problems.push(Problem::said(format_args!("{} {why}", out.join(path).display())));
    }
    let stale = written.iter().filter(|path| !expected.contains_key(**path));
    problems.extend(stale.map(|path| {
        let path = out.join(path);
        Problem::said(format_args!("{} is no file of the deployment any more", path.display()))
    }));
    Ok(problems)
}

/// Checks that the files fit into a Kubernetes ConfigMap: at most 1 MiB, under keys of letters, digits, `-`, `_` and `.`.
///
/// # Errors
/// The invalid name, or the total size.
fn fit_a_config_map(folder: &Path, deployment: &Path, names: &[String]) -> Result<(), Failure> {
    let instead =
        "for a larger map, render with `--target systemd` or `compose`, or serve it from a host outside the cluster";
    let allowed = |name: &str| {
        name.bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte))
    };
    if let Some(name) = names.iter().find(|name| !allowed(name)) {
        return Err(Failure::usage(format!(
            "`{name}`: Kubernetes takes letters, digits, `-`, `_` and `.` in the name of a file: expected another name"
        )));
    }
    let mut bytes = 0;
    for path in names
        .iter()
        .map(|name| folder.join(name))
        .chain([deployment.to_owned()])
    {
        bytes += std::fs::metadata(&path).map_err(Failure::failed_at(&path))?.len();
    }
    if bytes > MOST_IN_CONFIG_MAP {
        return Err(Failure::usage(format!(
            "{}: it and the files that it names have {bytes} bytes, and Kubernetes takes {MOST_IN_CONFIG_MAP} in a ConfigMap: {instead}",
            deployment.display()
        )));
    }
    Ok(())
}

/// Files that an earlier rendering wrote into a folder; none for a new one.
fn rendered_before(out: &Path) -> Result<BTreeSet<String>, Failure> {
    let is_new = match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_none(),
        Err(_) => !out.exists(),
    };
    if is_new {
        std::fs::create_dir_all(out).map_err(Failure::failed_at(out))?;
        return Ok(BTreeSet::new());
    }
    let list = std::fs::read_to_string(out.join(LIST)).map_err(|_| {
        Failure::usage(format!(
            "--out {}: expected a new folder, or one that `zenav deploy render` has written",
            out.display()
        ))
    })?;
    let within = |path: &&str| {
        Path::new(path)
            .components()
            .all(|part| matches!(part, std::path::Component::Normal(_)))
    };
    let paths = list.lines().filter(within).map(str::to_owned);
    Ok(paths.filter(|path| out.join(path).is_file()).collect())
}

/// Identities that were not issued, or are not usable.
fn key_problems(layout: &Layout<'_>, folder: &Path) -> Vec<Problem> {
    if layout.profile == Profile::Open {
        return Vec::new();
    }
    if !folder.join("ca.pem").is_file() {
        let folder = folder.display();
        return vec![Problem::said(format_args!(
            "no fleet in {folder}: `zenav keys init --dir {folder}` begins one (--keys names another folder)"
        ))];
    }
    let has_all = |identity: &String| {
        let issued = folder.join("issued").join(identity);
        ["ca.pem", "cert.pem", "key.pem"]
            .iter()
            .all(|file| issued.join(file).is_file())
    };
    let problem = |(identity, names): (String, Vec<String>)| {
        if has_all(&identity) {
            // Dialling by name happens only between containers of one network, so only addresses are checked.
            let is_address = |name: &String| layout.hosts.iter().any(|host| host.address == *name);
            let addresses: Vec<String> = names.into_iter().filter(is_address).collect();
            let why = keys::unusable(folder, &identity, &addresses)?;
            return Some(Problem::said(format_args!("identity {identity}: {why}")));
        }
        let hosts: String = names.iter().map(|name| format!(" --host {name}")).collect();
        Some(Problem::said(format_args!(
            "no identity {identity}: `zenav keys issue {identity} --dir {}{hosts}` makes it",
            folder.display()
        )))
    };
    readme::identities(layout).into_iter().filter_map(problem).collect()
}

fn report(problems: &[Problem], layout: &Layout<'_>, format: Format) -> Outcome {
    if !problems.is_empty() {
        return Err(refused(problems, format, exit_code::FAILED));
    }
    output::values(format, problems, |_| {
        format!(
            "{}, {}: nothing is wrong",
            output::counted(layout.hosts.len(), "host"),
            output::counted(layout.parts().count(), "part")
        )
    })
}

fn compare(layout: &Layout<'_>, link: &LinkArgs, format: Format) -> Outcome {
    let findings = connect::block_on(async {
        let seen = look(layout, link).await?;
        Ok(running::compare(layout, &seen))
    })?;
    output::values(format, &findings, |rows| {
        let row = |row: &Finding| {
            let state = match row.state {
                State::Runs => "runs",
                State::Missing => "MISSING",
                State::CutOff => "CUT OFF",
                State::Unnamed => "not in the file",
            };
            vec![row.host.clone(), row.part.clone(), state.to_owned(), row.detail.clone()]
        };
        output::table(&["HOST", "PART", "STATE", ""], rows.iter().map(row))
    })?;
    let is_well = findings.iter().all(|finding| finding.state == State::Runs);
    Ok(if is_well { exit_code::OK } else { exit_code::FAILED })
}

/// The given endpoints, or those of the deployment's own routers, each with its host.
fn viewpoints(layout: &Layout<'_>, given: &[String]) -> Vec<(Option<String>, Vec<String>)> {
    if !given.is_empty() {
        return vec![(None, given.to_owned())];
    }
    let routers = layout.hosts.iter().filter(|host| host.runs("router"));
    let endpoint = |address: &str| vec![format!("{}/{address}:{ROUTER_PORT}", layout.protocol())];
    routers
        .map(|host| (Some(host.name.clone()), endpoint(&host.address)))
        .collect()
}

/// Observes the bus from the deployment's own routers, or from the given endpoints.
async fn look(layout: &Layout<'_>, link: &LinkArgs) -> Result<Seen, Failure> {
    let mut seen = Seen::default();
    let mut bus: Option<Bus> = None;
    let mut refusal = None;
    let mut is_admitted = false;
    for (host, endpoint) in viewpoints(layout, &link.connect) {
        let link = LinkArgs {
            connect: endpoint,
            namespace: match link.namespace.is_empty() {
                true => layout.deployment.bus.namespace.clone(),
                false => link.namespace.clone(),
            },
            ..link.clone()
        };
        match connect::open(&link).await {
            Ok(opened) => {
                let parts = answering(&opened, &topics::PART_INFO).await?;
                is_admitted |= !parts.is_empty();
                let sees = parts.iter().filter(|part| part.component == "router").count();
                // Given endpoints stand for all routers.
                let named: Vec<(String, usize)> = match host {
                    Some(host) => vec![(host, sees)],
                    None => layout
                        .hosts
                        .iter()
                        .filter(|host| host.runs("router"))
                        .map(|host| (host.name.clone(), 0))
                        .collect(),
                };
                seen.routers.extend(named);
                if bus.is_none() {
                    bus = Some(opened);
                } else {
                    opened.close().await;
                }
            }
            Err(failure) => refusal = Some(failure),
        }
    }
    let Some(bus) = bus else {
        return Err(refusal.unwrap_or_else(|| Failure::failed("no router to look at")));
    };
    let looked = match check_admitted(link, is_admitted) {
        Ok(()) => fill(&mut seen, &bus).await,
        denied => denied,
    };
    bus.close().await;
    looked.map(|()| seen)
}

async fn fill(seen: &mut Seen, bus: &Bus) -> Result<(), Failure> {
    seen.robots = connect::robots(bus).await?;
    seen.workers = connect::alive(bus, topics::ALIVE_WORKER, GLANCE).await?;
    let parts = answering(bus, &topics::PART_INFO).await?;
    seen.gateways = parts.iter().filter(|part| part.component == "gateway").count();
    for mapper in parts.into_iter().filter(|part| part.component == "mapping") {
        *seen.mappers.entry(mapper.robot).or_default() += 1;
    }
    // One whose disk is full answers, too, and can neither lead nor stand by.
    let missions = answering(bus, &topics::CLOUD_INFO).await?;
    for mission in missions.into_iter().filter(|mission| mission.not_stored.is_none()) {
        *seen.orchestrators.entry(mission.robot).or_default() += 1;
    }
    Ok(())
}

/// The parts that answer, each once.
async fn answering(bus: &Bus, ask: &Ask<InfoRequest, InfoReply>) -> Result<Vec<InfoReply>, Failure> {
    let answers = bus.ask_all(ask, &["*"], &InfoRequest {}, GLANCE).await?;
    let mut parts: Vec<InfoReply> = Vec::new();
    for part in answers.into_iter().filter_map(|answer| answer.result.ok()) {
        let of = |part: &InfoReply| {
            let process = part.process.clone().unwrap_or_default();
            let robot = part.robot.clone();
            (robot, process.part, process.host, process.pid, process.instance)
        };
        // A robot's own endpoint may report an answer twice.
        if !parts.iter().any(|known| of(known) == of(&part)) {
            parts.push(part);
        }
    }
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use zenav_protocol::bus::{BusConfig, Router, RouterConfig};

    use super::*;
    use crate::config::Deployment;
    use crate::connect::DEFAULT_ENDPOINT;

    #[test]
    fn a_given_endpoint_is_looked_from_even_if_it_is_the_default_one() {
        let fleet: Deployment = toml::from_str(include_str!("tests/fleet.toml")).unwrap();
        let layout = Layout::of(&fleet).unwrap();
        let hosts: Vec<_> = viewpoints(&layout, &[]).into_iter().map(|(host, _)| host).collect();
        assert_eq!(hosts, ["fleet-a", "fleet-b", "site"].map(|name| Some(name.to_owned())));
        let given = vec![DEFAULT_ENDPOINT.to_owned()];
        assert_eq!(viewpoints(&layout, &given), [(None, given.clone())]);
    }

    #[test]
    fn a_rendering_that_was_edited_or_is_of_an_older_file_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let (file, out) = (folder.path().join("fleet.toml"), folder.path().join("out"));
        std::fs::write(&file, include_str!("tests/fleet.toml")).unwrap();
        assert!(outdated(&file, &out).is_err(), "nothing is rendered yet");
        let told = || -> Vec<String> {
            let problems = outdated(&file, &out).unwrap();
            problems.iter().map(Problem::to_string).collect()
        };
        for target in [Target::Systemd, Target::Zenoh, Target::All] {
            render(&file, &out, target).unwrap();
            assert_eq!(told(), Vec::<String>::new(), "{target:?}");
        }
        let unit = out.join("hosts/robot-a/systemd/zenav-edge-anna.service");
        std::fs::write(unit, "[Unit]\n").unwrap();
        std::fs::remove_file(out.join("compose.yaml")).unwrap();
        let found = told();
        assert!(
            found.len() == 2 && found[0].ends_with("compose.yaml is missing") && found[1].contains("is not what"),
            "{found:#?}"
        );
        render(&file, &out, Target::All).unwrap();
        let moved = include_str!("tests/fleet.toml").replace("[hosts.robot-a]", "[hosts.robot-z]");
        std::fs::write(&file, moved).unwrap();
        let found = told();
        for what in [
            "etc/deployment.toml is not what",
            "hosts/robot-z/compose.yaml is missing",
            "hosts/robot-a/compose.yaml is no file of",
        ] {
            assert!(found.iter().any(|told| told.contains(what)), "{what}: {found:#?}");
        }
    }

    #[test]
    fn a_key_that_is_missing_is_told_with_the_command_that_makes_it_as_it_is_dialled() {
        let fleet: Deployment = toml::from_str(include_str!("tests/fleet.toml")).unwrap();
        let layout = Layout::of(&fleet).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let told = |folder: &Path| -> Vec<String> {
            let problems = key_problems(&layout, folder);
            problems.iter().map(Problem::to_string).collect()
        };
        let none = told(folder.path());
        assert!(
            none.len() == 1 && none[0].contains("`zenav keys init --dir "),
            "{none:#?}"
        );
        keys::make(&folder.path().join("fleet"), "service.fleet-a").unwrap();
        let others = told(&folder.path().join("fleet"));
        let router = others
            .iter()
            .find(|told| told.starts_with("no identity router.fleet-a:"));
        assert!(
            router.is_some_and(|told| told.contains(" --host fleet-a.example.org")),
            "{others:#?}"
        );
        assert!(
            !others.iter().any(|told| told.contains("service.fleet-a:")),
            "{others:#?}"
        );
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_gateway_is_seen_on_the_bus_as_long_as_it_answers() {
        let free = RouterConfig {
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            ..RouterConfig::default()
        };
        let router = Router::open(&free).await.unwrap();
        let open = async |name: &str| {
            let config = BusConfig::service(name, &router.endpoints().await[0]);
            Bus::open(config).await.unwrap()
        };
        let (gateway, operator) = (open("gateway").await, open("operator").await);
        let seen = async |count| {
            let gateways = |parts: Vec<InfoReply>| parts.iter().filter(|part| part.component == "gateway").count();
            let look = async { while gateways(answering(&operator, &topics::PART_INFO).await.unwrap()) != count {} };
            tokio::time::timeout(Duration::from_secs(60), look).await.unwrap();
        };
        seen(0).await;
        gateway.serve_info("gateway", "", BTreeMap::new()).unwrap();
        seen(1).await;
        gateway.close().await;
        seen(0).await;
    }
}
