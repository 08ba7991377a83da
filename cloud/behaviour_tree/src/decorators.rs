//! Nodes around one child that change its answer or repeat it: BehaviorTree.CPP's `Inverter`,
//! `ForceSuccess`, `ForceFailure`, `RetryUntilSuccessful`, `Repeat`, `KeepRunningUntilFailure`,
//! `RunOnce`, `Precondition`.
//!
//! A child that has completed is reset at once. `count` holds attempts or cycles.

use super::node::{Latch, NodeId, bump};
use super::ports::Source;
use super::status::Status;
use super::tick::{Run, Stop};

impl<C> Run<'_, C> {
    /// `Success` for `Failure` and the other way round; `Running` and `Skipped` pass.
    pub(crate) fn inverter(&mut self, id: NodeId) -> Result<Status, Stop> {
        Ok(match self.only_child(id)? {
            Status::Success => Status::Failure,
            Status::Failure => Status::Success,
            other => other,
        })
    }

    /// Replaces the answer of a completed child; `Running` and `Skipped` pass.
    pub(crate) fn force(&mut self, id: NodeId, answer: Status) -> Result<Status, Stop> {
        let status = self.only_child(id)?;
        Ok(if status.is_completed() { answer } else { status })
    }

    /// Tries again on `Failure`, at most `num_attempts` times in all (-1: for ever); exhausted:
    /// `Failure`. The port is read again before every attempt. `Skipped` passes and keeps count.
    pub(crate) fn retry(&mut self, id: NodeId, attempts: &Source) -> Result<Status, Stop> {
        self.again(id, "num_attempts", attempts, Status::Failure)
    }

    /// Repeats on `Success`, `num_cycles` times (-1: for ever), then `Success`. `Failure` ends it.
    /// `Skipped` passes and keeps count.
    pub(crate) fn repeat(&mut self, id: NodeId, cycles: &Source) -> Result<Status, Stop> {
        self.again(id, "num_cycles", cycles, Status::Success)
    }

    /// Ticks the child again while it answers `again`. After a child that completed in its first
    /// tick it yields `Running` and asks to be woken, so that it stays interruptible.
    fn again(&mut self, id: NodeId, port: &str, limit: &Source, again: Status) -> Result<Status, Stop> {
        let child = self.child(id, 0)?;
        loop {
            let most: i64 = self.read(id, port, limit)?;
            let spent = i64::from(self.states[id as usize].count);
            if most >= 0 && spent >= most {
                self.states[id as usize].count = 0;
                return Ok(again);
            }
            let fresh = self.states[child as usize].status == Status::Idle;
            let status = self.exec_and_reset(child)?;
            if status == Status::Running || status == Status::Skipped {
                return Ok(status);
            }
            let state = &mut self.states[id as usize];
            if status != again {
                state.count = 0;
                return Ok(status);
            }
            bump(&mut state.count);
            self.changes += 1;
            if fresh && (most < 0 || spent + 1 < most) {
                self.wake = true;
                return Ok(Status::Running);
            }
        }
    }

    /// `Failure` of the child is the answer; everything else is `Running`.
    pub(crate) fn keep_running_until_failure(&mut self, id: NodeId) -> Result<Status, Stop> {
        Ok(match self.only_child(id)? {
            Status::Failure => Status::Failure,
            _ => Status::Running,
        })
    }

    /// Runs the child to its end once in the life of the tree; afterwards `Skipped`, or with
    /// `then_skip=false` the same answer again. `flag` is the latch, `mark` 1 for `Success`.
    pub(crate) fn run_once(&mut self, id: NodeId, then_skip: &Source) -> Result<Status, Stop> {
        if self.states[id as usize].flag {
            let skip: bool = self.read(id, "then_skip", then_skip)?;
            let succeeded = self.states[id as usize].mark == 1;
            return Ok(match (skip, succeeded) {
                (true, _) => Status::Skipped,
                (false, true) => Status::Success,
                (false, false) => Status::Failure,
            });
        }
        let status = self.only_child(id)?;
        if status.is_completed() {
            let state = &mut self.states[id as usize];
            state.flag = true;
            state.mark = u64::from(status == Status::Success);
        }
        Ok(status)
    }

    /// Ticks the child if the script holds, else answers `else`. Once the child runs, the script
    /// is not asked again until it has completed (as in the source; the manual says otherwise).
    /// `flag`: the child runs.
    pub(crate) fn precondition(&mut self, id: NodeId, latch: &Latch) -> Result<Status, Stop> {
        if !self.states[id as usize].flag && !self.holds(id, &latch.condition)? {
            let answer: String = self.read(id, "else", &latch.otherwise)?;
            return match Status::from_name(&answer) {
                Some(status) => Ok(status),
                None => Err(self.fault(id, format!("port `else` holds `{answer}`: expected a status"))),
            };
        }
        let status = self.only_child(id)?;
        self.states[id as usize].flag = status == Status::Running;
        Ok(status)
    }
}
