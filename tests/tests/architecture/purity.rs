//! Where are clocks, files, threads, the network and randomness used? Only in the files listed here, each with its reason.

use std::collections::BTreeSet;

use crate::sources::{modules_of, sources};
use crate::workspace::{files, relative, root};

/// Effects that a core must not have: it gets their results passed in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Effect {
    Clock,
    Disk,
    Network,
    Threads,
    Chance,
    Process,
}
use Effect::{Chance, Clock, Disk, Network, Process, Threads};

/// Path segments that indicate an effect.
const SIGNS: &[(Effect, &[&[&str]])] = &[
    (
        Clock,
        &[
            &["time", "Instant"],
            &["Instant", "now"],
            &["SystemTime"],
            &["clock_gettime"],
        ],
    ),
    (
        Disk,
        &[
            &["std", "fs"],
            &["fs", "File"],
            &["File", "open"],
            &["File", "create"],
            &["OpenOptions"],
        ],
    ),
    (
        Network,
        &[
            &["tokio"],
            &["zenoh"],
            &["zenoh_ext"],
            &["std", "net"],
            &["zenav_protocol", "bus"],
            &["crate", "bus"],
        ],
    ),
    (
        Threads,
        &[&["std", "thread"], &["thread", "spawn"], &["std", "sync", "mpsc"]],
    ),
    (
        Chance,
        &[
            &["rand", "rng"],
            &["thread_rng"],
            &["from_os_rng"],
            &["RandomState"],
            &["SysRng"],
            &["getrandom"],
        ],
    ),
    (
        Process,
        &[
            &["std", "process"],
            &["std", "env"],
            &["env", "var"],
            &["std", "io", "stdin"],
            &["std", "io", "stdout"],
        ],
    ),
];

/// Folders whose code is pure except for the exemptions. The services of `cloud/src`, and `deploy`, are shells.
const CORES: &[&str] = &[
    "protocol",
    "sim",
    "sim/reference_drivers",
    "edge",
    "cloud/behaviour_tree",
    "cloud/gateway",
    "cloud/mapping",
    "cloud/space",
    "cloud/planning",
    "cloud/pose_graph",
    "cloud/scan_matching",
    "cloud/localisation",
    "cloud/slam",
    "cloud/smoothing",
    "cloud/mission",
    "tests/fixtures",
];

/// Files and folders (which end in `/`) with effects, and why.
const EXEMPT: &[(&str, &[Effect], &str)] = &[
    ("protocol/src/bus/", &[Network, Clock], "the bus itself"),
    (
        "protocol/src/bus/link.rs",
        &[Threads],
        "a thread of Zenoh's waits until its routers have noticed that a link is gone",
    ),
    (
        "protocol/src/bus/threads.rs",
        &[Process],
        "starts its process anew with what Zenoh reads from the environment",
    ),
    (
        "protocol/src/bus/identity.rs",
        &[Disk],
        "a process's certificate, and the list of its fleet's members",
    ),
    (
        "edge/src/control.rs",
        &[Clock, Threads],
        "the control loop keeps its own time on its own thread",
    ),
    (
        "edge/src/deployment.rs",
        &[Network],
        "how the file says that the bus is protected",
    ),
    (
        "edge/src/exit_code.rs",
        &[Network],
        "which exit code an error of the bus has",
    ),
    (
        "edge/src/handoff.rs",
        &[Network],
        "what the control thread and the service's tasks exchange",
    ),
    (
        "edge/src/remote_body.rs",
        &[Network, Threads, Chance, Process, Clock],
        "a body in another process: silent after a while; its session has a random name",
    ),
    (
        "edge/src/service.rs",
        &[Network, Threads, Clock, Process],
        "the service: joins the bus, starts the control thread, names this boot by time and process",
    ),
    (
        "edge/src/trace.rs",
        &[Clock],
        "one scan in a second is followed, whatever the robot's own time",
    ),
    (
        "edge/src/state_file.rs",
        &[Disk],
        "what outlives a restart of the robot",
    ),
    (
        "edge/src/main.rs",
        &[Network, Disk, Process],
        "the robot's binary: files, signals, exit code",
    ),
    (
        "cloud/mapping/src/atomic.rs",
        &[Disk, Process],
        "writes a file whole or not at all, under a name of this process first",
    ),
    (
        "cloud/mapping/src/store.rs",
        &[Disk],
        "which maps are stored: the names of their folders",
    ),
    (
        "cloud/gateway/src/access.rs",
        &[Network],
        "addresses as data: is this one loopback's?",
    ),
    (
        "cloud/gateway/src/hub.rs",
        &[Network, Clock],
        "where feed and clients meet: one clock for all ages",
    ),
    (
        "cloud/gateway/src/http/",
        &[Network, Clock],
        "the server: connections, pace, deadlines",
    ),
    (
        "cloud/gateway/src/operator.rs",
        &[Network],
        "the newest command, from a browser to whoever drives",
    ),
    ("cloud/mapping/src/carmen.rs", &[Disk], "opens logs"),
    ("cloud/mapping/src/map_file.rs", &[Disk], "reads and writes map files"),
    (
        "cloud/mission/src/store/redb.rs",
        &[Disk],
        "the mission's store makes its folder",
    ),
    (
        "tests/fixtures/src/thread_time.rs",
        &[Clock],
        "a bench's own processor time",
    ),
];

