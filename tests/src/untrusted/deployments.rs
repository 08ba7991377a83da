//! Deployment files.

#![allow(clippy::expect_used, reason = "no test without its folder")]

use zenav::config;

/// A fleet on several hosts.
const FLEET: &str = include_str!("../../../deploy/src/hosts/tests/fleet.toml");
/// A deployment with settings of several sections.
const DEPLOYMENT: &str = "\
[router]
listen = [\"tcp/127.0.0.1:7460\"]
[simulation]
world = \"house\"
speed = 2.0
[robots.anna]
model = \"jackal+rear_lidar\"
start = { x = 1.0, y = -0.5, yaw = 1.57 }
on_lost = \"return_home\"
[robots.anna.edge.collision_monitor]
feeling_speed = 0.05
[groups]
all = [\"anna\"]
[mapping]
poses = \"slam\"
resolution = 0.05
[planning]
workers = 2
";

/// Both.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    [FLEET, DEPLOYMENT].map(|text| text.as_bytes().to_vec()).into()
}

/// Reads the text as a deployment.
///
/// # Panics
/// Without a temporary folder.
pub fn exercise(bytes: &[u8]) -> usize {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("fuzz.toml");
    std::fs::write(&file, bytes).expect("a temporary file");
    usize::from(config::load(Some(&file)).is_ok())
}
