//! Lazy Theta*. A short any-angle path from cell centre to cell centre, along lines of sight.
//!
//! Like A*, but a cell's parent may be any cell that sees it. Sight is assumed until the cell is expanded: one check per expansion. If
//! the parent does not see the cell, the best expanded neighbour becomes its parent; if that makes the path longer, the cell returns to
//! the open list. At the end string pulling makes the path taut.
//!
//! Sources: Nash, Koenig and Tovey, "Lazy Theta*: Any-Angle Path Planning and Path Length Analysis in 3D", AAAI 2010; Daniel, Nash,
//! Koenig and Felner, "Theta*: Any-Angle Path Planning on Grids", JAIR 2010.

use zenav_protocol::grid::Cell;

use zenav_space::LineOfSight;

use super::{Map, PathSearch};
use crate::budget::Budget;
use crate::grid_graph::{GridGraph, STEPS, STRAIGHT};
use crate::node_table::NodeTable;
use crate::open_list::{Open, OpenList, is_past};
use crate::path::Path;
use crate::searcher::{NotFound, Query, Searched};
use crate::string_pulling::pull_string;

/// Working memory, kept from one search to the next.
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory {
    reached: NodeTable<Reached>,
    open: OpenList,
}

/// Bound of all costs: about 374,000 cells. A longer path is [`NotFound::TooLong`].
const LONGEST: u32 = u32::MAX >> 1;

/// State of a cell; zero at first.
#[derive(Clone, Copy, Debug, Default)]
struct Reached {
    /// Length of the best path to it, bits inverted so that 0 means none; the lowest bit is set once the cell was expanded.
    mark: u32,
    /// Parent node; sight from it is assumed until it is checked.
    parent: u32,
}

impl Reached {
    fn new(cost: u32, parent: u32) -> Self {
        Self {
            mark: !(cost << 1) & !1,
            parent,
        }
    }

    fn cost(self) -> u32 {
        !self.mark >> 1
    }

    fn had_its_turn(self) -> bool {
        self.mark & 1 == 1
    }

    fn with_its_turn(self) -> Self {
        Self {
            mark: self.mark | 1,
            ..self
        }
    }
}

impl PathSearch for Memory {
    fn search<S: LineOfSight>(&mut self, map: &Map<'_, S>, query: &Query, budget: Budget<'_>) -> Searched {
        search(map.graph, map.sight, query, self, budget)
    }
}

/// A short path between two points; `sight` is the space of the graph's free cells. Deterministic.
fn search(
    graph: &GridGraph,
    sight: &impl LineOfSight,
    query: &Query,
    memory: &mut Memory,
    budget: Budget<'_>,
) -> Searched {
    let mut expansions = 0;
    let result = expand(graph, sight, query, memory, budget, &mut expansions);
    Searched { result, expansions }
}

fn expand(
    graph: &GridGraph,
    sight: &impl LineOfSight,
    query: &Query,
    memory: &mut Memory,
    budget: Budget<'_>,
    expansions: &mut u64,
) -> Result<Path, NotFound> {
    let (start, goal) = query.cells();
    let (start_node, goal_node) = graph.ends(start, goal)?;
    if !sight.sees(query.start, start.center()) {
        return Err(NotFound::StartBlocked);
    }
    if !sight.sees(goal.center(), query.goal) {
        return Err(NotFound::GoalBlocked);
    }
    if sight.sees(query.start, query.goal) {
        return Ok(Path::through(vec![query.start, query.goal]));
    }
    memory.reached.clear(graph.len());
    memory.open.clear(distance(start, goal));
    memory.reached.set(start_node, Reached::new(0, start_node));
    memory.open.push(Open {
        estimate: distance(start, goal),
        name: start_node,
    });
    let mut too_long = false;
    while let Some(Open { estimate, name: node }) = memory.open.pop() {
        let mut here = memory.reached.get(node);
        if here.had_its_turn() {
            continue;
        }
        if budget.is_spent(*expansions) {
            return Err(NotFound::TimedOut);
        }
        let cell = graph.cell(node);
        let mut parent = graph.cell(here.parent);
        if !sight.sees(parent.center(), cell.center()) {
            here = beside(graph, memory, node);
            memory.reached.set(node, here);
            let true_estimate = here.cost() + distance(cell, goal);
            if is_past(true_estimate, estimate) {
                memory.open.push(Open {
                    estimate: true_estimate,
                    name: node,
                });
                continue;
            }
            parent = graph.cell(here.parent);
        }
        memory.reached.set(node, here.with_its_turn());
        if node == goal_node {
            return Ok(path(graph, memory, sight, query, goal_node, budget));
        }
        *expansions += 1;
        let base = memory.reached.get(here.parent).cost();
        let mut steps = graph.steps(node);
        while steps != 0 {
            let step = STEPS[steps.trailing_zeros() as usize];
            steps &= steps - 1;
            let next = graph.beside(node, step);
            let known = memory.reached.get(next);
            if known.had_its_turn() {
                continue;
            }
            let to = step.after(cell);
            let cost = base + distance(parent, to);
            if cost >= LONGEST {
                too_long = true;
            } else if cost < known.cost() {
                memory.reached.set(next, Reached::new(cost, here.parent));
                memory.open.push(Open {
                    estimate: cost + distance(to, goal),
                    name: next,
                });
            }
        }
    }
    Err(if too_long { NotFound::TooLong } else { NotFound::NoPath })
}

