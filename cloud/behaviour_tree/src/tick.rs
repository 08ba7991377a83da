//! How does a tick go through a tree? Depth first from the root, one node asking its children.
//!
//! This file has what all nodes share: scripts before and after (`_skipIf` … `_post`), the status
//! that a node keeps, reset and halt. What each node does stands in the file of its family.
//! Nothing here allocates unless a node fails with an error.
//!
//! A node halts exactly once for every start that it did not finish: [`Run::reset`] halts what is
//! `Running` and nothing else, and leaves it `Idle`.

use std::time::Duration;

use super::blackboard::Blackboard;
use super::leaf::{Gate, Leaf, LeafIo, Pass};
use super::node::{Guards, Info, Kind, Memory, Node, NodeId, NodeState, bump};
use super::ports::Source;
use super::script::Program;
use super::status::Status;
use super::value::{FromValue, Value};

/// A node in error ends the tick; which and why stands in [`Run::fault`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stop;

/// What ended a tick.
#[derive(Debug)]
pub(crate) struct Fault {
    pub(crate) node: NodeId,
    pub(crate) message: String,
}

/// Node visits in one tick of the root: beyond it a loop in the tree does not end.
const VISITS: u32 = 1_000_000;

/// Code from outside that is a node.
pub(crate) enum Body<C> {
    Leaf(Box<dyn Leaf<C>>),
    Gate(Box<dyn Gate<C>>),
}

/// One tick under way: the tree taken apart into what is fixed and what changes.
pub(crate) struct Run<'a, C> {
    pub(crate) nodes: &'a [Node],
    pub(crate) infos: &'a [Info],
    pub(crate) children: &'a [NodeId],
    pub(crate) states: &'a mut [NodeState],
    pub(crate) memories: &'a mut [Memory],
    pub(crate) bodies: &'a mut [Body<C>],
    pub(crate) board: &'a mut Blackboard,
    pub(crate) ctx: &'a mut C,
    pub(crate) now: Duration,
    pub(crate) now_ns: u64,
    /// A node asks for another tick at once.
    pub(crate) wake: bool,
    pub(crate) changes: u64,
    pub(crate) visits: u32,
    pub(crate) fault: Option<Box<Fault>>,
}

impl<'a, C> Run<'a, C> {
    /// Ticks a node and keeps its answer as its status.
    pub(crate) fn exec(&mut self, id: NodeId) -> Result<Status, Stop> {
        self.visits += 1;
        if self.visits > VISITS {
            return Err(self.fault(
                id,
                format!("more than {VISITS} node visits in one tick: a loop in the tree never yields"),
            ));
        }
        let nodes: &'a [Node] = self.nodes;
        let node = &nodes[id as usize];
        let before = self.states[id as usize].status;
        let status = match &node.guards {
            None => self.enter(id, node, before)?,
            Some(guards) => {
                let status = match self.before(id, guards, before)? {
                    Some(status) => status,
                    None => self.enter(id, node, before)?,
                };
                if status.is_completed() {
                    self.after(id, guards, status)?;
                }
                status
            }
        };
        if status == Status::Idle {
            return Err(self.fault(
                id,
                "answered IDLE: expected RUNNING, SUCCESS, FAILURE or SKIPPED".into(),
            ));
        }
        let state = &mut self.states[id as usize];
        // A skipped node keeps its status; it cannot still be running.
        let kept = match status {
            Status::Skipped if state.status == Status::Running => Status::Idle,
            Status::Skipped => state.status,
            other => other,
        };
        if state.last != status {
            self.changes += 1;
        }
        state.last = status;
        state.status = kept;
        Ok(status)
    }

