//! Tests of deployments of many hosts: rendering, refusals, and detection of missing parts.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::files::{Target, render};
use super::layout::Layout;
use super::running::{Seen, State, compare};
use crate::config::Deployment;

const FLEET: &str = include_str!("fleet.toml");

fn deployment(text: &str) -> Deployment {
    toml::from_str(text).unwrap()
}

/// The problems of the fleet after replacing a piece of its text.
#[track_caller]
fn problems(from: &str, to: &str) -> Vec<String> {
    assert!(FLEET.contains(from), "{from}");
    let changed = deployment(&FLEET.replace(from, to));
    let problems = Layout::of(&changed).map(|_| ()).unwrap_err();
    problems.iter().map(ToString::to_string).collect()
}

/// `WRITE_DOCS=1` rewrites the golden file.
#[test]
fn a_deployment_is_rendered_as_it_was_looked_through() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/src/hosts/tests/rendered.golden");
    let fleet = deployment(FLEET);
    let layout = Layout::of(&fleet).unwrap();
    let files = render(&layout, &["deployment.toml".to_owned()], Target::All).unwrap();
    let text: String = files.iter().map(|(path, text)| format!("=== {path}\n{text}")).collect();
    if std::env::var_os("WRITE_DOCS").is_some() {
        std::fs::write(path, &text).unwrap();
    }
    let golden = std::fs::read_to_string(path).unwrap_or_default();
    assert!(
        golden == text,
        "rendered.golden is not what is rendered; WRITE_DOCS=1 writes it"
    );
}

#[test]
fn one_target_s_files_are_a_part_of_all() {
    let fleet = deployment(FLEET);
    let layout = Layout::of(&fleet).unwrap();
    let of = |target| render(&layout, &[], target).unwrap();
    let all = of(Target::All);
    for (target, within) in [
        (Target::Systemd, "systemd/"),
        (Target::Compose, "compose.yaml"),
        (Target::Kubernetes, "kubernetes/"),
        (Target::Zenoh, "zenoh/"),
    ] {
        let files = of(target);
        assert!(files.len() > 1, "{target:?}");
        for (path, text) in files.iter().filter(|(path, _)| *path != "README.md") {
            assert!(
                path.contains(within) && all.get(path) == Some(text),
                "{target:?}: {path}"
            );
        }
    }
}

#[test]
fn a_rendering_of_one_target_is_known_by_its_folders_whatever_a_host_is_called() {
    for name in ["zenoh", "systemd", "kubernetes"] {
        let fleet = deployment(&FLEET.replace("fleet-a", name));
        let layout = Layout::of(&fleet).unwrap();
        for target in [
            Target::Systemd,
            Target::Compose,
            Target::Kubernetes,
            Target::Zenoh,
            Target::All,
        ] {
            let files = render(&layout, &[], target).unwrap();
            let mut paths: BTreeSet<&str> = files.keys().map(String::as_str).collect();
            paths.insert("etc/zenoh/compose.yaml");
            assert_eq!(Target::of(&paths), target, "host {name}: {paths:#?}");
        }
    }
}

#[test]
fn a_robot_s_driver_dials_the_robot_s_own_edge_and_other_members_dial_routers() {
    let fleet = deployment(FLEET);
    let layout = Layout::of(&fleet).unwrap();
    let files = render(&layout, &[], Target::Zenoh).unwrap();
    let dialled = |path: &str| -> Vec<String> {
        let settings = files[path].split_once('\n').unwrap().1;
        let settings: serde_json::Value = serde_json::from_str(settings).unwrap();
        serde_json::from_value(settings["connect"]["endpoints"].clone()).unwrap()
    };
    // It listens on a port that the file names, and on the first one of its host without.
    let edges = [
        ("hosts/robot-c/zenoh/robot.carl.json5", "quic/10.0.9.13:7460"),
        ("hosts/robot-a/zenoh/robot.anna.json5", "quic/10.0.3.11:7450"),
    ];
    for (path, edge) in edges {
        assert_eq!(dialled(path), [edge]);
    }
    let routers = ["quic/fleet-a.example.org:7447", "quic/fleet-b.example.org:7447"];
    assert_eq!(dialled("hosts/desk/zenoh/operator.desk.json5"), routers);
    assert_eq!(dialled("hosts/fleet-a/zenoh/service.fleet-a.json5"), routers);
}

