//! Security. How are a session's links protected, and what may others do over them?
//!
//! By default, plain TCP: sessions listen on loopback only. With an identity, TLS 1.3 with a certificate on each side, over QUIC: endpoints
//! are `quic/HOST:PORT`, on UDP; names are verified, links end when their certificates expire, and a session that listens allows others
//! only what the key table grants them (`access_control`).
//!
//! QUIC instead of TLS over TCP: with the latter, Zenoh 1.10 lets its sending and its receiving thread access one rustls connection at the
//! same time, and crashes (<https://github.com/eclipse-zenoh/zenoh/issues/2557>). A QUIC link has one stream per direction and priority.

use std::net::IpAddr;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use zenoh::config::WhatAmI;

use super::access_control;
use super::identity::{Identity, IdentityError};
use super::session::BusError;
use crate::id::Id;
use crate::member::{Member, Role};

/// How links are protected, as a deployment says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// Neither encrypted nor authenticated: for loopback and closed networks.
    Open,
    /// TLS over QUIC, with a certificate on each side.
    Mtls,
}

crate::settings! {
    /// How links are protected.
    pub struct SecuritySection {
        /// `open` or `mtls`; unset: `mtls` when a deployment of many hosts is rendered, `open` on this machine.
        pub profile: Option<Profile> = None;
        /// Folder of this part's `ca.pem`, `cert.pem` and `key.pem`.
        pub identity: Option<PathBuf> = None;
    }
}

impl SecuritySection {
    /// Link protection of a part of the deployment; the part's own options, as in [`Security::of`], win over the section.
    ///
    /// # Errors
    /// [`BusError::Config`]: a folder that holds no identity, or a profile that does not fit.
    pub fn security(&self, identity: Option<&Path>, insecure: bool) -> Result<Security, BusError> {
        let wrong = |reason: String| Err(BusError::Config { reason });
        match (self.profile, identity.or(self.identity.as_deref())) {
            (Some(Profile::Mtls), None) => wrong(
                "security.profile is mtls: expected an identity (--identity FOLDER, ZENAV_IDENTITY, security.identity)"
                    .to_owned(),
            ),
            (Some(Profile::Open), Some(identity)) => wrong(format!(
                "security.profile is open, and there is an identity, {}: expected mtls, or none",
                identity.display()
            )),
            (_, identity) => Ok(Security::of(identity, insecure)?),
        }
    }
}

/// How links are protected.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Security {
    /// Neither encrypted nor authenticated; only programs on this machine can reach an endpoint.
    #[default]
    Loopback,
    /// Neither encrypted nor authenticated, on every address: anybody who reaches an endpoint can command every robot.
    Insecure,
    /// TLS over QUIC, with a certificate on each side.
    Mtls(Box<Identity>),
}

impl Security {
    /// From a user's options: an identity or none, and whether to listen to other machines without one.
    ///
    /// # Errors
    /// As [`Identity::load`].
    pub fn of(identity: Option<&Path>, insecure: bool) -> Result<Self, IdentityError> {
        Ok(match (identity, insecure) {
            (Some(folder), _) => Self::Mtls(Box::new(Identity::load(folder)?)),
            (None, true) => Self::Insecure,
            (None, false) => Self::Loopback,
        })
    }

    /// The identity, if there is one.
    #[must_use]
    pub fn identity(&self) -> Option<&Identity> {
        match self {
            Self::Mtls(identity) => Some(identity),
            Self::Loopback | Self::Insecure => None,
        }
    }

    /// Waits until a member was revoked that this process still admits, because Zenoh cannot reload the members while it runs. For ever in a
    /// process that admits nobody: without an identity, or without a list of members.
    pub async fn revoked(&self) {
        match self.identity() {
            Some(identity) => identity.revoked().await,
            None => std::future::pending().await,
        }
    }

    /// Whether this process may be a robot's edge. If the body is simulated in the same process, the process also publishes the simulated
    /// time, which only a router may do.
    ///
    /// # Errors
    /// [`IdentityError`]: the identity of another robot, or not a robot's.
    pub fn check_robot(&self, robot: &Id, is_simulated: bool) -> Result<(), IdentityError> {
        let Some(identity) = self.identity() else {
            return Ok(());
        };
        let own = identity.member();
        let problem = match own.role {
            Role::Router => return Ok(()),
            Role::Robot if own.name == *robot && !is_simulated => return Ok(()),
            Role::Robot if own.name == *robot => format!(
                "{own} has a simulated body in its own process, and would give everybody the time: expected a world that `zenav sim serve` serves (--attach), or an identity router.NAME"
            ),
            _ => format!("is of {own}: expected robot.{robot} (`zenav keys issue robot.{robot}` makes one)"),
        };
        Err(IdentityError {
            folder: identity.folder().to_owned(),
            problem,
        })
    }

