//! Nodes that depend on the clock: BehaviorTree.CPP's `Timeout`, `Delay`, and the leaf `Sleep`. Time is the time passed to the tick, so
//! simulated time works as well.
//!
//! `flag`: the clock is running; `mark`: its end, ns.

use super::Builtin;
use crate::node::{NodeId, millis};
use crate::ports::Source;
use crate::status::Status;
use crate::tick::{Answer, Run, Stop};

/// Halts a child that is still `Running` `msec` after its start, and answers `Failure`; every other status passes. 0 means no limit.
pub(crate) struct Timeout(pub(crate) Source);

impl<C> Builtin<C> for Timeout {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let child = run.child(id, 0)?;
        if !run.states[id].flag {
            start_clock(run, id, "msec", &self.0)?;
        }
        let state = &run.states[id];
        let over = state.mark < u64::MAX && run.now_ns >= state.mark;
        if over && run.states[child].status == Status::Running {
            run.reset(child);
            run.states[id].flag = false;
            return Ok(Status::Failure);
        }
        let status = run.exec_and_reset(child)?;
        run.states[id].flag = status == Status::Running;
        Ok(status)
    }
}

/// `Running` for `delay_msec`, then the child, whose status passes.
pub(crate) struct Delay(pub(crate) Source);

impl<C> Builtin<C> for Delay {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        if !run.states[id].flag {
            start_clock(run, id, "delay_msec", &self.0)?;
        }
        let state = &run.states[id];
        if state.mark < u64::MAX && run.now_ns < state.mark {
            return Ok(Status::Running);
        }
        let status = run.only_child(id)?;
        run.states[id].flag = status == Status::Running;
        Ok(status)
    }
}

/// `Running` for `msec`, then `Success`.
pub(crate) struct Sleep(pub(crate) Source);

impl<C> Builtin<C> for Sleep {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        if before != Status::Running {
            start_clock(run, id, "msec", &self.0)?;
        }
        let end = run.states[id].mark;
        Ok(if end == u64::MAX || run.now_ns >= end {
            Status::Success
        } else {
            Status::Running
        })
    }
}

/// Sets `mark` to the end of a time span from now; 0 or less has no end (`u64::MAX`).
fn start_clock<C>(run: &mut Run<'_, C>, id: NodeId, port: &str, ms: &Source) -> Result<(), Stop> {
    let ms: i64 = run.read(id, port, ms)?;
    let end = if ms > 0 {
        run.now_ns.saturating_add(millis(ms))
    } else {
        u64::MAX
    };
    let state = &mut run.states[id];
    state.flag = true;
    state.mark = end;
    Ok(())
}
