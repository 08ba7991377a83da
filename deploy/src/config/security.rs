//! Security section. How links are protected: flags win over the environment, the environment over the deployment file.

use std::path::PathBuf;

use clap::Args;
use serde::{Deserialize, Serialize};
use zenav_protocol::bus::Security;
use zenav_protocol::settings;

use super::Deployment;
use crate::failure::Failure;

/// How links are protected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// Neither encrypted nor authenticated: for loopback and closed networks.
    Open,
    /// TLS over QUIC, with a certificate on each side.
    Mtls,
}

settings! {
    /// How links are protected.
    pub struct SecuritySection {
        /// `open` or `mtls`; unset: `mtls` when a deployment of many hosts is rendered, `open` on this machine.
        pub profile: Option<Profile> = None;
        /// Folder of this part's `ca.pem`, `cert.pem` and `key.pem`.
        pub identity: Option<PathBuf> = None;
    }
}

/// Identity of this process in its fleet.
#[derive(Clone, Debug, Default, Args)]
pub struct IdentityArgs {
    /// Folder of this process's identity, made by `zenav keys issue`; with it, links are encrypted and both sides present certificates
    #[arg(long, global = true, value_name = "FOLDER", env = "ZENAV_IDENTITY")]
    pub identity: Option<PathBuf>,
}

/// How a process that listens protects its links.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct SecurityArgs {
    #[command(flatten)]
    pub(crate) identity: IdentityArgs,
    /// Listen to other machines without an identity: anyone who reaches an endpoint can command every robot
    #[arg(long)]
    pub(crate) insecure: bool,
}

impl IdentityArgs {
    /// Link protection by this identity; without one, links on this machine only.
    ///
    /// # Errors
    /// A folder that holds no identity.
    pub(crate) fn security(&self) -> Result<Security, Failure> {
        Ok(Security::of(self.identity.as_deref(), false)?)
    }

    /// Like [`Self::security`], with the deployment's settings.
    ///
    /// # Errors
    /// As [`Self::security`]; a profile that does not fit.
    pub(crate) fn security_of(&self, deployment: &Deployment) -> Result<Security, Failure> {
        let security = SecurityArgs {
            identity: self.clone(),
            insecure: false,
        };
        security.security_of(deployment)
    }
}

impl SecurityArgs {
    /// Link protection from these arguments.
    ///
    /// # Errors
    /// A folder that holds no identity.
    pub(crate) fn security(&self) -> Result<Security, Failure> {
        Ok(Security::of(self.identity.identity.as_deref(), self.insecure)?)
    }

    /// Like [`Self::security`], with the deployment's settings.
    ///
    /// # Errors
    /// As [`Self::security`]; a profile that does not fit.
    pub(crate) fn security_of(&self, deployment: &Deployment) -> Result<Security, Failure> {
        let section = &deployment.security;
        let identity = self.identity.identity.as_deref().or(section.identity.as_deref());
        match (section.profile, identity) {
            (Some(Profile::Mtls), None) => Err(Failure::usage(
                "security.profile is mtls: expected an identity (--identity FOLDER, ZENAV_IDENTITY, security.identity)",
            )),
            (Some(Profile::Open), Some(identity)) => Err(Failure::usage(format!(
                "security.profile is open, and there is an identity, {}: expected mtls, or none",
                identity.display()
            ))),
            (_, identity) => Ok(Security::of(identity, self.insecure)?),
        }
    }
}
