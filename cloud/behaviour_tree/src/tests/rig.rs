//! Test leaves that answer according to a plan and log their calls.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::{Leaf, LeafIo, NodeSpec, PortType, Registry, Status, Tree, build};

/// Log of calls: `a` started, `a.` ticked again, `a!` halted, `a~` resumed.
#[derive(Default)]
pub(super) struct World {
    pub(super) log: Vec<String>,
    calls: BTreeMap<String, usize>,
}

/// `<T name="a" plan="RRS"/>`: one letter per call, the last repeats forever. S, F, R, K (skipped), E (ends the tree with an error).
struct Planned;

impl Planned {
    fn answer(io: &mut LeafIo<'_>, world: &mut World, mark: &str) -> Status {
        world.log.push(format!("{}{mark}", io.name()));
        let plan: String = io.get("plan").unwrap();
        let call = world.calls.entry(io.name().to_owned()).or_default();
        let letter = plan.chars().nth(*call).or(plan.chars().last());
        *call += 1;
        match letter {
            Some('S') => Status::Success,
            Some('F') => Status::Failure,
            Some('K') => Status::Skipped,
            Some('E') => io.abort("as planned"),
            _ => Status::Running,
        }
    }
}

impl Leaf<World> for Planned {
    fn start(&mut self, io: &mut LeafIo<'_>, world: &mut World) -> Status {
        Self::answer(io, world, "")
    }
    fn tick(&mut self, io: &mut LeafIo<'_>, world: &mut World) -> Status {
        Self::answer(io, world, ".")
    }
    fn resume(&mut self, io: &mut LeafIo<'_>, world: &mut World) -> Status {
        Self::answer(io, world, "~")
    }
    fn halt(&mut self, io: &mut LeafIo<'_>, world: &mut World) {
        world.log.push(format!("{}!", io.name()));
    }
}

pub(super) fn registry() -> Registry<World> {
    #[cfg(feature = "nav2")]
    let mut registry = crate::nav2::controls();
    #[cfg(not(feature = "nav2"))]
    let mut registry = Registry::new();
    let planned = NodeSpec::action("T", "answers by a plan").input_or("plan", PortType::Text, "S", "answers");
    registry.leaf(planned, |_| Box::new(Planned)).unwrap();
    let peek = NodeSpec::condition("Peek", "logs a port").input("value", PortType::Any, "what to log");
    registry
        .function(peek, |io, world: &mut World| {
            let value = io.get::<String>("value").unwrap_or_else(|wrong| wrong.to_string());
            world.log.push(value);
            Status::Success
        })
        .unwrap();
    registry.name_number("RED", 1);
    registry.name_number("BLUE", 2);
    registry
}

/// A tree and its world.
pub(super) struct Rig {
    pub(super) tree: Tree<World>,
    pub(super) world: World,
    pub(super) now_ms: u64,
}

impl Rig {
    /// `body` is the content of `<BehaviorTree ID="Main">`, possibly followed by further trees.
    pub(super) fn new(body: &str) -> Rig {
        let text = format!(
            "<root BTCPP_format=\"4\" main_tree_to_execute=\"Main\"><BehaviorTree ID=\"Main\">{body}</BehaviorTree></root>"
        );
        let tree = build("test.xml", text.as_bytes(), &registry(), None, &mut |_, _| {
            Err("none".into())
        })
        .unwrap_or_else(|errors| panic!("{errors}"));
        Rig {
            tree,
            world: World::default(),
            now_ms: 0,
        }
    }

    pub(super) fn tick(&mut self) -> Status {
        self.tree
            .tick(Duration::from_millis(self.now_ms), &mut self.world)
            .unwrap()
    }

    pub(super) fn at(&mut self, now_ms: u64) -> Status {
        self.now_ms = now_ms;
        self.tick()
    }

    /// Answers of ticks 10 ms apart, as letters.
    pub(super) fn ticks(&mut self, count: usize) -> String {
        (0..count)
            .map(|_| {
                let status = self.tick();
                self.now_ms += 10;
                match status {
                    Status::Success => 'S',
                    Status::Failure => 'F',
                    Status::Skipped => 'K',
                    Status::Running => 'R',
                    Status::Idle => 'I',
                }
            })
            .collect()
    }

    pub(super) fn halt(&mut self) {
        self.tree
            .halt(Duration::from_millis(self.now_ms), &mut self.world)
            .unwrap();
    }

    /// Log entries since the last call.
    pub(super) fn log(&mut self) -> String {
        std::mem::take(&mut self.world.log).join(" ")
    }

    pub(super) fn error(&mut self) -> String {
        let tick = self.tree.tick(Duration::from_millis(self.now_ms), &mut self.world);
        tick.unwrap_err().to_string()
    }
}

/// The answers of this many ticks, and the log.
pub(super) fn play(body: &str, ticks: usize) -> (String, String) {
    let mut rig = Rig::new(body);
    let answers = rig.ticks(ticks);
    (answers, rig.log())
}

/// Compares with the expected answers and log.
#[track_caller]
pub(super) fn plays(body: &str, answers: &str, log: &str) {
    let (got_answers, got_log) = play(body, answers.len());
    assert_eq!((got_answers.as_str(), got_log.as_str()), (answers, log), "{body}");
}
