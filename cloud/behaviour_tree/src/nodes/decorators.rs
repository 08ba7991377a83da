//! Decorators that change the answer of their child or repeat it: BehaviorTree.CPP's `Inverter`, `ForceSuccess`, `ForceFailure`,
//! `RetryUntilSuccessful`, `Repeat`, `KeepRunningUntilFailure`, `RunOnce`, `Precondition`.
//!
//! A completed child is reset at once. `count` holds attempts or cycles.

use super::Builtin;
use crate::node::{NodeId, NodeState, bump};
use crate::ports::Source;
use crate::script::Program;
use crate::status::Status;
use crate::tick::{Answer, Run};

/// Swaps `Success` and `Failure`; `Running` and `Skipped` pass.
pub(crate) struct Inverter;

impl<C> Builtin<C> for Inverter {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        Ok(match run.only_child(id)? {
            Status::Success => Status::Failure,
            Status::Failure => Status::Success,
            other => other,
        })
    }
}

/// Replaces the answer of a completed child; `Running` and `Skipped` pass.
pub(crate) struct Force(pub(crate) Status);

impl<C> Builtin<C> for Force {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let status = run.only_child(id)?;
        Ok(if status.is_completed() { self.0 } else { status })
    }
}

/// Unlimited attempts or cycles; other negative numbers mean none, as in BehaviorTree.CPP.
const UNLIMITED: i64 = -1;

/// Ticks the child again while it answers `status`, at most as often as the port says (-1: unlimited); then answers the same. Any other
/// end ends it; `Skipped` passes and keeps the count. The port is read again before every attempt. After a child that completed in its
/// first tick, it yields `Running` and asks to be woken, so that it stays interruptible.
pub(crate) struct Again {
    pub(crate) status: Status,
    pub(crate) port: &'static str,
    pub(crate) limit: Source,
}

impl<C> Builtin<C> for Again {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let child = run.child(id, 0)?;
        loop {
            let most: i64 = run.read(id, self.port, &self.limit)?;
            let spent = i64::from(run.states[id].count);
            if most != UNLIMITED && spent >= most {
                run.states[id].count = 0;
                return Ok(self.status);
            }
            let fresh = run.states[child].status == Status::Idle;
            let status = run.exec_and_reset(child)?;
            if status == Status::Running || status == Status::Skipped {
                return Ok(status);
            }
            let state = &mut run.states[id];
            if status != self.status {
                state.count = 0;
                return Ok(status);
            }
            bump(&mut state.count);
            run.changes += 1;
            if fresh && (most == UNLIMITED || spent + 1 < most) {
                run.wake = true;
                return Ok(Status::Running);
            }
        }
    }

    fn on_reset(&self, state: &mut NodeState) {
        state.count = 0;
    }
}

/// `Failure` of the child is the answer; any other answer becomes `Running`.
pub(crate) struct KeepRunningUntilFailure;

impl<C> Builtin<C> for KeepRunningUntilFailure {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        Ok(match run.only_child(id)? {
            Status::Failure => Status::Failure,
            _ => Status::Running,
        })
    }
}

/// Runs the child to completion once in the life of the tree; afterwards `Skipped`, or with `then_skip=false` the same answer again. `flag`
/// is the latch, `mark` is 1 for `Success`.
pub(crate) struct RunOnce {
    pub(crate) then_skip: Source,
}

impl<C> Builtin<C> for RunOnce {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        if run.states[id].flag {
            let skip: bool = run.read(id, "then_skip", &self.then_skip)?;
            let succeeded = run.states[id].mark == 1;
            return Ok(Status::from_truth(succeeded).unless_skipped(skip));
        }
        let status = run.only_child(id)?;
        if status.is_completed() {
            let state = &mut run.states[id];
            state.flag = true;
            state.mark = u64::from(status == Status::Success);
        }
        Ok(status)
    }

    fn after_halt(&self, state: &mut NodeState) {
        let latch = (state.flag, state.mark);
        state.clear();
        (state.flag, state.mark) = latch;
    }
}

/// Ticks the child if the script is true, otherwise answers `else`. While the child runs, the script is not evaluated again until the child
/// has completed (as in BehaviorTree.CPP's source; its manual says otherwise). `flag`: the child is running.
pub(crate) struct Precondition {
    pub(crate) condition: Program,
    pub(crate) otherwise: Source,
}

impl<C> Builtin<C> for Precondition {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        if !run.states[id].flag && !run.holds(id, &self.condition)? {
            return run.read(id, "else", &self.otherwise);
        }
        let status = run.only_child(id)?;
        run.states[id].flag = status == Status::Running;
        Ok(status)
    }
}

/// Another tree: passes the status of its root.
pub(crate) struct SubTree;

impl<C> Builtin<C> for SubTree {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        run.only_child(id)
    }
}
