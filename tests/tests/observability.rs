//! Does every part report its health? Metrics, readiness and logs of real processes; the dashboard and the alert rules against the
//! declared metrics.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::Value;
use zenav_observability::{Kind, metrics};
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::http::{Answer, request};
use zenav_tests::observer::Observer;
use zenav_tests::process::Process;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest wait, wall time: far longer than needed even on a busy machine.
const LONG: Duration = Duration::from_secs(60);
/// The health endpoint on a free port.
const METRICS: [&str; 2] = ["--metrics", "127.0.0.1:0"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

/// Address of the health endpoint that a process logs.
fn address(process: &mut Process) -> String {
    let line = process.until("health: http://", LONG);
    line.split("http://")
        .nth(1)
        .unwrap()
        .split('/')
        .next()
        .unwrap()
        .to_owned()
}

fn get(address: &str, path: &str) -> Answer {
    request(address, "GET", path, address)
}

/// Waits until `/readyz` gives the expected answer.
fn readiness(address: &str, what: &str, fits: impl Fn(u16, &str) -> bool) -> String {
    let deadline = Instant::now() + LONG;
    loop {
        let answer = get(address, "/readyz");
        let text = answer.text();
        if fits(answer.status, &text) {
            return text;
        }
        assert!(Instant::now() < deadline, "{what}: {}\n{text}", answer.status);
        std::thread::yield_now();
    }
}

/// Names of metrics in a PromQL expression, together with the names in its label matchers.
fn named(text: &str) -> BTreeSet<String> {
    let is_word = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
    text.split(|letter| !is_word(letter))
        .filter(|word| word.starts_with("zenav_") || word.starts_with("process_"))
        .map(str::to_owned)
        .collect()
}

/// Whether a name in PromQL belongs to a declared metric; a histogram has three names.
fn is_declared(name: &str) -> bool {
    metrics::TABLE.iter().any(|row| match row.kind {
        Kind::Histogram => ["_bucket", "_sum", "_count"]
            .iter()
            .any(|ending| name.strip_suffix(ending) == Some(row.name)),
        Kind::Counter | Kind::Gauge => name == row.name,
    })
}

/// Metric families of a scrape: type, and total count of each.
fn families(text: &str) -> BTreeMap<String, (String, f64)> {
    let mut found = BTreeMap::new();
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("# TYPE ") {
            let (name, kind) = rest.split_once(' ').unwrap();
            found.insert(name.to_owned(), (kind.to_owned(), 0.0));
        } else if !line.starts_with('#') {
            let (series, value) = line.rsplit_once(' ').unwrap();
            let name = series.split('{').next().unwrap();
            let name = name.strip_suffix("_count").unwrap_or(name);
            if let Some((_, sum)) = found.get_mut(name) {
                *sum += value.parse::<f64>().unwrap();
            }
        }
    }
    found
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_declared_metric_shows_in_a_scrape_of_a_robot_that_drove() {
    let deployment = Deployment::new(ZENAV, "kitchen", 8.0);
    let mut up = deployment.start_up_with(&METRICS);
    let health = address(&mut up);
    drop(deployment.bus().await);
    let goal = ["goal", "submit", "--wait", "-0.9", "-0.2"];
    let driven = deployment.client(&goal);
    assert_eq!(driven.status.code(), Some(0), "{driven:?}");
    let ready = readiness(&health, "all parts are ready", |status, _| status == 200);
    for part in ["edge-tiago", "mapping-tiago", "gateway", "zenav-router"] {
        assert!(ready.contains(&format!("ok      {part}: it has started")), "{ready}");
    }
    assert!(ready.contains("the mission of tiago leads, or stands by"), "{ready}");
    let mut found = families(&get(&health, "/metrics").text());

    // A served world has metrics of its own.
    let served = Deployment::new(ZENAV, "kitchen", 1.0);
    let arguments = ["sim", "serve", "--listen", &served.router, METRICS[0], METRICS[1]];
    let mut sim = Process::start(ZENAV, &arguments, served.folder());
    let world = address(&mut sim);
    readiness(&world, "the world is served", |status, _| status == 200);
    found.extend(
        families(&get(&world, "/metrics").text())
            .into_iter()
            .filter(|(name, _)| name.starts_with("zenav_world_")),
    );

    for row in metrics::TABLE {
        let (kind, sum) = found
            .get(row.name)
            .unwrap_or_else(|| panic!("{} does not show", row.name));
        assert_eq!(kind, row.kind.name(), "{}", row.name);
        // Every stage that a scan or a goal passes was measured.
        assert!(
            row.kind != Kind::Histogram || *sum > 0.0,
            "{} measured nothing",
            row.name
        );
    }
    let declared: BTreeSet<&str> = metrics::TABLE.iter().map(|row| row.name).collect();
    for name in found.keys() {
        assert!(declared.contains(name.as_str()), "{name} is not declared");
    }
    for (name, least) in [
        ("zenav_goals_ended_total", 1.0),
        ("zenav_scans_total", 5.0),
        ("zenav_map_cells", 100.0),
        ("zenav_bus_messages_received_total", 100.0),
    ] {
        assert!(found[name].1 >= least, "{name}: {:?}", found[name]);
    }
    sim.assert_running();
    up.assert_running();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_part_says_what_it_waits_for_when_it_is_ready_and_when_its_router_goes_and_comes_back() {
    let deployment = Deployment::new(ZENAV, "kitchen", 1.0);
    let part = |part: &[&str]| {
        let arguments = [part, &["--connect", &deployment.router], &METRICS].concat();
        Process::start(ZENAV, &arguments, deployment.folder())
    };
    let services = ["mapping", "motion", "mission"];
    let mut parts: Vec<Process> = services
        .into_iter()
        .map(|service| part(&["cloud", service, "--data", service]))
        .collect();
    parts.push(part(&["gateway", "--listen", "127.0.0.1:0"]));
    // The only one that does not wait with everything else.
    parts.push(part(&["edge", "--listen", "tcp/127.0.0.1:0", "--data", "edge"]));
    let addresses: Vec<String> = parts.iter_mut().map(address).collect();
    for (part, health) in parts.iter_mut().zip(&addresses) {
        assert_eq!(get(health, "/livez").status, 200);
        let missing = readiness(health, "it waits for a router", |_, text| {
            text.contains("a router is linked")
        });
        assert!(missing.contains(": a router is linked\n"), "{missing}");
        assert_eq!(get(health, "/readyz").status, 503);
        part.assert_running();
    }
    for part in parts.iter_mut().rev().skip(1) {
        part.until("waits for a router", LONG);
    }
    let mut router = deployment.start_router();
    for (part, health) in parts.iter_mut().zip(&addresses) {
        part.until("ready", LONG);
        let lines = readiness(health, "it is ready", |status, _| status == 200);
        assert!(lines.lines().all(|line| line.starts_with("ok ")), "{lines}");
    }
    router.kill();
    for (part, health) in parts.iter_mut().zip(&addresses) {
        part.until("router lost", LONG);
        let lines = readiness(health, "its router is lost", |status, _| status == 503);
        assert!(lines.starts_with("missing "), "what is missing comes first: {lines}");
    }
    router = deployment.start_router();
    for (part, health) in parts.iter_mut().zip(&addresses) {
        part.until("router back", LONG);
        readiness(health, "it is ready again", |status, _| status == 200);
        let text = get(health, "/metrics").text();
        assert!(families(&text)["zenav_router_reconnects_total"].1 >= 1.0, "{text}");
    }
    router.assert_running();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn log_lines_in_json_name_part_robot_goal_and_plan() {
    let mut deployment = Deployment::new(ZENAV, "kitchen", 8.0);
    // Without this, only plans that are rejected are logged.
    deployment.logged = "info,zenav_edge=debug,zenoh=error";
    let mut up = deployment.start_up_with(&["--no-gateway", "--log-format", "json"]);
    let bus = deployment.bus().await;
    Observer::new(&bus, ROBOT)
        .until("a mission commands the robot", LONG, |state| state.lease.live)
        .await;
    let driven = deployment.client(&["goal", "submit", "--wait", "--id", "g-7", "-0.9", "-0.2"]);
    assert_eq!(driven.status.code(), Some(0), "{driven:?}");
    up.until("\"succeeded\"", LONG);
    let lines: Vec<Value> = up
        .log()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect();
    let has = |fields: &[(&str, &str)]| {
        lines
            .iter()
            .any(|line| fields.iter().all(|(name, value)| line[name] == *value))
    };
    for fields in [
        &[("level", "INFO"), ("message", "ready"), ("part", "mapping-tiago")][..],
        &[("message", "ready"), ("part", "edge-tiago")],
        &[("message", "lease"), ("robot", ROBOT)],
        &[
            ("message", "goal"),
            ("robot", ROBOT),
            ("goal", "g-7"),
            ("state", "succeeded"),
        ],
    ] {
        assert!(has(fields), "{fields:?}: {lines:#?}");
    }
    let is_accepted =
        |line: &Value| line["message"] == "plan accepted" && line["robot"] == ROBOT && line["goal"] == "g-7";
    let accepted = lines.iter().find(|line| is_accepted(line));
    assert!(accepted.is_some_and(|line| line["plan"].is_u64()), "{lines:#?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ps_lists_every_part_with_host_version_and_role_and_logs_what_each_said() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let mut up = deployment.start_up();
    let bus = deployment.bus().await;
    Observer::new(&bus, ROBOT)
        .until("a mission commands the robot", LONG, |state| state.lease.live)
        .await;
    let listed = deployment.client(&["ps", "-o", "json"]);
    assert_eq!(listed.status.code(), Some(0), "{listed:?}");
    let parts: Vec<Value> = serde_json::from_slice(&listed.stdout).unwrap();
    let components: BTreeSet<&str> = parts.iter().map(|part| part["component"].as_str().unwrap()).collect();
    for component in ["edge", "mapping", "mission", "motion", "gateway", "router"] {
        assert!(components.contains(component), "{component}: {parts:#?}");
    }
    for part in &parts {
        assert_eq!(part["version"], env!("CARGO_PKG_VERSION"), "{part}");
        assert_eq!(part["pid"], up.id(), "{part}");
        assert!(!part["host"].as_str().unwrap().is_empty(), "{part}");
        assert!(part["memory_bytes"].as_u64().unwrap() > 1_000_000, "{part}");
        assert!(part["load"].as_f64().unwrap() > 0.0, "{part}");
        // All parts run on one machine, with one clock.
        let off = part["clock_ahead_secs"].as_f64().unwrap().abs();
        assert!(
            off <= part["clock_uncertainty_secs"].as_f64().unwrap() + 0.001,
            "{part}"
        );
    }
    let leads = parts.iter().find(|part| part["component"] == "mission").unwrap();
    assert_eq!(leads["leads"], true);

    let said = deployment.client(&["logs", "--robot", ROBOT, "-o", "ndjson"]);
    assert_eq!(said.status.code(), Some(0), "{said:?}");
    let lines: Vec<Value> = String::from_utf8(said.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    for part in ["edge-tiago", "mapping-tiago"] {
        let ready = lines
            .iter()
            .filter(|line| line["message"] == "ready" && line["fields"]["part"] == part);
        assert_eq!(ready.count(), 1, "{lines:#?}");
    }
    up.assert_running();
}

/// The span of an export request.
fn span(line: &str) -> Value {
    let request: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
    request["resourceSpans"][0]["scopeSpans"][0]["spans"][0].clone()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_trace_follows_a_scan_from_the_lidar_to_the_wheels() {
    const WAY: [&str; 6] = [
        "scan published",
        "scan inserted",
        "map published",
        "motion request",
        "plan published",
        "plan to wheels",
    ];
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    // As on three machines: each process has a file of its own.
    let _router = deployment.start_router();
    let (router, own) = (deployment.router.as_str(), deployment.edge.as_str());
    let edge = ["edge", "--listen", own, "--speed", "4", "--trace", "edge.jsonl"];
    let cloud = ["cloud", "all", "--trace", "cloud.jsonl"];
    let mut parts = [(&edge[..], "edge"), (&cloud[..], "cloud")].map(|(part, data)| {
        let place = ["--connect", router, "--data", data, "--world", "kitchen"];
        Process::start(ZENAV, &[part, &place].concat(), deployment.folder())
    });
    let bus = deployment.bus().await;
    Observer::new(&bus, ROBOT)
        .until("a mission commands the robot", LONG, |state| state.lease.live)
        .await;
    let deadline = Instant::now() + LONG;
    // One scan per second is traced; the next motion request continues the newest trace.
    for y in ["-0.2", "0.3"].iter().cycle() {
        let driven = deployment.client(&["goal", "submit", "--wait", "-0.9", y]);
        assert_eq!(driven.status.code(), Some(0), "{driven:?}");
        let mut spans = Vec::new();
        for file in ["edge.jsonl", "cloud.jsonl"] {
            let text = std::fs::read_to_string(deployment.folder().join(file)).unwrap();
            let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
            spans.extend(whole.lines().map(span));
        }
        let parent = |child: &Value| {
            spans
                .iter()
                .find(|span| span["spanId"] == child["parentSpanId"] && span["traceId"] == child["traceId"])
        };
        let ways: Vec<Vec<&str>> = spans
            .iter()
            .filter(|span| span["name"] == WAY[5])
            .map(|last| {
                let mut way: Vec<&str> = std::iter::successors(Some(last), |span| parent(span))
                    .map(|span| span["name"].as_str().unwrap())
                    .collect();
                way.reverse();
                way
            })
            .collect();
        if ways.iter().any(|way| way == &WAY) {
            break;
        }
        assert!(Instant::now() < deadline, "{ways:?}");
    }
    parts.iter_mut().for_each(Process::assert_running);
}

#[test]
fn the_dashboard_shows_only_metrics_that_there_are_and_every_stage_of_the_data_way() {
    let text = std::fs::read_to_string(root().join("deploy/observability/grafana.json")).unwrap();
    let dashboard: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(dashboard["uid"], "zenav");
    let mut shown = BTreeSet::new();
    let mut ids = BTreeSet::new();
    for panel in dashboard["panels"].as_array().unwrap() {
        assert!(ids.insert(panel["id"].as_u64().unwrap()), "{panel}");
        assert!(panel["title"].is_string() && panel["gridPos"]["w"].is_u64(), "{panel}");
        if panel["type"] == "row" {
            continue;
        }
        let targets = panel["targets"].as_array().unwrap();
        assert!(!targets.is_empty(), "{panel}");
        for target in targets {
            let names = named(target["expr"].as_str().unwrap());
            assert!(!names.is_empty(), "{target}");
            shown.extend(names);
        }
    }
    let variables = named(&dashboard["templating"].to_string());
    for name in shown.iter().chain(&variables) {
        let plain = metrics::TABLE.iter().any(|row| row.name == name.as_str());
        assert!(is_declared(name) || plain, "{name} is no metric");
    }
    for row in metrics::TABLE {
        let is_shown = shown.iter().any(|name| name.trim_end_matches("_bucket") == row.name);
        assert!(row.kind != Kind::Histogram || is_shown, "{} is not shown", row.name);
    }
}

#[test]
fn alert_rules_have_the_form_of_prometheus_and_name_only_metrics_that_there_are() {
    let text = std::fs::read_to_string(root().join("deploy/observability/alerts.yaml")).unwrap();
    let rules: Value = serde_yaml::from_str(&text).unwrap();
    let mut names = BTreeSet::new();
    for group in rules["groups"].as_array().unwrap() {
        assert!(group["name"].as_str().unwrap().starts_with("zenav-"));
        for rule in group["rules"].as_array().unwrap() {
            let name = rule["alert"].as_str().unwrap();
            assert!(names.insert(name.to_owned()), "{name} stands twice");
            let known = ["alert", "expr", "for", "labels", "annotations"];
            for key in rule.as_object().unwrap().keys() {
                assert!(known.contains(&key.as_str()), "{name}: {key}");
            }
            let expression = rule["expr"].as_str().unwrap();
            for (open, close) in [('(', ')'), ('{', '}'), ('[', ']')] {
                let count = |letter| expression.chars().filter(|other| *other == letter).count();
                assert_eq!(count(open), count(close), "{name}: {expression}");
            }
            let metrics = named(expression);
            assert!(
                !metrics.is_empty() || expression.starts_with("up{"),
                "{name}: {expression}"
            );
            for metric in metrics {
                assert!(is_declared(&metric), "{name}: {metric} is no metric");
            }
            if let Some(wait) = rule.get("for") {
                let wait = wait.as_str().unwrap();
                let (number, unit) = wait.split_at(wait.len() - 1);
                assert!(
                    number.parse::<u32>().is_ok() && ["s", "m", "h"].contains(&unit),
                    "{name}: {wait}"
                );
            }
            assert!(
                ["warning", "critical"].contains(&rule["labels"]["severity"].as_str().unwrap()),
                "{name}"
            );
            for annotation in ["summary", "description"] {
                let text = rule["annotations"][annotation].as_str().unwrap();
                assert!(text.len() > 4, "{name}: {annotation}");
            }
        }
    }
    assert!(names.len() > 10, "{names:?}");
}

#[test]
fn the_table_of_metrics_in_the_docs_is_the_one_in_code() {
    let path = root().join("docs/observability.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = page.split_once("<!-- metrics: begin -->\n").unwrap();
    let (between, after) = rest.split_once("<!-- metrics: end -->").unwrap();
    let table = metrics::table_markdown();
    if std::env::var_os("WRITE_DOCS").is_some() {
        let written = format!("{before}<!-- metrics: begin -->\n{table}<!-- metrics: end -->{after}");
        std::fs::write(&path, written).unwrap();
        return;
    }
    assert!(
        between == table,
        "docs/observability.md is not what is declared; WRITE_DOCS=1 writes it"
    );
}
