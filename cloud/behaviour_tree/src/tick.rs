//! Tick. How does a tick traverse a tree? Depth first from the root; each node ticks its children.
//!
//! This file has what all nodes share: scripts before and after (`_skipIf` … `_post`), the node's stored status, reset and halt. The
//! behaviour of each node is in the file of its family. Nothing here allocates unless a node fails with an error.
//!
//! A node is halted exactly once for every start that it did not finish: [`Run::reset`] halts a node only if it is `Running`, and leaves it
//! `Idle`. A node with children is `Running` while they are ticked, so an error below it halts it, too.

use std::ops::{Index, IndexMut};
use std::time::Duration;

use super::blackboard::Blackboard;
use super::leaf::{Decorator, Enter, Leaf, LeafIo};
use super::node::{Guards, Info, Memory, Node, NodeId, NodeState, Role, bump};
use super::ports::Source;
use super::script::Program;
use super::status::Status;
use super::value::{FromValue, Value};

/// A node error ends the tick; the node and the reason are in [`Run::fault`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stop;

/// Result of ticking a node.
pub(crate) type Answer = Result<Status, Stop>;

/// Error that ended a tick.
#[derive(Debug)]
pub(crate) struct Fault {
    pub(crate) node: NodeId,
    pub(crate) message: String,
}

/// Most node visits in one tick of the root: more mean that a loop in the tree does not end.
const VISITS: u32 = 1_000_000;

/// External code of a node.
pub(crate) enum Body<C> {
    Leaf(Box<dyn Leaf<C>>),
    Decorator(Box<dyn Decorator<C>>),
}

/// The run-time states of a tree's nodes, by their ids.
pub(crate) struct States<'a>(pub(crate) &'a mut [NodeState]);

impl Index<NodeId> for States<'_> {
    type Output = NodeState;

    #[inline]
    fn index(&self, id: NodeId) -> &NodeState {
        &self.0[id as usize]
    }
}

impl IndexMut<NodeId> for States<'_> {
    #[inline]
    fn index_mut(&mut self, id: NodeId) -> &mut NodeState {
        &mut self.0[id as usize]
    }
}

/// One tick in progress: the tree split into fixed and changing parts.
pub(crate) struct Run<'a, C> {
    pub(crate) nodes: &'a [Node<C>],
    pub(crate) infos: &'a [Info],
    pub(crate) children: &'a [NodeId],
    pub(crate) states: States<'a>,
    pub(crate) memories: &'a mut [Memory],
    pub(crate) bodies: &'a mut [Body<C>],
    pub(crate) board: &'a mut Blackboard,
    pub(crate) ctx: &'a mut C,
    pub(crate) now: Duration,
    pub(crate) now_ns: u64,
    /// Whether a node requests another tick at once.
    pub(crate) wake: bool,
    pub(crate) changes: u64,
    pub(crate) visits: u32,
    pub(crate) fault: Option<Box<Fault>>,
}

