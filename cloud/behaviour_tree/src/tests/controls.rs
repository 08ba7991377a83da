//! Tests of sequences, fallbacks and parallels.

use super::rig::{Rig, plays};

#[test]
fn sequence_resumes_where_it_was_and_ends_at_the_first_failure() {
    plays(
        r#"<Sequence><T name="a"/><T name="b" plan="RS"/><T name="c"/></Sequence>"#,
        "RS",
        "a b b. c",
    );
    plays(
        r#"<Sequence><T name="a"/><T name="b" plan="FS"/><T name="c"/></Sequence>"#,
        "FS",
        "a b a b c",
    );
    plays(
        r#"<Sequence><T name="a" plan="K"/><T name="b"/></Sequence>"#,
        "S",
        "a b",
    );
    plays(
        r#"<Sequence><T name="a" plan="K"/><T name="b" plan="K"/></Sequence>"#,
        "K",
        "a b",
    );
}

#[test]
fn a_halted_sequence_halts_what_runs_and_starts_over() {
    let mut rig = Rig::new(r#"<Sequence><T name="a"/><T name="b" plan="R"/></Sequence>"#);
    rig.ticks(1);
    rig.halt();
    rig.halt();
    assert_eq!(rig.log(), "a b b!");
    rig.ticks(1);
    assert_eq!(rig.log(), "a b");
}

#[test]
fn async_sequence_yields_after_each_child_that_succeeds_at_once() {
    let body = r#"<ReactiveSequence><T name="watch"/><AsyncSequence>
        <T name="a"/><T name="b" plan="RS"/><T name="c"/></AsyncSequence></ReactiveSequence>"#;
    // Woken in the same tick, so the reactive parent is ticked again; b was running, so it does not yield.
    plays(body, "RS", "watch a watch b watch b. c");
    let mut rig = Rig::new(r#"<AsyncSequence><T name="a"/><T name="b"/></AsyncSequence>"#);
    let once = rig
        .tree
        .tick_exactly_once(std::time::Duration::ZERO, &mut rig.world)
        .unwrap();
    assert_eq!((once, rig.log().as_str()), (crate::Status::Running, "a"));
}

#[test]
fn async_fallback_yields_after_each_child_that_fails_at_once() {
    let body = r#"<ReactiveSequence><T name="watch"/><AsyncFallback>
        <T name="a" plan="F"/><T name="b"/></AsyncFallback></ReactiveSequence>"#;
    plays(body, "S", "watch a watch b");
}

#[test]
fn sequence_with_memory_tries_the_failed_child_again() {
    let body = r#"<SequenceWithMemory><T name="a"/><T name="b" plan="FS"/><T name="c"/></SequenceWithMemory>"#;
    plays(body, "FSS", "a b b c a b c");
    plays(&body.replace("SequenceWithMemory", "SequenceStar"), "FS", "a b b c");
}

#[test]
fn sequence_with_memory_keeps_its_place_over_a_halt() {
    let mut rig = Rig::new(r#"<SequenceWithMemory><T name="a"/><T name="b" plan="RS"/></SequenceWithMemory>"#);
    rig.ticks(1);
    rig.halt();
    rig.ticks(1);
    assert_eq!(rig.log(), "a b b! b");
}

#[test]
fn reactive_sequence_asks_from_the_start_and_halts_the_others() {
    plays(
        r#"<ReactiveSequence><T name="a"/><T name="b" plan="RS"/></ReactiveSequence>"#,
        "RS",
        "a b a b.",
    );
    plays(
        r#"<ReactiveSequence><T name="a" plan="SF"/><T name="b" plan="R"/></ReactiveSequence>"#,
        "RF",
        "a b a b!",
    );
    plays(
        r#"<ReactiveSequence><T name="a" plan="SR"/><T name="b" plan="R"/></ReactiveSequence>"#,
        "RR",
        "a b a b!",
    );
    plays(
        r#"<ReactiveSequence><T name="a" plan="K"/><T name="b" plan="K"/></ReactiveSequence>"#,
        "K",
        "a b",
    );
}

#[test]
fn fallback_goes_on_until_one_succeeds() {
    plays(
        r#"<Fallback><T name="a" plan="F"/><T name="b" plan="RS"/><T name="c"/></Fallback>"#,
        "RS",
        "a b b.",
    );
    plays(
        r#"<Fallback><T name="a" plan="F"/><T name="b" plan="K"/></Fallback>"#,
        "F",
        "a b",
    );
    plays(
        r#"<Fallback><T name="a" plan="K"/><T name="b" plan="K"/></Fallback>"#,
        "K",
        "a b",
    );
}

#[test]
fn reactive_fallback_asks_from_the_start_and_halts_the_others() {
    plays(
        r#"<ReactiveFallback><T name="a" plan="FS"/><T name="b" plan="R"/></ReactiveFallback>"#,
        "RS",
        "a b a b!",
    );
    plays(
        r#"<ReactiveFallback><T name="a" plan="F"/><T name="b" plan="F"/></ReactiveFallback>"#,
        "F",
        "a b",
    );
}

#[test]
fn parallel_ticks_what_is_not_done_and_ends_as_soon_as_it_can() {
    plays(
        r#"<Parallel><T name="a"/><T name="b" plan="RS"/></Parallel>"#,
        "RS",
        "a b b.",
    );
    // One failure is enough by default, and halts the rest.
    plays(
        r#"<Parallel><T name="a" plan="R"/><T name="b" plan="F"/></Parallel>"#,
        "F",
        "a b a!",
    );
    // Enough successes end it before the last child is ticked.
    plays(
        r#"<Parallel success_count="1"><T name="a"/><T name="b"/></Parallel>"#,
        "S",
        "a",
    );
    // All but one must succeed; one may fail.
    plays(
        r#"<Parallel success_count="-2" failure_count="2"><T name="a" plan="F"/><T name="b" plan="RS"/><T name="c"/></Parallel>"#,
        "RS",
        "a b c b.",
    );
    // Success impossible.
    plays(
        r#"<Parallel success_count="2" failure_count="3"><T name="a" plan="F"/><T name="b" plan="F"/><T name="c"/></Parallel>"#,
        "F",
        "a b",
    );
    plays(
        r#"<Parallel><T name="a" plan="K"/><T name="b"/></Parallel>"#,
        "S",
        "a b",
    );
    plays(
        r#"<Parallel success_count="2"><T name="a" plan="K"/><T name="b" plan="K"/></Parallel>"#,
        "K",
        "a b",
    );
}

#[test]
fn a_parallel_that_can_never_succeed_is_an_error() {
    let mut rig = Rig::new(r#"<Parallel success_count="3"><T name="a"/></Parallel>"#);
    assert!(rig.error().contains("thresholds of at most"));
}

#[test]
fn parallel_all_runs_every_child_to_its_end() {
    plays(
        r#"<ParallelAll><T name="a" plan="F"/><T name="b" plan="RRS"/></ParallelAll>"#,
        "RRF",
        "a b b. b.",
    );
    plays(
        r#"<ParallelAll max_failures="2"><T name="a" plan="F"/><T name="b" plan="RS"/></ParallelAll>"#,
        "RS",
        "a b b.",
    );
    plays(
        r#"<ParallelAll><T name="a" plan="K"/><T name="b" plan="K"/></ParallelAll>"#,
        "K",
        "a b",
    );
}

#[test]
fn parallel_any_ends_with_the_first_child_and_failure_goes_before_success() {
    plays(
        r#"<ParallelAny><T name="map" plan="R"/><T name="drive" plan="RS"/></ParallelAny>"#,
        "RS",
        "map drive map. drive. map!",
    );
    plays(
        r#"<ParallelAny><T name="map" plan="R"/><T name="drive" plan="F"/></ParallelAny>"#,
        "F",
        "map drive map!",
    );
    plays(
        r#"<ParallelAny><T name="a"/><T name="b" plan="F"/></ParallelAny>"#,
        "F",
        "a b",
    );
}

#[test]
fn a_leaf_that_answers_idle_is_an_error() {
    use crate::{NodeSpec, Registry, Status, build};
    let mut registry: Registry<()> = Registry::new();
    registry
        .function(NodeSpec::action("Idler", ""), |_, ()| Status::Idle)
        .unwrap();
    let text = br#"<root BTCPP_format="4"><BehaviorTree ID="M"><Idler/></BehaviorTree></root>"#;
    let mut tree = build("m.xml", text, &registry, None, &mut |_, _| Err(String::new())).unwrap();
    let error = tree.tick(std::time::Duration::ZERO, &mut ()).unwrap_err();
    assert_eq!((error.uid, error.path.as_str()), (1, "Idler"));
}
