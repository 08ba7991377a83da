//! Samples and messages that are made up for tests.

use std::path::Path;

use serde::Serialize;
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::messages::Plan;

use super::format::{Kind, Sample};
use super::writer::{RecordOptions, RecordWriter};

/// A message in JSON, published on a key, that arrived at a time, ns since the UNIX epoch.
pub(super) fn sample(key: &str, message: &impl Serialize, logged: u64) -> Sample {
    let bytes = codec::encode(message, Encoding::Json).unwrap();
    Sample::new(key.to_owned(), Kind::Put, Encoding::Json, bytes, logged)
}

/// Writes a record of these samples.
pub(super) fn record(path: &Path, samples: impl IntoIterator<Item = Sample>) {
    let mut writer = RecordWriter::create(path, RecordOptions::default(), 5).unwrap();
    samples.into_iter().for_each(|sample| writer.write(&sample).unwrap());
    writer.finish(0).unwrap();
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