#[test]
fn every_part_dials_routers_that_are_there_and_two_routers_have_one_link() {
    let fleet = deployment(FLEET);
    let layout = Layout::of(&fleet).unwrap();
    let dials = |host: &str| layout.host(host).unwrap().routers.clone();
    assert_eq!(dials("fleet-a"), ["fleet-a", "fleet-b"], "its own first");
    assert_eq!(dials("site"), ["site", "fleet-a", "fleet-b"]);
    assert_eq!(dials("robot-a"), ["site"]);
    assert_eq!(dials("robot-c"), ["fleet-a", "fleet-b"]);
    let linked = |host: &str| -> Vec<String> {
        let others = layout.dialled_by_router(layout.host(host).unwrap());
        others.into_iter().map(|host| host.name.clone()).collect()
    };
    assert_eq!(linked("fleet-a"), Vec::<String>::new());
    assert_eq!(linked("fleet-b"), ["fleet-a"]);
    assert_eq!(linked("site"), ["fleet-a", "fleet-b"]);
}

#[test]
fn what_cannot_be_is_told_by_key_and_with_what_was_expected() {
    for (from, to, key, why) in [
        (
            "role = \"operator\"\n",
            "",
            "hosts.desk.role",
            "expected robot, edge_site",
        ),
        ("10.0.3.20", "10.0.3.20:80", "hosts.desk.address", "without a port"),
        ("10.0.3.20", "300.0.3.20", "hosts.desk.address", "expected a name or"),
        ("10.0.3.20", "desk..local", "hosts.desk.address", "expected a name or"),
        ("10.0.3.20", "0.0.0.0", "hosts.desk.address", "no other host reaches it"),
        (
            "10.0.3.20",
            "localhost",
            "hosts.desk.address",
            "no other host reaches it",
        ),
        (
            "fleet-b.example.org",
            "Fleet-A.example.org",
            "hosts.fleet-b.address",
            "both listen on port 7447",
        ),
        (
            "connect = [\"site\"]",
            "connect = [\"site\", \"site\"]",
            "hosts.robot-a.connect",
            "names `site`: a second time",
        ),
        ("[hosts.desk]", "[hosts.Desk_1]", "hosts.Desk_1", "a-z 0-9 -"),
        (
            "[\"edge:carl\"]",
            "[\"edge:carol\"]",
            "hosts.robot-c.runs",
            "no robot `carol`; there is anna, bert_2, carl",
        ),
        ("[\"edge:carl\"]", "[]", "robots.carl", "expected `edge:carl`"),
        (
            "[\"edge:carl\"]",
            "[\"edge:carl\", \"edge:anna\"]",
            "hosts.robot-c.runs",
            "robot-a runs already",
        ),
        (
            "[\"edge:carl\"]",
            "[\"edge:carl\", \"mission\"]",
            "hosts.robot-c.runs",
            "on a host of role robot",
        ),
        (
            "connect = [\"site\"]",
            "connect = [\"sight\"]",
            "hosts.robot-a.connect",
            "no such host",
        ),
        (
            "connect = [\"site\"]",
            "connect = [\"desk\"]",
            "hosts.robot-a.connect",
            "runs no router",
        ),
        (", \"mapping:carl\"", "", "robots.carl", "is mapped nowhere"),
        (
            "\"motion\", \"mission\"]",
            "\"motion\", \"motion\", \"mission\"]",
            "hosts.fleet-a.runs",
            "planning.workers",
        ),
        ("\"world\", ", "", "robots.anna.attach", "no host runs a `world`"),
        ("10.0.3.12", "10.0.3.11", "hosts.robot-b.address", "port 7450"),
        (
            "tcp/0.0.0.0:7460",
            "tcp/127.0.0.1:7460",
            "robots.carl.listen",
            "nobody could stop it",
        ),
        (
            "runs = [\"router\", \"motion\", \"mission\", \"gateway\"]",
            "runs = [\"rooter\"]",
            "hosts.fleet-b.runs",
            "expected router, world",
        ),
    ] {
        let problems = problems(from, to);
        let told = problems
            .iter()
            .any(|problem| problem.starts_with(&format!("`{key}` ")) && problem.contains(why));
        assert!(told, "{key}: {why}: {problems:#?}");
    }
    let none = Layout::of(&Deployment::default()).map(|_| ()).unwrap_err();
    assert!(none[0].to_string().contains("[hosts.NAME]"));
}

