//! Claims about trees of Nav2's kinds on this stack: written anew here, with the nodes and the shapes that Nav2's have.

use nalgebra::Point2;
use zenav_protocol::messages::*;
use zenav_protocol::topics::MissionRequest;

use super::rig::Rig;
use crate::context::Context;
use crate::io::Ask;
use crate::trees::registry;
use zenav_behaviour_tree::{Category, Limits, Registry, check, simulate};

const DEFAULT: &str = include_str!("../../../behaviour_tree/src/tests/navigate.xml");

const SELECT: &str = r#"<ControllerSelector selected_controller="{controller}" default_controller="FollowPath" topic_name="controller_selector"/>
    <PlannerSelector selected_planner="{planner}" default_planner="GridBased" topic_name="planner_selector"/>"#;
const PLAN: &str = r#"<ComputePathToPose goal="{goal}" path="{path}" planner_id="{planner}" error_code_id="{plan_code}" error_msg="{plan_msg}"/>"#;
const FOLLOW: &str = r#"<FollowPath path="{path}" controller_id="{controller}" error_code_id="{follow_code}" error_msg="{follow_msg}" tracking_feedback="{tracking}"/>"#;

/// A whole file around the nodes of a tree.
fn file(nodes: &str) -> String {
    format!(
        "<root BTCPP_format=\"4\" main_tree_to_execute=\"Main\"><BehaviorTree ID=\"Main\">{nodes}</BehaviorTree></root>"
    )
}

/// Planning again while driving, in the rhythm of a decorator.
fn replanning(open: &str, close: &str) -> String {
    file(&format!(
        "<PipelineSequence>{SELECT}{open}{PLAN}{close}{FOLLOW}</PipelineSequence>"
    ))
}

fn goal(tree: &str, x: f64, y: f64) -> GoalRequest {
    GoalRequest {
        id: Some("g".into()),
        x: Some(x),
        y: Some(y),
        tree: Some(tree.into()),
        ..GoalRequest::default()
    }
}

/// Drives a tree to its end.
fn drive(request: GoalRequest) -> Rig {
    let mut rig = Rig::new();
    rig.submit(request).unwrap();
    assert!(rig.run_until(120.0, |rig| rig.state("g").is_end()), "{:#?}", rig.status);
    rig
}

#[track_caller]
fn assert_there(rig: &Rig, x: f64, y: f64) {
    let state = rig.goal("g");
    assert_eq!(state.state, GoalPhase::Succeeded, "{:?}", state.reason);
    let pose = rig.edge.pose;
    assert!((pose.x - x).hypot(pose.y - y) < 0.15, "{pose:?}");
}

fn motions(rig: &Rig) -> usize {
    let mut ids: Vec<u64> = rig.plans.iter().map(|(_, plan)| plan.trajectory_id).collect();
    ids.dedup();
    ids.len()
}

#[test]
fn nav2s_default_tree_drives_to_a_goal_and_plans_anew_while_it_is_far() {
    let rig = drive(goal(DEFAULT, 7.0, 0.0));
    assert_there(&rig, 7.0, 0.0);
    // Once a second until four metres are left.
    assert!((3..=8).contains(&motions(&rig)), "{}", motions(&rig));
    let last_begun = rig.plans.iter().rev().find(|(_, plan)| plan.splice.is_some()).unwrap();
    let left = last_begun.1.trajectory.last().unwrap().t;
    assert!(left > 4.0, "near the goal a free way is kept: {left} s");
}

#[test]
fn nav2s_default_tree_drives_a_short_way_on_one_plan() {
    let rig = drive(goal(DEFAULT, 3.0, 0.0));
    assert_there(&rig, 3.0, 0.0);
    assert_eq!(motions(&rig), 1);
}

#[test]
fn nav2s_default_tree_goes_round_what_turns_up() {
    let mut rig = Rig::new();
    rig.submit(goal(DEFAULT, 5.0, 0.0)).unwrap();
    rig.run(3.0);
    rig.occupy(4.0, 0.0);
    rig.remap();
    assert!(rig.run_until(60.0, |rig| rig.state("g").is_end()));
    assert_there(&rig, 5.0, 0.0);
    assert!(
        rig.plans.iter().any(|(_, plan)| plan.waypoints.len() > 1),
        "the way round has a corner"
    );
}

