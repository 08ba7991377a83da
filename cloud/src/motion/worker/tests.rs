//! Tests of the motion worker.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use nalgebra::Vector2;
use zenav_protocol::geometry::Twist2;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{CoursePlace, DrivingProfile, KnownCourse, MapInfo, MapRef, MapReply};
use zenav_protocol::polygon::{cross, edges};
use zenav_protocol::time::Stamp;
use zenav_protocol::trajectory::TrajectoryPoint;
use zenav_smoothing::HalfPlane;

use super::*;

fn spec() -> GridSpec {
    spec_of(120, 80)
}

fn spec_of(width: u32, height: u32) -> GridSpec {
    GridSpec {
        origin: Point2::origin(),
        resolution: 0.05,
        width,
        height,
    }
}

/// Describes a hall of 6 m by 4 m.
fn map_info() -> MapInfo {
    MapInfo {
        stamp: Stamp::ZERO,
        map: MapRef {
            id: "hall".to_owned(),
            revision: 1,
            frame: 0,
        },
        spec: spec(),
        free: 0,
        occupied: 0,
        unknown: 0,
        scans: 0,
        stored: true,
    }
}

/// A hall of 6 m by 4 m with a wall across it; the wall has a door of this width (m), from y = 2 m on.
fn hall(door: f64) -> MapReplica {
    hall_with(door, |_| false)
}

/// The same hall with obstacles at these places, m.
fn hall_with(door: f64, is_occupied: impl Fn(Point2<f64>) -> bool) -> MapReplica {
    let is_wall = |at: Point2<f64>| (3.0..3.05).contains(&at.x) && !(2.0..2.0 + door).contains(&at.y);
    hall_of(spec(), |at| is_wall(at) || is_occupied(at))
}

/// A hall with obstacles at these places, m.
fn hall_of(spec: GridSpec, is_occupied: impl Fn(Point2<f64>) -> bool) -> MapReplica {
    let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
    for cell in (0..spec.height).flat_map(|y| (0..spec.width).map(move |x| Cell::new(x, y))) {
        if is_occupied(spec.center(cell)) {
            grid[cell] = Occupancy::OCCUPIED;
        }
    }
    let info = MapInfo { spec, ..map_info() };
    let mut replica = MapReplica::new();
    replica.replace(&MapReply {
        info,
        values: grid.values().to_vec(),
        trajectory: Vec::new(),
        stored: Vec::new(),
    });
    replica
}

fn request(robot: &str, planner: &str) -> TrajectoryRequest {
    TrajectoryRequest {
        plan: PlanRequest {
            robot: "r".to_owned(),
            model: zenav_fixtures::robot(robot),
            map: MapRef::default(),
            start: Pose2::new(1.0, 1.0, 0.0),
            via: Vec::new(),
            goal: Pose2::new(5.0, 1.0, 0.0),
            planner: planner.to_owned(),
            unknown_is_free: false,
            cleared: Vec::new(),
            yield_to: Vec::new(),
            escape: 0.6,
            goal_tolerance: 0.0,
            budget_ms: 5000,
            seed: 1,
        },
        start_velocity: Twist2::ZERO,
        goal_yaw: Some(0.0),
        profile: DrivingProfile::default(),
    }
}

