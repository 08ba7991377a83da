//! Which trees measure the engine? Trees of a given size in which every node is ticked in every
//! tick, for benches.

use super::leaf::{Leaf, LeafIo};
use super::ports::PortType;
use super::registry::{NodeSpec, Registry};
use super::status::Status;
use super::tree::Tree;
use super::xml::{TreeErrors, build};

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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use std::time::Duration;

    use super::*;

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
