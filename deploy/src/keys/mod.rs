//! `zenav keys`: members of a fleet, and their certificates from the fleet's own authority.
//!
//! | file | answers |
//! |---|---|
//! | `certificate` | how is a certificate made, and what does it contain? |
//! | `fleet` | which members are there, and where are their keys? |

mod certificate;
mod fleet;

use std::net::IpAddr;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde::Serialize;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;
use zenav_protocol::member::Member;

use crate::arguments::positive;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};
use fleet::{Fleet, Issued};

/// Why the identity of a member, dialled at these names, is unusable; `None` if it is usable.
pub(crate) fn unusable(dir: &Path, identity: &str, names: &[String]) -> Option<String> {
    let found = || {
        let member: Member = identity.parse().map_err(Failure::usage)?;
        let issued = Fleet::open(dir)?.issued()?;
        Ok::<_, Failure>(issued.into_iter().find(|issued| issued.member == member))
    };
    let issued = match found() {
        Err(failure) => return Some(failure.message),
        Ok(None) => return Some(format!("was never issued in {}", dir.display())),
        Ok(Some(issued)) => issued,
    };
    let renewed = format!("`zenav keys issue {identity} --renew --dir {}", dir.display());
    // `::1` and `0:0:0:0:0:0:0:1` are one address.
    let parsed = |name: &String| name.parse::<IpAddr>().ok();
    let serves = |name: &&String| {
        let same = |host: &String| host == *name || parsed(host).is_some_and(|host| parsed(name) == Some(host));
        issued.facts.hosts.iter().any(same)
    };
    let lacking: Vec<&String> = names.iter().filter(|name| !serves(name)).collect();
    if issued.is_revoked {
        Some("was revoked: expected another name in the deployment file".to_owned())
    } else if issued.facts.expires <= OffsetDateTime::now_utc() {
        Some(format!("has expired: {renewed}` renews it"))
    } else if !lacking.is_empty() {
        let hosts: String = names.iter().map(|name| format!(" --host {name}")).collect();
        Some(format!(
            "does not serve {}, where it is dialled: {renewed}{hosts}` adds it",
            output::listed(lacking)
        ))
    } else {
        None
    }
}

/// Arguments of `zenav keys`.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: a router, a robot, the services and a person\n  zenav keys init\n  zenav keys issue router.site1 --host site1.local --host 10.0.0.2\n  zenav keys issue robot.tiago\n  zenav keys issue service.site1\n  zenav keys issue operator.anna\n  zenav router --listen quic/0.0.0.0:7447 --identity fleet-keys/issued/router.site1\n\nEach folder under fleet-keys/issued goes to the machine of its member; ca.key goes nowhere."
)]
pub struct KeysArgs {
    #[command(subcommand)]
    command: KeysCommand,
    /// Folder of the fleet
    #[arg(long, global = true, value_name = "FOLDER", default_value = "fleet-keys")]
    dir: PathBuf,
}

#[derive(Debug, Subcommand)]
enum KeysCommand {
    /// Create a certificate authority
    Init {
        /// Validity, days
        #[arg(long, default_value_t = 3650.0, value_parser = days)]
        days: f64,
    },
    /// Issue the certificate of a member
    Issue {
        /// ROLE.NAME; roles are router, robot, service, operator, viewer
        member: Member,
        /// Name or address under which others dial a router or robot, in addition to localhost; may be repeated
        #[arg(long, value_name = "HOST", value_parser = host_name)]
        host: Vec<String>,
        /// Validity, days; fractions are allowed
        #[arg(long, default_value_t = 365.0, value_parser = days)]
        days: f64,
        /// Issue a new certificate for the key of an existing member
        #[arg(long)]
        renew: bool,
    },
    /// Revoke a member: remove it from the members.txt of all members that listen
    Revoke {
        /// ROLE.NAME
        member: Member,
    },
    /// List the members
    List {
        /// Output format
        #[arg(short, long, value_enum, default_value_t)]
        output: Format,
    },
}

fn days(text: &str) -> Result<f64, String> {
    match positive(text)? {
        days if days <= 36_500.0 => Ok(days),
        _ => Err("expected up to 36500 days".to_owned()),
    }
}

/// A listed member.
#[derive(Debug, Serialize)]
struct Row {
    role: &'static str,
    name: String,
    serial: String,
    expires: String,
    expired: bool,
    revoked: bool,
    hosts: Vec<String>,
}

