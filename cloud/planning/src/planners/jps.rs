//! Jump point search. The shortest path where every cell costs the same, on blocks of bits, exactly optimal.
//!
//! Of all equally short paths only those that go diagonally first are considered: then a straight run has to stop only where an obstacle
//! beside it ends (a jump point). Intermediate points of a diagonal run are pruned: the jump points straight ahead of them become
//! successors of the run's beginning. Corners are not cut, so a diagonal run has no jump points of its own. Runs go from stop to stop on
//! the bitmaps of [`JumpGrid`]; the goal is not a stop there, but is detected by any run that crosses its row or column.
//!
//! Sources: Harabor and Grastien, "Online Graph Pruning for Pathfinding on Grid Maps", AAAI 2011; the same, "Improving Jump Point
//! Search", ICAPS 2014 (block scanning, pruning).

use zenav_protocol::grid::Cell;

use zenav_space::LineOfSight;

use super::{Map, PathSearch};
use crate::budget::Budget;
use crate::grid_graph::{DIAGONAL, GridGraph, GridPath, STEPS, STRAIGHT, UNREACHED, octile};
use crate::jump_grid::JumpGrid;
use crate::node_table::NodeTable;
use crate::open_list::{Open, OpenList, is_past};
use crate::searcher::{NotFound, Query, Searched};

/// Jump point search; its bitmaps are prepared by the first search on a map.
#[derive(Clone, Debug, Default)]
pub(crate) struct Jps {
    memory: Memory,
    /// The graph's revision, and the bitmaps prepared from it.
    prepared: Option<(u64, JumpGrid)>,
}

impl PathSearch for Jps {
    fn search<S: LineOfSight>(&mut self, map: &Map<'_, S>, query: &Query, budget: Budget<'_>) -> Searched {
        let revision = map.graph.revision();
        self.prepared = self.prepared.take().filter(|(prepared, _)| *prepared == revision);
        let (_, jumps) = self
            .prepared
            .get_or_insert_with(|| (revision, JumpGrid::new(map.graph)));
        let (start, goal) = query.cells();
        search(map.graph, jumps, start, goal, &mut self.memory, budget).into()
    }
}

/// Working memory, kept from one search to the next. All cells in it are in padded coordinates.
#[derive(Clone, Debug, Default)]
struct Memory {
    states: NodeTable<u64>,
    open: OpenList,
    /// The cells expanded, in order.
    expanded: Vec<Cell>,
    /// Jump points reached from the cell being expanded.
    seen: Vec<Seen>,
}

/// A jump point at the end of a run.
#[derive(Clone, Copy, Debug)]
struct Seen {
    cell: Cell,
    node: u32,
    cost: u32,
    direction: usize,
}

/// Number of jump points collected before they are looked up.
const BATCH: usize = 64;

/// State of a jump point in one word, 0 if unknown: its cost with bits inverted, the index in [`Memory::expanded`] of the cell from which
/// it was reached, and the directions of the runs that reached it at this cost.
#[derive(Clone, Copy)]
struct State(u64);

const DIRECTION_BITS: u32 = 4;
const MAX_EXPANDED: usize = 1 << (u32::BITS - DIRECTION_BITS);

impl State {
    const fn new(cost: u32, parent: usize) -> Self {
        Self((!cost as u64) << 32 | (parent as u64) << DIRECTION_BITS)
    }

    const fn cost(self) -> u32 {
        !((self.0 >> 32) as u32)
    }

    const fn parent(self) -> usize {
        (self.0 as u32 >> DIRECTION_BITS) as usize
    }

    const fn has(self, direction: usize) -> bool {
        self.0 >> direction & 1 == 1
    }

    const fn with(self, direction: usize) -> Self {
        Self(self.0 | 1 << direction)
    }
}

/// Identifier of an open node: its cell (a graph has at most 2^15 cells a side) and the direction in which it was reached.
const fn name(cell: Cell, direction: usize) -> u32 {
    (cell.y - 1) << 17 | (cell.x - 1) << 2 | direction as u32
}

const fn named(name: u32) -> (Cell, usize) {
    (
        Cell::new((name >> 2 & 0x7FFF) + 1, (name >> 17) + 1),
        (name & 3) as usize,
    )
}

