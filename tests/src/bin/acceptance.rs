//! The long runs that the test suite leaves out: many seeds of a scenario, each as a process of its own.
//!
//! `cargo build --release -p zenav-tests --bins && target/release/acceptance kitchen 20 --speed 4`

#![expect(clippy::print_stdout, reason = "a command that prints its findings")]

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::{Command, ExitCode, Stdio};

use serde_json::Value;

/// Largest distance from a goal that counts as reached, m.
const MAX_ERROR: f64 = 0.15;
/// Least distance to anything, m.
const MIN_CLEARANCE: f64 = 0.02;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words.as_slice() {
        [scenario, seeds, rest @ ..] if seeds.parse::<u64>().is_ok() => {
            demo(scenario, seeds.parse().unwrap_or(0), rest)
        }
        _ => {
            eprintln!(
                "usage: acceptance SCENARIO SEEDS [arguments of `zenav demo`…], such as: acceptance kitchen 20 --speed 4"
            );
            ExitCode::from(2)
        }
    }
}

/// The binary that this one was built with.
fn zenav() -> PathBuf {
    let own = std::env::current_exe().unwrap_or_default();
    own.with_file_name(format!("zenav-under-test{}", std::env::consts::EXE_SUFFIX))
}

fn demo(scenario: &str, seeds: u64, more: &[&str]) -> ExitCode {
    let mut failed = Vec::new();
    let mut worst: BTreeMap<&str, f64> = BTreeMap::new();
    for seed in 1..=seeds {
        let out = std::env::temp_dir().join(format!("zenav-acceptance-{}-{scenario}-{seed}", std::process::id()));
        let output = Command::new(zenav())
            .args([
                "demo",
                scenario,
                "--no-ui",
                "-o",
                "json",
                "--seed",
                &seed.to_string(),
                "--out",
            ])
            .arg(&out)
            .args(more)
            .env("RUST_LOG", "warn")
            .stdin(Stdio::null())
            .output();
        let _ = std::fs::remove_dir_all(&out);
        let output = match output {
            Ok(output) => output,
            Err(error) => {
                eprintln!("{}: {error}; build the workspace first", zenav().display());
                return ExitCode::FAILURE;
            }
        };
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
        println!("{name}: {value:.3}");
    }
    println!(
        "{} of {seeds} seeds passed{}",
        seeds - failed.len() as u64,
        if failed.is_empty() {
            String::new()
        } else {
            format!(", failed: {failed:?}")
        }
    );
    if failed.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
