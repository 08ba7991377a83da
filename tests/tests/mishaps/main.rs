//! What does one broken or forged message, a silent body, a full disk or a spoiled file do? The robot drives afterwards, and somebody is told.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod disk;
mod memory;
mod numbers;
mod one_message;
mod stored_files;

use std::process::Output;
use std::time::Duration;

use zenav_tests::deployment::Deployment;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait for anything, wall time: much more than it takes on a busy machine.
const LONG: Duration = Duration::from_secs(60);

/// Both outputs of a command.
fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// Drives the robot somewhere, which must succeed.
#[track_caller]
fn drive(deployment: &Deployment, x: &str, y: &str) {
    let output = deployment.client(&["goal", "submit", "--wait", x, y, "--timeout", "40"]);
    if output.status.code() != Some(0) {
        let asked = [
            &["doctor"][..],
            &["topic", "echo", "zenav/tiago/edge/state", "--count", "1"],
        ];
        let answers = asked.map(|question| said(&deployment.client(question)));
        panic!("{}\n{}", said(&output), answers.join("\n"));
    }
}
