//! Can a recorded run be read, replayed byte for byte, recomputed and reported, also if the recorder was killed? With real processes.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::Value;
use zenav::record::{Kind, RecordReader, Sample};
use zenav_protocol::bus::{Bus, BusConfig};
use zenav_protocol::messages::{GoalPhase, GoalState};
use zenav_protocol::topics;
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::process::{Process, free_endpoint, run};

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait, wall time.
const LIMIT: Duration = Duration::from_secs(60);
const ENDED: &str = "ended.mcap";
const KILLED: &str = "killed.mcap";

/// A drive with two recorders, one of which is killed, and the output of the other one.
struct Drive {
    deployment: Deployment,
    _running: Vec<Process>,
    summary: String,
}

fn recorder(deployment: &Deployment, file: &str) -> Process {
    let arguments = ["record", "--connect", &deployment.router, "-o", "json", file];
    let mut recorder = Process::start(ZENAV, &arguments, deployment.folder());
    let begun = Instant::now();
    while !recorder.log().contains("recording") {
        recorder.assert_running();
        assert!(begun.elapsed() < LIMIT, "the recorder begins");
        std::thread::park_timeout(Duration::from_millis(20));
    }
    recorder
}

impl Drive {
    fn new() -> Self {
        let deployment = Deployment::new(ZENAV, "kitchen", 3.0);
        let mut running = vec![deployment.start_router()];
        wait_for(&deployment.router);
        // Started before the robot: a map can only be recomputed from its beginning.
        let (mut ended, mut killed) = (recorder(&deployment, ENDED), recorder(&deployment, KILLED));
        running.push(deployment.start_edge());
        running.push(deployment.start_cloud());
        let goal = deployment.client(&[
            "goal",
            "submit",
            "0.88",
            "0.09",
            "--id",
            "there",
            "--wait",
            "--timeout",
            "50",
        ]);
        assert_eq!(goal.status.code(), Some(0), "{goal:?}");
        killed.kill();
        let code = ended.interrupt(LIMIT);
        assert_eq!(code, Ok(0), "{}", ended.log());
        Self {
            summary: ended.log(),
            deployment,
            _running: running,
        }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.deployment.folder().join(name)
    }

    /// Runs `zenav` on the record; exit code, and both outputs.
    fn zenav(&self, arguments: &[&str]) -> (i32, String, String) {
        let output = run(ZENAV, arguments, self.deployment.folder(), LIMIT);
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (
            output.status.code().unwrap_or(-1),
            text(&output.stdout),
            text(&output.stderr),
        )
    }
}

/// Waits until an endpoint accepts connections.
fn wait_for(endpoint: &str) {
    let address = endpoint.trim_start_matches("tcp/");
    let begun = Instant::now();
    while std::net::TcpStream::connect(address).is_err() {
        assert!(begun.elapsed() < LIMIT, "a router listens");
        std::thread::park_timeout(Duration::from_millis(20));
    }
}

fn read(path: &Path) -> (Vec<Sample>, bool) {
    let mut reader = RecordReader::open(path).unwrap();
    let mut samples = Vec::new();
    while let Some(sample) = reader.next_sample().unwrap() {
        samples.push(sample);
    }
    (samples, reader.is_cut_off())
}

