//! Does the gateway conform to its own OpenAPI document for any request? Checked by schemathesis, which generates requests from the
//! document, against a running deployment.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use zenav_tests::deployment::Deployment;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");

#[test]
#[ignore = "needs a Python with schemathesis; .ci/run installs it and names the Python in PYTHON"]
fn schemathesis_finds_nothing() {
    let deployment = Deployment::new(ZENAV, "kitchen", 1.0);
    let mut up = deployment.start_up_with(&["--gateway", "127.0.0.1:0"]);
    let line = up.until("mission control: ", Duration::from_secs(60));
    let (_, address) = line.split_once("mission control: ").unwrap();
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("schemathesis.toml");
    let run = Command::new(python)
        .args(["-m", "schemathesis.cli", "--config-file"])
        .arg(config)
        .args([
            "run",
            &format!("{address}api/v1/openapi.json"),
            "--max-examples",
            "20",
            "--no-color",
        ])
        .current_dir(deployment.folder())
        .output()
        .expect("PYTHON: a Python");
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success(), "{said}\n{}", String::from_utf8_lossy(&run.stderr));
    up.assert_running();
}
