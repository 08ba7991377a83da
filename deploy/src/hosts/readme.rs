//! Instructions beside the rendered files. What to do on which machine, in which order.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use super::compose::IMAGE;
use super::files::Target;
use super::kubernetes::PAGE_SECRET;
use super::layout::{Host, Layout};
use super::part::label;
use super::systemd;
use crate::config::{Profile, Role};
use crate::output::listed;

/// The text of `README.md`.
pub(super) fn text(layout: &Layout<'_>, wanted: &dyn Fn(Target) -> bool) -> String {
    let mut text =
        "# This deployment\n\nWritten by `zenav deploy render`: change the deployment file, and render again.\n\n"
            .to_owned();
    text += "| host | role | address | runs | dials the routers of |\n|---|---|---|---|---|\n";
    for host in &layout.hosts {
        let role = match host.role {
            Role::Robot => "robot",
            Role::EdgeSite => "edge_site",
            Role::Cloud => "cloud",
            Role::Operator => "operator",
        };
        let _ = writeln!(
            text,
            "| {} | {role} | {} | {} | {} |",
            host.name,
            host.address,
            listed(&host.parts),
            listed(&host.routers)
        );
    }
    if layout.profile == Profile::Mtls {
        keys(layout, &mut text);
    }
    if wanted(Target::Systemd) {
        text += "\n## systemd\n\nOn each host, with `zenav` in `/usr/bin`:\n\n```sh\n\
                 cp -r etc/. /etc/zenav/\n\
                 cp hosts/NAME/systemd/*.service /etc/systemd/system/\n\
                 systemctl daemon-reload\n";
        for host in layout.hosts.iter().filter(|host| !host.parts.is_empty()) {
            let units: Vec<String> = host.parts.iter().map(systemd::unit_name).collect();
            let _ = writeln!(text, "systemctl enable --now {}   # {}", units.join(" "), host.name);
        }
        text += "```\n";
        if let Some(token) = layout.token_file() {
            let _ = write!(
                text,
                "\nThe page's token is in `{}` on the host of its gateway, readable for root alone.\n",
                token.display()
            );
        }
    }
    if wanted(Target::Compose) {
        let _ = write!(
            text,
            "\n## Containers\n\nThe image is `{IMAGE}`, or what `ZENAV_IMAGE` names. On each host, with `etc` copied to `/etc/zenav`: \
             `docker compose -f hosts/NAME/compose.yaml up -d`{}. All of it on this machine, each part with an address of its own: \
             `docker compose up -d`. Where Compose is a separate program, write `docker-compose` instead of `docker compose`.",
            match layout.profile {
                Profile::Mtls =>
                    ", after `chown -R 65532:65532 /etc/zenav-identity`: the containers' user reads the keys",
                Profile::Open => "",
            }
        );
        let secrets = [
            (layout.profile == Profile::Mtls)
                .then_some(
                "`ZENAV_KEYS` names the folder of keys, instead of `./fleet-keys`; its files must be readable for the containers' user: \
                 `chown -R 65532:65532 fleet-keys/issued`.",
            ),
            layout
                .token_file()
                .is_some()
                .then_some(
                    "`ZENAV_PAGE_TOKEN` names the file of the page's token, instead of `./page-token`, which the containers' user reads, too: \
                     `head -c 24 /dev/urandom | base64 > page-token` makes one.",
                ),
        ];
        for told in secrets.into_iter().flatten() {
            let _ = write!(text, " {told}");
        }
        text.push('\n');
    }
    if wanted(Target::Zenoh) {
        text += "\n## Programs of your own\n\n`hosts/NAME/zenoh/MEMBER.json5` are Zenoh's settings for a program on that host that is no part of zenav, such as \
                 a driver or Zenoh's own tools: a client of the routers that the host's parts dial or, in the name of a robot, of that robot's edge";
        text += match layout.profile {
            Profile::Mtls => {
                ", with the identity of that member, in `/etc/zenav-identity/MEMBER`. The program's user must be able to read that folder, and nobody \
                 else but root: `setfacl -R -m u:USER:rX /etc/zenav-identity/MEMBER`.\n"
            }
            Profile::Open => ".\n",
        };
    }
    if wanted(Target::Kubernetes) {
        text += "\n## Kubernetes\n\n```sh\nkubectl create namespace zenav\n";
        if layout.profile == Profile::Mtls {
            let inside = |host: &Host| matches!(host.role, Role::Cloud | Role::EdgeSite);
            let of_cluster: BTreeSet<String> = layout
                .parts()
                .filter(|(host, _)| inside(host))
                .map(|(host, part)| layout.identity(host, part))
                .collect();
            for identity in of_cluster {
                let _ = writeln!(
                    text,
                    "kubectl -n zenav create secret generic {} --from-file fleet-keys/issued/{identity}",
                    label(&identity)
                );
            }
        }
        if layout.token_file().is_some() {
            let _ = writeln!(
                text,
                "kubectl -n zenav create secret generic {PAGE_SECRET} --from-file token=page-token"
            );
        }
        // Applied on the server: a map beside the file is too large for the client's annotation.
        text += "kubectl apply --server-side -k kubernetes\n```\n";
    }
    text
}

/// Identities of all parts, each with the addresses at which it is dialled.
pub(super) fn identities(layout: &Layout<'_>) -> BTreeMap<String, Vec<String>> {
    let mut identities = BTreeMap::<String, Vec<String>>::new();
    for (host, part) in layout.parts() {
        let names = identities.entry(layout.identity(host, part)).or_default();
        if host.port(layout.deployment, part).is_some() {
            for name in [host.address.clone(), super::command_line::name(host, part)] {
                if !names.contains(&name) {
                    names.push(name);
                }
            }
        }
    }
    for host in layout.hosts.iter().filter(|host| host.role == Role::Operator) {
        identities.entry(format!("operator.{}", host.name)).or_default();
    }
    identities
}

fn keys(layout: &Layout<'_>, text: &mut String) {
    text.push_str(
        "\n## Keys\n\nOn the machine of the certificate authority, once; then each folder goes to its host, as \
         `/etc/zenav-identity/ROLE.NAME`, readable for root alone. A unit holds a copy: after a change of `members.txt` (a new member, \
         or one that is revoked) those of routers and robots are restarted.\n\n```sh\nzenav keys init --dir fleet-keys\n",
    );
    for (identity, names) in identities(layout) {
        let hosts: Vec<String> = names.iter().map(|name| format!(" --host {name}")).collect();
        let _ = writeln!(text, "zenav keys issue {identity} --dir fleet-keys{}", hosts.concat());
    }
    text.push_str("```\n");
}
