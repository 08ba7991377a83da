//! Nodes that ask whether a blackboard entry has been written since they last looked:
//! BehaviorTree.CPP's `SkipUnlessUpdated`, `WaitValueUpdate`, `WasEntryUpdated`.
//!
//! `mark` is the sequence number seen last; it outlives halts.

use super::blackboard::Slot;
use super::node::NodeId;
use super::status::Status;
use super::tick::{Run, Stop};

impl<C> Run<'_, C> {
    /// Ticks the child if the entry was written since the last look, or while the child runs
    /// (`flag`); `otherwise` if not.
    pub(crate) fn if_updated(&mut self, id: NodeId, slot: Slot, otherwise: Status) -> Result<Status, Stop> {
        if !self.states[id as usize].flag && !self.is_news(id, slot) {
            return Ok(otherwise);
        }
        let status = self.only_child(id)?;
        self.states[id as usize].flag = status == Status::Running;
        Ok(status)
    }

    /// `Success` if the entry was written since the last look, else `Failure`.
    pub(crate) fn was_entry_updated(&mut self, id: NodeId, slot: Slot) -> Result<Status, Stop> {
        Ok(if self.is_news(id, slot) {
            Status::Success
        } else {
            Status::Failure
        })
    }

    fn is_news(&mut self, id: NodeId, slot: Slot) -> bool {
        let current = self.board.sequence(slot);
        std::mem::replace(&mut self.states[id as usize].mark, current) != current
    }
}