/// The best path to a cell through one of its expanded neighbours, for a cell that its parent does not see.
fn beside(graph: &GridGraph, memory: &Memory, node: u32) -> Reached {
    let mut best = Reached::default();
    let mut steps = graph.steps(node);
    while steps != 0 {
        let step = STEPS[steps.trailing_zeros() as usize];
        steps &= steps - 1;
        let neighbour = graph.beside(node, step);
        let known = memory.reached.get(neighbour);
        if known.had_its_turn() && known.cost() + step.cost < best.cost() {
            best = Reached::new(known.cost() + step.cost, neighbour);
        }
    }
    best
}

/// The path to the goal, pulled taut as far as the budget goes.
fn path(
    graph: &GridGraph,
    memory: &Memory,
    sight: &impl LineOfSight,
    query: &Query,
    goal_node: u32,
    budget: Budget<'_>,
) -> Path {
    let mut corners = vec![query.goal];
    let mut node = goal_node;
    loop {
        corners.push(graph.cell(node).center());
        let parent = memory.reached.get(node).parent;
        if parent == node {
            break;
        }
        node = parent;
    }
    corners.push(query.start);
    corners.reverse();
    corners.dedup();
    pull_string(sight, &mut corners, 1.0, || budget.is_cancelled());
    Path::through(corners)
}

