//! Nodes. What is the fixed part of a node? Its role, children and ports, fixed when the tree is built. Its run-time state is
//! [`NodeState`], plain data that can be stored.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::blackboard::ScopeId;
use super::nodes::Builtin;
use super::ports::BoundPort;
use super::registry::Category;
use super::script::Program;
use super::status::Status;

/// Index of a node in its tree, in document order; its uid is one more.
pub(crate) type NodeId = u32;

/// Implementation of a node.
pub(crate) enum Role<C> {
    /// Built into the engine.
    Builtin(Box<dyn Builtin<C>>),
    /// External; index into the tree's bodies.
    Leaf(u32),
    /// External; index into the tree's bodies.
    Decorator(u32),
}

/// Scripts around a node (`_skipIf`, `_onSuccess`, …).
#[derive(Default)]
pub(crate) struct Guards {
    pub(crate) failure_if: Option<Program>,
    pub(crate) success_if: Option<Program>,
    pub(crate) skip_if: Option<Program>,
    pub(crate) while_true: Option<Program>,
    pub(crate) on_success: Option<Program>,
    pub(crate) on_failure: Option<Program>,
    pub(crate) on_halted: Option<Program>,
    pub(crate) post: Option<Program>,
}

/// The part of a node needed by a tick.
pub(crate) struct Node<C> {
    pub(crate) role: Role<C>,
    pub(crate) guards: Option<Box<Guards>>,
    /// Range of its children in the tree's list of children.
    pub(crate) first_child: u32,
    pub(crate) child_count: u32,
}

/// The part of a node needed for display.
pub(crate) struct Info {
    pub(crate) name: Arc<str>,
    pub(crate) id: Arc<str>,
    pub(crate) category: Category,
    pub(crate) parent: Option<NodeId>,
    pub(crate) depth: u16,
    pub(crate) scope: ScopeId,
    pub(crate) ports: Box<[BoundPort]>,
    /// Ports and scripts with their texts, as in the tree file.
    pub(crate) written: Box<[(Box<str>, Box<str>)]>,
}

/// Run-time state of a node. The meaning of the counters is defined by the node's family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct NodeState {
    /// As its parent sees it.
    pub status: Status,
    /// Its last answer, kept when the parent resets it.
    pub last: Status,
    /// Its parent has its answer and does not tick it again (Parallel).
    pub done: bool,
    /// A latch of the node.
    pub flag: bool,
    /// Index of a child, or of an item.
    pub cursor: u32,
    /// Attempts, cycles, failures.
    pub count: u32,
    /// Children skipped in this activation.
    pub skipped: u32,
    /// A time in ns since the epoch of the tick times, or a sequence number.
    pub mark: u64,
    /// How often it was entered from a status other than `Running`.
    pub starts: u32,
}

impl NodeState {
    /// Resets all counters, latches and times.
    pub(crate) fn clear(&mut self) {
        (self.count, self.flag, self.cursor, self.mark) = (0, false, 0, 0);
    }
}

/// Feedback and memory of a node.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Memory {
    pub(crate) feedback: String,
    pub(crate) kept: serde_json::Value,
    /// How often `kept` was written.
    pub(crate) writes: u64,
    /// It was running when a restart interrupted it, and has not been ticked since.
    pub(crate) resuming: bool,
}

/// A time in the form stored in states.
pub(crate) fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Milliseconds of a port as nanoseconds; negative values become 0.
pub(crate) fn millis(ms: i64) -> u64 {
    u64::try_from(ms).unwrap_or(0).saturating_mul(1_000_000)
}

/// Increments a counter. Counters may come from a stored state, so overflow must be avoided.
pub(crate) fn bump(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}
