//! Nav2's default tree, against scripted leaves.

use crate::simulate::{Outcome, Script, registry, simulate};
use crate::{Limits, Status, check};

/// The shape of Nav2's default tree for NavigateToPose, rewritten for this test.
const TREE: &str = include_str!("navigate.xml");

fn run(tree: &str, script: &str) -> Outcome {
    let script: Script = serde_json::from_str(script).unwrap();
    let outcome = simulate(
        "nav.xml",
        tree.as_bytes(),
        None,
        &script,
        &mut |_, _| Err("none".into()),
    )
    .unwrap();
    assert_eq!(outcome.warnings, Vec::<String>::new());
    outcome
}

fn counts(outcome: &Outcome) -> [u64; 6] {
    [
        "ComputePathToPose",
        "FollowPath",
        "ClearEntireCostmap",
        "Spin",
        "Wait",
        "BackUp",
    ]
    .map(|leaf| outcome.counts.get(leaf).copied().unwrap_or(0))
}

#[test]
fn the_nodes_of_nav2_are_known() {
    check(
        "nav.xml",
        TREE.as_bytes(),
        &registry(),
        &mut |_, _| Err("none".into()),
        Limits::default(),
    )
    .unwrap();
}

#[test]
fn all_leaves_succeed() {
    let outcome = run(TREE, "{}");
    assert_eq!(
        (outcome.status, outcome.ticks, outcome.sim_time_ms),
        (Status::Success, 1, 0)
    );
    assert_eq!(counts(&outcome), [1, 1, 0, 0, 0, 0]);
}

#[test]
fn all_leaves_fail() {
    // Codes that a recovery may fix: the planner's own recovery fails, then each one of the round robin in turn.
    let outcome = run(
        TREE,
        r#"{"leaves": {"ComputePathToPose": {"status": "FAILURE", "set": {"error_code_id": "207"}},
            "FollowPath": {"status": "FAILURE", "set": {"error_code_id": "106"}}, "ClearEntireCostmap": {"status": "FAILURE"},
            "Spin": {"status": "FAILURE"}, "Wait": {"status": "FAILURE"}, "BackUp": {"status": "FAILURE"}}}"#,
    );
    assert_eq!(outcome.status, Status::Failure);
    assert_eq!(counts(&outcome), [1, 0, 2, 1, 1, 1]);
}

#[test]
fn the_planner_fails_for_ever_and_every_recovery_succeeds() {
    let outcome = run(
        TREE,
        r#"{"leaves": {"ComputePathToPose": {"status": "FAILURE", "set": {"error_code_id": "207"}}}}"#,
    );
    assert_eq!(outcome.status, Status::Failure);
    // Four passes of two tries with the map cleared in between; the first recovery clears both maps, the last one ends it.
    assert_eq!(counts(&outcome), [8, 0, 6, 1, 1, 1]);
}

#[test]
fn planner_and_controller_fail_once_and_their_maps_are_cleared() {
    let outcome = run(
        TREE,
        r#"{"leaves": {"ComputePathToPose": {"fail": [[1, 1]], "set": {"error_code_id": "207"}},
                        "FollowPath": {"fail": [[1, 1]], "set": {"error_code_id": "106"}},
                        "ClearLocal-Context": {}}}"#,
    );
    assert_eq!(outcome.status, Status::Success);
    assert_eq!(counts(&outcome), [2, 2, 2, 0, 0, 0]);
    assert_eq!(outcome.counts.get("ClearLocal-Context"), Some(&1));
}

#[test]
fn the_third_failure_of_the_controller_takes_a_recovery() {
    let outcome = run(
        TREE,
        r#"{"leaves": {"FollowPath": {"fail": [[1, 3]], "set": {"error_code_id": "106"}}}}"#,
    );
    assert_eq!(outcome.status, Status::Success);
    // Two tries, the first recovery (both maps cleared), one failure, cleared, success.
    assert_eq!(counts(&outcome), [2, 4, 4, 0, 0, 0]);
}

#[test]
fn a_controller_that_keeps_failing_ends_after_the_last_recovery_succeeds() {
    let script = r#"{"leaves": {"FollowPath": {"status": "FAILURE", "set": {"error_code_id": "106"}}}}"#;
    let outcome = run(TREE, script);
    assert_eq!(outcome.status, Status::Failure);
    // Four passes of two tries: the round robin fails after BackUp, though it succeeded.
    assert_eq!(counts(&outcome), [4, 8, 6, 1, 1, 1]);
    let mended = TREE.replace("<RoundRobin ", "<RoundRobin wrap_around=\"true\" ");
    let outcome = run(&mended, script);
    assert_eq!(outcome.status, Status::Failure);
    // All six retries: seven passes.
    assert_eq!(counts(&outcome)[1], 14);
}

