//! Tests of snapshots: stored state is restored.

use std::time::Duration;

use super::rig::Rig;
use crate::{RestoreError, Status, TreeSnapshot};

const BODY: &str = r#"<Sequence><Script code="x := 1"/><Repeat num_cycles="3"><Timeout msec="1000">
    <T name="a" plan="RS"/></Timeout></Repeat><T name="b"/></Sequence>"#;

#[test]
fn a_restored_tree_goes_on_and_resumes_what_ran() {
    let mut rig = Rig::new(BODY);
    rig.ticks(1);
    let stored = serde_json::to_string(&rig.tree.snapshot()).unwrap();
    let mut fresh = Rig::new(BODY);
    fresh.tree.restore(serde_json::from_str(&stored).unwrap()).unwrap();
    assert_eq!(fresh.tree.snapshot(), rig.tree.snapshot());
    fresh.now_ms = rig.now_ms;
    assert_eq!(fresh.ticks(2), "RS");
    // The fresh leaf has its own plan, so the plan starts over; the leaf is resumed once, not started.
    assert_eq!(fresh.log(), "a~ a. a a b");
}

#[test]
fn a_timeout_counts_from_its_start_before_the_restart() {
    let mut rig = Rig::new(r#"<Timeout msec="100"><T name="a" plan="R"/></Timeout>"#);
    rig.at(40);
    let snapshot = rig.tree.snapshot();
    let mut fresh = Rig::new(r#"<Timeout msec="100"><T name="a" plan="R"/></Timeout>"#);
    fresh.tree.restore(snapshot).unwrap();
    assert_eq!(fresh.at(139), Status::Running);
    assert_eq!(fresh.at(140), Status::Failure);
    assert_eq!(fresh.log(), "a~ a!");
}

#[test]
fn a_snapshot_of_another_tree_or_a_damaged_one_is_refused() {
    let rig = Rig::new(BODY);
    let snapshot = rig.tree.snapshot();
    let mut other = Rig::new(&BODY.replace("1000", "1001"));
    assert_eq!(
        other.tree.restore(snapshot.clone()),
        Err(RestoreError::OtherTree("Main".into()))
    );
    let mut json = serde_json::to_value(&snapshot).unwrap();
    json["version"] = 9.into();
    let newer: TreeSnapshot = serde_json::from_value(json).unwrap();
    assert_eq!(other.tree.restore(newer), Err(RestoreError::Version(9)));
    for (path, value) in [
        ("/states", serde_json::json!([])),
        ("/blackboard/scopes/0/keys/x", serde_json::json!(99)),
        ("/blackboard/scopes", serde_json::json!([])),
        ("/memories", serde_json::json!({"77": {"feedback": "", "kept": 1}})),
    ] {
        let mut json = serde_json::to_value(&snapshot).unwrap();
        *json.pointer_mut(path).unwrap() = value;
        let damaged: TreeSnapshot = serde_json::from_value(json).unwrap();
        let mut rig = Rig::new(BODY);
        assert!(
            matches!(rig.tree.restore(damaged), Err(RestoreError::Damaged(_))),
            "{path}"
        );
    }
}

#[test]
fn cursors_out_of_range_are_errors_not_panics() {
    for body in [
        r#"<IfThenElse><T name="a"/><T name="b"/></IfThenElse>"#,
        r#"<Switch2 variable="1" case_1="1" case_2="2"><T name="a"/><T name="b"/><T name="c"/></Switch2>"#,
        #[cfg(feature = "nav2")]
        r#"<RoundRobin><T name="a"/></RoundRobin>"#,
        r#"<Sequence><T name="a"/></Sequence>"#,
        r#"<SequenceWithMemory><T name="a"/></SequenceWithMemory>"#,
        #[cfg(feature = "nav2")]
        r#"<RecoveryNode><T name="a"/><T name="b"/></RecoveryNode>"#,
        r#"<TryCatch><T name="a"/><T name="b"/></TryCatch>"#,
        r#"<Parallel><T name="a"/><T name="b"/></Parallel>"#,
        r#"<LoopInt queue="1;2" value="{v}"><T name="a"/></LoopInt>"#,
        r#"<Repeat num_cycles="2"><T name="a"/></Repeat>"#,
    ] {
        let mut rig = Rig::new(body);
        let mut json = serde_json::to_value(rig.tree.snapshot()).unwrap();
        for field in ["cursor", "count", "skipped"] {
            json["states"][0][field] = u32::MAX.into();
        }
        json["states"][0]["status"] = "RUNNING".into();
        rig.tree.restore(serde_json::from_value(json).unwrap()).unwrap();
        let _ = rig.tree.tick(Duration::ZERO, &mut rig.world);
        rig.halt();
    }
}

#[test]
fn a_queue_on_the_blackboard_is_consumed_whatever_cursor_was_stored() {
    let mut rig = Rig::new(r#"<LoopInt queue="{q}" value="{v}"><T name="a"/></LoopInt>"#);
    rig.tree.blackboard_mut().set("q", serde_json::json!([1, 2])).unwrap();
    let mut json = serde_json::to_value(rig.tree.snapshot()).unwrap();
    json["states"][0]["cursor"] = u32::MAX.into();
    json["states"][0]["status"] = "RUNNING".into();
    rig.tree.restore(serde_json::from_value(json).unwrap()).unwrap();
    assert_eq!(rig.ticks(3), "RRS");
    assert_eq!(rig.log(), "a a");
}

#[test]
fn the_revision_stands_still_while_nothing_changes() {
    let mut rig = Rig::new(
        r#"<ReactiveSequence><AlwaysSuccess/><Inverter><T name="watch" plan="F"/></Inverter><T name="a" plan="RRRS"/></ReactiveSequence>"#,
    );
    let fresh = rig.tree.revision();
    rig.ticks(1);
    let running = rig.tree.revision();
    assert_ne!(fresh, running);
    rig.ticks(1);
    assert_eq!(rig.tree.revision(), running);
    rig.tree.blackboard_mut().set("x", 1_i64).unwrap();
    let written = rig.tree.revision();
    assert_ne!(written, running);
    rig.ticks(2);
    assert_ne!(rig.tree.revision(), written);
}