impl Row {
    fn of(issued: Issued) -> Result<Self, Failure> {
        Ok(Self {
            role: issued.member.role.as_str(),
            name: issued.member.name.to_string(),
            serial: issued.facts.serial,
            expires: issued.facts.expires.format(&Rfc3339).map_err(Failure::failed)?,
            expired: issued.facts.expires <= OffsetDateTime::now_utc(),
            revoked: issued.is_revoked,
            hosts: issued.facts.hosts,
        })
    }

    fn cells(&self) -> Vec<String> {
        let state = match (self.revoked, self.expired) {
            (true, _) => "revoked",
            (false, true) => "expired",
            (false, false) => "",
        };
        let hosts = self.hosts.join(" ");
        let cells = [self.role, &self.name, &self.serial, &self.expires, state, &hosts];
        cells.map(str::to_owned).into()
    }
}

/// Checks a name that a certificate may serve.
fn host_name(text: &str) -> Result<String, String> {
    let name = text.strip_prefix("*.").unwrap_or(text);
    if text.parse::<IpAddr>().is_ok() || is_host_name(name) {
        Ok(text.to_owned())
    } else {
        Err("expected a name or an IP address, without a port".to_owned())
    }
}

/// Whether a text is the name of a host (RFC 1123; `_` is allowed, too). Its last part is no number, which an address would have there.
pub(crate) fn is_host_name(text: &str) -> bool {
    let is_letter = |letter: u8| letter.is_ascii_alphanumeric() || matches!(letter, b'-' | b'_');
    let is_part = |part: &str| {
        (1..=63).contains(&part.len()) && part.bytes().all(is_letter) && part.trim_matches('-').len() == part.len()
    };
    let is_number = |part: &str| part.bytes().all(|letter| letter.is_ascii_digit());
    text.len() <= 253 && text.split('.').all(is_part) && !text.rsplit('.').next().is_some_and(is_number)
}

/// `zenav keys`.
///
/// # Errors
/// A folder without a fleet, or with one already; a name that exists, was revoked, or was never issued.
pub fn run(args: &KeysArgs) -> Outcome {
    let dir = &args.dir;
    match &args.command {
        KeysCommand::Init { days } => {
            Fleet::create(dir, *days)?;
            crate::output::note(format_args!(
                "{}: an authority; who has its ca.key makes members of the fleet",
                dir.display()
            ));
        }
        KeysCommand::Issue {
            member,
            host,
            days,
            renew,
        } => {
            if !host.is_empty() && !member.role.listens() {
                return Err(Failure::usage(format!(
                    "--host: nobody dials {member}; expected it for a router or a robot"
                )));
            }
            let fleet = Fleet::open(dir)?;
            let facts = fleet.issue(member, host, *days, *renew)?;
            let expires = facts.expires.format(&Rfc3339).map_err(Failure::failed)?;
            crate::output::note(format_args!(
                "{}: valid until {expires}",
                fleet.identity(member).display()
            ));
        }
        KeysCommand::Revoke { member } => {
            let fleet = Fleet::open(dir)?;
            if !fleet.revoke(member)? {
                crate::output::note(format_args!("{member} was revoked before"));
                return Ok(exit_code::OK);
            }
            let issued = fleet.issued()?;
            let listens = issued
                .iter()
                .filter(|issued| issued.member.role.listens() && !issued.is_revoked);
            crate::output::note(format_args!(
                "{member} is revoked. Copy members.txt to the machines of {}: two seconds later a router lets it in no more, and a robot comes to rest and starts anew",
                output::listed(listens.map(|issued| &issued.member))
            ));
        }
        KeysCommand::List { output } => {
            let rows: Vec<Row> = Fleet::open(dir)?
                .issued()?
                .into_iter()
                .map(Row::of)
                .collect::<Result<_, _>>()?;
            output::values(*output, &rows, |rows| {
                let header = ["ROLE", "NAME", "SERIAL", "EXPIRES", "STATE", "HOSTS"];
                output::table(&header, rows.iter().map(Row::cells))
            })?;
        }
    }
    Ok(exit_code::OK)
}

