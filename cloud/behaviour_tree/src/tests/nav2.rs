//! Tests of Nav2's controls and decorators.

use super::rig::{Rig, play, plays};
use crate::Status;

#[test]
fn pipeline_sequence_ticks_earlier_children_again_while_later_ones_run() {
    plays(
        r#"<PipelineSequence><T name="a"/><T name="b" plan="RS"/><T name="c" plan="RS"/></PipelineSequence>"#,
        "RRS",
        "a b a b. c a b c.",
    );
    // An earlier child that runs again does not stop the later ones.
    plays(
        r#"<PipelineSequence><T name="a" plan="SR"/><T name="b" plan="RR"/></PipelineSequence>"#,
        "RR",
        "a b a b.",
    );
    plays(
        r#"<PipelineSequence><T name="a" plan="SF"/><T name="b" plan="R"/></PipelineSequence>"#,
        "RF",
        "a b a b!",
    );
    plays(
        r#"<PipelineSequence><T name="a" plan="K"/><T name="b" plan="K"/></PipelineSequence>"#,
        "K",
        "a b",
    );
}

#[test]
fn recovery_node_mends_so_often_and_no_more() {
    plays(
        r#"<RecoveryNode number_of_retries="2"><T name="a" plan="F"/><T name="mend"/></RecoveryNode>"#,
        "F",
        "a mend a mend a",
    );
    plays(
        r#"<RecoveryNode><T name="a" plan="FRS"/><T name="mend" plan="RS"/></RecoveryNode>"#,
        "RRS",
        "a mend mend. a a.",
    );
    plays(
        r#"<RecoveryNode><T name="a" plan="F"/><T name="mend" plan="F"/></RecoveryNode>"#,
        "F",
        "a mend",
    );
    plays(
        r#"<RecoveryNode><T name="a" plan="K"/><T name="mend"/></RecoveryNode>"#,
        "K",
        "a",
    );
    plays(
        r#"<RecoveryNode><T name="a" plan="FS"/><T name="mend" plan="K"/></RecoveryNode>"#,
        "FS",
        "a mend a",
    );
}

#[test]
fn round_robin_takes_turns_and_fails_after_the_last_even_if_it_succeeds() {
    let body = r#"<KeepRunningUntilFailure><RoundRobin><T name="a"/><T name="b"/><T name="c"/></RoundRobin></KeepRunningUntilFailure>"#;
    plays(body, "RRF", "a b c");
    plays(
        r#"<RoundRobin><T name="a" plan="F"/><T name="b"/><T name="c"/></RoundRobin>"#,
        "S",
        "a b",
    );
    plays(
        r#"<RoundRobin><T name="a" plan="F"/><T name="b" plan="F"/></RoundRobin>"#,
        "F",
        "a b",
    );
    plays(
        r#"<RoundRobin><T name="a" plan="K"/><T name="b" plan="K"/></RoundRobin>"#,
        "K",
        "a b",
    );
}

#[test]
fn the_mended_round_robin_lets_the_last_child_succeed_once() {
    let body = r#"<KeepRunningUntilFailure><RoundRobin last_may_succeed="true"><T name="a"/><T name="b"/></RoundRobin></KeepRunningUntilFailure>"#;
    plays(body, "RRFR", "a b a");
}

#[test]
fn round_robin_that_wraps_around_never_runs_out() {
    let body = r#"<KeepRunningUntilFailure><RoundRobin wrap_around="true"><T name="a"/><T name="b"/></RoundRobin></KeepRunningUntilFailure>"#;
    plays(body, "RRRR", "a b a b");
    plays(
        r#"<RoundRobin wrap_around="true"><T name="a" plan="F"/><T name="b" plan="F"/></RoundRobin>"#,
        "F",
        "a b",
    );
}

#[test]
fn round_robin_keeps_its_place_though_the_main_branch_succeeded_in_between() {
    let body = r#"<RecoveryNode number_of_retries="9"><T name="main" plan="FSFS"/><RoundRobin><T name="a"/><T name="b"/><T name="c"/></RoundRobin></RecoveryNode>"#;
    plays(body, "SS", "main a main main b main");
}

