//! Tests of what an error at run time leaves behind: what ran is halted, as by a halt of the tree.

use std::time::Duration;

use super::rig::Rig;
use crate::{Decorator, Enter, LeafIo, NodeSpec, Registry, Status, Value, build};

#[test]
fn an_error_halts_from_the_root_down_and_in_order() {
    let body = r#"<Parallel success_count="3" _onHalted="halted := 1"><T name="a" plan="R"/><T name="b" plan="R"/>
        <T name="c" plan="RE"/></Parallel>"#;
    let mut rig = Rig::new(body);
    rig.ticks(1);
    assert_eq!(rig.error(), "Parallel/c (node 4): as planned");
    assert_eq!(rig.log(), "a b c a. b. c. a! b!");
    assert_eq!(rig.tree.blackboard().get("halted"), Some(&Value::Int(1)));
    assert!(rig.tree.statuses().all(|(_, status, _)| status == Status::Idle));
    // The same in the first tick, before any control has answered.
    let mut rig = Rig::new(&body.replace("RE", "E"));
    assert_eq!(rig.error(), "Parallel/c (node 4): as planned");
    assert_eq!(rig.log(), "a b c a! b!");
    assert_eq!(rig.tree.blackboard().get("halted"), Some(&Value::Int(1)));
}

#[test]
fn an_error_in_what_was_begun_is_cleaned_up_if_halts_are() {
    let body = r#"<TryCatch catch_on_halt="true"><T name="switch on"/><T name="work" plan="E"/><T name="switch off"/></TryCatch>"#;
    let mut rig = Rig::new(body);
    assert!(rig.error().contains("as planned"));
    assert_eq!(rig.log(), "switch on work switch off");
    let mut rig = Rig::new(&body.replace("true", "false"));
    assert!(rig.error().contains("as planned"));
    assert_eq!(rig.log(), "switch on work");
}

#[cfg(feature = "nav2")]
#[test]
fn a_loop_that_never_yields_is_ended_and_cleaned_up_after() {
    let body = r#"<TryCatch catch_on_halt="true"><T name="switch on"/>
        <RecoveryNode number_of_retries="2000000000"><AlwaysFailure/><AlwaysSuccess/></RecoveryNode>
        <T name="switch off"/></TryCatch>"#;
    let mut rig = Rig::new(body);
    assert!(rig.error().contains("never yields"));
    assert_eq!(rig.log(), "switch on switch off");
}

#[test]
fn a_leaf_that_has_completed_is_not_halted_because_the_script_after_it_fails() {
    for script in ["_onSuccess", "_post"] {
        let mut rig = Rig::new(&format!(
            "<Sequence><T name=\"a\" plan=\"RS\" {script}=\"missing += 1\"/></Sequence>"
        ));
        assert_eq!(rig.ticks(1), "R");
        assert!(rig.error().contains("`missing` has no value"));
        assert_eq!(rig.log(), "a a.", "{script}");
    }
}

#[test]
fn an_error_does_not_erase_what_a_node_keeps_for_life() {
    let body = r#"<Sequence><RunOnce then_skip="false"><T name="once"/></RunOnce>
        <ForceSuccess><WasEntryUpdated name="seen" entry="{e}"/></ForceSuccess><Script code="x += 1"/></Sequence>"#;
    let mut rig = Rig::new(body);
    rig.tree.blackboard_mut().set("e", 1_i64).unwrap();
    assert!(rig.error().contains("`x` has no value"));
    rig.tree.blackboard_mut().set("x", 1_i64).unwrap();
    assert_eq!(rig.ticks(1), "S", "RunOnce repeats the success of its child");
    assert_eq!(rig.log(), "once");
    let seen = rig.tree.iter().find(|node| node.name == "seen").unwrap();
    assert_eq!(seen.last, Status::Failure, "the entry has not been written again");
}

/// Counts how often it was halted.
struct Counter;

impl Decorator<u32> for Counter {
    fn enter(&mut self, _: &mut LeafIo<'_>, _: &mut u32, _: Status) -> Enter {
        Enter::TickChild
    }
    fn halt(&mut self, _: &mut LeafIo<'_>, halts: &mut u32) {
        *halts += 1;
    }
}

#[test]
fn a_decorator_from_outside_is_halted_once_by_an_error_below_it() {
    let mut registry = Registry::<u32>::new();
    registry
        .decorator(NodeSpec::decorator("Counter", ""), |_| Box::new(Counter))
        .unwrap();
    let text = br#"<root BTCPP_format="4"><BehaviorTree ID="M"><Counter><Script code="x += 1"/></Counter></BehaviorTree></root>"#;
    let mut tree = build("m.xml", text, &registry, None, &mut |_, _| Err(String::new())).unwrap();
    let mut halts = 0;
    assert!(tree.tick(Duration::ZERO, &mut halts).is_err());
    assert_eq!(halts, 1);
    tree.blackboard_mut().set("x", 1_i64).unwrap();
    assert_eq!(tree.tick(Duration::ZERO, &mut halts), Ok(Status::Success));
    assert_eq!(halts, 1);
}
