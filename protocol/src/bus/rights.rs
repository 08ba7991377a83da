//! Rights. May this process's own member of the fleet use a key? Checked before a request is sent: what an endpoint denies, it drops without
//! an answer.
//!
//! This serves clear errors, not protection: the endpoints enforce the same grants (`access_control`). Publishers and raw access are not
//! checked; tools call [`Bus::check`].

use std::fmt;
use std::sync::Arc;

use thiserror::Error;
use zenoh::key_expr::KeyExpr;

use super::{Bus, BusError, Security};
use crate::access::Grants;
use crate::id::Id;
use crate::member::{Member, Role};

/// What a member does with a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// Publishes on it.
    Write,
    /// Sends requests on it.
    Ask,
    /// Subscribes to it.
    Hear,
}

impl Act {
    /// The keys that are granted for this.
    fn granted(self, grants: &Grants) -> &[String] {
        match self {
            Self::Write => &grants.writes,
            Self::Ask => &grants.asks,
            Self::Hear => &grants.hears,
        }
    }
}

impl fmt::Display for Act {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Write => "write",
            Self::Ask => "ask",
            Self::Hear => "hear",
        })
    }
}

/// A key that a member may not use in this way.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{member} may not {act} {key}: {}", expected(.others))]
pub struct Denied {
    /// Whose rights do not suffice.
    pub member: Member,
    /// What it was about to do.
    pub act: Act,
    /// The key that it was to be done on, wildcards included.
    pub key: String,
    /// Members that may, such as `operator.NAME`; a router, which may do everything, only if no other member may.
    pub others: Vec<String>,
}

fn expected(others: &[String]) -> String {
    if others.is_empty() {
        return "no member of a fleet may".to_owned();
    }
    format!("expected an identity {}", others.join(" or "))
}

/// A member, and what it may do.
#[derive(Debug)]
pub(super) struct Rights {
    member: Member,
    grants: Grants,
}

impl Rights {
    /// Those of this process; `None` if its links are not controlled.
    pub(super) fn of(security: &Security) -> Option<Arc<Self>> {
        let member = security.identity()?.member();
        Some(Arc::new(Self::of_member(member.clone())))
    }

    fn of_member(member: Member) -> Self {
        let grants = Grants::of(&member);
        Self { member, grants }
    }

    fn permit(&self, act: Act, key: &KeyExpr<'_>) -> bool {
        // As on the wire: a key with wildcards must be granted as a whole.
        act.granted(&self.grants)
            .iter()
            .any(|granted| KeyExpr::new(granted.as_str()).is_ok_and(|granted| granted.includes(key)))
    }

    fn check(&self, act: Act, key: &KeyExpr<'_>) -> Result<(), Denied> {
        if self.permit(act, key) {
            return Ok(());
        }
        Err(Denied {
            member: self.member.clone(),
            act,
            key: key.to_string(),
            others: who_may(act, key),
        })
    }
}

/// The members that may do this, as patterns of their names.
fn who_may(act: Act, key: &KeyExpr<'_>) -> Vec<String> {
    let robot = key.split('/').nth(1).unwrap_or_default();
    let member = |role: Role| {
        let name = match role {
            Role::Robot => Id::robot(robot),
            _ => Id::new("NAME"),
        };
        Some(Member { role, name: name.ok()? })
    };
    let may = |role: &Role| member(*role).is_some_and(|member| Rights::of_member(member).permit(act, key));
    let (routers, others): (Vec<Role>, Vec<Role>) = Role::ALL
        .into_iter()
        .filter(may)
        .partition(|role| *role == Role::Router);
    let named = if others.is_empty() { routers } else { others };
    let names = named.into_iter().filter_map(member);
    names.map(|member| member.to_string()).collect()
}

impl Bus {
    /// This process's member of the fleet; `None` if links are not protected.
    #[must_use]
    pub fn member(&self) -> Option<&Member> {
        self.rights.as_deref().map(|rights| &rights.member)
    }

    /// Whether this process's member of the fleet may use a key; it may use every key if links are not protected.
    ///
    /// # Errors
    /// [`BusError::Denied`], [`BusError::Key`].
    pub fn check(&self, act: Act, key: &str) -> Result<(), BusError> {
        let key = Self::key(key.to_owned())?;
        Ok(self.check_key(act, &key)?)
    }

    pub(super) fn check_key(&self, act: Act, key: &KeyExpr<'_>) -> Result<(), Denied> {
        self.rights.as_ref().map_or(Ok(()), |rights| rights.check(act, key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(member: &str, act: Act, key: &str) -> Result<(), String> {
        let rights = Rights::of_member(member.parse().unwrap());
        let checked = rights.check(act, &KeyExpr::new(key).unwrap());
        checked.map_err(|denied| denied.to_string())
    }

    #[test]
    fn a_denied_member_is_told_who_may() {
        for (member, act, key, told) in [
            (
                "viewer.wall",
                Act::Write,
                "zenav/tiago/operator/teleop",
                "viewer.wall may not write zenav/tiago/operator/teleop: expected an identity operator.NAME",
            ),
            (
                "viewer.wall",
                Act::Ask,
                "zenav/*/ask/edge/log",
                "viewer.wall may not ask zenav/*/ask/edge/log: expected an identity service.NAME or operator.NAME",
            ),
            (
                "robot.neato",
                Act::Ask,
                "zenav/*/ask/edge/info",
                "robot.neato may not ask zenav/*/ask/edge/info: expected an identity service.NAME or operator.NAME or viewer.NAME",
            ),
            (
                "operator.anna",
                Act::Write,
                "zenav/tiago/edge/wheels",
                "operator.anna may not write zenav/tiago/edge/wheels: expected an identity robot.tiago",
            ),
            (
                "robot.neato",
                Act::Hear,
                "zenav/tiago/edge/scan",
                "robot.neato may not hear zenav/tiago/edge/scan: expected an identity robot.tiago or service.NAME or operator.NAME or viewer.NAME",
            ),
            (
                "service.site1",
                Act::Write,
                "zenav/sim/clock",
                "service.site1 may not write zenav/sim/clock: expected an identity router.NAME",
            ),
            (
                "operator.anna",
                Act::Write,
                "my/lamp",
                "operator.anna may not write my/lamp: no member of a fleet may",
            ),
        ] {
            assert_eq!(check(member, act, key), Err(told.to_owned()));
        }
    }

    #[test]
    fn a_member_may_do_what_is_its_own() {
        for (member, act, key) in [
            ("operator.anna", Act::Write, "zenav/tiago/operator/teleop"),
            ("operator.anna", Act::Ask, "zenav/*/ask/edge/log"),
            ("viewer.wall", Act::Ask, "zenav/svc/info/*"),
            ("viewer.wall", Act::Hear, "zenav/**"),
            ("robot.neato", Act::Hear, "zenav/neato/edge/state"),
            ("service.site1", Act::Ask, "action/gripper"),
            ("router.site1", Act::Write, "zenav/tiago/edge/wheels"),
        ] {
            assert_eq!(check(member, act, key), Ok(()), "{member} {act} {key}");
        }
    }
}
