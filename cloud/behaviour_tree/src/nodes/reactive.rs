//! Sequences and fallbacks that start from the first child in every tick: BehaviorTree.CPP's
//! `ReactiveSequence` and `ReactiveFallback`.

use super::Builtin;
use crate::node::NodeId;
use crate::status::Status;
use crate::tick::{Answer, Run};

/// Starts from child 0 in every tick.
///
/// | child | ReactiveSequence |
/// |---|---|
/// | `Success` | continues with the next child |
/// | `Running` | halts all others, `Running` |
/// | `Failure` | resets all, `Failure` |
/// | `Skipped` | resets it and continues; all skipped: `Skipped` |
pub(crate) struct ReactiveSequence;

/// [`ReactiveSequence`] with `Success` and `Failure` swapped.
pub(crate) struct ReactiveFallback;

impl<C> Builtin<C> for ReactiveSequence {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        react(run, id, Status::Failure, Status::Success)
    }
}

impl<C> Builtin<C> for ReactiveFallback {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
        react(run, id, Status::Success, Status::Failure)
    }
}

fn react<C>(run: &mut Run<'_, C>, id: NodeId, end: Status, otherwise: Status) -> Answer {
    let kids = run.kids(id);
    let mut skipped = 0;
    for child in kids {
        let status = run.exec(*child)?;
        if status == Status::Running {
            for other in kids {
                if other != child {
                    run.reset(*other);
                }
            }
            return Ok(Status::Running);
        }
        if status == end {
            run.reset_children(id);
            return Ok(end);
        }
        if status == Status::Skipped {
            skipped += 1;
            run.reset(*child);
        }
    }
    run.reset_children(id);
    Ok(otherwise.unless_skipped(skipped == kids.len()))
}