#[test]
fn nav2s_default_tree_gives_up_where_no_recovery_can_help_and_tells_the_reason() {
    let mut rig = Rig::new();
    rig.plans_none = true;
    rig.submit(goal(DEFAULT, 5.0, 0.0)).unwrap();
    assert!(rig.run_until(120.0, |rig| rig.state("g").is_end()));
    let state = rig.goal("g");
    assert_eq!(state.state, GoalPhase::Aborted);
    assert!(state.reason.as_ref().unwrap().contains("no path"), "{:?}", state.reason);
}

#[test]
fn nav2s_default_tree_survives_a_restart_in_mid_drive() {
    let mut rig = Rig::new();
    rig.submit(goal(DEFAULT, 7.0, 0.0)).unwrap();
    rig.run(6.0);
    rig.kill();
    rig.run(1.0);
    rig.start();
    assert!(rig.run_until(60.0, |rig| rig.state("g").is_end()));
    assert_there(&rig, 7.0, 0.0);
    assert_eq!(rig.goal("g").legs.len(), 1);
}

#[test]
fn a_running_default_tree_stores_no_snapshot_in_most_ticks() {
    let mut rig = Rig::new();
    rig.submit(goal(DEFAULT, 7.0, 0.0)).unwrap();
    rig.run(3.0);
    rig.dies_after_writes = Some(1000);
    rig.run(5.0);
    let writes = 1000 - rig.dies_after_writes.unwrap();
    // Five seconds are a hundred ticks.
    assert!(writes < 60, "{writes}");
}

#[test]
fn ways_are_planned_again_by_time_by_distance_by_speed_and_on_a_new_goal() {
    for (open, close, motions_expected) in [
        ("<RateController hz=\"0.5\">", "</RateController>", 3..=9),
        ("<DistanceController distance=\"2.0\">", "</DistanceController>", 2..=4),
        (
            "<SpeedController min_rate=\"0.1\" max_rate=\"0.5\" min_speed=\"0.0\" max_speed=\"0.4\">",
            "</SpeedController>",
            3..=9,
        ),
        ("<GoalUpdatedController>", "</GoalUpdatedController>", 1..=1),
    ] {
        let rig = drive(goal(&replanning(open, close), 6.0, 0.0));
        assert_there(&rig, 6.0, 0.0);
        assert!(motions_expected.contains(&motions(&rig)), "{open}: {}", motions(&rig));
    }
}

#[test]
fn a_way_is_planned_again_when_it_is_old_or_no_longer_valid() {
    let tree = replanning(
        r#"<RateController hz="2.0"><Fallback><ReactiveSequence>
            <TruncatePathLocal input_path="{path}" output_path="{rest}" distance_forward="-1" distance_backward="0.0"/>
            <ValidatePath path="{rest}"/>
            <Inverter><GlobalUpdatedGoal/></Inverter>
            <Fallback><IsGoalNearby path="{path}" proximity_threshold="2.0" max_robot_pose_search_dist="1.5"/>
              <Inverter><PathExpiringTimer seconds="4" path="{path}"/></Inverter></Fallback>
          </ReactiveSequence>"#,
        "</Fallback></RateController>",
    );
    let rig = drive(goal(&tree, 7.0, 0.0));
    assert_there(&rig, 7.0, 0.0);
    assert!((2..=4).contains(&motions(&rig)), "{}", motions(&rig));
}

