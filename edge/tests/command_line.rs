//! Which command lines does `zenav-edge` refuse, and with which exit code?

#![allow(clippy::unwrap_used, reason = "tests")]

use std::process::{Command, Output};

use tempfile::TempDir;
use zenav_edge::exit_code;

/// Runs the binary to its end, in a folder of its own with a deployment file `site.toml`.
fn run(deployment: &str, arguments: &[&str]) -> Output {
    let folder = TempDir::new().unwrap();
    std::fs::write(folder.path().join("site.toml"), deployment).unwrap();
    Command::new(env!("CARGO_BIN_EXE_zenav-edge"))
        .args(arguments)
        .current_dir(folder.path())
        .env_remove("ZENAV_IDENTITY")
        .output()
        .unwrap()
}

/// Asserts that wrong usage is told with all these words.
fn assert_usage(deployment: &str, arguments: &[&str], words: &[&str]) {
    let output = run(deployment, arguments);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(
        output.status.code(),
        Some(i32::from(exit_code::USAGE)),
        "{arguments:?}: {text}"
    );
    assert!(words.iter().all(|word| text.contains(word)), "{arguments:?}: {text}");
}

#[test]
fn without_an_identity_it_listens_to_this_machine_alone() {
    let both = ["--identity", "--insecure"];
    let everywhere = ["--listen", "tcp/0.0.0.0:0"];
    for body in [&["--attach"][..], &["--body", "bus"]] {
        assert_usage("", &[body, &everywhere[..]].concat(), &both);
    }
    #[cfg(feature = "sim")]
    assert_usage("", &[&["--world", "empty"][..], &everywhere[..]].concat(), &both);
    assert_usage(
        "",
        &["--attach", "--metrics", "0.0.0.0:0"],
        &["--metrics", "--insecure"],
    );
}

#[test]
fn the_security_of_a_deployment_file_holds() {
    let file = ["--attach", "--deployment", "site.toml"];
    let mtls = "[security]\nprofile = \"mtls\"\n[robots.tiago]\n";
    assert_usage(mtls, &file, &["security.profile is mtls", "ZENAV_IDENTITY"]);
    let keys = "[security]\nidentity = \"no-keys\"\n[robots.tiago]\n";
    assert_usage(keys, &file, &["identity no-keys", "zenav keys issue"]);
    // A flag wins over the file.
    let flag = ["--identity", "other-keys"];
    assert_usage(keys, &[&file[..], &flag].concat(), &["identity other-keys"]);
}

#[test]
fn a_model_in_a_deployment_file_is_a_file_beside_it() {
    let folder = TempDir::new().unwrap();
    let site = folder.path().join("site");
    std::fs::create_dir(&site).unwrap();
    std::fs::write(site.join("site.toml"), "[robots.tiago]\nmodel = \"mine.toml\"\n").unwrap();
    std::fs::write(site.join("mine.toml"), "wheels = 3\n").unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_zenav-edge"))
        .args(["--attach", "--deployment", "site/site.toml"])
        .current_dir(folder.path())
        .env_remove("ZENAV_IDENTITY")
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(i32::from(exit_code::USAGE)), "{text}");
    assert!(text.contains("mine.toml") && text.contains("wheels"), "{text}");
}