    fn enter(&mut self, id: NodeId, node: &'a Node, before: Status) -> Result<Status, Stop> {
        if before != Status::Running {
            bump(&mut self.states[id as usize].starts);
        }
        match &node.kind {
            Kind::Leaf(body) => self.leaf(id, *body, before),
            Kind::Gate(body) => self.gate(id, *body, before),
            Kind::AlwaysSuccess => Ok(Status::Success),
            Kind::AlwaysFailure => Ok(Status::Failure),
            Kind::Sleep(ms) => self.sleep(id, ms, before),
            Kind::SetBlackboard { value, slot } => self.set_blackboard(id, value, *slot),
            Kind::UnsetBlackboard(slot) => self.unset_blackboard(*slot),
            Kind::Script(code) => self.script(id, code),
            Kind::ScriptCondition(code) => self.script_condition(id, code),
            Kind::WasEntryUpdated(slot) => self.was_entry_updated(id, *slot),
            Kind::Sequence { yields } => self.sequence(id, *yields, before),
            Kind::SequenceWithMemory => self.sequence_with_memory(id, before),
            Kind::Fallback { yields } => self.fallback(id, *yields, before),
            Kind::ReactiveSequence => self.reactive_sequence(id),
            Kind::ReactiveFallback => self.reactive_fallback(id),
            Kind::Parallel(thresholds) => self.parallel(id, thresholds),
            Kind::ParallelAll(max_failures) => self.parallel_all(id, max_failures),
            Kind::ParallelAny => self.parallel_any(id),
            Kind::IfThenElse => self.if_then_else(id),
            Kind::WhileDoElse => self.while_do_else(id),
            Kind::Switch(cases) => self.switch(id, cases),
            Kind::TryCatch { .. } => self.try_catch(id, before),
            Kind::Inverter => self.inverter(id),
            Kind::ForceSuccess => self.force(id, Status::Success),
            Kind::ForceFailure => self.force(id, Status::Failure),
            Kind::Retry(attempts) => self.retry(id, attempts),
            Kind::Repeat(cycles) => self.repeat(id, cycles),
            Kind::KeepRunningUntilFailure => self.keep_running_until_failure(id),
            Kind::RunOnce { then_skip } => self.run_once(id, then_skip),
            Kind::Precondition(latch) => self.precondition(id, latch),
            Kind::SubTree => self.only_child(id),
            Kind::Timeout(ms) => self.timeout(id, ms),
            Kind::Delay(ms) => self.delay(id, ms),
            Kind::IfUpdated { slot, otherwise } => self.if_updated(id, *slot, *otherwise),
            Kind::Loop(queue) => self.loop_over(id, queue, before),
            Kind::PipelineSequence => self.pipeline_sequence(id),
            Kind::RecoveryNode(retries) => self.recovery(id, retries),
            Kind::RoundRobin(rounds) => self.round_robin(id, rounds),
            Kind::NonblockingSequence => self.nonblocking_sequence(id),
            Kind::PersistentSequence(index) => self.persistent_sequence(id, index),
            Kind::RateController(hz) => self.rate_controller(id, hz, before),
            Kind::SingleTrigger => self.single_trigger(id, before),
            Kind::PauseResume { pause, resume } => self.pause_resume(id, *pause, *resume, before),
        }
    }

    /// `_failureIf`, `_successIf`, `_skipIf` in this order before a node starts; `_while` before
    /// it starts and before every tick of it: false skips, and halts what runs.
    fn before(&mut self, id: NodeId, guards: &Guards, status: Status) -> Result<Option<Status>, Stop> {
        let starting = !status.is_active();
        if starting {
            for (script, answer) in [
                (&guards.failure_if, Status::Failure),
                (&guards.success_if, Status::Success),
                (&guards.skip_if, Status::Skipped),
            ] {
                if let Some(script) = script
                    && self.holds(id, script)?
                {
                    return Ok(Some(answer));
                }
            }
        }
        if let Some(script) = &guards.while_true
            && (starting || status == Status::Running)
            && !self.holds(id, script)?
        {
            self.reset(id);
            return Ok(Some(Status::Skipped));
        }
        Ok(None)
    }

    /// `_onSuccess` or `_onFailure`, then `_post`, once the node has completed.
    fn after(&mut self, id: NodeId, guards: &Guards, status: Status) -> Result<(), Stop> {
        let own = if status == Status::Success {
            &guards.on_success
        } else {
            &guards.on_failure
        };
        for script in [own, &guards.post].into_iter().flatten() {
            self.evaluate(id, script)?;
        }
        Ok(())
    }