#[test]
fn a_way_through_poses_passes_all_of_them() {
    let through = file(&format!(
        r#"<RecoveryNode number_of_retries="6"><PipelineSequence>{SELECT}
          <RateController hz="0.333"><RecoveryNode><ReactiveSequence>
            <RemovePassedGoals input_goals="{{goals}}" output_goals="{{goals}}" radius="0.7" input_waypoint_statuses="{{waypoint_statuses}}" output_waypoint_statuses="{{waypoint_statuses}}"/>
            <ComputePathThroughPoses goals="{{goals}}" path="{{path}}" planner_id="{{planner}}" error_code_id="{{plan_code}}"/>
          </ReactiveSequence><ClearEntireCostmap service_name="global_costmap/clear_entirely_global_costmap"/></RecoveryNode></RateController>
          {FOLLOW}</PipelineSequence><Wait wait_duration="1.0"/></RecoveryNode>"#
    ));
    let stops = [(2.0, 0.0), (2.0, 3.0), (-1.0, 3.0)];
    let mut rig = Rig::new();
    rig.submit(GoalRequest {
        id: Some("g".into()),
        waypoints: stops
            .iter()
            .map(|(x, y)| GoalPoint {
                x: *x,
                y: *y,
                yaw: None,
            })
            .collect(),
        tree: Some(through),
        ..GoalRequest::default()
    })
    .unwrap();
    let mut nearest = [f64::INFINITY; 3];
    for _ in 0..2400 {
        rig.step();
        for (near, (x, y)) in nearest.iter_mut().zip(stops) {
            *near = near.min((rig.edge.pose.x - x).hypot(rig.edge.pose.y - y));
        }
    }
    assert_there(&rig, -1.0, 3.0);
    assert!(nearest.iter().all(|near| *near < 0.7), "{nearest:?}");
}

#[test]
fn a_replan_of_the_follower_still_passes_the_goals_ahead() {
    let tree = file(&format!(
        "<Sequence><ComputePathThroughPoses goals=\"{{goals}}\" path=\"{{path}}\"/>{}</Sequence>",
        FOLLOW.replace("controller_id=\"{controller}\" ", "")
    ));
    let mut rig = Rig::new();
    rig.submit(GoalRequest {
        id: Some("g".into()),
        waypoints: [(3.0, 0.0), (3.0, 3.0)]
            .map(|(x, y)| GoalPoint { x, y, yaw: None })
            .to_vec(),
        tree: Some(tree),
        ..GoalRequest::default()
    })
    .unwrap();
    rig.run(2.0);
    rig.occupy(1.8, 0.0);
    rig.remap();
    let mut near = f64::INFINITY;
    for _ in 0..1200 {
        rig.step();
        near = near.min((rig.edge.pose.x - 3.0).hypot(rig.edge.pose.y));
    }
    assert_there(&rig, 3.0, 3.0);
    assert!(rig.goal("g").feedback.replans > 0 && near < 0.3, "{near}");
}

#[test]
fn a_tree_that_checks_the_bounds_of_the_path_drives_within_them() {
    let tree = file(&format!(
        "<Sequence>{PLAN}<ReactiveSequence><IsWithinPathTrackingBounds max_error_left=\"0.2\" max_error_right=\"0.2\" max_error_heading=\"3.14\" tracking_feedback=\"{{tracking}}\"/>{FOLLOW}</ReactiveSequence></Sequence>"
    ));
    assert_there(&drive(goal(&tree, 4.0, 1.0)), 4.0, 1.0);
    // A robot that is pushed aside is out of them.
    let mut rig = Rig::new();
    rig.submit(goal(&tree, 6.0, 0.0)).unwrap();
    rig.run(4.0);
    rig.edge.stuck = true;
    rig.edge.pose.y += 0.5;
    assert!(rig.run_until(5.0, |rig| rig.state("g").is_end()));
    let state = rig.goal("g");
    assert_eq!(state.state, GoalPhase::Aborted);
    assert!(
        state.reason.as_ref().unwrap().contains("beside the path"),
        "{:?}",
        state.reason
    );
}

