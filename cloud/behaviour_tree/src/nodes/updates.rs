//! Nodes that check whether a blackboard entry has been written since their last check: BehaviorTree.CPP's `SkipUnlessUpdated`,
//! `WaitValueUpdate`, `WasEntryUpdated`.
//!
//! `mark` is the last seen sequence number; it survives halts. An entry that was removed (`UnsetBlackboard`) has not been written.

use super::Builtin;
use crate::blackboard::Slot;
use crate::node::{NodeId, NodeState};
use crate::status::Status;
use crate::tick::{Answer, Run};

/// Ticks the child if the entry was written since the last check, or while the child is `Running` (`flag`), and passes its status;
/// otherwise answers `otherwise`.
pub(crate) struct IfUpdated {
    pub(crate) slot: Slot,
    pub(crate) otherwise: Status,
}

impl<C> Builtin<C> for IfUpdated {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        if !run.states[id].flag && !was_written(run, id, self.slot) {
            return Ok(self.otherwise);
        }
        let status = run.only_child(id)?;
        run.states[id].flag = status == Status::Running;
        Ok(status)
    }

    fn after_halt(&self, state: &mut NodeState) {
        let mark = state.mark;
        state.clear();
        state.mark = mark;
    }
}

/// `Success` if the entry was written since the last check, else `Failure`.
pub(crate) struct WasEntryUpdated(pub(crate) Slot);

impl<C> Builtin<C> for WasEntryUpdated {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        Ok(Status::from_truth(was_written(run, id, self.0)))
    }
}

fn was_written<C>(run: &mut Run<'_, C>, id: NodeId, slot: Slot) -> bool {
    if run.board.read(slot).is_none() {
        return false;
    }
    let current = run.board.sequence(slot);
    std::mem::replace(&mut run.states[id].mark, current) != current
}
