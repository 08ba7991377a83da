//! What is the shortest way, where every cell costs the same? Jump point search on blocks of bits, exactly optimal.
//!
//! Of all equally short ways only those that go diagonally first are looked at: then a straight run needs a stop only where an obstacle
//! beside it ends (a jump point). Jump points in the middle of a diagonal run are not kept either: what is found straight ahead of them
//! is reached from the run's beginning. Corners are not cut, so a diagonal run has no jump points of its own.
//!
//! Sources: Harabor and Grastien, "Online Graph Pruning for Pathfinding on Grid Maps", AAAI 2011; the same, "Improving Jump Point
//! Search", ICAPS 2014 (block scanning, pruning).

use zenav_protocol::grid::Cell;

use super::astar::{NotFound, ends};
use super::budget::Budget;
use super::jump_grid::{Diagonal, Direction, JumpGrid};
use super::lattice::{DIAGONAL, GridPath, Lattice, STRAIGHT, UNREACHED, octile};
use super::open::{Open, OpenList, is_past};
use super::records::Records;
use super::searcher::Searched;

/// Working memory, kept from one search to the next.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    states: Records<u64>,
    open: OpenList,
    /// The cells expanded, in order.
    expanded: Vec<Cell>,
}

/// What is known of a jump point, in one word, so that 0 stands for nothing: its cost turned over, where in [`Memory::expanded`] the
/// cell lies from which it was reached, and the directions of runs that reached it at this cost.
#[derive(Clone, Copy)]
struct State(u64);

const DIRECTION_BITS: u32 = 4;
const MAX_EXPANDED: usize = 1 << (u32::BITS - DIRECTION_BITS);

impl State {
    const fn new(cost: u32, parent: u32) -> Self {
        Self((!cost as u64) << 32 | (parent << DIRECTION_BITS) as u64)
    }

    const fn cost(self) -> u32 {
        !((self.0 >> 32) as u32)
    }

    const fn parent(self) -> usize {
        (self.0 as u32 >> DIRECTION_BITS) as usize
    }

    const fn has(self, direction: Direction) -> bool {
        self.0 >> direction as u32 & 1 == 1
    }

    const fn with(self, direction: Direction) -> Self {
        Self(self.0 | 1 << direction as u32)
    }
}

/// Name of an open node: its cell and the direction that it was reached in.
const fn name(x: u32, y: u32, direction: Direction) -> u32 {
    y << 17 | x << 2 | direction as u32
}

/// The shortest way from one cell to another. Deterministic.
pub fn search(
    lattice: &Lattice,
    grid: &JumpGrid,
    start: Cell,
    goal: Cell,
    memory: &mut Memory,
    budget: Budget<'_>,
) -> Searched<GridPath> {
    let goal_node = match ends(lattice, start, goal) {
        Ok((_, goal)) => goal,
        Err(reason) => {
            return Searched {
                result: Err(reason),
                expansions: 0,
            };
        }
    };
    memory.states.clear(lattice.len());
    memory.open.clear(octile(start, goal));
    memory.expanded.clear();
    let mut run = Run {
        lattice,
        grid,
        goal,
        goal_node,
        memory,
        budget,
        cost: 0,
        here: start,
        best: UNREACHED,
        column: [Direction::South, Direction::North].map(|direction| obstacle(lattice, grid, direction, goal)),
        row: [Direction::West, Direction::East].map(|direction| obstacle(lattice, grid, direction, goal)),
    };
    let mut expansions = 0;
    let result = run.until_found(start, &mut expansions).map(|()| run.trace(start));
    Searched { result, expansions }
}

/// The first obstacle in a direction: its column or row, by the lattice.
fn obstacle(lattice: &Lattice, grid: &JumpGrid, direction: Direction, from: Cell) -> u32 {
    let (mut x, mut y) = (from.x + 1, from.y + 1);
    loop {
        let stop = grid.stop(direction, x, y);
        match direction {
            Direction::East | Direction::West => x = stop,
            Direction::North | Direction::South => y = stop,
        }
        if !lattice.is_free(y * lattice.pitch() + x) {
            return stop;
        }
    }
}

/// One search.
struct Run<'a> {
    lattice: &'a Lattice,
    grid: &'a JumpGrid,
    goal: Cell,
    goal_node: u32,
    memory: &'a mut Memory,
    budget: Budget<'a>,
    /// What is being expanded, and its cost.
    here: Cell,
    cost: u32,
    /// Least cost known to the goal.
    best: u32,
    row: [u32; 2],
    column: [u32; 2],
}

