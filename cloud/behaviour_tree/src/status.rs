//! Status. What can a node answer? The five statuses of BehaviorTree.CPP v4.

use serde::{Deserialize, Serialize};

/// A node's last answer, or `Idle` before its first tick and after a reset by its parent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Status {
    /// Not started, or reset by the parent. A node never answers this.
    #[default]
    Idle,
    /// Started, not finished: tick again.
    Running,
    /// Finished; the goal was reached.
    Success,
    /// Finished; the goal was not reached.
    Failure,
    /// Not applicable now: the parent continues as if the node did not exist.
    Skipped,
}

impl Status {
    /// `Success` if the argument is true, else `Failure`.
    pub fn from_truth(holds: bool) -> Status {
        if holds { Status::Success } else { Status::Failure }
    }

    /// `Skipped` if all children were skipped, else this status.
    pub(crate) fn unless_skipped(self, skipped: bool) -> Status {
        if skipped { Status::Skipped } else { self }
    }

    /// `Success` or `Failure`.
    pub fn is_completed(self) -> bool {
        matches!(self, Status::Success | Status::Failure)
    }

    /// Neither `Idle` nor `Skipped`: the node has been ticked since its parent last reset it.
    pub fn is_active(self) -> bool {
        !matches!(self, Status::Idle | Status::Skipped)
    }

    /// The name used in the ecosystem: `SUCCESS`, `FAILURE`, …
    pub fn as_str(self) -> &'static str {
        match self {
            Status::Idle => "IDLE",
            Status::Running => "RUNNING",
            Status::Success => "SUCCESS",
            Status::Failure => "FAILURE",
            Status::Skipped => "SKIPPED",
        }
    }

    /// The status with this name, in any case.
    pub fn from_name(name: &str) -> Option<Status> {
        [
            Status::Idle,
            Status::Running,
            Status::Success,
            Status::Failure,
            Status::Skipped,
        ]
        .into_iter()
        .find(|status| status.as_str().eq_ignore_ascii_case(name.trim()))
    }
}

impl std::fmt::Display for Status {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.pad(self.as_str())
    }
}
