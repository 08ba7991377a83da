//! Deployments of many hosts, really started: as containers, or in network namespaces. Each part is started as `zenav deploy render` writes it,
//! has an address of its own, and can be killed, paused, cut off and replaced.
//!
//! | module | holds |
//! |---|---|
//! | [`containers`] | the compose file on this machine's engine |
//! | [`namespaces`] | the units' commands, each host in a network namespace |
//! | [`truth`] | what the robots' bodies did, by the word of their world |
//! | [`trial`] | missions of three robots, faults, and what must hold meanwhile |

pub mod containers;
pub mod namespaces;
pub mod trial;
pub mod truth;

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::process::run;

/// Longest run of a command that prepares a site.
const COMMAND: Duration = Duration::from_secs(120);

/// Three robots in a hall, each with a lane of its own; two of everything that another may have to stand in for.
const DEPLOYMENT: &str = r#"
[security]
profile = "open"
[simulation]
world = "hall.toml"
[robots.anna]
model = "tiago"
attach = true
start = { x = 0.0, y = 3.0, yaw = 0.0 }
[robots.bert]
model = "turtlebot3_waffle"
attach = true
start = { x = 0.0, y = 0.0, yaw = 0.0 }
[robots.carl]
model = "tiago"
attach = true
start = { x = 0.0, y = -3.0, yaw = 0.0 }
[hosts.fleet-a]
role = "cloud"
address = "{fleet-a}"
runs = ["router", "motion", "mission", "mapping"]
[hosts.fleet-b]
role = "cloud"
address = "{fleet-b}"
runs = ["router", "motion", "mission", "gateway"]
[hosts.hall]
role = "edge_site"
address = "{hall}"
runs = ["world"]
[hosts.robot-a]
role = "robot"
address = "{robot-a}"
runs = ["edge:anna"]
[hosts.robot-b]
role = "robot"
address = "{robot-b}"
runs = ["edge:bert"]
[hosts.robot-c]
role = "robot"
address = "{robot-c}"
runs = ["edge:carl"]
"#;

/// A hall of 14 m by 9 m without anything in it.
const HALL: &str = r#"
name = "hall"
size = [14.0, 9.0]
origin = [-1.5, -4.5]
[start]
x = 0.0
y = 0.0
yaw = 0.0
[[wall]]
from = [-1.4, -4.4]
to = [12.4, -4.4]
thickness = 0.1
[[wall]]
from = [-1.4, 4.4]
to = [12.4, 4.4]
thickness = 0.1
[[wall]]
from = [-1.4, -4.4]
to = [-1.4, 4.4]
thickness = 0.1
[[wall]]
from = [12.4, -4.4]
to = [12.4, 4.4]
thickness = 0.1
"#;

/// Names of the deployment's hosts.
pub const HOSTS: [&str; 6] = ["fleet-a", "fleet-b", "hall", "robot-a", "robot-b", "robot-c"];

/// A deployment of many hosts that runs on this machine. Parts are named `HOST-PART`, such as `fleet-a-router`.
pub trait Site: Send {
    /// What it is made of.
    fn kind(&self) -> String;

    /// Names of its parts.
    fn parts(&self) -> Vec<String>;

    /// Endpoints of the routers, as this process reaches them, separated by commas.
    fn routers(&self) -> String;

    /// The world's endpoint, as this process reaches it.
    fn world(&self) -> String;

    /// Kills a part at once.
    ///
    /// # Errors
    /// What the machine says.
    fn kill(&mut self, part: &str) -> Result<(), String>;

    /// Starts a part that was killed.
    ///
    /// # Errors
    /// What the machine says.
    fn start(&mut self, part: &str) -> Result<(), String>;

    /// Freezes a part.
    ///
    /// # Errors
    /// What the machine says.
    fn pause(&mut self, part: &str) -> Result<(), String>;

    /// Wakes it.
    ///
    /// # Errors
    /// What the machine says.
    fn resume(&mut self, part: &str) -> Result<(), String>;

    /// Cuts the part's host off from the fleet's network.
    ///
    /// # Errors
    /// What the machine says.
    fn cut(&mut self, part: &str) -> Result<(), String>;

