//! `zenav deploy render`, `check` and `health`: arguments, files and the bus around the pure parts.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, Subcommand};
use zenav_protocol::bus::Bus;
use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::topics;

use super::files::{self, Target};
use super::layout::{Layout, ROUTER_PORT};
use super::running::{self, Finding, Seen, State};
use super::{health, named_files, readme};
use crate::config::{Layers, Profile};
use crate::connect::{self, DEFAULT_ENDPOINT, LinkArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Which files were rendered, so that the next time those go that are no longer part of it.
const LIST: &str = "rendered.txt";
/// How long one look at what is announced may take.
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
        /// Deployment file with its [hosts.NAME]
        #[arg(value_name = "DEPLOYMENT.toml")]
        file: PathBuf,
        /// Folder to write into: a new one, or one that was rendered before
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// What to write for
        #[arg(long, value_enum, default_value_t = Target::All)]
        target: Target,
    },
    /// Check the hosts of a deployment, and with --against-bus what of it runs
    Check {
        /// Deployment file with its [hosts.NAME]
        #[arg(value_name = "DEPLOYMENT.toml")]
        file: PathBuf,
        /// Compare it with what runs: at its own routers, or where --connect says
        #[arg(long)]
        against_bus: bool,
        /// Folder of the certificate authority, where the parts' keys are looked for
        #[arg(long, value_name = "DIR", default_value = "fleet-keys")]
        keys: PathBuf,
        #[command(flatten)]
        link: LinkArgs,
        /// Output format
        #[arg(short, long, value_enum, default_value_t)]
        output: Format,
    },
    /// Ask a part of this machine whether it is ready, for the health checks of containers: exits with 0 when it is, 1 when it is not, 4
    /// when nobody listens there, 5 when nobody answers within 2 s
    Health {
        /// Where the part serves its health
        #[arg(value_name = "ADDRESS:PORT", default_value = "127.0.0.1:9464")]
        address: SocketAddr,
    },
}

/// `zenav deploy`.
///
/// # Errors
/// Bad files, each problem with its line; a part that is missing; a part that is not ready.
pub fn deploy(args: &DeployArgs) -> Outcome {
    match &args.command {
        DeployCommand::Render { file, out, target } => render(file, out, *target),
        DeployCommand::Check {
            file,
            against_bus,
            keys,
            link,
            output,
        } => {
            let layers = Layers::load(Some(file))?;
            let layout = laid_out(&layers, file)?;
            let missing = without_keys(&layout, keys);
            if !*against_bus {
                return report_keys(&missing, &layout, keys);
            }
            compare(&layout, link, *output)
        }
        DeployCommand::Health { address } => {
            output::line(&health::ready(*address)?);
            Ok(exit_code::OK)
        }
    }
}

/// All problems of a file, one a line, each with the line that it is on.
fn told(layers: &Layers, problems: &[OutOfBounds]) -> Failure {
    let lines: Vec<String> = problems
        .iter()
        .map(|problem| format!("{}: {problem}", layers.origin(&problem.key)))
        .collect();
    Failure::usage(lines.join("\n"))
}

fn laid_out<'l>(layers: &'l Layers, file: &Path) -> Result<Layout<'l>, Failure> {
    let layout = Layout::of(&layers.deployment).map_err(|problems| told(layers, &problems))?;
    named_files::of(&layers.deployment, &folder_of(file)).map_err(|problems| told(layers, &problems))?;
    Ok(layout)
}

fn folder_of(file: &Path) -> PathBuf {
    file.parent().unwrap_or_else(|| Path::new("")).to_owned()
}

