//! Claims about what comes out of the smoother, checked by other means than the smoother's own.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::sync::Arc;

use nalgebra::Point2;
use proptest::prelude::*;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::grid::{Cell, Occupancy, OccupancyGrid};
use zenav_protocol::messages::PlanOutcome;
use zenav_protocol::polygon::{contains, edges};
use zenav_protocol::robot::RobotModel;

use super::{SmoothQuery, SmoothSettings, Smoothed, smooth};
use zenav_planning::{Budget, PlanOptions, Planner, Searcher, plan};
use zenav_space::{ConfigurationSpace, UnknownPolicy, Zones};

fn robot(name: &str) -> RobotModel {
    zenav_fixtures::robot(name)
}

fn space(grid: &OccupancyGrid, model: &RobotModel) -> ConfigurationSpace {
    ConfigurationSpace::new(grid, &model.footprint, UnknownPolicy::Blocked, 0.0)
}

/// An empty hall of 8 m by 6 m with its lower left corner at the origin.
fn hall() -> OccupancyGrid {
    zenav_fixtures::walled_room(zenav_fixtures::spec(160, 120, 0.05), |_| false)
}

/// The hall with boxes: corner and sides in cells.
fn cluttered(boxes: &[(u32, u32, u32, u32)]) -> OccupancyGrid {
    let mut grid = hall();
    for (x, y, w, h) in boxes {
        for row in *y..(y + h).min(120) {
            for column in *x..(x + w).min(160) {
                grid[Cell::new(column, row)] = Occupancy::OCCUPIED;
            }
        }
    }
    grid
}

fn way(space: &ConfigurationSpace, from: Pose2, to: Pose2, options: &PlanOptions) -> Option<Vec<Point2<f64>>> {
    match plan(
        space,
        &mut Searcher::new(space.free()).unwrap(),
        from,
        to,
        options,
        Budget::UNLIMITED,
    )
    .outcome
    {
        PlanOutcome::Found { path, .. } => Some(path),
        _ => None,
    }
}

fn smoothed(space: &ConfigurationSpace, query: &SmoothQuery<'_>, model: &RobotModel) -> Smoothed {
    smooth(space, query, model, &SmoothSettings::default(), &mut || 0.0)
}

/// At every millisecond: free by the true footprint, within 95 % of every limit, going where the velocity says.
///
/// Poses are compared with the trapezoid of two velocities: where the acceleration jumps by `j` between the two, as
/// at the peak of a turn on the spot, that is off by up to `j dt^2 / 8`.
fn assert_sound(result: &Smoothed, space: &ConfigurationSpace, model: &RobotModel) {
    let drive = &model.drive;
    let half = 0.5 * drive.wheel_separation;
    let (speed, acceleration) = (
        0.95 * drive.max_wheel_speed * drive.wheel_radius,
        0.95 * drive.acceleration(),
    );
    let states = result.motion.states(0.001);
    for (i, state) in states.iter().enumerate() {
        let point = state.point;
        assert!(
            space.is_valid(point.pose()),
            "collision at {point:?}: {}",
            result.statistics.status
        );
        for side in [-half, half] {
            assert!(
                (point.v + side * point.w).abs() <= speed + 1e-6,
                "wheel speed at {point:?}"
            );
            assert!(
                (state.a + side * state.alpha).abs() <= acceleration + 1e-6,
                "wheel acceleration at {point:?}"
            );
        }
        assert!(
            (point.v * point.w).abs() <= 0.95 * drive.max_lateral_acceleration + 1e-6
                && point.v <= 0.95 * drive.top_speed() + 1e-6
        );
        if let Some(before) = i.checked_sub(1).map(|j| states[j].point) {
            let dt = point.t - before.t;
            assert!(dt > 0.0);
            let trapezoid = 2.0 * acceleration * dt * dt / 8.0;
            let moved = Twist2::new(0.5 * (before.v + point.v), 0.5 * (before.w + point.w));
            let expected = before.pose().advance(moved, dt);
            assert!(
                expected.distance(&point.pose()) < 1e-6 + trapezoid,
                "{} m off at {point:?}",
                expected.distance(&point.pose())
            );
            assert!(
                wrap_angle(expected.yaw - point.yaw).abs() < 1e-6 + trapezoid / half,
                "{} rad off at {point:?}",
                wrap_angle(expected.yaw - point.yaw)
            );
        }
    }
}

