//! Cargo's metadata and dependency trees of the workspace, so that no test parses a manifest.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use serde::Deserialize;

/// Output of `cargo metadata`.
#[derive(Debug, Deserialize)]
pub struct Metadata {
    pub packages: Vec<Package>,
    pub workspace_members: Vec<String>,
}

#[derive(Debug, Deserialize)]
pub struct Package {
    pub id: String,
    pub name: String,
    pub license: Option<String>,
    pub rust_version: Option<String>,
    pub description: Option<String>,
    pub readme: Option<String>,
    pub keywords: Vec<String>,
    pub categories: Vec<String>,
    pub repository: Option<String>,
    pub manifest_path: PathBuf,
    pub dependencies: Vec<Dependency>,
    /// Registries to which it may be published: all (`None`), or none (`Some([])`).
    pub publish: Option<Vec<String>>,
    pub targets: Vec<Target>,
}

/// A dependency declared in a manifest.
#[derive(Debug, Deserialize)]
pub struct Dependency {
    pub name: String,
    /// `None` for a normal dependency, otherwise `dev` or `build`.
    pub kind: Option<String>,
    /// Set for packages of this workspace only.
    pub path: Option<PathBuf>,
    /// The versions it may have; `*` where the manifest says nothing.
    pub req: String,
}

#[derive(Debug, Deserialize)]
pub struct Target {
    pub kind: Vec<String>,
}

impl Package {
    /// Folder of its manifest, from the workspace root.
    pub fn folder(&self) -> String {
        let folder = self.manifest_path.parent().unwrap();
        relative(folder)
    }

    /// Whether other packages can depend on it.
    pub fn is_library(&self) -> bool {
        self.targets
            .iter()
            .any(|target| target.kind.iter().any(|kind| kind == "lib"))
    }

    /// Whether it is published for use outside this workspace.
    pub fn is_published(&self) -> bool {
        self.publish.as_ref().is_none_or(|registries| !registries.is_empty())
    }
}

impl Metadata {
    /// The packages of this workspace.
    pub fn members(&self) -> impl Iterator<Item = &Package> {
        self.packages
            .iter()
            .filter(|package| self.workspace_members.contains(&package.id))
    }
}

/// The workspace root.
pub fn root() -> &'static Path {
    static ROOT: OnceLock<PathBuf> = OnceLock::new();
    ROOT.get_or_init(|| {
        let own = Path::new(env!("CARGO_MANIFEST_DIR"));
        own.parent().unwrap().to_path_buf()
    })
}

/// A path from the workspace root, with `/` on every system.
pub fn relative(path: &Path) -> String {
    let inside = path.strip_prefix(root()).unwrap_or(path);
    inside.to_string_lossy().replace('\\', "/")
}

/// Every file below a folder with this ending, in order; without hidden folders, and those that a build or a run writes.
pub fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    fn collect(folder: &Path, ending: &str, found: &mut Vec<PathBuf>) {
        let Ok(entries) = std::fs::read_dir(folder) else { return };
        for path in entries.map(|entry| entry.unwrap().path()) {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if name.starts_with('.') || ["target", "zenav-out", "zenav-data"].contains(&name.as_str()) {
                continue;
            }
            if path.is_dir() {
                collect(&path, ending, found);
            } else if path.extension().is_some_and(|found| found == ending) {
                found.push(path);
            }
        }
    }
    let mut found = Vec::new();
    collect(folder, ending, &mut found);
    found.sort();
    found
}

fn cargo(arguments: &str) -> String {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| env!("CARGO").into());
    let output = Command::new(cargo)
        .args(arguments.split(' '))
        .current_dir(root())
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

/// Every package built on this machine, dependencies included.
pub fn metadata() -> &'static Metadata {
    static METADATA: OnceLock<Metadata> = OnceLock::new();
    METADATA.get_or_init(|| {
        let version = Command::new("rustc").arg("-vV").output().unwrap();
        let version = String::from_utf8(version.stdout).unwrap();
        let host = version.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
        let text = cargo(&format!(
            "metadata --locked --format-version 1 --filter-platform {host}"
        ));
        serde_json::from_str(&text).unwrap()
    })
}

/// Names of all packages in the build of one, without features that only other packages enable.
pub fn built_of(package: &str) -> Vec<String> {
    let tree = cargo(&format!(
        "tree --locked --package {package} --edges normal --prefix none --format {{p}}"
    ));
    tree.lines()
        .filter_map(|line| line.split_whitespace().next())
        .map(str::to_owned)
        .collect()
}
