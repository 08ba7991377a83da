//! Does a deployment of many hosts work when started as `zenav deploy render` writes it? As containers of the compose file if there is an
//! engine, otherwise with the units' commands in network namespaces; if neither is possible, the test fails.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::io::Write as _;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::messages::InfoReply;
use zenav_protocol::topics;
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::hosts::{self, trial};
use zenav_tests::process::{Process, free_endpoint, run};

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait, wall time: far longer than needed even on a busy machine.
const LONG: Duration = Duration::from_secs(60);

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn three_robots_finish_their_missions_while_parts_die_freeze_are_cut_off_and_replaced() {
    let begun = Instant::now();
    let mut site = tokio::task::block_in_place(|| hosts::open(Path::new(ZENAV), 1.0)).unwrap();
    // Not by `println`, which shows nothing of a test that passes.
    let _ = writeln!(std::io::stderr(), "a deployment of many hosts: {}", site.kind());
    let findings = trial::run(site.as_mut(), trial::short(), begun).await.unwrap();
    println!("{findings:#?}");
    // Pauses of the robot are judged by `acceptance compose`: here other tests share the processors.
    let lost: Vec<&String> = findings
        .failures
        .iter()
        .filter(|failure| !failure.contains(" rested for "))
        .collect();
    assert!(lost.is_empty(), "{findings:#?}");
    assert!(findings.rows.iter().all(|row| row.rest < 30.0), "{findings:#?}");
}

/// A deployment file, rendered by the binary under test.
fn rendered(folder: &Path) -> PathBuf {
    let sources = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../deploy/src/hosts/tests/fleet.toml");
    std::fs::copy(sources, folder.join("fleet.toml")).unwrap();
    let output = run(ZENAV, &["deploy", "render", "fleet.toml", "--out", "out"], folder, LONG);
    assert!(output.status.success(), "{output:?}");
    folder.join("out")
}

/// Files below a folder with this ending.
fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for path in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if path.is_dir() {
            found.extend(files(&path, ending));
        } else if path.to_string_lossy().ends_with(ending) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Largest exposure level accepted from `systemd-analyze security`, of 100.
const EXPOSED: &str = "--threshold=20";

/// Needs `systemd-analyze`: `.ci/run` installs it.
#[test]
#[ignore = "needs systemd-analyze"]
fn systemd_accepts_every_unit_without_a_word_and_finds_little_exposed() {
    let folder = tempfile::tempdir().unwrap();
    let units = files(&rendered(folder.path()), ".service");
    assert_eq!(units.len(), 15);
    for unit in units {
        // The binary is not installed here.
        let text = std::fs::read_to_string(&unit).unwrap().replace("/usr/bin/zenav", ZENAV);
        std::fs::write(&unit, text).unwrap();
        let path = unit.to_string_lossy().into_owned();
        for arguments in [&["verify", &path][..], &["security", "--offline=yes", EXPOSED, &path]] {
            let output = run("systemd-analyze", arguments, folder.path(), LONG);
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(
                output.status.success() && said.is_empty(),
                "{arguments:?}: {said}\n{}",
                String::from_utf8_lossy(&output.stdout)
            );
        }
    }
}

