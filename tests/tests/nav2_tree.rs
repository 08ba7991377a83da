//! Does one of Nav2's trees drive zenav's robot? Its default tree for one goal, in the simulator, over the real bus.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use zenav_tests::deployment::{CORRIDOR, Deployment, ROBOT};
use zenav_tests::observer::Observer;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Nodes and structure of Nav2's default tree.
const TREE: &str = include_str!("../../cloud/behaviour_tree/src/tests/navigate.xml");

/// Plans once and fails as soon as the robot is 0.2 m off its path, like Nav2's trees. Any heading is allowed: the way back starts with a
/// turn in place.
const BOUNDS: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sequence>
    <ComputePathToPose goal="{goal}" path="{path}"/>
    <ReactiveSequence>
      <IsWithinPathTrackingBounds max_error_left="0.2" max_error_right="0.2" max_error_heading="3.2" tracking_feedback="{tracking}"/>
      <FollowPath path="{path}" tracking_feedback="{tracking}"/>
    </ReactiveSequence>
</Sequence></BehaviorTree></root>"#;

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_robot_keeps_to_its_path_round_the_corners_of_a_kitchen() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let _up = deployment.start_up();
    let bus = deployment.bus().await;
    let tree = deployment.folder().join("bounds.xml");
    std::fs::write(&tree, BOUNDS).unwrap();
    let tree = tree.to_string_lossy().into_owned();
    for place in ["corner", "sink"] {
        let submit = [
            "goal",
            "submit",
            "--place",
            place,
            "--robot",
            ROBOT,
            "--tree",
            &tree,
            "--wait",
            "-o",
            "json",
            "--timeout",
            "30",
        ];
        let ended = tokio::task::block_in_place(|| deployment.client(&submit));
        assert_eq!(ended.status.code(), Some(0), "{place}: {ended:?}");
    }
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn nav2s_default_tree_drives_a_robot_down_a_corridor_and_plans_again_on_the_way() {
    let deployment = Deployment::new(ZENAV, CORRIDOR, 4.0);
    let _up = deployment.start_up();
    let bus = deployment.bus().await;
    let mut robot = Observer::new(&bus, ROBOT);
    let tree = deployment.folder().join("navigate.xml");
    std::fs::write(&tree, TREE).unwrap();
    let tree = tree.to_string_lossy().into_owned();
    let submit = [
        "goal",
        "submit",
        "8",
        "0.5",
        "--robot",
        ROBOT,
        "--tree",
        &tree,
        "--wait",
        "-o",
        "json",
        "--timeout",
        "30",
    ];
    let ended = tokio::task::block_in_place(|| deployment.client(&submit));
    assert_eq!(ended.status.code(), Some(0), "{ended:?}");
    let report: serde_json::Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert!(report["replans"].as_u64().unwrap() > 0, "{report}");
    robot.assert_untouched();
}
