//! Secured deployments. A fleet with identities: each part is a separate process with keys made by `zenav keys`, on QUIC endpoints.

#![allow(clippy::expect_used, reason = "a test cannot go on without its rig")]

use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::Duration;

use tempfile::TempDir;
use zenav_protocol::bus::{Bus, BusConfig, BusError, Security};

use crate::process::{Process, free_endpoint, run, words};

/// Longest run of a command.
const COMMAND: Duration = Duration::from_secs(90);
/// Longest wait for a session.
const JOIN: Duration = Duration::from_secs(20);

/// Creates the keys of a fleet with these members, in `fleet-keys` of a folder.
///
/// # Errors
/// What `zenav keys` says when it fails.
pub fn issue(binary: &Path, folder: &Path, members: &[&str]) -> Result<(), String> {
    keys(binary, folder, &["init"])?;
    members
        .iter()
        .try_for_each(|member| keys(binary, folder, &["issue", member]))
}

fn keys(binary: &Path, folder: &Path, arguments: &[&str]) -> Result<(), String> {
    let output = run(binary, &[&["keys"], arguments].concat(), folder, COMMAND);
    let why = String::from_utf8_lossy(&output.stderr);
    let failed = || format!("zenav keys {arguments:?}: {why}");
    output.status.success().then_some(()).ok_or_else(failed)
}

/// Folder of a member's identity, from the folder of the keys.
#[must_use]
pub fn identity(folder: &Path, member: &str) -> PathBuf {
    folder.join("fleet-keys/issued").join(member)
}

/// Keys, endpoints and files of one fleet.
#[derive(Debug)]
pub struct SecuredFleet {
    binary: PathBuf,
    folder: TempDir,
    speed: f64,
    /// Namespace of all parts; empty for none.
    namespace: String,
    /// The router's endpoint.
    pub router: String,
    /// The robot's own endpoint.
    pub edge: String,
}

impl SecuredFleet {
    /// Creates the keys of a fleet with these members; starts nothing yet.
    ///
    /// # Panics
    /// When there is no folder or free port, or `zenav keys` fails.
    #[must_use]
    pub fn new(binary: &str, speed: f64, members: &[&str]) -> Self {
        let fleet = Self {
            binary: binary.into(),
            folder: tempfile::tempdir().expect("a temporary folder"),
            speed,
            namespace: String::new(),
            router: free_endpoint().replace("tcp/", "quic/"),
            edge: free_endpoint().replace("tcp/", "quic/"),
        };
        issue(&fleet.binary, fleet.folder(), members).expect("keys");
        fleet
    }

    /// The same fleet in a namespace.
    #[must_use]
    pub fn within(self, namespace: &str) -> Self {
        Self {
            namespace: namespace.to_owned(),
            ..self
        }
    }

    /// The folder of all files.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// `zenav keys`, which must succeed.
    ///
    /// # Panics
    /// When it fails.
    pub fn keys(&self, arguments: &[&str]) {
        keys(&self.binary, self.folder(), arguments).expect("keys");
    }

    /// Folder of a member's identity.
    #[must_use]
    pub fn identity(&self, member: &str) -> PathBuf {
        identity(self.folder(), member)
    }

    fn start(&self, member: &str, arguments: &[&str]) -> Process {
        let identity = self.identity(member).to_string_lossy().into_owned();
        let (namespace, binary) = (self.variable(), self.binary.to_string_lossy());
        let (before, after) = ([&*namespace, &*binary], ["--identity", &identity]);
        Process::start("env", &[&before, arguments, &after[..]].concat(), self.folder())
    }

    /// Starts a part of a member with all that it can log; its output and its log are one.
    #[must_use]
    pub fn start_traced(&self, member: &str, arguments: &[&str]) -> Process {
        let identity = self.identity(member).to_string_lossy().into_owned();
        let binary = self.binary.to_string_lossy();
        let before = ["-c", "export RUST_LOG=trace; exec \"$0\" \"$@\" >&2", &*binary];
        Process::start(
            "sh",
            &[&before, arguments, &["--identity", &identity]].concat(),
            self.folder(),
        )
    }

    /// The environment variable that sets the namespace of a part.
    fn variable(&self) -> String {
        format!("ZENAV_BUS__NAMESPACE={}", self.namespace)
    }

    /// `zenav router`.
    #[must_use]
    pub fn start_router(&self, member: &str) -> Process {
        self.start(member, &["router", "--listen", &self.router])
    }

    /// `zenav sim serve` on the router.
    #[must_use]
    pub fn start_world(&self, member: &str) -> Process {
        let (router, speed) = (&self.router, self.speed);
        let line = format!("sim serve --connect {router} --world kitchen --speed {speed}");
        self.start(member, &words(&line))
    }

    /// `zenav edge` of a robot in the served world.
    #[must_use]
    pub fn start_edge(&self, member: &str) -> Process {
        let line = format!(
            "edge --attach --connect {} --listen {} --data edge",
            self.router, self.edge
        );
        self.start(member, &words(&line))
    }

    /// `zenav cloud all`.
    #[must_use]
    pub fn start_cloud(&self, member: &str) -> Process {
        self.start(member, &["cloud", "all", "--connect", &self.router, "--data", "cloud"])
    }

    /// Runs a command to its end.
    #[must_use]
    pub fn zenav(&self, arguments: &[&str]) -> Output {
        run(&self.binary, arguments, self.folder(), COMMAND)
    }

    /// Runs a client command as a member to its end, at the router or at another endpoint.
    #[must_use]
    pub fn client(&self, member: &str, endpoint: &str, arguments: &[&str]) -> Output {
        let identity = self.identity(member).to_string_lossy().into_owned();
        let (namespace, binary) = (self.variable(), self.binary.to_string_lossy());
        let (before, after) = (
            [&*namespace, &*binary],
            ["--connect", endpoint, "--identity", &identity],
        );
        run(
            "env",
            &[&before, arguments, &after[..]].concat(),
            self.folder(),
            COMMAND,
        )
    }

    /// Joins as a member at an endpoint.
    ///
    /// # Panics
    /// When it cannot.
    pub async fn join(&self, member: &str, endpoint: &str) -> Bus {
        open(self.session(member, endpoint)).await
    }

    /// Joins as a member with an endpoint of its own, as a robot does: its session is a router. The member must have a list of members.
    ///
    /// # Panics
    /// When it cannot.
    pub async fn join_as_router(&self, member: &str, endpoint: &str) -> Bus {
        let bus = open(BusConfig {
            listen: vec!["quic/127.0.0.1:0".to_owned()],
            ..self.session(member, endpoint)
        })
        .await;
        let linked = async {
            while !bus.is_connected().await {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        tokio::time::timeout(JOIN, linked).await.expect("a link in time");
        bus
    }

    fn session(&self, member: &str, endpoint: &str) -> BusConfig {
        let security = Security::of(Some(&self.identity(member)), false).expect("an identity");
        BusConfig {
            security,
            ..BusConfig::service(member, endpoint).within(&self.namespace)
        }
    }

    /// Tries once to join at an endpoint with any identity, or with none.
    ///
    /// # Errors
    /// The reason why it cannot join.
    pub async fn try_to_join(&self, identity: Option<&Path>, endpoint: &str) -> Result<Bus, BusError> {
        let security = Security::of(identity, false).expect("an identity");
        Bus::open(BusConfig {
            security,
            ..BusConfig::command("stranger", endpoint)
        })
        .await
    }
}

async fn open(config: BusConfig) -> Bus {
    let opened = tokio::time::timeout(JOIN, Bus::open(config)).await;
    opened.expect("somebody lets it in in time").expect("the bus opens")
}
