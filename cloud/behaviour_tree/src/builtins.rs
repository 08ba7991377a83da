//! Which nodes need no registration? One table: id, ports, children, and what each becomes.
//!
//! Names, ports and defaults are BehaviorTree.CPP's 4.10 and Nav2's 1.5.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use super::blackboard::Slot;
use super::node::{Cases, Kind, Latch, Queue, Rounds, Thresholds};
use super::ports::{PortType, Source};
use super::registry::{Category, NodeSpec};
use super::script::Program;
use super::status::Status;
use super::value::ValueType;

use PortType::{Any, Bool, Int, Key, Positive, Script, Text, Unsigned};

/// Every built-in node by its id.
pub(crate) fn specs() -> &'static BTreeMap<String, NodeSpec> {
    static SPECS: LazyLock<BTreeMap<String, NodeSpec>> = LazyLock::new(|| {
        controls()
            .into_iter()
            .chain(decorators())
            .chain(nav2())
            .chain(leaves())
            .map(|spec| (spec.id.clone(), spec))
            .collect()
    });
    &SPECS
}

/// The built-in node of that id.
pub(crate) fn spec(id: &str) -> Option<&'static NodeSpec> {
    specs().get(id)
}

fn controls() -> Vec<NodeSpec> {
    const MANY: usize = usize::MAX;
    let control = NodeSpec::control;
    let mut specs = vec![
        control(
            "Sequence",
            "Children in order until one fails; resumes where it was.",
            1,
            MANY,
        ),
        control("AsyncSequence", "A Sequence that yields after each child.", 1, MANY),
        control(
            "SequenceWithMemory",
            "A Sequence that tries the failed child again.",
            1,
            MANY,
        ),
        control("SequenceStar", "Other name of SequenceWithMemory.", 1, MANY),
        control(
            "ReactiveSequence",
            "A Sequence that asks from the first child in every tick.",
            1,
            MANY,
        ),
        control(
            "Fallback",
            "Children in order until one succeeds; resumes where it was.",
            1,
            MANY,
        ),
        control("AsyncFallback", "A Fallback that yields after each child.", 1, MANY),
        control(
            "ReactiveFallback",
            "A Fallback that asks from the first child in every tick.",
            1,
            MANY,
        ),
        control(
            "Parallel",
            "All children at once, until enough have succeeded or failed.",
            1,
            MANY,
        )
        .input_or("success_count", Int, "-1", "children that must succeed; -1: all")
        .input_or("failure_count", Int, "1", "children that must fail; -1: all"),
        control("ParallelAll", "All children at once, each to its end.", 1, MANY).input_or(
            "max_failures",
            Int,
            "1",
            "failures that make it fail; -1: all",
        ),
        control(
            "ParallelAny",
            "All children at once, until one succeeds or fails (py_trees).",
            1,
            MANY,
        ),
        control("IfThenElse", "Asks child 1 once, then runs child 2 or 3.", 2, 3),
        control("WhileDoElse", "Asks child 1 in every tick and runs child 2 or 3.", 2, 3),
        control(
            "TryCatch",
            "A Sequence whose last child cleans up after a failure.",
            2,
            MANY,
        )
        .input_or("catch_on_halt", Bool, "false", "clean up after a halt too"),
    ];
    for cases in 2..=6 {
        let mut spec = control(
            &format!("Switch{cases}"),
            "Runs the child whose case equals the variable, else the last.",
            cases + 1,
            cases + 1,
        )
        .input("variable", Text, "what to compare");
        for case in 1..=cases {
            spec = spec.input(&format!("case_{case}"), Text, "value that selects this child");
        }
        specs.push(spec);
    }
    specs
}

