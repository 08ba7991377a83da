//! Tests of replanning: a kept answer is as good as a new search.

use proptest::prelude::*;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::messages::PlanOutcome;
use zenav_protocol::robot::Footprint;

use super::disc::{Known, cells_along};
use super::*;
use crate::Searcher;
use crate::cell_cost::costs_along;
use crate::path::Path;
use crate::plan::{between, costs_of};
use crate::planners::Planner;
use zenav_protocol::grid::Cell;
use zenav_space::{LineOfSight as _, UnknownPolicy};

const SIDE: u32 = 90;

fn end(cell: Cell) -> End {
    End {
        point: cell.center(),
        cell,
    }
}

/// An empty room of metre-wide cells.
fn room() -> OccupancyGrid {
    zenav_fixtures::free_map(zenav_fixtures::spec(SIDE, SIDE, 1.0))
}

fn set(grid: &mut OccupancyGrid, x: u32, y: u32, is_free: bool) {
    grid[Cell::new(x, y)] = if is_free { Occupancy::FREE } else { Occupancy::OCCUPIED };
}

fn space(grid: &OccupancyGrid) -> ConfigurationSpace {
    ConfigurationSpace::new(grid, &Footprint::Radius(0.3), UnknownPolicy::Blocked, 0.0)
}

fn options() -> [PlanOptions; 4] {
    let mut far = PlanOptions::default();
    far.settings.clearance.distance = 2.5;
    [
        PlanOptions::shortest(Planner::Jps),
        PlanOptions::shortest(Planner::AStar),
        far,
        PlanOptions::shortest(Planner::Theta),
    ]
}

fn cost(space: &ConfigurationSpace, options: &PlanOptions, path: &Path) -> u32 {
    let searcher = Searcher::new(space.free()).unwrap();
    let costs = costs_along(searcher.graph(), &costs_of(space, options), &cells_along(path));
    *costs.unwrap().last().unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn an_answer_is_as_good_as_a_search_from_scratch_whatever_has_changed(
        walls in prop::collection::vec((0..SIDE, 0..SIDE, 1_u32..12, 1_u32..4), 0..40),
        fence in any::<bool>(),
        steps in prop::collection::vec((prop::collection::vec((0..SIDE, 0..SIDE, 1_u32..5, any::<bool>()), 0..4), 0_usize..6, 0_u32..30, prop::option::weighted(0.3, (0..SIDE - 4, any::<bool>()))), 1..10),
    ) {
        let mut grid = room();
        for (x, y, long, thick) in walls {
            (0..long * thick).for_each(|i| set(&mut grid, (x + i % long).min(SIDE - 1), (y + i / long).min(SIDE - 1), false));
        }
        // With a fence there is no path at all until a door opens in it.
        (0..SIDE).filter(|_| fence).for_each(|y| set(&mut grid, 45, y, false));
        let goal = Cell::new(SIDE - 3, SIDE - 4);
        let mut replanner = DiscReplanner::new(&space(&grid)).unwrap();
        let mut starts = [Cell::new(2, 3); 4];
        for (changes, moved, aside, door) in steps {
            if let Some((y, is_open)) = door.filter(|_| fence) {
                (y..y + 4).for_each(|y| set(&mut grid, 45, y, is_open));
            }
            for (x, y, size, is_free) in changes {
                (0..size * size).for_each(|i| set(&mut grid, (x + i % size).min(SIDE - 1), (y + i / size).min(SIDE - 1), is_free));
            }
            set(&mut grid, goal.x, goal.y, true);
            starts.iter().for_each(|start| set(&mut grid, start.x, start.y, true));
            let space = space(&grid);
            replanner.follow(&space).unwrap();
            prop_assert_eq!(&replanner.free, space.free());
            for (options, start) in options().iter().zip(&mut starts) {
                // Plans begin and end at free cells only.
                if !(space.is_free(*start) && space.is_free(goal)) {
                    continue;
                }
                let (found, origin) = replanner.find(&space, end(*start), end(goal), options, Budget::UNLIMITED);
                let anew = between(&space, &mut Searcher::new(space.free()).unwrap(), end(*start), end(goal), options, Budget::UNLIMITED);
                if let (Planner::Theta, PlanOrigin::Reused, Ok(path)) = (options.planner, origin, &found.result) {
                    // A reused path may lead where no path over the grid leads any more.
                    prop_assert!(path.corners.windows(2).all(|leg| space.sees(leg[0], leg[1])));
                    continue;
                }
                let (Ok(found), Ok(anew)) = (&found.result, &anew.result) else {
                    prop_assert_eq!(found.result, anew.result);
                    continue;
                };
                prop_assert_eq!((found.corners[0], found.corners[found.corners.len() - 1]), (end(*start).point, end(goal).point));
                if options.planner == Planner::Theta {
                    prop_assert!(found.corners.windows(2).all(|leg| space.sees(leg[0], leg[1])));
                    continue;
                }
                let [found_cost, least] = [found, anew].map(|path| cost(&space, options, path));
                match origin {
                    PlanOrigin::Searched | PlanOrigin::Reused => prop_assert_eq!(found_cost, least),
                    PlanOrigin::Repaired => prop_assert!(found_cost >= least && found_cost - least <= least / 50),
                }
                let cells = cells_along(found);
                *start = cells[moved.min(cells.len() - 1)];
                if aside < 3 && space.is_free(Cell::new(start.x + aside, start.y)) {
                    start.x += aside;
                }
            }
        }
    }
}

