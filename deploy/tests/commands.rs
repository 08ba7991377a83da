//! Answers and exit codes of the commands: the binary itself against small fake robots on the test's own router.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod fake;

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use fake::{Fake, router};
use serde_json::Value;

/// Exit code and output.
struct Answer {
    code: i32,
    out: String,
    err: String,
}

impl Answer {
    fn of(output: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self {
            code: output.status.code().unwrap_or(-1),
            out: text(&output.stdout),
            err: text(&output.stderr),
        }
    }

    #[track_caller]
    fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, code, "stdout: {}\nstderr: {}", self.out, self.err);
        self
    }

    fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|error| panic!("{error}: {}", self.out))
    }
}

fn command(endpoint: &str, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_zenav"));
    command
        .args(line.split(' '))
        .args(["--connect", endpoint])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// A command, which must end with this exit code.
async fn zenav(endpoint: &str, line: &str, code: i32) -> Answer {
    let mut command = command(endpoint, line);
    let output = tokio::task::spawn_blocking(move || command.output().unwrap());
    let ended = tokio::time::timeout(Duration::from_secs(60), output).await;
    let answer = Answer::of(&ended.expect("the command ends").unwrap());
    assert_eq!(
        answer.code, code,
        "{line}\nstdout: {}\nstderr: {}",
        answer.out, answer.err
    );
    answer
}

/// A command that needs no bus.
fn offline(line: &str) -> Answer {
    let mut command = Command::new(env!("CARGO_BIN_EXE_zenav"));
    Answer::of(&command.args(line.split(' ')).output().unwrap())
}

#[test]
fn a_map_whose_unknown_cells_become_free_is_warned_of_once() {
    let folder = tempfile::tempdir().unwrap();
    let (image, yaml) = (folder.path().join("hall.pgm"), folder.path().join("hall.yaml"));
    std::fs::write(image, "P2 3 1 255 205 254 205").unwrap();
    let show = |threshold: &str| {
        let text = format!("image: hall.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nfree_thresh: {threshold}\n");
        std::fs::write(&yaml, text).unwrap();
        offline(&format!("map show {}", yaml.display())).expect(0)
    };
    let shown = show("0.25");
    let warned = shown.err.matches("hall.yaml:4: `free_thresh` 0.25 makes 2 cells free");
    assert_eq!(warned.count(), 1, "{}", shown.err);
    assert!(
        shown.err.contains("`free_thresh: 0.196` keeps them unknown"),
        "{}",
        shown.err
    );
    assert!(shown.out.contains("3 free, 0 unknown"), "{}", shown.out);
    assert!(!show("0.196").err.contains("free_thresh"));
    // In scale mode no threshold helps.
    let scaled = show("0.196\nmode: scale");
    let told = "hall.yaml:5: `mode: scale` makes 2 cells free";
    let remedy = "`mode: trinary` with `free_thresh: 0.196` keeps them unknown";
    assert!(
        scaled.err.contains(told) && scaled.err.contains(remedy),
        "{}",
        scaled.err
    );
}

#[cfg(target_os = "linux")]
#[test]
fn a_run_is_reported_although_its_trajectory_cannot_be_stored() {
    let ran = offline("run --world empty --goal 0.5 0 --known-map --trajectory /dev/full");
    assert!(
        ran.code != 0 && ran.out.starts_with("Reached"),
        "{}{}",
        ran.out,
        ran.err
    );
    assert!(ran.err.contains("/dev/full"), "{}", ran.err);
}

#[test]
fn an_endpoint_that_is_in_use_is_told_with_what_may_have_it() {
    let other = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", other.local_addr().unwrap());
    let refused = offline(&format!("router --listen {endpoint}")).expect(1);
    let told = format!("cannot listen on {endpoint}: in use, perhaps by another `zenav up`");
    assert!(refused.err.contains(&told), "{}", refused.err);
}

#[cfg(unix)]
#[test]
fn ctrl_c_at_the_start_of_a_demonstration_leaves_no_files_behind() {
    use std::io::{BufRead as _, BufReader};
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut demo = Command::new(env!("CARGO_BIN_EXE_zenav"))
        .args([
            "demo",
            "kitchen",
            "--no-ui",
            "--no-gateway",
            "--out",
            out.to_str().unwrap(),
        ])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(demo.stderr.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("waiting for the parts")));
    let interrupt = Command::new("kill").args(["-INT", &demo.id().to_string()]).status();
    assert!(interrupt.unwrap().success());
    // Read to the end: a full pipe would hold the process up.
    let last = lines.map_while(Result::ok).last();
    assert_eq!(demo.wait().unwrap().code(), Some(130), "{last:?}");
    let left: Vec<_> = std::fs::read_dir(&out).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_is_waited_for_and_its_end_is_the_exit_code() {
    let (_router, endpoint) = router().await;
    let _fake = Fake::start(&endpoint, "r1").await;
    let answer = zenav(&endpoint, "goal submit -1.46 -3.12 --wait -o json", 0).await;
    let end = answer.json();
    assert_eq!(
        (end["state"].as_str(), end["reason"].is_null()),
        (Some("Succeeded"), true)
    );
    assert!(end["id"].as_str().unwrap().starts_with("goal-"));
    let blocked = zenav(&endpoint, "goal submit --place blocked --wait -o json", 1).await;
    assert_eq!(blocked.json()["reason"], "blocked");
    zenav(&endpoint, "goal submit --place canceled --wait", 6).await;
    let refused = zenav(&endpoint, "goal submit 99 0 -o json", 7).await.json();
    assert_eq!(
        (refused["state"].as_str(), refused["nearest_free"]["x"].as_f64()),
        (Some("Rejected"), Some(2.0))
    );
    let known = zenav(&endpoint, "goal list -o json", 0).await.json();
    assert_eq!(known.as_array().unwrap().len(), 3);
    zenav(&endpoint, &format!("goal watch {}", end["id"].as_str().unwrap()), 0).await;
    zenav(&endpoint, "goal watch nope", 3).await;
    zenav(&endpoint, "goal cancel nope", 3).await;
    zenav(&endpoint, "goal submit NaN 0", 2).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_sent_twice_by_one_id_is_one_goal() {
    let (_router, endpoint) = router().await;
    let _fake = Fake::start(&endpoint, "r1").await;
    for _ in 0..2 {
        zenav(&endpoint, "goal submit 1 2 --id mine", 0).await;
    }
    let goals = zenav(&endpoint, "goal list -o json", 0).await.json();
    assert_eq!(goals.as_array().unwrap().len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_goals_of_all_robots_are_listed_each_with_its_robot() {
    let (_router, endpoint) = router().await;
    let _one = Fake::start(&endpoint, "r1").await;
    let _two = Fake::start(&endpoint, "r2").await;
    for robot in ["r1", "r2"] {
        zenav(&endpoint, &format!("goal submit 1 2 --id {robot} --robot {robot}"), 0).await;
    }
    let listed = zenav(&endpoint, "goal list", 0).await.out;
    for start in ["ID  ROBOT  STATE ", "r1  r1 ", "r2  r2 "] {
        assert!(listed.lines().any(|line| line.starts_with(start)), "{start}: {listed}");
    }
    assert!(listed.contains("AGE"), "{listed}");
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_detaches_from_a_goal_and_does_not_cancel_it() {
    use std::io::{BufRead as _, BufReader};
    let (_router, endpoint) = router().await;
    let _fake = Fake::start(&endpoint, "r1").await;
    let mut child: Child = command(&endpoint, "goal submit --place forever --id long --wait")
        .spawn()
        .unwrap();
    // Printed once the goal is accepted: from then on Ctrl-C detaches.
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let output = tokio::task::spawn_blocking(move || {
        assert!(lines.any(|line| line.unwrap().contains("Active")));
        assert!(
            Command::new("kill")
                .args(["-INT", &child.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
        let detached = lines.any(|line| line.unwrap().contains("detached"));
        (child.wait().unwrap().code(), detached)
    });
    assert_eq!(output.await.unwrap(), (Some(130), true));
    let goals = zenav(&endpoint, "goal list -o json", 0).await.json();
    assert_eq!(goals[0]["state"], "Active");
    let canceled = zenav(&endpoint, "goal cancel -o json", 0).await.json();
    assert_eq!(canceled["id"], "long");
    zenav(&endpoint, "goal watch long", 6).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_robot_meant_is_found_or_the_answer_names_those_that_there_are() {
    let (router, endpoint) = router().await;
    zenav(&endpoint, "goal list", 3).await;
    let _one = Fake::start(&endpoint, "r1").await;
    zenav(&endpoint, "stop", 0).await;
    let _two = Fake::start(&endpoint, "r2").await;
    let several = zenav(&endpoint, "stop", 2).await;
    assert!(several.err.contains("r1, r2"), "{}", several.err);
    let stopped = zenav(&endpoint, "stop --all -o json", 0).await.json();
    assert_eq!(stopped.as_array().unwrap().len(), 2);
    let unknown = zenav(&endpoint, "goal submit 1 2 --robot r9", 3).await;
    assert!(
        unknown.err.contains("r9") && unknown.err.contains("r1, r2"),
        "{}",
        unknown.err
    );
    zenav(&endpoint, "stop --robot r9", 3).await;
    zenav(&endpoint, "stop --robot a/b", 2).await;
    zenav("nonsense", "stop", 2).await;
    let mut by_environment = Command::new(env!("CARGO_BIN_EXE_zenav"));
    by_environment
        .args(["stop", "--robot", "r1"])
        .env("ZENAV_BUS__CONNECT", &endpoint);
    let output = tokio::task::spawn_blocking(move || by_environment.output().unwrap());
    Answer::of(&output.await.unwrap()).expect(0);
    router.close().await;
    let gone = zenav(&endpoint, "goal list", 4).await;
    assert!(gone.err.contains(&endpoint), "{}", gone.err);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_takes_the_lease_and_another_is_refused_meanwhile() {
    let (_router, endpoint) = router().await;
    let _fake = Fake::start(&endpoint, "r1").await;
    let mut first = command(&endpoint, "lease acquire --holder me --for 600")
        .spawn()
        .unwrap();
    let told = {
        use std::io::{BufRead as _, BufReader};
        let mut lines = BufReader::new(first.stdout.take().unwrap()).lines();
        tokio::task::spawn_blocking(move || lines.next().unwrap().unwrap())
            .await
            .unwrap()
    };
    assert!(told.contains("me may command r1"), "{told}");
    let lease = zenav(&endpoint, "lease -o json", 0).await.json();
    assert_eq!(lease["holder"], "me");
    zenav(&endpoint, "lease acquire --holder other", 7).await;
    zenav(&endpoint, "lease release --holder other", 3).await;
    first.kill().unwrap();
    first.wait().unwrap();
    zenav(&endpoint, "lease release --holder me", 0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn topics_are_printed_as_they_are_and_measured() {
    let (_router, endpoint) = router().await;
    let _fake = Fake::start(&endpoint, "r1").await;
    let echo = zenav(&endpoint, "topic echo zenav/r1/edge/state --count 2", 0).await;
    assert_eq!(
        echo.out
            .lines()
            .filter(|line| serde_json::from_str::<Value>(line).unwrap()["boot_id"] == "b")
            .count(),
        2
    );
    let stream = zenav(&endpoint, "topic echo state --count 2 -o json", 0).await;
    let whole = |line: &str| serde_json::from_str::<Value>(line).is_ok();
    assert!(stream.out.lines().all(whole), "an object a line: {}", stream.out);
    // A retained message; CBOR is shown as JSON.
    let patch = zenav(&endpoint, "topic echo map_patch --count 1 -o ndjson", 0)
        .await
        .json();
    assert_eq!(patch["payload"]["tiles"][0]["values"], serde_json::json!([-1, 0, 100]));
    let hz = zenav(&endpoint, "topic hz state --count 20 -o json", 0).await.json();
    assert!(hz[0]["hz"].as_f64().unwrap() > 1.0, "{hz}");
    let lines = zenav(&endpoint, "topic hz state --for 5", 0).await.out;
    assert!(lines.lines().count() >= 3, "one each second, and the last: {lines}");
    zenav(&endpoint, "topic hz heartbeat --for 0.3", 5).await;
    zenav(&endpoint, "topic echo nothing", 3).await;
    let list = zenav(&endpoint, "topic list -o json", 0).await.json();
    let keys: Vec<&str> = list
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row["key"].as_str().unwrap())
        .collect();
    assert!(
        keys.contains(&"zenav/r1/edge/state") && keys.contains(&"zenav/r1/cloud/map"),
        "{keys:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_is_checked_against_its_key_however_the_key_is_written() {
    let (_router, endpoint) = router().await;
    let _fake = Fake::start(&endpoint, "r1").await;
    for key in ["zenav/r1/operator/teleop", "r1/operator/teleop", "operator/teleop"] {
        let refused = zenav(&endpoint, &format!("topic pub {key} {{}}"), 2).await;
        assert!(refused.err.contains("not a Teleop"), "{key}: {}", refused.err);
    }
    let foreign = zenav(&endpoint, "topic pub r1/lamp {}", 0).await;
    assert!(foreign.err.contains("r1/lamp is not a key of zenav"), "{}", foreign.err);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_is_not_there_is_not_recorded() {
    let (_router, endpoint) = router().await;
    let _fake = Fake::start(&endpoint, "r1").await;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.mcap");
    let record = |robot: &str| format!("record --for 1 {} --robot {robot}", file.display());
    let refused = zenav(&endpoint, &record("r9"), 3).await;
    assert!(refused.err.contains("no robot `r9`: there is r1"), "{}", refused.err);
    assert!(!file.exists());
    zenav(&endpoint, &record("r1"), 0).await;
    assert!(file.exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_saved_as_map_server_files_and_drawn() {
    let (_router, endpoint) = router().await;
    let _fake = Fake::start(&endpoint, "r1").await;
    let folder = tempfile::tempdir().unwrap();
    let name = folder.path().join("sub/kitchen");
    let saved = zenav(&endpoint, &format!("map save {} -o json", name.display()), 0)
        .await
        .json();
    assert_eq!(
        (saved["width"].as_u64(), saved["occupied"].as_u64()),
        (Some(10), Some(10))
    );
    assert!(Path::new(saved["file"].as_str().unwrap()).is_file() && name.with_extension("pgm").is_file());
    let drawn = zenav(
        &endpoint,
        &format!("map show {}", name.with_extension("yaml").display()),
        0,
    )
    .await;
    assert!(drawn.out.starts_with("▀▀▀▀▀▀▀▀▀▀\n"), "{}", drawn.out);
    let shown = zenav(&endpoint, "map show", 0).await.out;
    assert!(shown.contains("robot at (0.25, 0.13)"), "{shown}");
    zenav(&endpoint, "map show no/such.yaml", 3).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_doctor_finds_what_is_missing() {
    let (_router, endpoint) = router().await;
    let _fake = Fake::start(&endpoint, "r1").await;
    let report = zenav(&endpoint, "doctor -o json", 1).await.json();
    let verdict = |about: &str, check: &str| {
        let checks = report["checks"].as_array().unwrap();
        let found = checks
            .iter()
            .find(|found| found["about"] == about && found["check"] == check);
        found.unwrap_or_else(|| panic!("no {about} {check}: {report}"))["verdict"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    assert_eq!(
        (verdict("router", "link"), verdict("r1", "edge"), verdict("r1", "state")),
        ("ok".into(), "ok".into(), "ok".into())
    );
    assert_eq!(
        (
            verdict("r1", "mapping"),
            verdict("svc", "motion"),
            verdict("r1", "scan")
        ),
        ("fail".into(), "fail".into(), "fail".into())
    );
    zenav(&endpoint, "doctor --robot r9", 3).await;
}
