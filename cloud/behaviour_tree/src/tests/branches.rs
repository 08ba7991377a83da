//! Tests of the controls that choose between children.

use super::rig::{Rig, plays};

#[test]
fn if_then_else_asks_once_and_stays_in_its_branch() {
    plays(
        r#"<IfThenElse><T name="if" plan="SF"/><T name="then" plan="RS"/><T name="else"/></IfThenElse>"#,
        "RSS",
        "if then then. if else",
    );
    plays(
        r#"<IfThenElse><T name="if" plan="F"/><T name="then"/></IfThenElse>"#,
        "F",
        "if",
    );
    plays(
        r#"<IfThenElse><T name="if" plan="RS"/><T name="then"/></IfThenElse>"#,
        "RS",
        "if if. then",
    );
}

#[test]
fn while_do_else_asks_every_tick_and_halts_the_other_branch() {
    plays(
        r#"<WhileDoElse><T name="if" plan="SFS"/><T name="do" plan="R"/><T name="else" plan="R"/></WhileDoElse>"#,
        "RRR",
        "if do if do! else if else! do",
    );
    plays(
        r#"<WhileDoElse><T name="if" plan="SF"/><T name="do" plan="R"/></WhileDoElse>"#,
        "RF",
        "if do if do!",
    );
}

#[test]
fn switch_runs_the_matching_child_and_halts_it_when_another_matches() {
    let body = r#"<Switch2 variable="{mode}" case_1="fast" case_2="BLUE">
        <T name="one" plan="R"/><T name="two" plan="R"/><T name="default" plan="R"/></Switch2>"#;
    let mut rig = Rig::new(body);
    rig.ticks(1);
    assert_eq!(rig.log(), "default");
    rig.tree.blackboard_mut().set("mode", "fast").unwrap();
    rig.ticks(2);
    assert_eq!(rig.log(), "default! one one.");
    rig.tree.blackboard_mut().set("mode", "2").unwrap();
    rig.ticks(1);
    assert_eq!(rig.log(), "one! two");
}

#[test]
fn switch_takes_computed_numbers_for_what_they_nearly_are() {
    let body = r#"<Sequence><Script code="sum := 0.1 + 0.2; three := 1 + 2"/>
        <Switch2 variable="{sum}" case_1="0.4" case_2="0.3"><T name="1"/><T name="2"/><T name="other"/></Switch2>
        <Switch2 variable="{three}" case_1="3" case_2="4"><T name="3"/><T name="4"/><T name="other"/></Switch2></Sequence>"#;
    let mut rig = Rig::new(body);
    rig.ticks(1);
    assert_eq!(rig.log(), "2 3");
}

#[test]
fn try_catch_cleans_up_and_fails() {
    plays(
        r#"<TryCatch><T name="a"/><T name="b" plan="RF"/><T name="catch" plan="RS"/></TryCatch>"#,
        "RRF",
        "a b b. catch catch.",
    );
    plays(
        r#"<TryCatch><T name="a"/><T name="b"/><T name="catch"/></TryCatch>"#,
        "S",
        "a b",
    );
    plays(
        r#"<TryCatch><T name="a" plan="K"/><T name="catch"/></TryCatch>"#,
        "K",
        "a",
    );
}

#[test]
fn try_catch_cleans_up_after_a_halt_only_if_asked() {
    let body = r#"<TryCatch><T name="a" plan="R"/><T name="catch"/></TryCatch>"#;
    let mut rig = Rig::new(body);
    rig.ticks(1);
    rig.halt();
    assert_eq!(rig.log(), "a a!");
    let mut rig = Rig::new(&body.replace("<TryCatch", "<TryCatch catch_on_halt=\"true\""));
    rig.ticks(1);
    rig.halt();
    rig.halt();
    assert_eq!(rig.log(), "a a! catch");
}
