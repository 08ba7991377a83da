//! Sequences and fallbacks that remember their position: BehaviorTree.CPP's `Sequence`, `AsyncSequence`, `SequenceWithMemory`, `Fallback`,
//! `AsyncFallback`.
//!
//! All keep the index of the current child in `cursor` and count skipped children in `skipped`.

use super::Builtin;
use crate::node::{NodeId, NodeState, bump};
use crate::status::Status;
use crate::tick::{Answer, Run};

/// Ticks children in order.
///
/// | child | Sequence |
/// |---|---|
/// | `Success`, `Skipped` | continues with the next child in the same tick |
/// | `Running` | `Running`, resumes there |
/// | `Failure` | resets all, `Failure` |
/// | all `Skipped` | `Skipped` |
///
/// `yields` (AsyncSequence): after a child that succeeds in its first tick, answers `Running` and asks to be woken, so that it stays
/// interruptible.
pub(crate) struct Sequence {
    pub(crate) yields: bool,
}

/// Ticks children in order until one succeeds: [`Sequence`] with `Success` and `Failure` swapped.
pub(crate) struct Fallback {
    pub(crate) yields: bool,
}

impl<C> Builtin<C> for Sequence {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        until(run, id, Status::Failure, self.yields, before)
    }
}

impl<C> Builtin<C> for Fallback {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        until(run, id, Status::Success, self.yields, before)
    }
}

/// Ticks the children in order until one answers `end`.
fn until<C>(run: &mut Run<'_, C>, id: NodeId, end: Status, yields: bool, before: Status) -> Answer {
    let kids = run.kids(id);
    if !before.is_active() {
        run.states[id as usize].skipped = 0;
    }
    loop {
        let at = run.states[id as usize].cursor as usize;
        let Some(child) = kids.get(at) else { break };
        let fresh = run.states[*child as usize].status == Status::Idle;
        let status = run.exec(*child)?;
        if status == Status::Running {
            return Ok(Status::Running);
        }
        if status == end {
            return Ok(run.finish(id, end));
        }
        let state = &mut run.states[id as usize];
        bump(&mut state.cursor);
        if status == Status::Skipped {
            bump(&mut state.skipped);
        } else if yields && fresh && at + 1 < kids.len() {
            run.wake = true;
            run.changes += 1;
            return Ok(Status::Running);
        }
    }
    let otherwise = Status::from_truth(end == Status::Failure);
    let skipped = run.states[id as usize].skipped as usize == kids.len();
    Ok(run.finish(id, otherwise.unless_skipped(skipped)))
}

/// [`Sequence`], but `Failure` keeps the index, so that the next activation retries the failed child; so does a halt. The index is reset
/// only at the end.
pub(crate) struct SequenceWithMemory;

impl<C> Builtin<C> for SequenceWithMemory {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        let kids = run.kids(id);
        if !before.is_active() {
            run.states[id as usize].skipped = 0;
        }
        loop {
            let at = run.states[id as usize].cursor as usize;
            let Some(child) = kids.get(at) else { break };
            let fresh = run.states[*child as usize].status == Status::Idle;
            let status = run.exec(*child)?;
            match status {
                Status::Running => return Ok(Status::Running),
                Status::Failure => {
                    run.reset_children(id);
                    return Ok(Status::Failure);
                }
                Status::Skipped => bump(&mut run.states[id as usize].skipped),
                _ => {}
            }
            bump(&mut run.states[id as usize].cursor);
            // As in BehaviorTree.CPP 4.10, so that it stays interruptible.
            if status == Status::Success && fresh && at + 1 < kids.len() {
                run.wake = true;
                run.changes += 1;
                return Ok(Status::Running);
            }
        }
        let skipped = run.states[id as usize].skipped as usize == kids.len();
        Ok(run.finish(id, Status::Success.unless_skipped(skipped)))
    }

    fn after_halt(&self, state: &mut NodeState) {
        let cursor = state.cursor;
        state.clear();
        state.cursor = cursor;
    }
}
