//! Can a program in another language be a robot's body? With real processes: a deployment whose only robot has the Python example as its
//! body.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::time::Duration;

use zenav_tests::process::{Process, free_endpoint, run};

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
const DEPLOYMENT: &str = r#"
[robots.own]
model = "neato"
driver = true
listen = "tcp/127.0.0.1:0"
"#;
/// Longest wait, wall time.
const LIMIT: Duration = Duration::from_secs(60);

#[test]
#[ignore = "needs a Python with eclipse-zenoh, which .ci/run installs: PYTHON=… cargo test -p zenav-tests --test own_body -- --ignored"]
fn the_python_example_is_driven_to_a_goal_and_without_it_the_robot_is_at_rest() {
    let python = std::env::var_os("PYTHON").unwrap_or_else(|| "python3".into());
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("own_body.toml"), DEPLOYMENT).unwrap();
    let router = free_endpoint();
    let up = ["up", "own_body.toml", "--no-gateway", "--listen", &router];
    let mut up = Process::start(ZENAV, &up, folder.path());
    up.until("router up", LIMIT);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../edge/examples/body.py");
    let body = Process::start(&python, &[script, "own", &router], folder.path());
    up.until("ready in", LIMIT);
    let goal = [
        "goal",
        "submit",
        "1.2",
        "0.8",
        "--wait",
        "--timeout",
        "30",
        "--connect",
        &router,
    ];
    let goal = run(ZENAV, &goal, folder.path(), LIMIT);
    assert!(goal.status.success(), "{goal:?}\n{}", up.log());
    drop(body);
    up.until("no readings", LIMIT);
}
