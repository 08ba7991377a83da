//! Security options. How links are protected: flags win over the environment, the environment over the deployment file.

use std::path::PathBuf;

use clap::Args;
use zenav_protocol::bus::Security;
pub use zenav_protocol::bus::{Profile, SecuritySection};

use super::Deployment;
use crate::failure::Failure;

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
    /// Listen to other machines without an identity, --metrics included: anyone who reaches an endpoint can command every robot
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
        let identity = self.identity.identity.as_deref();
        Ok(deployment.security.security(identity, self.insecure)?)
    }
}