fn render(file: &Path, out: &Path, target: Target) -> Outcome {
    let layers = Layers::load(Some(file))?;
    let layout = laid_out(&layers, file)?;
    let named = named_files::of(&layers.deployment, &folder_of(file)).map_err(|problems| told(&layers, &problems))?;
    let config = [vec!["deployment.toml".to_owned()], named.clone()].concat();
    let texts = files::render(&layout, &config, target).map_err(Failure::failed)?;
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
    let folders = ["etc", "kubernetes"];
    for folder in folders
        .into_iter()
        .filter(|folder| *folder == "etc" || texts.keys().any(|path| path.starts_with(folder)))
    {
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

/// The files that were rendered into a folder before; none for a new one.
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

/// Identities that nobody has issued: their common names.
fn without_keys(layout: &Layout<'_>, keys: &Path) -> Vec<String> {
    if layout.profile == Profile::Open {
        return Vec::new();
    }
    let has_all = |identity: &String| {
        let folder = keys.join("issued").join(identity);
        ["ca.pem", "cert.pem", "key.pem"]
            .iter()
            .all(|file| folder.join(file).is_file())
    };
    readme::identities(layout)
        .into_keys()
        .filter(|identity| !has_all(identity))
        .collect()
}

fn report_keys(missing: &[String], layout: &Layout<'_>, keys: &Path) -> Outcome {
    if !missing.is_empty() {
        let commands: Vec<String> = missing
            .iter()
            .map(|identity| {
                format!(
                    "no identity {identity}: `zenav keys issue {identity} --dir {}` makes it",
                    keys.display()
                )
            })
            .collect();
        return Err(Failure::failed(commands.join("\n")));
    }
    output::line(&format!(
        "{}, {}: nothing is wrong",
        output::counted(layout.hosts.len(), "host"),
        output::counted(layout.parts().count(), "part")
    ));
    Ok(exit_code::OK)
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
                State::Unnamed => "not in the file",
                State::NotAnnounced => "not announced",
            };
            vec![row.host.clone(), row.part.clone(), state.to_owned(), row.detail.clone()]
        };
        output::table(
            &["HOST", "PART", "STATE", ""],
            &rows.iter().map(row).collect::<Vec<_>>(),
        )
    })?;
    let is_well = findings
        .iter()
        .all(|finding| matches!(finding.state, State::Runs | State::NotAnnounced));
    Ok(if is_well { exit_code::OK } else { exit_code::FAILED })
}

/// What is seen from the deployment's own routers, or from the endpoints that were named.
async fn look(layout: &Layout<'_>, link: &LinkArgs) -> Result<Seen, Failure> {
    let mut seen = Seen::default();
    let mut bus: Option<Bus> = None;
    let is_named = link.connect != [DEFAULT_ENDPOINT];
    let endpoints: Vec<(Option<String>, Vec<String>)> = if is_named {
        vec![(None, link.connect.clone())]
    } else {
        let routers = layout.hosts.iter().filter(|host| host.runs("router"));
        let endpoint = |address: &str| vec![format!("{}/{address}:{ROUTER_PORT}", layout.protocol())];
        routers
            .map(|host| (Some(host.name.clone()), endpoint(&host.address)))
            .collect()
    };
    let mut refusal = None;
    for (host, endpoint) in endpoints {
        let link = LinkArgs {
            connect: endpoint,
            ..link.clone()
        };
        match connect::open(&link).await {
            Ok(opened) => {
                // Where one endpoint was named it stands for all routers.
                let named: Vec<String> = match host {
                    Some(host) => vec![host],
                    None => layout
                        .hosts
                        .iter()
                        .filter(|host| host.runs("router"))
                        .map(|host| host.name.clone())
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
    let looked = fill(&mut seen, &bus).await;
    bus.close().await;
    looked.map(|()| seen)
}

async fn fill(seen: &mut Seen, bus: &Bus) -> Result<(), Failure> {
    let mut statuses = bus.latest(&topics::MISSION, &["*"])?;
    seen.robots = connect::robots(bus).await?;
    let workers = bus
        .list_alive(topics::alive_key(topics::ALIVE_WORKER, &["*", "*"]), GLANCE)
        .await?;
    for key in &workers {
        if let Some([service, worker]) = topics::alive_chunks(topics::ALIVE_WORKER, key).as_deref() {
            seen.workers
                .entry((*service).to_owned())
                .or_default()
                .insert((*worker).to_owned());
        }
    }
    let mut leading = BTreeMap::new();
    let until = tokio::time::Instant::now() + GLANCE;
    while let Ok(Some(received)) = tokio::time::timeout_at(until, statuses.next()).await {
        if let (Some(robot), true) = (received.chunks.first(), received.message.leads) {
            leading.insert(robot.clone(), 1 + received.message.standbys.len());
        }
    }
    seen.orchestrators = leading;
    Ok(())
}