/// Needs a Python with `kubernetes-validate`, which includes the schemas: `.ci/run` has one.
#[test]
#[ignore = "needs Python with kubernetes-validate"]
fn every_manifest_is_valid_by_the_strict_schemas_of_kubernetes() {
    let folder = tempfile::tempdir().unwrap();
    let kubernetes = rendered(folder.path()).join("kubernetes");
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let manifests = files(&kubernetes, ".yaml");
    assert!(manifests.len() > 10, "{manifests:?}");
    let manifests: Vec<String> = manifests
        .iter()
        .map(|path| path.to_string_lossy().into_owned())
        .collect();
    // Kustomize's own file is not a cluster resource.
    let resources = manifests.iter().filter(|path| !path.ends_with("kustomization.yaml"));
    for resource in resources {
        let output = run(
            &python,
            &["-m", "kubernetes_validate", "--strict", resource],
            folder.path(),
            LONG,
        );
        assert!(output.status.success(), "{resource}: {output:?}");
    }
    let kustomization = std::fs::read_to_string(kubernetes.join("kustomization.yaml")).unwrap();
    for name in kustomization
        .lines()
        .filter_map(|line| line.trim().strip_prefix("- "))
        .filter(|name| name.ends_with(".yaml"))
    {
        assert!(kubernetes.join(name).is_file(), "kustomization.yaml names {name}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn mission_and_mapping_refuse_a_robot_of_another_schema_and_name_both_versions() {
    let deployment = Deployment::new(ZENAV, "kitchen", 1.0);
    let _router = deployment.start_router();
    let bus = deployment.bus().await;
    let mut newer = bus.serve(&topics::EDGE_INFO, &[ROBOT]).unwrap();
    let serving = tokio::spawn(async move {
        while let Some(request) = newer.next().await {
            request.reply(&InfoReply {
                component: "edge".into(),
                version: "9.9.9".into(),
                schema: SCHEMA_VERSION + 1,
                ..InfoReply::default()
            });
        }
    });
    for service in ["mission", "mapping"] {
        let mut part = deployment.start_service(service);
        let line = part.until("speaks schema", LONG);
        for version in [
            "9.9.9".to_owned(),
            format!("schema {}", SCHEMA_VERSION + 1),
            format!("schema {SCHEMA_VERSION}"),
        ] {
            assert!(line.contains(&version), "{version}: {line}");
        }
    }
    serving.abort();
}

/// A part under a test service manager: its notifications arrive at the socket.
fn supervised(folder: &Path, name: &str, arguments: &[&str]) -> (Process, UnixDatagram) {
    let socket = folder.join(name);
    let heard = UnixDatagram::bind(&socket).unwrap();
    heard.set_read_timeout(Some(LONG)).unwrap();
    let notify = format!("NOTIFY_SOCKET={}", socket.display());
    let line = [&[notify.as_str(), "WATCHDOG_USEC=200000", ZENAV][..], arguments].concat();
    (Process::start("env", &line, folder), heard)
}

fn next(heard: &UnixDatagram) -> String {
    let mut bytes = [0; 512];
    let length = heard.recv(&mut bytes).expect("the part says something in time");
    String::from_utf8_lossy(&bytes[..length]).trim().to_owned()
}

#[test]
fn a_part_tells_its_service_manager_when_it_is_ready_that_it_lives_and_when_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = free_endpoint();
    let motion = ["cloud", "motion", "--connect", &endpoint];
    let (worker, of_worker) = supervised(folder.path(), "worker", &motion);
    let (mut router, of_router) = supervised(folder.path(), "router", &["router", "--listen", &endpoint]);
    assert_eq!(next(&of_router), "READY=1");
    assert_eq!(next(&of_router), "WATCHDOG=1");
    assert_eq!(next(&of_worker), "READY=1", "it has met a router");
    assert_eq!(next(&of_worker), "WATCHDOG=1");

    // A frozen part stops feeding its watchdog.
    worker.pause().unwrap();
    of_worker.set_nonblocking(true).unwrap();
    let mut bytes = [0; 512];
    while of_worker.recv(&mut bytes).is_ok() {}
    let beats = (0..5).filter(|_| next(&of_router) == "WATCHDOG=1").count();
    assert_eq!(beats, 5);
    assert!(
        of_worker.recv(&mut bytes).is_err(),
        "a frozen part has beaten its watchdog"
    );
    worker.resume().unwrap();

    assert_eq!(router.interrupt(LONG), Ok(0));
    let last = std::iter::repeat_with(|| next(&of_router)).find(|said| said != "WATCHDOG=1");
    assert_eq!(last.as_deref(), Some("STOPPING=1"));
}