fn decorators() -> Vec<NodeSpec> {
    let decorator = NodeSpec::decorator;
    let mut specs = vec![
        decorator("Inverter", "SUCCESS for FAILURE and the other way round."),
        decorator("ForceSuccess", "SUCCESS whatever the child ends with."),
        decorator("ForceFailure", "FAILURE whatever the child ends with."),
        decorator("RetryUntilSuccessful", "Tries again until the child succeeds.").input(
            "num_attempts",
            Int,
            "attempts in all; -1: for ever",
        ),
        decorator("Repeat", "Repeats while the child succeeds.").input("num_cycles", Int, "cycles; -1: for ever"),
        decorator("KeepRunningUntilFailure", "RUNNING until the child fails."),
        decorator("Timeout", "FAILURE if the child takes longer.").input(
            "msec",
            Unsigned,
            "time for the child, ms; 0: unlimited",
        ),
        decorator("Delay", "Waits before the child.").input("delay_msec", Unsigned, "wait, ms"),
        decorator("RunOnce", "Runs the child once in the life of the tree.").input_or(
            "then_skip",
            Bool,
            "true",
            "afterwards SKIPPED, not the same answer again",
        ),
        decorator("Precondition", "Runs the child if a script holds.")
            .input("if", Script, "condition")
            .input_or("else", PortType::Status, "FAILURE", "answer if it does not hold"),
        decorator("SkipUnlessUpdated", "SKIPPED unless the entry has been written.").input(
            "entry",
            Key,
            "entry to watch",
        ),
        decorator("WaitValueUpdate", "RUNNING unless the entry has been written.").input(
            "entry",
            Key,
            "entry to watch",
        ),
    ];
    for (id, item) in [
        ("LoopInt", Int),
        ("LoopBool", Bool),
        ("LoopDouble", PortType::Double),
        ("LoopString", Text),
    ] {
        let queue = PortType::List(item.value_type().unwrap_or(ValueType::Text));
        specs.push(
            decorator(id, "Runs the child once for each item of a list.")
                .inout("queue", queue, "the list: 1;2;3, or an entry that is consumed")
                .input_or("if_empty", PortType::Status, "SUCCESS", "answer when no item is left")
                .output("value", item, "the current item"),
        );
    }
    specs
}

fn nav2() -> Vec<NodeSpec> {
    vec![
        NodeSpec::control(
            "PipelineSequence",
            "A Sequence that ticks earlier children again while later ones run.",
            1,
            usize::MAX,
        ),
        NodeSpec::control(
            "RecoveryNode",
            "Child 1; when it fails, child 2 and child 1 again.",
            2,
            2,
        )
        .input_or("number_of_retries", Unsigned, "1", "how often child 2 may mend"),
        NodeSpec::control("RoundRobin", "One child an activation, in turn.", 1, usize::MAX)
            .input_or(
                "wrap_around",
                Bool,
                "false",
                "after the last child comes the first again",
            )
            .input_or(
                "last_may_succeed",
                Bool,
                "false",
                "without wrap_around, let success of the last child count (Nav2 makes it a failure)",
            ),
        NodeSpec::control(
            "NonblockingSequence",
            "A Sequence that ticks every child in every tick.",
            1,
            usize::MAX,
        ),
        NodeSpec::control(
            "PersistentSequence",
            "A Sequence whose index is a blackboard entry.",
            1,
            usize::MAX,
        )
        .inout("current_child_idx", Int, "index of the current child"),
        NodeSpec::control(
            "PauseResumeController",
            "Child 1 while not paused, 2 while paused; 3 on pausing, 4 on going on.",
            1,
            4,
        )
        .input_or(
            "pause_service_name",
            Text,
            "pause",
            "entry of the root blackboard: written, it asks to pause",
        )
        .input_or(
            "resume_service_name",
            Text,
            "resume",
            "entry of the root blackboard: written, it asks to go on",
        ),
        NodeSpec::decorator("RateController", "Ticks the child at a rate.").input_or(
            "hz",
            Positive,
            "10.0",
            "rate, 1/s",
        ),
        NodeSpec::decorator("SingleTrigger", "Runs the child once an activation."),
    ]
}

