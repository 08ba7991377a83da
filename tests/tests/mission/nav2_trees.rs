//! Claims about trees in the style of Nav2 on this stack: rewritten with the nodes and structure of Nav2's own.

use nalgebra::Point2;
use zenav_protocol::messages::{GoalPhase, GoalRequest, MapAction};

use super::rig::{Rig, room, through, to};

const DEFAULT: &str = include_str!("../../../cloud/behaviour_tree/src/tests/navigate.xml");

const SELECT: &str = r#"<ControllerSelector selected_controller="{controller}" default_controller="FollowPath" topic_name="controller_selector"/>
    <PlannerSelector selected_planner="{planner}" default_planner="GridBased" topic_name="planner_selector"/>"#;
const PLAN: &str = r#"<ComputePathToPose goal="{goal}" path="{path}" planner_id="{planner}" error_code_id="{plan_code}" error_msg="{plan_msg}"/>"#;
const FOLLOW: &str = r#"<FollowPath path="{path}" controller_id="{controller}" error_code_id="{follow_code}" error_msg="{follow_msg}" tracking_feedback="{tracking}"/>"#;

/// A complete tree file around these nodes.
fn file(nodes: &str) -> String {
    format!(
        "<root BTCPP_format=\"4\" main_tree_to_execute=\"Main\"><BehaviorTree ID=\"Main\">{nodes}</BehaviorTree></root>"
    )
}

/// A tree that replans while driving, at the rate of a decorator.
fn replanning(open: &str, close: &str) -> String {
    file(&format!(
        "<PipelineSequence>{SELECT}{open}{PLAN}{close}{FOLLOW}</PipelineSequence>"
    ))
}

fn goal(tree: &str, x: f64, y: f64) -> GoalRequest {
    GoalRequest {
        tree: Some(tree.into()),
        ..to(x, y, "g")
    }
}

/// A rig with a tree as its goal, started.
fn begin(request: GoalRequest) -> Rig {
    let mut rig = Rig::new();
    rig.submit(request).unwrap();
    rig
}

/// Drives a tree to its end.
fn drive(request: GoalRequest) -> Rig {
    let mut rig = begin(request);
    rig.end_of("g", 120.0);
    rig
}

/// Runs a tree that must drive to this point.
#[track_caller]
fn assert_there(rig: &mut Rig, x: f64, y: f64) {
    rig.success_of("g", 60.0);
    assert!(rig.distance(x, y) < 0.15, "{:?}", rig.pose());
}

fn runs(rig: &Rig, name: &str) -> bool {
    let nodes = &rig.status.as_ref().unwrap().nodes;
    nodes.iter().any(|node| node.name == name && node.status == "RUNNING")
}

#[test]
fn nav2s_default_tree_drives_to_a_goal_and_plans_anew_while_it_is_far() {
    let mut rig = begin(goal(DEFAULT, 7.0, 0.0));
    assert_there(&mut rig, 7.0, 0.0);
    // Once a second until four metres are left.
    assert!((3..=8).contains(&rig.trajectories()), "{}", rig.trajectories());
    let last_begun = rig.plans.iter().rev().find(|plan| plan.splice.is_some()).unwrap();
    let left = last_begun.trajectory.last().unwrap().t;
    assert!(left > 4.0, "near the goal a free path is kept: {left} s");
}

#[test]
fn nav2s_default_tree_drives_a_short_path_on_one_plan() {
    let mut rig = begin(goal(DEFAULT, 3.0, 0.0));
    assert_there(&mut rig, 3.0, 0.0);
    assert_eq!(rig.trajectories(), 1);
}

#[test]
fn nav2s_default_tree_goes_round_what_turns_up() {
    let mut rig = begin(goal(DEFAULT, 5.0, 0.0));
    rig.run(3.0);
    rig.occupy(4.0, 0.0, 0.2);
    assert_there(&mut rig, 5.0, 0.0);
    assert!(
        rig.plans.iter().any(|plan| plan.waypoints.len() > 1),
        "the path round it has a corner"
    );
}

#[test]
fn nav2s_default_tree_gives_up_where_no_recovery_can_help_and_tells_the_reason() {
    let mut rig = Rig::on(room(|at| at.y.abs() > 0.8));
    (rig.config.settings.patience, rig.config.settings.linger) = (0.0, 0.0);
    rig.start();
    rig.submit(goal(DEFAULT, 5.0, 0.0)).unwrap();
    rig.occupy(2.0, 0.0, 0.45);
    let state = rig.end_of("g", 120.0);
    assert_eq!(state.state, GoalPhase::Aborted);
    assert!(state.reason.as_ref().unwrap().contains("no path"), "{:?}", state.reason);
}

#[test]
fn nav2s_default_tree_survives_a_restart_in_mid_drive() {
    let mut rig = begin(goal(DEFAULT, 7.0, 0.0));
    rig.run(6.0);
    rig.kill();
    rig.run(1.0);
    rig.start();
    assert_there(&mut rig, 7.0, 0.0);
    assert_eq!(rig.goal("g").legs.len(), 1);
}