/// The payloads of each key, in order.
fn payloads(samples: &[Sample]) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut keys = BTreeMap::<String, Vec<Vec<u8>>>::new();
    for sample in samples.iter().filter(|sample| sample.kind == Kind::Put) {
        keys.entry(sample.key.clone()).or_default().push(sample.bytes.clone());
    }
    keys
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_drive_is_recorded_read_replayed_computed_again_and_told() {
    let drive = tokio::task::block_in_place(Drive::new);
    let (samples, cut_off) = read(&drive.file(ENDED));
    assert!(!cut_off, "{}", drive.summary);
    let keys = payloads(&samples);
    for key in [
        "edge/scan",
        "edge/pose",
        "edge/event",
        "cloud/map_patch",
        "cloud/plan",
        "cloud/goal/there",
    ] {
        assert!(
            keys.contains_key(&format!("zenav/{ROBOT}/{key}")),
            "{key}: {:?}",
            keys.keys()
        );
    }
    let last = keys[&format!("zenav/{ROBOT}/cloud/goal/there")].last().unwrap();
    let last: GoalState = serde_json::from_slice(last).unwrap();
    assert_eq!(last.state, GoalPhase::Succeeded);
    assert!(
        samples.iter().any(|sample| sample.reply(&topics::EDGE_INFO).is_some()),
        "the robot's model is in the record"
    );
    // Samples are in order of arrival; answers to the recorder's own requests are interleaved.
    let heard: Vec<u64> = samples
        .iter()
        .filter(|sample| sample.kind != Kind::Reply)
        .map(|sample| sample.logged)
        .collect();
    assert!(heard.windows(2).all(|pair| pair[0] <= pair[1] + 50_000_000));

    // The record of a killed recorder lacks at most its last second.
    let (rest, cut_off) = read(&drive.file(KILLED));
    assert!(cut_off);
    let (end, rest_end) = (samples.last().unwrap().logged, rest.last().unwrap().logged);
    assert!(end.saturating_sub(rest_end) < 4_000_000_000, "{end} {rest_end}");
    let events = format!("zenav/{ROBOT}/edge/event");
    assert!(payloads(&rest)[&events].len() + 10 > keys[&events].len());

    // The robot is alive, so none of its keys may be published.
    let router = drive.deployment.router.clone();
    let (code, _, why) = drive.zenav(&["replay", ENDED, "--connect", &router]);
    assert_eq!(code, 7, "{why}");
    assert!(why.contains(ROBOT) && why.contains("--to-live-robot"), "{why}");

    // Beyond its end there is nothing to publish.
    let (code, _, why) = drive.zenav(&["replay", ENDED, "--connect", &router, "--from", "9999"]);
    assert!(
        code == 3 && why.contains("nothing of that in the record, which lasts "),
        "{code} {why}"
    );

    // The recorded scans give the recorded map, and the recorded requests give the recorded trajectories.
    let (code, told, why) = drive.zenav(&["replay", ENDED, "--recompute", "mapping,motion", "-o", "json"]);
    let told: Value = serde_json::from_str(&told).unwrap_or_else(|error| panic!("{error}: {told} {why}"));
    assert_eq!(code, 0, "{told:#}\n{why}");
    assert_eq!(told["maps"][0]["identical"], true, "{told:#}");
    for worker in told["motion"].as_array().unwrap() {
        assert_eq!(worker["identical"], true, "{told:#}");
        assert_eq!(worker["same"], worker["requests"], "{told:#}");
    }

    // A record does not differ from itself.
    let (code, told, why) = drive.zenav(&["diff", ENDED, ENDED, "-o", "json"]);
    let told: Value = serde_json::from_str(&told).unwrap_or_else(|error| panic!("{error}: {told} {why}"));
    assert_eq!((code, &told["largest"]), (0, &serde_json::json!([])), "{told:#}");
    assert_eq!(told["robots"][0]["goals"][0]["a"], "succeeded", "{told:#}");

    // Reported as one self-contained page.
    let (code, _, why) = drive.zenav(&["report", ENDED, "--out", "page.html"]);
    assert_eq!(code, 0, "{why}");
    let page = std::fs::read_to_string(drive.file("page.html")).unwrap();
    assert!(page.len() < 1_000_000, "{} bytes", page.len());
    for part in [
        "<svg class=\"floor\"",
        "data:image/png",
        "Speed, m/s",
        "Clearance, m",
        "Behaviour tree",
        "succeeded",
        "0.88, 0.09 <span class=\"soft\">there</span>",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("<script") && !page.contains("http"));

    replayed(&drive, &keys).await;
}

