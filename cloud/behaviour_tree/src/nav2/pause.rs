//! A control that pauses and resumes on request: Nav2's `PauseResumeController` (nav2_behavior_tree 1.5).
//!
//! Nav2 offers two services; here a request is a write of any value to the entry with that name on the root blackboard. `cursor` is the
//! current child: 0 resumed, 1 paused, 2 on pausing, 3 on resuming. `mark` and `count` are the numbers of served requests to pause and to
//! resume: requests made while the node is not active wait for it, as Nav2's services queue them.

use std::cmp::Ordering;

use crate::node::{NodeId, NodeState};
use crate::nodes::{Builtin, PauseEntries};
use crate::status::Status;
use crate::tick::{Answer, Run};

/// Indices of the children.
const RESUMED: u32 = 0;
const PAUSED: u32 = 1;
const ON_PAUSE: u32 = 2;
const ON_RESUME: u32 = 3;

/// Ticks the child of the present state. A request resets every child and goes through the child for the transition, if there is one; a
/// state without a child is `Running`. `Success` of the resumed child is the answer, and so is `Failure` of any child; any other success
/// continues. `Skipped` is the same as `Success`.
pub(crate) struct PauseResume(pub(crate) PauseEntries);

impl<C> Builtin<C> for PauseResume {
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer {
        let requests = [run.board.sequence(self.0.pause), run.board.sequence(self.0.resume)];
        let state = &mut run.states[id];
        if before != Status::Running {
            state.cursor = RESUMED;
        }
        // A pause and a resume since the last tick cancel out.
        let pauses = requests[0].wrapping_sub(state.mark) as i64;
        let resumes = (requests[1] as u32).wrapping_sub(state.count) as i32;
        (state.mark, state.count) = (requests[0], requests[1] as u32);
        let is_paused = matches!(state.cursor, PAUSED | ON_PAUSE);
        match pauses.cmp(&i64::from(resumes)) {
            Ordering::Greater if !is_paused => switch_to(run, id, ON_PAUSE),
            Ordering::Less if is_paused => switch_to(run, id, ON_RESUME),
            _ => {}
        }
        let at = run.states[id].cursor;
        let status = match run.kids(id).get(at as usize) {
            Some(child) => run.exec_and_reset(*child)?,
            // This state has no child.
            None => Status::Success,
        };
        match (status, at) {
            (Status::Running, _) => Ok(Status::Running),
            (Status::Failure, _) | (_, RESUMED) => {
                run.reset_children(id);
                Ok(Status::from_truth(status != Status::Failure))
            }
            (_, change) => {
                if change == ON_PAUSE {
                    switch_to(run, id, PAUSED);
                } else if change == ON_RESUME {
                    switch_to(run, id, RESUMED);
                }
                Ok(Status::Running)
            }
        }
    }

    fn after_halt(&self, state: &mut NodeState) {
        // Served requests stay served.
        let served = (state.mark, state.count);
        state.clear();
        (state.mark, state.count) = served;
    }

    fn pause_entries(&self) -> Option<PauseEntries> {
        Some(self.0)
    }
}

fn switch_to<C>(run: &mut Run<'_, C>, id: NodeId, child: u32) {
    run.reset_children(id);
    run.states[id].cursor = child;
    run.changes += 1;
}
