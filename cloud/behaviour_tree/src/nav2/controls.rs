//! Nav2's controls and decorators that need no robot: `PipelineSequence`, `RecoveryNode`, `RoundRobin`, `NonblockingSequence`,
//! `PersistentSequence`, `RateController`, `SingleTrigger` (nav2_behavior_tree 1.5).

use crate::node::{NodeId, bump};
use crate::nodes::Builtin;
use crate::ports::Source;
use crate::status::Status;
use crate::tick::{Answer, Run, Stop};
use crate::value::Value;

/// Starts from child 0 in every tick. `Running` ends the tick unless a later child has been reached before (`cursor`): then the earlier
/// child runs in parallel. `Failure`: resets all, `Failure`.
pub(crate) struct PipelineSequence;

impl<C> Builtin<C> for PipelineSequence {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let kids = run.kids(id);
        let mut skipped = 0;
        for (index, child) in kids.iter().enumerate() {
            match run.exec(*child)? {
                Status::Failure => return Ok(run.finish(id, Status::Failure)),
                Status::Running if index >= run.states[id].cursor as usize => {
                    run.states[id].cursor = index as u32;
                    return Ok(Status::Running);
                }
                Status::Skipped => skipped += 1,
                _ => {}
            }
        }
        Ok(run.finish(id, Status::Success.unless_skipped(skipped == kids.len())))
    }
}

/// Runs child 0; when it fails, child 1 recovers and child 0 is tried again in the same tick, at most `number_of_retries` times (`count`).
/// Failure of child 1 is the answer. A skipped child 1 is a failure that keeps the count. `cursor` is the current child.
pub(crate) struct RecoveryNode {
    pub(crate) number_of_retries: Source,
}

impl<C> Builtin<C> for RecoveryNode {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let retries: i64 = run.read(id, "number_of_retries", &self.number_of_retries)?;
        let main = run.child(id, 0)?;
        let mend = run.child(id, 1)?;
        loop {
            if run.states[id].cursor == 0 {
                match run.exec(main)? {
                    Status::Running => return Ok(Status::Running),
                    Status::Failure if i64::from(run.states[id].count) < retries => {
                        run.reset(main);
                        run.states[id].cursor = 1;
                    }
                    other => return Ok(run.finish(id, other)),
                }
            } else {
                match run.exec(mend)? {
                    Status::Running => return Ok(Status::Running),
                    Status::Success => {
                        run.reset(mend);
                        let state = &mut run.states[id];
                        bump(&mut state.count);
                        state.cursor = 0;
                    }
                    Status::Skipped => {
                        run.states[id].cursor = 0;
                        return Ok(Status::Failure);
                    }
                    _ => return Ok(run.finish(id, Status::Failure)),
                }
            }
        }
    }
}

/// Runs the children in turn: `Success` of a child is the answer, and the next activation starts with the next child (`cursor` is kept). On
/// `Failure` or `Skipped` the next child follows at once, until all have failed.
///
/// As in Nav2, without `wrap_around` the last child's answer is ignored: even its `Success` makes the node fail and start over. With
/// `last_may_succeed` (not in Nav2) it counts, and the activation after it fails.
pub(crate) struct RoundRobin {
    pub(crate) wrap_around: Source,
    pub(crate) last_may_succeed: Source,
}

impl<C> Builtin<C> for RoundRobin {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let kids = run.kids(id);
        let flag = |source| run.value(source).and_then(Value::as_bool).unwrap_or(false);
        let (wrap_around, last_may_succeed) = (flag(&self.wrap_around), flag(&self.last_may_succeed));
        let mut skipped = 0;
        while (run.states[id].count as usize + skipped) < kids.len() {
            let index = run.states[id].cursor as usize;
            let Some(child) = kids.get(index) else { break };
            let status = run.exec(*child)?;
            if status == Status::Running {
                return Ok(Status::Running);
            }
            let last = index + 1 == kids.len();
            run.states[id].cursor = if last && wrap_around { 0 } else { index as u32 + 1 };
            if last && !wrap_around && !(last_may_succeed && status == Status::Success) {
                skipped += usize::from(status == Status::Skipped);
                break;
            }
            match status {
                Status::Success => {
                    run.reset_children(id);
                    run.states[id].count = 0;
                    return Ok(Status::Success);
                }
                Status::Skipped => skipped += 1,
                _ => bump(&mut run.states[id].count),
            }
        }
        Ok(run.finish(id, Status::Failure.unless_skipped(skipped == kids.len())))
    }
}

