//! Refusals. Why was a request refused?

use std::fmt::Display;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{GoalPoint, Leader, LeaseRole};

/// A server's reply to a request that it does not carry out: `{"error": "Rejected", "reason": …}`.
#[derive(Clone, Debug, Error, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "error")]
pub enum Refusal {
    /// The request was understood, but cannot be carried out.
    #[error("rejected: {reason}{}", nearest(.nearest_free))]
    Rejected {
        /// What prevents it, with the numbers compared.
        reason: String,
        /// The nearest free place, map frame.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        nearest_free: Option<GoalPoint>,
    },
    /// The request was not understood.
    #[error("bad request: {reason}")]
    BadRequest {
        /// What was expected, and where the request differs.
        reason: String,
    },
    /// The request is larger than its key allows.
    #[error("payload too large: at most {limit} bytes here")]
    TooLarge {
        /// The key's limit, bytes.
        limit: usize,
    },
    /// There is no such goal, map, parameter or place.
    #[error("not found: {what}")]
    NotFound {
        /// What was not found.
        what: String,
    },
    /// The server is a standby; another mission leads.
    #[error("not the leader")]
    NotLeader,
    /// The lease has another holder.
    #[error("{holder} holds the lease ({role:?}, epoch {epoch})")]
    Held {
        /// The holder.
        holder: String,
        /// The holder's role.
        role: LeaseRole,
        /// The holder's epoch.
        epoch: u64,
        /// The mission that leads, regardless of who holds the lease.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        leader: Option<Leader>,
    },
    /// The mission may not lead: it lacks goals that were acknowledged for the robot.
    #[error("may not lead: the robot's goals are in the store {}; if no machine has it any more, `zenav lease forget` gives them up", .caught_up.join(" or "))]
    NotCaughtUp {
        /// The stores that hold every goal.
        caught_up: Vec<String>,
    },
    /// The command's lease epoch is not the current one.
    #[error("epoch {got} is not the current one ({current})")]
    WrongEpoch {
        /// The command's epoch.
        got: u64,
        /// The current epoch.
        current: u64,
    },
    /// The server is overloaded; ask again later.
    #[error("busy: {reason}")]
    Busy {
        /// What the server is busy with.
        reason: String,
    },
    /// The server failed.
    #[error("internal: {reason}")]
    Internal {
        /// The server's own error.
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
    /// [`Refusal::Rejected`] with a reason and no nearest free place.
    ///
    /// ```
    /// use zenav_protocol::messages::Refusal;
    ///
    /// let refusal = Refusal::rejected("the goal is 0.12 m from a wall, at least 0.27 m are needed");
    /// assert_eq!(refusal.to_string(), "rejected: the goal is 0.12 m from a wall, at least 0.27 m are needed");
    /// let heard: Refusal = serde_json::from_str(r#"{"error": "WrongEpoch", "got": 3, "current": 4}"#)?;
    /// assert_eq!(heard, Refusal::WrongEpoch { got: 3, current: 4 });
    /// # Ok::<(), serde_json::Error>(())
    /// ```
    #[must_use]
    pub fn rejected(reason: impl Display) -> Self {
        Self::Rejected {
            reason: reason.to_string(),
            nearest_free: None,
        }
    }

    /// [`Refusal::BadRequest`] with what the server expected.
    #[must_use]
    pub fn bad_request(reason: impl Display) -> Self {
        Self::BadRequest {
            reason: reason.to_string(),
        }
    }

    /// [`Refusal::Internal`] with the server's own error.
    #[must_use]
    pub fn internal(reason: impl Display) -> Self {
        Self::Internal {
            reason: reason.to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_reads_as_the_contract_says() {
        let refusal = Refusal::Rejected {
            reason: "the goal is occupied".into(),
            nearest_free: Some(GoalPoint::at(1.0, 2.0)),
        };
        let text = serde_json::to_string(&refusal).unwrap();
        assert_eq!(
            text,
            r#"{"error":"Rejected","reason":"the goal is occupied","nearest_free":{"x":1.0,"y":2.0}}"#
        );
        assert_eq!(serde_json::from_str::<Refusal>(&text).unwrap(), refusal);
    }
}
