//! Effects of one broken or forged message, a silent body, a full disk or a corrupted file: the robot must still drive afterwards, and the
//! fault must be reported.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod deaf_router;
mod disk;
mod memory;
mod numbers;
mod one_message;
mod stored_files;

use std::process::Output;
use std::time::Duration;

use zenav_tests::deployment::Deployment;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait, wall time: far longer than needed even on a busy machine.
const LONG: Duration = Duration::from_secs(60);

/// Stdout and stderr of a command.
fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// Drives the robot to a point, which must succeed.
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
