//! Fleet. Members of a fleet, and the folder with their keys.
//!
//! | path in the fleet's folder | holds |
//! |---|---|
//! | `ca.pem`, `ca.key` | the certificate authority; its key never leaves this folder |
//! | `issued/ROLE.NAME/` | the identity of a member, to be copied to its machine: `ca.pem`, `cert.pem`, `key.pem`; for routers and robots also `members.txt` |
//! | `members.txt` | all members issued and not revoked |
//! | `revoked.txt` | one line per revoked member: name, serial number, time |

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;
use zenav_protocol::bus::MEMBERS;
use zenav_protocol::member::Member;

use super::certificate::{self, Facts, Pair};
use crate::failure::Failure;

const AUTHORITY: &str = "ca.pem";
const AUTHORITY_KEY: &str = "ca.key";
const REVOKED: &str = "revoked.txt";
const ISSUED: &str = "issued";

/// A fleet's folder.
pub(super) struct Fleet {
    folder: PathBuf,
    authority: Pair,
}

/// A member with its certificate.
pub(super) struct Issued {
    pub(super) member: Member,
    pub(super) facts: Facts,
    pub(super) is_revoked: bool,
}

impl Fleet {
    /// Creates a fleet.
    ///
    /// # Errors
    /// A folder that already holds a fleet, or that cannot be written.
    pub(super) fn create(folder: &Path, days: f64) -> Result<(), Failure> {
        for name in [AUTHORITY, AUTHORITY_KEY] {
            if folder.join(name).exists() {
                return Err(Failure::usage(format!(
                    "{} holds a fleet already ({name}): a new authority would make all its certificates void",
                    folder.display()
                )));
            }
        }
        private_folder(&folder.join(ISSUED))?;
        let authority = certificate::authority(days).map_err(Failure::failed)?;
        write_private(&folder.join(AUTHORITY_KEY), &authority.key)?;
        write(&folder.join(AUTHORITY), &authority.certificate)?;
        write(&folder.join(MEMBERS), "")
    }

    /// Opens a fleet.
    ///
    /// # Errors
    /// A folder without a fleet.
    pub(super) fn open(folder: &Path) -> Result<Self, Failure> {
        let read = |name: &str| {
            fs::read_to_string(folder.join(name)).map_err(|error| {
                Failure::not_found(format!(
                    "{} holds no fleet: {name}: {error} (`zenav keys init --dir {}` makes one)",
                    folder.display(),
                    folder.display()
                ))
            })
        };
        Ok(Self {
            folder: folder.to_owned(),
            authority: Pair {
                certificate: read(AUTHORITY)?,
                key: read(AUTHORITY_KEY)?,
            },
        })
    }

    /// Folder of a member's identity.
    pub(super) fn identity(&self, member: &Member) -> PathBuf {
        self.folder.join(ISSUED).join(member.to_string())
    }

    /// Issues a certificate; with `renew`, a new one for the existing key.
    ///
    /// # Errors
    /// A name that exists or was revoked, or for a renewal one that does not exist; more days than the authority has left.
    pub(super) fn issue(&self, member: &Member, hosts: &[String], days: f64, renew: bool) -> Result<Facts, Failure> {
        let folder = self.identity(member);
        if self.revoked()?.contains(member) {
            return Err(Failure::usage(format!(
                "{member} was revoked: a certificate of this name would let the old one in again; expected another name"
            )));
        }
        let old = folder.join("cert.pem");
        if renew != old.exists() {
            return Err(match renew {
                true => Failure::not_found(format!("{member} was never issued in {}", self.folder.display())),
                false => Failure::usage(format!(
                    "{member} exists: {} (--renew makes a new certificate for its key)",
                    folder.display()
                )),
            });
        }
        let authority = certificate::facts(self.authority.certificate.as_bytes()).map_err(Failure::failed)?;
        let left = (authority.expires - OffsetDateTime::now_utc()).as_seconds_f64() / 86400.0;
        if days > left {
            return Err(Failure::usage(format!(
                "--days {days}: the authority itself ends in {left:.1} days; expected less"
            )));
        }
        let mut hosts = hosts.to_vec();
        if renew && hosts.is_empty() {
            hosts = read_facts(&old)?.hosts;
        }
        // The key is already there if an earlier attempt failed to write the certificate.
        let private = folder.join("key.pem");
        let key = match renew || private.exists() {
            true => Some(fs::read_to_string(&private).map_err(Failure::failed_at(&private))?),
            false => None,
        };
        let pair = certificate::member(member, &hosts, days, &self.authority, key.as_deref())
            .map_err(|error| Failure::usage(format!("{member}: {error} (--host {})", hosts.join(", "))))?;
        private_folder(&folder)?;
        if key.is_none() {
            write_private(&private, &pair.key)?;
        }
        write(&folder.join("ca.pem"), &self.authority.certificate)?;
        write(&old, &pair.certificate)?;
        self.tell_members()?;
        read_facts(&old)
    }

