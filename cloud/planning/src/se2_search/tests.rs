//! Tests of paths for robots that are longer than wide.

use proptest::prelude::*;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::robot::Footprint;

use super::*;
use crate::cell_cost::Uniform;
use zenav_space::UnknownPolicy;

/// 0.8 m long, 0.3 m wide; the base is off the middle.
fn long() -> Footprint {
    zenav_fixtures::footprint(&[(-0.5, -0.15), (0.3, -0.15), (0.3, 0.15), (-0.5, 0.15)])
}

/// A room of 6 m by 4 m with 5 cm cells; `is_wall` gives the walls (m).
fn room(is_wall: impl Fn(f64, f64) -> bool) -> OccupancyGrid {
    zenav_fixtures::walled_room(zenav_fixtures::spec(120, 80, 0.05), |at| is_wall(at.x, at.y))
}

fn path(grid: &OccupancyGrid, start: Pose2, goal: (f64, f64), any: bool) -> Result<Vec<Point2<f64>>, NotFound> {
    driven(grid, start, goal, any).map(|path| path.corners)
}

fn driven(grid: &OccupancyGrid, start: Pose2, goal: (f64, f64), any: bool) -> Result<DrivenPath, NotFound> {
    let space = ConfigurationSpace::new(grid, &long(), UnknownPolicy::Blocked, 0.0);
    let heading = (!any).then_some(start.yaw);
    let query = Query {
        start: start.position(),
        heading,
        goal: Point2::new(goal.0, goal.1),
        tolerance: 0.0,
    };
    let found = search(&space, &Uniform, &query, &Se2Settings::default(), Budget::UNLIMITED).result;
    if let Ok(path) = &found {
        let DrivenPath { corners, backwards } = path;
        assert!(is_drivable(&space, corners, backwards, heading), "{path:?}");
        assert_eq!((corners[0], corners[corners.len() - 1]), (query.start, query.goal));
    }
    found
}

#[test]
fn a_long_robot_goes_through_a_gap_that_it_only_fits_lengthways() {
    // A gap of 0.4 m in a wall of 1 m.
    let grid = room(|x, y| (2.5..3.5).contains(&x) && !(1.8..2.2).contains(&y));
    let found = path(&grid, Pose2::new(1.0, 1.0, 0.0), (5.0, 3.0), false).unwrap();
    assert!(found.len() >= 4);
}

#[test]
fn where_there_is_no_room_to_turn_there_is_no_path() {
    // A gap of 0.45 m round a corner.
    let grid = room(|x, y| {
        let along = x < 4.5 && (1.0..1.45).contains(&y);
        let up = (4.05..4.5).contains(&x) && (1.0..3.0).contains(&y);
        x > 1.5 && !along && !up
    });
    assert_eq!(
        path(&grid, Pose2::new(1.0, 1.225, 0.0), (4.275, 2.9), false),
        Err(NotFound::NoPath)
    );
    assert!(path(&grid, Pose2::new(2.0, 1.225, 0.0), (4.0, 1.225), false).is_ok());
}

#[test]
fn a_robot_that_cannot_turn_where_it_stands_goes_on_to_where_it_can() {
    let grid = room(|x, y| x < 2.0 && !(1.8..2.2).contains(&y));
    let start = Pose2::new(0.8, 2.0, 0.0);
    let found = path(&grid, start, (5.0, 1.0), false).unwrap();
    assert!((found[1].y - 2.0).abs() < 0.05 && found[2].x > 2.0, "{found:?}");
    assert!(path(&grid, Pose2 { yaw: 1.5, ..start }, (5.0, 1.0), false).is_err());
    assert!(path(&grid, Pose2 { yaw: 1.5, ..start }, (5.0, 1.0), true).is_ok());
}

#[test]
fn a_robot_backs_out_of_a_lane_in_which_it_cannot_turn_and_nowhere_else() {
    // A lane of 0.5 m that ends 10 cm before the robot.
    let in_lane = |x: f64, y: f64| (2.7..4.4).contains(&x) && (y - 2.0).abs() < 0.25;
    let grid = room(|x, y| (x - 4.0).hypot(y - 2.0) < 1.2 && !in_lane(x, y));
    let found = driven(&grid, Pose2::new(4.0, 2.0, 0.0), (1.0, 1.0), false).unwrap();
    assert_eq!(found.backwards.first(), Some(&0), "{found:?}");
    assert!(found.backwards.len() < found.corners.len() - 1, "{found:?}");
    let open = driven(&room(|_, _| false), Pose2::new(4.0, 2.0, 0.0), (1.0, 1.0), false).unwrap();
    assert!(open.backwards.is_empty(), "{open:?}");
}