#[test]
fn a_much_longer_way_near_the_goal_is_waited_out() {
    let tree = file(&format!(
        r#"<PipelineSequence>{SELECT}<RateController hz="1.0">{PLAN}</RateController>
          <ReactiveSequence>
            <PathLongerOnApproach path="{{path}}" prox_len="3.0" length_factor="2.0"><RetryUntilSuccessful num_attempts="1">
              <SequenceWithMemory><CancelControl/><Wait wait_duration="5.0"/></SequenceWithMemory>
            </RetryUntilSuccessful></PathLongerOnApproach>
            {FOLLOW}
          </ReactiveSequence></PipelineSequence>"#
    ));
    let mut rig = Rig::new();
    rig.submit(goal(&tree, 5.0, 0.0)).unwrap();
    assert!(rig.run_until(10.0, |rig| rig.edge.pose.x > 2.1));
    rig.occupy(3.8, 0.0);
    rig.remap();
    let waits = |rig: &Rig| {
        let nodes = &rig.status.as_ref().unwrap().nodes;
        nodes.iter().any(|node| node.id == "Wait" && node.status == "RUNNING")
    };
    assert!(rig.run_until(5.0, waits), "{:#?}", rig.status);
    assert!(rig.edge.pose.x < 3.4, "it stands and waits");
    assert!(rig.run_until(60.0, |rig| rig.state("g").is_end()));
    assert_there(&rig, 5.0, 0.0);
}

#[test]
fn a_moving_goal_is_followed_at_a_distance() {
    let tree = file(&format!(
        r#"<PipelineSequence>{SELECT}<RateController hz="1.0"><Sequence>
            <GoalUpdater input_goal="{{goal}}" output_goal="{{target}}">
              <ComputePathToPose goal="{{target}}" path="{{path}}" planner_id="{{planner}}"/>
            </GoalUpdater>
            <TruncatePath distance="1.0" input_path="{{path}}" output_path="{{cut}}"/>
          </Sequence></RateController>
          <KeepRunningUntilFailure>{}</KeepRunningUntilFailure></PipelineSequence>"#,
        FOLLOW.replace("{path}", "{cut}")
    ));
    let mut rig = Rig::new();
    rig.submit(GoalRequest {
        blackboard: [(
            "goal_update".to_owned(),
            serde_json::json!({"x": 3.0, "y": 0.0, "stamp": 5}),
        )]
        .into(),
        ..goal(&tree, 6.0, 0.0)
    })
    .unwrap();
    rig.run(30.0);
    assert_eq!(rig.state("g"), GoalPhase::Active, "it follows for ever");
    assert!((rig.edge.pose.x - 2.0).abs() < 0.15, "{:?}", rig.edge.pose);
}

#[test]
fn paths_are_joined_and_smoothed_before_they_are_followed() {
    let tree = file(
        r#"<Sequence>
          <ComputePathToPose goal="2;0" path="{first}"/>
          <GetPoseFromPath path="{first}" index="-1" pose="{middle}"/>
          <Inverter><ArePosesNear ref_pose="{middle}" target_pose="2;2" tolerance="0.3"/></Inverter>
          <ComputePathToPose start="{middle}" goal="2;2" path="{second}"/>
          <ConcatenatePaths input_path1="{first}" input_path2="{second}" output_path="{both}"/>
          <SmoothPath unsmoothed_path="{both}" smoothed_path="{path}" smoother_id="route_smoother"/>
          <FollowPath path="{path}"/>
        </Sequence>"#,
    );
    let mut rig = Rig::new();
    rig.submit(goal(&tree, 0.0, 0.0)).unwrap();
    let mut near = f64::INFINITY;
    for _ in 0..800 {
        rig.step();
        near = near.min((rig.edge.pose.x - 2.0).hypot(rig.edge.pose.y));
    }
    assert_there(&rig, 2.0, 2.0);
    assert!(near < 0.3, "the corner is part of the way: {near}");
}

