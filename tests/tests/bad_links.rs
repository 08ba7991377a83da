//! Missions over a bad link, with a cut, and with a killed orchestrator: the short fault suite, as run by `acceptance faults --short`.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::process::Command;

#[test]
fn missions_end_over_a_bad_link_a_cut_and_a_killed_orchestrator() {
    let output = Command::new(env!("CARGO_BIN_EXE_acceptance"))
        .args(["faults", "--short"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}");
    assert!(
        output.status.success(),
        "{said}\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
}
