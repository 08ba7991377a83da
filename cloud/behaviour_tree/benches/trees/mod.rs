//! Trees for benchmarks of the engine.

use zenav_behaviour_tree::{Leaf, LeafIo, NodeSpec, PortType, Registry, Status, Tree, TreeErrors, build};

/// Reads a port and adds it to the context.
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

/// A tree of `nodes` nodes (at least 10), all visited in every tick: reactive branches of conditions, inverters and external leaves that
/// read a port, and an action that runs forever. Its context counts the leaves' ticks.
///
/// # Errors
/// More nodes than a tree may have.
pub fn reactive_tree(nodes: usize) -> Result<Tree<u64>, TreeErrors> {
    let mut registry = Registry::new();
    let spec = NodeSpec::condition("Add", "Adds to the context.");
    let added = registry.leaf(spec.input("step", PortType::Unsigned, "by how much"), |_| Box::new(Add));
    assert!(added.is_ok(), "{added:?}");
    // Root and last leaf, then branches of six nodes, then single leaves.
    let rest = nodes.saturating_sub(2);
    let branch = "<ReactiveFallback><Inverter><Add step=\"1\"/></Inverter><Sequence><Add step=\"{@step}\"/><AlwaysSuccess/></Sequence></ReactiveFallback>";
    let branches = branch.repeat(rest / 6);
    let singles = "<Add step=\"1\"/>".repeat(rest % 6);
    let text = format!(
        "<root BTCPP_format=\"4\"><BehaviorTree ID=\"Sample\"><ReactiveSequence>{branches}{singles}\
         <KeepRunningUntilFailure><AlwaysSuccess/></KeepRunningUntilFailure></ReactiveSequence></BehaviorTree></root>"
    );
    let none = &mut |_: &str, _: &str| Err("there are no other files".into());
    let mut tree = build("sample", text.as_bytes(), &registry, None, none)?;
    let set = tree.blackboard_mut().set("step", 1_i64);
    assert!(set.is_ok(), "{set:?}");
    Ok(tree)
}
