//! Sequences and fallbacks that ask from the first child again in every tick: BehaviorTree.CPP's
//! `ReactiveSequence` and `ReactiveFallback`.

use super::node::NodeId;
use super::status::Status;
use super::tick::{Run, Stop};

impl<C> Run<'_, C> {
    /// From child 0 in every tick. The first that is `Running` halts all others: `Running`.
    /// `Failure`: resets all, `Failure`. A skipped child is reset. All skipped: `Skipped`.
    pub(crate) fn reactive_sequence(&mut self, id: NodeId) -> Result<Status, Stop> {
        self.react(id, Status::Failure, Status::Success)
    }

    /// From child 0 in every tick. The first that is `Running` halts all others: `Running`.
    /// `Success`: resets all, `Success`. All fail: `Failure`. All skipped: `Skipped`.
    pub(crate) fn reactive_fallback(&mut self, id: NodeId) -> Result<Status, Stop> {
        self.react(id, Status::Success, Status::Failure)
    }

    fn react(&mut self, id: NodeId, end: Status, otherwise: Status) -> Result<Status, Stop> {
        let kids = self.kids(id);
        let mut skipped = 0;
        for child in kids {
            let status = self.exec(*child)?;
            if status == Status::Running {
                for other in kids {
                    if other != child {
                        self.reset(*other);
                    }
                }
                return Ok(Status::Running);
            }
            if status == end {
                self.reset_children(id);
                return Ok(end);
            }
            if status == Status::Skipped {
                skipped += 1;
                self.reset(*child);
            }
        }
        self.reset_children(id);
        Ok(if skipped == kids.len() {
            Status::Skipped
        } else {
            otherwise
        })
    }
}