#[test]
fn the_router_s_rest_and_further_routers_are_rendered_and_what_cannot_be_is_refused() {
    let with = |router: &str| deployment(&format!("[router]\n{router}\n{FLEET}"));
    // A served world listens on the port of scouting.
    let real = FLEET
        .replace("\"world\", ", "")
        .replace("attach = true", "driver = true");
    let router = "rest = \"127.0.0.1:8000\"\nscouting = true\nconnect = [\"quic/other.example.org:7447\"]";
    let linked = deployment(&format!("[router]\n{router}\n{real}"));
    let files = render(&Layout::of(&linked).unwrap(), &[], Target::Systemd).unwrap();
    for (path, text) in files.iter().filter(|(path, _)| path.ends_with(".service")) {
        let is_router = path.ends_with("zenav-router.service");
        let line = text.lines().find(|line| line.starts_with("ExecStart=")).unwrap();
        for flags in [
            " --rest 127.0.0.1:8000 ",
            " --scouting ",
            " --connect quic/other.example.org:7447 ",
        ] {
            assert_eq!(line.contains(flags), is_router, "{path}: {line}");
        }
    }
    for (router, key, why) in [
        (
            "rest = \"0.0.0.0:8000\"",
            "router.rest",
            "expected an address of loopback",
        ),
        (
            "rest = \"127.0.0.1:9464\"",
            "hosts.fleet-a.address",
            "listen on port 9464",
        ),
        ("scouting = true", "hosts.site.address", "listen on port 7446"),
        (
            "connect = [\"quic/fleet-b.example.org:7447\"]",
            "router.connect",
            "the router of fleet-b",
        ),
        (
            "listen = [\"tcp/0.0.0.0:7500\"]",
            "router.listen",
            "listens on port 7447",
        ),
    ] {
        let refused = with(router);
        let problems = Layout::of(&refused).map(|_| ()).unwrap_err();
        assert!(
            problems[0].key == key && problems[0].problem.contains(why),
            "{router}: {problems:#?}"
        );
    }
}

#[test]
fn loopback_is_what_an_address_is_and_not_what_it_contains() {
    for (endpoint, expected) in [
        ("tcp/127.0.0.1:7450", true),
        ("127.0.0.5:7480", true),
        ("tcp/localhost:7450", true),
        ("quic/[::1]:7450", true),
        ("tcp/192.168.127.10:7450", false),
        ("10.127.0.5:7480", false),
        ("tcp/0.0.0.0:7447", false),
    ] {
        assert_eq!(super::layout::is_loopback(endpoint), expected, "{endpoint}");
    }
}

#[test]
fn two_containers_of_one_name_and_a_host_that_dials_no_router_are_told() {
    let robot = "[robots.motion]\ndriver = true\n[hosts.bot]\nrole = \"robot\"\naddress = \"10.0.0.3\"\n";
    let cloud = |name: &str, address: &str, runs: &str| {
        format!("[hosts.{name}]\nrole = \"cloud\"\naddress = \"{address}\"\nruns = [{runs}]\n")
    };
    let told = |text: String| -> Vec<String> {
        let changed = deployment(&text);
        let problems = Layout::of(&changed).map(|_| ()).unwrap_err();
        problems.iter().map(ToString::to_string).collect()
    };
    let hall = cloud("hall", "10.0.0.1", "\"router\", \"mapping\", \"mission:motion\"");
    let other = cloud("hall-mission", "10.0.0.2", "\"motion\"");
    let problems = told(format!("{robot}runs = [\"edge:motion\"]\n{hall}{other}"));
    assert!(
        problems.len() == 1 && problems[0].contains("hall-mission-motion in a cluster, as is `mission:motion` of hall"),
        "{problems:#?}"
    );
    // A router on the robot alone.
    let services = cloud("hall", "10.0.0.1", "\"motion\", \"mapping\", \"mission\"");
    let problems = told(format!("{robot}runs = [\"edge:motion\", \"router\"]\n{services}"));
    assert!(
        problems.len() == 1 && problems[0].contains("dials no router") && problems[0].contains("connect = [\"bot\"]"),
        "{problems:#?}"
    );
    let named = format!("{services}connect = [\"bot\"]\n");
    let well = deployment(&format!("{robot}runs = [\"edge:motion\", \"router\"]\n{named}"));
    assert!(Layout::of(&well).is_ok());
}