#[test]
fn a_running_default_tree_stores_no_snapshot_in_most_ticks() {
    let mut rig = begin(goal(DEFAULT, 7.0, 0.0));
    rig.run(3.0);
    let before = rig.writes;
    rig.run(5.0);
    let writes = rig.writes - before;
    // Five seconds are 125 ticks.
    assert!(writes < 60, "{writes}");
}

#[test]
fn paths_are_planned_again_by_time_by_distance_by_speed_and_on_a_new_goal() {
    for (open, close, expected) in [
        ("<RateController hz=\"0.5\">", "</RateController>", 3..=9),
        ("<DistanceController distance=\"2.0\">", "</DistanceController>", 2..=4),
        (
            "<SpeedController min_rate=\"0.1\" max_rate=\"0.5\" min_speed=\"0.0\" max_speed=\"0.4\">",
            "</SpeedController>",
            3..=9,
        ),
        ("<GoalUpdatedController>", "</GoalUpdatedController>", 1..=1),
    ] {
        let mut rig = begin(goal(&replanning(open, close), 5.0, 0.0));
        assert_there(&mut rig, 5.0, 0.0);
        assert!(expected.contains(&rig.trajectories()), "{open}: {}", rig.trajectories());
    }
}

#[test]
fn a_path_is_planned_again_when_it_is_old_or_no_longer_valid() {
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
    let mut rig = begin(goal(&tree, 7.0, 0.0));
    assert_there(&mut rig, 7.0, 0.0);
    assert!((2..=4).contains(&rig.trajectories()), "{}", rig.trajectories());
}

#[test]
fn a_path_through_poses_passes_all_of_them() {
    let tree = file(&format!(
        r#"<RecoveryNode number_of_retries="6"><PipelineSequence>{SELECT}
          <RateController hz="0.333"><RecoveryNode><ReactiveSequence>
            <RemovePassedGoals input_goals="{{goals}}" output_goals="{{goals}}" radius="0.7" input_waypoint_statuses="{{waypoint_statuses}}" output_waypoint_statuses="{{waypoint_statuses}}"/>
            <ComputePathThroughPoses goals="{{goals}}" path="{{path}}" planner_id="{{planner}}" error_code_id="{{plan_code}}"/>
          </ReactiveSequence><ClearEntireCostmap service_name="global_costmap/clear_entirely_global_costmap"/></RecoveryNode></RateController>
          {FOLLOW}</PipelineSequence><Wait wait_duration="1.0"/></RecoveryNode>"#
    ));
    let stops = [(2.0, 0.0), (2.0, 3.0), (-1.0, 3.0)];
    let mut rig = begin(GoalRequest {
        tree: Some(tree),
        ..through(&stops, "g")
    });
    let nearest = rig.success_past("g", 60.0, &stops);
    assert_there(&mut rig, -1.0, 3.0);
    assert!(nearest.iter().all(|near| *near < 0.7), "{nearest:?}");
}

#[test]
fn a_replan_of_the_follower_still_passes_the_goals_ahead() {
    let tree = file(&format!(
        "<Sequence><ComputePathThroughPoses goals=\"{{goals}}\" path=\"{{path}}\"/>{}</Sequence>",
        FOLLOW.replace("controller_id=\"{controller}\" ", "")
    ));
    let mut rig = begin(GoalRequest {
        tree: Some(tree),
        ..through(&[(3.0, 0.0), (3.0, 3.0)], "g")
    });
    rig.run(2.0);
    rig.occupy(2.0, 0.0, 0.2);
    let near = rig.success_past("g", 60.0, &[(3.0, 0.0)])[0];
    assert_there(&mut rig, 3.0, 3.0);
    assert!(rig.goal("g").feedback.replans > 0 && near < 0.3, "{near}");
}

#[test]
fn a_tree_that_checks_the_bounds_of_the_path_drives_within_them() {
    let tree = file(&format!(
        "<Sequence>{PLAN}<ReactiveSequence><IsWithinPathTrackingBounds max_error_left=\"0.2\" max_error_right=\"0.2\" max_error_heading=\"3.14\" tracking_feedback=\"{{tracking}}\"/>{FOLLOW}</ReactiveSequence></Sequence>"
    ));
    assert_there(&mut begin(goal(&tree, 4.0, 1.0)), 4.0, 1.0);
    // A robot that swerves leaves the bounds.
    let mut rig = begin(goal(&tree, 6.0, 0.0));
    rig.run(4.0);
    rig.wheels = Some([2.0, 4.0]);
    let state = rig.end_of("g", 5.0);
    assert_eq!(state.state, GoalPhase::Aborted);
    assert!(
        state.reason.as_ref().unwrap().contains("beside the path"),
        "{:?}",
        state.reason
    );
}