#[test]
fn a_pause_of_the_goal_reaches_a_tree_that_has_a_node_for_it() {
    let tree = file(
        r#"<PauseResumeController pause_service_name="hold" resume_service_name="go">
            <NavigateToPose goal="{goal}"/><Wait name="Held" wait_duration="1000"/><Wait name="Stops" wait_duration="0.5"/>
          </PauseResumeController>"#,
    );
    let pause = |rig: &mut Rig, resume: bool| {
        let request = PauseRequest {
            id: None,
            resume,
            request_id: None,
        };
        rig.answer(MissionRequest::Pause(request)).unwrap();
    };
    let runs = |rig: &Rig, name: &str| {
        let nodes = &rig.status.as_ref().unwrap().nodes;
        nodes.iter().any(|node| node.name == name && node.status == "RUNNING")
    };
    let mut rig = Rig::new();
    rig.submit(goal(&tree, 4.0, 0.0)).unwrap();
    rig.run(2.0);
    pause(&mut rig, false);
    assert!(rig.run_until(1.0, |rig| runs(rig, "Stops")) && rig.run_until(2.0, |rig| runs(rig, "Held")));
    rig.run(3.0);
    let held_at = rig.edge.driven;
    rig.run(3.0);
    assert_eq!((rig.state("g"), rig.edge.driven), (GoalPhase::Paused, held_at));
    pause(&mut rig, true);
    assert!(rig.run_until(60.0, |rig| rig.state("g").is_end()));
    assert_there(&rig, 4.0, 0.0);
}

#[test]
fn a_whole_navigation_is_an_action_that_survives_a_restart() {
    let tree = file(
        r#"<Sequence><NavigateToPose goal="2;0"/><NavigateThroughPoses goals="2;2|0;2" error_code_id="{code}"/></Sequence>"#,
    );
    let mut rig = Rig::new();
    rig.submit(goal(&tree, 0.0, 0.0)).unwrap();
    for _ in 0..4 {
        rig.run(2.0);
        rig.kill();
        rig.run(1.0);
        rig.start();
    }
    assert!(rig.run_until(60.0, |rig| rig.state("g").is_end()));
    assert_there(&rig, 0.0, 2.0);
    assert_eq!(rig.goal("g").legs.len(), 3, "no drive was begun twice");
}