    /// Puts a node back to `Idle`; one that is `Running` is halted first.
    pub(crate) fn reset(&mut self, id: NodeId) {
        if self.states[id as usize].status == Status::Running {
            self.halt(id);
        }
        let state = &mut self.states[id as usize];
        state.status = Status::Idle;
        state.done = false;
        // What was skipped half-way starts to count anew; RecoveryNode keeps its count, as in Nav2.
        if state.count != 0 && matches!(self.nodes[id as usize].kind, Kind::Retry(_) | Kind::Repeat(_)) {
            state.count = 0;
        }
    }

    /// Resets every child.
    pub(crate) fn reset_children(&mut self, id: NodeId) {
        for child in self.kids(id) {
            self.reset(*child);
        }
    }

    fn halt(&mut self, id: NodeId) {
        let nodes: &'a [Node] = self.nodes;
        let node = &nodes[id as usize];
        if let Kind::TryCatch { catch_on_halt } = &node.kind {
            self.catch_before_halt(id, catch_on_halt);
        }
        self.reset_children(id);
        match &node.kind {
            Kind::Leaf(body) | Kind::Gate(body) => self.halt_body(id, *body),
            _ => {}
        }
        let state = &mut self.states[id as usize];
        state.status = Status::Idle;
        state.count = 0;
        state.flag &= matches!(node.kind, Kind::RunOnce { .. });
        // These two keep their place: the index of the child to resume with, and the last seen
        // number of an entry.
        if !matches!(node.kind, Kind::SequenceWithMemory) {
            state.cursor = 0;
        }
        if !matches!(node.kind, Kind::IfUpdated { .. }) {
            state.mark = 0;
        }
        self.changes += 1;
        if let Some(script) = node.guards.as_ref().and_then(|guards| guards.on_halted.as_ref()) {
            // The first fault is kept and ends the tick.
            let _ = self.evaluate(id, script);
        }
    }

    /// After a fault: halts every leaf that runs, whatever its ancestors' statuses say.
    pub(crate) fn halt_everything(&mut self) {
        for id in (0..self.nodes.len() as NodeId).rev() {
            self.reset(id);
        }
    }

    fn io(&mut self, id: NodeId) -> (LeafIo<'_>, &mut [Body<C>], &mut C) {
        let io = LeafIo {
            info: &self.infos[id as usize],
            uid: (id + 1) as u16,
            now: self.now,
            previous: self.states[id as usize].status,
            board: self.board,
            memory: &mut self.memories[id as usize],
            wake: &mut self.wake,
            abort: None,
        };
        (io, self.bodies, self.ctx)
    }

    fn leaf(&mut self, id: NodeId, body: u32, before: Status) -> Result<Status, Stop> {
        let (mut io, bodies, ctx) = self.io(id);
        let Some(Body::Leaf(leaf)) = bodies.get_mut(body as usize) else {
            return Err(Stop);
        };
        let status = if before != Status::Running {
            io.memory.feedback.clear();
            io.memory.resuming = false;
            leaf.start(&mut io, ctx)
        } else if std::mem::take(&mut io.memory.resuming) {
            leaf.resume(&mut io, ctx)
        } else {
            leaf.tick(&mut io, ctx)
        };
        match io.abort {
            None => Ok(status),
            Some(why) => {
                // It has ended itself: nothing is left to halt.
                self.states[id as usize].status = Status::Idle;
                Err(self.fault(id, why))
            }
        }
    }