#[test]
fn nonblocking_sequence_ticks_every_child_in_every_tick() {
    plays(
        r#"<NonblockingSequence><T name="a" plan="RS"/><T name="b" plan="RS"/></NonblockingSequence>"#,
        "RS",
        "a b a. b.",
    );
    plays(
        r#"<NonblockingSequence><T name="a" plan="R"/><T name="b" plan="F"/></NonblockingSequence>"#,
        "F",
        "a b a!",
    );
    let mut rig = Rig::new(r#"<NonblockingSequence><T name="a" plan="K"/></NonblockingSequence>"#);
    assert!(rig.error().contains("was skipped"));
}

#[test]
fn persistent_sequence_keeps_its_index_on_the_blackboard() {
    let mut rig = Rig::new(
        r#"<PersistentSequence current_child_idx="{i}"><T name="a"/><T name="b" plan="RSF"/></PersistentSequence>"#,
    );
    rig.ticks(1);
    rig.halt();
    assert_eq!(rig.log(), "a b b!");
    assert_eq!(rig.tree.blackboard().get("i").unwrap().as_int(), Some(1));
    assert_eq!(rig.ticks(2), "SF");
    assert_eq!(rig.log(), "b a b");
    assert_eq!(rig.tree.blackboard().get("i").unwrap().as_int(), Some(0));
    // Unlike a Sequence, it is not skipped itself.
    let body = r#"<PersistentSequence current_child_idx="{i}"><T name="a" plan="K"/><T name="b" plan="K"/></PersistentSequence>"#;
    plays(body, "S", "a b");
}

#[test]
fn rate_controller_ticks_on_activation_while_running_and_when_due() {
    let mut rig = Rig::new(
        r#"<PipelineSequence><RateController hz="10"><T name="plan" plan="RS"/></RateController><T name="drive" plan="R"/></PipelineSequence>"#,
    );
    rig.at(0);
    rig.at(20);
    assert_eq!(rig.log(), "plan plan. drive");
    rig.at(119);
    assert_eq!(rig.log(), "drive.");
    rig.at(120);
    assert_eq!(rig.log(), "plan drive.");
    rig.at(219);
    assert_eq!(rig.log(), "drive.");
    let mut rig = Rig::new(r#"<RateController hz="{hz}"><T name="a"/></RateController>"#);
    rig.tree.blackboard_mut().set("hz", 0.0).unwrap();
    assert!(rig.error().contains("more than 0"));
}

#[test]
fn a_failed_child_of_a_rate_controller_is_tried_when_it_is_due() {
    let body = r#"<RateController hz="10"><T name="a" plan="F"/></RateController>"#;
    // Each failure ends the activation, so the next tick is a new one.
    assert_eq!(play(body, 2), ("FF".to_owned(), "a a".to_owned()));
}

#[test]
fn single_trigger_runs_its_child_once_an_activation() {
    let mut rig = Rig::new(
        r#"<ReactiveFallback><SingleTrigger><T name="a" plan="F"/></SingleTrigger><T name="b" plan="R"/></ReactiveFallback>"#,
    );
    // The reactive parent resets it in every tick.
    assert_eq!(rig.ticks(2), "RR");
    assert_eq!(rig.log(), "a b a b.");
    let mut rig = Rig::new(
        r#"<NonblockingSequence><ForceSuccess><SingleTrigger><T name="a"/></SingleTrigger></ForceSuccess><T name="b" plan="R"/></NonblockingSequence>"#,
    );
    assert_eq!(rig.tick(), Status::Running);
    let mut rig = Rig::new(
        r#"<PipelineSequence><SingleTrigger><T name="a" plan="RS"/></SingleTrigger><T name="b" plan="R"/></PipelineSequence>"#,
    );
    assert_eq!(rig.ticks(3), "RRF");
    assert_eq!(rig.log(), "a a. b b!");
}
