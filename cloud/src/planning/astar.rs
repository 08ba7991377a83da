//! What is the cheapest way over the lattice? A* with octile estimates, exactly optimal for whole-number costs.
//!
//! Open nodes lie in a ring of buckets by their estimated total cost: it never falls along a way, and one step raises it by a bounded
//! amount, so that a few dozen buckets hold all of them. Inside a bucket the last one in is the first one out, and a node whose cost is
//! improved is put in again; the search ends when nothing open can be better than the goal's cost.
//!
//! Sources: Hart, Nilsson and Raphael, "A Formal Basis for the Heuristic Determination of Minimum Cost Paths", 1968; Dial, "Algorithm
//! 360: Shortest-Path Forest with Topological Ordering", 1969.

use zenav_protocol::grid::Cell;

use super::budget::Budget;
use super::lattice::{DIAGONAL, GridPath, Lattice, STEPS, UNREACHED, octile};
use super::searcher::Searched;
use crate::space::DistanceCost;

/// Costs beyond the way's length.
pub trait CellCost {
    /// What it costs to be at a cell, in parts of [`PARTS`] of the step that leads there or away: 0 is the length alone.
    fn extra(&self, cell: Cell) -> u8;
}

/// Extra costs are counted in parts of this many of a step's own cost.
pub const PARTS: u32 = 32;

/// The way's length alone.
#[derive(Clone, Copy, Debug)]
pub struct Uniform;

impl CellCost for Uniform {
    fn extra(&self, _cell: Cell) -> u8 {
        0
    }
}

/// Nearness to obstacles.
impl CellCost for DistanceCost<'_> {
    fn extra(&self, cell: Cell) -> u8 {
        self.at(cell)
    }
}

/// Why a search ended without a way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotFound {
    /// The start or the goal is outside the map.
    OutOfMap,
    /// The start is not free.
    StartBlocked,
    /// The goal is not free.
    GoalBlocked,
    /// They are not connected.
    NoPath,
    /// The budget ran out.
    TimedOut,
}

/// Working memory, kept from one search to the next.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    /// Cost of the best way known to each node, and which nodes have one.
    pub(super) cost: Vec<u32>,
    pub(super) touched: Vec<u32>,
    ring: Vec<Vec<(u32, u32)>>,
}

impl Memory {
    /// Makes room for `nodes` nodes, none of them reached.
    pub(super) fn clear(&mut self, nodes: usize) {
        if self.cost.len() == nodes {
            for node in self.touched.drain(..) {
                self.cost[node as usize] = UNREACHED;
            }
        } else {
            self.touched.clear();
            self.cost.clear();
            self.cost.resize(nodes, UNREACHED);
        }
        for bucket in &mut self.ring {
            bucket.clear();
        }
    }

    /// Notes a better way to a node.
    pub(super) fn reach(&mut self, node: u32, cost: u32) {
        let known = &mut self.cost[node as usize];
        if *known == UNREACHED {
            self.touched.push(node);
        }
        *known = cost;
    }
}

/// Width of a bucket: an eleventh of a straight step.
const BUCKET_BITS: u32 = 9;
/// More than the largest rise of the estimate in one step, `DIAGONAL * (2 + 255 / PARTS)`, in buckets.
const RING: usize = 256;
const _: () = assert!((DIAGONAL as usize * (2 + 256 / PARTS as usize)) >> BUCKET_BITS < RING - 2);

/// The cheapest way from one cell to another. Deterministic.
pub fn search(
    lattice: &Lattice,
    costs: &impl CellCost,
    start: Cell,
    goal: Cell,
    memory: &mut Memory,
    budget: Budget<'_>,
) -> Searched<GridPath> {
    let mut expansions = 0;
    let result = expand(lattice, costs, start, goal, memory, budget, &mut expansions);
    Searched { result, expansions }
}

fn expand(
    lattice: &Lattice,
    costs: &impl CellCost,
    start: Cell,
    goal: Cell,
    memory: &mut Memory,
    budget: Budget<'_>,
    expansions: &mut u64,
) -> Result<GridPath, NotFound> {
    let (start_node, goal_node) = ends(lattice, start, goal)?;
    memory.clear(lattice.len());
    memory.ring.resize_with(RING, Vec::new);
    memory.reach(start_node, 0);
    let first = octile(start, goal);
    let mut current = first >> BUCKET_BITS;
    memory.ring[current as usize % RING].push((start_node, 0));
    let mut open = 1_usize;
    while open > 0 {
        let Some((node, cost)) = memory.ring[current as usize % RING].pop() else {
            if memory.cost[goal_node as usize] >> BUCKET_BITS <= current {
                break;
            }
            current += 1;
            continue;
        };
        open -= 1;
        if memory.cost[node as usize] != cost {
            // A better way to it came later.
            continue;
        }
        let cell = lattice.cell(node);
        if cost + octile(cell, goal) >= memory.cost[goal_node as usize] {
            continue;
        }
        if budget.is_spent(*expansions) {
            return Err(NotFound::TimedOut);
        }
        *expansions += 1;
        let here = u32::from(costs.extra(cell));
        let mut steps = lattice.steps(node);
        while steps != 0 {
            let step = STEPS[steps.trailing_zeros() as usize];
            steps &= steps - 1;
            let next = neighbour(lattice, node, step.x, step.y);
            let known = memory.cost[next as usize];
            if known <= cost.saturating_add(step.cost) {
                continue;
            }
            let to = Cell::new(cell.x.wrapping_add_signed(step.x), cell.y.wrapping_add_signed(step.y));
            let better = cost.saturating_add(weighted(step.cost, here, costs.extra(to)));
            let estimate = better.saturating_add(octile(to, goal));
            if better < known && estimate < UNREACHED {
                memory.reach(next, better);
                memory.ring[(estimate >> BUCKET_BITS) as usize % RING].push((next, better));
                open += 1;
            }
        }
    }
    if memory.cost[goal_node as usize] == UNREACHED {
        return Err(NotFound::NoPath);
    }
    Ok(GridPath::through(&trace(
        lattice,
        costs,
        start_node,
        goal_node,
        &memory.cost,
    )))
}

