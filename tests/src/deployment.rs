//! Deployments. A router, a robot and a cloud as separate processes, as on three machines.
//!
//! Endpoints are chosen once from free ports, so a killed part restarts on the endpoint where the others look for it. Robot and cloud keep
//! their files in separate folders.

#![allow(clippy::expect_used, reason = "a test cannot go on without its rig")]

use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::Duration;

use tempfile::TempDir;
use zenav_protocol::bus::{Bus, BusConfig};

use crate::process::{LOGGED, Process, free_endpoint, run, words};

/// The robot of the shipped deployment.
pub const ROBOT: &str = "tiago";

/// Longest run of a command.
const COMMAND: Duration = Duration::from_secs(60);

/// A straight corridor with room for a drive of 25 s and more: 17 m between its ends, 3 m between its walls.
pub const CORRIDOR: &str = r#"
name = "corridor"
size = [18.0, 4.0]
origin = [-1.0, -2.0]
wall = [
  { from = [-0.95, -1.5], to = [16.95, -1.5], thickness = 0.1 },
  { from = [-0.95, 1.5], to = [16.95, 1.5], thickness = 0.1 },
  { from = [-0.95, -1.5], to = [-0.95, 1.5], thickness = 0.1 },
  { from = [16.95, -1.5], to = [16.95, 1.5], thickness = 0.1 },
]
[[place]]
name = "far_end"
x = 15.0
y = 0.0
"#;

/// Endpoints and files of one deployment.
#[derive(Debug)]
pub struct Deployment {
    binary: PathBuf,
    folder: TempDir,
    world: String,
    speed: f64,
    /// What the parts log, as in `RUST_LOG`.
    pub logged: &'static str,
    /// The router's endpoint.
    pub router: String,
    /// The robot's own endpoint.
    pub edge: String,
}