fn assert_ends_at(result: &Smoothed, goal: Pose2, goal_yaw: Option<f64>) {
    let end = result.motion.at(result.motion.duration()).point;
    assert!(
        end.pose().distance(&goal) < 1e-6 && end.v == 0.0 && end.w == 0.0,
        "{end:?}"
    );
    if let Some(yaw) = goal_yaw {
        assert!(wrap_angle(end.yaw - yaw).abs() < 1e-6);
    }
}

#[test]
fn a_motion_stays_out_of_closed_zones_and_is_slow_in_speed_zones() {
    let model = robot("tiago");
    let zones = "[[keep_out]]\npoints = [[3.0, 0.5], [5.0, 1.0], [4.0, 4.2]]\n[[speed_limit]]\npoints = [[2.0, 0.0], [6.0, 0.0], [6.0, 6.0], [2.0, 6.0]]\nmax_speed = 0.25\n";
    let zones = Arc::new(Zones::from_toml(zones, "zones").unwrap());
    let space = ConfigurationSpace::with_zones(&hall(), &model.footprint, UnknownPolicy::Blocked, 0.0, &zones);
    let (start, goal) = (Pose2::new(1.0, 2.0, 0.0), Pose2::new(7.0, 2.0, 0.0));
    let way = way(&space, start, goal, &PlanOptions::default()).unwrap();
    let query = SmoothQuery {
        way: &way,
        start,
        start_velocity: Twist2::ZERO,
        goal_yaw: None,
    };
    let result = smoothed(&space, &query, &model);
    assert_sound(&result, &space, &model);
    assert_ends_at(&result, goal, None);
    let corners = [(3.0, 0.5), (5.0, 1.0), (4.0, 4.2)].map(|(x, y)| Point2::new(x, y));
    let (mut within, mut fastest) = (0, 0.0_f64);
    for state in result.motion.states(0.001) {
        let position = state.point.pose().position();
        let apart = edges(&corners)
            .map(|edge| {
                let along = edge.b - edge.a;
                let share = ((position - edge.a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                (edge.a + along * share - position).norm()
            })
            .fold(f64::INFINITY, f64::min);
        assert!(apart > model.footprint.inscribed_radius() && !contains(&corners, position));
        fastest = fastest.max(state.point.v);
        // Where exactly the border is crossed depends on the path's samples.
        if (2.05..5.95).contains(&position.x) {
            within += 1;
            assert!(state.point.v <= 0.25 + 1e-6, "{:?}", state.point);
        }
    }
    assert!(within > 1000 && fastest > 0.4, "{within} {fastest}");
}

#[test]
fn around_a_wall_the_curve_is_faster_than_stop_and_turn() {
    let model = robot("tiago");
    let space = space(&cluttered(&[(80, 0, 3, 80)]), &model);
    let (start, goal) = (Pose2::new(1.0, 1.0, 0.0), Pose2::new(7.0, 1.0, 0.0));
    let path = way(&space, start, goal, &PlanOptions::default()).unwrap();
    let result = smoothed(
        &space,
        &SmoothQuery {
            way: &path,
            start,
            start_velocity: Twist2::ZERO,
            goal_yaw: Some(-1.5),
        },
        &model,
    );
    assert_eq!(result.statistics.status, "smoothed");
    assert_sound(&result, &space, &model);
    assert_ends_at(&result, goal, Some(-1.5));
    let safe = super::timing::legs::safe_motion(
        &path,
        start,
        Twist2::ZERO,
        Some(-1.5),
        &super::timing::Limits::of(&model),
        super::timing::UNRESTRICTED,
    );
    assert!(
        result.motion.duration() < 0.9 * safe.duration(),
        "{} against {}",
        result.motion.duration(),
        safe.duration()
    );
    assert!(result.statistics.min_clearance.unwrap() > 0.1);
}

#[test]
fn a_moving_robot_goes_on_as_it_moves() {
    let model = robot("tiago");
    let space = space(&hall(), &model);
    let start = Pose2::new(2.0, 2.0, 0.3);
    let path = [start.position(), Point2::new(6.0, 4.5)];
    let velocity = Twist2::new(0.4, 0.2);
    let result = smoothed(
        &space,
        &SmoothQuery {
            way: &path,
            start,
            start_velocity: velocity,
            goal_yaw: None,
        },
        &model,
    );
    assert_eq!(result.statistics.status, "smoothed");
    let first = result.motion.at(0.0).point;
    assert!((first.v - 0.4).abs() < 1e-9 && (first.w - 0.2).abs() < 1e-3 && wrap_angle(first.yaw - 0.3).abs() < 1e-6);
    assert!(
        result
            .motion
            .states(0.01)
            .iter()
            .take(300)
            .all(|state| state.point.v > 0.3),
        "it does not stop on the way"
    );
    assert_sound(&result, &space, &model);
}

#[test]
fn a_moving_robot_whose_way_lies_behind_stops_and_turns_first() {
    let model = robot("tiago");
    let space = space(&hall(), &model);
    let start = Pose2::new(4.0, 3.0, 0.0);
    let path = [start.position(), Point2::new(1.0, 3.2)];
    let result = smoothed(
        &space,
        &SmoothQuery {
            way: &path,
            start,
            start_velocity: Twist2::new(0.5, 0.0),
            goal_yaw: None,
        },
        &model,
    );
    assert_eq!(result.statistics.status, "smoothed");
    assert_sound(&result, &space, &model);
    assert_ends_at(&result, Pose2::new(1.0, 3.2, 0.0), None);
}

#[test]
fn degenerate_ways_are_driven_or_refused_but_never_fatal() {
    let model = robot("tiago");
    let space = space(&hall(), &model);
    let start = Pose2::new(2.0, 2.0, 0.0);
    let (here, there, nowhere) = (start.position(), Point2::new(4.0, 2.0), Point2::new(f64::NAN, 2.0));
    let run = |way: &[Point2<f64>], yaw: Option<f64>| {
        smoothed(
            &space,
            &SmoothQuery {
                way,
                start,
                start_velocity: Twist2::ZERO,
                goal_yaw: yaw,
            },
            &model,
        )
    };
    for empty in [
        run(&[], None),
        run(&[here], None),
        run(&[here, here, here], None),
        run(&[nowhere], Some(f64::NAN)),
    ] {
        assert!(empty.motion.is_empty());
        assert_eq!(empty.statistics.status, "smoothed");
    }
    let turned = run(&[here], Some(2.0));
    assert_ends_at(&turned, start, Some(2.0));
    let repeated = run(&[here, here, there, there, nowhere, there], None);
    assert_ends_at(&repeated, Pose2::new(4.0, 2.0, 0.0), None);
    let back = run(&[here, there, here], None);
    assert!(back.motion.is_empty(), "there and back is no way");
    let tiny = run(&[here, Point2::new(2.004, 2.003)], None);
    assert_ends_at(&tiny, Pose2::new(2.004, 2.003, 0.0), None);
    let lost = smoothed(
        &space,
        &SmoothQuery {
            way: &[here, there],
            start: Pose2 {
                x: f64::INFINITY,
                ..start
            },
            start_velocity: Twist2::ZERO,
            goal_yaw: None,
        },
        &model,
    );
    assert!(lost.motion.is_empty() && lost.statistics.status == "fallback:start_not_finite");
}

#[test]
fn a_blocked_way_is_not_driven() {
    let model = robot("tiago");
    let space = space(&cluttered(&[(80, 0, 3, 120)]), &model);
    let start = Pose2::new(1.0, 1.0, 0.0);
    let query = SmoothQuery {
        way: &[start.position(), Point2::new(7.0, 1.0)],
        start,
        start_velocity: Twist2::ZERO,
        goal_yaw: None,
    };
    let result = smoothed(&space, &query, &model);
    assert!(result.motion.is_empty() && result.statistics.status == "fallback:way_blocked");
}

#[test]
fn a_solver_that_may_not_iterate_leaves_the_safe_way() {
    let model = robot("tiago");
    let space = space(&cluttered(&[(80, 0, 3, 80)]), &model);
    let (start, goal) = (Pose2::new(1.0, 1.0, 0.0), Pose2::new(7.0, 1.0, 0.0));
    let path = way(&space, start, goal, &PlanOptions::default()).unwrap();
    let settings = SmoothSettings {
        max_iterations: 1,
        ..SmoothSettings::default()
    };
    let query = SmoothQuery {
        way: &path,
        start,
        start_velocity: Twist2::ZERO,
        goal_yaw: None,
    };
    let result = smooth(&space, &query, &model, &settings, &mut || 0.0);
    assert!(
        result.statistics.status.starts_with("fallback:MaxIterations"),
        "{}",
        result.statistics.status
    );
    assert_sound(&result, &space, &model);
    assert_ends_at(&result, goal, None);
}

#[test]
fn a_robot_that_touches_a_wall_is_led_away_from_it() {
    let model = robot("tiago");
    let space = space(&hall(), &model);
    let start = Pose2::new(0.05 + 0.265 - 0.01, 3.0, 0.0);
    let goal = Pose2::new(4.0, 1.0, 0.0);
    let path = way(&space, start, goal, &PlanOptions::default()).unwrap();
    let result = smoothed(
        &space,
        &SmoothQuery {
            way: &path,
            start,
            start_velocity: Twist2::ZERO,
            goal_yaw: None,
        },
        &model,
    );
    assert_eq!(result.statistics.status, "smoothed");
    assert_ends_at(&result, goal, None);
    let clearances = result
        .motion
        .states(0.01)
        .into_iter()
        .map(|state| space.clearance(state.point.pose().position()));
    assert!(clearances.fold(f64::INFINITY, f64::min) >= space.clearance(start.position()) - 1e-6);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_trajectory_is_free_within_limits_and_ends_at_the_goal(
        boxes in prop::collection::vec((5_u32..150, 5_u32..110, 2_u32..30, 2_u32..30), 0..9),
        ends in prop::array::uniform2((0.5..7.5_f64, 0.5..5.5_f64)),
        yaw in -3.1..3.1_f64, goal_yaw in prop::option::of(-3.1..3.1_f64), oblong in any::<bool>(), shortest in any::<bool>(),
    ) {
        let model = robot(if oblong { "turtlebot3_waffle" } else { "tiago" });
        let space = space(&cluttered(&boxes), &model);
        let [start, goal] = ends.map(|(x, y)| Pose2::new(x, y, yaw));
        // FreePolygon to turn at both ends: a robot that stands wedged in is another matter.
        let room = model.footprint.circumscribed_radius() + 0.02;
        prop_assume!(space.clearance(start.position()) > room && space.clearance(goal.position()) > room);
        let options = if shortest { PlanOptions::shortest(Planner::AStar) } else { PlanOptions::default() };
        let Some(path) = way(&space, start, goal, &options) else { return Ok(()) };
        let query = SmoothQuery { way: &path, start, start_velocity: Twist2::ZERO, goal_yaw };
        let result = smoothed(&space, &query, &model);
        prop_assert!(!result.motion.is_empty() || start.distance(&goal) < 1e-3 || oblong, "{}", result.statistics.status);
        if !result.motion.is_empty() {
            assert_sound(&result, &space, &model);
            assert_ends_at(&result, goal, goal_yaw);
        }
        let again = smoothed(&space, &query, &model);
        prop_assert_eq!(again.trajectory(0.05), result.trajectory(0.05));
    }
}