/// The nodes of free ends.
pub(super) fn ends(lattice: &Lattice, start: Cell, goal: Cell) -> Result<(u32, u32), NotFound> {
    let start = lattice.node(start).ok_or(NotFound::OutOfMap)?;
    let goal = lattice.node(goal).ok_or(NotFound::OutOfMap)?;
    if !lattice.is_free(start) {
        return Err(NotFound::StartBlocked);
    }
    if !lattice.is_free(goal) {
        return Err(NotFound::GoalBlocked);
    }
    Ok((start, goal))
}

fn neighbour(lattice: &Lattice, node: u32, x: i32, y: i32) -> u32 {
    node.wrapping_add_signed(y * lattice.pitch() as i32 + x)
}

/// Cost of a step with half the extra cost of each end: the same in both directions.
fn weighted(step: u32, here: u32, there: u8) -> u32 {
    step + step * (here + u32::from(there)) / (2 * PARTS)
}

/// The cells of the cheapest way, start first: from the goal back, always to the neighbour that makes up its cost.
fn trace(lattice: &Lattice, costs: &impl CellCost, start: u32, goal: u32, cost: &[u32]) -> Vec<Cell> {
    let mut cells = vec![lattice.cell(goal)];
    let mut node = goal;
    let mut last_step = usize::MAX;
    while node != start {
        let cell = lattice.cell(node);
        let here = u32::from(costs.extra(cell));
        let mut best = (UNREACHED, 0, false);
        let mut steps = lattice.steps(node);
        while steps != 0 {
            let i = steps.trailing_zeros() as usize;
            steps &= steps - 1;
            let before = neighbour(lattice, node, STEPS[i].x, STEPS[i].y);
            let known = cost[before as usize];
            if known == UNREACHED {
                continue;
            }
            let to = Cell::new(
                cell.x.wrapping_add_signed(STEPS[i].x),
                cell.y.wrapping_add_signed(STEPS[i].y),
            );
            let total = known.saturating_add(weighted(STEPS[i].cost, here, costs.extra(to)));
            // Among equals, straight on: fewer corners.
            if total < best.0 || (total == best.0 && i == last_step && !best.2) {
                best = (total, i, i == last_step);
            }
        }
        if best.0 > cost[node as usize] {
            // Cannot happen while costs are symmetric; rather a short way than an endless one.
            break;
        }
        last_step = best.1;
        node = neighbour(lattice, node, STEPS[best.1].x, STEPS[best.1].y);
        cells.push(lattice.cell(node));
    }
    cells.reverse();
    cells
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::space::BitGrid;
    use proptest::prelude::*;

    /// Dijkstra over all cells, in floating point, by repeated sweeps.
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
        fn the_way_is_as_short_as_dijkstra_s((free, start, goal) in random_map()) {
            let lattice = Lattice::new(&free).unwrap();
            let mut memory = Memory::default();
            // Twice with one memory: nothing of the first search is left for the second.
            for _ in 0..2 {
                let found = search(&lattice, &Uniform, start, goal, &mut memory, Budget::UNLIMITED).result;
                match reference(&free, &Uniform, start, goal) {
                    Some(length) => prop_assert!((found.unwrap().length() - length).abs() < 1e-9),
                    None => prop_assert_eq!(found, Err(NotFound::NoPath)),
                }
            }
        }

        #[test]
        fn the_way_is_as_cheap_as_dijkstra_s_with_extra_costs((free, start, goal) in random_map()) {
            let lattice = Lattice::new(&free).unwrap();
            let mut memory = Memory::default();
            let found = search(&lattice, &Bumpy, start, goal, &mut memory, Budget::UNLIMITED).result;
            match reference(&free, &Bumpy, start, goal) {
                Some(cost) => {
                    prop_assert!(found.is_ok());
                    let node = lattice.node(goal).unwrap();
                    let ours = f64::from(memory.cost[node as usize]) / 5741.0;
                    prop_assert!((ours - cost).abs() < 1e-2, "{} against {}", ours, cost);
                }
                None => prop_assert_eq!(found, Err(NotFound::NoPath)),
            }
        }

        #[test]
        fn every_step_of_the_way_is_allowed((free, start, goal) in random_map()) {
            let lattice = Lattice::new(&free).unwrap();
            if let Ok(path) = search(&lattice, &Uniform, start, goal, &mut Memory::default(), Budget::UNLIMITED).result {
                prop_assert_eq!((path.corners[0], path.corners[path.corners.len() - 1]), (start, goal));
                for pair in path.corners.windows(2) {
                    let (dx, dy) = (i64::from(pair[1].x) - i64::from(pair[0].x), i64::from(pair[1].y) - i64::from(pair[0].y));
                    prop_assert!(dx == 0 || dy == 0 || dx.abs() == dy.abs());
                    let step = STEPS.iter().position(|s| (i64::from(s.x), i64::from(s.y)) == (dx.signum(), dy.signum())).unwrap();
                    for i in 0..dx.abs().max(dy.abs()) {
                        let cell = Cell::new((i64::from(pair[0].x) + i * dx.signum()) as u32, (i64::from(pair[0].y) + i * dy.signum()) as u32);
                        prop_assert!(lattice.steps(lattice.node(cell).unwrap()) >> step & 1 == 1);
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
                &Lattice::new(free).unwrap(),
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
                    cancel: None
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
