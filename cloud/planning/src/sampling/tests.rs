//! Properties of every planner that grows trees.

use std::sync::atomic::AtomicBool;

use nalgebra::Point2;
use proptest::prelude::*;
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
use zenav_protocol::robot::Footprint;

use crate::{Budget, NotFound, Path, Planner, Query, Searched, Searcher};
use zenav_space::{BitGrid, ConfigurationSpace, LineOfSight as _, PointLineOfSight, UnknownPolicy};

const PLANNERS: [Planner; 3] = [Planner::Rrt, Planner::RrtConnect, Planner::RrtStar];

/// Enough samples for a search to cover any of the small maps here, and some more.
const SAMPLES: u64 = 2000;

fn budget(samples: u64) -> Budget<'static> {
    Budget {
        max_samples: samples,
        ..Budget::UNLIMITED
    }
}

fn query(start: Cell, goal: Cell) -> Query {
    Query {
        start: start.center(),
        goal: goal.center(),
        seed: 7,
    }
}

fn ask(free: &BitGrid, planner: Planner, query: &Query, budget: Budget<'_>) -> Searched {
    let sight = PointLineOfSight::new(free);
    Searcher::new(free).unwrap().search(planner, &sight, query, budget)
}

/// Whether a segment touches the closed square of a cell: separating axes, one by one.
fn touches(a: Point2<f64>, b: Point2<f64>, x: f64, y: f64) -> bool {
    let apart = a.x.max(b.x) < x || a.x.min(b.x) > x + 1.0 || a.y.max(b.y) < y || a.y.min(b.y) > y + 1.0;
    let side = |x: f64, y: f64| (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x);
    let sides = [side(x, y), side(x + 1.0, y), side(x, y + 1.0), side(x + 1.0, y + 1.0)];
    !(apart || sides.iter().all(|side| *side > 0.0) || sides.iter().all(|side| *side < 0.0))
}

fn is_free(free: &BitGrid, path: &Path) -> bool {
    let cells = (0..free.height()).flat_map(|y| (0..free.width()).map(move |x| Cell::new(x, y)));
    let blocked: Vec<Cell> = cells.filter(|cell| !free.get(*cell)).collect();
    let inside =
        |p: &Point2<f64>| p.x > 0.0 && p.y > 0.0 && p.x < f64::from(free.width()) && p.y < f64::from(free.height());
    path.corners.iter().all(inside)
        && path.corners.windows(2).all(|leg| {
            let hits = |cell: &Cell| touches(leg[0], leg[1], cell.x.into(), cell.y.into());
            !blocked.iter().any(hits)
        })
}

/// Maps with free ends: clutter of any density, with sides of up to slightly more than a word.
fn map() -> impl Strategy<Value = (BitGrid, Query)> {
    (
        1_u32..70,
        1_u32..40,
        1_u8..12,
        prop::collection::vec(0_u8..12, 70 * 40),
        any::<[u32; 4]>(),
        any::<u64>(),
    )
        .prop_map(|(width, height, density, cells, ends, seed)| {
            let mut free = BitGrid::from_fn(width, height, |cell| cells[(cell.y * 70 + cell.x) as usize] < density);
            let (start, goal) = (
                Cell::new(ends[0] % width, ends[1] % height),
                Cell::new(ends[2] % width, ends[3] % height),
            );
            free.set(start, true);
            free.set(goal, true);
            (
                free,
                Query {
                    seed,
                    ..query(start, goal)
                },
            )
        })
}

