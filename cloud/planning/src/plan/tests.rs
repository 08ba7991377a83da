//! Tests of the paths that robots get.

use super::*;
use crate::Planner;
use proptest::prelude::*;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::robot::Footprint;
use zenav_space::UnknownPolicy;

const RADIUS: f64 = 0.26;

/// A room of 5 m by 4 m, 5 cm cells, with walls and a wall across that leaves a door of 1 m at the top.
fn room() -> OccupancyGrid {
    let spec = GridSpec {
        origin: Point2::new(-1.0, -1.0),
        ..zenav_fixtures::spec(100, 80, 0.05)
    };
    zenav_fixtures::walled_room(spec, |at| at.x > 1.5 && at.x < 1.55 && at.y < 2.0)
}

fn ask(grid: &OccupancyGrid, start: (f64, f64), goal: (f64, f64), options: &PlanOptions) -> PlanOutcome {
    let space = ConfigurationSpace::new(grid, &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0);
    let mut searcher = Searcher::new(space.free()).unwrap();
    plan(
        &space,
        &mut searcher,
        Pose2::new(start.0, start.1, 0.0),
        Pose2::new(goal.0, goal.1, 0.0),
        options,
        Budget::UNLIMITED,
    )
    .outcome
}

#[test]
fn a_path_leads_from_start_to_goal_and_the_robot_fits_all_along() {
    let space = ConfigurationSpace::new(&room(), &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0);
    for options in [PlanOptions::default(), PlanOptions::shortest(Planner::AStar)] {
        let PlanOutcome::Found { path, length } = ask(&room(), (0.013, 0.027), (3.011, 0.049), &options) else {
            panic!("no path")
        };
        assert_eq!(
            (path[0], path[path.len() - 1]),
            (Point2::new(0.013, 0.027), Point2::new(3.011, 0.049))
        );
        assert!(
            path.windows(2)
                .all(|pair| space.segment_is_free(pair[0], pair[1], RADIUS))
        );
        assert!(length > 4.5 && length < 7.0, "{length}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn a_path_of_any_planner_leads_to_the_goal_where_the_robot_fits_and_there_is_none_only_where_there_can_be_none(
        posts in proptest::collection::vec((-0.8..3.8_f64, -0.8..2.8_f64), 0..40),
        (x, y) in (-0.5..3.5_f64, -0.5..2.5_f64),
        seed: u64,
    ) {
        let spec = *room().spec();
        let is_wall = |at: Point2<f64>| posts.iter().any(|post| (at.x - post.0).hypot(at.y - post.1) < 0.1);
        let grid = zenav_fixtures::walled_room(spec, is_wall);
        let space = ConfigurationSpace::new(&grid, &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0);
        let by = |planner| ask(&grid, (0.0, 0.0), (x, y), &PlanOptions { seed, ..PlanOptions::new(planner) });
        let known = by(Planner::AStar);
        for (_, planner) in Planner::ALL {
            match (by(*planner), &known) {
                (PlanOutcome::Found { path, length }, PlanOutcome::Found { .. }) => {
                    prop_assert_eq!((path[0], path[path.len() - 1]), (Point2::origin(), Point2::new(x, y)));
                    // A grid's path is free at the centres of its cells.
                    let is_free = |leg: &[Point2<f64>]| space.segment_is_free(leg[0], leg[1], RADIUS - 0.05);
                    prop_assert!(path.windows(2).all(is_free), "{planner}: {path:?}");
                    let along: f64 = path.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum();
                    prop_assert!((along - length).abs() < 1e-9, "{planner}: {along}, {length}");
                }
                // Sampling may give up on a narrow way.
                (PlanOutcome::NoPath | PlanOutcome::TimedOut, PlanOutcome::Found { .. }) => {
                    prop_assert!(!planner.keeps_clear(), "{planner} found no path");
                }
                (other, known) => prop_assert_eq!(&other, known, "{}", planner),
            }
        }
    }
}

#[test]
fn with_room_to_spare_a_path_keeps_off_the_walls() {
    let space = ConfigurationSpace::new(&room(), &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0);
    let least = |options: &PlanOptions| {
        let PlanOutcome::Found { path, .. } = ask(&room(), (0.0, 0.0), (3.0, 0.0), options) else {
            panic!("no path")
        };
        path.windows(2)
            .map(|pair| space.segment_clearance(pair[0], pair[1]))
            .fold(f64::INFINITY, f64::min)
            - RADIUS
    };
    assert!(least(&PlanOptions::shortest(Planner::AStar)) < 0.05);
    assert!(
        least(&PlanOptions::default()) > 0.12,
        "{}",
        least(&PlanOptions::default())
    );
}

#[test]
fn places_where_the_robot_does_not_fit_are_named_with_the_nearest_that_do() {
    let options = PlanOptions::default();
    let PlanOutcome::GoalOccupied {
        nearest_free: Some(near),
    } = ask(&room(), (0.0, 0.0), (1.52, 0.0), &options)
    else {
        panic!()
    };
    assert!((near - Point2::new(1.52, 0.0)).norm() < 0.4);
    assert!(matches!(
        ask(&room(), (1.52, 0.0), (0.0, 0.0), &options),
        PlanOutcome::StartOccupied { nearest_free: Some(_) }
    ));
    assert_eq!(ask(&room(), (0.0, 0.0), (9.0, 0.0), &options), PlanOutcome::OutOfMap);
    assert_eq!(
        ask(&room(), (f64::NAN, 0.0), (0.0, 0.0), &options),
        PlanOutcome::OutOfMap
    );
    let mut closed = room();
    for y in 60..80 {
        closed[Cell::new(50, y)] = Occupancy::OCCUPIED;
    }
    assert_eq!(ask(&closed, (0.0, 0.0), (3.0, 0.0), &options), PlanOutcome::NoPath);
}

#[test]
fn to_stay_where_it_is_is_a_path_without_length() {
    let outcome = ask(&room(), (0.0, 0.0), (0.0, 0.0), &PlanOptions::default());
    assert_eq!(
        outcome,
        PlanOutcome::Found {
            path: vec![Point2::origin(); 2],
            length: 0.0
        }
    );
}

#[test]
fn a_robot_close_to_a_wall_leaves_it() {
    // The wall's face is at x = -0.95: 1 cm between robot and wall, then 1 cm of the robot in the wall's cell.
    for x in [-0.95 + RADIUS + 0.01, -0.95 + RADIUS - 0.01] {
        assert!(
            matches!(
                ask(&room(), (x, 0.0), (1.0, 0.0), &PlanOptions::default()),
                PlanOutcome::Found { .. }
            ),
            "{x}"
        );
    }
    assert!(matches!(
        ask(&room(), (-0.9, 0.0), (1.0, 0.0), &PlanOptions::default()),
        PlanOutcome::StartOccupied { .. }
    ));
}

/// 0.8 m by 0.3 m.
fn long_outline() -> Footprint {
    zenav_fixtures::footprint(&[(-0.4, -0.15), (0.4, -0.15), (0.4, 0.15), (-0.4, 0.15)])
}

/// The long robot in the room, where the dividing wall has a door of `gap` cells.
fn ask_long(gap: u32, start: Pose2, goal: (f64, f64), planner: Planner) -> Planned {
    let mut grid = room();
    for y in 1..79 {
        let is_door = (40..40 + gap).contains(&y);
        grid[Cell::new(50, y)] = if is_door { Occupancy::FREE } else { Occupancy::OCCUPIED };
    }
    let space = ConfigurationSpace::new(&grid, &long_outline(), UnknownPolicy::Blocked, 0.0);
    let mut searcher = Searcher::new(space.free()).unwrap();
    let mut options = PlanOptions::new(planner);
    options.settings.sampling.improving = 200;
    let goal = Pose2::new(goal.0, goal.1, 0.0);
    let planned = plan(&space, &mut searcher, start, goal, &options, Budget::UNLIMITED);
    let again = crate::Replanner::new(&space)
        .unwrap()
        .plan(&space, start, goal, &options, Budget::UNLIMITED);
    assert_eq!(again.unwrap(), planned);
    if let PlanOutcome::Found { path, .. } = &planned.outcome {
        assert!(
            se2_search::is_drivable(&space, path, &planned.backwards, Some(start.yaw)),
            "{planner}: {path:?}"
        );
    }
    planned
}

#[test]
fn every_path_of_every_planner_can_be_driven_by_a_robot_that_is_longer_than_wide() {
    let by = |gap, planner| {
        let planned = ask_long(gap, Pose2::new(0.0, 0.0, 1.0), (3.0, 0.0), planner);
        (planned.found_by, planned.outcome)
    };
    for (_, planner) in Planner::ALL {
        let first = if planner.keeps_clear() {
            FootprintSearch::Inscribed
        } else {
            FootprintSearch::Circumscribed
        };
        // A door of 1 m has room to turn; one of 45 cm can be passed lengthways; one of 25 cm is too narrow.
        assert_eq!(by(19, *planner).0, Some(first), "{planner}");
        assert!(by(9, *planner).0.is_some(), "{planner}");
        assert_eq!(by(5, *planner), (None, PlanOutcome::NoPath), "{planner}");
    }
}

#[test]
fn a_long_robot_goes_into_a_niche_as_far_as_it_fits_and_not_as_far_as_a_disc_would() {
    let (mut grid, goal) = (room(), Point2::new(3.0, 0.0));
    // The niche is 0.3 m deep behind the goal and open on one side; the robot reaches 0.4 m.
    let cells = (0..80).flat_map(|y| (0..100).map(move |x| Cell::new(x, y)));
    for cell in cells {
        let off = grid.spec().center(cell) - goal;
        if (0.3..0.4).contains(&off.norm()) && !(off.x < 0.0 && off.y.abs() < 0.25) {
            grid[cell] = Occupancy::OCCUPIED;
        }
    }
    let space = ConfigurationSpace::new(&grid, &long_outline(), UnknownPolicy::Blocked, 0.0);
    let ask = |goal_tolerance| {
        let options = PlanOptions {
            goal_tolerance,
            ..PlanOptions::default()
        };
        let (start, goal) = (Pose2::new(0.0, 0.0, 0.0), Pose2::new(goal.x, goal.y, 0.0));
        let mut searcher = Searcher::new(space.free()).unwrap();
        plan(&space, &mut searcher, start, goal, &options, Budget::UNLIMITED)
    };
    let PlanOutcome::GoalOccupied {
        nearest_free: Some(near),
    } = ask(0.0).outcome
    else {
        panic!("{:?}", ask(0.0))
    };
    assert!((0.05..0.25).contains(&(near - goal).norm()), "{near}");
    let planned = ask(0.25);
    let PlanOutcome::Found { path, .. } = &planned.outcome else {
        panic!("{planned:?}")
    };
    assert!((path[path.len() - 1] - goal).norm() <= 0.25);
    assert!(se2_search::is_drivable(&space, path, &planned.backwards, Some(0.0)));
}

#[test]
fn a_robot_that_stands_in_an_obstacle_leaves_it_only_where_that_is_asked_for() {
    let space = ConfigurationSpace::new(&room(), &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0);
    let mut searcher = Searcher::new(space.free()).unwrap();
    let (start, goal) = (Pose2::new(-0.93, 0.0, 0.0), Pose2::new(1.0, 0.0, 0.0));
    let mut ask = |escape| {
        let options = PlanOptions {
            escape,
            ..PlanOptions::default()
        };
        plan(&space, &mut searcher, start, goal, &options, Budget::UNLIMITED)
    };
    assert!(matches!(ask(0.1).outcome, PlanOutcome::StartOccupied { .. }));
    let escaped = ask(0.6);
    let PlanOutcome::Found { path, length } = &escaped.outcome else {
        panic!("{escaped:?}")
    };
    assert!(escaped.escapes && path[0] == start.position() && path[path.len() - 1] == goal.position());
    let legs: f64 = path.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum();
    assert!((length - legs).abs() < 1e-9);
    assert!(
        path.windows(2)
            .skip(1)
            .all(|leg| space.segment_is_free(leg[0], leg[1], RADIUS))
    );
}