fn ask(map: &MapReplica, request: &TrajectoryRequest, cancel: &Cancel) -> TrajectoryReply {
    let request = MotionRequest::Trajectory(request.clone());
    match MotionWorker::default().answer(Some(map), &request, &mut || 0.0, cancel) {
        Ok(MotionReply::Trajectory(reply)) => reply,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_trajectory_stops_at_the_poses_that_it_is_to_pass_and_cuts_no_corner_there() {
    let mut request = request("tiago", "astar");
    request.plan.via = vec![
        Pose2::new(1.0, 3.0, 0.0),
        Pose2::new(2.0, 3.0, 0.0),
        Pose2::new(2.0, 1.0, 0.0),
    ];
    let reply = ask(&hall(1.5), &request, &Cancel::default()).smooth.unwrap();
    let mut from = 0.0;
    for stop in request.plan.via.iter().chain([&request.plan.goal]) {
        let is_there = |point: &&TrajectoryPoint| {
            point.t > from && (point.position() - stop.position()).norm() < 1e-3 && point.v.abs() < 1e-6
        };
        from = reply
            .trajectory
            .iter()
            .find(is_there)
            .unwrap_or_else(|| panic!("{stop:?}"))
            .t;
    }
    assert!(reply.trajectory.windows(2).all(|pair| pair[0].t < pair[1].t));
    assert!((reply.statistics.duration - from).abs() < 0.2, "{:?}", reply.statistics);
}

#[test]
fn one_answer_holds_the_path_and_its_trajectory_to_rest_at_the_goal() {
    let (map, request) = (hall(1.25), request("tiago", "astar"));
    let reply = ask(&map, &request, &Cancel::default());
    let PlanOutcome::Found { path, .. } = &reply.plan.outcome else {
        panic!("{:?}", reply.plan.outcome)
    };
    assert_eq!(path.first(), Some(&request.plan.start.position()));
    let smooth = reply.smooth.unwrap();
    assert_eq!(smooth.statistics.status, "smoothed");
    let last = smooth.trajectory.last().unwrap();
    assert!(last.pose().distance(&request.plan.goal) < 1e-6 && last.v == 0.0);
}

#[test]
fn the_corridor_of_an_answer_holds_every_point_of_its_trajectory() {
    let (map, request) = (hall(1.25), request("tiago", "astar"));
    let smooth = ask(&map, &request, &Cancel::default()).smooth.unwrap();
    let counted = smooth.statistics.certificate.corridor.unwrap().polygons;
    assert_eq!(smooth.corridor.len(), counted);
    // Corners are rounded to millimetres.
    let holds = |polygon: &[Point2<f64>], point: Point2<f64>| {
        edges(polygon).all(|edge| {
            let along = edge.b - edge.a;
            cross(along, point - edge.a) >= -2e-3 * along.norm()
        })
    };
    for point in smooth.trajectory.iter() {
        let is_held = smooth.corridor.iter().any(|polygon| holds(polygon, point.position()));
        assert!(is_held, "{point:?}");
    }
    assert!(
        !smooth
            .corridor
            .iter()
            .any(|polygon| holds(polygon, Point2::new(3.025, 1.9))),
        "the wall"
    );
}

#[test]
fn a_corridor_of_very_many_polygons_is_left_out_as_a_whole() {
    let side = |x: f64, y: f64| HalfPlane {
        normal: Vector2::new(x, y),
        offset: 1.0,
    };
    let square = FreePolygon {
        sides: vec![side(1.0, 0.0), side(-1.0, 0.0), side(0.0, 1.0), side(0.0, -1.0)],
        from: Point2::origin(),
        to: Point2::new(0.5, 0.0),
        length: 0.5,
    };
    assert_eq!(corners(&vec![square.clone(); MAX_POLYGONS]).len(), MAX_POLYGONS);
    assert!(corners(&vec![square; MAX_POLYGONS + 1]).is_empty());
}

#[test]
fn a_path_passes_the_poses_asked_for_and_a_leg_without_one_is_named() {
    let map = hall(1.25);
    let mut request = request("tiago", "astar");
    request.plan.via = vec![Pose2::new(1.0, 3.0, 0.0), Pose2::new(5.0, 3.0, 0.0)];
    let reply = ask(&map, &request, &Cancel::default());
    let PlanOutcome::Found { path, length } = &reply.plan.outcome else {
        panic!("{:?}", reply.plan.outcome)
    };
    for pose in &request.plan.via {
        assert!(path.contains(&pose.position()), "{path:?}");
    }
    assert!(*length > 8.0 && !reply.smooth.unwrap().trajectory.is_empty());
    request.plan.via[1] = Pose2::new(3.025, 1.0, 0.0);
    let reply = ask(&map, &request, &Cancel::default());
    assert!(matches!(reply.plan.outcome, PlanOutcome::GoalOccupied { .. }) && reply.plan.leg == 1);
    assert_eq!(reply.smooth, None);
}

#[test]
fn a_robot_that_by_the_map_stands_in_something_leaves_it_if_it_may() {
    let map = hall(1.25);
    let mut request = request("tiago", "astar");
    request.plan.start = Pose2::new(2.95, 1.0, 0.0);
    let reply = ask(&map, &request, &Cancel::default());
    assert!(reply.plan.escapes && !reply.smooth.unwrap().trajectory.is_empty());
    request.plan.escape = 0.0;
    let reply = ask(&map, &request, &Cancel::default());
    assert!(matches!(reply.plan.outcome, PlanOutcome::StartOccupied { .. }));
}

#[test]
fn a_path_without_what_may_leave_is_told_and_nothing_of_it_is_kept() {
    let (map, mut worker) = (hall(0.0), MotionWorker::default());
    let mut plan = request("tiago", "astar").plan;
    let mut ask = |plan: &PlanRequest| {
        let request = MotionRequest::Plan(plan.clone());
        match worker.answer(Some(&map), &request, &mut || 0.0, &Cancel::default()) {
            Ok(MotionReply::Plan(reply)) => Ok(reply.outcome),
            Err(refusal) => Err(refusal),
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(ask(&plan), Ok(PlanOutcome::NoPath));
    plan.cleared = (40..60)
        .map(|y| Point2::new(3.025, 0.05 * f64::from(y) + 0.025))
        .collect();
    assert!(matches!(ask(&plan), Ok(PlanOutcome::Found { .. })));
    plan.cleared.push(Point2::new(f64::NAN, 0.0));
    assert!(matches!(ask(&plan), Err(Refusal::BadRequest { .. })));
    plan.cleared.clear();
    assert_eq!(ask(&plan), Ok(PlanOutcome::NoPath));
}

#[test]
fn a_body_that_no_disc_stands_for_gets_a_path_that_it_can_drive_by_every_planner() {
    for planner in ["astar", "theta", "jps", "rrt_connect"] {
        let reply = ask(&hall(0.8), &request("jackal", planner), &Cancel::default());
        let smooth = reply
            .smooth
            .unwrap_or_else(|| panic!("{planner}: {:?}", reply.plan.outcome));
        assert!(!smooth.trajectory.is_empty(), "{planner}: {}", smooth.statistics.status);
    }
}

#[test]
fn a_search_out_of_time_has_no_path_and_a_smoother_out_of_time_a_safe_trajectory() {
    let (map, request) = (hall(1.25), request("tiago", "astar"));
    let over = || AtomicBool::new(true);
    let no_search = Cancel {
        search: over(),
        ..Cancel::default()
    };
    assert_eq!(ask(&map, &request, &no_search).plan.outcome, PlanOutcome::TimedOut);
    let no_smoothing = Cancel {
        smoothing: over(),
        ..Cancel::default()
    };
    let smooth = ask(&map, &request, &no_smoothing).smooth.unwrap();
    assert_eq!(smooth.statistics.status, "fallback:timed_out");
    assert!(smooth.trajectory.last().unwrap().pose().distance(&request.plan.goal) < 0.01);
}

#[test]
fn a_long_body_that_two_discs_hold_backs_straight_out_and_turns_behind_them() {
    // By the map each disc reaches some centimetres into the side of the outline.
    let discs = [Point2::new(2.65, 2.445), Point2::new(2.6, 1.555)];
    let map = hall_with(1.25, |at| discs.iter().any(|disc| (at - disc).norm() <= 0.3));
    let mut request = request("jackal", "astar");
    (request.plan.start, request.plan.goal) = (Pose2::new(2.5, 2.0, 0.0), Pose2::new(0.6, 3.2, 0.0));
    (request.goal_yaw, request.plan.escape) = (None, 0.6);
    let reply = ask(&map, &request, &Cancel::default());
    assert!(
        reply.plan.escapes && reply.plan.backwards.first() == Some(&0),
        "{:?}",
        reply.plan
    );
    let smooth = reply.smooth.unwrap();
    let held = smooth.trajectory.iter().take_while(|point| point.x > 2.3);
    assert!(held.clone().count() > 1, "{}", smooth.statistics.status);
    for point in held {
        assert!(
            point.v <= 0.0 && point.yaw.abs() < 1e-3 && (point.y - 2.0).abs() < 1e-3,
            "{point:?}"
        );
    }
}

#[test]
fn a_long_body_backs_out_of_a_lane_in_which_it_cannot_turn_and_drives_on_forwards() {
    // A lane of 0.4 m that ends at the wall.
    let is_lane_side = |y: f64| (0.75..0.8).contains(&y) || (1.2..1.25).contains(&y);
    let map = hall_with(1.25, |at| (1.5..3.0).contains(&at.x) && is_lane_side(at.y));
    let mut request = request("jackal", "astar");
    (request.plan.start, request.plan.goal) = (Pose2::new(2.7, 1.0, 0.0), Pose2::new(0.5, 3.0, 0.0));
    request.goal_yaw = None;
    let reply = ask(&map, &request, &Cancel::default());
    assert_eq!(reply.plan.backwards, [0], "{reply:?}");
    let trajectory = reply.smooth.unwrap().trajectory;
    let cusp = trajectory.iter().rposition(|point| point.v < -1e-3).unwrap();
    let (back, on) = trajectory.split_at(cusp + 1);
    assert!(back.iter().all(|point| point.v <= 0.0 && point.yaw.abs() < 0.5));
    assert!(on.iter().all(|point| point.v >= 0.0) && on.iter().any(|point| point.v > 0.1));
    assert!(back[cusp].x < 1.7 && on[0].v.abs() < 0.1);
    let speed = |pair: &[TrajectoryPoint]| pair[0].pose().distance(&pair[1].pose()) / (pair[1].t - pair[0].t);
    let top = zenav_fixtures::robot("jackal").drive.top_speed();
    assert!(
        trajectory
            .windows(2)
            .all(|pair| pair[0].t < pair[1].t && speed(pair) <= 1.01 * top),
        "no jump: {trajectory:?}"
    );
    assert!((trajectory.last().unwrap().position() - request.plan.goal.position()).norm() < 1e-6);
}

#[test]
fn a_given_path_is_driven_backwards_where_it_says_so_and_an_index_of_no_leg_is_refused() {
    let map = hall(1.5);
    let mut request = request("tiago", "astar");
    (request.plan.start, request.goal_yaw) = (Pose2::new(2.0, 1.0, 0.0), None);
    let path = [(2.0, 1.0), (1.0, 1.0), (1.0, 2.5)].map(|(x, y)| Point2::new(x, y));
    let answer = |backwards: &[usize]| {
        let request = request.smooth(map.map().clone(), path.to_vec(), backwards.to_vec());
        let request = MotionRequest::Smooth(request);
        MotionWorker::default().answer(Some(&map), &request, &mut || 0.0, &Cancel::default())
    };
    let Ok(MotionReply::Smooth(reply)) = answer(&[0]) else {
        panic!("no trajectory")
    };
    let driven = reply.trajectory.spaced(0.0, 0.05, 0.1);
    let first: Vec<TrajectoryPoint> = driven.filter(|point| (1.2..1.8).contains(&point.x)).collect();
    assert!(
        !first.is_empty() && first.iter().all(|point| point.v < 0.0 && point.yaw.abs() < 0.1),
        "{reply:?}"
    );
    assert!(reply.trajectory.iter().any(|point| point.v > 0.1 && point.y > 1.2));
    for bad in [&[2][..], &[1, 0], &[0, 0], &[usize::MAX]] {
        let refused = answer(bad).unwrap_err().to_string();
        assert!(
            refused.starts_with("bad request: `backwards`") && refused.contains("2 legs"),
            "{refused}"
        );
    }
}

/// A robot of 0.3 m radius at constant velocity from a place on, for 30 s.
fn course(from: [f64; 2], velocity: [f64; 2]) -> KnownCourse {
    let place = |secs: f64| CoursePlace {
        secs,
        x: from[0] + velocity[0] * secs,
        y: from[1] + velocity[1] * secs,
    };
    KnownCourse {
        radius: 0.3,
        places: (0..=60).map(|nth| place(0.5 * f64::from(nth))).collect(),
    }
}

#[test]
fn a_trajectory_leads_past_a_robot_that_goes_first_and_tells_when_it_arrives() {
    let map = hall_of(spec_of(240, 160), |_| false);
    let mut request = request("tiago", "astar");
    (request.plan.start, request.plan.goal) = (Pose2::new(1.0, 4.0, 0.0), Pose2::new(10.0, 4.0, 0.0));
    let alone = ask(&map, &request, &Cancel::default());
    assert_eq!(alone.arrival_secs, None);
    for course in [
        course([10.0, 4.0], [-0.5, 0.0]),
        course([5.5, 3.0], [0.0, 0.15]),
        course([2.0, 4.0], [0.2, 0.0]),
    ] {
        request.plan.yield_to = vec![course.clone()];
        let reply = ask(&map, &request, &Cancel::default());
        let smooth = reply.smooth.unwrap();
        let arrival = reply.arrival_secs.unwrap();
        let end = smooth.trajectory.end_time();
        assert!(
            arrival >= end && arrival < alone.smooth.as_ref().unwrap().trajectory.end_time() + 8.0,
            "{arrival} {end}"
        );
        for point in smooth.trajectory.iter() {
            let other = course.places[((point.t / 0.5) as usize).min(60)].at();
            let apart = (point.position() - other).norm();
            assert!(apart > 0.3 + 0.27 + 0.1, "{apart} at {} s", point.t);
        }
    }
    request.plan.yield_to[0].places.reverse();
    let request = MotionRequest::Trajectory(request);
    let answer = MotionWorker::default().answer(Some(&map), &request, &mut || 0.0, &Cancel::default());
    assert!(matches!(answer, Err(Refusal::BadRequest { .. })), "{answer:?}");
}