    /// Whether this process's member has a role in which `part`, such as `zenav router`, does its work: what an endpoint does not grant, it
    /// drops without an answer.
    ///
    /// # Errors
    /// [`IdentityError`]: a member of another role than `roles`.
    pub fn check_role(&self, part: &str, roles: &[Role]) -> Result<(), IdentityError> {
        let Some(identity) = self.identity() else {
            return Ok(());
        };
        let problem = wrong_role(identity.member(), part, roles);
        problem.map_or(Ok(()), |problem| {
            Err(IdentityError {
                folder: identity.folder().to_owned(),
                problem,
            })
        })
    }

    /// Checks that health and metrics may be served at an address, `HOST:PORT`. They are plain HTTP: other machines read them only if the
    /// process has an identity, or listens to other machines anyway.
    ///
    /// # Errors
    /// [`BusError::Config`].
    pub fn check_metrics(&self, address: &str) -> Result<(), BusError> {
        if *self != Self::Loopback || is_loopback(address) {
            return Ok(());
        }
        Err(BusError::Config {
            reason: format!(
                "--metrics {address}: other machines could read it: expected an address of loopback, an identity (`--identity FOLDER`, made by `zenav keys`), or `--insecure`"
            ),
        })
    }

    /// Endpoints as used with this protection: with an identity, `tcp/HOST:PORT` and `tls/HOST:PORT` become `quic/HOST:PORT`.
    pub(super) fn endpoints(&self, given: &[String]) -> Vec<String> {
        let reached = |endpoint: &String| match (self, endpoint.split_once('/')) {
            (Self::Mtls(_), Some(("tcp" | "tls", address))) => format!("quic/{address}"),
            _ => endpoint.clone(),
        };
        given.iter().map(reached).collect()
    }

    /// Whether these endpoints may be used for connecting and listening.
    pub(super) fn check(&self, connect: &[String], listen: &[String]) -> Result<(), BusError> {
        for endpoint in connect.iter().chain(listen) {
            let protocol = link_protocol(endpoint);
            let expected = match self {
                _ if protocol.is_none() => "tcp/HOST:PORT, or quic/HOST:PORT with an identity",
                Self::Mtls(_) if protocol != Some("quic") => "quic/HOST:PORT, as this has an identity",
                Self::Loopback | Self::Insecure if matches!(protocol, Some("quic" | "tls")) => {
                    "an identity (`--identity FOLDER`, ZENAV_IDENTITY; `zenav keys issue` makes one)"
                }
                _ => continue,
            };
            return Err(BusError::Config {
                reason: format!("endpoint `{endpoint}`: expected {expected}"),
            });
        }
        match (self, listen.iter().find(|endpoint| !is_loopback(endpoint))) {
            (Self::Loopback, Some(endpoint)) => Err(BusError::Exposed {
                endpoint: endpoint.clone(),
            }),
            _ => Ok(()),
        }
    }

    /// Adds this protection's settings to Zenoh's.
    pub(super) fn settings(&self, mode: WhatAmI, listen: &[String], settings: &mut Value) -> Result<(), BusError> {
        let Self::Mtls(identity) = self else {
            return Ok(());
        };
        settings["transport"]["link"]["tls"] = certificates(identity.folder());
        if mode == WhatAmI::Router && !listen.is_empty() {
            let fleet = identity.fleet()?;
            settings["access_control"] = access_control::rules(fleet, identity.member());
            settings["low_pass_filter"] = access_control::size_limits();
        }
        Ok(())
    }
}

/// Zenoh's settings of links with the identity in a folder: a certificate on each side.
pub(super) fn certificates(folder: &Path) -> Value {
    let file = |name: &str| folder.join(name).to_string_lossy().into_owned();
    json!({
        "root_ca_certificate": file("ca.pem"),
        "listen_certificate": file("cert.pem"),
        "listen_private_key": file("key.pem"),
        "connect_certificate": file("cert.pem"),
        "connect_private_key": file("key.pem"),
        "enable_mtls": true,
        "verify_name_on_connect": true,
        "close_link_on_expiration": true,
    })
}

/// Why a member cannot run a part that works in these roles only; the first is the usual one.
fn wrong_role(own: &Member, part: &str, roles: &[Role]) -> Option<String> {
    if roles.contains(&own.role) {
        return None;
    }
    let named: Vec<String> = roles.iter().map(|role| format!("{role}.NAME")).collect();
    let mut problem = format!(
        "is of {own}, whose role is {}: {part} needs {}",
        own.role,
        named.join(" or ")
    );
    if let Some(usual) = named.first() {
        problem.push_str(&format!(" (`zenav keys issue {usual}` makes one)"));
    }
    Some(problem)
}

/// The protocol of an endpoint, `PROTOCOL/HOST:PORT`; `None` if links do not support it.
#[must_use]
pub fn link_protocol(endpoint: &str) -> Option<&str> {
    let (protocol, address) = endpoint.split_once('/')?;
    (matches!(protocol, "tcp" | "quic" | "tls") && address.contains(':')).then_some(protocol)
}

