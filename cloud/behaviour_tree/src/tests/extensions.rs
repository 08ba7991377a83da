//! Tests of external leaves and decorators.

use std::time::Duration;

use crate::{
    Category, Decorator, DuplicateNode, Enter, Leaf, LeafIo, NodeSpec, PortError, PortType, Registry, Status, Tree,
    Value, build,
};

/// Distance driven by the robot, m.
type Metres = f64;

/// Ticks its child on activation and after every metre.
struct EveryMetre;

impl Decorator<Metres> for EveryMetre {
    fn enter(&mut self, io: &mut LeafIo<'_>, way: &mut Metres, child: Status) -> Enter {
        let due = io.recall::<f64>().is_none_or(|last| *way - last >= 1.0);
        if due || child == Status::Running {
            Enter::TickChild
        } else {
            Enter::Answer(Status::Running)
        }
    }
    fn leave(&mut self, io: &mut LeafIo<'_>, way: &mut Metres, child: Status) -> Status {
        if child == Status::Success {
            io.remember(way).unwrap();
        }
        child
    }
}

fn make(registry: &Registry<Metres>, body: &str) -> Tree<Metres> {
    let text = format!("<root><BehaviorTree ID=\"M\">{body}</BehaviorTree></root>");
    build("m.xml", text.as_bytes(), registry, None, &mut |_, _| Err("none".into())).unwrap()
}

#[test]
fn a_decorator_from_outside_decides_when_its_child_is_ticked() {
    let mut registry = Registry::new();
    registry
        .decorator(NodeSpec::decorator("EveryMetre", ""), |_| Box::new(EveryMetre))
        .unwrap();
    let body = "<ReactiveSequence><EveryMetre><AlwaysSuccess name=\"plan\"/></EveryMetre><KeepRunningUntilFailure><AlwaysSuccess/></KeepRunningUntilFailure></ReactiveSequence>";
    let mut tree = make(&registry, body);
    let planned = |tree: &Tree<Metres>| tree.iter().find(|node| node.name == "plan").unwrap().starts;
    for (way, plans) in [(0.0, 1), (0.5, 1), (1.0, 2), (1.9, 2), (2.1, 3)] {
        tree.tick(Duration::ZERO, &mut way.clone()).unwrap();
        assert_eq!(planned(&tree), plans, "{way}");
    }
    // Its memory is part of the snapshot.
    let mut fresh = make(&registry, body);
    fresh.restore(tree.snapshot()).unwrap();
    fresh.tick(Duration::ZERO, &mut 2.2).unwrap();
    assert_eq!(planned(&fresh), 3);
}

struct Abort;

impl Leaf<Metres> for Abort {
    fn start(&mut self, _: &mut LeafIo<'_>, _: &mut Metres) -> Status {
        Status::Running
    }
    fn tick(&mut self, io: &mut LeafIo<'_>, _: &mut Metres) -> Status {
        io.abort("the map is gone")
    }
    fn halt(&mut self, _: &mut LeafIo<'_>, way: &mut Metres) {
        *way += 1.0;
    }
}

#[test]
fn a_leaf_can_end_the_whole_tree_and_is_not_halted_for_it() {
    let mut registry = Registry::new();
    registry
        .leaf(NodeSpec::action("Abort", ""), |_| Box::new(Abort))
        .unwrap();
    let mut tree = make(&registry, "<Fallback><Abort/><AlwaysSuccess/></Fallback>");
    let mut halts = 0.0;
    assert_eq!(tree.tick(Duration::ZERO, &mut halts), Ok(Status::Running));
    let error = tree.tick(Duration::ZERO, &mut halts).unwrap_err();
    assert_eq!(error.to_string(), "Fallback/Abort (node 2): the map is gone");
    assert_eq!(halts, 0.0);
}

#[test]
fn ports_are_read_and_written_by_type() {
    let mut registry = Registry::<Metres>::new();
    let spec = NodeSpec::action("Ports", "")
        .input("literal", PortType::Double, "")
        .input_or("given", PortType::Int, "7", "")
        .input_optional("open", PortType::Text, "")
        .input("entry", PortType::Any, "")
        .output("code", PortType::Unsigned, "")
        .output("unused", PortType::Text, "");
    registry
        .function(spec, |io, _| {
            assert_eq!(io.get::<f64>("literal"), Ok(0.5));
            assert_eq!(io.get::<i64>("given"), Ok(7));
            assert_eq!(io.get::<String>("open"), Err(PortError::Unset("open".into())));
            assert_eq!(io.get_optional::<String>("open"), Ok(None));
            assert_eq!(io.get::<bool>("entry"), Err(PortError::Empty("entry".into())));
            assert!(matches!(io.get::<bool>("given"), Err(PortError::Type { .. })));
            io.set("code", "106").unwrap();
            assert!(matches!(io.set("code", "many"), Err(PortError::Type { .. })));
            assert_eq!(io.set("literal", 1.0), Err(PortError::Literal("literal".into())));
            io.set("unused", "lost").unwrap();
            io.set_entry("list", serde_json::json!([1, 2])).unwrap();
            assert_eq!(io.entry("@list").map(ToString::to_string).as_deref(), Some("[1,2]"));
            Status::Success
        })
        .unwrap();
    let mut tree = make(
        &registry,
        "<Ports name=\"p\" literal=\"0.5\" entry=\"{e}\" code=\"{c}\"/>",
    );
    assert_eq!(tree.tick(Duration::ZERO, &mut 0.0), Ok(Status::Success));
    assert_eq!(tree.blackboard().get("c"), Some(&Value::Int(106)));
}

#[test]
fn an_id_is_registered_once_and_a_declaration_gives_way() {
    let mut registry = Registry::<Metres>::new();
    registry.declare(NodeSpec::action("Grab", "declared"));
    registry
        .function(NodeSpec::action("Grab", "done"), |_, _| Status::Success)
        .unwrap();
    registry.declare(NodeSpec::action("Grab", "declared again"));
    assert_eq!(registry.spec("Grab").unwrap().doc, "done");
    let again = registry.function(NodeSpec::action("Grab", ""), |_, _| Status::Success);
    assert_eq!(again, Err(DuplicateNode("Grab".into())));
    let builtin = registry.function(NodeSpec::action("Sleep", ""), |_, _| Status::Success);
    assert_eq!(builtin, Err(DuplicateNode("Sleep".into())));
    assert!(registry.specs().any(|spec| spec.category == Category::Control));
}

#[test]
fn a_tree_moves_between_threads() {
    fn sent<T: Send>() {}
    sent::<Tree<Metres>>();
}
