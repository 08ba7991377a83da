//! Rendered files. The files of a deployment of many hosts. Pure: a layout in, paths and texts out.
//!
//! ```text
//! README.md                       what to do with the rest
//! etc/                            the deployment file and what it names, copied: /etc/zenav on every host
//! hosts/NAME/systemd/*.service    units of a host
//! hosts/NAME/compose.yaml         the same parts as containers of that host
//! hosts/NAME/zenoh/MEMBER.json5   Zenoh's settings for other programs on that host, with the identity of this member
//! compose.yaml                    all parts as containers of one engine
//! kubernetes/*.yaml               kustomize base of the parts of cloud and edge sites, and the files of etc/
//! ```

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::layout::Layout;
use super::{compose, kubernetes, readme, systemd, zenoh_settings};
use crate::config::Role;

/// What to render for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Target {
    /// Units of systemd for each host
    Systemd,
    /// Compose files: one for each host, and one for all on one engine
    Compose,
    /// A kustomize base
    Kubernetes,
    /// Zenoh's settings for programs of other kinds on each host
    Zenoh,
    /// All of them
    All,
}

impl Target {
    /// What a rendering with files of these paths was for.
    pub(super) fn of(paths: &BTreeSet<&str>) -> Self {
        let in_host = |path: &str, what: &str| path.starts_with("hosts/") && path.split('/').nth(2) == Some(what);
        let has = |is_of: &dyn Fn(&str) -> bool| paths.iter().any(|path| is_of(path));
        match [
            has(&|path| in_host(path, "systemd")),
            has(&|path| path == "compose.yaml" || in_host(path, "compose.yaml")),
            has(&|path| path.starts_with("kubernetes/")),
            has(&|path| in_host(path, "zenoh")),
        ] {
            [true, false, false, false] => Self::Systemd,
            [false, true, false, false] => Self::Compose,
            [false, false, true, false] => Self::Kubernetes,
            [false, false, false, true] => Self::Zenoh,
            _ => Self::All,
        }
    }
}

/// File contents by path within the folder.
pub type Files = BTreeMap<String, String>;

/// Renders a deployment. `etc` lists the deployment file and the files that it names, which are copied unchanged.
///
/// # Errors
/// A document that cannot be written as YAML; never one of those rendered here.
pub fn render(layout: &Layout<'_>, etc: &[String], target: Target) -> Result<Files, String> {
    let wanted = |one: Target| target == Target::All || target == one;
    let mut files = Files::new();
    files.insert("README.md".to_owned(), readme::text(layout, &wanted));
    let hosts = layout.hosts.iter().filter(|host| !host.parts.is_empty());
    if wanted(Target::Systemd) {
        for host in hosts.clone() {
            for part in &host.parts {
                let path = format!("hosts/{}/systemd/{}", host.name, systemd::unit_name(part));
                files.insert(path, systemd::unit(layout, host, part));
            }
        }
    }
    if wanted(Target::Compose) {
        for host in hosts {
            let path = format!("hosts/{}/compose.yaml", host.name);
            files.insert(path, yaml(&[compose::of_host(layout, host)])?);
        }
        files.insert("compose.yaml".to_owned(), yaml(&[compose::whole(layout)])?);
    }
    if wanted(Target::Zenoh) {
        for host in &layout.hosts {
            for (member, text) in zenoh_settings::of_host(layout, host) {
                files.insert(format!("hosts/{}/zenoh/{member}.json5", host.name), text);
            }
        }
    }
    if wanted(Target::Kubernetes)
        && layout
            .hosts
            .iter()
            .any(|host| host.role != Role::Robot && !host.parts.is_empty())
    {
        for (path, value) in kubernetes::base(layout, etc) {
            let text = match &value {
                Value::Array(documents) => yaml(documents)?,
                one => yaml(std::slice::from_ref(one))?,
            };
            files.insert(format!("kubernetes/{path}"), text);
        }
    }
    Ok(files)
}

/// Documents of a YAML file.
fn yaml(documents: &[Value]) -> Result<String, String> {
    let mut text = "# Written by `zenav deploy render`: change the deployment file, and render again.\n".to_owned();
    for (number, document) in documents.iter().enumerate() {
        if number > 0 {
            text.push_str("---\n");
        }
        let written = serde_saphyr::to_string(document).map_err(|error| error.to_string())?;
        text.push_str(written.trim_end());
        text.push('\n');
    }
    Ok(text)
}
