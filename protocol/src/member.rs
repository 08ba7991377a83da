//! Members. Which participants does a fleet have, and in which roles? The common name of a member's certificate states both: `ROLE.NAME`.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::id::{Id, InvalidId};

/// Permissions of a member; [`Grants::of`](crate::access::Grants::of) translates them into keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// A hub of links: it forwards everything, so it is trusted with everything. A world server, or a whole deployment in one process.
    Router,
    /// One robot: its edge, and the body that the edge drives.
    Robot,
    /// Off-board services: mapping, motion, mission.
    Service,
    /// A person who commands, or a page for commanding.
    Operator,
    /// A read-only participant.
    Viewer,
}

impl Role {
    /// All roles.
    pub const ALL: [Self; 5] = [Self::Router, Self::Robot, Self::Service, Self::Operator, Self::Viewer];

    /// Name of the role in a common name.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Router => "router",
            Self::Robot => "robot",
            Self::Service => "service",
            Self::Operator => "operator",
            Self::Viewer => "viewer",
        }
    }

    /// Whether other members connect to it: its certificate is then also valid for an endpoint.
    #[must_use]
    pub const fn listens(self) -> bool {
        matches!(self, Self::Router | Self::Robot)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A member of a fleet.
///
/// ```
/// use zenav_protocol::member::{Member, Role};
///
/// let robot: Member = "robot.tiago".parse().unwrap();
/// assert_eq!((robot.role, robot.name.as_str()), (Role::Robot, "tiago"));
/// assert_eq!(robot.to_string(), "robot.tiago");
/// assert!("pilot.anna".parse::<Member>().is_err());
/// ```
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Member {
    /// The member's role.
    pub role: Role,
    /// The member's name; for a robot, it is part of every key.
    pub name: Id,
}

/// A text that is not a valid member name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NoMember {
    /// The role is unknown or missing.
    #[error("`{0}`: expected ROLE.NAME, where ROLE is router, robot, service, operator or viewer")]
    Role(String),
    /// The name is not valid in a key.
    #[error(transparent)]
    Name(#[from] InvalidId),
}

impl FromStr for Member {
    type Err = NoMember;

    fn from_str(text: &str) -> Result<Self, NoMember> {
        let unknown = || NoMember::Role(text.chars().take(80).collect());
        let (role, name) = text.split_once('.').ok_or_else(unknown)?;
        let role = Role::ALL
            .into_iter()
            .find(|known| known.as_str() == role)
            .ok_or_else(unknown)?;
        let name = match role {
            Role::Robot => Id::robot(name)?,
            _ => Id::new(name)?,
        };
        Ok(Self { role, name })
    }
}

impl fmt::Display for Member {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.role, self.name.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_common_name_says_role_and_name_and_nothing_else_is_one() {
        for role in Role::ALL {
            let text = format!("{role}.a-1");
            assert_eq!(text.parse::<Member>().unwrap().to_string(), text);
        }
        for bad in [
            "",
            "robot",
            "robot.",
            "robot.a/b",
            "robot.a.b",
            "Robot.a",
            "robot.sim",
            "robot.*",
            ".a",
            "admin.a",
        ] {
            assert!(bad.parse::<Member>().is_err(), "{bad}");
        }
    }
}