/// On another router everything is replayed byte for byte, in order, and not early.
async fn replayed(drive: &Drive, keys: &BTreeMap<String, Vec<Vec<u8>>>) {
    const SPEED: f64 = 4.0;
    let endpoint = free_endpoint();
    let _router = Process::start(ZENAV, &["router", "--listen", &endpoint], drive.deployment.folder());
    let bus = tokio::time::timeout(LIMIT, Bus::open(BusConfig::service("listener", &endpoint)))
        .await
        .unwrap()
        .unwrap();
    let mut tap = bus.tap(&["**".to_owned()], 256 << 20).unwrap();
    let begun = Instant::now();
    let speed = SPEED.to_string();
    let arguments = ["replay", ENDED, "--connect", &endpoint, "--speed", &speed, "-o", "json"];
    let (code, told, why) = tokio::task::block_in_place(|| drive.zenav(&arguments));
    let took = begun.elapsed();
    assert_eq!(code, 0, "{why}");
    let told: Value = serde_json::from_str(&told).unwrap();
    assert!(
        took.as_secs_f64() >= told["secs"].as_f64().unwrap() / SPEED,
        "{took:?} {told}"
    );
    let mut heard = BTreeMap::<String, Vec<Vec<u8>>>::new();
    while let Ok(Some(tapped)) = tokio::time::timeout(Duration::from_secs(2), tap.next()).await {
        heard.entry(tapped.sample.key).or_default().push(tapped.sample.bytes);
    }
    assert_eq!(tap.dropped(), 0);
    assert_eq!(heard.keys().collect::<Vec<_>>(), keys.keys().collect::<Vec<_>>());
    for (key, recorded) in keys {
        let heard = &heard[key];
        // Samples with congestion control "drop" may be lost on a loaded machine; the order stays.
        let mut rest = recorded.iter();
        assert!(heard.iter().all(|one| rest.any(|other| other == one)), "{key}");
        let must_be_whole = ["/cloud/", "/edge/event"].iter().any(|part| key.contains(part));
        let least = if must_be_whole {
            recorded.len()
        } else {
            recorded.len() * 9 / 10
        };
        assert!(heard.len() >= least, "{key}: {} of {}", heard.len(), recorded.len());
    }
    bus.close().await;
}

/// A Python with the package `mcap`: `PYTHON`, otherwise `python3`.
fn python() -> PathBuf {
    let python = PathBuf::from(std::env::var_os("PYTHON").unwrap_or_else(|| "python3".into()));
    let check = Command::new(&python).args(["-c", "import mcap"]).output();
    let name = python.display();
    let check = check.unwrap_or_else(|error| panic!("`{name}` does not run: {error}; set PYTHON"));
    assert!(
        check.status.success(),
        "`{name}` has no module mcap: {name} -m pip install mcap"
    );
    python
}

#[test]
#[ignore = "needs a Python with mcap, which .ci/run installs: PYTHON=… cargo test -p zenav-tests --test records -- --ignored"]
fn the_python_library_for_mcap_reads_every_message_of_a_record() {
    let python = python();
    let drive = Drive::new();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/records/read.py");
    let output = run(&python, &[script, ENDED, KILLED], drive.deployment.folder(), LIMIT);
    let errors = String::from_utf8_lossy(&output.stderr);
    let told: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {errors}"));
    let ended = &told["ended"];
    assert_eq!(ended["profile"], "zenav");
    assert_eq!(ended["metadata"]["zenav"]["format"], "1");
    let (samples, _) = read(&drive.file(ENDED));
    for (key, recorded) in payloads(&samples) {
        assert_eq!(ended["topics"][&key], recorded.len(), "{key}");
    }
    for (topic, schema) in [
        (format!("/{ROBOT}/scan"), "foxglove.LaserScan"),
        (format!("/{ROBOT}/map"), "foxglove.Grid"),
        (format!("/{ROBOT}/pose"), "foxglove.PoseInFrame"),
        ("/tf".to_owned(), "foxglove.FrameTransforms"),
        (format!("/{ROBOT}/footprint"), "foxglove.SceneUpdate"),
        (format!("/{ROBOT}/plan"), "foxglove.SceneUpdate"),
        (format!("/{ROBOT}/scene"), "foxglove.SceneUpdate"),
        (format!("/{ROBOT}/log"), "foxglove.Log"),
        (format!("zenav/{ROBOT}/edge/scan"), "zenav.Scan"),
    ] {
        assert_eq!(ended["schemas"][&topic], schema, "{topic}");
    }
    assert_eq!(told["killed"]["was_cut_off"], true);
    assert!(told["killed"]["messages"].as_u64().unwrap() > samples.len() as u64 / 2);
}
