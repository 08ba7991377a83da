//! Is a run repeatable, bit for bit, from its seed?

#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;
use std::time::Duration;

use zenav_tests::process::run;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");

/// Report and trajectory, as bytes.
fn drive(folder: &Path, seed: &str, file: &str, more: &[&str]) -> (Vec<u8>, Vec<u8>) {
    let arguments = [
        "run",
        "--world",
        "kitchen",
        "--robot",
        "tiago",
        "--goal",
        "0.9",
        "-0.4",
        "--seed",
        seed,
        "--trajectory",
        file,
        "-o",
        "json",
    ];
    let output = run(ZENAV, &[&arguments, more].concat(), folder, Duration::from_secs(60));
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    (output.stdout, std::fs::read(folder.join(file)).unwrap())
}

#[test]
fn a_seed_gives_the_same_report_and_trajectory_twice_and_another_seed_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let first = drive(folder.path(), "11", "first.csv", &[]);
    let second = drive(folder.path(), "11", "second.csv", &[]);
    assert!(
        first.0 == second.0,
        "{}\n{}",
        String::from_utf8_lossy(&first.0),
        String::from_utf8_lossy(&second.0)
    );
    assert!(first.1 == second.1, "the trajectories differ");
    let rows = first.1.iter().filter(|byte| **byte == b'\n').count();
    assert!(first.1.starts_with(b"t,x,y,yaw,v,w\n") && rows > 100, "{rows} rows");
    let other = drive(folder.path(), "12", "other.csv", &[]);
    assert!(first.1 != other.1, "the noise does not depend on the seed");
}

#[test]
fn a_run_takes_the_settings_of_its_deployment() {
    let folder = tempfile::tempdir().unwrap();
    let shipped = drive(folder.path(), "11", "shipped.csv", &[]).1;
    for (name, text) in [
        ("same", "[mission]\nplan_valid = 5.0\n"),
        ("smoothing", "[smoothing.corridor]\nclearance = 0.1\n"),
        (
            "edge",
            "[robots.tiago.edge.plan]\nbraking_share = 0.5\n[robots.tiago.edge.estimator]\nslip = 1e-3\n",
        ),
        ("mission", "[mission]\nplan_valid = 1.5\n"),
    ] {
        std::fs::write(folder.path().join("tuned.toml"), text).unwrap();
        let tuned = drive(folder.path(), "11", "tuned.csv", &["--deployment", "tuned.toml"]).1;
        assert_eq!(tuned == shipped, name == "same", "{name}");
    }
}
