//! Built-in nodes. Which nodes need no registration, and how is each constructed?
//!
//! One row per node, with specification and constructor; the behaviour of a node is described at its type, in the file of its family.
//! Names, ports and defaults are those of BehaviorTree.CPP 4.10; Nav2's nodes are in `nav2`.
//!
//! **A new control or decorator**: a type that implements [`Builtin`] in its family's file, and a row here.

mod branches;
mod decorators;
mod leaves;
mod loops;
mod parallel;
mod reactive;
mod sequences;
mod timing;
mod updates;

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::blackboard::Slot;
use crate::node::{NodeId, NodeState};
use crate::ports::{PortType, Source};
use crate::registry::NodeSpec;
use crate::script::Program;
use crate::status::Status;
use crate::tick::{Answer, Run};
use crate::value::ValueType;

pub(crate) use decorators::SubTree;
pub(crate) use leaves::Always;

use PortType::{Any, Bool, Double, Int, Key, Script, Text, Unsigned};

/// A built-in node. Fixed when the tree is built; its run-time state is its [`NodeState`], whose counters have the meaning given in the
/// type's documentation.
pub(crate) trait Builtin<C>: Send {
    /// One tick. `before` is its status as its parent left it: anything but `Running` makes this an activation.
    fn tick(&self, run: &mut Run<'_, C>, id: NodeId, before: Status) -> Answer;

    /// Called when it is halted while `Running`, before its children are halted.
    fn before_halt(&self, _run: &mut Run<'_, C>, _id: NodeId) {}

    /// What remains of its state after a halt, once its children are halted. Nothing, unless overridden.
    fn after_halt(&self, state: &mut NodeState) {
        state.clear();
    }

    /// Called when its parent resets it while it has a `count`, running or not. The count is kept, unless overridden.
    fn on_reset(&self, _state: &mut NodeState) {}

    /// The entries for requests to pause and resume, if the node supports them.
    fn pause_entries(&self) -> Option<PauseEntries> {
        None
    }
}

/// Entries of the root blackboard; any write to one is a request.
#[derive(Clone, Copy)]
pub(crate) struct PauseEntries {
    pub(crate) pause: Slot,
    pub(crate) resume: Slot,
}

/// The tree builder's interface for constructing a node: its ports in the scope of its use.
pub(crate) trait Ports {
    /// The binding of a port.
    fn source(&mut self, port: &str) -> Source;
    /// The bindings of all ports whose names have this prefix, in the order of the specification.
    fn sources(&mut self, prefix: &str) -> Vec<Source>;
    /// The type of a port's value.
    fn value_type(&self, port: &str) -> ValueType;
    /// The entry named by a port of type [`PortType::Key`].
    fn slot(&mut self, port: &str) -> Slot;
    /// The entry of the root blackboard named by the text on a port.
    #[cfg(feature = "nav2")]
    fn root_slot(&mut self, port: &str) -> Slot;
    /// The script on a port of type [`PortType::Script`].
    fn program(&mut self, port: &str) -> Program;
    /// Numbers by name.
    fn enums(&self) -> Arc<BTreeMap<String, i64>>;
}

/// Constructor of a built-in node from its ports.
pub(crate) type MakeBuiltin<C> = fn(&mut dyn Ports) -> Box<dyn Builtin<C>>;

/// A built-in node: its specification and constructor.
pub(crate) type Row<C> = (NodeSpec, MakeBuiltin<C>);

/// Rows of the table: `specification => node;`, where the node is constructed from its `ports`.
macro_rules! table {
    ($ports:ident: $($spec:expr => $node:expr;)*) => {
        vec![$({
            let make: $crate::nodes::MakeBuiltin<C> = |$ports| {
                let _ = &$ports;
                Box::new($node)
            };
            ($spec, make)
        },)*]
    };
}
#[cfg(feature = "nav2")]
pub(crate) use table;

/// A control node with at least one child.
pub(crate) fn control(id: &str, doc: &str) -> NodeSpec {
    NodeSpec::control(id, doc, 1, usize::MAX)
}

fn decorator(id: &str, doc: &str) -> NodeSpec {
    NodeSpec::decorator(id, doc)
}

/// BehaviorTree.CPP's nodes, and py_trees' `ParallelAny`.
pub(crate) fn rows<C>() -> Vec<Row<C>> {
    use branches::{IfThenElse, Switch, TryCatch, WhileDoElse};
    use decorators::{Again, Force, Inverter, KeepRunningUntilFailure, Precondition, RunOnce};
    use leaves::{RunScript, ScriptCondition, SetBlackboard, UnsetBlackboard};
    use loops::LoopOver;
    use parallel::{Parallel, ParallelAll, ParallelAny};
    use reactive::Reactive;
    use sequences::InOrder;
    use timing::{Delay, Sleep, Timeout};
    use updates::{IfUpdated, WasEntryUpdated};

    let mut rows = table! { ports:
        // Controls.
        control("Sequence", "Ticks children in order until one fails; resumes at the running child.") => InOrder::SEQUENCE;
        control("AsyncSequence", "A Sequence that yields after each child.") => InOrder { yields: true, ..InOrder::SEQUENCE };
        control("SequenceWithMemory", "A Sequence that retries the failed child.") => InOrder::WITH_MEMORY;
        control("SequenceStar", "Former name of SequenceWithMemory.") => InOrder::WITH_MEMORY;
        control("ReactiveSequence", "A Sequence that starts from the first child in every tick.") => Reactive { end: Status::Failure };
        control("Fallback", "Ticks children in order until one succeeds; resumes at the running child.") => InOrder::FALLBACK;
        control("AsyncFallback", "A Fallback that yields after each child.") => InOrder { yields: true, ..InOrder::FALLBACK };
        control("ReactiveFallback", "A Fallback that starts from the first child in every tick.") => Reactive { end: Status::Success };
        control("Parallel", "Ticks all children until enough have succeeded or failed.")
            .input_or("success_count", Int, "-1", "successes that end it; -1: all")
            .input_or("failure_count", Int, "1", "failures that end it; -1: all")
            => Parallel { success_count: ports.source("success_count"), failure_count: ports.source("failure_count") };
        control("ParallelAll", "Ticks all children, each to its end.")
            .input_or("max_failures", Int, "1", "failures that make it fail; -1: all")
            => ParallelAll { max_failures: ports.source("max_failures") };
        control("ParallelAny", "Ticks all children until one succeeds or fails (py_trees).") => ParallelAny;
        NodeSpec::control("IfThenElse", "Ticks child 1 once, then runs child 2 or 3.", 2, 3) => IfThenElse;
        NodeSpec::control("WhileDoElse", "Ticks child 1 in every tick and runs child 2 or 3.", 2, 3) => WhileDoElse;
        NodeSpec::control("TryCatch", "A Sequence whose last child cleans up after a failure.", 2, usize::MAX)
            .input_or("catch_on_halt", Bool, "false", "clean up after a halt too")
            => TryCatch { catch_on_halt: ports.source("catch_on_halt") };
        // Decorators.
        decorator("Inverter", "Swaps SUCCESS and FAILURE.") => Inverter;
        decorator("ForceSuccess", "SUCCESS whatever the child ends with.") => Force(Status::Success);
        decorator("ForceFailure", "FAILURE whatever the child ends with.") => Force(Status::Failure);
        decorator("RetryUntilSuccessful", "Retries until the child succeeds.")
            .input("num_attempts", Int, "attempts in all; -1: unlimited")
            => Again { status: Status::Failure, port: "num_attempts", limit: ports.source("num_attempts") };
        decorator("Repeat", "Repeats while the child succeeds.").input("num_cycles", Int, "cycles; -1: unlimited")
            => Again { status: Status::Success, port: "num_cycles", limit: ports.source("num_cycles") };
        decorator("KeepRunningUntilFailure", "RUNNING until the child fails.") => KeepRunningUntilFailure;
        decorator("Timeout", "FAILURE if the child takes longer.").input("msec", Unsigned, "time for the child, ms; 0: unlimited")
            => Timeout(ports.source("msec"));
        decorator("Delay", "Waits before the child.").input("delay_msec", Unsigned, "wait, ms") => Delay(ports.source("delay_msec"));
        decorator("RunOnce", "Runs the child once in the life of the tree.")
            .input_or("then_skip", Bool, "true", "afterwards SKIPPED, not the same status again")
            => RunOnce { then_skip: ports.source("then_skip") };
        decorator("Precondition", "Runs the child if a script is true.")
            .input("if", Script, "condition")
            .input_or("else", PortType::Status, "FAILURE", "status if the condition is false")
            => Precondition { condition: ports.program("if"), otherwise: ports.source("else") };
        decorator("SkipUnlessUpdated", "SKIPPED unless the entry has been written.").input("entry", Key, "entry to watch")
            => IfUpdated { slot: ports.slot("entry"), otherwise: Status::Skipped };
        decorator("WaitValueUpdate", "RUNNING unless the entry has been written.").input("entry", Key, "entry to watch")
            => IfUpdated { slot: ports.slot("entry"), otherwise: Status::Running };
        // Leaves.
        NodeSpec::action("AlwaysSuccess", "SUCCESS.") => Always(Status::Success);
        NodeSpec::action("AlwaysFailure", "FAILURE.") => Always(Status::Failure);
        NodeSpec::action("Sleep", "Waits.").input("msec", Unsigned, "wait, ms") => Sleep(ports.source("msec"));
        NodeSpec::action("SetBlackboard", "Writes an entry.")
            .input("value", Any, "literal or entry to copy")
            .inout("output_key", Key, "entry to write")
            => SetBlackboard { value: ports.source("value"), slot: ports.slot("output_key") };
        NodeSpec::action("UnsetBlackboard", "Removes an entry.").input("key", Key, "entry to remove")
            => UnsetBlackboard(ports.slot("key"));
        NodeSpec::action("Script", "Runs a script.").input("code", Script, "script") => RunScript(ports.program("code"));
        NodeSpec::condition("ScriptCondition", "SUCCESS if a script is true.").input("code", Script, "condition")
            => ScriptCondition(ports.program("code"));
        NodeSpec::action("WasEntryUpdated", "SUCCESS if the entry has been written since the last tick.")
            .input("entry", Key, "entry to watch")
            => WasEntryUpdated(ports.slot("entry"));
    };
    for cases in 2..=6 {
        let doc = "Runs the child whose case equals the variable, else the last.";
        let spec = NodeSpec::control(&format!("Switch{cases}"), doc, cases + 1, cases + 1);
        let spec = (1..=cases).fold(spec.input("variable", Text, "value to compare"), |spec, case| {
            spec.input(&format!("case_{case}"), Text, "value that selects this child")
        });
        rows.extend(table! { ports:
            spec => Switch { variable: ports.source("variable"), cases: ports.sources("case_"), enums: ports.enums() };
        });
    }
    for (id, item) in [
        ("LoopInt", Int),
        ("LoopBool", Bool),
        ("LoopDouble", Double),
        ("LoopString", Text),
    ] {
        let queue = PortType::List(item.value_type().unwrap_or(ValueType::Text));
        let spec = decorator(id, "Runs the child once for each item of a list.")
            .inout("queue", queue, "the list: 1;2;3, or an entry that is consumed")
            .input_or("if_empty", PortType::Status, "SUCCESS", "status when no item is left")
            .output("value", item, "the current item");
        rows.extend(table! { ports:
            spec => LoopOver {
                queue: ports.source("queue"),
                value: ports.source("value"),
                if_empty: ports.source("if_empty"),
                item: ports.value_type("value"),
            };
        });
    }
    rows
}