impl Run<'_> {
    fn until_found(&mut self, start: Cell, expansions: &mut u64) -> Result<(), NotFound> {
        if start == self.goal {
            return Ok(());
        }
        let start_node = self.node(start.x, start.y);
        self.memory.states.set(start_node, State::new(0, 0).0);
        if self.budget.is_spent(0) {
            return Err(NotFound::TimedOut);
        }
        *expansions += 1;
        self.memory.expanded.push(start);
        for direction in Direction::ALL {
            self.straight(direction, start.x, start.y, 0);
        }
        for diagonal in Diagonal::ALL {
            self.diagonal(diagonal);
        }
        while let Some(Open { estimate, name }) = self.memory.open.pop() {
            if is_past(estimate, self.best) {
                break;
            }
            let cell = Cell::new(name >> 2 & 0x7FFF, name >> 17);
            let cost = estimate - octile(cell, self.goal);
            let state = State(self.memory.states.get(self.node(cell.x, cell.y)));
            // A better way to it came later.
            if state.cost() != cost || estimate >= self.best {
                continue;
            }
            if self.budget.is_spent(*expansions) || self.memory.expanded.len() == MAX_EXPANDED {
                return Err(NotFound::TimedOut);
            }
            *expansions += 1;
            (self.here, self.cost) = (cell, cost);
            self.memory.expanded.push(cell);
            self.expand(Direction::ALL[name as usize & 3]);
        }
        if self.best == UNREACHED {
            return Err(NotFound::NoPath);
        }
        Ok(())
    }

    fn node(&self, x: u32, y: u32) -> u32 {
        (y + 1) * self.lattice.pitch() + x + 1
    }

    fn expand(&mut self, direction: Direction) {
        let (dx, dy) = direction.step();
        let Cell { x, y } = self.here;
        let node = self.node(x, y);
        self.straight(direction, x, y, self.cost);
        // Beside: where an obstacle ends just here.
        for side in [1, -1] {
            let (sx, sy) = (dy * side, dx * side);
            if self.is_free(node, sx, sy) && !self.is_free(node, sx - dx, sy - dy) {
                let beside = match (sx, sy) {
                    (1, _) => Direction::East,
                    (-1, _) => Direction::West,
                    (_, 1) => Direction::North,
                    _ => Direction::South,
                };
                self.straight(beside, x, y, self.cost);
                let diagonal = match (dx + sx, dy + sy) {
                    (1, 1) => Diagonal::NorthEast,
                    (-1, 1) => Diagonal::NorthWest,
                    (1, -1) => Diagonal::SouthEast,
                    _ => Diagonal::SouthWest,
                };
                self.diagonal(diagonal);
            }
        }
    }

    fn is_free(&self, node: u32, dx: i32, dy: i32) -> bool {
        self.lattice
            .is_free(node.wrapping_add_signed(dy * self.lattice.pitch() as i32 + dx))
    }

    /// Reaches the next jump point in a straight direction.
    #[inline]
    fn straight(&mut self, direction: Direction, x: u32, y: u32, cost: u32) {
        // The lattice's border counts here.
        let (x, y) = (x + 1, y + 1);
        let (gx, gy) = (self.goal.x + 1, self.goal.y + 1);
        let stop = self.grid.stop(direction, x, y);
        let (along, at, distance) = match direction {
            Direction::East => (gy == y && gx > x && gx <= stop, (stop, y), stop - x),
            Direction::West => (gy == y && gx < x && gx >= stop, (stop, y), x - stop),
            Direction::North => (gx == x && gy > y && gy <= stop, (x, stop), stop - y),
            Direction::South => (gx == x && gy < y && gy >= stop, (x, stop), y - stop),
        };
        if along {
            self.found(cost + (gx.abs_diff(x) + gy.abs_diff(y)) * STRAIGHT);
            return;
        }
        let node = at.1 * self.lattice.pitch() + at.0;
        if self.lattice.is_free(node) {
            self.reach(
                node,
                Cell::new(at.0 - 1, at.1 - 1),
                direction,
                cost.saturating_add(distance * STRAIGHT),
            );
        }
    }

    /// Goes on diagonally as long as it goes, and reaches what lies straight ahead of each cell passed.
    fn diagonal(&mut self, direction: Diagonal) {
        let [horizontal, vertical] = direction.sides();
        let (dx, dy) = (horizontal.step().0, vertical.step().1);
        let (mut x, mut y, mut cost) = (self.here.x + 1, self.here.y + 1, self.cost);
        let pitch = self.lattice.pitch();
        let can_go = |x: u32, y: u32| {
            let node = y * pitch + x;
            let beside = node.wrapping_add_signed(dx);
            let above = node.wrapping_add_signed(dy * pitch as i32);
            self.lattice.is_free(beside)
                && self.lattice.is_free(above)
                && self.lattice.is_free(above.wrapping_add_signed(dx))
        };
        if !can_go(x, y) {
            return;
        }
        loop {
            let stop = self.grid.turn(direction, x, y);
            let steps = stop.abs_diff(y);
            y = stop;
            x = x.wrapping_add_signed(dx * steps as i32);
            cost += DIAGONAL * steps;
            self.ahead(horizontal, x, y, cost);
            self.ahead(vertical, x, y, cost);
            let node = y * pitch + x;
            let beside = node.wrapping_add_signed(dx);
            let above = node.wrapping_add_signed(dy * pitch as i32);
            if !(self.lattice.is_free(beside)
                && self.lattice.is_free(above)
                && self.lattice.is_free(above.wrapping_add_signed(dx)))
            {
                break;
            }
        }
        // The goal may lie straight ahead of a cell on the way.
        let steps = y.abs_diff(self.here.y + 1) as i64;
        let (from, to) = (self.here, self.goal);
        let along = [
            (i64::from(to.x) - i64::from(from.x)) * i64::from(dx),
            (i64::from(to.y) - i64::from(from.y)) * i64::from(dy),
        ];
        let short = along[0].min(along[1]);
        if short < 1 || short > steps {
            return;
        }
        let turn = (
            from.x.wrapping_add_signed(dx * short as i32),
            from.y.wrapping_add_signed(dy * short as i32),
        );
        if (turn.1 == to.y && self.row[0] < turn.0 + 1 && turn.0 + 1 < self.row[1])
            || (turn.0 == to.x && self.column[0] < turn.1 + 1 && turn.1 + 1 < self.column[1])
        {
            self.found(self.cost.saturating_add(octile(from, to)));
        }
    }

    /// Reaches the jump point that lies straight ahead.
    #[inline]
    fn ahead(&mut self, direction: Direction, x: u32, y: u32, cost: u32) {
        let stop = self.grid.stop(direction, x, y);
        let (at, distance) = match direction {
            Direction::East | Direction::West => ((stop, y), stop.abs_diff(x)),
            Direction::North | Direction::South => ((x, stop), stop.abs_diff(y)),
        };
        let node = at.1 * self.lattice.pitch() + at.0;
        if self.lattice.is_free(node) {
            self.reach(
                node,
                Cell::new(at.0 - 1, at.1 - 1),
                direction,
                cost.saturating_add(distance * STRAIGHT),
            );
        }
    }

    /// Notes a way to the goal.
    fn found(&mut self, cost: u32) {
        if cost < self.best {
            self.best = cost;
            let parent = self.memory.expanded.len() as u32 - 1;
            self.memory.states.set(self.goal_node, State::new(cost, parent).0);
        }
    }

    /// Notes a way from what is being expanded to a node: diagonally first, then straight.
    #[inline]
    fn reach(&mut self, node: u32, at: Cell, direction: Direction, cost: u32) {
        let mut state = State(self.memory.states.get(node));
        let known = state.cost();
        if cost > known || (cost == known && state.has(direction)) {
            return;
        }
        let estimate = cost.saturating_add(octile(at, self.goal));
        if estimate >= self.best {
            return;
        }
        if cost < known {
            state = State::new(cost, self.memory.expanded.len() as u32 - 1);
        }
        self.memory.states.set(node, state.with(direction).0);
        self.memory.open.push(Open {
            estimate,
            name: name(at.x, at.y, direction),
        });
    }

    /// The way, start first.
    fn trace(&self, start: Cell) -> GridPath {
        let mut cells = vec![self.goal];
        let mut to = self.goal;
        while to != start {
            let state = State(self.memory.states.get(self.node(to.x, to.y)));
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
        GridPath::through(&cells)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::super::astar::{self, Uniform};
    use super::*;
    use crate::space::BitGrid;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn the_way_is_as_short_as_that_of_astar_and_every_step_is_allowed(
            size in (2_u32..150, 2_u32..90), walls in prop::collection::vec((0_u32..150, 0_u32..90, 1_u32..40, 1_u32..20), 0..25),
            dots in prop::collection::vec((0_u32..150, 0_u32..90), 0..200), queries in prop::collection::vec(any::<(u32, u32, u32, u32)>(), 1..6),
        ) {
            let (w, h) = size;
            let mut free = BitGrid::from_fn(w, h, |cell| !walls.iter().any(|(x, y, dx, dy)| cell.x >= *x && cell.x < x + dx && cell.y >= *y && cell.y < y + dy));
            dots.iter().for_each(|(x, y)| free.set(Cell::new(*x, *y), false));
            let lattice = Lattice::new(&free).unwrap();
            let grid = JumpGrid::new(&lattice);
            let (mut ours, mut theirs) = (Memory::default(), astar::Memory::default());
            for (a, b, c, d) in queries {
                let (start, goal) = (Cell::new(a % w, b % h), Cell::new(c % w, d % h));
                let found = search(&lattice, &grid, start, goal, &mut ours, Budget::UNLIMITED).result;
                let expected = astar::search(&lattice, &Uniform, start, goal, &mut theirs, Budget::UNLIMITED).result;
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