impl Deployment {
    /// Starts nothing yet. `world` is a shipped name, or the text of a world file; `speed` is simulated seconds per second.
    ///
    /// # Panics
    /// When there is no folder or free port.
    #[must_use]
    pub fn new(binary: &str, world: &str, speed: f64) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let world = if world.contains('\n') {
            let file = folder.path().join("world.toml");
            std::fs::write(&file, world).expect("a world file");
            file.to_string_lossy().into_owned()
        } else {
            world.to_owned()
        };
        Self {
            binary: binary.into(),
            folder,
            world,
            speed,
            logged: LOGGED,
            router: free_endpoint(),
            edge: free_endpoint(),
        }
    }

    /// The folder of all files.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    fn start(&self, arguments: &[&str]) -> Process {
        Process::start_logging(&self.binary, arguments, self.folder(), self.logged)
    }

    /// `zenav router`.
    #[must_use]
    pub fn start_router(&self) -> Process {
        self.start(&["router", "--listen", &self.router])
    }

    /// `zenav edge`.
    #[must_use]
    pub fn start_edge(&self) -> Process {
        let (router, edge, world, speed) = (&self.router, &self.edge, &self.world, self.speed);
        self.start(&words(&format!(
            "edge --connect {router} --listen {edge} --data edge --world {world} --speed {speed}"
        )))
    }

    /// `zenav cloud all`.
    #[must_use]
    pub fn start_cloud(&self) -> Process {
        self.start_service("all")
    }

    /// `zenav cloud` with one of its services.
    #[must_use]
    pub fn start_service(&self, service: &str) -> Process {
        self.start_service_in(service, "cloud")
    }

    /// `zenav cloud` with one of its services, as on a machine of its own: its files are in the folder `data`.
    #[must_use]
    pub fn start_service_in(&self, service: &str, data: &str) -> Process {
        let (router, world) = (&self.router, &self.world);
        self.start(&words(&format!(
            "cloud {service} --connect {router} --data {data} --world {world}"
        )))
    }

    /// `zenav cloud motion` under a worker's name.
    #[must_use]
    pub fn start_motion_worker(&self, worker: &str) -> Process {
        let router = &self.router;
        self.start(&words(&format!(
            "cloud motion --connect {router} --data cloud --worker {worker}"
        )))
    }

    /// `zenav cloud mission` under a name, which is also its folder.
    #[must_use]
    pub fn start_mission(&self, holder: &str) -> Process {
        self.start_service_in(&format!("mission --holder {holder}"), holder)
    }

    /// `zenav cloud mission` under a name, which is also its folder. `robots`: the robots' sections of a deployment file; `is_pinned`: only
    /// on the first core (by `taskset` of util-linux).
    ///
    /// # Panics
    /// When the file cannot be written.
    #[must_use]
    pub fn start_missions(&self, holder: &str, robots: &str, is_pinned: bool) -> Process {
        let file = format!("{holder}.toml");
        let (world, router) = (&self.world, &self.router);
        let text = format!(
            "[bus]\nconnect = \"{router}\"\n[simulation]\nworld = '{world}'\n[data]\ndir = \"{holder}\"\n{robots}"
        );
        std::fs::write(self.folder().join(&file), text).expect("a deployment file");
        let arguments = ["cloud", "mission", "--holder", holder, "--deployment", &file];
        if is_pinned {
            let binary = self.binary.to_string_lossy();
            let pinned = [&["-c", "0", &binary][..], &arguments].concat();
            Process::start("taskset", &pinned, self.folder())
        } else {
            self.start(&arguments)
        }
    }

    /// `zenav up`: everything in one process, from a deployment file.
    ///
    /// # Panics
    /// When the file cannot be written.
    #[must_use]
    pub fn start_up(&self) -> Process {
        self.start_up_with(&[])
    }

    /// Like [`Self::start_up`], with further arguments.
    ///
    /// # Panics
    /// When the file cannot be written.
    #[must_use]
    pub fn start_up_with(&self, more: &[&str]) -> Process {
        self.start_up_of("", more)
    }

    /// Like [`Self::start_up_with`], with further sections of the deployment file.
    ///
    /// # Panics
    /// When the file cannot be written.
    #[must_use]
    pub fn start_up_of(&self, sections: &str, more: &[&str]) -> Process {
        let file = self.folder().join("deployment.toml");
        let (world, speed, router, edge) = (&self.world, self.speed, &self.router, &self.edge);
        let text = format!(
            "[router]\nlisten = [\"{router}\"]\n[bus]\nconnect = \"{router}\"\n[simulation]\nworld = '{world}'\nspeed = {speed:?}\n\
             [robots.{ROBOT}]\nmodel = \"tiago\"\nlisten = \"{edge}\"\n[data]\ndir = \"up\"\n{sections}"
        );
        std::fs::write(file, text).expect("a deployment file");
        self.start(&[&["up", "deployment.toml"], more].concat())
    }

    /// `zenav sim serve`: the world, and the router.
    #[must_use]
    pub fn start_served_world(&self) -> Process {
        let (router, world, speed) = (&self.router, &self.world, self.speed);
        self.start(&words(&format!(
            "sim serve --listen {router} --world {world} --speed {speed}"
        )))
    }

    /// `zenav up` for robots of the served world; `robots`: their sections of a deployment file.
    ///
    /// # Panics
    /// When the file cannot be written.
    #[must_use]
    pub fn start_up_attached(&self, robots: &str) -> Process {
        let file = self.folder().join("attached.toml");
        let (world, router) = (&self.world, &self.router);
        let text = format!(
            "[router]\nenabled = false\n[bus]\nconnect = \"{router}\"\n[simulation]\nworld = '{world}'\n[data]\ndir = \"attached\"\n{robots}"
        );
        std::fs::write(file, text).expect("a deployment file");
        self.start(&["up", "attached.toml"])
    }

    /// Runs a command to its end.
    #[must_use]
    pub fn zenav(&self, arguments: &[&str]) -> Output {
        run(&self.binary, arguments, self.folder(), COMMAND)
    }

    /// Runs a client command against the router to its end.
    #[must_use]
    pub fn client(&self, arguments: &[&str]) -> Output {
        let mut all = arguments.to_vec();
        all.extend(["--connect", &self.router]);
        self.zenav(&all)
    }

    /// Joins at the router, which may still be starting.
    ///
    /// # Panics
    /// When it cannot.
    pub async fn bus(&self) -> Bus {
        self.bus_at(&self.router).await
    }

    /// Joins at an endpoint that may still be starting.
    ///
    /// # Panics
    /// When it cannot.
    pub async fn bus_at(&self, endpoint: &str) -> Bus {
        let joined =
            tokio::time::timeout(Duration::from_secs(20), Bus::open(BusConfig::service("test", endpoint))).await;
        joined.expect("somebody listens in time").expect("the bus opens")
    }
}