#[test]
fn a_navigation_inside_itself_ends() {
    let tree = file(r#"<NavigateToPose goal="2;0" behavior_tree="{self}"/>"#);
    let inner = file(
        r#"<Sequence><Script code="self := @self"/><NavigateToPose goal="2;0" behavior_tree="{self}"/></Sequence>"#,
    );
    let request = GoalRequest {
        blackboard: [("self".to_owned(), inner.into())].into(),
        ..goal(&tree, 2.0, 0.0)
    };
    let rig = drive(request);
    assert_eq!(rig.state("g"), GoalPhase::Aborted);
}

#[test]
fn what_this_stack_does_not_have_fails_and_names_it() {
    for (node, what) in [
        (r#"<ComputeRoute goal="{goal}" path="{path}"/>"#, "route server"),
        (r#"<DockRobot dock_id="d"/>"#, "docking"),
        (r#"<ReinitializeGlobalLocalization/>"#, "global localization"),
        (
            r#"<ComputePathToPose goal="{goal}" path="{path}" planner_id="Unheard"/>"#,
            "expected one of GridBased, astar",
        ),
        (
            r#"<Sequence><ComputePathToPose goal="{goal}" path="{path}"/><FollowPath path="{path}" controller_id="MPPI"/></Sequence>"#,
            "expected one of FollowPath",
        ),
    ] {
        let rig = drive(goal(&file(node), 3.0, 0.0));
        let state = rig.goal("g");
        assert_eq!(state.state, GoalPhase::Aborted);
        assert!(state.reason.as_ref().unwrap().contains(what), "{:?}", state.reason);
    }
}

#[test]
fn every_node_of_nav2_can_stand_in_a_mission_tree_with_all_its_ports() {
    fn nodes<C>(registry: &Registry<C>) -> String {
        let specs = registry.specs().filter(|spec| spec.category != Category::SubTree);
        let node = |spec: &zenav_behaviour_tree::NodeSpec| {
            let value = |port: &zenav_behaviour_tree::PortSpec| match &port.default {
                Some(default) => default.clone(),
                None if matches!(port.kind, zenav_behaviour_tree::PortType::Script) => "1 == 1".to_owned(),
                None => format!("{{{}_{}}}", spec.id, port.name),
            };
            let ports: String = spec
                .ports
                .iter()
                .map(|port| format!(" {}=\"{}\"", port.name, value(port)))
                .collect();
            let children = "<AlwaysSuccess/>".repeat(spec.children.0);
            format!("<{0}{ports}>{children}</{0}>", spec.id)
        };
        specs.map(node).collect()
    }
    let text = file(&format!("<Sequence>{}</Sequence>", nodes(&simulate::registry())));
    let none = &mut |_: &str, _: &str| Err("none".to_owned());
    let summary = check::<Context>("all.xml", text.as_bytes(), registry(), none, Limits::default());
    let count = summary.unwrap_or_else(|errors| panic!("{errors}")).trees["Main"];
    assert!(count > 120, "{count}");
    crate::trees::build(&text).unwrap_or_else(|error| panic!("{error}"));
}

#[test]
fn a_battery_a_clock_and_a_bump_are_watched() {
    let tree = file(
        r#"<ReactiveFallback><DistanceTraveled distance="1.0"/><IsStuck/><Inverter><IsBatteryLow min_battery="0.5"/></Inverter></ReactiveFallback>"#,
    );
    assert_eq!(drive(goal(&tree, 3.0, 0.0)).state("g"), GoalPhase::Succeeded);
    let tree = file(
        r#"<Sequence><CheckStopStatus duration_stopped="500"/><WhileDoElse><TimeExpired seconds="2.0"/><AlwaysSuccess/><Sleep msec="60000"/></WhileDoElse></Sequence>"#,
    );
    let rig = drive(goal(&tree, 3.0, 0.0));
    let state = rig.goal("g");
    let took = state.ended.unwrap().secs_since(state.started.unwrap());
    assert!((2.4..3.5).contains(&took), "{took}");
}

#[test]
fn clearing_the_global_costmap_asks_mapping_to_forget_what_may_have_passed() {
    let tree = file(
        r#"<Sequence><ClearEntireCostmap service_name="local_costmap/clear_entirely_local_costmap"/>
          <ClearEntireCostmap service_name="global_costmap/clear_entirely_global_costmap"/></Sequence>"#,
    );
    let rig = drive(goal(&tree, 1.0, 0.0));
    assert_eq!(rig.state("g"), GoalPhase::Succeeded);
    let asked = rig.asked.iter().filter(|ask| {
        matches!(ask, Ask::Map(request) if request.action == MapAction::Forget && request.epoch.is_some() && request.request_id.is_some())
    });
    assert_eq!(asked.count(), 1);
}

#[test]
fn goals_in_collision_are_left_out() {
    let mut rig = Rig::new();
    rig.occupy(2.0, 2.0);
    rig.remap();
    let tree = file(
        r#"<Sequence>
          <AppendGoalPoseToGoals goal_pose="1;0" input_goals="{none}" output_goals="{a}"/>
          <AppendGoalPoseToGoals goal_pose="2;2" input_goals="{a}" output_goals="{a}"/>
          <AppendGoalPoseToGoals goal_pose="3;0" input_goals="{a}" output_goals="{a}"/>
          <CheckPoseOccupancy pose="2;2"/>
          <Inverter><CheckPoseOccupancy pose="1;0"/></Inverter>
          <RemoveInCollisionGoals input_goals="{a}" output_goals="{a}"/>
          <ComputePathThroughPoses goals="{a}" path="{path}"/>
          <FollowPath path="{path}"/>
        </Sequence>"#,
    );
    rig.submit(goal(&tree, 0.0, 0.0)).unwrap();
    assert!(rig.run_until(60.0, |rig| rig.state("g").is_end()));
    assert_there(&rig, 3.0, 0.0);
    let places: Vec<Point2<f64>> = rig.plans.last().unwrap().1.waypoints.clone();
    assert_eq!(places, [Point2::new(1.0, 0.0), Point2::new(3.0, 0.0)]);
}