/// Successor steps of a jump point, by the direction in which it was reached and the steps that are possible: straight on, and sideways
/// and diagonally ahead where an obstacle ends beside it.
const SUCCESSORS: [[u8; 256]; 4] = {
    let mut table = [[0; 256]; 4];
    let mut direction = 0;
    while direction < 4 {
        let (dx, dy) = (STEPS[direction].x, STEPS[direction].y);
        let mut can = 0;
        while can < 256 {
            let mut on = 1 << direction;
            let mut side = -1;
            while side <= 1 {
                let (sx, sy) = (dy * side, dx * side);
                // The cell before is free, so only an obstacle beside it can forbid the step back to that side.
                if can >> step_of(sx - dx, sy - dy) & 1 == 0 {
                    on |= 1 << step_of(sx, sy) | 1 << step_of(sx + dx, sy + dy);
                }
                side += 2;
            }
            table[direction][can] = (on & can) as u8;
            can += 1;
        }
        direction += 1;
    }
    table
};

const fn step_of(x: i32, y: i32) -> usize {
    let mut i = 0;
    while STEPS[i].x != x || STEPS[i].y != y {
        i += 1;
    }
    i
}

/// The shortest path from one cell to another. Deterministic.
fn search(
    graph: &GridGraph,
    grid: &JumpGrid,
    start: Cell,
    goal: Cell,
    memory: &mut Memory,
    budget: Budget<'_>,
) -> Searched<GridPath> {
    if let Err(reason) = graph.ends(start, goal) {
        return Searched::failed(reason);
    }
    memory.states.clear(graph.len());
    memory.open.clear(octile(start, goal));
    memory.expanded.clear();
    memory.seen.clear();
    let [start, goal] = [start, goal].map(|cell| Cell::new(cell.x + 1, cell.y + 1));
    let mut run = Run {
        graph,
        grid,
        goal,
        sides: [0, 1, 2, 3].map(|direction| obstacle(graph, grid, direction, goal)),
        memory,
        budget,
        here: start,
        cost: 0,
        best: UNREACHED,
        too_long: false,
    };
    let result = run.until_found(start).map(|()| run.trace(start));
    Searched {
        result,
        expansions: memory.expanded.len() as u64,
    }
}

/// The column (east, west) or row (north, south) of the first obstacle in a direction.
fn obstacle(graph: &GridGraph, grid: &JumpGrid, direction: usize, from: Cell) -> u32 {
    let ray = grid.ray(direction);
    let mut at = from;
    loop {
        at = ray.after(at, ray.length(at));
        if !graph.is_free(graph.padded(at)) {
            return if direction < 2 { at.x } else { at.y };
        }
    }
}

/// A search in progress.
struct Run<'a> {
    graph: &'a GridGraph,
    grid: &'a JumpGrid,
    goal: Cell,
    /// The first obstacles to the east, west, north and south of the goal.
    sides: [u32; 4],
    memory: &'a mut Memory,
    budget: Budget<'a>,
    /// The cell being expanded, and its cost.
    here: Cell,
    cost: u32,
    /// Least known cost to the goal.
    best: u32,
    /// Whether a path was dropped because its cost overflowed.
    too_long: bool,
}