    fn gate(&mut self, id: NodeId, body: u32, before: Status) -> Result<Status, Stop> {
        let child = self.child(id, 0)?;
        let child_status = self.states[child as usize].status;
        let (mut io, bodies, ctx) = self.io(id);
        let Some(Body::Gate(gate)) = bodies.get_mut(body as usize) else {
            return Err(Stop);
        };
        if before != Status::Running {
            io.memory.feedback.clear();
        }
        match gate.enter(&mut io, ctx, child_status) {
            Pass::Answer(status) => {
                if let Some(why) = io.abort {
                    return Err(self.fault(id, why));
                }
                if status != Status::Running {
                    self.reset(child);
                }
                Ok(status)
            }
            Pass::Tick => {
                let answer = self.exec_and_reset(child)?;
                let (mut io, bodies, ctx) = self.io(id);
                let Some(Body::Gate(gate)) = bodies.get_mut(body as usize) else {
                    return Err(Stop);
                };
                let status = gate.leave(&mut io, ctx, answer);
                if let Some(why) = io.abort {
                    return Err(self.fault(id, why));
                }
                if status != Status::Running {
                    self.reset(child);
                }
                Ok(status)
            }
        }
    }

    fn halt_body(&mut self, id: NodeId, body: u32) {
        let (mut io, bodies, ctx) = self.io(id);
        match bodies.get_mut(body as usize) {
            Some(Body::Leaf(leaf)) => leaf.halt(&mut io, ctx),
            Some(Body::Gate(gate)) => gate.halt(&mut io, ctx),
            None => {}
        }
        if let Some(why) = io.abort {
            self.fault(id, why);
        }
    }

    /// The children of a node.
    pub(crate) fn kids(&self, id: NodeId) -> &'a [NodeId] {
        let node = &self.nodes[id as usize];
        let first = node.first_child as usize;
        &self.children[first..first + node.child_count as usize]
    }

    /// One child. The index may come from a stored state, so it is checked.
    pub(crate) fn child(&mut self, id: NodeId, index: usize) -> Result<NodeId, Stop> {
        match self.kids(id).get(index) {
            Some(child) => Ok(*child),
            None => Err(self.fault(id, format!("has no child {index}"))),
        }
    }

    /// Ticks a child and, as every decorator does, resets it once it has completed.
    pub(crate) fn exec_and_reset(&mut self, child: NodeId) -> Result<Status, Stop> {
        let status = self.exec(child)?;
        if status.is_completed() {
            self.reset(child);
        }
        Ok(status)
    }

    /// Ticks the only child of a decorator.
    pub(crate) fn only_child(&mut self, id: NodeId) -> Result<Status, Stop> {
        let child = self.child(id, 0)?;
        self.exec_and_reset(child)
    }

    /// Notes what went wrong; the first fault of a tick is the one that is told.
    pub(crate) fn fault(&mut self, node: NodeId, message: String) -> Stop {
        self.fault.get_or_insert_with(|| Box::new(Fault { node, message }));
        Stop
    }

    /// The value of a port, if it has one.
    pub(crate) fn value<'s>(&'s self, source: &'s Source) -> Option<&'s Value> {
        match source {
            Source::Literal(value) => Some(value),
            Source::Slot(slot) => self.board.read(*slot),
            Source::Unset => None,
        }
    }

    /// Reads a port of a built-in node that cannot do without it.
    pub(crate) fn read<T: FromValue>(&mut self, id: NodeId, port: &str, source: &Source) -> Result<T, Stop> {
        let why = match self.value(source) {
            Some(value) => match T::from_value(value) {
                Some(read) => return Ok(read),
                None => format!("port `{port}` holds `{value}`: expected {}", T::EXPECTED),
            },
            None => format!("port `{port}` has no value: expected {}", T::EXPECTED),
        };
        Err(self.fault(id, why))
    }

    /// Runs a script for its value.
    pub(crate) fn evaluate(&mut self, id: NodeId, script: &Program) -> Result<Value, Stop> {
        match script.run(self.board) {
            Ok(value) => Ok(value),
            Err(why) => Err(self.fault(id, format!("script `{}`: {why}", script.text()))),
        }
    }

    /// Runs a script as a condition.
    pub(crate) fn holds(&mut self, id: NodeId, script: &Program) -> Result<bool, Stop> {
        let value = self.evaluate(id, script)?;
        match super::script::truth(&value) {
            Some(truth) => Ok(truth),
            None => Err(self.fault(
                id,
                format!("script `{}` is `{value}`: expected true or false", script.text()),
            )),
        }
    }
}
