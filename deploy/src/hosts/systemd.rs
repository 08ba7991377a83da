//! Systemd units. One unit per part: sandboxed, with a watchdog, under its own user.
//!
//! `Type=notify`: a part reports when it is ready, and feeds its watchdog from then on (`zenav_protocol::bus::service_manager`). Its keys
//! are passed as credentials, which only the part can read. Follows systemd.exec(5).

use super::command_line::{Addresses, CONFIG, IDENTITY, Place, arguments};
use super::layout::{Host, Layout};
use super::part::Part;
use crate::config::Profile;

/// A part's only permissions: read its configuration, write its state, use the network.
const SANDBOX: &str = "\
# The sandbox: no file but its own state, no privilege, no other process.
DynamicUser=yes
StateDirectoryMode=0700
UMask=0077
ProtectSystem=strict
ProtectHome=yes
PrivateTmp=yes
PrivateDevices=yes
PrivateMounts=yes
PrivateUsers=yes
DevicePolicy=closed
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectProc=invisible
ProcSubset=pid
CapabilityBoundingSet=
AmbientCapabilities=
NoNewPrivileges=yes
LockPersonality=yes
MemoryDenyWriteExecute=yes
RemoveIPC=yes
RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX AF_NETLINK
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallFilter=~@privileged @resources
SystemCallErrorNumber=EPERM
";

/// Name of a part's unit.
pub(super) fn unit_name(part: &Part) -> String {
    format!("zenav-{}.service", part.name())
}

/// A part's unit.
pub(super) fn unit(layout: &Layout<'_>, host: &Host, part: &Part) -> String {
    let state = format!("zenav-{}", part.name());
    let place = Place {
        addresses: Addresses::Hosts,
        // Systemd specifiers: the folders of state and of credentials.
        data: format!("%S/{state}"),
        identity: "%d".to_owned(),
        token: "%d/page-token".to_owned(),
        metrics: format!("127.0.0.1:{}", host.metrics_port(part)),
        worker: host.name.clone(),
    };
    let command: Vec<String> = arguments(layout, host, part, &place)
        .iter()
        .map(|word| quoted(word))
        .collect();
    let mut credentials = match layout.profile {
        Profile::Open => String::new(),
        Profile::Mtls => {
            let folder = format!("{IDENTITY}/{}", layout.identity(host, part));
            let files = layout.identity_files(host, part).into_iter();
            files
                .map(|file| format!("LoadCredential={file}:{folder}/{file}\n"))
                .collect()
        }
    };
    if let Some(token) = layout.token_file().filter(|_| *part == Part::Gateway) {
        credentials += &format!("LoadCredential=page-token:{}\n", token.display());
    }
    let after = match host.runs("router") && *part != Part::Router {
        true => " zenav-router.service",
        false => "",
    };
    format!(
        "# Written by `zenav deploy render`: change the deployment file, and render again.\n\
         [Unit]\n\
         Description=zenav {part} on {host}\n\
         Wants=network-online.target\n\
         After=network-online.target{after}\n\
         # A robot's part is started again for as long as it takes.\n\
         StartLimitIntervalSec=0\n\
         \n\
         [Service]\n\
         Type=notify\n\
         NotifyAccess=main\n\
         ExecStart=/usr/bin/zenav {command}\n\
         WorkingDirectory={CONFIG}\n\
         StateDirectory={state}\n\
         {credentials}\
         Restart=always\n\
         RestartSec=1s\n\
         # A part is ready once it has met a router, however long that takes; then it beats at least every 5 s.\n\
         TimeoutStartSec=infinity\n\
         WatchdogSec=10s\n\
         TimeoutStopSec=15s\n\
         LimitNOFILE=65536\n\
         {SANDBOX}\
         \n\
         [Install]\n\
         WantedBy=multi-user.target\n",
        host = host.name,
        command = command.join(" "),
    )
}

/// A word of a command, quoted as in systemd.syntax(7); specifiers are kept.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:,=%@+".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    let escaped = word.replace('\\', "\\\\").replace('"', "\\\"").replace('$', "$$");
    format!("\"{escaped}\"")
}
