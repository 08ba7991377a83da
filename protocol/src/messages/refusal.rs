//! Why was an ask refused? One enum, one table to exit codes.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{GoalPoint, LeaseRole};

/// An error reply: `{"error": "Rejected", "reason": …}`.
#[derive(Clone, Debug, Error, PartialEq, Serialize, Deserialize)]
#[serde(tag = "error")]
pub enum Refusal {
    /// Understood, but not to be done.
    #[error("rejected: {reason}{}", nearest(.nearest_free))]
    Rejected {
        /// What stands against it.
        reason: String,
        /// The nearest place that would do, map frame.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        nearest_free: Option<GoalPoint>,
    },
    /// Not understood.
    #[error("bad request: {reason}")]
    BadRequest {
        /// What was expected, and where it went wrong.
        reason: String,
    },
    /// More bytes than the key's limit.
    #[error("payload too large: at most {limit} bytes here")]
    TooLarge {
        /// The key's limit, bytes.
        limit: usize,
    },
    /// No such goal, map, parameter, place.
    #[error("not found: {what}")]
    NotFound {
        /// What was looked for.
        what: String,
    },
    /// This server stands by; another one leads.
    #[error("not the leader")]
    NotLeader,
    /// Somebody else may command the robot now.
    #[error("{holder} holds the lease ({role:?}, epoch {epoch})")]
    Held {
        /// Who.
        holder: String,
        /// As what.
        role: LeaseRole,
        /// Their epoch.
        epoch: u64,
        /// The store of the mission that leads, whoever holds the lease.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        leader: Option<String>,
    },
    /// A mission that does not hold all goals that were acknowledged for the robot.
    #[error("only {} may lead: its goals are not known here", .caught_up.join(" or "))]
    NotCaughtUp {
        /// The stores that hold them.
        caught_up: Vec<String>,
    },
    /// A command of another epoch than the current one.
    #[error("epoch {got} is not the current one, {current}")]
    WrongEpoch {
        /// The command's.
        got: u64,
        /// The current one.
        current: u64,
    },
    /// Too much to do; ask again later.
    #[error("busy: {reason}")]
    Busy {
        /// With what.
        reason: String,
    },
    /// The server itself failed.
    #[error("internal: {reason}")]
    Internal {
        /// How.
        reason: String,
    },
}

fn nearest(nearest_free: &Option<GoalPoint>) -> String {
    nearest_free
        .as_ref()
        .map(|p| format!(" (nearest free place: {:.2}, {:.2})", p.x, p.y))
        .unwrap_or_default()
}

impl Refusal {
    /// A rejection with a reason alone.
    #[must_use]
    pub fn rejected(reason: impl Into<String>) -> Self {
        Self::Rejected {
            reason: reason.into(),
            nearest_free: None,
        }
    }

    /// A request that could not be understood.
    #[must_use]
    pub fn bad_request(reason: impl Into<String>) -> Self {
        Self::BadRequest { reason: reason.into() }
    }

    /// The exit code of a command line that met this refusal.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::Internal { .. } | Self::NotLeader => exit_code::FAILED,
            Self::BadRequest { .. } | Self::TooLarge { .. } => exit_code::USAGE,
            Self::NotFound { .. } => exit_code::NOT_FOUND,
            Self::Busy { .. } => exit_code::TIMEOUT,
            Self::Rejected { .. } | Self::Held { .. } | Self::NotCaughtUp { .. } | Self::WrongEpoch { .. } => {
                exit_code::REJECTED
            }
        }
    }
}

/// Exit codes of every command.
pub mod exit_code {
    /// Done.
    pub const OK: u8 = 0;
    /// Failed.
    pub const FAILED: u8 = 1;
    /// The command line or its input was wrong.
    pub const USAGE: u8 = 2;
    /// No such robot, goal, file.
    pub const NOT_FOUND: u8 = 3;
    /// No router, no peer.
    pub const CANNOT_CONNECT: u8 = 4;
    /// No answer in time.
    pub const TIMEOUT: u8 = 5;
    /// The goal was canceled.
    pub const CANCELED: u8 = 6;
    /// The goal was rejected.
    pub const REJECTED: u8 = 7;
    /// Ctrl-C.
    pub const INTERRUPTED: u8 = 130;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_reads_as_the_contract_says() {
        let refusal = Refusal::Rejected {
            reason: "the goal is occupied".into(),
            nearest_free: Some(GoalPoint {
                x: 1.0,
                y: 2.0,
                yaw: None,
            }),
        };
        let text = serde_json::to_string(&refusal).unwrap();
        assert_eq!(
            text,
            r#"{"error":"Rejected","reason":"the goal is occupied","nearest_free":{"x":1.0,"y":2.0}}"#
        );
        assert_eq!(serde_json::from_str::<Refusal>(&text).unwrap(), refusal);
        assert_eq!(refusal.exit_code(), 7);
    }
}
