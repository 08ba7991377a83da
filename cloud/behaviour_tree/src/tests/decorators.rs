//! Tests of decorators, clocks, loops and leaves.

use super::rig::{Rig, plays};
use crate::{Status, Value};

#[test]
fn inverter_and_force_change_completed_answers_only() {
    plays(r#"<Inverter><T name="a" plan="RSFK"/></Inverter>"#, "RFSK", "a a. a a");
    plays(
        r#"<ForceSuccess><T name="a" plan="RSFK"/></ForceSuccess>"#,
        "RSSK",
        "a a. a a",
    );
    plays(
        r#"<ForceFailure><T name="a" plan="RSFK"/></ForceFailure>"#,
        "RFFK",
        "a a. a a",
    );
}

#[test]
fn retry_tries_so_often_in_the_same_tick() {
    plays(
        r#"<RetryUntilSuccessful num_attempts="3"><T name="a" plan="FFS"/></RetryUntilSuccessful>"#,
        "S",
        "a a a",
    );
    plays(
        r#"<RetryUntilSuccessful num_attempts="2"><T name="a" plan="FFRFF"/></RetryUntilSuccessful>"#,
        "FRF",
        "a a a a. a",
    );
    plays(
        r#"<RetryUntilSuccessful num_attempts="0"><T name="a"/></RetryUntilSuccessful>"#,
        "F",
        "",
    );
}

#[test]
fn retry_reads_its_limit_before_every_attempt() {
    let body = r#"<RetryUntilSuccessful num_attempts="{n}"><Sequence>
        <Script code="n = n - 1"/><T name="a" plan="F"/></Sequence></RetryUntilSuccessful>"#;
    let mut rig = Rig::new(body);
    rig.tree.blackboard_mut().set("n", 4_i64).unwrap();
    assert_eq!(rig.ticks(1), "F");
    assert_eq!(rig.log(), "a a");
}

#[test]
fn an_endless_retry_of_what_fails_at_once_does_not_end_the_tick_never() {
    let mut rig = Rig::new(r#"<RetryUntilSuccessful num_attempts="-1"><AlwaysFailure/></RetryUntilSuccessful>"#);
    assert_eq!(rig.ticks(2), "RR");
}

#[test]
fn retry_yields_so_that_a_reactive_parent_asks_again() {
    let body = r#"<ReactiveSequence><T name="watch"/><RetryUntilSuccessful num_attempts="2">
        <T name="a" plan="FS"/></RetryUntilSuccessful></ReactiveSequence>"#;
    plays(body, "S", "watch a watch a");
}

#[cfg(feature = "nav2")]
#[test]
fn repeat_repeats_success_and_keeps_count_when_skipped() {
    plays(
        r#"<Repeat num_cycles="3"><T name="a" plan="SRS"/></Repeat>"#,
        "RS",
        "a a a. a",
    );
    plays(r#"<Repeat num_cycles="3"><T name="a" plan="SF"/></Repeat>"#, "F", "a a");
    let body = r#"<PipelineSequence><Repeat num_cycles="3"><T name="a" plan="SKS"/></Repeat><T name="b" plan="R"/></PipelineSequence>"#;
    // Woken after each quick success; the skipped third call does not count as a cycle.
    plays(body, "RR", "a a b a b. a b.");
}

#[test]
fn keep_running_until_failure() {
    plays(
        r#"<KeepRunningUntilFailure><T name="a" plan="SRF"/></KeepRunningUntilFailure>"#,
        "RRF",
        "a a a.",
    );
}

#[test]
fn timeout_halts_a_child_that_takes_longer() {
    let mut rig = Rig::new(r#"<Timeout msec="100"><T name="a" plan="R"/></Timeout>"#);
    assert_eq!(rig.at(0), Status::Running);
    assert_eq!(rig.at(99), Status::Running);
    assert_eq!(rig.at(100), Status::Failure);
    assert_eq!(rig.log(), "a a. a!");
    // The clock restarts with the next activation.
    assert_eq!(rig.at(110), Status::Running);
    assert_eq!(rig.at(209), Status::Running);
}

#[test]
fn delay_waits_before_the_child() {
    let mut rig = Rig::new(r#"<Delay delay_msec="50"><T name="a"/></Delay>"#);
    assert_eq!(rig.at(0), Status::Running);
    assert_eq!(rig.at(49), Status::Running);
    assert_eq!(rig.log(), "");
    assert_eq!(rig.at(50), Status::Success);
}

#[test]
fn sleep_takes_its_time() {
    let mut rig = Rig::new(r#"<Sleep msec="20"/>"#);
    assert_eq!(rig.ticks(3), "RRS");
}

#[test]
fn run_once_is_skipped_or_repeats_its_answer() {
    plays(
        r#"<Fallback><RunOnce><T name="a" plan="RF"/></RunOnce><T name="b"/></Fallback>"#,
        "RSS",
        "a a. b b",
    );
    plays(
        r#"<RunOnce then_skip="false"><T name="a" plan="F"/></RunOnce>"#,
        "FF",
        "a",
    );
}

#[test]
fn precondition_asks_until_the_child_runs() {
    let mut rig = Rig::new(r#"<Precondition if="go == 1" else="RUNNING"><T name="a" plan="RS"/></Precondition>"#);
    rig.tree.blackboard_mut().set("go", 0_i64).unwrap();
    assert_eq!(rig.ticks(1), "R");
    rig.tree.blackboard_mut().set("go", 1_i64).unwrap();
    assert_eq!(rig.ticks(1), "R");
    rig.tree.blackboard_mut().set("go", 0_i64).unwrap();
    assert_eq!(rig.ticks(2), "SR");
    assert_eq!(rig.log(), "a a.");
}

#[test]
fn loops_take_one_item_a_tick() {
    let body = r#"<LoopInt queue="1;2;3" value="{x}"><Peek value="{x}"/></LoopInt>"#;
    plays(body, "RRRSR", "1 2 3 1");
    plays(&body.replace("queue=", "if_empty=\"FAILURE\" queue="), "RRRF", "1 2 3");
    plays(
        r#"<LoopString queue="a;b" value="{x}"><T name="t" plan="RSF"/></LoopString>"#,
        "RRF",
        "t t. t",
    );
}

#[test]
fn a_loop_consumes_a_queue_on_the_blackboard() {
    let mut rig = Rig::new(r#"<LoopDouble queue="{q}" value="{x}"><Peek value="{x}"/></LoopDouble>"#);
    rig.tree.blackboard_mut().set("q", serde_json::json!([1.5, 2])).unwrap();
    assert_eq!(rig.ticks(4), "RRSS");
    assert_eq!(rig.log(), "1.5 2");
    rig.tree.blackboard_mut().set("q", serde_json::json!(["text"])).unwrap();
    assert!(rig.error().contains("item `text`"));
}

#[test]
fn updates_are_seen_once_each() {
    let body = r#"<ReactiveFallback><SkipUnlessUpdated entry="{e}"><T name="skip" plan="F"/></SkipUnlessUpdated>
        <Inverter><WasEntryUpdated entry="{e}"/></Inverter><AlwaysFailure/></ReactiveFallback>"#;
    let mut rig = Rig::new(body);
    assert_eq!(rig.ticks(1), "S");
    rig.tree.blackboard_mut().set("e", 1_i64).unwrap();
    assert_eq!(rig.ticks(2), "FS");
    assert_eq!(rig.log(), "skip");
    let mut rig = Rig::new(r#"<WaitValueUpdate entry="e"><T name="a" plan="RS"/></WaitValueUpdate>"#);
    assert_eq!(rig.ticks(1), "R");
    rig.tree.blackboard_mut().set("e", 1_i64).unwrap();
    assert_eq!(rig.ticks(3), "RSR");
    assert_eq!(rig.log(), "a a.");
}

#[test]
fn a_removed_entry_was_not_updated_and_one_that_is_written_again_was() {
    let mut rig = Rig::new(r#"<WasEntryUpdated entry="{e}"/>"#);
    rig.tree.blackboard_mut().set("e", 1_i64).unwrap();
    assert_eq!(rig.ticks(1), "S");
    rig.tree.blackboard_mut().unset("e");
    assert_eq!(rig.ticks(1), "F");
    rig.tree.blackboard_mut().set("e", 1_i64).unwrap();
    assert_eq!(rig.ticks(2), "SF");
}

#[test]
fn there_is_nothing_to_copy_from_an_entry_without_a_value() {
    plays(r#"<SetBlackboard value="{nothing}" output_key="y"/>"#, "F", "");
}

#[test]
fn leaves_write_and_forget_entries() {
    let body = r#"<Sequence><SetBlackboard value="5" output_key="x"/><SetBlackboard value="{x}" output_key="{y}"/>
        <Script code="z := x + 1"/><ScriptCondition code="z == 6 &amp;&amp; y == '5'"/><UnsetBlackboard key="x"/></Sequence>"#;
    let mut rig = Rig::new(body);
    assert_eq!(rig.ticks(1), "S");
    let board = rig.tree.blackboard();
    assert_eq!((board.get("x"), board.get("z")), (None, Some(&Value::Double(6.0))));
    plays(r#"<ScriptCondition code="1 == 2"/>"#, "F", "");
    plays("<AlwaysSuccess/>", "S", "");
    plays("<AlwaysFailure/>", "F", "");
}

#[test]
fn an_error_in_a_script_ends_the_tree_and_names_the_node() {
    let mut rig = Rig::new(
        r#"<Fallback name="try"><Parallel name="both"><T name="a" plan="R"/><Script name="sum" code="y := x + 1"/></Parallel><T name="b"/></Fallback>"#,
    );
    let error = rig.error();
    assert_eq!(
        error,
        "try/both/sum (node 4): script `y := x + 1`: the entry `x` has no value"
    );
    // The running leaf has been halted, and the fallback was not ticked.
    assert_eq!(rig.log(), "a a!");
    assert!(rig.tree.statuses().all(|(_, status, _)| status == Status::Idle));
}