    /// Revokes a member, and updates the folders of members that listen; `false` if it was already revoked. Its files may have been moved
    /// away.
    ///
    /// # Errors
    /// A member that was never issued.
    pub(super) fn revoke(&self, member: &Member) -> Result<bool, Failure> {
        if self.revoked()?.contains(member) {
            // The earlier revocation may have failed before all folders were updated.
            self.tell_members()?;
            return Ok(false);
        }
        let certificate = self.identity(member).join("cert.pem");
        let serial = match certificate.exists() {
            true => read_facts(&certificate)?.serial,
            false if self.members()?.contains(member) => "-".to_owned(),
            false => {
                return Err(Failure::not_found(format!(
                    "{member} was never issued in {}",
                    self.folder.display()
                )));
            }
        };
        let now = OffsetDateTime::now_utc().format(&Rfc3339).map_err(Failure::failed)?;
        let text = self.list(REVOKED)? + &format!("{member} {serial} {now}\n");
        write(&self.folder.join(REVOKED), &text)?;
        self.tell_members()?;
        Ok(true)
    }

    /// All members issued, by name.
    ///
    /// # Errors
    /// A certificate that cannot be read.
    pub(super) fn issued(&self) -> Result<Vec<Issued>, Failure> {
        let revoked = self.revoked()?;
        let folder = self.folder.join(ISSUED);
        let mut issued = Vec::new();
        for entry in fs::read_dir(&folder).map_err(Failure::failed_at(&folder))? {
            let entry = entry.map_err(Failure::failed_at(&folder))?;
            let Ok(member) = entry.file_name().to_string_lossy().parse::<Member>() else {
                continue;
            };
            // Its files were moved to its machine, or it was never finished.
            if !entry.path().join("cert.pem").is_file() {
                continue;
            }
            issued.push(Issued {
                facts: read_facts(&entry.path().join("cert.pem"))?,
                is_revoked: revoked.contains(&member),
                member,
            });
        }
        issued.sort_by(|a, b| a.member.cmp(&b.member));
        Ok(issued)
    }

    /// Text of a list in the fleet's folder; empty if there is none yet.
    fn list(&self, name: &str) -> Result<String, Failure> {
        let path = self.folder.join(name);
        match path.exists() {
            true => fs::read_to_string(&path).map_err(Failure::failed_at(&path)),
            false => Ok(String::new()),
        }
    }

    /// Members in a list, one per line, of which `name_in` takes the name.
    fn listed(&self, list: &str, name_in: fn(&str) -> &str) -> Result<BTreeSet<Member>, Failure> {
        let (text, path) = (self.list(list)?, self.folder.join(list));
        let lines = text.lines().map(str::trim);
        let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
        lines
            .map(|line| name_in(line).parse().map_err(Failure::failed_at(&path)))
            .collect()
    }

    fn revoked(&self) -> Result<BTreeSet<Member>, Failure> {
        self.listed(REVOKED, |line| line.split_whitespace().next().unwrap_or(line))
    }

