//! Tests of the smoother's results, checked independently of the smoother.

use std::sync::Arc;

use nalgebra::{Point2, Vector2};
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::grid::{Cell, Occupancy, OccupancyGrid};
use zenav_protocol::messages::PlanOutcome;
use zenav_protocol::polygon::{contains, edges};
use zenav_protocol::robot::{Footprint, RobotModel};

use super::{Cuts, Fallback, Outcome, SmoothQuery, Smoothed, SmoothedPieces, SmoothingSettings, smooth, smooth_pieces};
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

fn path(space: &ConfigurationSpace, from: Pose2, to: Pose2, options: &PlanOptions) -> Option<Vec<Point2<f64>>> {
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
    smooth(space, query, model, &SmoothingSettings::default(), None, &mut || 0.0)
}

/// At every millisecond: free by the true footprint, within 95 % of every limit, and moving as the velocity says.
///
/// Poses are compared with the trapezoid of two velocities. Where the acceleration jumps by `j` between the two, as at the peak of a turn
/// on the spot, the trapezoid is off by up to `j dt^2 / 8`.
fn assert_sound(result: &Smoothed, space: &ConfigurationSpace, model: &RobotModel) {
    let drive = &model.drive;
    let half = 0.5 * drive.wheel_separation;
    let (speed, acceleration) = (
        0.95 * drive.max_wheel_speed * drive.wheel_radius,
        0.95 * drive.acceleration(),
    );
    let states = result.trajectory.states(0.001);
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

/// Whether a footprint overlaps a square, by separating axes, independent of the configuration space.
fn overlaps(footprint: &Footprint, pose: Pose2, center: Point2<f64>, half: f64) -> bool {
    match footprint {
        Footprint::Radius(radius) => {
            let (dx, dy) = ((pose.x - center.x).abs(), (pose.y - center.y).abs());
            (dx - half).max(0.0).hypot((dy - half).max(0.0)) < radius - 1e-9
        }
        Footprint::Polygon(corners) => {
            let corners: Vec<_> = corners.iter().map(|corner| pose.transform_point(*corner)).collect();
            let normals =
                edges(&corners).map(|edge| Vector2::new(edge.a.y - edge.b.y, edge.b.x - edge.a.x).normalize());
            normals.chain([Vector2::x(), Vector2::y()]).all(|axis| {
                let along = corners.iter().map(|corner| axis.dot(&(corner - center)));
                let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                    (low.min(x), high.max(x))
                });
                let reach = half * (axis.x.abs() + axis.y.abs());
                low < reach - 1e-9 && high > -reach + 1e-9
            })
        }
    }
}

/// At every hundredth of a second the footprint overlaps no occupied cell.
fn assert_free(result: &Smoothed, grid: &OccupancyGrid, model: &RobotModel) {
    let spec = grid.spec();
    let reach = model.footprint.circumscribed_radius() + spec.resolution;
    for state in result.trajectory.states(0.01) {
        let pose = state.point.pose();
        let cells = |low: f64, high: f64| (low / spec.resolution) as u32..=(high / spec.resolution) as u32;
        for y in cells(pose.y - reach, pose.y + reach) {
            for x in cells(pose.x - reach, pose.x + reach) {
                let cell = Cell::new(x.min(spec.width - 1), y.min(spec.height - 1));
                let hit = grid[cell] == Occupancy::OCCUPIED
                    && overlaps(&model.footprint, pose, spec.center(cell), 0.5 * spec.resolution);
                assert!(!hit, "{pose:?} touches {cell:?}: {}", result.outcome);
            }
        }
    }
}

#[test]
fn every_robot_is_smoothed_nearly_everywhere_and_never_left_without_a_trajectory() {
    for (name, least) in [
        ("tiago", 0.9),
        ("neato", 0.9),
        ("turtlebot3_waffle", 0.8),
        ("jackal", 0.8),
    ] {
        let model = robot(name);
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let (mut asked, mut smooth) = (0, 0);
        while asked < 20 {
            let boxes: Vec<_> = (0..6)
                .map(|_| {
                    let corner = (rng.random_range(5..150), rng.random_range(5..110));
                    (corner.0, corner.1, rng.random_range(2..20), rng.random_range(2..20))
                })
                .collect();
            let grid = cluttered(&boxes);
            let space = space(&grid, &model);
            let mut pose = || {
                Pose2::new(
                    rng.random_range(0.5..7.5),
                    rng.random_range(0.5..5.5),
                    rng.random_range(-3.1..3.1),
                )
            };
            let (start, goal) = (pose(), pose());
            let room = model.footprint.circumscribed_radius() + 0.02;
            if space.clearance(start.position()) < room || space.clearance(goal.position()) < room {
                continue;
            }
            let Some(path) = path(&space, start, goal, &PlanOptions::default()) else {
                continue;
            };
            let query = SmoothQuery::new(&path, start);
            let result = smoothed(&space, &query, &model);
            assert!(!result.trajectory.is_empty(), "{name}: {}", result.outcome);
            assert_free(&result, &grid, &model);
            asked += 1;
            smooth += usize::from(result.is_smooth());
        }
        assert!(smooth as f64 >= least * f64::from(asked), "{name}: {smooth} of {asked}");
    }
}