/// A plan from the left to the right of a room; the map has a wall with a door in the middle.
fn asked(replanner: &mut Replanner, grid: &OccupancyGrid, x: f64, options: &PlanOptions) -> Planned {
    let [start, goal] = [x, 80.5].map(|x| Pose2::new(x, 45.5, 0.0));
    replanner
        .plan(&space(grid), start, goal, options, Budget::UNLIMITED)
        .unwrap()
}

fn walled() -> OccupancyGrid {
    let mut grid = room();
    (0..SIDE)
        .filter(|y| !(30..38).contains(y))
        .for_each(|y| set(&mut grid, 40, y, false));
    grid
}

#[test]
fn what_the_path_has_nothing_to_do_with_changes_nothing() {
    for options in options() {
        let mut grid = walled();
        let mut replanner = Replanner::new(&space(&grid)).unwrap();
        let first = asked(&mut replanner, &grid, 10.5, &options);
        assert_eq!(first.origin, PlanOrigin::Searched);
        // An obstacle appears and disappears, far away.
        set(&mut grid, 60, 2, false);
        assert_eq!(asked(&mut replanner, &grid, 10.5, &options).outcome, first.outcome);
        set(&mut grid, 60, 2, true);
        let last = asked(&mut replanner, &grid, 10.5, &options);
        assert_eq!(
            (last.outcome, last.expansions, last.origin),
            (first.outcome, 0, PlanOrigin::Reused)
        );
    }
}

#[test]
fn the_rest_of_the_path_stands_when_the_robot_has_moved_on() {
    for options in options() {
        let (grid, mut replanner) = (walled(), Replanner::new(&space(&walled())).unwrap());
        let Ok(path) = replanner
            .disc(FootprintSearch::Inscribed, &space(&grid))
            .unwrap()
            .find(
                &space(&grid),
                end(Cell::new(10, 45)),
                end(Cell::new(80, 45)),
                &options,
                Budget::UNLIMITED,
            )
            .0
            .result
        else {
            panic!("no path")
        };
        // A cell of the path: legs over the grid have a whole number of steps.
        let leg = path.corners[1] - path.corners[0];
        let on = path.corners[0] + leg * ((0.5 * leg.amax()).floor() / leg.amax());
        let start = Pose2::new(on.x.floor() + 0.5, on.y.floor() + 0.5, 0.0);
        let rest = replanner
            .plan(
                &space(&grid),
                start,
                Pose2::new(80.5, 45.5, 0.0),
                &options,
                Budget::UNLIMITED,
            )
            .unwrap();
        assert_eq!((rest.origin, rest.expansions), (PlanOrigin::Reused, 0), "{options:?}");
    }
}

