//! Sequences and fallbacks that remember their position: BehaviorTree.CPP's `Sequence`, `AsyncSequence`, `SequenceWithMemory`, `Fallback`,
//! `AsyncFallback`.
//!
//! All keep the index of the current child in `cursor` and count skipped children in `skipped`.

use super::Builtin;
use crate::node::{NodeId, NodeState, bump};
use crate::status::Status;
use crate::tick::{Answer, Run};

/// Ticks children in order until one answers `end`. As a Sequence:
///
/// | child | Sequence |
/// |---|---|
/// | `Success`, `Skipped` | continues with the next child in the same tick |
/// | `Running` | `Running`, resumes there |
/// | `Failure` | resets all, `Failure` |
/// | all `Skipped` | `Skipped` |
///
/// A Fallback swaps `Success` and `Failure`.
pub(crate) struct InOrder {
    /// The answer of a child that ends it.
    pub(crate) end: Status,
    /// After a child that is done in its first tick, answers `Running` and asks to be woken, so that it stays interruptible.
    pub(crate) yields: bool,
    /// An `end` keeps the index, so that the next activation retries the child; so does a halt. Otherwise the index is reset.
    pub(crate) remembers: bool,
}

impl InOrder {
    pub(crate) const SEQUENCE: Self = Self {
        end: Status::Failure,
        yields: false,
        remembers: false,
    };
    pub(crate) const FALLBACK: Self = Self {
        end: Status::Success,
        ..Self::SEQUENCE
    };
    /// Yields as in BehaviorTree.CPP 4.10.
    pub(crate) const WITH_MEMORY: Self = Self {
        yields: true,
        remembers: true,
        ..Self::SEQUENCE
    };
}

impl<C> Builtin<C> for InOrder {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        let kids = run.kids(id);
        if !before.is_active() {
            run.states[id].skipped = 0;
        }
        loop {
            let at = run.states[id].cursor as usize;
            let Some(child) = kids.get(at) else { break };
            let fresh = run.states[*child].status == Status::Idle;
            let status = run.exec(*child)?;
            if status == Status::Running {
                return Ok(Status::Running);
            }
            if status == self.end && self.remembers {
                run.reset_children(id);
                return Ok(status);
            }
            if status == self.end {
                return Ok(run.finish(id, status));
            }
            let state = &mut run.states[id];
            bump(&mut state.cursor);
            if status == Status::Skipped {
                bump(&mut state.skipped);
            } else if self.yields && fresh && at + 1 < kids.len() {
                run.wake = true;
                run.changes += 1;
                return Ok(Status::Running);
            }
        }
        let otherwise = Status::from_truth(self.end == Status::Failure);
        let skipped = run.states[id].skipped as usize == kids.len();
        Ok(run.finish(id, otherwise.unless_skipped(skipped)))
    }

    fn after_halt(&self, state: &mut NodeState) {
        let cursor = state.cursor;
        state.clear();
        if self.remembers {
            state.cursor = cursor;
        }
    }
}
