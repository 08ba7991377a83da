//! Identity. Who is this process in the fleet, and who else belongs to it? A folder that `zenav keys` makes:
//!
//! | file | holds |
//! |---|---|
//! | `ca.pem` | the fleet's certificate authority |
//! | `cert.pem`, `key.pem` | this member's certificate, and its private key |
//! | `members.txt` | only where others dial in: the fleet's members, a common name a line; who does not stand there may do nothing |
//!
//! Of the private key only the file's path is held here; Zenoh reads it.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use thiserror::Error;
use x509_parser::pem::parse_x509_pem;

use crate::member::Member;

/// Where the fleet's members stand.
pub const MEMBERS: &str = "members.txt";
/// A certificate that ends sooner than this is told of.
const SOON: Duration = Duration::from_secs(14 * 24 * 3600);

/// Who a process is in its fleet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    folder: PathBuf,
    member: Member,
    expires: SystemTime,
    fleet: Option<Vec<Member>>,
}

/// A folder that holds no identity, or one that is of no use any more.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("identity {}: {problem}", .folder.display())]
pub struct IdentityError {
    /// The folder.
    pub folder: PathBuf,
    /// What is wrong, and what was expected.
    pub problem: String,
}

impl Identity {
    /// Reads a folder, and says in the log when its certificate ends soon.
    ///
    /// # Errors
    /// [`IdentityError`]: a file that is missing or unreadable, a certificate whose name is no member's or that has expired.
    pub fn load(folder: &Path) -> Result<Self, IdentityError> {
        let identity = Self::read(folder)?;
        let left = identity.expires.duration_since(SystemTime::now()).unwrap_or_default();
        if left < SOON {
            let member = &identity.member;
            tracing::warn!(%member, hours = left.as_secs() / 3600, "the certificate ends soon: `zenav keys issue {member} --renew`");
        }
        warn_of_open_key(folder);
        Ok(identity)
    }

    /// Whether its folder holds another one now that can be used: other members, or a new certificate.
    #[must_use]
    pub fn is_outdated(&self) -> bool {
        Self::read(&self.folder).is_ok_and(|now| now != *self)
    }

    fn read(folder: &Path) -> Result<Self, IdentityError> {
        let wrong = |problem: String| IdentityError {
            folder: folder.to_owned(),
            problem,
        };
        for name in ["ca.pem", "cert.pem", "key.pem"] {
            std::fs::File::open(folder.join(name)).map_err(|error| {
                wrong(format!(
                    "{name}: {error}; expected a folder that `zenav keys issue` made"
                ))
            })?;
        }
        let bytes = std::fs::read(folder.join("cert.pem")).map_err(|error| wrong(format!("cert.pem: {error}")))?;
        let certificate = |problem: &str| wrong(format!("cert.pem: {problem}"));
        let (_, pem) = parse_x509_pem(&bytes).map_err(|_| certificate("expected a certificate in PEM"))?;
        let parsed = pem
            .parse_x509()
            .map_err(|_| certificate("expected an X.509 certificate"))?;
        let name = parsed
            .subject()
            .iter_common_name()
            .next()
            .and_then(|name| name.as_str().ok());
        let member = name
            .unwrap_or_default()
            .parse::<Member>()
            .map_err(|error| certificate(&error.to_string()))?;
        let ends = u64::try_from(parsed.validity().not_after.timestamp()).unwrap_or(0);
        let expires = UNIX_EPOCH.checked_add(Duration::from_secs(ends)).unwrap_or(UNIX_EPOCH);
        if let Ok(since) = SystemTime::now().duration_since(expires) {
            let hours = since.as_secs() / 3600;
            return Err(certificate(&format!(
                "the certificate of {member} has expired {hours} h ago: `zenav keys issue {member} --renew` makes a new one"
            )));
        }
        let fleet = match std::fs::read_to_string(folder.join(MEMBERS)) {
            Ok(text) => Some(members(&text).map_err(wrong)?),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
            Err(error) => return Err(wrong(format!("{MEMBERS}: {error}"))),
        };
        Ok(Self {
            folder: folder.to_owned(),
            member,
            expires,
            fleet,
        })
    }

    /// Who it is.
    #[must_use]
    pub fn member(&self) -> &Member {
        &self.member
    }

    /// Where it stands.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The members of the fleet.
    ///
    /// # Errors
    /// [`IdentityError`] where there is no list of them.
    pub fn fleet(&self) -> Result<&[Member], IdentityError> {
        self.fleet.as_deref().ok_or_else(|| IdentityError {
            folder: self.folder.clone(),
            problem: format!(
                "{MEMBERS} is missing: who listens must know who belongs to the fleet (`zenav keys issue` writes it for routers and robots)"
            ),
        })
    }

    /// Path of one of its files.
    pub(super) fn file(&self, name: &str) -> String {
        self.folder.join(name).to_string_lossy().into_owned()
    }
}

/// The members that stand in a list: one a line, `#` begins a comment.
///
/// # Errors
/// The line that names none.
fn members(text: &str) -> Result<Vec<Member>, String> {
    let lines = text
        .lines()
        .enumerate()
        .map(|(number, line)| (number + 1, line.split('#').next().unwrap_or_default().trim()));
    lines
        .filter(|(_, line)| !line.is_empty())
        .map(|(number, line)| {
            line.parse::<Member>()
                .map_err(|error| format!("{MEMBERS}:{number}: {error}"))
        })
        .collect()
}

/// Says in the log that others on this machine may read the private key.
#[cfg(unix)]
fn warn_of_open_key(folder: &Path) {
    use std::os::unix::fs::MetadataExt as _;
    let file = folder.join("key.pem");
    if std::fs::metadata(&file).is_ok_and(|found| found.mode() & 0o007 != 0) {
        tracing::warn!(file = %file.display(), "every user of this machine may read this private key: `chmod 600` it");
    }
}

#[cfg(not(unix))]
fn warn_of_open_key(_: &Path) {}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_members_is_read_and_a_bad_line_is_named() {
        let read = members("# the fleet\nrobot.tiago\n\nservice.site1 # here\n").unwrap();
        assert_eq!(
            read.iter().map(ToString::to_string).collect::<Vec<_>>(),
            ["robot.tiago", "service.site1"]
        );
        let error = members("robot.tiago\nanna\n").unwrap_err();
        assert!(error.starts_with("members.txt:2: `anna`"), "{error}");
    }

    #[test]
    fn a_folder_without_keys_is_told_with_the_command_that_makes_one() {
        let error = Identity::load(Path::new("/nonexistent")).unwrap_err().to_string();
        assert!(
            error.contains("/nonexistent") && error.contains("ca.pem") && error.contains("zenav keys issue"),
            "{error}"
        );
    }
}
