//! Identity. Which member of the fleet is this process, and which other members are there? Read from a folder that `zenav keys` makes:
//!
//! | file | content |
//! |---|---|
//! | `ca.pem` | the fleet's certificate authority |
//! | `cert.pem`, `key.pem` | this member's certificate, and its private key |
//! | `members.txt` | only for members that listen: all members of the fleet, one common name per line; a member not listed has no access |
//!
//! Only the path of the private key is held here; Zenoh reads the file.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use thiserror::Error;
use x509_parser::pem::parse_x509_pem;

use crate::member::Member;

/// File with the list of the fleet's members.
pub const MEMBERS: &str = "members.txt";
/// A certificate that expires within this time causes a warning.
const SOON: Duration = Duration::from_secs(14 * 24 * 3600);

/// Period at which the folder is read again.
const LOOK: Duration = Duration::from_secs(1);

/// The identity of a process in its fleet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    folder: PathBuf,
    member: Member,
    expires: SystemTime,
    fleet: Option<Vec<Member>>,
}

/// A folder without an identity, or with one that is no longer valid.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("identity {}: {problem}", .folder.display())]
pub struct IdentityError {
    /// The folder that was to hold an identity.
    pub folder: PathBuf,
    /// The problem, and what was expected.
    pub problem: String,
}

impl Identity {
    /// Reads a folder, and logs a warning when its certificate expires soon.
    ///
    /// # Errors
    /// [`IdentityError`]: a file that is missing or unreadable, a certificate that has expired or whose name is not a member's.
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

    /// Waits until the folder holds a different valid identity: other members, or a new certificate. Zenoh cannot reload these while it
    /// runs. Two reads in succession must agree, and a list must have this member: a list that is copied in place is empty or cut for a
    /// moment.
    pub async fn outdated(&self) {
        self.until(|now| now != self).await;
    }

    /// Waits until the folder lists a member of the fleet no more: it was revoked. As cautious as [`Self::outdated`].
    pub async fn revoked(&self) {
        self.until(|now| now.lacks_a_member_of(self)).await;
    }

    async fn until(&self, is_met: impl Fn(&Self) -> bool) {
        let mut before = None;
        loop {
            tokio::time::sleep(LOOK).await;
            let now = Self::read(&self.folder).ok().filter(&is_met);
            if now.as_ref().is_some_and(|now| now.is_settled(before.as_ref())) {
                return;
            }
            before = now;
        }
    }

    /// Whether the folder was read completely: as the time before, and with this member in its list, if it has one.
    fn is_settled(&self, before: Option<&Self>) -> bool {
        before == Some(self) && self.fleet.as_ref().is_none_or(|fleet| fleet.contains(&self.member))
    }

    fn lacks_a_member_of(&self, earlier: &Self) -> bool {
        match (&self.fleet, &earlier.fleet) {
            (Some(now), Some(earlier)) => earlier.iter().any(|member| !now.contains(member)),
            _ => false,
        }
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

    /// The member that the identity belongs to.
    #[must_use]
    pub fn member(&self) -> &Member {
        &self.member
    }

    /// Folder of the identity.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The members of the fleet.
    ///
    /// # Errors
    /// [`IdentityError`] if there is no list of members.
    pub fn fleet(&self) -> Result<&[Member], IdentityError> {
        self.fleet.as_deref().ok_or_else(|| IdentityError {
            folder: self.folder.clone(),
            problem: format!(
                "{MEMBERS} is missing: who listens must know who belongs to the fleet (`zenav keys issue` writes it for routers and robots)"
            ),
        })
    }
}

/// Parses a list of members: one per line, `#` starts a comment.
///
/// # Errors
/// The first line that is not a member.
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

/// Logs a warning if other users of this machine can read the private key.
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

    /// The identity of `robot.tiago`, with this list of members.
    fn identity(fleet: Option<&str>) -> Identity {
        Identity {
            folder: PathBuf::new(),
            member: "robot.tiago".parse().unwrap(),
            expires: UNIX_EPOCH,
            fleet: fleet.map(|text| members(text).unwrap()),
        }
    }

    #[test]
    fn who_is_listed_no_more_was_revoked() {
        let earlier = identity(Some("robot.tiago\noperator.bert"));
        for (now, is_revoked) in [
            (Some("robot.tiago"), true),
            (Some("robot.tiago\noperator.anna"), true),
            (Some("operator.bert\nrobot.tiago\noperator.anna"), false),
            (None, false),
        ] {
            assert_eq!(identity(now).lacks_a_member_of(&earlier), is_revoked, "{now:?}");
        }
        assert!(!earlier.lacks_a_member_of(&identity(None)), "a service has no list");
    }

    #[test]
    fn a_list_that_is_empty_or_changes_from_one_read_to_the_next_revokes_nobody() {
        let whole = "robot.tiago\noperator.bert";
        for (before, now, is_settled) in [
            (Some(whole), Some(whole), true),
            (Some("robot.tiago"), Some("robot.tiago"), true),
            (None, None, true),
            (Some("robot.tiago"), Some(whole), false),
            (Some(whole), Some("robot.tiago"), false),
            (Some(whole), Some(""), false),
            (Some(""), Some(""), false),
            (Some("operator.bert"), Some("operator.bert"), false),
        ] {
            let settled = identity(now).is_settled(Some(&identity(before)));
            assert_eq!(settled, is_settled, "{before:?}, then {now:?}");
        }
        assert!(!identity(Some(whole)).is_settled(None), "the first read");
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