#[test]
fn what_runs_nowhere_is_told_once_each() {
    let text = FLEET
        .replace("\"router\", ", "")
        .replace("\"motion\", ", "")
        .replace(", \"mission\"", "");
    let text = text
        .replace("[\"mission\"", "[")
        .replace("[, ", "[")
        .replace("connect = [\"site\"]", "");
    let changed = deployment(&text);
    let problems: Vec<String> = Layout::of(&changed)
        .map(|_| ())
        .unwrap_err()
        .iter()
        .map(ToString::to_string)
        .collect();
    for part in ["run no router", "run no motion", "has no mission anywhere"] {
        assert!(
            problems.iter().any(|problem| problem.contains(part)),
            "{part}: {problems:#?}"
        );
    }
}

#[test]
fn what_does_not_show_on_the_bus_is_missing_and_what_nobody_named_is_told() {
    let fleet = deployment(FLEET);
    let layout = Layout::of(&fleet).unwrap();
    let set = |names: &[&str]| -> BTreeSet<String> { names.iter().map(|name| (*name).to_owned()).collect() };
    let all = set(&["edge", "mapping", "mission"]);
    let robots = |names: &[&str]| -> BTreeMap<String, BTreeSet<String>> {
        names.iter().map(|name| ((*name).to_owned(), all.clone())).collect()
    };
    let seen = Seen {
        routers: ["fleet-a", "fleet-b", "site"].map(|host| (host.to_owned(), 3)).into(),
        robots: robots(&["anna", "bert_2", "carl"]),
        workers: [
            ("motion".to_owned(), set(&["fleet-a-1", "fleet-b-1", "fleet-b-2"])),
            ("world".to_owned(), set(&["x"])),
        ]
        .into(),
        orchestrators: ["anna", "bert_2", "carl"].map(|robot| (robot.to_owned(), 2)).into(),
        mappers: ["anna", "bert_2", "carl"].map(|robot| (robot.to_owned(), 1)).into(),
        gateways: 1,
    };
    let well = compare(&layout, &seen);
    assert!(well.iter().all(|finding| finding.state == State::Runs), "{well:#?}");
    assert_eq!(well.len(), layout.parts().count());

    let worse = Seen {
        routers: ["fleet-a", "site"].map(|host| (host.to_owned(), 0)).into(),
        robots: robots(&["anna", "carl", "stranger"]),
        workers: [("motion".to_owned(), set(&["fleet-a-1", "elsewhere-1"]))].into(),
        orchestrators: [("anna".to_owned(), 1), ("carl".to_owned(), 2)].into(),
        mappers: [("anna".to_owned(), 1), ("carl".to_owned(), 1)].into(),
        gateways: 0,
    };
    let found: BTreeSet<String> = compare(&layout, &worse)
        .into_iter()
        .filter(|finding| finding.state != State::Runs)
        .map(|finding| format!("{} {} {:?}", finding.host, finding.part, finding.state))
        .collect();
    let expected = [
        "fleet-b router Missing",
        "fleet-b motion Missing",
        "fleet-a mission Missing",
        "fleet-b mission Missing",
        "fleet-b gateway Missing",
        "site world Missing",
        "site mapping:bert_2 Missing",
        "robot-b edge:bert_2 Missing",
        "- edge:stranger Unnamed",
        "- motion worker elsewhere-1 Unnamed",
    ];
    assert_eq!(found, set(&expected));
}

#[test]
fn a_router_where_others_do_not_show_is_cut_off_and_one_of_another_program_is_not() {
    let fleet = deployment(FLEET);
    let layout = Layout::of(&fleet).unwrap();
    let cut_off = |sees: [usize; 3]| -> Vec<String> {
        let hosts = ["fleet-a", "fleet-b", "site"].map(str::to_owned);
        let seen = Seen {
            routers: hosts.into_iter().zip(sees).collect(),
            ..Seen::default()
        };
        let found = compare(&layout, &seen).into_iter();
        found
            .filter(|finding| finding.state == State::CutOff)
            .map(|finding| finding.host)
            .collect()
    };
    assert_eq!(cut_off([3, 3, 3]), Vec::<String>::new());
    assert_eq!(cut_off([2, 1, 2]), ["fleet-a", "fleet-b", "site"]);
    assert_eq!(
        cut_off([3, 1, 3]),
        ["fleet-b"],
        "it hears nobody, and the others hear it"
    );
    assert_eq!(cut_off([0, 0, 0]), Vec::<String>::new(), "it does not tell");
}