/// Counts of plans, drives, cleared maps, spins, waits and retreats that Nav2 states for its own tree in `nav2_system_tests`
/// (`test_behavior_tree_node.cpp`, 2026-08). Its servers fail a given number of first goals; clearing a map always succeeds.
#[test]
fn leaves_start_as_often_as_in_nav2_s_own_system_tests() {
    let plan =
        |times: u32| format!(r#""ComputePathToPose": {{"fail": [[1, {times}]], "set": {{"error_code_id": 207}}}}"#);
    let follow = |times: u32| format!(r#""FollowPath": {{"fail": [[1, {times}]], "set": {{"error_code_id": 106}}}}"#);
    let recoveries = r#""Spin": {"fail": [[1, 100]]}, "Wait": {"fail": [[1, 100]]}, "BackUp": {"fail": [[1, 100]]}"#;
    let spin_fails = r#""Spin": {"fail": [[1, 1]]}"#;
    let spin_takes_long = r#""Spin": {"run_ms": 1000}"#;
    let new_goal = r#", "events": [{"when": {"leaf": "Spin", "starts": 1}, "set": {"goal": "1;1;1"}}]"#;
    let situations = [
        ("all succeed", String::new(), "", Status::Success, [1, 1, 0, 0, 0, 0]),
        (
            "all fail",
            format!("{}, {}, {recoveries}", plan(100), follow(100)),
            "",
            Status::Failure,
            [4, 0, 4, 1, 1, 1],
        ),
        (
            "planner and controller fail once",
            format!("{}, {}", plan(1), follow(1)),
            "",
            Status::Success,
            [2, 2, 2, 0, 0, 0],
        ),
        (
            "the controller fails three times",
            format!("{}, {}", plan(1), follow(3)),
            "",
            Status::Success,
            [3, 4, 5, 0, 0, 0],
        ),
        (
            "the controller keeps failing",
            format!("{}, {spin_fails}", follow(14)),
            "",
            Status::Failure,
            [3, 6, 5, 1, 1, 1],
        ),
        (
            "the goal changes during recovery",
            format!("{}, {spin_takes_long}", follow(4)),
            new_goal,
            Status::Success,
            [3, 5, 4, 1, 0, 0],
        ),
    ];
    for (name, leaves, events, status, expected) in situations {
        let outcome = run(TREE, &format!(r#"{{"leaves": {{{leaves}}}{events}}}"#));
        assert_eq!((outcome.status, counts(&outcome)), (status, expected), "{name}");
    }
}

#[test]
fn an_error_that_no_recovery_helps_ends_at_once() {
    let outcome = run(
        TREE,
        r#"{"leaves": {"FollowPath": {"status": "FAILURE", "set": {"error_code_id": 102}}}}"#,
    );
    assert_eq!(outcome.status, Status::Failure);
    assert_eq!(counts(&outcome), [1, 1, 0, 0, 0, 0]);
}

#[test]
fn a_new_goal_during_a_recovery_does_not_disturb_it() {
    let script = r#"{"leaves": {"FollowPath": {"fail": [[1, 4]], "set": {"error_code_id": "106"}}, "Spin": {"run_ms": 500}},
        "blackboard": {"goal": "0;0;0"},
        "events": [{"when": {"leaf": "Spin", "starts": 1}, "set": {"goal": "1;1;1"}}]}"#;
    let outcome = run(TREE, script);
    assert_eq!(outcome.status, Status::Success);
    assert_eq!(counts(&outcome), [3, 5, 4, 1, 0, 0]);
    // GoalUpdated is reset by its reactive parent in every tick that Spin runs, so it never sees a change there; GlobalUpdatedGoal, which
    // remembers for the life of the tree, does.
    assert_eq!(outcome.sim_time_ms, 500);
    let mended = TREE.replace("<GoalUpdated/>", "<GlobalUpdatedGoal/>");
    let outcome = run(&mended, &script.replace("[1, 4]", "[1, 6]"));
    assert_eq!((outcome.status, outcome.sim_time_ms), (Status::Success, 10));
}

#[test]
fn while_driving_the_way_is_planned_once_a_second_unless_it_is_still_valid() {
    let script = r#"{"leaves": {"FollowPath": {"run_ms": 3500}}}"#;
    assert_eq!(counts(&run(TREE, script))[0], 4);
    let near = r#"{"leaves": {"FollowPath": {"run_ms": 3500}, "IsGoalNearby": {}}}"#;
    assert_eq!(counts(&run(TREE, near))[0], 1);
}

#[test]
fn a_script_is_checked_and_time_runs_out() {
    assert!(serde_json::from_str::<Script>(r#"{"leafs": {}}"#).is_err());
    let still = serde_json::from_str::<Script>(r#"{"tick_period_ms": 0}"#)
        .unwrap_err()
        .to_string();
    assert!(still.contains("`tick_period_ms` is 0: expected at least 1"), "{still}");
    assert!(serde_json::from_str::<Script>(r#"{"leaves": {"A": {"fails": []}}}"#).is_err());
    let endless = r#"{"timeout_ms": 100, "leaves": {"FollowPath": {"status": "RUNNING"}}}"#;
    let outcome = run(TREE, endless);
    assert_eq!((outcome.status, outcome.timed_out), (Status::Running, true));
    assert_eq!((outcome.ticks, outcome.sim_time_ms), (11, 100));
}

#[test]
fn what_a_script_sets_on_a_port_that_is_not_there_is_told() {
    let tree = r#"<root><BehaviorTree ID="A"><Sequence><FollowPath path="{p}"/><Grab where="{w}"/></Sequence></BehaviorTree></root>"#;
    let script = r#"{"leaves": {"FollowPath": {"set": {"bogus": 1, "error_code_id": 106}}, "Grab": {"set": {"where": 1, "what": 2}}}}"#;
    let script: Script = serde_json::from_str(script).unwrap();
    let none = &mut |_: &str, _: &str| Err("none".into());
    let outcome = simulate("nav.xml", tree.as_bytes(), None, &script, none).unwrap();
    assert_eq!(
        outcome.warnings,
        [
            "`FollowPath` has no port `bogus`: nothing is set",
            "`Grab` has no port `what`: nothing is set"
        ]
    );
}

#[test]
fn conditions_that_the_blackboard_and_the_time_decide_are_decided() {
    let of = |body: &str, script: &str| {
        let tree = format!("<root><BehaviorTree ID=\"A\">{body}</BehaviorTree></root>");
        let outcome = run(&tree, script);
        (outcome.status, outcome.sim_time_ms)
    };
    let bounds = r#"<Sequence><ComputePathToPose goal="{goal}" path="{path}"/><ReactiveSequence>
        <IsWithinPathTrackingBounds max_error_left="0.2" max_error_right="0.2" tracking_feedback="{t}"/>
        <FollowPath path="{path}" tracking_feedback="{t}"/></ReactiveSequence></Sequence>"#;
    let follow = r#""leaves": {"FollowPath": {"run_ms": 500}}"#;
    assert_eq!(of(bounds, &format!("{{{follow}}}")), (Status::Success, 500));
    let away = r#"{"position_tracking_error": -0.3, "heading_tracking_error": 0.0}"#;
    assert_eq!(
        of(bounds, &format!("{{{follow}, \"blackboard\": {{\"t\": {away}}}}}")),
        (Status::Failure, 0)
    );

    let near = r#"<ArePosesNear ref_pose="{a}" target_pose="{b}" tolerance="0.5"/>"#;
    let at = |b: &str| format!(r#"{{"blackboard": {{"a": "0;0;0", "b": "{b}"}}}}"#);
    assert_eq!(of(near, &at("0.1;0;0")).0, Status::Success);
    assert_eq!(of(near, &at("0.4;0.4;0")).0, Status::Failure);
    assert_eq!(of(near, "{}").0, Status::Failure);

    for timer in [
        r#"PathExpiringTimer seconds="2" path="{p}""#,
        r#"TimeExpired seconds="2""#,
    ] {
        let body =
            format!("<ReactiveSequence><Inverter><{timer}/></Inverter><Sleep msec=\"9000\"/></ReactiveSequence>");
        let expected = if timer.starts_with("Path") {
            (Status::Failure, 2000)
        } else {
            (Status::Success, 9000)
        };
        assert_eq!(of(&body, "{}"), expected, "{timer}");
    }
}

#[test]
fn leaves_that_nobody_declares_are_actions_unless_called_conditions() {
    let tree = r#"<root><BehaviorTree ID="A"><Sequence><Grab/><Inverter><Condition ID="Seen"/></Inverter>
        <Action ID="Put" where="{place}"/></Sequence></BehaviorTree></root>"#;
    let outcome = run(tree, r#"{"leaves": {"Put": {"fail": [[1, 1]], "set": {"where": 3}}}}"#);
    assert_eq!(outcome.status, Status::Failure);
    assert_eq!(
        serde_json::to_value(&outcome.counts).unwrap(),
        serde_json::json!({"Grab": 1, "Seen": 1, "Put": 1})
    );
}