impl Run<'_> {
    fn until_found(&mut self, start: Cell) -> Result<(), NotFound> {
        let node = self.graph.padded(start);
        self.memory.states.set(node, State::new(0, 0).0);
        self.expand(start, 0, self.graph.steps(node))?;
        while let Some(Open { estimate, name }) = self.memory.open.pop() {
            if is_past(estimate, self.best) {
                break;
            }
            let (cell, direction) = named(name);
            let cost = estimate - octile(cell, self.goal);
            let node = self.graph.padded(cell);
            // Otherwise the entry is stale: a better path to the node or to the goal was found later.
            if State(self.memory.states.get(node)).cost() == cost && estimate < self.best {
                let can = self.graph.steps(node) as usize;
                self.expand(cell, cost, u32::from(SUCCESSORS[direction][can & 0xFF]))?;
            }
        }
        if self.best == UNREACHED && self.too_long {
            Err(NotFound::TooLong)
        } else if self.best == UNREACHED {
            Err(NotFound::NoPath)
        } else {
            Ok(())
        }
    }

    /// Expands a cell by the given steps.
    fn expand(&mut self, here: Cell, cost: u32, mut steps: u32) -> Result<(), NotFound> {
        let expansions = self.memory.expanded.len();
        if self.budget.is_spent(expansions as u64) || expansions == MAX_EXPANDED {
            return Err(NotFound::TimedOut);
        }
        (self.here, self.cost) = (here, cost);
        self.memory.expanded.push(here);
        if self.sees_goal(here) {
            self.found();
            return Ok(());
        }
        while steps != 0 {
            let step = steps.trailing_zeros() as usize;
            steps &= steps - 1;
            if step < 4 {
                self.straight(step, here, cost);
            } else {
                self.diagonal(step)?;
            }
        }
        self.settle();
        Ok(())
    }

    /// Collects the jump point straight ahead of a cell, if any.
    #[inline]
    fn straight(&mut self, direction: usize, from: Cell, cost: u32) {
        let ray = self.grid.ray(direction);
        let length = ray.length(from);
        let cell = ray.after(from, length);
        let node = self.graph.padded(cell);
        if self.graph.is_free(node) {
            let cost = cost.saturating_add(length * STRAIGHT);
            self.memory.seen.push(Seen {
                cell,
                node,
                cost,
                direction,
            });
        }
    }

    /// Follows a diagonal to its end, and collects the jump points straight ahead of each stop on it.
    fn diagonal(&mut self, direction: usize) -> Result<(), NotFound> {
        let grid = self.grid;
        let ray = grid.ray(direction);
        let [horizontal, vertical] = [usize::from(ray.step.x < 0), 2 + usize::from(ray.step.y < 0)];
        let mut at = self.here;
        let mut cost = self.cost;
        loop {
            let length = ray.length(at);
            at = ray.after(at, length);
            cost = cost.saturating_add(length * DIAGONAL);
            self.straight(horizontal, at, cost);
            self.straight(vertical, at, cost);
            if self.memory.seen.len() >= BATCH {
                self.settle();
                if self.budget.is_cancelled() {
                    return Err(NotFound::TimedOut);
                }
            }
            if !self.graph.can_step(self.graph.padded(at), ray.step) {
                break;
            }
        }
        // The goal may lie straight ahead where the run crosses the goal's row or column, whichever comes first.
        let ahead = |from: u32, to: u32, step: i32| {
            if (to > from) == (step > 0) {
                to.abs_diff(from)
            } else {
                0
            }
        };
        let crossing = ahead(self.here.x, self.goal.x, ray.step.x).min(ahead(self.here.y, self.goal.y, ray.step.y));
        if crossing > 0 && crossing <= at.y.abs_diff(self.here.y) && self.sees_goal(ray.after(self.here, crossing)) {
            self.found();
        }
        Ok(())
    }

    /// Whether the goal is in sight along the cell's row or column.
    fn sees_goal(&self, cell: Cell) -> bool {
        let [east, west, north, south] = self.sides;
        (cell.y == self.goal.y && west < cell.x && cell.x < east)
            || (cell.x == self.goal.x && south < cell.y && cell.y < north)
    }

    /// Records a path from the cell being expanded to the goal: diagonal first, then straight.
    fn found(&mut self) {
        let cost = self.cost.saturating_add(octile(self.here, self.goal));
        if cost < self.best {
            self.best = cost;
            let state = State::new(cost, self.memory.expanded.len() - 1);
            self.memory.states.set(self.graph.padded(self.goal), state.0);
        } else if cost == UNREACHED {
            self.too_long = true;
        }
    }

    /// Records the paths from the cell being expanded to the jump points collected: diagonal first, then straight.
    fn settle(&mut self) {
        let Memory {
            states,
            open,
            expanded,
            seen,
        } = &mut *self.memory;
        // Two passes: the first one, which waits for memory, has no branches.
        let mut better = 0;
        for i in 0..seen.len() {
            let Seen {
                node, cost, direction, ..
            } = seen[i];
            let known = State(states.get(node));
            seen[better] = seen[i];
            better += usize::from((cost < known.cost()) | ((cost == known.cost()) & !known.has(direction)));
        }
        for Seen {
            cell,
            node,
            cost,
            direction,
        } in seen.drain(..).take(better)
        {
            let estimate = cost.saturating_add(octile(cell, self.goal));
            if estimate < self.best {
                let known = State(states.get(node));
                let state = if cost < known.cost() {
                    State::new(cost, expanded.len() - 1)
                } else {
                    known
                };
                states.set(node, state.with(direction).0);
                open.push(Open {
                    estimate,
                    name: name(cell, direction),
                });
            } else if estimate == UNREACHED {
                self.too_long = true;
            }
        }
    }

    /// The path, start first.
    fn trace(&self, start: Cell) -> GridPath {
        let mut cells = vec![self.goal];
        let mut to = self.goal;
        while to != start {
            let state = State(self.memory.states.get(self.graph.padded(to)));
            let from = self.memory.expanded[state.parent()];
            let diagonal = from.x.abs_diff(to.x).min(from.y.abs_diff(to.y));
            let toward = |a: u32, b: u32| if b > a { a + diagonal } else { a - diagonal };
            let corner = Cell::new(toward(from.x, to.x), toward(from.y, to.y));
            if diagonal > 0 && corner != to {
                cells.push(corner);
            }
            cells.push(from);
            to = from;
        }
        cells.reverse();
        for cell in &mut cells {
            *cell = Cell::new(cell.x - 1, cell.y - 1);
        }
        GridPath::through(&cells)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell_cost::Uniform;
    use crate::planners::astar;
    use proptest::prelude::*;
    use zenav_space::BitGrid;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn the_path_is_as_short_as_that_of_astar_and_every_step_is_allowed(
            size in (2_u32..150, 2_u32..90), walls in prop::collection::vec((0_u32..150, 0_u32..90, 1_u32..40, 1_u32..20), 0..25),
            dots in prop::collection::vec((0_u32..150, 0_u32..90), 0..200), queries in prop::collection::vec(any::<(u32, u32, u32, u32)>(), 1..6),
        ) {
            let (w, h) = size;
            let mut free = BitGrid::from_fn(w, h, |cell| !walls.iter().any(|(x, y, dx, dy)| cell.x >= *x && cell.x < x + dx && cell.y >= *y && cell.y < y + dy));
            dots.iter().for_each(|(x, y)| free.set(Cell::new(*x, *y), false));
            let graph = GridGraph::new(&free).unwrap();
            let grid = JumpGrid::new(&graph);
            let (mut ours, mut theirs) = (Memory::default(), astar::Memory::default());
            for (a, b, c, d) in queries {
                let (start, goal) = (Cell::new(a % w, b % h), Cell::new(c % w, d % h));
                let found = search(&graph, &grid, start, goal, &mut ours, Budget::UNLIMITED).result;
                let expected = astar::search(&graph, &Uniform, start, goal, &mut theirs, Budget::UNLIMITED).result;
                match (&found, &expected) {
                    (Ok(found), Ok(expected)) => {
                        prop_assert!((found.length() - expected.length()).abs() < 1e-9, "{} against {}", found.length(), expected.length());
                        prop_assert_eq!((found.corners[0], found.corners[found.corners.len() - 1]), (start, goal));
                        for pair in found.corners.windows(2) {
                            let (dx, dy) = (i64::from(pair[1].x) - i64::from(pair[0].x), i64::from(pair[1].y) - i64::from(pair[0].y));
                            prop_assert!(dx == 0 || dy == 0 || dx.abs() == dy.abs());
                            for i in 0..dx.abs().max(dy.abs()) {
                                let (x, y) = (i64::from(pair[0].x) + i * dx.signum(), i64::from(pair[0].y) + i * dy.signum());
                                let free = |x: i64, y: i64| free.get(Cell::new(x as u32, y as u32));
                                prop_assert!(free(x + dx.signum(), y + dy.signum()) && free(x + dx.signum(), y) && free(x, y + dy.signum()));
                            }
                        }
                    }
                    _ => prop_assert_eq!(found.is_ok(), expected.is_ok()),
                }
            }
        }
    }
}
