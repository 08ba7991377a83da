//! Nav2's other nodes. Which nodes are there, and what are their ports? Names, kinds, types and defaults of nav2_behavior_tree 1.5, as
//! data.
//!
//! A tree that uses a declared node can be read, checked and drawn; a leaf registered under the same id implements the node.

use crate::ports::{Direction, PortType};
use crate::registry::{Category, NodeSpec};

/// One node per line: category, id, ports. A port is `name:type=default`, with `>` before an output, and `!` before an input without which
/// the node always fails; `@server`, `@service` and `@error` are common groups of ports.
const NODES: &str = "\
Action BackUp backup_dist:double=0.15 backup_speed:double=0.025 time_allowance:double=10.0 disable_collision_checks:bool=false @server @error
Action DriveOnHeading dist_to_travel:double=0.15 speed:double=0.025 time_allowance:double=10.0 disable_collision_checks:bool=false @server @error
Action CancelControl @server
Action CancelBackUp @server
Action CancelDriveOnHeading @server
Action CancelSpin @server
Action CancelAssistedTeleop @server
Action CancelWait @server
Action CancelComputeAndTrackRoute @server
Action CancelFollowObject @server
Action ClearEntireCostmap @service plugins:vector<string>
Action ClearCostmapExceptRegion reset_distance:double=1.0 @service plugins:vector<string>
Action ClearCostmapAroundRobot reset_distance:double=1.0 @service plugins:vector<string>
Action ClearCostmapAroundPose pose:PoseStamped reset_distance:double=1.0 @service plugins:vector<string>
Action ComputePathToPose start:PoseStamped use_start:bool !goal:PoseStamped viapoints:vector<PoseStamped> planner_id:string= @server >path:Path @error
Action ComputePathThroughPoses start:PoseStamped !goals:Goals planner_id:string= @server >path:Path >last_reached_index:int @error
Action ComputeRoute start:PoseStamped goal:PoseStamped start_id:uint goal_id:uint use_start:bool=false use_poses:bool=false @server >route:Route >path:Path >planning_time:Duration @error
Action ComputeAndTrackRoute start:PoseStamped goal:PoseStamped start_id:uint goal_id:uint use_start:bool=false use_poses:bool=false @server >execution_duration:Duration >last_node_id:uint >next_node_id:uint >current_edge_id:uint >route:Route >path:Path >rerouted:bool @error
Action RemovePassedGoals radius:double=0.5 robot_base_frame:string !input_goals:Goals input_waypoint_statuses:vector<WaypointStatus> >output_goals:Goals >output_waypoint_statuses:vector<WaypointStatus>
Action RemoveInCollisionGoals !input_goals:Goals cost_threshold:double=254.0 use_footprint:bool=true consider_unknown_as_obstacle:bool=false input_waypoint_statuses:vector<WaypointStatus> @service >output_goals:Goals >output_waypoint_statuses:vector<WaypointStatus>
Action SmoothPath !unsmoothed_path:Path max_smoothing_duration:double=3.0 check_for_collisions:bool=false smoother_id:string @server >smoothed_path:Path >smoothing_duration:double >was_completed:bool @error
Action FollowPath !path:Path controller_id:string goal_checker_id:string progress_checker_id:string path_handler_id:string @server >tracking_feedback:TrackingFeedback @error
Action FollowObject pose_topic:string=dynamic_pose max_duration:double=0.0 tracked_frame:string @server >total_elapsed_time:Duration @error
Action NavigateToPose !goal:PoseStamped behavior_tree:string @server @error
Action NavigateThroughPoses !goals:Goals behavior_tree:string @server @error
Action ReinitializeGlobalLocalization @service
Action TruncatePath !input_path:Path distance:double=1.0 >output_path:Path
Action TruncatePathLocal !input_path:Path distance_forward:double=8.0 distance_backward:double=4.0 robot_base_frame:string transform_tolerance:double=0.2 pose:PoseStamped angular_distance_weight:double=0.0 max_robot_pose_search_dist:double=inf >output_path:Path
Action PlannerSelector topic_name:string=planner_selector default_planner:string >selected_planner:string
Action ControllerSelector topic_name:string=controller_selector default_controller:string >selected_controller:string
Action SmootherSelector topic_name:string=smoother_selector default_smoother:string >selected_smoother:string
Action GoalCheckerSelector topic_name:string=goal_checker_selector default_goal_checker:string >selected_goal_checker:string
Action ProgressCheckerSelector topic_name:string=progress_checker_selector default_progress_checker:string >selected_progress_checker:string
Action PathHandlerSelector topic_name:string=path_handler_selector default_path_handler:string >selected_path_handler:string
Action Spin spin_dist:double=1.57 time_allowance:double=10.0 is_recovery:bool=true disable_collision_checks:bool=false @server @error
Action Wait wait_duration:double=1.0 @server @error
Action AssistedTeleop is_recovery:bool=false time_allowance:double=10.0 @server @error
Action DockRobot use_dock_id:bool=true dock_id:string dock_pose:PoseStamped dock_type:string max_staging_time:double=1000.0 navigate_to_staging_pose:bool=true @server >success:bool >num_retries:uint @error
Action UndockRobot dock_type:string max_undocking_time:double=30.0 @server >success:bool @error
Action GetPoseFromPath !path:Path index:int=0 >pose:PoseStamped
Action ToggleCollisionMonitor enable:bool=true @service
Action GetCurrentPose robot_base_frame:string global_frame:string >current_pose:PoseStamped
Action ConcatenatePaths input_path1:Path input_path2:Path >output_path:Path
Action AppendGoalPoseToGoals !goal_pose:PoseStamped input_goals:Goals >output_goals:Goals
Action ExtractRouteNodesAsGoals route:Route >goals:Goals
Action GetNextFewGoals !num_goals:int !input_goals:Goals >output_goals:Goals
Action CheckPoseOccupancy !pose:PoseStamped cost_threshold:double=254.0 use_footprint:bool=true consider_unknown_as_obstacle:bool=false @service
Action CheckStopStatus velocity_threshold:double=0.01 duration_stopped:ms=1000
Action ValidatePath !path:Path max_cost:uint=254 consider_unknown_as_obstacle:bool=false layer_name:string= footprint:string= stop_at_first_collision:bool=true max_lookahead_distance:double=-1.0 @service >collision_poses:vector<PoseStamped>
Condition IsPathValid !path:Path max_cost:uint=253 consider_unknown_as_obstacle:bool=false @service
Condition GoalReached !goal:PoseStamped robot_base_frame:string
Condition IsStuck
Condition TransformAvailable child:string= parent:string=
Condition GoalUpdated goal:PoseStamped goals:Goals
Condition GlobalUpdatedGoal goal:PoseStamped goals:Goals
Condition IsBatteryLow min_battery:double battery_topic:string=/battery_status is_voltage:bool=false
Condition IsBatteryCharging battery_topic:string=/battery_status
Condition DistanceTraveled distance:double=1.0 global_frame:string robot_base_frame:string
Condition TimeExpired seconds:double=1.0
Condition PathExpiringTimer seconds:double=1.0 path:Path
Condition InitialPoseReceived initial_pose_received:bool
Condition WouldAControllerRecoveryHelp error_code:uint error_codes_to_check:vector<int>
Condition WouldAPlannerRecoveryHelp error_code:uint error_codes_to_check:vector<int>
Condition WouldASmootherRecoveryHelp error_code:uint error_codes_to_check:vector<int>
Condition WouldARouteRecoveryHelp error_code:uint error_codes_to_check:vector<int>
Condition AreErrorCodesPresent error_code:uint error_codes_to_check:vector<int>
Condition ArePosesNear ref_pose:PoseStamped target_pose:PoseStamped global_frame:string tolerance:double=0.5
Condition IsGoalNearby !path:Path proximity_threshold:double=1.0 max_robot_pose_search_dist:double=-1.0 global_frame:string robot_base_frame:string
Condition IsWithinPathTrackingBounds max_error_left:double=0.5 max_error_right:double=0.5 max_error_heading:double=3.14 tracking_feedback:TrackingFeedback
Decorator DistanceController distance:double=1.0 global_frame:string robot_base_frame:string
Decorator GoalUpdater input_goal:PoseStamped input_goals:Goals >output_goal:PoseStamped >output_goals:Goals
Decorator SpeedController min_rate:double=0.1 max_rate:double=1.0 min_speed:double=0.0 max_speed:double=0.5 goal:PoseStamped goals:Goals
Decorator PathLongerOnApproach path:Path prox_len:double=3.0 length_factor:double=2.0
Decorator GoalUpdatedController goal:PoseStamped goals:Goals
";

