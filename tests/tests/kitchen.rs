//! Does the kitchen mission run from an empty folder to its end over real Zenoh sessions, and is its map reused the second time?

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::path::Path;
use std::time::Duration;

use serde_json::Value;
use zenav_protocol::grid::Occupancy;
use zenav_tests::process::run;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
const LIMIT: Duration = Duration::from_secs(110);

fn demo(folder: &Path) -> Value {
    let arguments = [
        "demo", "kitchen", "--seed", "7", "--speed", "8", "--no-ui", "-o", "json", "--out", "out",
    ];
    let output = run(ZENAV, &arguments, folder, LIMIT);
    let log = String::from_utf8_lossy(&output.stderr);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {log}"));
    assert_eq!(output.status.code(), Some(0), "{report:#}\n{log}");
    report
}

fn number(of: &Value, key: &str) -> f64 {
    of[key].as_f64().unwrap_or_else(|| panic!("{key} is no number: {of:#}"))
}

/// The fields that other programs rely on, and the robot's safe arrival.
fn assert_good(report: &Value) {
    assert_eq!(report["scenario"], "kitchen");
    assert_eq!(report["seed"], 7);
    assert_eq!(report["outcome"], "succeeded");
    assert_eq!(report["collisions"], 0);
    for key in ["sim_time_s", "wall_time_s", "plans", "energy_j"] {
        assert!(number(report, key) > 0.0, "{key}: {report:#}");
    }
    assert!(number(report, "replans") >= 0.0);
    for latency in ["scan_to_plan_ms", "goal_to_motion_ms"] {
        let (p50, p99) = (
            number(&report["latency"][latency], "p50"),
            number(&report["latency"][latency], "p99"),
        );
        assert!(0.0 <= p50 && p50 <= p99, "{latency}: {report:#}");
    }
    let goals = report["goals"].as_array().unwrap();
    for goal in goals {
        assert!(goal["name"].is_string());
        assert_eq!(goal["outcome"], "reached", "{goal:#}");
        assert!(
            number(goal, "time_s") > 0.0 && number(goal, "length_m") > 0.0,
            "{goal:#}"
        );
        assert!(number(goal, "min_clearance_m") > 0.05, "{goal:#}");
    }
    let errors: Vec<f64> = goals.iter().filter_map(|goal| goal["final_error_m"].as_f64()).collect();
    assert!(errors.len() >= 2, "the corner and the sink: {report:#}");
    assert!(errors.iter().all(|error| *error <= 0.1), "{errors:?}");
}

#[test]
fn the_kitchen_is_mapped_once_and_driven_twice() {
    let folder = tempfile::tempdir().unwrap();
    let first = demo(folder.path());
    assert_good(&first);
    assert_eq!(first["map_found"], false);
    let out = folder.path().join("out");
    let written: Value = serde_json::from_str(&std::fs::read_to_string(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(written, first);
    let map = zenav::files::map(&out.join("map.yaml")).expect("a map that every map tool can read");
    let known = map
        .values()
        .iter()
        .filter(|value| Occupancy::of(**value) != Occupancy::Unknown)
        .count();
    assert!(known > 2000, "{known} known cells of a kitchen of 12,000");
    assert!(std::fs::read(out.join("map.pgm")).unwrap().starts_with(b"P5"));

    let second = demo(folder.path());
    assert_good(&second);
    assert_eq!(second["map_found"], true);
    let count = |report: &Value| report["goals"].as_array().unwrap().len();
    assert!(
        number(&second, "sim_time_s") < number(&first, "sim_time_s") && count(&second) <= count(&first),
        "nothing was skipped"
    );
}
