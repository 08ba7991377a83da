//! Multi-host deployments, run as containers or in network namespaces. Each part is started as `zenav deploy render` writes it, has its own
//! address and identity, and can be killed, paused, cut off and replaced.
//!
//! | module | holds |
//! |---|---|
//! | [`containers`] | the compose file on this machine's engine |
//! | [`namespaces`] | the units' commands, each host in a network namespace |
//! | [`truth`] | ground truth of the robots' bodies, from their world |
//! | [`soak`] | faults for a long time, and the parts' resources meanwhile |
//! | [`queues`] | messages that wait in a part, from its metrics |
//! | [`trial`] | missions of three robots under faults, and the checks meanwhile |

pub mod containers;
pub mod namespaces;
pub mod queues;
pub mod soak;
pub mod trial;
pub mod truth;

use std::path::{Path, PathBuf};
use std::time::Duration;

use zenav_protocol::bus::{Bus, BusConfig, Security};

use crate::process::run;

/// Longest run of a command that prepares a site.
const COMMAND: Duration = Duration::from_secs(120);
/// Longest wait for a session with a site.
const JOINED: Duration = Duration::from_secs(90);

/// Three robots in a hall, each in its own lane, with two of every redundant part. It has no security section: the default encrypts links
/// and authenticates each part.
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
runs = ["router", "motion", "mission", "mapping", "gateway"]
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

/// The folder of the fleet's keys, and the identity of this process, which submits goals and observes.
const KEYS: &str = "fleet-keys";
const OPERATOR: &str = "operator.desk";

/// An empty hall of 14 m by 9 m.
const HALL: &str = r#"
name = "hall"
size = [14.0, 9.0]
origin = [-1.5, -4.5]
wall = [
  { from = [-1.4, -4.4], to = [12.4, -4.4], thickness = 0.1 },
  { from = [-1.4, 4.4], to = [12.4, 4.4], thickness = 0.1 },
  { from = [-1.4, -4.4], to = [-1.4, 4.4], thickness = 0.1 },
  { from = [12.4, -4.4], to = [12.4, 4.4], thickness = 0.1 },
]
[start]
x = 0.0
y = 0.0
yaw = 0.0
"#;

/// Names of the hosts with parts.
pub const HOSTS: [&str; 6] = ["fleet-a", "fleet-b", "hall", "robot-a", "robot-b", "robot-c"];

/// Hosts with a router.
const ROUTERS: [&str; 2] = ["fleet-a", "fleet-b"];

/// A multi-host deployment on this machine. Parts are named `HOST-PART`, such as `fleet-a-router`.
pub trait Site: Send {
    /// Its kind: containers or network namespaces.
    fn kind(&self) -> String;

    /// Names of its parts.
    fn parts(&self) -> Vec<String>;

    /// Its number on this machine: part of its addresses.
    fn number(&self) -> u8;

    /// The folder of its files.
    fn folder(&self) -> &Path;

    /// Endpoints of the routers, as this process reaches them, separated by commas.
    fn routers(&self) -> String {
        let router = |host| format!("quic/{}:7447", address(self.number(), host, "fleet"));
        ROUTERS.map(router).join(",")
    }

    /// The world's endpoint, as this process reaches it.
    fn world(&self) -> String {
        format!("quic/{}:7446", address(self.number(), "hall", "bodies"))
    }

    /// The folder of this process's identity: an operator's.
    fn identity(&self) -> PathBuf {
        self.folder().join(KEYS).join("issued").join(OPERATOR)
    }

    /// Kills a part at once.
    ///
    /// # Errors
    /// The system's error.
    fn kill(&mut self, part: &str) -> Result<(), String>;

    /// Starts a part that was killed.
    ///
    /// # Errors
    /// The system's error.
    fn start(&mut self, part: &str) -> Result<(), String>;

    /// Freezes a part.
    ///
    /// # Errors
    /// The system's error.
    fn pause(&mut self, part: &str) -> Result<(), String>;

    /// Resumes a frozen part.
    ///
    /// # Errors
    /// The system's error.
    fn resume(&mut self, part: &str) -> Result<(), String>;

    /// Cuts the part's host off from the fleet's network; the parts on it still reach one another.
    ///
    /// # Errors
    /// The system's error.
    fn cut(&mut self, part: &str) -> Result<(), String>;

    /// Reconnects the part's host.
    ///
    /// # Errors
    /// The system's error.
    fn heal(&mut self, part: &str) -> Result<(), String>;

    /// Cuts the two routers off from one another, or reconnects them: the firewall of each drops what comes from the other.
    ///
    /// # Errors
    /// The system's error.
    fn split(&mut self, is_cut: bool) -> Result<(), String> {
        let rule = if is_cut { "-I" } else { "-D" };
        for [here, there] in [ROUTERS, [ROUTERS[1], ROUTERS[0]]] {
            let process = self.process_id(&format!("{here}-router"))?.to_string();
            let from = address(self.number(), there, "fleet");
            let firewall = ["iptables", "-w", rule, "INPUT", "-s", &from, "-j", "DROP"];
            checked(
                "nsenter",
                &[&["-t", &process, "-n"], &firewall[..]].concat(),
                self.folder(),
            )?;
        }
        Ok(())
    }

    /// Replaces a part as an update does: asks it to end, then starts the new one.
    ///
    /// # Errors
    /// The system's error.
    fn update(&mut self, part: &str) -> Result<(), String>;

    /// The process of a part on this machine.
    ///
    /// # Errors
    /// When it does not run.
    fn process_id(&self, part: &str) -> Result<u32, String>;

    /// The log of a part.
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

/// Opens a site on this machine, with its world at this speed: containers if there is an engine, else network namespaces. `ZENAV_SITE`
/// overrides this with `containers` or `namespaces`.
///
/// # Errors
/// The reason why neither is possible here.
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

/// Renders the deployment into a folder, with the hosts' addresses from `address`, and makes the keys that its `README.md` asks for.
/// `reached`: the address at which this process reaches a host, if it differs from that of other parts.
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

/// Runs a command and returns its output.
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

/// Whether a program exists and succeeds.
fn answers(program: &str, arguments: &[&str]) -> bool {
    let mut command = std::process::Command::new(program);
    command
        .args(arguments)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null());
    command.status().is_ok_and(|status| status.success())
}