/// A room with a wall across it; the wall has a door of one cell at the given height.
fn room(width: u32, height: u32, door: Option<u32>) -> BitGrid {
    BitGrid::from_fn(width, height, |cell| cell.x != width / 2 || Some(cell.y) == door)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn a_path_is_found_exactly_where_free_cells_connect_and_it_is_free((free, query) in map()) {
        let expected = ask(&free, Planner::AStar, &query, Budget::UNLIMITED).result;
        for planner in PLANNERS {
            match ask(&free, planner, &query, budget(SAMPLES)).result {
                Ok(path) => {
                    prop_assert!(expected.is_ok() && is_free(&free, &path), "{}", planner);
                    prop_assert_eq!((path.corners[0], path.corners[path.corners.len() - 1]), (query.start, query.goal));
                    prop_assert!(path.length >= (query.goal - query.start).norm() - 1e-9);
                }
                Err(error) => {
                    prop_assert_eq!(error, NotFound::NoPath, "{}", planner);
                    prop_assert_eq!(&expected, &Err(NotFound::NoPath), "{}", planner);
                }
            }
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_path_whatever_was_searched_before((free, query) in map(), (_, before) in map()) {
        let sight = PointLineOfSight::new(&free);
        for planner in PLANNERS {
            let mut searcher = Searcher::new(&free).unwrap();
            let first = searcher.search(planner, &sight, &query, budget(300));
            searcher.search(planner, &sight, &before, budget(300));
            prop_assert_eq!(&searcher.search(planner, &sight, &query, budget(300)), &first);
        }
    }

    #[test]
    fn more_samples_never_make_a_path_longer((free, query) in map()) {
        let mut last = f64::INFINITY;
        for samples in [0, 50, 100, 200, 400, 800] {
            if let Ok(path) = ask(&free, Planner::RrtStar, &query, budget(SAMPLES + samples)).result {
                prop_assert!(path.length <= last + 1e-9);
                last = path.length;
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_disc_fits_all_along_its_path(walls in prop::collection::vec((0_u32..60, 0_u32..60, 1_u32..20, any::<bool>()), 0..12), ends in any::<[u16; 4]>(), seed in any::<u64>()) {
        let spec = GridSpec { origin: Point2::new(-1.0, 2.0), resolution: 0.05, width: 60, height: 60 };
        let mut grid = Grid::filled(spec, Occupancy::FREE);
        for (x, y, length, is_level) in walls {
            for i in 0..length {
                let cell = if is_level { Cell::new((x + i).min(59), y) } else { Cell::new(x, (y + i).min(59)) };
                grid[cell] = Occupancy::OCCUPIED;
            }
        }
        let space = ConfigurationSpace::new(&grid, &Footprint::Radius(0.12), UnknownPolicy::Blocked, 0.0);
        // Anywhere, not at centres of cells.
        let [a, b, c, d] = ends.map(|end| f64::from(end) / 65536.0 * 60.0);
        let query = Query { start: Point2::new(a, b), goal: Point2::new(c, d), seed };
        for planner in PLANNERS {
            match Searcher::new(space.free()).unwrap().search(planner, &space, &query, budget(SAMPLES)).result {
                Ok(path) => {
                    prop_assert_eq!((path.corners[0], path.corners[path.corners.len() - 1]), (query.start, query.goal));
                    for leg in path.corners.windows(2) {
                        let [from, to] = [leg[0], leg[1]].map(|p| spec.from_cells(p));
                        prop_assert!(space.segment_clearance(from, to) >= 0.12 - 1e-9, "{}", planner);
                    }
                }
                Err(NotFound::StartBlocked) => prop_assert!(!space.admits(query.start)),
                Err(NotFound::GoalBlocked) => prop_assert!(!space.admits(query.goal)),
                Err(NotFound::NoPath | NotFound::TimedOut) => {}
                Err(NotFound::OutOfMap | NotFound::TooLong) => prop_assert!(false),
            }
        }
    }
}

#[test]
fn a_closed_room_has_no_path_out_and_one_cell_is_a_door() {
    let (start, goal) = (Cell::new(3, 3), Cell::new(140, 100));
    for planner in PLANNERS {
        let closed = ask(&room(150, 120, None), planner, &query(start, goal), Budget::UNLIMITED);
        assert_eq!(closed.result, Err(NotFound::NoPath), "{planner}");
        let open = ask(&room(150, 120, Some(77)), planner, &query(start, goal), budget(SAMPLES));
        assert!(open.result.unwrap().length < 220.0, "{planner}");
    }
}

#[test]
fn rrt_star_comes_close_to_the_shortest_path() {
    // The shortest path runs over the two nearer corners of the only door, whose cell is one wide.
    let free = room(101, 80, Some(60));
    let query = query(Cell::new(10, 10), Cell::new(90, 20));
    let (left, right) = (Point2::new(50.0, 60.0), Point2::new(51.0, 60.0));
    let shortest = (left - query.start).norm() + 1.0 + (query.goal - right).norm();
    let path = ask(&free, Planner::RrtStar, &query, budget(500)).result.unwrap();
    assert!(
        path.length >= shortest && path.length < shortest * 1.001,
        "{} against {shortest}",
        path.length
    );
    // Two paths around a block: the first that is met is not always the shorter one.
    let free = BitGrid::from_fn(101, 101, |cell| {
        !((20..80).contains(&cell.x) && (20..75).contains(&cell.y))
    });
    for seed in 0..10 {
        let query = Query {
            start: Point2::new(50.5, 5.5),
            goal: Point2::new(52.5, 95.5),
            seed,
        };
        let around = |x: f64| {
            let (low, high) = (Point2::new(x, 20.0), Point2::new(x, 75.0));
            (low - query.start).norm() + 55.0 + (query.goal - high).norm()
        };
        let path = ask(&free, Planner::RrtStar, &query, budget(4000)).result.unwrap();
        assert!(path.length >= around(80.0) && path.length < around(80.0) * 1.002 && around(80.0) < around(20.0));
    }
}

#[test]
fn ends_that_cannot_be_are_told_apart() {
    let mut free = room(40, 30, Some(5));
    free.set(Cell::new(2, 2), false);
    let one = BitGrid::from_fn(1, 1, |_| true);
    let (a, b) = (Cell::new(5, 5), Cell::new(35, 25));
    for planner in PLANNERS {
        let result = |free: &BitGrid, query: Query| ask(free, planner, &query, budget(SAMPLES)).result;
        let stay = result(&free, query(a, a)).unwrap();
        assert_eq!((stay.corners, stay.length), (vec![a.center()], 0.0));
        assert_eq!(
            result(&one, query(Cell::new(0, 0), Cell::new(0, 0))).unwrap().length,
            0.0
        );
        assert_eq!(result(&free, query(Cell::new(2, 2), b)), Err(NotFound::StartBlocked));
        assert_eq!(result(&free, query(a, Cell::new(2, 2))), Err(NotFound::GoalBlocked));
        assert_eq!(result(&free, query(a, Cell::new(40, 2))), Err(NotFound::OutOfMap));
        assert_eq!(result(&BitGrid::new(0, 0), query(a, b)), Err(NotFound::OutOfMap));
        for bad in [f64::NAN, f64::INFINITY, -0.5, 1e300] {
            let off = Query {
                goal: Point2::new(bad, 3.5),
                ..query(a, b)
            };
            assert_eq!(result(&free, off), Err(NotFound::OutOfMap));
        }
    }
}

#[test]
fn a_search_ends_with_its_budget_and_when_it_is_told_to() {
    let free = room(150, 120, Some(77));
    let query = query(Cell::new(3, 3), Cell::new(140, 100));
    let cancel = AtomicBool::new(true);
    for planner in PLANNERS {
        let cancelled = ask(
            &free,
            planner,
            &query,
            Budget {
                cancel: Some(&cancel),
                ..Budget::UNLIMITED
            },
        );
        assert_eq!((cancelled.result, cancelled.expansions), (Err(NotFound::TimedOut), 0));
        let short = ask(&free, planner, &query, budget(3));
        assert_eq!((short.result, short.expansions), (Err(NotFound::TimedOut), 3));
    }
    let improved = ask(&free, Planner::RrtStar, &query, budget(5000));
    assert_eq!(improved.expansions, 5000, "what is left is used");
}

#[test]
fn samples_come_from_the_domain_that_is_set() {
    let free = BitGrid::from_fn(100, 100, |cell| !(cell.x == 50 && cell.y < 90));
    let mut searcher = Searcher::new(&free).unwrap();
    let low = [Point2::new(0.0, 40.0), Point2::new(100.0, 100.0)];
    searcher.domain = Some(low);
    searcher.sampling.patience = u64::MAX;
    searcher.sampling.corners = 0.0;
    let query = query(Cell::new(10, 45), Cell::new(90, 45));
    let sight = PointLineOfSight::new(&free);
    for planner in PLANNERS {
        assert!(searcher.search(planner, &sight, &query, budget(SAMPLES)).result.is_ok());
        assert!(searcher.tree(usize::MAX).into_iter().flatten().all(|p| p.y >= 40.0));
    }
}

#[test]
fn a_black_box_is_asked_for_lines_of_sight_alone_and_its_paths_are_free_all_the_same() {
    let free = BitGrid::from_fn(60, 60, |cell| cell.x != 30 || cell.y > 40);
    let sight = PointLineOfSight::new(&free);
    let query = query(Cell::new(3, 3), Cell::new(55, 5));
    for planner in PLANNERS {
        let mut searcher = Searcher::new(&free).unwrap();
        searcher.black_box = true;
        let plain = searcher
            .search(planner, &sight, &query, budget(SAMPLES))
            .result
            .unwrap();
        assert!(is_free(&free, &plain), "{planner}");
        searcher.black_box = false;
        let shortened = searcher
            .search(planner, &sight, &query, budget(SAMPLES))
            .result
            .unwrap();
        assert!(shortened.length <= plain.length * 1.001, "{planner}");
    }
}

#[test]
fn the_trees_of_the_last_search_can_be_looked_at() {
    let free = room(150, 120, Some(77));
    let sight = PointLineOfSight::new(&free);
    let query = query(Cell::new(3, 3), Cell::new(140, 100));
    let mut searcher = Searcher::new(&free).unwrap();
    for planner in PLANNERS {
        searcher
            .search(planner, &sight, &query, budget(SAMPLES))
            .result
            .unwrap();
        let edges: Vec<_> = searcher.tree(100_000);
        assert!(
            edges.len() > 10 && edges.iter().all(|edge| sight.sees(edge[0], edge[1])),
            "{planner}"
        );
        assert!(edges.iter().flatten().any(|p| *p == query.start));
        assert_eq!(searcher.tree(7).len(), 7);
    }
}