impl<'a, C> Run<'a, C> {
    /// Ticks a node and stores its answer as its status.
    pub(crate) fn exec(&mut self, id: NodeId) -> Answer {
        self.visits += 1;
        if self.visits > VISITS {
            return Err(self.fault(
                id,
                format!("more than {VISITS} node visits in one tick: a loop in the tree never yields"),
            ));
        }
        let nodes: &'a [Node<C>] = self.nodes;
        let node = &nodes[id as usize];
        let before = self.states[id].status;
        let status = match &node.guards {
            None => self.enter(id, node, before)?,
            Some(guards) => {
                let status = match self.before(id, guards, before)? {
                    Some(status) => status,
                    None => self.enter(id, node, before)?,
                };
                if status.is_completed() {
                    // It has ended: an error in these scripts does not halt it.
                    self.states[id].status = status;
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
        // A skipped node keeps its status; it cannot still be running.
        let kept = match (status, before) {
            (Status::Skipped, Status::Running) => Status::Idle,
            (Status::Skipped, before) => before,
            (other, _) => other,
        };
        let state = &mut self.states[id];
        if state.last != status {
            self.changes += 1;
        }
        state.last = status;
        state.status = kept;
        Ok(status)
    }

    fn enter(&mut self, id: NodeId, node: &'a Node<C>, before: Status) -> Answer {
        if before != Status::Running {
            bump(&mut self.states[id].starts);
        }
        match &node.role {
            Role::Builtin(builtin) => {
                if node.child_count > 0 {
                    self.starts_children(id);
                }
                builtin.tick(self, id, before)
            }
            Role::Leaf(body) => self.leaf(id, *body, before),
            Role::Decorator(body) => self.decorator(id, *body, before),
        }
    }

    /// From here on the node counts as running: an error below it halts it with its children.
    fn starts_children(&mut self, id: NodeId) {
        self.states[id].status = Status::Running;
    }

    /// `_failureIf`, `_successIf`, `_skipIf`, in this order, before a node starts; `_while` before it starts and before each of its ticks:
    /// if false, the node is skipped, and halted if running.
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

    /// `_onSuccess` or `_onFailure`, then `_post`, after the node has completed.
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

    /// Sets a node back to `Idle`; a `Running` node is halted first.
    pub(crate) fn reset(&mut self, id: NodeId) {
        if self.states[id].status == Status::Running {
            self.halt(id);
        }
        let state = &mut self.states[id];
        state.status = Status::Idle;
        state.done = false;
        if state.count != 0
            && let Role::Builtin(builtin) = &self.nodes[id as usize].role
        {
            builtin.on_reset(state);
        }
    }

    /// Resets every child.
    pub(crate) fn reset_children(&mut self, id: NodeId) {
        for child in self.kids(id) {
            self.reset(*child);
        }
    }

    /// Ends an activation with this answer: every child is reset, `cursor` and `count` start over.
    pub(crate) fn finish(&mut self, id: NodeId, status: Status) -> Status {
        self.reset_children(id);
        let state = &mut self.states[id];
        (state.cursor, state.count) = (0, 0);
        status
    }

    fn halt(&mut self, id: NodeId) {
        let nodes: &'a [Node<C>] = self.nodes;
        let node = &nodes[id as usize];
        if let Role::Builtin(builtin) = &node.role {
            builtin.before_halt(self, id);
        }
        self.reset_children(id);
        if let Role::Leaf(body) | Role::Decorator(body) = &node.role {
            self.halt_body(id, *body);
        }
        let state = &mut self.states[id];
        state.status = Status::Idle;
        match &node.role {
            Role::Builtin(builtin) => builtin.after_halt(state),
            Role::Leaf(_) | Role::Decorator(_) => state.clear(),
        }
        self.changes += 1;
        if let Some(script) = node.guards.as_ref().and_then(|guards| guards.on_halted.as_ref()) {
            // The first fault is kept and ends the tick.
            let _ = self.evaluate(id, script);
        }
    }

    /// After a fault: halts what runs, from the root down as [`Tree::halt`](super::Tree::halt) does, and whatever else a damaged snapshot
    /// left running.
    pub(crate) fn halt_everything(&mut self) {
        // A clean-up on halting has node visits of its own.
        self.visits = 0;
        for id in 0..self.nodes.len() as NodeId {
            self.reset(id);
        }
    }

    /// A node's view of the tree; `previous` is its status before this tick.
    fn io(&mut self, id: NodeId, previous: Status) -> (LeafIo<'_>, &mut [Body<C>], &mut C) {
        let io = LeafIo {
            info: &self.infos[id as usize],
            uid: (id + 1) as u16,
            now: self.now,
            previous,
            board: self.board,
            memory: &mut self.memories[id as usize],
            wake: &mut self.wake,
            abort: None,
        };
        (io, self.bodies, self.ctx)
    }

    fn leaf(&mut self, id: NodeId, body: u32, before: Status) -> Answer {
        let (mut io, bodies, ctx) = self.io(id, before);
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
                // The leaf has ended itself: nothing is left to halt.
                self.states[id].status = Status::Idle;
                Err(self.fault(id, why))
            }
        }
    }

    fn decorator(&mut self, id: NodeId, body: u32, before: Status) -> Answer {
        let child = self.child(id, 0)?;
        let child_status = self.states[child].status;
        let (mut io, bodies, ctx) = self.io(id, before);
        let Some(Body::Decorator(decorator)) = bodies.get_mut(body as usize) else {
            return Err(Stop);
        };
        if before != Status::Running {
            io.memory.feedback.clear();
        }
        let (status, abort) = match decorator.enter(&mut io, ctx, child_status) {
            Enter::Answer(status) => (status, io.abort),
            Enter::TickChild => {
                self.starts_children(id);
                let answer = self.exec_and_reset(child)?;
                let (mut io, bodies, ctx) = self.io(id, before);
                let Some(Body::Decorator(decorator)) = bodies.get_mut(body as usize) else {
                    return Err(Stop);
                };
                (decorator.leave(&mut io, ctx, answer), io.abort)
            }
        };
        if abort.is_some() || status != Status::Running {
            self.reset(child);
        }
        match abort {
            None => Ok(status),
            Some(why) => {
                // It has ended itself, as a leaf does.
                self.states[id].status = Status::Idle;
                Err(self.fault(id, why))
            }
        }
    }

    fn halt_body(&mut self, id: NodeId, body: u32) {
        let (mut io, bodies, ctx) = self.io(id, Status::Running);
        match bodies.get_mut(body as usize) {
            Some(Body::Leaf(leaf)) => leaf.halt(&mut io, ctx),
            Some(Body::Decorator(decorator)) => decorator.halt(&mut io, ctx),
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
    pub(crate) fn exec_and_reset(&mut self, child: NodeId) -> Answer {
        let status = self.exec(child)?;
        if status.is_completed() {
            self.reset(child);
        }
        Ok(status)
    }

    /// Ticks the only child of a decorator.
    pub(crate) fn only_child(&mut self, id: NodeId) -> Answer {
        let child = self.child(id, 0)?;
        self.exec_and_reset(child)
    }

    /// Records a fault; the first fault of a tick is the one reported.
    pub(crate) fn fault(&mut self, node: NodeId, message: String) -> Stop {
        self.fault.get_or_insert_with(|| Box::new(Fault { node, message }));
        Stop
    }

    /// The value of a port, if it has one.
    pub(crate) fn value<'s>(&'s self, source: &'s Source) -> Option<&'s Value> {
        source.value(self.board)
    }

    /// Reads a port that a built-in node requires.
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
