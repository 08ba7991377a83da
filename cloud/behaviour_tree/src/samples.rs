//! Which trees measure and try the engine? Trees of a given size in which every node is ticked in
//! every tick, for benches; and whatever bytes a fuzzer makes up.

use super::leaf::{Leaf, LeafIo};
use super::ports::PortType;
use super::registry::{NodeSpec, Registry};
use super::status::Status;
use std::time::Duration;

use super::simulate::{Script, Simulation, registry};
use super::tree::Tree;
use super::xml::{Limits, TreeErrors, build, check};

/// Ticks of a tree that is tried.
const TICKS: u64 = 50;

/// A leaf that reads a port and adds it to the context.
struct Add;

impl Leaf<u64> for Add {
    fn start(&mut self, io: &mut LeafIo<'_>, total: &mut u64) -> Status {
        match io.get::<u64>("step") {
            Ok(step) => {
                *total = total.wrapping_add(step);
                Status::Success
            }
            Err(wrong) => io.fail(wrong.to_string()),
        }
    }
}

/// A tree of `nodes` nodes (at least 10), all of which every tick visits: reactive branches of
/// conditions, inverters and leaves from outside that read a port, and an action that runs for
/// ever. Its context counts the leaves' ticks.
///
/// # Errors
/// More nodes than a tree may have.
pub fn reactive_tree(nodes: usize) -> Result<Tree<u64>, TreeErrors> {
    let mut registry = Registry::new();
    let spec = NodeSpec::condition("Add", "Adds to the context.");
    let added = registry.leaf(spec.input("step", PortType::Unsigned, "by how much"), |_| Box::new(Add));
    debug_assert!(added.is_ok(), "{added:?}");
    // Root and last leaf, then branches of seven nodes, then single leaves.
    let rest = nodes.saturating_sub(2);
    let branch = "<ReactiveFallback><Inverter><Add step=\"1\"/></Inverter><Sequence><Add step=\"{@step}\"/><AlwaysSuccess/></Sequence></ReactiveFallback>";
    let branches = branch.repeat(rest / 6);
    let singles = "<Add step=\"1\"/>".repeat(rest % 6);
    let text = format!(
        "<root BTCPP_format=\"4\"><BehaviorTree ID=\"Sample\"><ReactiveSequence>{branches}{singles}\
         <KeepRunningUntilFailure><AlwaysSuccess/></KeepRunningUntilFailure></ReactiveSequence></BehaviorTree></root>"
    );
    let mut tree = build("sample", text.as_bytes(), &registry, None, &mut |_, _| {
        Err("none".into())
    })?;
    let set = tree.blackboard_mut().set("step", 1_i64);
    debug_assert!(set.is_ok(), "{set:?}");
    Ok(tree)
}

/// Tries bytes as a tree file: reads and checks them, and if they are a tree, ticks it against
/// leaves that succeed, stores it half-way, goes on with what was stored, and halts it.
///
/// Whatever the bytes are, it comes back, soon, and without a panic.
///
/// # Errors
/// Everything that is wrong with the file.
pub fn exercise(bytes: &[u8]) -> Result<Status, TreeErrors> {
    let registry = registry();
    let none = &mut |_: &str, _: &str| Err("there are no other files".to_owned());
    check("fuzz.xml", bytes, &registry, none, Limits::default())?;
    let mut tree = build("fuzz.xml", bytes, &registry, None, none)?;
    let mut simulation = Simulation::new(Script::default());
    let mut status = Status::Idle;
    for tick in 0..TICKS {
        let now = Duration::from_millis(10 * tick);
        // A tree in error has been halted, and starts anew.
        status = tree.tick(now, &mut simulation).unwrap_or(Status::Failure);
        if tick == TICKS / 2 {
            let stored = tree.snapshot();
            let restored = tree.restore(stored);
            debug_assert!(restored.is_ok(), "{restored:?}");
        }
    }
    let _ = tree.halt(Duration::from_secs(1), &mut simulation);
    debug_assert!(tree.iter().all(|node| node.status == Status::Idle));
    debug_assert!(!tree.render().is_empty());
    Ok(status)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use proptest::prelude::*;

    use super::*;

    /// The files that the fuzzer begins with.
    fn corpus() -> Vec<(String, Vec<u8>)> {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fuzz/corpus/tree");
        let mut files: Vec<(String, Vec<u8>)> = std::fs::read_dir(folder)
            .unwrap()
            .map(|file| file.unwrap())
            .map(|file| {
                (
                    file.file_name().to_string_lossy().into_owned(),
                    std::fs::read(file.path()).unwrap(),
                )
            })
            .collect();
        files.sort();
        files
    }

    #[test]
    fn every_file_of_the_corpus_is_run_or_refused() {
        let files = corpus();
        assert!(files.len() > 40);
        for (name, bytes) in files {
            let ran = exercise(&bytes);
            let refused = name.starts_with("bad_");
            let missing = name == "include.xml";
            assert_eq!(ran.is_err(), refused || missing, "{name}: {ran:?}");
        }
    }

    proptest! {
        /// What the fuzzer does without its compiler: pieces of the corpus in another order.
        #[test]
        fn cut_and_joined_files_are_run_or_refused(
            files in prop::collection::vec((any::<prop::sample::Index>(), 0.0..1.0, 0.0..1.0), 1..4),
            noise in prop::collection::vec((0.0..1.0, any::<u8>()), 0..4),
        ) {
            let corpus = corpus();
            let mut bytes = Vec::new();
            for (file, from, to) in files {
                let (_, text) = file.get(&corpus);
                let at = |share: f64| (share * text.len() as f64) as usize;
                let (from, to): (usize, usize) = (at(f64::min(from, to)), at(f64::max(from, to)));
                bytes.extend_from_slice(&text[from..to]);
            }
            for (place, byte) in noise {
                let at = (place * bytes.len() as f64) as usize;
                if let Some(changed) = bytes.get_mut(at) {
                    *changed = byte;
                }
            }
            let _ = exercise(&bytes);
        }
    }

    #[test]
    fn every_tick_visits_every_node() {
        for nodes in [10, 30, 1000] {
            let mut tree = reactive_tree(nodes).unwrap();
            assert!(tree.len().abs_diff(nodes) <= 1, "{} {nodes}", tree.len());
            for tick in 1..4 {
                assert_eq!(tree.tick(Duration::ZERO, &mut 0), Ok(Status::Running));
                assert!(
                    tree.iter()
                        .all(|node| node.starts == tick || node.status == Status::Running)
                );
            }
        }
    }
}
