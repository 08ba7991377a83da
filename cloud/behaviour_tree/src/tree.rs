//! Tree. How is a tree run? A tick ticks the root, and again at once while a node asks to be woken (BehaviorTree.CPP's `tickOnce`).

use std::time::Duration;

use super::blackboard::{Blackboard, Slot};
use super::node::{Info, Memory, Node, NodeId, NodeState, Role, nanos};
use super::nodes::PauseEntries;
use super::status::Status;
use super::tick::{Body, Run, States, Stop};
use super::value::Value;

/// Most rounds of one tick: an endless retry of a child that fails at once continues in the next tick.
const ROUNDS: u32 = 1_000;
/// Node visits after which a tick is not extended by a node that asks to be woken.
const ROUND_VISITS: u32 = 100_000;

/// A node error: a script that cannot be evaluated, a port without a value, a leaf that aborts. The whole tree has been halted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{path} (node {uid}): {message}")]
pub struct TickError {
    /// Number of the node.
    pub uid: u16,
    /// Names from the root to the node, joined by `/`.
    pub path: String,
    /// The error, and what was expected.
    pub message: String,
}

/// A tree of nodes over a context `C`, ready to run.
pub struct Tree<C> {
    pub(crate) id: String,
    pub(crate) nodes: Vec<Node<C>>,
    pub(crate) infos: Vec<Info>,
    pub(crate) children: Vec<NodeId>,
    pub(crate) states: Vec<NodeState>,
    pub(crate) memories: Vec<Memory>,
    pub(crate) bodies: Vec<Body<C>>,
    pub(crate) board: Blackboard,
    pub(crate) shape: u64,
    pub(crate) changes: u64,
}

impl<C> std::fmt::Debug for Tree<C> {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "Tree({}, {} nodes, {})", self.id, self.nodes.len(), self.status())
    }
}

impl<C> Tree<C> {
    /// Id of the root tree.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Number of nodes, SubTrees unfolded.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Always false: a tree has a root.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The root's status: `Running` between the ticks of an unfinished run, else `Idle`.
    pub fn status(&self) -> Status {
        self.states.first().map_or(Status::Idle, |root| root.status)
    }

    /// The blackboard; keys refer to the root scope.
    pub fn blackboard(&self) -> &Blackboard {
        &self.board
    }

    /// The blackboard, to write goals and parameters before and between ticks.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use zenav_behaviour_tree::{Registry, Status, build};
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><ScriptCondition code="charge > 0.2"/></BehaviorTree></root>"#;
    /// # let mut tree = build("charge.xml", text.as_bytes(), &Registry::<()>::new(), None, &mut |_, _| Err("no includes".into()))?;
    /// for (charge, answer) in [(0.5, Status::Success), (0.1, Status::Failure)] {
    ///     tree.blackboard_mut().set("charge", charge)?;
    ///     assert_eq!(tree.tick(Duration::ZERO, &mut ())?, answer);
    /// }
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn blackboard_mut(&mut self) -> &mut Blackboard {
        &mut self.board
    }

    /// Counts every change that a restart must not lose: a new answer of a node, a halt, a write to an entry or to a leaf's memory. While
    /// it does not change, a stored snapshot stays valid, except for the counters of starts.
    pub fn revision(&self) -> u64 {
        let remembered: u64 = self.memories.iter().map(|memory| memory.writes).sum();
        self.changes.wrapping_add(self.board.writes()).wrapping_add(remembered)
    }

    /// Whether the tree can be paused on request: it has a `PauseResumeController`.
    pub fn can_pause(&self) -> bool {
        self.pause_entries().next().is_some()
    }

    /// Asks every `PauseResumeController` to pause, or to resume; if one of their entries has an incompatible type, none is asked, and the
    /// result is `false`.
    pub fn ask_to_pause(&mut self, resume: bool) -> bool {
        let entries = self
            .pause_entries()
            .map(|entries| if resume { entries.resume } else { entries.pause });
        // A different text each time, so that the request is stored.
        let requests: Vec<(Slot, Value)> = entries
            .map(|slot| {
                (
                    slot,
                    Value::text(self.board.sequence(slot).saturating_add(1).to_string()),
                )
            })
            .collect();
        let fits = |(slot, value): &(Slot, Value)| {
            let kind = self.board.kind(*slot);
            kind.is_none_or(|kind| kind == value.kind() || value.convert(kind).is_some())
        };
        requests.iter().all(fits)
            && requests
                .into_iter()
                .all(|(slot, value)| self.board.write(slot, value).is_ok())
    }

    /// Makes the `PauseResumeController`s ignore earlier writes to their entries.
    pub fn forget_pauses(&mut self) {
        for (node, state) in self.nodes.iter().zip(&mut self.states) {
            if let Role::Builtin(builtin) = &node.role
                && let Some(entries) = builtin.pause_entries()
            {
                state.mark = self.board.sequence(entries.pause);
                state.count = self.board.sequence(entries.resume) as u32;
            }
        }
    }

    fn pause_entries(&self) -> impl Iterator<Item = PauseEntries> {
        self.nodes.iter().filter_map(|node| match &node.role {
            Role::Builtin(builtin) => builtin.pause_entries(),
            Role::Leaf(_) | Role::Decorator(_) => None,
        })
    }

