//! Tests of the scripts around a node.

use super::rig::{Rig, plays};
use crate::Value;

#[test]
fn conditions_before_a_node_are_asked_in_their_order() {
    plays(
        r#"<T name="a" _failureIf="true" _successIf="true" _skipIf="true"/>"#,
        "F",
        "",
    );
    plays(r#"<T name="a" _successIf="true" _skipIf="true"/>"#, "S", "");
    plays(r#"<T name="a" _skipIf="true" _while="false"/>"#, "K", "");
    plays(r#"<T name="a" _while="false"/>"#, "K", "");
    plays(
        r#"<T name="a" _failureIf="false" _successIf="1 > 2" _skipIf="0" _while="1"/>"#,
        "S",
        "a",
    );
}

#[test]
fn conditions_are_not_asked_again_while_the_node_runs_except_while() {
    let mut rig = Rig::new(r#"<T name="a" plan="R" _skipIf="stop" _while="go" _onHalted="halted := true"/>"#);
    let board = rig.tree.blackboard_mut();
    board.set("stop", false).unwrap();
    board.set("go", true).unwrap();
    rig.ticks(1);
    rig.tree.blackboard_mut().set("stop", true).unwrap();
    assert_eq!(rig.ticks(1), "R");
    rig.tree.blackboard_mut().set("go", false).unwrap();
    assert_eq!(rig.ticks(1), "K");
    assert_eq!(rig.log(), "a a. a!");
    assert_eq!(rig.tree.blackboard().get("halted"), Some(&Value::Double(1.0)));
}

#[test]
fn scripts_after_a_node_run_once_it_has_completed() {
    let body = r#"<T name="a" plan="RSF" _onSuccess="s += 1" _onFailure="f += 1" _post="p += 1" _onHalted="h += 1"/>"#;
    let mut rig = Rig::new(body);
    for key in ["s", "f", "p", "h"] {
        rig.tree.blackboard_mut().set(key, 0_i64).unwrap();
    }
    let count = |rig: &Rig| ["s", "f", "p", "h"].map(|key| rig.tree.blackboard().get(key).unwrap().as_int().unwrap());
    rig.ticks(1);
    assert_eq!(count(&rig), [0, 0, 0, 0]);
    rig.ticks(1);
    assert_eq!(count(&rig), [1, 0, 1, 0]);
    rig.ticks(1);
    assert_eq!(count(&rig), [1, 1, 2, 0]);
    let mut rig = Rig::new(r#"<T name="a" plan="R" _onHalted="h := 1"/>"#);
    rig.ticks(1);
    rig.halt();
    rig.halt();
    assert_eq!(rig.tree.blackboard().get("h"), Some(&Value::Int(1)));
}

#[test]
fn a_guard_decides_without_starting_and_still_runs_the_scripts_after() {
    let mut rig = Rig::new(r#"<T name="a" _successIf="true" _onSuccess="s := 1"/>"#);
    assert_eq!(rig.ticks(1), "S");
    assert_eq!(
        (rig.log().as_str(), rig.tree.blackboard().get("s")),
        ("", Some(&Value::Int(1)))
    );
}

#[test]
fn a_condition_that_is_no_condition_is_an_error() {
    let mut rig = Rig::new(r#"<T name="a" _skipIf="'text'"/>"#);
    assert!(rig.error().contains("expected true or false"));
    let mut rig = Rig::new(r#"<T name="a" plan="R" _onHalted="x = 1"/>"#);
    rig.ticks(1);
    let error = rig.tree.halt(std::time::Duration::ZERO, &mut rig.world).unwrap_err();
    assert!(error.message.contains("`x` has no value"));
    assert_eq!(rig.log(), "a a!");
}
