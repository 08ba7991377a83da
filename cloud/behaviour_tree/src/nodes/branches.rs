//! Controls that choose between children: BehaviorTree.CPP's `IfThenElse`, `WhileDoElse`, `Switch2` … `Switch6`, `TryCatch`.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::Builtin;
use crate::node::{NodeId, bump};
use crate::ports::Source;
use crate::script::is_same;
use crate::status::Status;
use crate::tick::{Answer, Run};
use crate::value::Value;

/// Ticks child 0 until it completes, then runs child 1 on `Success` or child 2 on `Failure` to completion (`cursor` is the branch). Without
/// a third child, `Failure` of the first is the answer. `Skipped` of the first is the answer, too; in BehaviorTree.CPP it is an error.
pub(crate) struct IfThenElse;

impl<C> Builtin<C> for IfThenElse {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        if run.states[id].cursor == 0 {
            let condition = run.child(id, 0)?;
            match run.exec(condition)? {
                Status::Success => run.states[id].cursor = 1,
                Status::Failure if run.kids(id).len() > 2 => run.states[id].cursor = 2,
                Status::Running => return Ok(Status::Running),
                other => {
                    run.reset_children(id);
                    return Ok(other);
                }
            }
        }
        let branch = run.child(id, run.states[id].cursor as usize)?;
        let status = run.exec(branch)?;
        if status != Status::Running {
            run.finish(id, status);
        }
        Ok(status)
    }
}

/// Ticks child 0 in every tick and runs child 1 while it succeeds, child 2 while it fails; the other branch is halted. Without a third
/// child, `Failure` of the first is the answer. `Skipped` of the first is the answer, too; in BehaviorTree.CPP it is an error.
pub(crate) struct WhileDoElse;

impl<C> Builtin<C> for WhileDoElse {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let kids = run.kids(id);
        let condition = run.child(id, 0)?;
        let (chosen, other) = match run.exec(condition)? {
            Status::Running => return Ok(Status::Running),
            Status::Success => (1, 2),
            Status::Failure if kids.len() > 2 => (2, 1),
            answer => {
                run.reset_children(id);
                return Ok(answer);
            }
        };
        if let Some(other) = kids.get(other) {
            run.reset(*other);
        }
        let branch = run.child(id, chosen)?;
        let status = run.exec(branch)?;
        if status != Status::Running {
            run.reset_children(id);
        }
        Ok(status)
    }
}

/// Runs the child whose `case_N` equals `variable`, or the last child if none does. When another child matches, the running one is halted.
/// `cursor` is the running child plus one.
pub(crate) struct Switch {
    pub(crate) variable: Source,
    pub(crate) cases: Vec<Source>,
    /// Numbers of the names in the cases.
    pub(crate) enums: Arc<BTreeMap<String, i64>>,
}

impl<C> Builtin<C> for Switch {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let matching = run.value(&self.variable).and_then(|variable| {
            self.cases
                .iter()
                .position(|case| run.value(case).is_some_and(|case| same(variable, case, &self.enums)))
        });
        let chosen = matching.unwrap_or(self.cases.len());
        let running = run.states[id].cursor as usize;
        if running != 0 && running != chosen + 1 {
            let other = run.child(id, running - 1)?;
            run.reset(other);
        }
        let child = run.child(id, chosen)?;
        let status = run.exec(child)?;
        if status == Status::Running {
            run.states[id].cursor = chosen as u32 + 1;
        } else {
            run.finish(id, status);
        }
        Ok(status)
    }
}

/// All children but the last as a Sequence. If one fails, the last runs to completion as clean-up, and the answer is `Failure` regardless
/// of its result. `flag`: cleaning up.
pub(crate) struct TryCatch {
    pub(crate) catch_on_halt: Source,
}

impl<C> Builtin<C> for TryCatch {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        let Some((catch, attempts)) = run.kids(id).split_last() else {
            return Err(run.fault(id, "has no children".into()));
        };
        if !before.is_active() {
            run.states[id].skipped = 0;
        }
        while !run.states[id].flag {
            let Some(child) = attempts.get(run.states[id].cursor as usize) else {
                let skipped = run.states[id].skipped as usize == attempts.len();
                return Ok(run.finish(id, Status::Success.unless_skipped(skipped)));
            };
            match run.exec(*child)? {
                Status::Running => return Ok(Status::Running),
                Status::Failure => {
                    for child in attempts {
                        run.reset(*child);
                    }
                    run.states[id].flag = true;
                    break;
                }
                Status::Skipped => bump(&mut run.states[id].skipped),
                _ => {}
            }
            bump(&mut run.states[id].cursor);
        }
        if run.exec(*catch)? == Status::Running {
            return Ok(Status::Running);
        }
        run.states[id].flag = false;
        Ok(run.finish(id, Status::Failure))
    }

    /// With `catch_on_halt`, a halt during the attempt stops it and ticks the clean-up once; if that does not finish, it is halted with the
    /// rest.
    fn before_halt(&self, run: &mut Run<'_, C>, id: NodeId) {
        let wanted = run.value(&self.catch_on_halt).and_then(Value::as_bool).unwrap_or(false);
        if !wanted || run.states[id].flag {
            return;
        }
        if let Some((catch, attempts)) = run.kids(id).split_last() {
            for child in attempts {
                run.reset(*child);
            }
            // A fault of the clean-up is kept and ends the tick.
            let _ = run.exec(*catch);
        }
    }
}

/// Equal as text, as numbers (nearly), or by the number of a name.
fn same(one: &Value, two: &Value, enums: &BTreeMap<String, i64>) -> bool {
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