#[test]
fn a_cut_is_mended_and_a_closed_door_is_found_out() {
    let options = PlanOptions::shortest(Planner::AStar);
    let mut grid = walled();
    let mut replanner = Replanner::new(&space(&grid)).unwrap();
    let whole = asked(&mut replanner, &grid, 10.5, &options);
    let found = replanner.discs[0].1.kept[0].clone();
    let Known::Grid { cells, .. } = &found.known else {
        panic!()
    };
    let on = cells[cells.len() * 3 / 4];
    set(&mut grid, on.x, on.y, false);
    let mended = asked(&mut replanner, &grid, 10.5, &options);
    assert_eq!(mended.origin, PlanOrigin::Repaired);
    assert!(
        mended.expansions * 3 < whole.expansions,
        "{} of {}",
        mended.expansions,
        whole.expansions
    );
    (30..38).for_each(|y| set(&mut grid, 40, y, false));
    let closed = asked(&mut replanner, &grid, 10.5, &options);
    assert_eq!(
        (closed.outcome, closed.origin),
        (PlanOutcome::NoPath, PlanOrigin::Searched)
    );
    // It stays closed until something opens.
    set(&mut grid, 20, 20, false);
    assert_eq!(asked(&mut replanner, &grid, 10.5, &options).origin, PlanOrigin::Reused);
    set(&mut grid, 20, 20, true);
    assert_eq!(
        asked(&mut replanner, &grid, 10.5, &options).outcome,
        PlanOutcome::NoPath,
        "elsewhere"
    );
    (4..7).for_each(|y| set(&mut grid, 40, y, true));
    assert!(matches!(
        asked(&mut replanner, &grid, 10.5, &options).outcome,
        PlanOutcome::Found { .. }
    ));
}

#[test]
fn a_shortcut_is_not_missed() {
    for options in options() {
        let mut grid = walled();
        let mut replanner = Replanner::new(&space(&grid)).unwrap();
        let before = asked(&mut replanner, &grid, 10.5, &options);
        (40..50).for_each(|y| set(&mut grid, 40, y, true));
        let after = asked(&mut replanner, &grid, 10.5, &options);
        assert_eq!(after.origin, PlanOrigin::Searched);
        assert_ne!(before.outcome, after.outcome);
    }
}

#[test]
fn a_diagonal_step_beside_a_cell_that_became_known_is_not_missed() {
    for options in [
        PlanOptions::shortest(Planner::Jps),
        PlanOptions::shortest(Planner::AStar),
    ] {
        let mut grid = room();
        // It forbids one step of the only path without a straight step, and lies on no shortest path itself.
        grid[Cell::new(42, 41)] = Occupancy::UNKNOWN;
        let mut replanner = DiscReplanner::new(&space(&grid)).unwrap();
        let mut ask = |grid: &OccupancyGrid| {
            let space = space(grid);
            replanner.follow(&space).unwrap();
            let [start, goal] = [35, 50].map(|at| end(Cell::new(at, at)));
            let (found, origin) = replanner.find(&space, start, goal, &options, Budget::UNLIMITED);
            (found.result.unwrap().length, origin)
        };
        let (before, _) = ask(&grid);
        set(&mut grid, 42, 41, true);
        let (after, origin) = ask(&grid);
        assert_eq!(origin, PlanOrigin::Searched, "{options:?}");
        let diagonal = std::f64::consts::SQRT_2;
        assert!((before - 2.0 - 14.0 * diagonal).abs() < 1e-9 && (after - 15.0 * diagonal).abs() < 1e-9);
    }
}

#[test]
fn a_map_that_has_grown_is_prepared_anew() {
    let mut replanner = Replanner::new(&space(&room())).unwrap();
    let grid = zenav_fixtures::free_map(zenav_fixtures::spec(2 * SIDE, SIDE, 1.0));
    let goal = Pose2::new(170.5, 5.5, 0.0);
    let planned = replanner.plan(
        &space(&grid),
        Pose2::new(1.5, 1.5, 0.0),
        goal,
        &options()[0],
        Budget::UNLIMITED,
    );
    assert!(matches!(planned.unwrap().outcome, PlanOutcome::Found { .. }));
}