#[test]
fn a_much_longer_path_near_the_goal_is_waited_out() {
    let tree = file(&format!(
        r#"<PipelineSequence>{SELECT}<RateController hz="1.0">{PLAN}</RateController>
          <ReactiveSequence>
            <PathLongerOnApproach path="{{path}}" prox_len="3.0" length_factor="2.0"><RetryUntilSuccessful num_attempts="1">
              <SequenceWithMemory><CancelControl/><Wait wait_duration="2.0"/></SequenceWithMemory>
            </RetryUntilSuccessful></PathLongerOnApproach>
            {FOLLOW}
          </ReactiveSequence></PipelineSequence>"#
    ));
    // A wall with a door ahead, and another door far to the side.
    let is_door = |y: f64| y.abs() < 0.6 || (3.0..4.2).contains(&y);
    let mut rig = Rig::on(room(|at| (at.x - 3.85).abs() < 0.1 && !is_door(at.y)));
    rig.submit(goal(&tree, 5.0, 0.0)).unwrap();
    assert!(rig.run_until(10.0, |rig| rig.pose().x > 2.1));
    rig.occupy(3.85, 0.0, 0.4);
    assert!(rig.run_until(5.0, |rig| runs(rig, "Wait")), "{:#?}", rig.status);
    assert!(rig.pose().x < 3.4, "it stands and waits");
    assert_there(&mut rig, 5.0, 0.0);
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
    let update = serde_json::json!({"x": 3.0, "y": 0.0, "stamp": 5});
    let mut rig = begin(GoalRequest {
        blackboard: [("goal_update".to_owned(), update)].into(),
        ..goal(&tree, 6.0, 0.0)
    });
    rig.run(30.0);
    assert_eq!(rig.phase("g"), GoalPhase::Active, "it follows for ever");
    assert!((rig.pose().x - 2.0).abs() < 0.15, "{:?}", rig.pose());
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
    let mut rig = begin(goal(&tree, 0.0, 0.0));
    let near = rig.success_past("g", 60.0, &[(2.0, 0.0)])[0];
    assert_there(&mut rig, 2.0, 2.0);
    assert!(near < 0.3, "the corner is part of the path: {near}");
}

#[test]
fn a_pause_of_the_goal_reaches_a_tree_that_has_a_node_for_it() {
    let tree = file(
        r#"<PauseResumeController pause_service_name="hold" resume_service_name="go">
            <NavigateToPose goal="{goal}"/><Wait name="Held" wait_duration="1000"/><Wait name="Stops" wait_duration="0.5"/>
          </PauseResumeController>"#,
    );
    let mut rig = begin(goal(&tree, 4.0, 0.0));
    rig.run(2.0);
    rig.pause(false);
    assert!(rig.run_until(1.0, |rig| runs(rig, "Stops")) && rig.run_until(2.0, |rig| runs(rig, "Held")));
    rig.run(3.0);
    let held_at = rig.driven();
    rig.run(3.0);
    assert!(rig.phase("g") == GoalPhase::Paused && rig.driven() - held_at < 0.01);
    rig.pause(true);
    assert_there(&mut rig, 4.0, 0.0);
}

#[test]
fn a_whole_navigation_is_an_action_that_survives_a_restart() {
    let tree = file(
        r#"<Sequence><NavigateToPose goal="2;0"/><NavigateThroughPoses goals="2;2|0;2" error_code_id="{code}"/></Sequence>"#,
    );
    let mut rig = begin(goal(&tree, 0.0, 0.0));
    for _ in 0..4 {
        rig.run(2.0);
        rig.kill();
        rig.run(1.0);
        rig.start();
    }
    assert_there(&mut rig, 0.0, 2.0);
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
    assert_eq!(rig.phase("g"), GoalPhase::Aborted);
}

#[test]
fn what_this_stack_does_not_have_fails_and_names_it() {
    for (node, what) in [
        (r#"<ComputeRoute goal="{goal}" path="{path}"/>"#, "route server"),
        (r#"<DockRobot dock_id="d"/>"#, "docking"),
        (r#"<ReinitializeGlobalLocalization/>"#, "nothing looks for the robot"),
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
fn a_battery_a_clock_and_a_bump_are_watched() {
    let tree = file(
        r#"<ReactiveFallback><DistanceTraveled distance="1.0"/><IsStuck/><Inverter><IsBatteryLow min_battery="0.5"/></Inverter></ReactiveFallback>"#,
    );
    assert_eq!(drive(goal(&tree, 3.0, 0.0)).phase("g"), GoalPhase::Succeeded);
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
    assert_eq!(rig.phase("g"), GoalPhase::Succeeded);
    assert_eq!(rig.map_actions(), [MapAction::Forget]);
}

#[test]
fn goals_in_collision_are_left_out() {
    let mut rig = Rig::on(room(|at| (at.x - 2.05).hypot(at.y - 2.05) < 0.1));
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
    assert_there(&mut rig, 3.0, 0.0);
    let waypoints = &rig.plans.last().unwrap().waypoints;
    assert!(waypoints.contains(&Point2::new(1.0, 0.0)) && waypoints.iter().all(|point| point.y.abs() < 0.1));
}
