//! The leaves that need nothing from outside: BehaviorTree.CPP's `SetBlackboard`,
//! `UnsetBlackboard`, `Script`, `ScriptCondition`. (`AlwaysSuccess` and `AlwaysFailure` are one
//! word each, in the dispatch; `Sleep` stands with the clocks.)

use super::blackboard::Slot;
use super::node::NodeId;
use super::ports::Source;
use super::script::Program;
use super::status::Status;
use super::tick::{Run, Stop};
use super::value::Value;

impl<C> Run<'_, C> {
    /// Copies a literal or another entry into an entry, which keeps its type. A literal does not
    /// give a new entry a type: the first proper assignment does.
    pub(crate) fn set_blackboard(&mut self, id: NodeId, value: &Source, slot: Slot) -> Result<Status, Stop> {
        if let Source::Literal(Value::Text(text)) = value
            && self.board.kind(slot).is_none()
        {
            self.board.write_literal(slot, text);
            return Ok(Status::Success);
        }
        let value: Value = self.read(id, "value", value)?;
        match self.board.write(slot, value) {
            Ok(()) => Ok(Status::Success),
            Err(wrong) => Err(self.fault(id, wrong.to_string())),
        }
    }

    /// Forgets an entry and its type.
    pub(crate) fn unset_blackboard(&mut self, slot: Slot) -> Result<Status, Stop> {
        self.board.clear(slot);
        Ok(Status::Success)
    }

    /// Runs a script for its effect.
    pub(crate) fn script(&mut self, id: NodeId, code: &Program) -> Result<Status, Stop> {
        self.evaluate(id, code)?;
        Ok(Status::Success)
    }

    /// `Success` if the script holds, else `Failure`.
    pub(crate) fn script_condition(&mut self, id: NodeId, code: &Program) -> Result<Status, Stop> {
        Ok(if self.holds(id, code)? {
            Status::Success
        } else {
            Status::Failure
        })
    }
}