/// Specifications of Nav2's nodes that are not built in.
pub fn specs() -> Vec<NodeSpec> {
    NODES.lines().filter_map(node).collect()
}

fn node(line: &str) -> Option<NodeSpec> {
    let mut words = line.split_ascii_whitespace();
    let category = Category::from_tag(words.next()?)?;
    let mut spec = NodeSpec::new(category, words.next()?, "");
    for word in words {
        spec = match word {
            "@server" => spec
                .input_optional("server_name", PortType::Text, "action server to ask")
                .input_optional("server_timeout", PortType::Unsigned, "time for its acknowledgement, ms"),
            "@service" => spec
                .input_optional("service_name", PortType::Text, "service to ask")
                .input_optional("server_timeout", PortType::Unsigned, "time for its answer, ms"),
            "@error" => spec
                .output("error_code_id", PortType::Unsigned, "why it failed; 0: it did not")
                .output("error_msg", PortType::Text, "why it failed, in words"),
            port => add_port(spec, port)?,
        };
    }
    Some(spec)
}

fn add_port(spec: NodeSpec, port: &str) -> Option<NodeSpec> {
    let (direction, port) = match port.strip_prefix('>') {
        Some(output) => (Direction::Output, output),
        None => (Direction::Input, port),
    };
    let (is_required, port) = match port.strip_prefix('!') {
        Some(required) => (true, required),
        None => (false, port),
    };
    let (name, kind) = port.split_once(':')?;
    let (kind, default) = match kind.split_once('=') {
        Some((kind, default)) => (kind, Some(default)),
        None => (kind, None),
    };
    let kind = match kind {
        "uint" | "ms" => PortType::Unsigned,
        other => PortType::from_name(other),
    };
    let doc = if is_required { "without it the node fails" } else { "" };
    Some(spec.port(name, direction, kind, default, is_required, doc))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nav2::controls;

    #[test]
    fn every_line_is_a_node_whose_defaults_fit_their_ports() {
        let specs = specs();
        assert_eq!(specs.len(), NODES.lines().count());
        let built_in = controls::<()>();
        for spec in &specs {
            assert!(built_in.spec(&spec.id).is_none(), "{} is built in", spec.id);
            for port in &spec.ports {
                if let Some(default) = &port.default {
                    assert!(port.kind.parse(default).is_some(), "{} {}", spec.id, port.name);
                }
            }
        }
    }

    #[test]
    fn nav2_has_81_nodes_of_which_eight_are_built_in_and_older_releases_one_more() {
        assert_eq!(specs().len(), 73 + 1);
    }
}
