//! Which package may depend on which? Checked with Cargo's own metadata.

use std::collections::BTreeMap;

use crate::workspace::{built_of, metadata, root};

/// What a package of this workspace may use of the others: in its code, and additionally in its tests.
type Arrows = (&'static str, &'static [&'static str], &'static [&'static str]);

const ARROWS: &[Arrows] = &[
    ("zenav-observability", &[], &[]),
    ("zenav-protocol", &["zenav-observability"], &["zenav-fixtures"]),
    ("zenav-sim", &["zenav-protocol"], &["zenav-fixtures"]),
    (
        "zenav-reference-drivers",
        &["zenav-protocol", "zenav-sim"],
        &["zenav-fixtures"],
    ),
    (
        "zenav-edge",
        &["zenav-protocol", "zenav-sim", "zenav-observability"],
        &["zenav-fixtures"],
    ),
    ("zenav-behaviour-tree", &[], &[]),
    ("zenav-gateway", &["zenav-protocol"], &[]),
    ("zenav-mapping", &["zenav-protocol"], &["zenav-fixtures"]),
    ("zenav-space", &["zenav-protocol"], &["zenav-mapping", "zenav-fixtures"]),
    (
        "zenav-planning",
        &["zenav-protocol", "zenav-space"],
        &["zenav-mapping", "zenav-fixtures"],
    ),
    ("zenav-pose-graph", &["zenav-protocol"], &["zenav-fixtures"]),
    ("zenav-scan-matching", &["zenav-protocol"], &[]),
    (
        "zenav-localisation",
        &["zenav-protocol", "zenav-scan-matching"],
        &["zenav-fixtures", "zenav-mapping"],
    ),
    (
        "zenav-slam",
        &["zenav-protocol", "zenav-pose-graph", "zenav-scan-matching"],
        &["zenav-mapping", "zenav-fixtures"],
    ),
    (
        "zenav-smoothing",
        &["zenav-protocol", "zenav-space"],
        &["zenav-mapping", "zenav-planning", "zenav-fixtures"],
    ),
    (
        "zenav-mission",
        &[
            "zenav-protocol",
            "zenav-behaviour-tree",
            "zenav-planning",
            "zenav-smoothing",
            "zenav-space",
        ],
        &["zenav-mapping", "zenav-fixtures"],
    ),
    (
        "zenav-cloud",
        &[
            "zenav-protocol",
            "zenav-observability",
            "zenav-behaviour-tree",
            "zenav-gateway",
            "zenav-localisation",
            "zenav-mapping",
            "zenav-mission",
            "zenav-planning",
            "zenav-scan-matching",
            "zenav-slam",
            "zenav-smoothing",
            "zenav-space",
        ],
        &["zenav-fixtures"],
    ),
    (
        "zenav",
        &[
            "zenav-protocol",
            "zenav-observability",
            "zenav-sim",
            "zenav-edge",
            "zenav-cloud",
            "zenav-behaviour-tree",
            "zenav-gateway",
            "zenav-localisation",
            "zenav-mapping",
            "zenav-mission",
            "zenav-planning",
            "zenav-pose-graph",
            "zenav-reference-drivers",
            "zenav-slam",
            "zenav-smoothing",
            "zenav-space",
        ],
        &["zenav-fixtures"],
    ),
    ("zenav-fixtures", &["zenav-protocol"], &[]),
    (
        "zenav-model",
        &["zenav-protocol", "zenav-edge", "zenav-mission", "zenav-fixtures"],
        &[],
    ),
];

/// What a computation never contains: the bus, a database, a solver, XML, collision checks of the simulator.
const PURE: &[&str] = &["zenoh", "tokio", "redb", "clarabel", "roxmltree", "parry2d-f64"];
/// The same for those that solve an optimisation.
const PURE_BUT_FOR_A_SOLVER: &[&str] = &["zenoh", "tokio", "redb", "roxmltree", "parry2d-f64"];

/// Packages that a package must never contain, not even transitively.
const WALLS: &[(&str, &[&str])] = &[
    ("zenav-observability", &["zenoh", "axum", "hyper"]),
    ("zenav-protocol", &["zenoh", "zenoh-ext", "tokio"]),
    ("zenav-sim", &["zenoh", "tokio", "redb", "clarabel"]),
    ("zenav-reference-drivers", &["zenoh", "tokio", "redb", "clarabel"]),
    ("zenav-edge", &["zenav-cloud", "redb", "clarabel", "roxmltree", "axum"]),
    (
        "zenav-behaviour-tree",
        &["zenoh", "tokio", "redb", "nalgebra", "clarabel", "zenav-protocol"],
    ),
    (
        "zenav-gateway",
        &["zenoh", "redb", "clarabel", "roxmltree", "parry2d-f64"],
    ),
    ("zenav-mapping", PURE),
    ("zenav-space", PURE),
    ("zenav-planning", PURE),
    ("zenav-pose-graph", PURE_BUT_FOR_A_SOLVER),
    ("zenav-scan-matching", PURE),
    ("zenav-localisation", PURE),
    ("zenav-slam", PURE_BUT_FOR_A_SOLVER),
    ("zenav-smoothing", PURE_BUT_FOR_A_SOLVER),
    ("zenav-mission", &["zenoh", "tokio", "parry2d-f64"]),
    ("zenav-cloud", &["zenav-edge", "zenav-sim", "parry2d-f64"]),
    ("zenav-fixtures", &["zenoh", "tokio"]),
];

#[test]
fn packages_depend_on_each_other_along_the_arrows_only_in_tests_too() {
    let arrows: BTreeMap<_, _> = ARROWS
        .iter()
        .map(|(name, code, tests)| (*name, (*code, *tests)))
        .collect();
    // The test package is not published, and may use everything.
    for package in metadata().members().filter(|package| package.name != "zenav-tests") {
        let name = package.name.as_str();
        let (code, tests) = arrows
            .get(name)
            .unwrap_or_else(|| panic!("{name}: a new package; say in ARROWS what it may depend on"));
        for dependency in package
            .dependencies
            .iter()
            .filter(|dependency| dependency.path.is_some())
        {
            let used = dependency.name.as_str();
            let is_test = dependency.kind.as_deref() == Some("dev");
            let allowed = code.contains(&used) || (is_test && tests.contains(&used));
            assert!(
                allowed,
                "{name} depends on {used} ({:?}) against the arrows",
                dependency.kind
            );
        }
    }
}

#[test]
fn libraries_are_built_without_what_their_job_does_not_need() {
    for (package, forbidden) in WALLS {
        let parts = built_of(package);
        assert!(parts.iter().any(|part| part == package), "{package}: {parts:?}");
        for wall in *forbidden {
            assert!(
                !parts.iter().any(|part| part == wall),
                "{package} is built of {wall}: cargo tree --package {package} --edges normal --invert {wall}"
            );
        }
    }
}

/// Licences that allow any use of the program.
const PERMISSIVE: &[&str] = &[
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "ISC",
    "MIT",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// Packages under other licences, with the reason for the exception.
const EXCEPTIONS: &[(&str, &str, &str)] = &[
    (
        "option-ext",
        "MPL-2.0",
        "Zenoh finds the home folder by it; its licence binds its own files alone",
    ),
    (
        "webpki-roots",
        "CDLA-Permissive-2.0",
        "Zenoh's QUIC has it: a list of public certificates; its licence asks that it be passed on with the list",
    ),
];

/// Whether permissive licences can be chosen in an SPDX expression; `/` is an old form of `OR`.
fn is_permissive(expression: &str) -> bool {
    // In all licences in use, parentheses enclose alternatives that are joined by AND: `(A OR B) AND C`.
    let all = expression.replace('/', " OR ");
    if all.contains('(') {
        return all
            .split(" AND ")
            .all(|part| is_permissive(&part.replace(['(', ')'], "")));
    }
    all.split(" OR ").any(|choice| {
        choice
            .split(" AND ")
            .all(|licence| PERMISSIVE.contains(&licence.trim()))
    })
}

#[test]
fn every_package_is_under_a_permissive_licence() {
    assert!(is_permissive("(MIT OR Apache-2.0) AND Unicode-3.0") && is_permissive("EPL-2.0 OR Apache-2.0"));
    assert!(!is_permissive("MIT AND GPL-3.0") && !is_permissive("(MIT OR ISC) AND MPL-2.0") && !is_permissive(""));
    for package in &metadata().packages {
        let licence = package.license.as_deref().unwrap_or_default();
        let excepted = EXCEPTIONS
            .iter()
            .any(|(name, exception, _)| *name == package.name && *exception == licence);
        assert!(is_permissive(licence) || excepted, "{}: `{licence}`", package.name);
    }
    for (name, _, _) in EXCEPTIONS {
        let used = metadata().packages.iter().any(|package| package.name == *name);
        assert!(used, "{name} is used no more: its exception goes");
    }
}

/// `1.90` or `1.90.0` as numbers.
fn version(text: &str) -> Vec<u32> {
    text.split('.').map(|part| part.parse().unwrap()).collect()
}

#[test]
fn nothing_asks_for_a_newer_rust_than_the_workspace_says() {
    let own = metadata()
        .members()
        .next()
        .and_then(|member| member.rust_version.clone());
    let own = own.expect("the workspace says which Rust it needs");
    for member in metadata().members() {
        assert_eq!(member.rust_version.as_ref(), Some(&own), "{}", member.name);
    }
    for package in &metadata().packages {
        let needs = package.rust_version.as_deref().unwrap_or("1.0");
        assert!(
            version(needs)[..2] <= version(&own)[..2],
            "{} needs Rust {needs}, the workspace says {own}",
            package.name
        );
    }
}

#[test]
fn every_crate_for_others_says_what_it_is() {
    let members = metadata().members();
    for package in members.filter(|package| package.is_library() && package.is_published()) {
        let name = package.name.as_str();
        assert!(package.description.is_some(), "{name} has no description");
        let said = !package.keywords.is_empty() && !package.categories.is_empty() && package.repository.is_some();
        assert!(said, "{name} lacks keywords, categories or repository");
        let readme = package.readme.as_deref().unwrap_or("README.md");
        let readme = root().join(package.folder()).join(readme);
        assert!(readme.is_file(), "{name}: {} is missing", readme.display());
        for licence in ["LICENSE-MIT", "LICENSE-APACHE"] {
            let file = root().join(package.folder()).join(licence);
            assert!(file.is_file(), "{name}: {} is missing", file.display());
        }
        let needed = package.dependencies.iter().filter(|needed| needed.kind.is_none());
        for needed in needed.filter(|needed| needed.path.is_some()) {
            assert_ne!(needed.req, "*", "{name}: `{}` lacks a version", needed.name);
        }
    }
}
