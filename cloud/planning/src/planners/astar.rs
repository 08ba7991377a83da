//! A*. The cheapest path over the grid graph: octile heuristic, exactly optimal for whole-number costs.
//!
//! A node whose cost improves is pushed again; the search ends when no open node can be better than the goal's cost.
//!
//! Source: Hart, Nilsson and Raphael, "A Formal Basis for the Heuristic Determination of Minimum Cost Paths", 1968.

use zenav_protocol::grid::Cell;

use zenav_space::LineOfSight;

use super::{Map, PathSearch};
use crate::budget::Budget;
use crate::cell_cost::{CellCost, Uniform, weighted};
use crate::grid_graph::{GridGraph, GridPath, STEPS, UNREACHED, octile};
use crate::node_table::{NodeTable, Written};
use crate::open_list::{Open, OpenList, is_past};
use crate::searcher::{NotFound, Query, Searched};

/// Working memory, kept from one search to the next.
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory {
    /// Cost of the best path known to each node, bits inverted: 0 means none.
    costs: NodeTable<u32>,
    open: OpenList,
}

impl Memory {
    /// Cost of the best path known to a node.
    fn cost(&self, node: u32) -> u32 {
        !self.costs.get(node)
    }

    /// Records a better path to a node.
    fn reach(&mut self, node: u32, cost: u32) {
        self.costs.set(node, !cost);
    }

    /// Nodes touched by the last search, rounded up to cache lines.
    pub(crate) fn reached(&self) -> Written {
        self.costs.written()
    }
}

impl PathSearch for Memory {
    fn search<S: LineOfSight>(&mut self, map: &Map<'_, S>, query: &Query, budget: Budget<'_>) -> Searched {
        let (start, goal) = query.cells();
        search(map.graph, &Uniform, start, goal, self, budget).into()
    }
}

/// The cheapest path from one cell to another. Deterministic.
pub(crate) fn search(
    graph: &GridGraph,
    costs: &impl CellCost,
    start: Cell,
    goal: Cell,
    memory: &mut Memory,
    budget: Budget<'_>,
) -> Searched<GridPath> {
    let mut expansions = 0;
    let result = expand(graph, costs, start, goal, memory, budget, &mut expansions);
    Searched { result, expansions }
}

fn expand(
    graph: &GridGraph,
    costs: &impl CellCost,
    start: Cell,
    goal: Cell,
    memory: &mut Memory,
    budget: Budget<'_>,
    expansions: &mut u64,
) -> Result<GridPath, NotFound> {
    let (start_node, goal_node) = graph.ends(start, goal)?;
    memory.costs.clear(graph.len());
    memory.open.clear(octile(start, goal));
    memory.reach(start_node, 0);
    memory.open.push(Open {
        estimate: octile(start, goal),
        name: name(start),
    });
    let mut too_long = false;
    while let Some(Open { estimate, name: open }) = memory.open.pop() {
        let best = memory.cost(goal_node);
        if is_past(estimate, best) {
            break;
        }
        let cell = named(open);
        let cost = estimate - octile(cell, goal);
        let node = graph.padded(Cell::new(cell.x + 1, cell.y + 1));
        // Otherwise the entry is stale: a better path to the node or to the goal was found later.
        if memory.cost(node) != cost || estimate >= best {
            continue;
        }
        if budget.is_spent(*expansions) {
            return Err(NotFound::TimedOut);
        }
        *expansions += 1;
        let here = u32::from(costs.extra(cell));
        let mut steps = graph.steps(node);
        while steps != 0 {
            let step = STEPS[steps.trailing_zeros() as usize];
            steps &= steps - 1;
            let next = graph.beside(node, step);
            let known = memory.cost(next);
            if known <= cost.saturating_add(step.cost) {
                continue;
            }
            let to = step.after(cell);
            let better = cost.saturating_add(weighted(step.cost, here, costs.extra(to)));
            let estimate = better.saturating_add(octile(to, goal));
            if better < known && estimate < UNREACHED {
                memory.reach(next, better);
                memory.open.push(Open {
                    estimate,
                    name: name(to),
                });
            } else if estimate == UNREACHED {
                too_long = true;
            }
        }
    }
    if memory.cost(goal_node) == UNREACHED {
        return Err(if too_long { NotFound::TooLong } else { NotFound::NoPath });
    }
    let cells = trace(graph, costs, start_node, goal_node, memory);
    Ok(GridPath::through(&cells))
}

