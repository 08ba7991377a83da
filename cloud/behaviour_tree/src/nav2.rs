//! The controls and decorators that Nav2 adds and that need no robot: `PipelineSequence`,
//! `RecoveryNode`, `RoundRobin`, `NonblockingSequence`, `PersistentSequence`, `RateController`,
//! `SingleTrigger` (nav2_behavior_tree 1.5).

use super::node::{NodeId, Rounds, bump};
use super::ports::Source;
use super::status::Status;
use super::tick::{Run, Stop};
use super::value::Value;

impl<C> Run<'_, C> {
    /// From child 0 in every tick. `Running` ends the tick unless a later child has been reached
    /// before (`cursor`): then the earlier one runs beside it. `Failure`: resets all, `Failure`.
    pub(crate) fn pipeline_sequence(&mut self, id: NodeId) -> Result<Status, Stop> {
        let kids = self.kids(id);
        let mut skipped = 0;
        for (index, child) in kids.iter().enumerate() {
            match self.exec(*child)? {
                Status::Failure => {
                    self.reset_children(id);
                    self.states[id as usize].cursor = 0;
                    return Ok(Status::Failure);
                }
                Status::Running if index >= self.states[id as usize].cursor as usize => {
                    self.states[id as usize].cursor = index as u32;
                    return Ok(Status::Running);
                }
                Status::Skipped => skipped += 1,
                _ => {}
            }
        }
        self.reset_children(id);
        self.states[id as usize].cursor = 0;
        Ok(if skipped == kids.len() {
            Status::Skipped
        } else {
            Status::Success
        })
    }

    /// Child 0; when it fails, child 1 mends and child 0 is tried again in the same tick, at most
    /// `number_of_retries` times (`count`). Failure of child 1 is the answer. A skipped child 1
    /// is a failure that keeps the count. `cursor` is the child whose turn it is.
    pub(crate) fn recovery(&mut self, id: NodeId, retries: &Source) -> Result<Status, Stop> {
        let retries: i64 = self.read(id, "number_of_retries", retries)?;
        let main = self.child(id, 0)?;
        let mend = self.child(id, 1)?;
        loop {
            if self.states[id as usize].cursor == 0 {
                match self.exec(main)? {
                    Status::Running => return Ok(Status::Running),
                    Status::Failure if i64::from(self.states[id as usize].count) < retries => {
                        self.reset(main);
                        self.states[id as usize].cursor = 1;
                    }
                    other => return Ok(self.end_recovery(id, other)),
                }
            } else {
                match self.exec(mend)? {
                    Status::Running => return Ok(Status::Running),
                    Status::Success => {
                        self.reset(mend);
                        let state = &mut self.states[id as usize];
                        bump(&mut state.count);
                        state.cursor = 0;
                    }
                    Status::Skipped => {
                        self.states[id as usize].cursor = 0;
                        return Ok(Status::Failure);
                    }
                    _ => return Ok(self.end_recovery(id, Status::Failure)),
                }
            }
        }
    }

    fn end_recovery(&mut self, id: NodeId, status: Status) -> Status {
        self.reset_children(id);
        let state = &mut self.states[id as usize];
        (state.cursor, state.count) = (0, 0);
        status
    }

    /// One child an activation, in turn: `Success` of a child is the answer, and the next
    /// activation starts with the next child (`cursor` is kept). `Failure` or `Skipped`: the next
    /// child at once, until all have failed.
    ///
    /// As in Nav2, without `wrap_around` the last child's answer is not looked at: even its
    /// `Success` makes the node fail and start over. With `last_may_succeed` (not in Nav2) it
    /// counts, and the activation after it fails.
    pub(crate) fn round_robin(&mut self, id: NodeId, rounds: &Rounds) -> Result<Status, Stop> {
        let kids = self.kids(id);
        let flag = |run: &Self, source| run.value(source).and_then(Value::as_bool).unwrap_or(false);
        let wrap_around = flag(self, &rounds.wrap_around);
        let last_may_succeed = flag(self, &rounds.last_may_succeed);
        let mut skipped = 0;
        while (self.states[id as usize].count as usize + skipped) < kids.len() {
            let index = self.states[id as usize].cursor as usize;
            let Some(child) = kids.get(index) else { break };
            let status = self.exec(*child)?;
            if status == Status::Running {
                return Ok(Status::Running);
            }
            let last = index + 1 == kids.len();
            self.states[id as usize].cursor = if last && wrap_around { 0 } else { index as u32 + 1 };
            if last && !wrap_around && !(last_may_succeed && status == Status::Success) {
                skipped += usize::from(status == Status::Skipped);
                break;
            }
            match status {
                Status::Success => {
                    self.reset_children(id);
                    self.states[id as usize].count = 0;
                    return Ok(Status::Success);
                }
                Status::Skipped => skipped += 1,
                _ => bump(&mut self.states[id as usize].count),
            }
        }
        self.reset_children(id);
        let state = &mut self.states[id as usize];
        (state.cursor, state.count) = (0, 0);
        Ok(if skipped == kids.len() {
            Status::Skipped
        } else {
            Status::Failure
        })
    }

    /// Every child in every tick. Any `Failure`: resets all, `Failure`. Any `Running`: `Running`.
    /// A child that is skipped is an error.
    pub(crate) fn nonblocking_sequence(&mut self, id: NodeId) -> Result<Status, Stop> {
        let mut running = false;
        for child in self.kids(id) {
            match self.exec(*child)? {
                Status::Failure => {
                    self.reset_children(id);
                    return Ok(Status::Failure);
                }
                Status::Running => running = true,
                Status::Skipped => {
                    return Err(self.fault(id, "a child was skipped: expected SUCCESS, FAILURE or RUNNING".into()));
                }
                _ => {}
            }
        }
        if running {
            return Ok(Status::Running);
        }
        self.reset_children(id);
        Ok(Status::Success)
    }

    /// A Sequence whose index is a blackboard entry, so that it outlives halts. `Failure` and the
    /// end set it back to 0.
    pub(crate) fn persistent_sequence(&mut self, id: NodeId, index: &Source) -> Result<Status, Stop> {
        let kids = self.kids(id);
        let mut skipped = 0;
        loop {
            let at = self.value(index).and_then(Value::as_int).unwrap_or(0);
            let Some(child) = usize::try_from(at).ok().and_then(|at| kids.get(at)) else {
                break;
            };
            match self.exec(*child)? {
                Status::Running => return Ok(Status::Running),
                Status::Failure => {
                    self.reset_children(id);
                    self.write_index(id, index, 0)?;
                    return Ok(Status::Failure);
                }
                Status::Skipped => skipped += 1,
                _ => {}
            }
            self.write_index(id, index, at + 1)?;
        }
        self.reset_children(id);
        self.write_index(id, index, 0)?;
        Ok(if skipped == kids.len() {
            Status::Skipped
        } else {
            Status::Success
        })
    }

    fn write_index(&mut self, id: NodeId, index: &Source, at: i64) -> Result<(), Stop> {
        let written = match index {
            Source::Slot(slot) => self
                .board
                .write(*slot, Value::Int(at))
                .map_err(|wrong| wrong.to_string()),
            _ => Err("expected a blackboard entry, as in `{key}`".to_owned()),
        };
        written.map_err(|why| self.fault(id, format!("port `current_child_idx`: {why}")))
    }

    /// Ticks the child on activation, while it runs, and once `1/hz` has passed since it last
    /// succeeded; otherwise `Running`. `flag`: ticked in this activation; `mark`: last success.
    pub(crate) fn rate_controller(&mut self, id: NodeId, hz: &Source, before: Status) -> Result<Status, Stop> {
        let hz: f64 = self.read(id, "hz", hz)?;
        if hz.is_nan() || hz <= 0.0 {
            return Err(self.fault(id, format!("port `hz` holds {hz}: expected more than 0")));
        }
        let child = self.child(id, 0)?;
        if !before.is_active() {
            let now = self.now_ns;
            let state = &mut self.states[id as usize];
            (state.mark, state.flag) = (now, false);
        }
        let state = &self.states[id as usize];
        let due = self.now_ns.saturating_sub(state.mark) as f64 >= 1e9 / hz;
        if state.flag && !due && self.states[child as usize].status != Status::Running {
            return Ok(Status::Running);
        }
        self.states[id as usize].flag = true;
        let status = self.exec_and_reset(child)?;
        if status == Status::Success {
            self.states[id as usize].mark = self.now_ns;
            self.changes += 1;
        }
        Ok(status)
    }

    /// Runs the child to its end once an activation; afterwards `Failure` until the parent resets
    /// the node. `flag`: done.
    pub(crate) fn single_trigger(&mut self, id: NodeId, before: Status) -> Result<Status, Stop> {
        if !before.is_active() {
            self.states[id as usize].flag = false;
        }
        if self.states[id as usize].flag {
            return Ok(Status::Failure);
        }
        let status = self.only_child(id)?;
        self.states[id as usize].flag = status.is_completed();
        Ok(status)
    }
}
