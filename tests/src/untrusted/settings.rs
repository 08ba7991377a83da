//! Settings files. The same text as a robot, an option of a robot, a world and a file of zones.

#![allow(
    clippy::expect_used,
    reason = "zones of a file that are refused as messages are a finding"
)]

use zenav_protocol::grid::GridSpec;
use zenav_protocol::robot::{self, RobotModel};
use zenav_sim::{Simulation, World, world};
use zenav_space::Zones;

/// Zones of both kinds.
const ZONES: &str = "\
[[keep_out]]
name = \"stairs\"
points = [[0, 0], [2, 0], [2, 1], [0, 1]]
[[speed_limit]]
max_speed = 0.3
points = [[-1.0, -1.0], [0.5, -1.0], [0.0, 1.5]]
";

/// The shipped files, and one of each other kind.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let shipped = [robot::SHIPPED, robot::OPTIONS, world::SHIPPED].concat();
    let texts = shipped.into_iter().map(|(_, text)| text);
    texts.chain([ZONES]).map(|text| text.as_bytes().to_vec()).collect()
}

/// Reads the text as every kind of file, and uses what was read.
///
/// # Panics
/// When zones that were read are refused as messages.
pub fn exercise(bytes: &[u8]) -> usize {
    let Ok(text) = std::str::from_utf8(bytes) else { return 0 };
    [
        RobotModel::from_toml(text, "fuzz").is_ok(),
        is_option(text),
        is_world(text),
        are_zones(text),
    ]
    .into_iter()
    .filter(|taken| *taken)
    .count()
}

fn is_option(text: &str) -> bool {
    let with = |robot: &str| RobotModel::with_options(&format!("{robot}+fuzz"), |_| Ok(text.to_owned()));
    robot::SHIPPED.iter().any(|(robot, _)| with(robot).is_ok())
}

fn is_world(text: &str) -> bool {
    let Ok(world) = World::from_toml(text, "fuzz", &|_| Err("there are no maps".to_owned())) else {
        return false;
    };
    let _ = world.doubts();
    let _ = Simulation::new(&world, Vec::new(), 1);
    true
}

fn are_zones(text: &str) -> bool {
    let Ok(zones) = Zones::from_toml(text, "fuzz") else {
        return false;
    };
    Zones::new(&zones.to_messages()).expect("zones of a file are zones of a message");
    let spec = GridSpec {
        origin: nalgebra::Point2::new(-2.0, -2.0),
        resolution: 0.05,
        width: 80,
        height: 80,
    };
    let _ = zones.keep_out_cells(&spec);
    true
}