fn leaves() -> Vec<NodeSpec> {
    vec![
        NodeSpec::action("AlwaysSuccess", "SUCCESS."),
        NodeSpec::action("AlwaysFailure", "FAILURE."),
        NodeSpec::action("Sleep", "Waits.").input("msec", Unsigned, "wait, ms"),
        NodeSpec::action("SetBlackboard", "Writes an entry.")
            .input("value", Any, "literal or entry to copy")
            .inout("output_key", Key, "entry to write"),
        NodeSpec::action("UnsetBlackboard", "Forgets an entry.").input("key", Key, "entry to forget"),
        NodeSpec::action("Script", "Runs a script.").input("code", Script, "script"),
        NodeSpec::condition("ScriptCondition", "SUCCESS if a script holds.").input("code", Script, "condition"),
        NodeSpec::action("WasEntryUpdated", "SUCCESS if the entry has been written since.").input(
            "entry",
            Key,
            "entry to watch",
        ),
    ]
}

/// What the tree builder offers to make a node from: its ports in the scope where it stands.
pub(crate) trait Ports {
    /// What is on a port.
    fn source(&mut self, port: &str) -> Source;
    /// The entry that a port of type [`PortType::Key`] names.
    fn slot(&mut self, port: &str) -> Slot;
    /// The entry of the root blackboard that the text on a port names.
    fn root_slot(&mut self, port: &str) -> Slot;
    /// The script on a port of type [`PortType::Script`].
    fn program(&mut self, port: &str) -> Program;
    /// Names of numbers.
    fn enums(&self) -> Arc<BTreeMap<String, i64>>;
}

