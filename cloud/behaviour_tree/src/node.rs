//! Nodes. What is a node of a tree, apart from what it is doing? Its role, its children, its ports: fixed
//! when the tree is built. What it is doing is [`NodeState`], plain data that can be stored.

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

/// What does a node's work.
pub(crate) enum Role<C> {
    /// The engine's own.
    Builtin(Box<dyn Builtin<C>>),
    /// From outside; index into the tree's bodies.
    Leaf(u32),
    /// From outside; index into the tree's bodies.
    Decorator(u32),
}

/// Scripts that stand around a node (`_skipIf`, `_onSuccess`, …).
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

/// What a tick needs of a node.
pub(crate) struct Node<C> {
    pub(crate) role: Role<C>,
    pub(crate) guards: Option<Box<Guards>>,
    /// Range of its children in the tree's list of children.
    pub(crate) first_child: u32,
    pub(crate) child_count: u32,
}

/// What a reader needs of a node.
pub(crate) struct Info {
    pub(crate) name: Arc<str>,
    pub(crate) id: Arc<str>,
    pub(crate) category: Category,
    pub(crate) parent: Option<NodeId>,
    pub(crate) depth: u16,
    pub(crate) scope: ScopeId,
    pub(crate) ports: Box<[BoundPort]>,
}

/// What a node is doing. The meaning of the counters belongs to the node's family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct NodeState {
    /// As its parent sees it.
    pub status: Status,
    /// What it answered last, kept when the parent resets it.
    pub last: Status,
    /// Its parent has its answer and does not ask again (Parallel).
    pub done: bool,
    /// A latch of its own.
    pub flag: bool,
    /// Index of a child, or of an item.
    pub cursor: u32,
    /// Attempts, cycles, failures.
    pub count: u32,
    /// Children skipped in this activation.
    pub skipped: u32,
    /// A time in ns since the epoch of whoever ticks, or a sequence number.
    pub mark: u64,
    /// How often it was entered from not `Running`.
    pub starts: u32,
}

impl NodeState {
    /// Nothing is counted, latched or timed any more.
    pub(crate) fn clear(&mut self) {
        (self.count, self.flag, self.cursor, self.mark) = (0, false, 0, 0);
    }
}

/// What a node says and remembers.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Memory {
    pub(crate) feedback: String,
    pub(crate) kept: serde_json::Value,
    /// How often `kept` was written.
    pub(crate) writes: u64,
    /// A restart found it running, and it has not been ticked since.
    pub(crate) resuming: bool,
}

/// A time as the states keep it.
pub(crate) fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Milliseconds of a port as nanoseconds; negative ones are none.
pub(crate) fn millis(ms: i64) -> u64 {
    u64::try_from(ms).unwrap_or(0).saturating_mul(1_000_000)
}

/// One more. Counters may come from a stored state, so none may overflow.
pub(crate) fn bump(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}
