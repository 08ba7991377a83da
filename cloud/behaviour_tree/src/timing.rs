//! Nodes that wait or watch the clock: BehaviorTree.CPP's `Timeout`, `Delay`, and the leaf
//! `Sleep`. Time is what the tree is ticked with, so simulated time does as well.
//!
//! `flag`: the clock is running; `mark`: when it ends, ns.

use super::node::{NodeId, millis};
use super::ports::Source;
use super::status::Status;
use super::tick::{Run, Stop};

impl<C> Run<'_, C> {
    /// Halts a child that is still running `msec` after it was started, and answers `Failure`.
    /// 0 never halts.
    pub(crate) fn timeout(&mut self, id: NodeId, ms: &Source) -> Result<Status, Stop> {
        let child = self.child(id, 0)?;
        if !self.states[id as usize].flag {
            self.start_clock(id, "msec", ms)?;
        }
        let state = &self.states[id as usize];
        let over = state.mark < u64::MAX && self.now_ns >= state.mark;
        if over && self.states[child as usize].status == Status::Running {
            self.reset(child);
            self.states[id as usize].flag = false;
            return Ok(Status::Failure);
        }
        let status = self.exec_and_reset(child)?;
        self.states[id as usize].flag = status == Status::Running;
        Ok(status)
    }

    /// `Running` for `delay_msec`, then the child.
    pub(crate) fn delay(&mut self, id: NodeId, ms: &Source) -> Result<Status, Stop> {
        if !self.states[id as usize].flag {
            self.start_clock(id, "delay_msec", ms)?;
        }
        let state = &self.states[id as usize];
        if state.mark < u64::MAX && self.now_ns < state.mark {
            return Ok(Status::Running);
        }
        let status = self.only_child(id)?;
        self.states[id as usize].flag = status == Status::Running;
        Ok(status)
    }

    /// `Running` for `msec`, then `Success`.
    pub(crate) fn sleep(&mut self, id: NodeId, ms: &Source, before: Status) -> Result<Status, Stop> {
        if before != Status::Running {
            self.start_clock(id, "msec", ms)?;
        }
        let end = self.states[id as usize].mark;
        Ok(if end == u64::MAX || self.now_ns >= end {
            Status::Success
        } else {
            Status::Running
        })
    }

    /// Sets `mark` to the end of a span from now; 0 or less has no end (`u64::MAX`).
    fn start_clock(&mut self, id: NodeId, port: &str, ms: &Source) -> Result<(), Stop> {
        let ms: i64 = self.read(id, port, ms)?;
        let end = if ms > 0 {
            self.now_ns.saturating_add(millis(ms))
        } else {
            u64::MAX
        };
        let state = &mut self.states[id as usize];
        state.flag = true;
        state.mark = end;
        Ok(())
    }
}