/// The built-in node of that id with these ports; `None` if there is none.
pub(crate) fn kind(id: &str, ports: &mut dyn Ports) -> Option<Kind> {
    Some(match id {
        "AlwaysSuccess" => Kind::AlwaysSuccess,
        "AlwaysFailure" => Kind::AlwaysFailure,
        "Sleep" => Kind::Sleep(ports.source("msec")),
        "SetBlackboard" => Kind::SetBlackboard {
            value: ports.source("value"),
            slot: ports.slot("output_key"),
        },
        "UnsetBlackboard" => Kind::UnsetBlackboard(ports.slot("key")),
        "Script" => Kind::Script(ports.program("code")),
        "ScriptCondition" => Kind::ScriptCondition(ports.program("code")),
        "WasEntryUpdated" => Kind::WasEntryUpdated(ports.slot("entry")),
        "Sequence" => Kind::Sequence { yields: false },
        "AsyncSequence" => Kind::Sequence { yields: true },
        "SequenceWithMemory" | "SequenceStar" => Kind::SequenceWithMemory,
        "Fallback" => Kind::Fallback { yields: false },
        "AsyncFallback" => Kind::Fallback { yields: true },
        "ReactiveSequence" => Kind::ReactiveSequence,
        "ReactiveFallback" => Kind::ReactiveFallback,
        "Parallel" => Kind::Parallel(Box::new(Thresholds {
            success: ports.source("success_count"),
            failure: ports.source("failure_count"),
        })),
        "ParallelAll" => Kind::ParallelAll(ports.source("max_failures")),
        "ParallelAny" => Kind::ParallelAny,
        "IfThenElse" => Kind::IfThenElse,
        "WhileDoElse" => Kind::WhileDoElse,
        "TryCatch" => Kind::TryCatch {
            catch_on_halt: ports.source("catch_on_halt"),
        },
        "Switch2" | "Switch3" | "Switch4" | "Switch5" | "Switch6" => {
            let count = id.as_bytes().last().map_or(0, |digit| usize::from(digit - b'0'));
            Kind::Switch(Box::new(Cases {
                variable: ports.source("variable"),
                cases: (1..=count).map(|case| ports.source(&format!("case_{case}"))).collect(),
                enums: ports.enums(),
            }))
        }
        "Inverter" => Kind::Inverter,
        "ForceSuccess" => Kind::ForceSuccess,
        "ForceFailure" => Kind::ForceFailure,
        "RetryUntilSuccessful" => Kind::Retry(ports.source("num_attempts")),
        "Repeat" => Kind::Repeat(ports.source("num_cycles")),
        "KeepRunningUntilFailure" => Kind::KeepRunningUntilFailure,
        "Timeout" => Kind::Timeout(ports.source("msec")),
        "Delay" => Kind::Delay(ports.source("delay_msec")),
        "RunOnce" => Kind::RunOnce {
            then_skip: ports.source("then_skip"),
        },
        "Precondition" => Kind::Precondition(Box::new(Latch {
            condition: ports.program("if"),
            otherwise: ports.source("else"),
        })),
        "SkipUnlessUpdated" => Kind::IfUpdated {
            slot: ports.slot("entry"),
            otherwise: Status::Skipped,
        },
        "WaitValueUpdate" => Kind::IfUpdated {
            slot: ports.slot("entry"),
            otherwise: Status::Running,
        },
        "LoopInt" | "LoopBool" | "LoopDouble" | "LoopString" => Kind::Loop(Box::new(Queue {
            queue: ports.source("queue"),
            value: ports.source("value"),
            if_empty: ports.source("if_empty"),
            item: match id {
                "LoopInt" => ValueType::Int,
                "LoopBool" => ValueType::Bool,
                "LoopDouble" => ValueType::Double,
                _ => ValueType::Text,
            },
        })),
        "PipelineSequence" => Kind::PipelineSequence,
        "RecoveryNode" => Kind::RecoveryNode(ports.source("number_of_retries")),
        "RoundRobin" => Kind::RoundRobin(Box::new(Rounds {
            wrap_around: ports.source("wrap_around"),
            last_may_succeed: ports.source("last_may_succeed"),
        })),
        "NonblockingSequence" => Kind::NonblockingSequence,
        "PersistentSequence" => Kind::PersistentSequence(ports.source("current_child_idx")),
        "RateController" => Kind::RateController(ports.source("hz")),
        "SingleTrigger" => Kind::SingleTrigger,
        "PauseResumeController" => Kind::PauseResume {
            pause: ports.root_slot("pause_service_name"),
            resume: ports.root_slot("resume_service_name"),
        },
        _ => return None,
    })
}

/// The specification of a SubTree node: its ports are the names that it remaps.
pub(crate) fn subtree(id: &str) -> NodeSpec {
    NodeSpec {
        open: true,
        ..NodeSpec::new(Category::SubTree, id, "Another tree, with its own blackboard.")
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "tests")]
    use super::*;
    use crate::blackboard::Blackboard;

    struct Blank(Blackboard);

    impl Ports for Blank {
        fn source(&mut self, _: &str) -> Source {
            Source::Unset
        }
        fn slot(&mut self, port: &str) -> Slot {
            self.0.resolve(0, port)
        }
        fn root_slot(&mut self, port: &str) -> Slot {
            self.slot(port)
        }
        fn program(&mut self, _: &str) -> Program {
            Program::bind("", Vec::new(), &Arc::default(), &mut |name| self.0.resolve(0, name))
        }
        fn enums(&self) -> Arc<BTreeMap<String, i64>> {
            Arc::default()
        }
    }

    #[test]
    fn every_specified_node_exists() {
        let mut ports = Blank(Blackboard::default());
        for id in specs().keys() {
            kind(id, &mut ports).expect(id);
        }
    }

    #[test]
    fn every_default_is_a_value_of_its_port() {
        for spec in specs().values() {
            for port in &spec.ports {
                if let Some(default) = &port.default {
                    assert!(port.kind.parse(default).is_some(), "{} {}", spec.id, port.name);
                }
            }
        }
    }
}