    fn members(&self) -> Result<BTreeSet<Member>, Failure> {
        self.listed(MEMBERS, |line| line)
    }

    /// Writes the list of members to the folders of all that listen: every member issued, also if its files were moved away since, and not
    /// revoked.
    fn tell_members(&self) -> Result<(), Failure> {
        let (issued, revoked) = (self.issued()?, self.revoked()?);
        let mut members = self.members()?;
        members.extend(issued.iter().map(|issued| issued.member.clone()));
        members.retain(|member| !revoked.contains(member));
        let mut text =
            "# Who belongs to the fleet, written by `zenav keys`: who does not stand here may do nothing.\n".to_owned();
        text.extend(members.iter().map(|member| format!("{member}\n")));
        write(&self.folder.join(MEMBERS), &text)?;
        for issued in issued.iter().filter(|issued| issued.member.role.listens()) {
            write(&self.identity(&issued.member).join(MEMBERS), &text)?;
        }
        Ok(())
    }
}

fn read_facts(path: &Path) -> Result<Facts, Failure> {
    let bytes = fs::read(path).map_err(Failure::failed_at(path))?;
    certificate::facts(&bytes).map_err(Failure::failed_at(path))
}

/// Creates a folder that only its owner may access.
fn private_folder(path: &Path) -> Result<(), Failure> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(path).map_err(Failure::failed_at(path))
}

/// Writes a file atomically.
fn write(path: &Path, text: &str) -> Result<(), Failure> {
    zenav_mapping::write_atomically(path, text.as_bytes()).map_err(Failure::failed)
}

/// Writes a new file atomically that only its owner may read; an existing file is an error.
fn write_private(path: &Path, text: &str) -> Result<(), Failure> {
    let unfinished = path.with_extension("unfinished");
    let mut options = fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let written = options.open(&unfinished).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        // A rename would replace an existing file; not every file system has hard links.
        match fs::hard_link(&unfinished, path) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists && !path.exists() => {
                fs::rename(&unfinished, path)
            }
            linked => linked,
        }
    });
    // If this fails, the leftover does no harm.
    let _ = fs::remove_file(&unfinished);
    written.map_err(Failure::failed_at(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_failed_half_way_is_done_the_next_time_and_who_was_moved_away_stays_a_member() {
        let folder = tempfile::tempdir().unwrap();
        Fleet::create(folder.path(), 30.0).unwrap();
        let fleet = Fleet::open(folder.path()).unwrap();
        let member = |name: &str| name.parse::<Member>().unwrap();
        let (router, guest) = (member("router.site1"), member("operator.guest"));
        for one in [&router, &guest, &member("robot.moved")] {
            fleet.issue(one, &[], 7.0, false).unwrap();
        }
        fs::remove_file(fleet.identity(&member("robot.moved")).join("cert.pem")).unwrap();
        assert!(fleet.revoke(&guest).unwrap());
        // The routers' copy is still the old one, as after a full disk.
        let members = fleet.identity(&router).join(MEMBERS);
        fs::write(&members, "operator.guest\n").unwrap();
        assert!(!fleet.revoke(&guest).unwrap());
        let told = fs::read_to_string(&members).unwrap();
        assert!(
            told.contains("robot.moved") && !told.contains("operator.guest"),
            "{told}"
        );
        // A robot that was stolen together with its files.
        assert!(fleet.revoke(&member("robot.moved")).unwrap());
        assert!(!fs::read_to_string(&members).unwrap().contains("robot.moved"));
        assert!(fleet.revoke(&member("robot.nobody")).is_err());
        // A key without its certificate is reused.
        let anna = member("operator.anna");
        fleet.issue(&anna, &[], 7.0, false).unwrap();
        let key = fs::read(fleet.identity(&anna).join("key.pem")).unwrap();
        fs::remove_file(fleet.identity(&anna).join("cert.pem")).unwrap();
        fleet.issue(&anna, &[], 7.0, false).unwrap();
        assert_eq!(fs::read(fleet.identity(&anna).join("key.pem")).unwrap(), key);
    }
}