    /// Ticks the tree at the time `now` (since any epoch, never decreasing), and again at once while a node asks to be woken. `Success`,
    /// `Failure` or `Skipped` ends the run: the next tick starts over.
    ///
    /// Cost: no allocation unless a leaf or a text makes one.
    ///
    /// # Errors
    /// [`TickError`]: a node error. Every running leaf has been halted.
    ///
    /// ```
    /// use std::time::Duration;
    /// use zenav_behaviour_tree::{Registry, Status, build};
    ///
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Timeout msec="100"><Sleep msec="500"/></Timeout></BehaviorTree></root>"#;
    /// let mut tree = build("slow.xml", text.as_bytes(), &Registry::<()>::new(), None, &mut |_, _| Err("no includes".into()))?;
    /// assert_eq!(tree.tick(Duration::ZERO, &mut ())?, Status::Running);
    /// assert_eq!(tree.tick(Duration::from_millis(99), &mut ())?, Status::Running);
    /// assert_eq!(tree.tick(Duration::from_millis(100), &mut ())?, Status::Failure);
    /// assert_eq!(tree.status(), Status::Idle, "the run has ended");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn tick(&mut self, now: Duration, ctx: &mut C) -> Result<Status, TickError> {
        self.run(now, ctx, ROUNDS)
    }

    /// As [`Tree::tick`], but ticks the root exactly once.
    ///
    /// # Errors
    /// [`TickError`]: a node error. Every running leaf has been halted.
    pub fn tick_exactly_once(&mut self, now: Duration, ctx: &mut C) -> Result<Status, TickError> {
        self.run(now, ctx, 1)
    }

    /// Halts all running nodes; every node is `Idle` afterwards. `SequenceWithMemory` and `RunOnce` keep their memory.
    ///
    /// # Errors
    /// [`TickError`] from a script that runs on halting; the tree is halted nevertheless.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use zenav_behaviour_tree::{Registry, Status, build};
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sleep msec="500"/></BehaviorTree></root>"#;
    /// # let mut tree = build("wait.xml", text.as_bytes(), &Registry::<()>::new(), None, &mut |_, _| Err("no includes".into()))?;
    /// tree.tick(Duration::ZERO, &mut ())?;
    /// tree.halt(Duration::from_millis(400), &mut ())?;
    /// assert_eq!((tree.report()[0].status, tree.report()[0].last), (Status::Idle, Status::Running));
    /// // The next tick starts over: the wait lasts until 900 ms.
    /// assert_eq!(tree.tick(Duration::from_millis(400), &mut ())?, Status::Running);
    /// assert_eq!(tree.tick(Duration::from_millis(899), &mut ())?, Status::Running);
    /// assert_eq!(tree.tick(Duration::from_millis(900), &mut ())?, Status::Success);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn halt(&mut self, now: Duration, ctx: &mut C) -> Result<(), TickError> {
        let mut run = self.take_apart(now, ctx);
        run.reset(0);
        let (fault, changes) = (run.fault.take(), run.changes);
        self.changes = changes;
        match fault {
            None => Ok(()),
            Some(fault) => Err(self.tick_error(*fault)),
        }
    }

    fn run(&mut self, now: Duration, ctx: &mut C, rounds: u32) -> Result<Status, TickError> {
        let mut run = self.take_apart(now, ctx);
        let mut answer = run.exec(0);
        for _ in 1..rounds {
            let woken = std::mem::take(&mut run.wake) && matches!(answer, Ok(Status::Running));
            if !woken || run.visits > ROUND_VISITS || run.fault.is_some() {
                break;
            }
            answer = run.exec(0);
        }
        // A script that failed during a halt is also a fault of the tick.
        if run.fault.is_some() {
            answer = Err(Stop);
        }
        match answer {
            Ok(Status::Running) => {}
            Ok(_) => run.reset(0),
            Err(Stop) => run.halt_everything(),
        }
        let (fault, changes) = (run.fault.take(), run.changes);
        self.changes = changes;
        match (answer, fault) {
            (Ok(status), None) => Ok(status),
            (_, Some(fault)) => Err(self.tick_error(*fault)),
            (Err(Stop), None) => Err(TickError {
                uid: 0,
                path: self.id.clone(),
                message: "the tree is not what it was built as".to_owned(),
            }),
        }
    }

    fn take_apart<'t>(&'t mut self, now: Duration, ctx: &'t mut C) -> Run<'t, C> {
        Run {
            nodes: &self.nodes,
            infos: &self.infos,
            children: &self.children,
            states: States(&mut self.states),
            memories: &mut self.memories,
            bodies: &mut self.bodies,
            board: &mut self.board,
            ctx,
            now,
            now_ns: nanos(now),
            wake: false,
            changes: self.changes,
            visits: 0,
            fault: None,
        }
    }

    fn tick_error(&self, fault: super::tick::Fault) -> TickError {
        TickError {
            uid: (fault.node + 1) as u16,
            path: self.path(fault.node),
            message: fault.message,
        }
    }

    /// Names from the root to a node, joined by `/`.
    pub(crate) fn path(&self, node: NodeId) -> String {
        let mut names = Vec::new();
        let mut next = Some(node);
        while let Some(info) = next.and_then(|id| self.infos.get(id as usize)) {
            names.push(&*info.name);
            next = info.parent;
        }
        names.reverse();
        names.join("/")
    }
}
