//! Nodes whose children run side by side: BehaviorTree.CPP's `Parallel` and `ParallelAll`, and
//! `ParallelAny`, which is py_trees' Parallel with the policy SuccessOnOne.
//!
//! A child that has completed is marked `done` and not ticked again until all are reset; `count`
//! holds failures, `cursor` successes.

use super::node::{NodeId, Thresholds, bump};
use super::ports::Source;
use super::status::Status;
use super::tick::{Run, Stop};

/// A threshold as a number of children: -1 is all, -2 all but one, …
fn of_children(threshold: i64, children: usize) -> i64 {
    let children = children as i64;
    if threshold < 0 {
        (children + 1).saturating_add(threshold).max(0)
    } else {
        threshold
    }
}

impl<C> Run<'_, C> {
    /// Ticks every child that is not done, in order, and ends as soon as `success_count` have
    /// succeeded, `failure_count` have failed, or success has become impossible; then resets all.
    /// Under a negative success threshold skipped children count as succeeded.
    pub(crate) fn parallel(&mut self, id: NodeId, thresholds: &Thresholds) -> Result<Status, Stop> {
        let kids = self.kids(id);
        let all = kids.len() as i64;
        let asked: i64 = self.read(id, "success_count", &thresholds.success)?;
        let needed = of_children(asked, kids.len());
        let allowed: i64 = self.read(id, "failure_count", &thresholds.failure)?;
        let allowed = of_children(allowed, kids.len());
        if needed > all || allowed > all {
            let what = format!("has {all} children: expected thresholds of at most as many");
            return Err(self.fault(id, what));
        }
        let mut skipped = 0;
        for child in kids {
            if !self.states[*child as usize].done {
                match self.exec(*child)? {
                    Status::Success => {
                        self.states[*child as usize].done = true;
                        bump(&mut self.states[id as usize].cursor);
                    }
                    Status::Failure => {
                        self.states[*child as usize].done = true;
                        bump(&mut self.states[id as usize].count);
                    }
                    Status::Skipped => skipped += 1,
                    _ => {}
                }
            }
            let state = &self.states[id as usize];
            let (successes, failures) = (i64::from(state.cursor), i64::from(state.count));
            if successes >= needed || (asked < 0 && successes + skipped >= needed) {
                return Ok(self.finish_parallel(id, Status::Success));
            }
            if all - failures < needed || failures == allowed {
                return Ok(self.finish_parallel(id, Status::Failure));
            }
        }
        Ok(if skipped == all {
            Status::Skipped
        } else {
            Status::Running
        })
    }

    /// Runs every child to its end; `Failure` if at least `max_failures` failed. All skipped:
    /// `Skipped`.
    pub(crate) fn parallel_all(&mut self, id: NodeId, max_failures: &Source) -> Result<Status, Stop> {
        let kids = self.kids(id);
        let limit: i64 = self.read(id, "max_failures", max_failures)?;
        let limit = of_children(limit, kids.len());
        if limit > kids.len() as i64 {
            let what = format!("has {} children: expected max_failures of at most as many", kids.len());
            return Err(self.fault(id, what));
        }
        let (mut skipped, mut done) = (0, 0);
        for child in kids {
            if !self.states[*child as usize].done {
                match self.exec(*child)? {
                    Status::Success => self.states[*child as usize].done = true,
                    Status::Failure => {
                        self.states[*child as usize].done = true;
                        bump(&mut self.states[id as usize].count);
                    }
                    Status::Skipped => skipped += 1,
                    _ => {}
                }
            }
            done += usize::from(self.states[*child as usize].done);
        }
        if skipped == kids.len() {
            return Ok(Status::Skipped);
        }
        if skipped + done < kids.len() {
            return Ok(Status::Running);
        }
        let failed = i64::from(self.states[id as usize].count) >= limit;
        Ok(self.finish_parallel(id, if failed { Status::Failure } else { Status::Success }))
    }

    /// Ticks every child in every tick, then: any failed, `Failure`; else any succeeded,
    /// `Success`; either halts the others. All skipped: `Skipped`.
    pub(crate) fn parallel_any(&mut self, id: NodeId) -> Result<Status, Stop> {
        let kids = self.kids(id);
        let (mut failed, mut succeeded, mut skipped) = (false, false, 0);
        for child in kids {
            match self.exec(*child)? {
                Status::Failure => failed = true,
                Status::Success => succeeded = true,
                Status::Skipped => skipped += 1,
                _ => {}
            }
        }
        Ok(if failed {
            self.finish_parallel(id, Status::Failure)
        } else if succeeded {
            self.finish_parallel(id, Status::Success)
        } else if skipped == kids.len() {
            Status::Skipped
        } else {
            Status::Running
        })
    }

    fn finish_parallel(&mut self, id: NodeId, status: Status) -> Status {
        self.reset_children(id);
        let state = &mut self.states[id as usize];
        (state.cursor, state.count) = (0, 0);
        status
    }
}
