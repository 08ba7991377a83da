//! Leaves without external code: BehaviorTree.CPP's `AlwaysSuccess`, `AlwaysFailure`, `SetBlackboard`, `UnsetBlackboard`, `Script`,
//! `ScriptCondition`. (`Sleep` is in `timing`.)

use super::Builtin;
use crate::blackboard::Slot;
use crate::node::NodeId;
use crate::ports::Source;
use crate::script::Program;
use crate::status::Status;
use crate::tick::{Answer, Run};
use crate::value::Value;

/// The same status in every tick.
pub(crate) struct Always(pub(crate) Status);

impl<C> Builtin<C> for Always {
    fn tick(&self, _: &mut Run<'_, C>, _: NodeId, _: Status) -> Answer {
        Ok(self.0)
    }
}

/// Copies a literal or another entry into an entry, which keeps its type: `Success`; `Failure` if the other entry has no value. A literal
/// does not give a new entry a type; the first typed assignment does. A value of another type is an error.
pub(crate) struct SetBlackboard {
    pub(crate) value: Source,
    pub(crate) slot: Slot,
}

impl<C> Builtin<C> for SetBlackboard {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        if let Source::Literal(Value::Text(text)) = &self.value
            && run.board.kind(self.slot).is_none()
        {
            run.board.write_literal(self.slot, text);
            return Ok(Status::Success);
        }
        let Some(value) = run.value(&self.value).cloned() else {
            return Ok(Status::Failure);
        };
        match run.board.write(self.slot, value) {
            Ok(()) => Ok(Status::Success),
            Err(wrong) => Err(run.fault(id, wrong.to_string())),
        }
    }
}

/// Removes an entry's value and its type: `Success`.
pub(crate) struct UnsetBlackboard(pub(crate) Slot);

impl<C> Builtin<C> for UnsetBlackboard {
    fn tick(&self, run: &mut Run<'_, C>, _: NodeId, _: Status) -> Answer {
        run.board.clear(self.0);
        Ok(Status::Success)
    }
}

/// Runs a script for its effect: `Success`, or an error that ends the tree.
pub(crate) struct RunScript(pub(crate) Program);

impl<C> Builtin<C> for RunScript {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        run.evaluate(id, &self.0)?;
        Ok(Status::Success)
    }
}

/// `Success` if the script is true, else `Failure`.
pub(crate) struct ScriptCondition(pub(crate) Program);

impl<C> Builtin<C> for ScriptCondition {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        Ok(Status::from_truth(run.holds(id, &self.0)?))
    }
}