/// Identifier of an open node: its cell; a graph has at most 2^15 cells a side.
const fn name(cell: Cell) -> u32 {
    cell.y << 16 | cell.x
}

const fn named(name: u32) -> Cell {
    Cell::new(name & 0xFFFF, name >> 16)
}

/// The cells of the cheapest path, start first: traced back from the goal, always to the neighbour that accounts for the cost.
fn trace(graph: &GridGraph, costs: &impl CellCost, start: u32, goal: u32, memory: &Memory) -> Vec<Cell> {
    let mut cells = vec![graph.cell(goal)];
    let mut node = goal;
    let mut last_step = usize::MAX;
    while node != start {
        let cell = graph.cell(node);
        let here = u32::from(costs.extra(cell));
        let mut best = (UNREACHED, 0, false);
        let mut steps = graph.steps(node);
        while steps != 0 {
            let i = steps.trailing_zeros() as usize;
            steps &= steps - 1;
            let known = memory.cost(graph.beside(node, STEPS[i]));
            if known == UNREACHED {
                continue;
            }
            let extra = costs.extra(STEPS[i].after(cell));
            let total = known.saturating_add(weighted(STEPS[i].cost, here, extra));
            // Ties go straight on: fewer corners.
            if total < best.0 || (total == best.0 && i == last_step && !best.2) {
                best = (total, i, i == last_step);
            }
        }
        if best.0 > memory.cost(node) {
            // Cannot happen while costs are symmetric; a truncated path is better than an endless loop.
            break;
        }
        last_step = best.1;
        node = graph.beside(node, STEPS[best.1]);
        cells.push(graph.cell(node));
    }
    cells.reverse();
    cells
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell_cost::PARTS;
    use proptest::prelude::*;
    use zenav_space::BitGrid;

    /// Reference costs over all cells, in floating point, by repeated sweeps.
    fn reference(free: &BitGrid, extra: &impl CellCost, start: Cell, goal: Cell) -> Option<f64> {
        let (w, h) = (free.width(), free.height());
        let mut cost = vec![f64::INFINITY; (w * h) as usize];
        let at = |x: i64, y: i64| {
            if x < 0 || y < 0 {
                false
            } else {
                free.get(Cell::new(x as u32, y as u32))
            }
        };
        cost[(start.y * w + start.x) as usize] = 0.0;
        let mut changed = at(start.x.into(), start.y.into());
        while changed {
            changed = false;
            for y in 0..i64::from(h) {
                for x in 0..i64::from(w) {
                    let here = cost[(y * i64::from(w) + x) as usize];
                    if here.is_infinite() {
                        continue;
                    }
                    for step in STEPS {
                        let (dx, dy) = (i64::from(step.x), i64::from(step.y));
                        if !at(x + dx, y + dy) || !at(x + dx, y) || !at(x, y + dy) {
                            continue;
                        }
                        let length = if dx != 0 && dy != 0 { 2.0_f64.sqrt() } else { 1.0 };
                        let both = extra.extra(Cell::new(x as u32, y as u32)) as f64
                            + extra.extra(Cell::new((x + dx) as u32, (y + dy) as u32)) as f64;
                        let total = here + length * (1.0 + both / (2.0 * f64::from(PARTS)));
                        let next = &mut cost[((y + dy) * i64::from(w) + x + dx) as usize];
                        if total < *next - 1e-9 {
                            *next = total;
                            changed = true;
                        }
                    }
                }
            }
        }
        let found = cost[(goal.y * w + goal.x) as usize];
        found.is_finite().then_some(found)
    }

    struct Bumpy;

    impl CellCost for Bumpy {
        fn extra(&self, cell: Cell) -> u8 {
            (cell.x.wrapping_mul(37) ^ cell.y.wrapping_mul(101)) as u8
        }
    }

    fn random_map() -> impl Strategy<Value = (BitGrid, Cell, Cell)> {
        (
            2_u32..24,
            2_u32..24,
            prop::collection::vec(0_u8..4, 24 * 24),
            any::<(u32, u32, u32, u32)>(),
        )
            .prop_map(|(w, h, cells, ends)| {
                let mut free = BitGrid::from_fn(w, h, |cell| cells[(cell.y * 24 + cell.x) as usize] != 0);
                let (start, goal) = (Cell::new(ends.0 % w, ends.1 % h), Cell::new(ends.2 % w, ends.3 % h));
                free.set(start, true);
                free.set(goal, true);
                (free, start, goal)
            })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        #[test]
        fn the_path_is_as_short_as_dijkstra_s((free, start, goal) in random_map()) {
            let graph = GridGraph::new(&free).unwrap();
            let mut memory = Memory::default();
            // Twice with one memory: nothing of the first search is left for the second.
            for _ in 0..2 {
                let found = search(&graph, &Uniform, start, goal, &mut memory, Budget::UNLIMITED).result;
                match reference(&free, &Uniform, start, goal) {
                    Some(length) => prop_assert!((found.unwrap().length() - length).abs() < 1e-9),
                    None => prop_assert_eq!(found, Err(NotFound::NoPath)),
                }
            }
        }

        #[test]
        fn the_path_is_as_cheap_as_dijkstra_s_with_extra_costs((free, start, goal) in random_map()) {
            let graph = GridGraph::new(&free).unwrap();
            let mut memory = Memory::default();
            let found = search(&graph, &Bumpy, start, goal, &mut memory, Budget::UNLIMITED).result;
            match reference(&free, &Bumpy, start, goal) {
                Some(cost) => {
                    prop_assert!(found.is_ok());
                    let node = graph.node(goal).unwrap();
                    let ours = f64::from(memory.cost(node)) / 5741.0;
                    prop_assert!((ours - cost).abs() < 1e-2, "{} against {}", ours, cost);
                }
                None => prop_assert_eq!(found, Err(NotFound::NoPath)),
            }
        }

        #[test]
        fn every_step_of_the_path_is_allowed((free, start, goal) in random_map()) {
            let graph = GridGraph::new(&free).unwrap();
            if let Ok(path) = search(&graph, &Uniform, start, goal, &mut Memory::default(), Budget::UNLIMITED).result {
                prop_assert_eq!((path.corners[0], path.corners[path.corners.len() - 1]), (start, goal));
                for pair in path.corners.windows(2) {
                    let (dx, dy) = (i64::from(pair[1].x) - i64::from(pair[0].x), i64::from(pair[1].y) - i64::from(pair[0].y));
                    prop_assert!(dx == 0 || dy == 0 || dx.abs() == dy.abs());
                    let step = STEPS.iter().position(|s| (i64::from(s.x), i64::from(s.y)) == (dx.signum(), dy.signum())).unwrap();
                    for i in 0..dx.abs().max(dy.abs()) {
                        let cell = Cell::new((i64::from(pair[0].x) + i * dx.signum()) as u32, (i64::from(pair[0].y) + i * dy.signum()) as u32);
                        prop_assert!(graph.steps(graph.node(cell).unwrap()) >> step & 1 == 1);
                    }
                }
            }
        }
    }

    #[test]
    fn every_way_not_to_find_one_is_told() {
        let mut free = BitGrid::from_fn(3, 1, |_| true);
        let (a, b, c) = (Cell::new(0, 0), Cell::new(1, 0), Cell::new(2, 0));
        let run = |free: &BitGrid, start, goal, budget| {
            search(
                &GridGraph::new(free).unwrap(),
                &Uniform,
                start,
                goal,
                &mut Memory::default(),
                budget,
            )
            .result
        };
        assert_eq!(
            run(&free, a, Cell::new(3, 0), Budget::UNLIMITED),
            Err(NotFound::OutOfMap)
        );
        assert_eq!(
            run(
                &free,
                a,
                c,
                Budget {
                    max_expansions: 1,
                    ..Budget::UNLIMITED
                }
            ),
            Err(NotFound::TimedOut)
        );
        assert_eq!(run(&free, b, b, Budget::UNLIMITED).unwrap().corners, [b]);
        free.set(b, false);
        assert_eq!(run(&free, a, c, Budget::UNLIMITED), Err(NotFound::NoPath));
        assert_eq!(run(&free, b, c, Budget::UNLIMITED), Err(NotFound::StartBlocked));
        assert_eq!(run(&free, a, b, Budget::UNLIMITED), Err(NotFound::GoalBlocked));
        assert_eq!(
            run(&BitGrid::new(0, 0), a, a, Budget::UNLIMITED),
            Err(NotFound::OutOfMap)
        );
    }
}
