//! Controls whose children run in parallel: BehaviorTree.CPP's `Parallel` and `ParallelAll`, and `ParallelAny`, which is py_trees' Parallel
//! with the policy SuccessOnOne.
//!
//! A completed child is marked `done` and not ticked again until all are reset; `count` holds failures, `cursor` successes.

use super::Builtin;
use crate::node::{NodeId, bump};
use crate::ports::Source;
use crate::status::Status;
use crate::tick::{Answer, Run};

/// A threshold as a number of children: -1 is all, -2 all but one, …
fn of_children(threshold: i64, children: usize) -> i64 {
    let children = children as i64;
    if threshold < 0 {
        (children + 1).saturating_add(threshold).max(0)
    } else {
        threshold
    }
}

/// Ticks every child that is not done, in order, and ends as soon as `success_count` have succeeded, `failure_count` have failed, or
/// success has become impossible; then resets all. With a negative success threshold, skipped children count as succeeded.
pub(crate) struct Parallel {
    pub(crate) success_count: Source,
    pub(crate) failure_count: Source,
}

impl<C> Builtin<C> for Parallel {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let kids = run.kids(id);
        let all = kids.len() as i64;
        let asked: i64 = run.read(id, "success_count", &self.success_count)?;
        let needed = of_children(asked, kids.len());
        let allowed: i64 = run.read(id, "failure_count", &self.failure_count)?;
        let allowed = of_children(allowed, kids.len());
        if needed > all || allowed > all {
            let what = format!("has {all} children: expected thresholds of at most as many");
            return Err(run.fault(id, what));
        }
        let mut skipped = 0;
        for child in kids {
            if !run.states[*child].done {
                match run.exec(*child)? {
                    Status::Success => {
                        run.states[*child].done = true;
                        bump(&mut run.states[id].cursor);
                    }
                    Status::Failure => {
                        run.states[*child].done = true;
                        bump(&mut run.states[id].count);
                    }
                    Status::Skipped => skipped += 1,
                    _ => {}
                }
            }
            let state = &run.states[id];
            let (successes, failures) = (i64::from(state.cursor), i64::from(state.count));
            if successes >= needed || (asked < 0 && successes + skipped >= needed) {
                return Ok(run.finish(id, Status::Success));
            }
            if all - failures < needed || failures == allowed {
                return Ok(run.finish(id, Status::Failure));
            }
        }
        Ok(Status::Running.unless_skipped(skipped == all))
    }
}

/// Runs every child to completion; `Failure` if at least `max_failures` failed. All skipped: `Skipped`.
pub(crate) struct ParallelAll {
    pub(crate) max_failures: Source,
}

impl<C> Builtin<C> for ParallelAll {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let kids = run.kids(id);
        let limit: i64 = run.read(id, "max_failures", &self.max_failures)?;
        let limit = of_children(limit, kids.len());
        if limit > kids.len() as i64 {
            let what = format!("has {} children: expected max_failures of at most as many", kids.len());
            return Err(run.fault(id, what));
        }
        let (mut skipped, mut done) = (0, 0);
        for child in kids {
            if !run.states[*child].done {
                match run.exec(*child)? {
                    Status::Success => run.states[*child].done = true,
                    Status::Failure => {
                        run.states[*child].done = true;
                        bump(&mut run.states[id].count);
                    }
                    Status::Skipped => skipped += 1,
                    _ => {}
                }
            }
            done += usize::from(run.states[*child].done);
        }
        if skipped == kids.len() {
            return Ok(Status::Skipped);
        }
        if skipped + done < kids.len() {
            return Ok(Status::Running);
        }
        let failed = i64::from(run.states[id].count) >= limit;
        Ok(run.finish(id, Status::from_truth(!failed)))
    }
}

/// Ticks every child in every tick. If any failed: `Failure`; otherwise, if any succeeded: `Success`; both halt the others. All skipped:
/// `Skipped`.
pub(crate) struct ParallelAny;

impl<C> Builtin<C> for ParallelAny {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        let kids = run.kids(id);
        let (mut failed, mut succeeded, mut skipped) = (false, false, 0);
        for child in kids {
            match run.exec(*child)? {
                Status::Failure => failed = true,
                Status::Success => succeeded = true,
                Status::Skipped => skipped += 1,
                _ => {}
            }
        }
        Ok(if failed || succeeded {
            run.finish(id, Status::from_truth(!failed))
        } else {
            Status::Running.unless_skipped(skipped == kids.len())
        })
    }
}