    /// Puts it back.
    ///
    /// # Errors
    /// What the machine says.
    fn heal(&mut self, part: &str) -> Result<(), String>;

    /// Replaces a part as an update does: it is asked to end, and the new one is started.
    ///
    /// # Errors
    /// What the machine says.
    fn update(&mut self, part: &str) -> Result<(), String>;

    /// What a part has logged.
    fn log(&mut self, part: &str) -> String;
}

/// A site on this machine: containers where there is an engine, else network namespaces. `ZENAV_SITE` chooses, `containers` or `namespaces`.
///
/// # Errors
/// Why neither is possible here.
pub fn open(binary: &Path) -> Result<Box<dyn Site>, String> {
    let chosen = std::env::var("ZENAV_SITE").unwrap_or_default();
    let containers = || containers::Containers::start(binary).map(|site| Box::new(site) as Box<dyn Site>);
    let namespaces = || namespaces::Namespaces::start(binary).map(|site| Box::new(site) as Box<dyn Site>);
    match chosen.as_str() {
        "containers" => containers(),
        "namespaces" => namespaces(),
        "" => match containers::missing() {
            None => containers(),
            Some(engine) => match namespaces::missing() {
                None => namespaces(),
                Some(tools) => Err(format!("no deployment can be started here: {engine}; {tools}")),
            },
        },
        other => Err(format!("ZENAV_SITE is `{other}`: expected containers or namespaces")),
    }
}

/// Renders the deployment into a folder, with each host at the address that `address` gives it.
fn render(binary: &Path, folder: &Path, target: &str, address: impl Fn(&str) -> String) -> Result<PathBuf, String> {
    let mut text = DEPLOYMENT.to_owned();
    for host in HOSTS {
        text = text.replace(&format!("{{{host}}}"), &address(host));
    }
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).map_err(|error| error.to_string());
    write("fleet.toml", &text)?;
    write("hall.toml", HALL)?;
    checked(binary, &["deploy", "check", "fleet.toml"], folder)?;
    checked(
        binary,
        &[
            "deploy",
            "render",
            "fleet.toml",
            "--out",
            "rendered",
            "--target",
            target,
        ],
        folder,
    )?;
    Ok(folder.join("rendered"))
}

/// What a command prints.
fn checked(program: impl AsRef<std::ffi::OsStr>, arguments: &[&str], folder: &Path) -> Result<String, String> {
    let output = run(program.as_ref(), arguments, folder, COMMAND);
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    Err(format!(
        "{} {}: {}",
        program.as_ref().display(),
        arguments.join(" "),
        said.trim()
    ))
}

/// Whether a program is there, and succeeds.
fn answers(program: &str, arguments: &[&str]) -> bool {
    let mut command = std::process::Command::new(program);
    command
        .args(arguments)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// Takes out of a rendered file what this binary does not know yet: flags of health and of security.
fn only_known_flags(binary: &Path, file: &Path) -> Result<(), String> {
    let help = checked(binary, &["router", "--help"], Path::new("."))?;
    let text = std::fs::read_to_string(file).map_err(|error| error.to_string())?;
    let mut kept = String::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let entry = line
            .trim_start_matches([' ', '-', '"', '\''])
            .trim_end_matches(['"', '\'']);
        match entry {
            "insecure" if !help.contains("--insecure") => {}
            "metrics" if !help.contains("--metrics") => {
                lines.next();
            }
            _ => {
                let words: Vec<&str> = line.split(' ').collect();
                let is_kept = |(place, word): (usize, &&str)| {
                    let is_value = place > 0 && words[place - 1] == "--metrics";
                    let is_metrics = (*word == "--metrics" || is_value) && !help.contains("--metrics");
                    !(is_metrics || (*word == "--insecure" && !help.contains("--insecure")))
                };
                let line: Vec<&str> = words
                    .iter()
                    .enumerate()
                    .filter(|one| is_kept(*one))
                    .map(|(_, word)| *word)
                    .collect();
                kept.push_str(&line.join(" "));
                kept.push('\n');
            }
        }
    }
    std::fs::write(file, kept).map_err(|error| error.to_string())
}