/// Euclidean distance, in units of the graph's costs.
fn distance(from: Cell, to: Cell) -> u32 {
    let (dx, dy) = (f64::from(from.x) - f64::from(to.x), f64::from(from.y) - f64::from(to.y));
    ((dx * dx + dy * dy).sqrt() * f64::from(STRAIGHT) + 0.5) as u32
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use std::sync::atomic::AtomicBool;

    use proptest::prelude::*;
    use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
    use zenav_protocol::robot::Footprint;

    use super::*;
    use crate::cell_cost::Uniform;
    use crate::planners::astar;
    use zenav_space::{BitGrid, ConfigurationSpace, PointLineOfSight, UnknownPolicy};

    const SIDE: u32 = 48;

    /// Blocked walls and dots; the ends may be blocked too.
    #[derive(Clone, Debug)]
    struct World {
        blocked: BitGrid,
        start: Cell,
        goal: Cell,
    }

    fn world() -> impl Strategy<Value = World> {
        let walls = prop::collection::vec((0..SIDE, 0..SIDE, 1_u32..20, 1_u32..4, any::<bool>()), 0..14);
        let dots = prop::collection::vec((0..SIDE, 0..SIDE), 0..120);
        let ends = ((0..SIDE, 0..SIDE), (0..SIDE, 0..SIDE));
        (walls, dots, ends).prop_map(|(walls, dots, (start, goal))| {
            let mut blocked = BitGrid::from_fn(SIDE, SIDE, |cell| {
                walls.iter().any(|(x, y, long, thick, upright)| {
                    let (dx, dy) = if *upright { (*thick, *long) } else { (*long, *thick) };
                    (*x..x + dx).contains(&cell.x) && (*y..y + dy).contains(&cell.y)
                })
            });
            dots.iter().for_each(|(x, y)| blocked.set(Cell::new(*x, *y), true));
            let [start, goal] = [start, goal].map(|(x, y)| Cell::new(x, y));
            World { blocked, start, goal }
        })
    }

    fn query(start: Cell, goal: Cell) -> Query {
        Query {
            start: start.center(),
            goal: goal.center(),
            seed: 1,
        }
    }

    /// A path is found exactly where A* finds one, is in sight throughout, and is never longer than the graph's shortest path.
    fn check(free: &BitGrid, sight: &impl LineOfSight, world: &World) -> Result<(), TestCaseError> {
        let graph = GridGraph::new(free).unwrap();
        let mut memory = Memory::default();
        let question = query(world.start, world.goal);
        let shortest = astar::search(
            &graph,
            &Uniform,
            world.start,
            world.goal,
            &mut astar::Memory::default(),
            Budget::UNLIMITED,
        )
        .result;
        // Twice with one memory: nothing of the first search is left for the second.
        let first = search(&graph, sight, &question, &mut memory, Budget::UNLIMITED);
        prop_assert_eq!(
            &first,
            &search(&graph, sight, &question, &mut memory, Budget::UNLIMITED)
        );
        match (first.result, shortest) {
            (Ok(path), Ok(shortest)) => {
                prop_assert_eq!(
                    (path.corners[0], path.corners[path.corners.len() - 1]),
                    (question.start, question.goal)
                );
                prop_assert!(path.corners.windows(2).all(|leg| sight.sees(leg[0], leg[1])));
                prop_assert!(
                    path.length <= shortest.length() + 1e-9,
                    "{} against {}",
                    path.length,
                    shortest.length()
                );
                prop_assert!(path.length >= (question.goal - question.start).norm() - 1e-9);
            }
            (Err(ours), Err(theirs)) => prop_assert_eq!(ours, theirs),
            (ours, theirs) => prop_assert!(false, "{:?} against {:?}", ours, theirs),
        }
        Ok(())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn a_point_s_path_is_in_sight_and_at_most_as_long_as_the_graph_s(world in world()) {
            let free = world.blocked.complement();
            check(&free, &PointLineOfSight::new(&free), &world)?;
        }

        #[test]
        fn a_disc_s_path_is_in_sight_and_at_most_as_long_as_the_graph_s(world in world(), radius in 0.0..0.25, policy in prop::sample::select(vec![UnknownPolicy::Free, UnknownPolicy::Blocked])) {
            let spec = GridSpec { origin: Point2::new(-1.0, 3.0), resolution: 0.1, width: SIDE, height: SIDE };
            let mut grid = Grid::filled(spec, Occupancy::FREE);
            for (number, cell) in (0..spec.len()).map(|index| spec.cell(index)).filter(|cell| world.blocked.get(*cell)).enumerate() {
                grid[cell] = if number % 7 == 0 { Occupancy::UNKNOWN } else { Occupancy::OCCUPIED };
            }
            let space = ConfigurationSpace::new(&grid, &Footprint::Radius(radius), policy, 0.0);
            check(space.free(), &space, &world)?;
        }

        #[test]
        fn a_path_goes_from_exactly_where_it_is_asked_to_where_it_is_asked(world in world(), within in (0.01..0.99, 0.01..0.99, 0.01..0.99, 0.01..0.99)) {
            let free = world.blocked.complement();
            let sight = PointLineOfSight::new(&free);
            let ask = Query {
                start: Point2::new(f64::from(world.start.x) + within.0, f64::from(world.start.y) + within.1),
                goal: Point2::new(f64::from(world.goal.x) + within.2, f64::from(world.goal.y) + within.3),
                seed: 1,
            };
            if let Ok(path) = search(&GridGraph::new(&free).unwrap(), &sight, &ask, &mut Memory::default(), Budget::UNLIMITED).result {
                prop_assert_eq!((path.corners[0], path.corners[path.corners.len() - 1]), (ask.start, ask.goal));
                prop_assert!(path.corners.windows(2).all(|leg| sight.sees(leg[0], leg[1])));
            }
        }
    }

    #[test]
    fn every_way_not_to_find_one_is_told() {
        let mut free = BitGrid::from_fn(9, 9, |_| true);
        (0..8).for_each(|y| free.set(Cell::new(4, y), false));
        let run = |free: &BitGrid, start, goal, budget: Budget<'_>| {
            search(
                &GridGraph::new(free).unwrap(),
                &PointLineOfSight::new(free),
                &query(start, goal),
                &mut Memory::default(),
                budget,
            )
        };
        let (a, b) = (Cell::new(1, 1), Cell::new(7, 1));
        let found = run(&free, a, b, Budget::UNLIMITED);
        assert!(found.expansions > 8 && found.result.is_ok());
        for (start, goal, expected) in [
            (Cell::new(9, 0), a, NotFound::OutOfMap),
            (Cell::new(4, 0), a, NotFound::StartBlocked),
            (a, Cell::new(4, 0), NotFound::GoalBlocked),
        ] {
            assert_eq!(run(&free, start, goal, Budget::UNLIMITED).result, Err(expected));
        }
        let few = Budget {
            max_expansions: found.expansions - 1,
            ..Budget::UNLIMITED
        };
        assert_eq!(run(&free, a, b, few).result, Err(NotFound::TimedOut));
        let cancelled = AtomicBool::new(true);
        let cancelled = Budget {
            cancel: Some(&cancelled),
            ..Budget::UNLIMITED
        };
        assert_eq!(run(&free, a, b, cancelled).result, Err(NotFound::TimedOut));
        free.set(Cell::new(4, 8), false);
        assert_eq!(run(&free, a, b, Budget::UNLIMITED).result, Err(NotFound::NoPath));
        assert_eq!(run(&free, a, a, Budget::UNLIMITED).result.unwrap().length, 0.0);
    }
}
