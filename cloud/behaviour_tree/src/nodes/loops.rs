//! Decorators that tick their child once for each item of a list: BehaviorTree.CPP's `LoopInt`, `LoopBool`, `LoopDouble`, `LoopString`.
//!
//! A list in the tree file (`1;2;3`) is traversed by index (`cursor`); a list on the blackboard is consumed. Spaces around the items of a
//! text are left out, and so are empty items. `flag`: the child runs with the current item.

use super::Builtin;
use crate::node::{NodeId, bump};
use crate::ports::Source;
use crate::status::Status;
use crate::tick::{Answer, Run, Stop};
use crate::value::{Value, ValueType};

/// Takes an item into `value` and ticks the child; answers `Running` between items, so at most one item per tick. `Failure` of the child
/// ends the loop. When no item is left: `if_empty`.
pub(crate) struct LoopOver {
    pub(crate) queue: Source,
    pub(crate) value: Source,
    pub(crate) if_empty: Source,
    pub(crate) item: ValueType,
}

impl<C> Builtin<C> for LoopOver {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        let child = run.child(id, 0)?;
        if !before.is_active() {
            let state = &mut run.states[id];
            (state.cursor, state.flag) = (0, false);
        }
        if !run.states[id].flag {
            let Some(item) = self.next_item(run, id)? else {
                return run.read(id, "if_empty", &self.if_empty);
            };
            if let Source::Slot(slot) = self.value
                && let Err(wrong) = run.board.write(slot, item)
            {
                return Err(run.fault(id, format!("port `value`: {wrong}")));
            }
        }
        let status = run.exec_and_reset(child)?;
        run.states[id].flag = status == Status::Running;
        Ok(match status {
            Status::Failure => Status::Failure,
            _ => Status::Running,
        })
    }
}

impl LoopOver {
    fn next_item<C>(&self, run: &mut Run<'_, C>, id: NodeId) -> Result<Option<Value>, Stop> {
        let index = run.states[id].cursor as usize;
        let item = match &self.queue {
            Source::Slot(slot) => match run.board.read(*slot) {
                Some(Value::Data(_)) => run.board.pop_front(*slot).and_then(|item| Value::from_json(&item)),
                Some(text) => nth(text, index),
                None => None,
            },
            Source::Literal(text) => nth(text, index),
            Source::Unset => None,
        };
        let Some(item) = item else { return Ok(None) };
        bump(&mut run.states[id].cursor);
        run.changes += 1;
        match item.convert(self.item) {
            Some(item) => Ok(Some(item)),
            None => Err(run.fault(
                id,
                format!("port `queue` has the item `{item}`: expected {:?}", self.item),
            )),
        }
    }
}

/// An item of `1;2;3`.
fn nth(list: &Value, index: usize) -> Option<Value> {
    match list {
        Value::Text(text) => text
            .split(';')
            .map(str::trim)
            .filter(|item| !item.is_empty())
            .nth(index)
            .map(Value::text),
        Value::Data(data) => data.as_array()?.get(index).and_then(Value::from_json),
        scalar => (index == 0).then(|| scalar.clone()),
    }
}
