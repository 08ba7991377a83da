//! Sequences and fallbacks that start from the first child in every tick: BehaviorTree.CPP's
//! `ReactiveSequence` and `ReactiveFallback`.

use super::Builtin;
use crate::node::NodeId;
use crate::status::Status;
use crate::tick::{Answer, Run};

/// Starts from child 0 in every tick, until one answers `end`. As a ReactiveSequence:
///
/// | child | ReactiveSequence |
/// |---|---|
/// | `Success` | continues with the next child |
/// | `Running` | halts all others, `Running` |
/// | `Failure` | resets all, `Failure` |
/// | `Skipped` | resets it and continues; all skipped: `Skipped` |
///
/// A ReactiveFallback swaps `Success` and `Failure`.
pub(crate) struct Reactive {
    pub(crate) end: Status,
}

impl<C> Builtin<C> for Reactive {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, _: Status) -> Answer {
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
            if status == self.end {
                run.reset_children(id);
                return Ok(status);
            }
            if status == Status::Skipped {
                skipped += 1;
                run.reset(*child);
            }
        }
        run.reset_children(id);
        let otherwise = Status::from_truth(self.end == Status::Failure);
        Ok(otherwise.unless_skipped(skipped == kids.len()))
    }
}
