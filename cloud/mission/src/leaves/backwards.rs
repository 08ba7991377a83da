//! Tests of paths with legs that are driven backwards, from ComputePathToPose to FollowPath.

use nalgebra::Point2;
use zenav_behaviour_tree::Status;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{MotionReply, PlanReply, TrajectoryReply};
use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};

use super::path::DrivenPath;
use crate::rig::Drive;
use crate::route::RouteData;

/// Corners of a path on the blackboard, m along x, and its legs that are driven backwards.
fn driven(drive: &Drive, key: &str) -> (Vec<f64>, Vec<usize>) {
    let path = drive.path(key);
    (along(&path.points), path.backwards)
}

fn along(points: &[Point2<f64>]) -> Vec<f64> {
    points.iter().map(|point| point.x).collect()
}

/// One metre backwards, then ahead to the goal.
fn backs() -> Trajectory {
    let at = |(t, x, v)| TrajectoryPoint {
        t,
        x,
        v,
        ..TrajectoryPoint::default()
    };
    let points = [
        (0.0, 0.0, 0.0),
        (1.0, -0.5, -0.5),
        (2.0, -1.0, 0.0),
        (5.0, 5.0, 0.5),
        (8.0, 12.0, 0.0),
    ];
    points.map(at).into_iter().collect()
}

#[test]
fn a_leg_that_is_planned_backwards_stays_so_until_it_is_driven() {
    let mut drive = Drive::new(
        r#"<Sequence>
          <ComputePathToPose goal="12;0" path="{path}"/>
          <SmoothPath unsmoothed_path="{path}" smoothed_path="{smooth}"/>
          <FollowPath path="{smooth}" tracking_feedback="{tracking}"/>
        </Sequence>"#,
    );
    let expected = (vec![0.0, -1.0, 12.0], vec![0]);
    let plan = PlanReply {
        backwards: vec![0],
        ..drive.rig.found(&[(-1.0, 0.0)])
    };
    let found = TrajectoryReply {
        smooth: Some(drive.rig.smooth(backs())),
        plan,
        arrival_secs: None,
    };
    assert_eq!(drive.told(2.0, |_| MotionReply::Trajectory(found)), Status::Running);
    assert_eq!(driven(&drive, "path"), expected);
    let request = drive.smooths(backs());
    assert_eq!((along(&request.path), request.backwards), expected);
    assert!(request.start.distance(&Pose2::IDENTITY) < 1e-9 && request.start.yaw.abs() < 1e-9);
    assert_eq!(drive.tick(2.1), Status::Running);
    assert_eq!(driven(&drive, "smooth"), expected);
    let request = drive.smooths(backs());
    assert_eq!((along(&request.path), request.backwards), expected);
    let tracking = drive.tree.blackboard().get("tracking").unwrap().to_json();
    let error = tracking["heading_tracking_error"].as_f64().unwrap();
    assert!(error.abs() < 1e-9, "it faces away from where it drives: {error}");
}

#[test]
fn a_reverse_leg_that_is_behind_the_robot_is_not_driven_again() {
    let mut drive = Drive::new(r#"<FollowPath path="{cut}" tracking_feedback="{tracking}"/>"#);
    let path = DrivenPath {
        points: [0.0, -1.0, 12.0].map(|x| Point2::new(x, 0.0)).to_vec(),
        backwards: vec![0],
    };
    let cut = RouteData {
        driven: 1.5,
        ..RouteData::of(path, None)
    };
    drive.tree.blackboard_mut().set("cut", cut.value().unwrap()).unwrap();
    drive.rig.x = -0.5;
    assert_eq!((drive.tick(2.0), drive.tick(2.05)), (Status::Running, Status::Running));
    let request = drive.smooths(backs());
    assert_eq!((along(&request.path), request.backwards), (vec![-0.5, 12.0], vec![]));
    let tracking = drive.tree.blackboard().get("tracking").unwrap().to_json();
    assert_eq!(tracking["remaining_path_length"].as_f64(), Some(12.5));
}

#[test]
fn a_path_from_elsewhere_has_the_planned_reverse_legs_and_an_index_of_no_leg_fails() {
    for (backwards, status) in [(vec![0], Status::Success), (vec![2], Status::Failure)] {
        let mut drive = Drive::new(r#"<ComputePathToPose goal="12;0" start="0;0;0" path="{path}"/>"#);
        let plan = PlanReply {
            backwards,
            ..drive.rig.found(&[(-1.0, 0.0)])
        };
        assert_eq!(drive.told(2.0, |_| MotionReply::Plan(plan)), status);
        if status == Status::Success {
            assert_eq!(driven(&drive, "path"), (vec![0.0, -1.0, 12.0], vec![0]));
        }
    }
}
