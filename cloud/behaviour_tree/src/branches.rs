//! Nodes that choose between children: BehaviorTree.CPP's `IfThenElse`, `WhileDoElse`,
//! `Switch2` … `Switch6`, `TryCatch`.

use super::node::{Cases, NodeId, bump};
use super::ports::Source;
use super::script::is_same;
use super::status::Status;
use super::tick::{Run, Stop};
use super::value::Value;

impl<C> Run<'_, C> {
    /// Asks child 0 once, then runs child 1 on `Success` or child 2 on `Failure` to its end
    /// (`cursor` is the branch). Without a third child, `Failure` of the first is the answer.
    pub(crate) fn if_then_else(&mut self, id: NodeId) -> Result<Status, Stop> {
        if self.states[id as usize].cursor == 0 {
            let condition = self.child(id, 0)?;
            match self.exec(condition)? {
                Status::Success => self.states[id as usize].cursor = 1,
                Status::Failure if self.kids(id).len() > 2 => self.states[id as usize].cursor = 2,
                Status::Running => return Ok(Status::Running),
                other => {
                    self.reset_children(id);
                    return Ok(other);
                }
            }
        }
        let branch = self.child(id, self.states[id as usize].cursor as usize)?;
        let status = self.exec(branch)?;
        if status != Status::Running {
            self.reset_children(id);
            self.states[id as usize].cursor = 0;
        }
        Ok(status)
    }

    /// Asks child 0 in every tick and runs child 1 while it succeeds, child 2 while it fails; the
    /// other branch is halted. Without a third child, `Failure` of the first is the answer.
    pub(crate) fn while_do_else(&mut self, id: NodeId) -> Result<Status, Stop> {
        let kids = self.kids(id);
        let condition = self.child(id, 0)?;
        let (chosen, other) = match self.exec(condition)? {
            Status::Running => return Ok(Status::Running),
            Status::Success => (1, 2),
            Status::Failure if kids.len() > 2 => (2, 1),
            answer => {
                self.reset_children(id);
                return Ok(answer);
            }
        };
        if let Some(other) = kids.get(other) {
            self.reset(*other);
        }
        let branch = self.child(id, chosen)?;
        let status = self.exec(branch)?;
        if status != Status::Running {
            self.reset_children(id);
        }
        Ok(status)
    }

    /// Runs the child whose `case_N` equals `variable`, the last child if none does. When another
    /// child matches, the one that runs is halted. `cursor` is the running child plus one.
    pub(crate) fn switch(&mut self, id: NodeId, cases: &Cases) -> Result<Status, Stop> {
        let matching = self.value(&cases.variable).and_then(|variable| {
            cases
                .cases
                .iter()
                .position(|case| self.value(case).is_some_and(|case| same(variable, case, &cases.enums)))
        });
        let chosen = matching.unwrap_or(cases.cases.len());
        let running = self.states[id as usize].cursor as usize;
        if running != 0 && running != chosen + 1 {
            let other = self.child(id, running - 1)?;
            self.reset(other);
        }
        let child = self.child(id, chosen)?;
        let status = self.exec(child)?;
        if status == Status::Running {
            self.states[id as usize].cursor = chosen as u32 + 1;
        } else {
            self.reset_children(id);
            self.states[id as usize].cursor = 0;
        }
        Ok(status)
    }

    /// All children but the last as a Sequence. If one fails, the last runs to its end as
    /// clean-up, and the answer is `Failure` whatever it said. `flag`: cleaning up.
    pub(crate) fn try_catch(&mut self, id: NodeId, before: Status) -> Result<Status, Stop> {
        let Some((catch, attempts)) = self.kids(id).split_last() else {
            return Err(self.fault(id, "has no children".into()));
        };
        if !before.is_active() {
            self.states[id as usize].skipped = 0;
        }
        while !self.states[id as usize].flag {
            let Some(child) = attempts.get(self.states[id as usize].cursor as usize) else {
                self.reset_children(id);
                let state = &mut self.states[id as usize];
                state.cursor = 0;
                let skipped = state.skipped as usize == attempts.len();
                return Ok(if skipped { Status::Skipped } else { Status::Success });
            };
            match self.exec(*child)? {
                Status::Running => return Ok(Status::Running),
                Status::Failure => {
                    for child in attempts {
                        self.reset(*child);
                    }
                    self.states[id as usize].flag = true;
                    break;
                }
                Status::Skipped => bump(&mut self.states[id as usize].skipped),
                _ => {}
            }
            bump(&mut self.states[id as usize].cursor);
        }
        if self.exec(*catch)? == Status::Running {
            return Ok(Status::Running);
        }
        self.reset_children(id);
        let state = &mut self.states[id as usize];
        (state.cursor, state.flag) = (0, false);
        Ok(Status::Failure)
    }

    /// With `catch_on_halt`, a halt in the middle of the attempt stops it and ticks the clean-up
    /// once; what it does not finish then is halted with the rest.
    pub(crate) fn catch_before_halt(&mut self, id: NodeId, catch_on_halt: &Source) {
        let wanted = self.value(catch_on_halt).and_then(Value::as_bool).unwrap_or(false);
        if !wanted || self.states[id as usize].flag {
            return;
        }
        if let Some((catch, attempts)) = self.kids(id).split_last() {
            for child in attempts {
                self.reset(*child);
            }
            // A fault of the clean-up is kept and ends the tick.
            let _ = self.exec(*catch);
        }
    }
}

/// Equal as text, as numbers (nearly), or by the number that a name stands for.
fn same(one: &Value, two: &Value, enums: &std::collections::BTreeMap<String, i64>) -> bool {
    if one == two {
        return true;
    }
    if let (Value::Text(one), Value::Text(two)) = (one, two)
        && one.trim() == two.trim()
    {
        return true;
    }
    let number = |value: &Value| match value {
        Value::Text(text) => match enums.get(text.trim()) {
            Some(number) => Some(*number as f64),
            None => value.as_double(),
        },
        other => other.as_double(),
    };
    matches!((number(one), number(two)), (Some(one), Some(two)) if is_same(one, two))
}
