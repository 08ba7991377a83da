//! Deployments of many hosts, really started: as containers, or in network namespaces. Each part is started as `zenav deploy render` writes it,
//! has an address of its own and proves who it is, and can be killed, paused, cut off and replaced.
//!
//! | module | holds |
//! |---|---|
//! | [`containers`] | the compose file on this machine's engine |
//! | [`namespaces`] | the units' commands, each host in a network namespace |
//! | [`truth`] | what the robots' bodies did, by the word of their world |
//! | [`soak`] | faults for a long time, and what the parts hold on to meanwhile |
//! | [`trial`] | missions of three robots, faults, and what must hold meanwhile |

pub mod containers;
pub mod namespaces;
pub mod soak;
pub mod trial;
pub mod truth;

use std::path::{Path, PathBuf};
use std::time::Duration;

use zenav_protocol::bus::{Bus, BusConfig, Security};

use crate::process::run;

/// Longest run of a command that prepares a site.
const COMMAND: Duration = Duration::from_secs(120);
/// Longest wait for a session with it.
const JOINED: Duration = Duration::from_secs(90);

/// Three robots in a hall, each with a lane of its own; two of everything that another may have to stand in for. Nothing is said of security: its
/// links are encrypted, and each part proves who it is.
const DEPLOYMENT: &str = r#"
# All parts share the cores of one machine, and come from a debug build.
[mapping]
resolution = 0.05
[simulation]
world = "hall.toml"
speed = {speed}
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
[hosts.desk]
role = "operator"
address = "desk.example"
"#;

/// The folder of the fleet's keys, and who gives goals and looks on.
const KEYS: &str = "fleet-keys";
const OPERATOR: &str = "operator.desk";

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

/// Names of the hosts that run something.
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

    /// The folder of this process's identity: an operator's.
    fn identity(&self) -> PathBuf;

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

    /// The process of a part on this machine.
    ///
    /// # Errors
    /// When it does not run.
    fn process_id(&self, part: &str) -> Result<u32, String>;

    /// What a part has logged.
    fn log(&mut self, part: &str) -> String;
}

/// Number of this process's sites on this machine: part of their addresses.
fn site_number() -> u8 {
    u8::try_from(std::process::id() % 200 + 20).unwrap_or(20)
}

/// A site's networks: of the fleet, and of the robots' bodies.
const NETWORKS: [(&str, u8); 2] = [("fleet", 77), ("bodies", 78)];

/// An address in one of the networks of a site.
fn numbered(site: u8, network: &str, number: usize) -> String {
    let network = NETWORKS
        .iter()
        .find(|(name, _)| *name == network)
        .map_or(0, |(_, number)| *number);
    format!("10.{network}.{site}.{number}")
}

/// A host's address in one of the networks of a site.
fn address(site: u8, host: &str, network: &str) -> String {
    let number = HOSTS.iter().position(|name| *name == host).unwrap_or_default();
    numbered(site, network, number + 10)
}

/// A site on this machine, whose world goes at this speed: containers where there is an engine, else network namespaces. `ZENAV_SITE` chooses,
/// `containers` or `namespaces`.
///
/// # Errors
/// Why neither is possible here.
pub fn open(binary: &Path, speed: f64) -> Result<Box<dyn Site>, String> {
    let chosen = std::env::var("ZENAV_SITE").unwrap_or_default();
    let containers = || containers::Containers::start(binary, speed).map(|site| Box::new(site) as Box<dyn Site>);
    let namespaces = || namespaces::Namespaces::start(binary, speed).map(|site| Box::new(site) as Box<dyn Site>);
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

/// Renders the deployment into a folder, with each host at the address that `address` gives it, and makes the keys that its `README.md` asks for.
/// `reached` is where this process reaches a host, when that is not where other parts do.
fn render(
    binary: &Path,
    folder: &Path,
    target: &str,
    speed: f64,
    address: impl Fn(&str) -> String,
    reached: impl Fn(&str) -> Option<String>,
) -> Result<PathBuf, String> {
    let mut text = DEPLOYMENT.replace("{speed}", &format!("{speed:?}"));
    for host in HOSTS {
        text = text.replace(&format!("{{{host}}}"), &address(host));
    }
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).map_err(|error| error.to_string());
    write("fleet.toml", &text)?;
    write("hall.toml", HALL)?;
    let rendered = [
        "deploy",
        "render",
        "fleet.toml",
        "--out",
        "rendered",
        "--target",
        target,
    ];
    checked(binary, &rendered, folder)?;
    let told = std::fs::read_to_string(folder.join("rendered/README.md")).map_err(|error| error.to_string())?;
    for line in told.lines().filter_map(|line| line.strip_prefix("zenav keys ")) {
        let mut words = vec!["keys"];
        words.extend(line.split(' '));
        let member = words.get(2).and_then(|member| member.strip_prefix("router."));
        let more = member.and_then(&reached);
        words.extend(more.iter().flat_map(|address| ["--host", address.as_str()]));
        checked(binary, &words, folder)?;
    }
    checked(binary, &["deploy", "check", "fleet.toml"], folder)?;
    Ok(folder.join("rendered"))
}

/// A session with the site, as its operator.
async fn join(name: &'static str, endpoints: &str, identity: &Path) -> Result<Bus, String> {
    let security = Security::of(Some(identity), false).map_err(|error| error.to_string())?;
    let config = BusConfig {
        security,
        ..BusConfig::service(name, endpoints)
    };
    let opened = tokio::time::timeout(JOINED, Bus::open(config)).await;
    opened
        .map_err(|_| format!("nobody lets `{name}` in at {endpoints}"))?
        .map_err(|error| error.to_string())
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