/// Creates a fleet with one member for a month; returns the folder of its identity.
///
/// # Errors
/// As [`run`]; an invalid member name.
pub fn make(folder: &Path, member: &str) -> Result<PathBuf, Failure> {
    let member: Member = member.parse().map_err(Failure::usage)?;
    Fleet::create(folder, 60.0)?;
    let fleet = Fleet::open(folder)?;
    fleet.issue(&member, &[], 30.0, false)?;
    Ok(fleet.identity(&member))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(dir: &Path, command: KeysCommand) -> Outcome {
        run(&KeysArgs {
            command,
            dir: dir.to_owned(),
        })
    }

    fn issue(member: &str) -> KeysCommand {
        KeysCommand::Issue {
            member: member.parse().unwrap(),
            host: Vec::new(),
            days: 1.0,
            renew: false,
        }
    }

    fn revoke(member: &str) -> KeysCommand {
        KeysCommand::Revoke {
            member: member.parse().unwrap(),
        }
    }

    #[test]
    fn whoever_listens_knows_who_was_issued_and_not_revoked() {
        let dir = tempfile::tempdir().unwrap();
        let dir = dir.path().join("fleet");
        keys(&dir, KeysCommand::Init { days: 10.0 }).unwrap();
        for member in ["router.r", "operator.anna", "viewer.wall", "robot.tiago"] {
            keys(&dir, issue(member)).unwrap();
        }
        keys(&dir, revoke("operator.anna")).unwrap();
        let told = |member: &str| std::fs::read_to_string(dir.join("issued").join(member).join("members.txt"));
        for member in ["router.r", "robot.tiago"] {
            let text = told(member).unwrap();
            let names: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
            assert_eq!(names, ["router.r", "robot.tiago", "viewer.wall"], "{member}");
        }
        assert!(told("viewer.wall").is_err());
        let issued = Fleet::open(&dir).unwrap().issued().unwrap();
        assert_eq!(issued.iter().filter(|issued| issued.is_revoked).count(), 1);
    }

    #[test]
    fn what_cannot_be_is_refused_with_what_was_expected() {
        let dir = tempfile::tempdir().unwrap();
        let dir = dir.path().join("fleet");
        let refused = |command: KeysCommand, code: u8, part: &str| {
            let failure = keys(&dir, command).unwrap_err();
            assert!(
                failure.code == code && failure.message.contains(part),
                "{}: {failure}",
                failure.code
            );
        };
        refused(issue("robot.a"), exit_code::NOT_FOUND, "zenav keys init");
        keys(&dir, KeysCommand::Init { days: 10.0 }).unwrap();
        refused(
            KeysCommand::Init { days: 10.0 },
            exit_code::USAGE,
            "holds a fleet already",
        );
        keys(&dir, issue("robot.a")).unwrap();
        refused(issue("robot.a"), exit_code::USAGE, "--renew");
        refused(revoke("robot.b"), exit_code::NOT_FOUND, "never issued");
        keys(&dir, revoke("robot.a")).unwrap();
        keys(&dir, revoke("robot.a")).unwrap();
        refused(issue("robot.a"), exit_code::USAGE, "another name");
        let long = KeysCommand::Issue {
            member: "robot.c".parse().unwrap(),
            host: Vec::new(),
            days: 20.0,
            renew: false,
        };
        refused(long, exit_code::USAGE, "authority itself ends");
    }

    #[cfg(unix)]
    #[test]
    fn private_keys_are_their_owner_s_alone() {
        use std::os::unix::fs::PermissionsExt as _;
        let dir = tempfile::tempdir().unwrap();
        let dir = dir.path().join("fleet");
        keys(&dir, KeysCommand::Init { days: 10.0 }).unwrap();
        keys(&dir, issue("robot.a")).unwrap();
        for file in ["ca.key", "issued/robot.a/key.pem"] {
            let mode = std::fs::metadata(dir.join(file)).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600, "{file}");
        }
    }

    #[test]
    fn a_host_is_a_name_or_an_address() {
        for good in ["site1.local", "10.0.0.2", "fe80::1", "*.site1.local", "R2-D2_a"] {
            assert!(host_name(good).is_ok(), "{good}");
        }
        for bad in [
            "",
            "a b",
            "site1:7447",
            "tcp/site1",
            "a..b",
            "a.",
            "-",
            "a.-b",
            "300.1.1.1",
            "10.1",
            "*.",
        ] {
            assert!(host_name(bad).unwrap_err().contains("without a port"), "{bad}");
        }
    }
}
