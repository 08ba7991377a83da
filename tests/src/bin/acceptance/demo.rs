//! Demonstrations. Runs a scenario with many seeds, each in its own process.

use std::collections::BTreeMap;
use std::process::{Command, Stdio};

use serde_json::Value;
use zenav_fixtures::Row;

use crate::{Verdict, zenav};

/// Largest true distance from a goal that counts as reached, m.
const MAX_ERROR: f64 = 0.05;
/// Least true clearance, m.
const MIN_CLEARANCE: f64 = 0.02;

/// Runs a scenario with a number of seeds.
pub fn demo(scenario: &str, seeds: u64, more: &[String]) -> Verdict {
    let mut failed = Vec::new();
    let mut worst: BTreeMap<&str, f64> = BTreeMap::new();
    for seed in 1..=seeds {
        let out = std::env::temp_dir().join(format!("zenav-acceptance-{}-{scenario}-{seed}", std::process::id()));
        let output = Command::new(zenav())
            .args(["demo", scenario, "--no-ui", "-o", "json"])
            .args(["--seed", &seed.to_string(), "--out"])
            .arg(&out)
            .args(more)
            .env("RUST_LOG", "warn")
            .stdin(Stdio::null())
            .output();
        let _ = std::fs::remove_dir_all(&out);
        let output = output.map_err(|error| format!("{}: {error}; build the workspace first", zenav().display()))?;
        let report: Value = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
        let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
        let error = report["goals"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|goal| goal["final_error_m"].as_f64())
            .fold(0.0, f64::max);
        let clearance = number(&report["min_clearance_m"]);
        let good = output.status.code() == Some(0)
            && report["collisions"] == 0
            && clearance > MIN_CLEARANCE
            && error <= MAX_ERROR;
        println!(
            "seed {seed:3}: {} exit {:?}, collisions {}, clearance {clearance:.3} m, error {error:.3} m, simulated {:.1} s, wall {:.1} s",
            if good { "ok    " } else { "FAILED" },
            output.status.code(),
            report["collisions"],
            number(&report["sim_time_s"]),
            number(&report["wall_time_s"])
        );
        let mut note = |name, value: f64, pick: fn(f64, f64) -> f64| {
            let entry = worst.entry(name).or_insert(value);
            *entry = pick(*entry, value);
        };
        note("least clearance, m", clearance, f64::min);
        note("largest error, m", error, f64::max);
        note("longest wall time, s", number(&report["wall_time_s"]), f64::max);
        if !good {
            eprintln!("{}", String::from_utf8_lossy(&output.stderr));
            failed.push(seed);
        }
    }
    for (name, value) in worst {
        let (what, unit) = name.split_once(", ").unwrap_or((name, ""));
        Row::new(format!("{scenario}: {what}"), value, unit).print();
    }
    let succeeded = seeds - failed.len() as u64;
    Row::new(
        format!("{scenario}: seeds that succeed, of {seeds}"),
        succeeded as f64,
        "",
    )
    .print();
    println!(
        "{} of {seeds} seeds passed{}",
        seeds - failed.len() as u64,
        if failed.is_empty() {
            String::new()
        } else {
            format!(", failed: {failed:?}")
        }
    );
    Ok(failed.is_empty())
}