#[test]
fn a_robot_may_be_mapped_on_two_hosts_and_a_copy_that_is_missing_is_told() {
    let fleet = deployment(&FLEET.replace("\"gateway\"]", "\"gateway\", \"mapping:anna\"]"));
    let layout = Layout::of(&fleet).unwrap();
    let missing = |count: usize| -> Vec<String> {
        let seen = Seen {
            mappers: ["anna", "bert_2", "carl"].map(|robot| (robot.to_owned(), count)).into(),
            ..Seen::default()
        };
        let found = compare(&layout, &seen).into_iter();
        found
            .filter(|finding| finding.part.starts_with("mapping") && finding.state != State::Runs)
            .map(|finding| format!("{} {}: {}", finding.host, finding.part, finding.detail))
            .collect()
    };
    assert_eq!(missing(2), Vec::<String>::new());
    let short = "mapping:anna: anna has 1 of 2 mapping services";
    assert_eq!(missing(1), ["fleet-b", "site"].map(|host| format!("{host} {short}")));
}

#[test]
fn files_that_a_deployment_names_stand_beside_it_and_go_along() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("hall.toml", "[map]\nyaml = \"hall.yaml\"\n");
    write("hall.yaml", "image: hall.pgm\nresolution: 0.05\n");
    write("hall.pgm", "P5");
    write("lidar.toml", "");
    let named = |text: &str| super::named_files::of(&deployment(text), folder.path());
    let text = "[simulation]\nworld = \"hall.toml\"\n[robots.a]\nmodel = \"jackal+lidar.toml\"\n";
    assert_eq!(
        named(text).unwrap(),
        ["hall.pgm", "hall.toml", "hall.yaml", "lidar.toml"]
    );
    assert_eq!(named("").unwrap(), Vec::<String>::new());
    for (text, key, why) in [
        (
            "[simulation]\nworld = \"hole.toml\"",
            "simulation.world",
            "or one of kitchen, ",
        ),
        (
            "[robots.a]\nmodel = \"turtlebot\"",
            "robots.a.model",
            "or one of tiago, ",
        ),
        (
            "[robots.a]\nmodel = \"tiago+back\"",
            "robots.a.model",
            "or one of rear_lidar, ",
        ),
        ("[mapping]\nmap = \"/maps/hall.yaml\"", "mapping.map", "a path"),
        ("[zones]\nfile = \"../zones.toml\"", "zones.file", "a path"),
        ("[zones]\nfile = \"zones.toml\"", "zones.file", "expected a file beside"),
    ] {
        let refused = named(text).unwrap_err();
        assert!(
            refused[0].key == key && refused[0].problem.contains(why),
            "{text}: {refused:?}"
        );
    }
    // An image may be named by its path, as ROS's `map_saver` does: the copy must not be the file itself.
    let elsewhere = folder.path().join("hall.pgm").display().to_string();
    for image in [elsewhere.as_str(), "../hall.pgm", "./hall.pgm"] {
        write("far.yaml", &format!("image: {image}\nresolution: 0.05\n"));
        match named("[mapping]\nmap = \"far.yaml\"") {
            Err(errors) => assert!(
                errors[0].key == "mapping.map" && errors[0].problem.contains(image),
                "{image}"
            ),
            Ok(names) => assert_eq!(names, ["far.yaml"], "no such file: {image}"),
        }
    }
    assert_eq!(std::fs::read_to_string(folder.path().join("hall.pgm")).unwrap(), "P5");
    let into = folder.path().join("etc");
    super::named_files::copy(&folder.path().join("hall.toml"), &["hall.pgm".to_owned()], &into).unwrap();
    assert_eq!(std::fs::read_to_string(into.join("hall.pgm")).unwrap(), "P5");
    assert!(Path::new(&into).join("deployment.toml").is_file());
}
