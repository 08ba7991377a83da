//! Does the house stand as `ARCHITECTURE.md` says? The arrows between packages and modules, where Zenoh may appear, and the key table.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

fn sources(folder: &str) -> Vec<(PathBuf, String)> {
    fn collect(folder: &Path, found: &mut Vec<(PathBuf, String)>) {
        let mut entries: Vec<PathBuf> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        entries.sort();
        for path in entries {
            if path.is_dir() {
                collect(&path, found);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path, text));
            }
        }
    }
    let mut found = Vec::new();
    collect(&root().join(folder), &mut found);
    assert!(!found.is_empty(), "{folder} has no sources");
    found
}

fn assert_nowhere(folder: &str, words: &[&str]) {
    for (path, text) in sources(folder) {
        for (number, line) in text.lines().enumerate() {
            let code = line.split("//").next().unwrap_or_default();
            for word in words {
                assert!(
                    !code.contains(word),
                    "{}:{}: `{word}` is against the arrows",
                    path.display(),
                    number + 1
                );
            }
        }
    }
}

#[test]
fn packages_import_only_along_the_arrows() {
    assert_nowhere("protocol/src", &["zenav_sim", "zenav_edge", "zenav_cloud", "parry2d"]);
    assert_nowhere(
        "sim/src",
        &["zenav_edge", "zenav_cloud", "zenav_protocol::bus", "zenoh::", "tokio::"],
    );
    assert_nowhere("edge/src", &["zenav_cloud", "clarabel"]);
    assert_nowhere("cloud/src", &["zenav_edge", "zenav_sim", "parry2d"]);
}

#[test]
fn manifests_depend_only_along_the_arrows() {
    let manifest = |package: &str| fs::read_to_string(root().join(package).join("Cargo.toml")).unwrap();
    let forbidden = [
        ("protocol", &["zenav-sim", "zenav-edge", "zenav-cloud"][..]),
        ("sim", &["zenav-edge", "zenav-cloud", "\"bus\"", "zenoh", "tokio"]),
        ("edge", &["zenav-cloud", "clarabel", "axum"]),
        ("cloud", &["zenav-edge", "zenav-sim"]),
    ];
    for (package, words) in forbidden {
        for line in manifest(package)
            .lines()
            .filter(|line| !line.starts_with("description"))
        {
            for word in words {
                assert!(!line.contains(word), "{package}/Cargo.toml: `{line}`");
            }
        }
    }
}

#[test]
fn inside_the_cloud_knowledge_flows_from_maps_to_missions() {
    assert_nowhere(
        "cloud/src/mapping",
        &[
            "crate::planning",
            "crate::smoothing",
            "crate::mission",
            "crate::behaviour_tree",
        ],
    );
    assert_nowhere(
        "cloud/src/space",
        &[
            "crate::planning",
            "crate::smoothing",
            "crate::mission",
            "crate::behaviour_tree",
        ],
    );
    assert_nowhere("cloud/src/planning", &["crate::mission", "crate::behaviour_tree"]);
    assert_nowhere("cloud/src/smoothing", &["crate::mission", "crate::behaviour_tree"]);
    assert_nowhere(
        "cloud/src/behaviour_tree",
        &[
            "crate::mapping",
            "crate::space",
            "crate::planning",
            "crate::smoothing",
            "crate::mission",
            "zenav_protocol",
        ],
    );
}

#[test]
fn zenoh_appears_in_the_bus_and_the_router_alone() {
    for folder in ["protocol/src", "sim/src", "edge/src", "cloud/src", "deploy/src"] {
        for (path, text) in sources(folder) {
            let inside = path.to_string_lossy().replace('\\', "/");
            if inside.contains("/protocol/src/bus/") || inside.ends_with("/deploy/src/router.rs") {
                continue;
            }
            for line in text.lines() {
                let code = line.split("//").next().unwrap_or_default();
                assert!(
                    !code.contains("zenoh::") && !code.contains("zenoh_ext"),
                    "{inside}: `{line}`"
                );
            }
        }
    }
}

#[test]
fn cores_are_pure() {
    // Where time, threads and the network come in: services and what hosts workers, the follower that keeps a map fresh, the robot's
    // control thread and the boxes through which it meets the network.
    let network = [
        "service.rs",
        "worker_host.rs",
        "follower.rs",
        "control.rs",
        "exchange.rs",
        "main.rs",
        "remote_body.rs",
    ];
    let impure = [
        "tokio::",
        "Instant::now",
        "SystemTime",
        "zenav_protocol::bus",
        "std::net",
        "std::thread",
        "thread_rng",
    ];
    // Where files come in.
    let disk = [
        "service.rs",
        "main.rs",
        "state_file.rs",
        "store.rs",
        "map_file.rs",
        "atomic.rs",
        "carmen.rs",
    ];
    for folder in ["edge/src", "cloud/src", "sim/src"] {
        for (path, text) in sources(folder) {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.components().any(|part| part.as_os_str() == "tests") || name == "tests.rs" {
                continue;
            }
            // A service that has outgrown a file is a folder.
            let shell = network.contains(&name.as_str()) || path.components().any(|part| part.as_os_str() == "service");
            let code = text.split("#[cfg(test)]").next().unwrap_or_default();
            let find = |word: &str| {
                code.lines()
                    .find(|line| line.split("//").next().unwrap_or_default().contains(word))
            };
            for word in impure.iter().filter(|_| !shell) {
                assert_eq!(find(word), None, "{}: a core uses `{word}`", path.display());
            }
            for word in ["std::fs", "File::"].iter().filter(|_| !disk.contains(&name.as_str())) {
                assert_eq!(find(word), None, "{}: a core uses `{word}`", path.display());
            }
        }
    }
}

#[test]
fn the_key_table_in_the_docs_is_the_one_in_code() {
    let page = fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let between = page
        .split("<!-- keys: begin -->")
        .nth(1)
        .and_then(|rest| rest.split("<!-- keys: end -->").next())
        .unwrap();
    let table = zenav_protocol::topics::table_markdown();
    assert_eq!(
        between.trim(),
        table.trim(),
        "ARCHITECTURE.md: replace the key table by:\n{table}"
    );
}