/// Ticks every child in every tick. Any `Failure`: resets all, `Failure`. Any `Running`: `Running`. A skipped child is an error.
pub(crate) struct NonblockingSequence;

impl<C> Builtin<C> for NonblockingSequence {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let mut running = false;
        for child in run.kids(id) {
            match run.exec(*child)? {
                Status::Failure => {
                    run.reset_children(id);
                    return Ok(Status::Failure);
                }
                Status::Running => running = true,
                Status::Skipped => {
                    return Err(run.fault(id, "a child was skipped: expected SUCCESS, FAILURE or RUNNING".into()));
                }
                _ => {}
            }
        }
        if running {
            return Ok(Status::Running);
        }
        run.reset_children(id);
        Ok(Status::Success)
    }
}

/// A Sequence whose index is a blackboard entry, so that it survives halts. `Failure` and the end reset it to 0. A skipped child counts as
/// done, and where all are skipped, the answer is `Success`. An entry without a value is 0; in Nav2 it is an error.
pub(crate) struct PersistentSequence {
    pub(crate) current_child_idx: Source,
}

impl<C> Builtin<C> for PersistentSequence {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let kids = run.kids(id);
        loop {
            let at = run.value(&self.current_child_idx).and_then(Value::as_int).unwrap_or(0);
            let Some(child) = usize::try_from(at).ok().and_then(|at| kids.get(at)) else {
                break;
            };
            match run.exec(*child)? {
                Status::Running => return Ok(Status::Running),
                Status::Failure => {
                    run.reset_children(id);
                    self.write_index(run, id, 0)?;
                    return Ok(Status::Failure);
                }
                _ => {}
            }
            self.write_index(run, id, at + 1)?;
        }
        run.reset_children(id);
        self.write_index(run, id, 0)?;
        Ok(Status::Success)
    }
}

impl PersistentSequence {
    fn write_index<C>(&self, run: &mut Run<'_, C>, id: NodeId, at: i64) -> Result<(), Stop> {
        let written = match &self.current_child_idx {
            Source::Slot(slot) => run
                .board
                .write(*slot, Value::Int(at))
                .map_err(|wrong| wrong.to_string()),
            _ => Err("expected a blackboard entry, as in `{key}`".to_owned()),
        };
        written.map_err(|why| run.fault(id, format!("port `current_child_idx`: {why}")))
    }
}

/// Ticks the child on activation, while it runs, and once `1/hz` has passed since its last success; otherwise `Running`. `flag`: ticked in
/// this activation; `mark`: last success.
pub(crate) struct RateController {
    pub(crate) hz: Source,
}

impl<C> Builtin<C> for RateController {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        let hz: f64 = run.read(id, "hz", &self.hz)?;
        if hz.is_nan() || hz <= 0.0 {
            return Err(run.fault(id, format!("port `hz` holds {hz}: expected more than 0")));
        }
        let child = run.child(id, 0)?;
        if !before.is_active() {
            let now = run.now_ns;
            let state = &mut run.states[id];
            (state.mark, state.flag) = (now, false);
        }
        let state = &run.states[id];
        let due = run.now_ns.saturating_sub(state.mark) as f64 >= 1e9 / hz;
        if state.flag && !due && run.states[child].status != Status::Running {
            return Ok(Status::Running);
        }
        run.states[id].flag = true;
        let status = run.exec_and_reset(child)?;
        if status == Status::Success {
            run.states[id].mark = run.now_ns;
            run.changes += 1;
        }
        Ok(status)
    }
}

/// Runs the child to completion once per activation; afterwards `Failure` until the parent resets the node. `flag`: done.
pub(crate) struct SingleTrigger;

impl<C> Builtin<C> for SingleTrigger {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        if !before.is_active() {
            run.states[id].flag = false;
        }
        if run.states[id].flag {
            return Ok(Status::Failure);
        }
        let status = run.only_child(id)?;
        run.states[id].flag = status.is_completed();
        Ok(status)
    }
}