fn exempt(path: &str, effect: Effect) -> Option<usize> {
    EXEMPT.iter().position(|(exempt, effects, _)| {
        let is_it = if exempt.ends_with('/') {
            path.starts_with(exempt)
        } else {
            path == *exempt
        };
        is_it && effects.contains(&effect)
    })
}

#[test]
fn cores_are_pure_and_every_exemption_is_used() {
    let mut used = BTreeSet::new();
    let mut found = Vec::new();
    for folder in CORES {
        for source in sources(folder) {
            for name in &source.names {
                for (effect, signs) in SIGNS {
                    if !signs.iter().any(|sign| name.has(sign)) {
                        continue;
                    }
                    match exempt(&source.path, *effect) {
                        Some(which) => {
                            used.insert((which, *effect));
                        }
                        None => found.push(format!(
                            "{}:{}: {effect:?}: {}",
                            source.path,
                            name.line,
                            name.segments.join("::")
                        )),
                    }
                }
            }
        }
    }
    assert!(
        found.is_empty(),
        "a core is pure, or its file is named in EXEMPT:\n{}",
        found.join("\n")
    );
    for (which, (path, effects, reason)) in EXEMPT.iter().enumerate() {
        assert!(!reason.is_empty());
        for effect in *effects {
            assert!(
                used.contains(&(which, *effect)),
                "{path} has no {effect:?}: the exemption goes"
            );
        }
    }
}

/// The only folder that may name Zenoh.
const ZENOH: &str = "protocol/src/bus/";

#[test]
fn zenoh_appears_in_the_bus_alone() {
    for folder in CORES.iter().chain(&["cloud", "deploy"]) {
        for source in sources(folder) {
            if source.path.starts_with(ZENOH) {
                continue;
            }
            for name in &source.names {
                let zenoh = name
                    .segments
                    .first()
                    .is_some_and(|first| first == "zenoh" || first == "zenoh_ext");
                assert!(!zenoh, "{}:{}: {}", source.path, name.line, name.segments.join("::"));
            }
        }
    }
}

#[test]
fn no_file_outside_tests_takes_in_every_message_by_a_glob() {
    let all = CORES
        .iter()
        .chain(&["cloud", "deploy"])
        .flat_map(|folder| sources(folder));
    let globs: Vec<String> = all
        .filter(|source| source.names.iter().any(|name| name.has(&["messages", "*"])))
        .map(|source| source.path)
        .collect();
    assert!(globs.is_empty(), "{}", globs.join("\n"));
}

#[test]
fn every_source_file_belongs_to_its_crate() {
    for folder in CORES.iter().chain(&["cloud", "deploy"]) {
        let src = format!("{folder}/src");
        let mut declared = BTreeSet::new();
        let all = files(&root().join(&src), "rs");
        let all: Vec<String> = all.iter().map(|path| relative(path)).collect();
        for path in &all {
            let base = path.strip_suffix(".rs").unwrap_or(path);
            let is_root = ["/lib", "/main", "/mod"].iter().any(|name| base.ends_with(name));
            let children = if is_root {
                base.rsplit_once('/').map_or(base, |(folder, _)| folder)
            } else {
                base
            };
            for module in modules_of(path) {
                declared.insert(format!("{children}/{module}.rs"));
                declared.insert(format!("{children}/{module}/mod.rs"));
            }
        }
        for path in &all {
            let is_entry = *path == format!("{src}/lib.rs") || *path == format!("{src}/main.rs");
            assert!(is_entry || declared.contains(path), "{path}: no `mod` declares it");
        }
    }
}
