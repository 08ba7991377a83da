//! Sequences and fallbacks that remember where they were: BehaviorTree.CPP's `Sequence`,
//! `AsyncSequence`, `SequenceWithMemory`, `Fallback`, `AsyncFallback`.
//!
//! All keep the index of the current child in `cursor` and count skipped children in `skipped`.

use super::node::{NodeId, bump};
use super::status::Status;
use super::tick::{Run, Stop};

impl<C> Run<'_, C> {
    /// Children in order. `Success` or `Skipped`: the next child in the same tick. `Running`:
    /// `Running`, resumes there. `Failure`: resets all, `Failure`. All skipped: `Skipped`.
    ///
    /// `yields` (AsyncSequence): after a child that succeeds in its first tick, answers `Running`
    /// and asks to be woken, so that it stays interruptible.
    pub(crate) fn sequence(&mut self, id: NodeId, yields: bool, before: Status) -> Result<Status, Stop> {
        self.until(id, Status::Failure, yields, before)
    }

    /// Children in order until one succeeds: `Sequence` with the parts of `Success` and `Failure`
    /// exchanged.
    pub(crate) fn fallback(&mut self, id: NodeId, yields: bool, before: Status) -> Result<Status, Stop> {
        self.until(id, Status::Success, yields, before)
    }

    /// Goes through the children until one answers `end`.
    fn until(&mut self, id: NodeId, end: Status, yields: bool, before: Status) -> Result<Status, Stop> {
        let kids = self.kids(id);
        if !before.is_active() {
            self.states[id as usize].skipped = 0;
        }
        loop {
            let at = self.states[id as usize].cursor as usize;
            let Some(child) = kids.get(at) else { break };
            let fresh = self.states[*child as usize].status == Status::Idle;
            let status = self.exec(*child)?;
            if status == Status::Running {
                return Ok(Status::Running);
            }
            if status == end {
                self.reset_children(id);
                self.states[id as usize].cursor = 0;
                return Ok(end);
            }
            let state = &mut self.states[id as usize];
            bump(&mut state.cursor);
            if status == Status::Skipped {
                bump(&mut state.skipped);
            } else if yields && fresh && at + 1 < kids.len() {
                self.wake = true;
                self.changes += 1;
                return Ok(Status::Running);
            }
        }
        self.reset_children(id);
        let state = &mut self.states[id as usize];
        state.cursor = 0;
        if state.skipped as usize == kids.len() {
            return Ok(Status::Skipped);
        }
        Ok(if end == Status::Failure {
            Status::Success
        } else {
            Status::Failure
        })
    }

    /// `Sequence`, but `Failure` keeps the index, so that the next activation tries the failed
    /// child again; a halt keeps it too. Only going through to the end sets it back.
    pub(crate) fn sequence_with_memory(&mut self, id: NodeId, before: Status) -> Result<Status, Stop> {
        let kids = self.kids(id);
        if !before.is_active() {
            self.states[id as usize].skipped = 0;
        }
        loop {
            let at = self.states[id as usize].cursor as usize;
            let Some(child) = kids.get(at) else { break };
            match self.exec(*child)? {
                Status::Running => return Ok(Status::Running),
                Status::Failure => {
                    self.reset_children(id);
                    return Ok(Status::Failure);
                }
                Status::Skipped => bump(&mut self.states[id as usize].skipped),
                _ => {}
            }
            bump(&mut self.states[id as usize].cursor);
        }
        self.reset_children(id);
        let state = &mut self.states[id as usize];
        state.cursor = 0;
        Ok(if state.skipped as usize == kids.len() {
            Status::Skipped
        } else {
            Status::Success
        })
    }
}
