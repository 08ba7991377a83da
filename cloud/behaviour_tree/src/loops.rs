//! Nodes that tick their child once for each item of a list: BehaviorTree.CPP's `LoopInt`,
//! `LoopBool`, `LoopDouble`, `LoopString`.
//!
//! A list in the tree file (`1;2;3`) is gone through by index (`cursor`); a list on the blackboard
//! is consumed. `flag`: the child runs with the current item.

use super::node::{NodeId, Queue};
use super::ports::Source;
use super::status::Status;
use super::tick::{Run, Stop};
use super::value::Value;

impl<C> Run<'_, C> {
    /// Takes an item into `value` and ticks the child; `Running` between items, so one item a
    /// tick at most. `Failure` of the child ends the loop. No item left: `if_empty`.
    pub(crate) fn loop_over(&mut self, id: NodeId, queue: &Queue, before: Status) -> Result<Status, Stop> {
        let child = self.child(id, 0)?;
        if !before.is_active() {
            let state = &mut self.states[id as usize];
            (state.cursor, state.flag) = (0, false);
        }
        if !self.states[id as usize].flag {
            let Some(item) = self.next_item(id, queue)? else {
                let answer: String = self.read(id, "if_empty", &queue.if_empty)?;
                return match Status::from_name(&answer) {
                    Some(status) => Ok(status),
                    None => Err(self.fault(id, format!("port `if_empty` holds `{answer}`: expected a status"))),
                };
            };
            if let Source::Slot(slot) = queue.value
                && let Err(wrong) = self.board.write(slot, item)
            {
                return Err(self.fault(id, format!("port `value`: {wrong}")));
            }
        }
        let status = self.exec_and_reset(child)?;
        self.states[id as usize].flag = status == Status::Running;
        Ok(if status == Status::Failure {
            Status::Failure
        } else {
            Status::Running
        })
    }

    fn next_item(&mut self, id: NodeId, queue: &Queue) -> Result<Option<Value>, Stop> {
        let index = self.states[id as usize].cursor as usize;
        let item = match &queue.queue {
            Source::Slot(slot) => match self.board.read(*slot) {
                Some(Value::Data(_)) => self.board.pop_front(*slot).and_then(|item| Value::from_json(&item)),
                Some(text) => nth(text, index),
                None => None,
            },
            Source::Literal(text) => nth(text, index),
            Source::Unset => None,
        };
        let Some(item) = item else { return Ok(None) };
        self.states[id as usize].cursor = index as u32 + 1;
        self.changes += 1;
        match item.convert(queue.item) {
            Some(item) => Ok(Some(item)),
            None => Err(self.fault(
                id,
                format!("port `queue` has the item `{item}`: expected {:?}", queue.item),
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
