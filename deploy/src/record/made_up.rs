//! Samples and messages that are made up for tests.

#![allow(clippy::unwrap_used, reason = "tests")]

use serde::Serialize;
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::messages::Plan;

use super::format::{Kind, Sample};

/// A message in JSON, published on a key, that arrived at a time, ns since the UNIX epoch.
pub(super) fn sample(key: &str, message: &impl Serialize, logged: u64) -> Sample {
    Sample {
        key: key.to_owned(),
        encoding: Encoding::Json.mime().to_owned(),
        kind: Kind::Put,
        bytes: codec::encode(message, Encoding::Json).unwrap(),
        attachment: None,
        logged,
        published: None,
    }
}

/// A plan for the goal `g`, without a path.
pub(super) fn plan() -> Plan {
    serde_json::from_value(serde_json::json!({
        "goal_id": "g", "epoch": 1, "revision": { "incarnation": 1, "counter": 1 }, "trajectory_id": 1,
        "map": { "id": "m", "revision": 1 }, "frame": "map", "based_on": { "stamp": 1, "boot_id": "b" }, "valid_for": 5.0,
        "waypoints": [], "trajectory": [], "splice": null,
        "statistics": { "planner": "astar", "search_ms": 0.0, "corridor_ms": 0.0, "geometry_ms": 0.0, "timing_ms": 0.0,
            "length": 0.0, "duration": 0.0, "min_clearance": null, "status": "waypoints", "solver": "" },
    }))
    .unwrap()
}