#[test]
fn coarse_cells_leave_places_between_their_centres() {
    // Two cells: the only place to go through is the border between them.
    let wall: Vec<_> = (0..9).chain(11..20).map(|y| (15, y)).collect();
    let grid = zenav_fixtures::map_with_occupied(zenav_fixtures::spec(30, 20, 0.2), &wall);
    assert!(path(&grid, Pose2::new(1.0, 1.0, 0.0), (5.0, 3.0), false).is_ok());
}

#[test]
fn beside_a_wall_the_path_ends_where_the_robot_comes_to_at_an_angle() {
    let outline = zenav_fixtures::footprint(&[(-0.21, -0.165), (0.21, -0.165), (0.21, 0.165), (-0.21, 0.165)]);
    let grid = zenav_fixtures::walled_room(zenav_fixtures::spec(240, 160, 0.025), |_| false);
    let space = ConfigurationSpace::new(&grid, &outline, UnknownPolicy::Blocked, 0.0);
    let ask = |tolerance: f64| {
        // Along the wall there are 2 cm beside the outline.
        let goal = Point2::new(4.0, 0.025 + 0.165 + 0.02);
        let query = Query {
            start: Point2::new(1.0, 2.0),
            heading: Some(0.3),
            goal,
            tolerance,
        };
        let budget = Budget {
            max_expansions: 500_000,
            ..Budget::UNLIMITED
        };
        let path = search(&space, &Uniform, &query, &Se2Settings::default(), budget).result?;
        assert!(is_drivable(&space, &path.corners, &path.backwards, query.heading));
        Ok((path.corners[path.corners.len() - 1] - goal).norm())
    };
    assert_eq!(ask(0.0), Err(NotFound::TimedOut));
    let off = ask(0.03).unwrap();
    assert!((0.01..=0.03).contains(&off), "{off}");
}

#[test]
fn an_outline_of_many_corners_turns_beside_an_obstacle() {
    // As many corners as a robot may have; the area swept by a turn has five times as many.
    let corner = |nth: u32| {
        let (sin, cos) = (f64::from(nth) * std::f64::consts::TAU / 64.0).sin_cos();
        Point2::new(0.3 * cos, 0.3 * sin)
    };
    let outline = Footprint::Polygon((0..64).map(corner).collect());
    // Nearer than the distance from which on no outline is looked at, and farther away than the outline reaches.
    let grid = zenav_fixtures::map_with_occupied(zenav_fixtures::spec(40, 40, 0.05), &[(20, 29)]);
    let space = ConfigurationSpace::new(&grid, &outline, UnknownPolicy::Blocked, 0.0);
    let masks = FootprintMasks::new(&space).unwrap();
    assert!(!masks.has_room_to_turn((20, 20)) && masks.can_turn_round((20, 20)));
}

#[test]
fn a_search_without_budget_times_out() {
    let space = ConfigurationSpace::new(&room(|_, _| false), &long(), UnknownPolicy::Blocked, 0.0);
    let query = Query {
        start: Point2::new(1.0, 1.0),
        heading: None,
        goal: Point2::new(5.0, 3.0),
        tolerance: 0.0,
    };
    for max_expansions in [10, 5000] {
        let budget = Budget {
            max_expansions,
            ..Budget::UNLIMITED
        };
        assert_eq!(
            search(&space, &Uniform, &query, &Se2Settings::default(), budget).result,
            Err(NotFound::TimedOut)
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn whatever_is_found_can_be_driven(
        boxes in prop::collection::vec((0.3..5.5_f64, 0.3..3.5_f64, 0.1..0.8_f64, 0.1..0.8_f64), 0..9),
        ends in prop::array::uniform2((0.3..5.7_f64, 0.3..3.7_f64)), yaw in -3.1..3.1_f64, any in any::<bool>(),
    ) {
        let grid = room(|x, y| boxes.iter().any(|(left, low, w, h)| (*left..left + w).contains(&x) && (*low..low + h).contains(&y)));
        let [start, goal] = ends;
        let _ = path(&grid, Pose2::new(start.0, start.1, yaw), goal, any);
    }
}