/// Whether only programs on this machine can reach an endpoint.
fn is_loopback(endpoint: &str) -> bool {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, address)| address);
    let address = address.split(['#', '?', ';']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

impl From<IdentityError> for BusError {
    fn from(error: IdentityError) -> Self {
        Self::Config {
            reason: error.to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::client_settings;

    #[test]
    fn without_an_identity_only_this_machine_is_listened_to() {
        for near in [
            "tcp/127.0.0.1:7447",
            "tcp/[::1]:0",
            "tcp/localhost:7447",
            "tcp/127.9.9.9:1#iface=lo",
        ] {
            assert_eq!(Security::Loopback.check(&[], &[near.to_owned()]), Ok(()), "{near}");
        }
        for far in [
            "tcp/0.0.0.0:7447",
            "tcp/[::]:7447",
            "tcp/10.0.0.2:7447",
            "tcp/robot.local:7447",
            "tcp/127.0.0.1.example.org:1",
        ] {
            let error = Security::Loopback.check(&[], &[far.to_owned()]).unwrap_err();
            let text = error.to_string();
            assert!(
                text.contains(far) && text.contains("--identity") && text.contains("--insecure"),
                "{text}"
            );
            assert_eq!(Security::Insecure.check(&[], &[far.to_owned()]), Ok(()));
        }
        assert_eq!(Security::Loopback.check(&["tcp/10.0.0.2:7447".to_owned()], &[]), Ok(()));
    }

    #[test]
    fn without_an_identity_only_this_machine_reads_the_metrics() {
        for near in ["127.0.0.1:9464", "[::1]:0", "localhost:9464"] {
            assert_eq!(Security::Loopback.check_metrics(near), Ok(()), "{near}");
        }
        for far in ["0.0.0.0:9464", "[::]:9464", "10.0.0.2:9464", "robot.local:9464"] {
            let text = Security::Loopback.check_metrics(far).unwrap_err().to_string();
            assert!(text.contains(far) && text.contains("--insecure"), "{text}");
            assert_eq!(Security::Insecure.check_metrics(far), Ok(()));
        }
    }

    #[test]
    fn zenoh_takes_the_settings_for_other_programs() {
        let folder = "/etc/zenav-identity/robot.tiago";
        for identity in [None, Some(Path::new(folder))] {
            let settings = client_settings(&["quic/site1:7447".to_owned()], "robot.tiago", identity);
            zenoh::Config::from_json5(&settings.to_string()).unwrap();
            let key = settings.pointer("/transport/link/tls/connect_private_key");
            let expected = identity.map(|_| format!("{folder}/key.pem"));
            assert_eq!(key.and_then(Value::as_str), expected.as_deref());
        }
    }

    #[test]
    fn a_part_needs_a_member_in_its_role() {
        let told = |member: &str, roles: &[Role]| wrong_role(&member.parse().unwrap(), "`zenav cloud`", roles);
        let services = [Role::Service, Role::Router];
        for right in ["service.site1", "router.site1"] {
            assert_eq!(told(right, &services), None, "{right}");
        }
        assert_eq!(
            told("operator.anna", &services).unwrap(),
            "is of operator.anna, whose role is operator: `zenav cloud` needs service.NAME or router.NAME (`zenav keys issue service.NAME` makes one)"
        );
        assert!(told("robot.tiago", &[Role::Router]).is_some());
        assert_eq!(Security::Loopback.check_role("`zenav router`", &[Role::Router]), Ok(()));
    }

    #[test]
    fn a_profile_and_an_identity_must_fit() {
        let folder = Path::new("/nonexistent");
        let section = |profile| SecuritySection {
            profile,
            ..SecuritySection::default()
        };
        let told =
            |section: &SecuritySection, identity| section.security(identity, true).map_err(|error| error.to_string());
        assert_eq!(told(&section(None), None), Ok(Security::Insecure));
        assert_eq!(told(&section(Some(Profile::Open)), None), Ok(Security::Insecure));
        let without = told(&section(Some(Profile::Mtls)), None).unwrap_err();
        assert!(without.contains("expected an identity"), "{without}");
        let with = told(&section(Some(Profile::Open)), Some(folder)).unwrap_err();
        assert!(
            with.contains("/nonexistent") && with.contains("expected mtls"),
            "{with}"
        );
        // The section's own folder counts too.
        let own = SecuritySection {
            profile: Some(Profile::Mtls),
            identity: Some(folder.to_owned()),
        };
        let unread = told(&own, None).unwrap_err();
        assert!(unread.contains("identity /nonexistent: ca.pem"), "{unread}");
    }

    #[test]
    fn a_protected_endpoint_needs_an_identity() {
        let error = Security::Insecure
            .check(&["quic/10.0.0.2:7447".to_owned()], &[])
            .unwrap_err();
        assert!(error.to_string().contains("--identity"), "{error}");
    }
}