fn assert_ends_at(result: &Smoothed, goal: Pose2, goal_yaw: Option<f64>) {
    let end = result.trajectory.at(result.trajectory.duration()).point;
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
    let path = path(&space, start, goal, &PlanOptions::default()).unwrap();
    let query = SmoothQuery::new(&path, start);
    let result = smoothed(&space, &query, &model);
    assert_sound(&result, &space, &model);
    assert_ends_at(&result, goal, None);
    let corners = [(3.0, 0.5), (5.0, 1.0), (4.0, 4.2)].map(|(x, y)| Point2::new(x, y));
    let (mut within, mut fastest) = (0, 0.0_f64);
    for state in result.trajectory.states(0.001) {
        let position = state.point.pose().position();
        let apart = edges(&corners)
            .map(|edge| (edge.nearest(position) - position).norm())
            .fold(f64::INFINITY, f64::min);
        assert!(apart > model.footprint.inscribed_radius() && !contains(&corners, position));
        fastest = fastest.max(state.point.v);
        // The exact place where the border is crossed depends on the path's samples.
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
    let path = path(&space, start, goal, &PlanOptions::default()).unwrap();
    let result = smoothed(
        &space,
        &SmoothQuery {
            goal_yaw: Some(-1.5),
            ..SmoothQuery::new(&path, start)
        },
        &model,
    );
    assert_eq!(result.statistics.status, "smoothed");
    assert_sound(&result, &space, &model);
    assert_ends_at(&result, goal, Some(-1.5));
    let safe = super::timing::stop_turn_go::stop_turn_go(
        &path,
        start,
        Twist2::ZERO,
        Some(-1.5),
        &super::timing::Limits::of(&model),
        super::timing::UNRESTRICTED,
    );
    assert!(
        result.trajectory.duration() < 0.9 * safe.duration(),
        "{} against {}",
        result.trajectory.duration(),
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
            start_velocity: velocity,
            ..SmoothQuery::new(&path, start)
        },
        &model,
    );
    assert_eq!(result.statistics.status, "smoothed");
    let first = result.trajectory.at(0.0).point;
    assert!((first.v - 0.4).abs() < 1e-9 && (first.w - 0.2).abs() < 1e-3 && wrap_angle(first.yaw - 0.3).abs() < 1e-6);
    assert!(
        result
            .trajectory
            .states(0.01)
            .iter()
            .take(300)
            .all(|state| state.point.v > 0.3),
        "it does not stop on the path"
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
            start_velocity: Twist2::new(0.5, 0.0),
            ..SmoothQuery::new(&path, start)
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
    let run = |path: &[Point2<f64>], yaw: Option<f64>| {
        smoothed(
            &space,
            &SmoothQuery {
                goal_yaw: yaw,
                ..SmoothQuery::new(path, start)
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
        assert!(empty.trajectory.is_empty());
        assert_eq!(empty.statistics.status, "smoothed");
    }
    let turned = run(&[here], Some(2.0));
    assert_ends_at(&turned, start, Some(2.0));
    let repeated = run(&[here, here, there, there, nowhere, there], None);
    assert_ends_at(&repeated, Pose2::new(4.0, 2.0, 0.0), None);
    let back = run(&[here, there, here], None);
    assert!(back.trajectory.is_empty(), "there and back is no path");
    let tiny = run(&[here, Point2::new(2.004, 2.003)], None);
    assert_ends_at(&tiny, Pose2::new(2.004, 2.003, 0.0), None);
    let lost = smoothed(
        &space,
        &SmoothQuery::new(
            &[here, there],
            Pose2 {
                x: f64::INFINITY,
                ..start
            },
        ),
        &model,
    );
    assert!(lost.trajectory.is_empty() && lost.statistics.status == "fallback:start_not_finite");
}

#[test]
fn a_blocked_way_is_not_driven() {
    let model = robot("tiago");
    let wall = (80, 0, 3, 120);
    let start = Pose2::new(1.02, 1.02, 0.0);
    // Neither is it driven by a robot that stands in an obstacle, or too near to one, and may leave it.
    for before in [None, Some((20, 20, 1, 1)), Some((20, 24, 1, 1))] {
        let boxes: Vec<_> = before.into_iter().chain([wall]).collect();
        let space = space(&cluttered(&boxes), &model);
        let to = |x| {
            let path = [start.position(), Point2::new(x, 1.02)];
            let query = SmoothQuery::new(&path, start);
            smoothed(&space, &query, &model)
        };
        let through = to(7.0);
        assert!(through.trajectory.is_empty() && through.statistics.status == "fallback:path_blocked");
        assert!(!to(3.0).trajectory.is_empty(), "{before:?}");
    }
}

/// A path of tiago's along y = 2 m, from its first place, where the robot looks along x and is at rest.
fn driven(space: &ConfigurationSpace, places: &[f64], cuts: &Cuts<'_>) -> SmoothedPieces {
    let path: Vec<_> = places.iter().map(|x| Point2::new(*x, 2.0)).collect();
    let query = SmoothQuery::new(&path, Pose2::new(places[0], 2.0, 0.0));
    let (model, settings) = (robot("tiago"), SmoothingSettings::default());
    smooth_pieces(space, &query, cuts, &model, &settings, None, &mut || 0.0)
}

#[test]
fn a_leg_driven_backwards_is_no_turn_and_the_robot_rests_at_the_cusp() {
    let model = robot("tiago");
    let space = space(&hall(), &model);
    let cuts = Cuts {
        backwards: &[1],
        via: &[],
    };
    let there_and_back = driven(&space, &[2.0, 4.0, 3.0], &cuts);
    let states = there_and_back.states(0.01);
    let points: Vec<_> = states.iter().map(|state| state.point).collect();
    let cusp = points.iter().position(|point| point.x > 4.0 - 1e-6).unwrap();
    assert!(points[..=cusp].iter().all(|point| point.v >= 0.0) && points[cusp..].iter().all(|point| point.v <= 0.0));
    assert!(
        points
            .iter()
            .all(|point| point.yaw.abs() < 1e-6 && (point.y - 2.0).abs() < 1e-6)
    );
    for pair in states.windows(2) {
        let (before, after) = (pair[0].point, pair[1].point);
        let dt = after.t - before.t;
        assert!(dt > 0.0 && dt < 0.01 + 1e-9);
        let moved = 0.5 * dt * (before.v + after.v);
        assert!((after.x - before.x - moved).abs() < 1e-4, "{before:?} {after:?}");
    }
    let end = points[points.len() - 1];
    assert!((end.x - 3.0).abs() < 1e-6 && end.v == 0.0);
    assert!((end.t - there_and_back.statistics.duration).abs() < 1e-9);
    assert!((there_and_back.statistics.length - 3.0).abs() < 1e-6);
}

#[test]
fn a_piece_without_length_stops_nothing_and_a_blocked_one_everything() {
    let model = robot("tiago");
    let cuts = Cuts {
        backwards: &[1],
        via: &[],
    };
    // Half a millimetre ahead there is nothing to drive.
    let back = driven(&space(&hall(), &model), &[4.0, 4.0005, 2.5], &cuts);
    assert_eq!(back.pieces.len(), 1, "{}", back.outcome);
    let states = back.states(0.01);
    assert!((states[states.len() - 1].point.x - 2.5).abs() < 1e-6);
    assert!(states.iter().all(|state| state.point.v <= 0.0));
    // A wall stands behind the robot.
    let walled = space(&cluttered(&[(80, 0, 3, 120)]), &model);
    let blocked = driven(&walled, &[5.0, 6.0, 2.5], &cuts);
    assert!(blocked.is_empty() && blocked.states(0.01).is_empty());
    assert_eq!(blocked.outcome, Outcome::Unsmoothed(Fallback::PathBlocked));
}

#[test]
fn a_solver_that_may_not_iterate_leaves_the_safe_way() {
    let model = robot("tiago");
    let space = space(&cluttered(&[(80, 0, 3, 80)]), &model);
    let (start, goal) = (Pose2::new(1.0, 1.0, 0.0), Pose2::new(7.0, 1.0, 0.0));
    let path = path(&space, start, goal, &PlanOptions::default()).unwrap();
    let settings = SmoothingSettings {
        max_iterations: 1,
        ..SmoothingSettings::default()
    };
    let query = SmoothQuery::new(&path, start);
    let result = smooth(&space, &query, &model, &settings, None, &mut || 0.0);
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
    let path = path(&space, start, goal, &PlanOptions::default()).unwrap();
    let result = smoothed(&space, &SmoothQuery::new(&path, start), &model);
    assert_eq!(result.statistics.status, "smoothed");
    assert_ends_at(&result, goal, None);
    let clearances = result
        .trajectory
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
        let grid = cluttered(&boxes);
        let space = space(&grid, &model);
        let [start, goal] = ends.map(|(x, y)| Pose2::new(x, y, yaw));
        // Room to turn at both ends: a robot that is wedged in is not tested here.
        let reach = model.footprint.circumscribed_radius() + 0.02;
        prop_assume!(space.clearance(start.position()) > reach && space.clearance(goal.position()) > reach);
        let options = if shortest { PlanOptions::shortest(Planner::AStar) } else { PlanOptions::default() };
        let Some(path) = path(&space, start, goal, &options) else { return Ok(()) };
        let query = SmoothQuery { goal_yaw, ..SmoothQuery::new(&path, start) };
        let result = smoothed(&space, &query, &model);
        prop_assert!(!result.trajectory.is_empty() || start.distance(&goal) < 1e-3, "{}", result.statistics.status);
        if !result.trajectory.is_empty() {
            assert_sound(&result, &space, &model);
            assert_free(&result, &grid, &model);
            assert_ends_at(&result, goal, goal_yaw);
        }
        let again = smoothed(&space, &query, &model);
        prop_assert_eq!(again.sampled(0.05), result.sampled(0.05));
    }
}
