//! What is the shortest way, where every cell costs the same? Jump point search on blocks of bits, exactly optimal.
//!
//! Of all equally short ways only those that go diagonally first are looked at: then a straight run needs a stop only where an obstacle
//! beside it ends (a jump point). Runs are scanned 64 cells at a time, along rows and, on a transposed copy, along columns. Jump points
//! in the middle of a diagonal run are not kept either: what is found straight ahead of them is reached from the run's beginning.
//! Corners are not cut, so a diagonal run has no jump points of its own.
//!
//! Sources: Harabor and Grastien, "Online Graph Pruning for Pathfinding on Grid Maps", AAAI 2011; the same, "Improving Jump Point
//! Search", ICAPS 2014 (block scanning, pruning).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use zenav_protocol::grid::Cell;

use super::astar::{Memory, NotFound, ends};
use super::budget::Budget;
use super::lattice::{GridPath, Lattice, UNREACHED, octile};
use super::searcher::Searched;

/// Free cells along columns, and memory for searches.
#[derive(Clone, Debug)]
pub struct JumpGrid {
    columns: Vec<u64>,
    /// Words a column.
    stride: usize,
    /// Node that each node was reached from.
    parents: Vec<u32>,
    /// Directions in which each node was reached at its cost.
    entered: Vec<u8>,
    open: BinaryHeap<Reverse<Open>>,
}

/// Estimate first; of equals the one nearer to the goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Open {
    estimate: u32,
    to_go: u32,
    node: u32,
    direction: Direction,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Direction {
    East,
    West,
    North,
    South,
    /// The start: everywhere.
    All,
}

impl Direction {
    const fn bit(self) -> u8 {
        1 << self as u8
    }

    /// Columns and rows of a step.
    const fn step(self) -> (i32, i32) {
        match self {
            Self::East => (1, 0),
            Self::West => (-1, 0),
            Self::North => (0, 1),
            Self::South => (0, -1),
            Self::All => (0, 0),
        }
    }

    const fn of(x: i32, y: i32) -> Self {
        match (x, y) {
            (1, _) => Self::East,
            (-1, _) => Self::West,
            (_, 1) => Self::North,
            _ => Self::South,
        }
    }
}

impl JumpGrid {
    /// Prepares a lattice: linear in its words.
    #[must_use]
    pub fn new(lattice: &Lattice) -> Self {
        let rows = lattice.len() / lattice.pitch() as usize;
        let stride = rows.div_ceil(64);
        let pitch_words = lattice.pitch() as usize / 64;
        let mut columns = vec![0; stride * pitch_words * 64 + 1];
        for band in 0..stride {
            for word in 0..pitch_words {
                let mut block = [0_u64; 64];
                for (row, bits) in block.iter_mut().enumerate().take(rows - band * 64) {
                    *bits = lattice.words()[(band * 64 + row) * pitch_words + word];
                }
                if block.iter().any(|bits| *bits != 0) {
                    transpose(&mut block);
                    for (column, bits) in block.into_iter().enumerate() {
                        columns[(word * 64 + column) * stride + band] = bits;
                    }
                }
            }
        }
        Self {
            columns,
            stride,
            parents: Vec::new(),
            entered: Vec::new(),
            open: BinaryHeap::new(),
        }
    }
}

/// Swaps rows and columns of a block of bits (Warren, "Hacker's Delight", 7-3).
fn transpose(block: &mut [u64; 64]) {
    let mut mask = 0x0000_0000_FFFF_FFFF_u64;
    let mut width = 32;
    while width != 0 {
        let mut row = 0;
        while row < 64 {
            let swapped = ((block[row] >> width) ^ block[row + width]) & mask;
            block[row] ^= swapped << width;
            block[row + width] ^= swapped;
            row = (row + width + 1) & !width;
        }
        width >>= 1;
        mask ^= mask << width;
    }
}

/// The shortest way from one cell to another. Deterministic.
pub fn search(
    lattice: &Lattice,
    grid: &mut JumpGrid,
    start: Cell,
    goal: Cell,
    memory: &mut Memory,
    budget: Budget<'_>,
) -> Searched<GridPath> {
    let (start_node, goal_node) = match ends(lattice, start, goal) {
        Ok(nodes) => nodes,
        Err(reason) => {
            return Searched {
                result: Err(reason),
                expansions: 0,
            };
        }
    };
    // What an earlier search left in these two is overwritten when a node is first reached.
    memory.clear(lattice.len());
    grid.parents.resize(lattice.len(), 0);
    grid.entered.resize(lattice.len(), 0);
    let mut open = std::mem::take(&mut grid.open);
    open.clear();
    let mut entered = std::mem::take(&mut grid.entered);
    let mut parents = std::mem::take(&mut grid.parents);
    let mut run = Run {
        lattice,
        grid,
        goal,
        goal_node,
        memory,
        open: &mut open,
        entered: &mut entered,
        parents: &mut parents,
        node: start_node,
        cost: 0,
    };
    let mut expansions = 0;
    run.memory.reach(start_node, 0);
    run.open.push(Reverse(Open {
        estimate: octile(start, goal),
        to_go: octile(start, goal),
        node: start_node,
        direction: Direction::All,
    }));
    let result = run.until_found(budget, &mut expansions).map(|()| run.trace(start_node));
    (grid.open, grid.entered, grid.parents) = (open, entered, parents);
    Searched { result, expansions }
}

/// One search.
struct Run<'a> {
    lattice: &'a Lattice,
    grid: &'a JumpGrid,
    goal: Cell,
    goal_node: u32,
    memory: &'a mut Memory,
    open: &'a mut BinaryHeap<Reverse<Open>>,
    entered: &'a mut [u8],
    parents: &'a mut [u32],
    /// What is being expanded, and its cost.
    node: u32,
    cost: u32,
}

impl Run<'_> {
    fn until_found(&mut self, budget: Budget<'_>, expansions: &mut u64) -> Result<(), NotFound> {
        while let Some(Reverse(Open {
            estimate,
            to_go,
            node,
            direction,
        })) = self.open.pop()
        {
            if node == self.goal_node {
                return Ok(());
            }
            // A better way to it came later.
            if self.memory.cost[node as usize] != estimate - to_go {
                continue;
            }
            if budget.is_spent(*expansions) {
                return Err(NotFound::TimedOut);
            }
            *expansions += 1;
            (self.node, self.cost) = (node, estimate - to_go);
            self.expand(node, direction);
        }
        Err(NotFound::NoPath)
    }

    fn expand(&mut self, node: u32, direction: Direction) {
        let (dx, dy) = direction.step();
        if direction == Direction::All {
            for straight in [Direction::East, Direction::West, Direction::North, Direction::South] {
                self.straight(node, straight);
            }
            for (x, y) in [(1, 1), (1, -1), (-1, 1), (-1, -1)] {
                self.diagonal(node, x, y);
            }
            return;
        }
        self.straight(node, direction);
        // Beside: where an obstacle ends just here.
        for side in [1, -1] {
            let (sx, sy) = (dy * side, dx * side);
            if self.is_free(node, sx, sy) && !self.is_free(node, sx - dx, sy - dy) {
                self.straight(node, Direction::of(sx, sy));
                self.diagonal(node, dx + sx, dy + sy);
            }
        }
    }

    fn is_free(&self, node: u32, dx: i32, dy: i32) -> bool {
        self.lattice.is_free(self.beside(node, dx, dy))
    }

    fn beside(&self, node: u32, dx: i32, dy: i32) -> u32 {
        node.wrapping_add_signed(dy * self.lattice.pitch() as i32 + dx)
    }

    /// Reaches the next jump point in a straight direction.
    fn straight(&mut self, from: u32, direction: Direction) {
        let pitch = self.lattice.pitch();
        let (x, y) = (from % pitch, from / pitch);
        let (gx, gy) = (self.goal_node % pitch, self.goal_node / pitch);
        let (rows, columns) = (self.lattice.words(), &self.grid.columns[..]);
        let (along, run, found) = match direction {
            Direction::East => (gy == y && gx > x, forward(rows, pitch as usize / 64, y, x), 0),
            Direction::West => (gy == y && gx < x, backward(rows, pitch as usize / 64, y, x), 0),
            Direction::North => (gx == x && gy > y, forward(columns, self.grid.stride, x, y), 1),
            Direction::South => (gx == x && gy < y, backward(columns, self.grid.stride, x, y), 1),
            Direction::All => return,
        };
        let (end, is_jump) = run;
        let (target, end_is_beyond) = if found == 0 {
            (gx, x.abs_diff(end) >= x.abs_diff(gx))
        } else {
            (gy, y.abs_diff(end) >= y.abs_diff(gy))
        };
        let stop = if along && end_is_beyond {
            target
        } else if is_jump {
            end
        } else {
            return;
        };
        let node = if found == 0 { y * pitch + stop } else { stop * pitch + x };
        self.reach(node, direction);
    }

    /// Goes on diagonally as long as it goes, and reaches what lies straight ahead of each cell passed.
    fn diagonal(&mut self, from: u32, dx: i32, dy: i32) {
        let mut node = from;
        while self.is_free(node, dx, dy) && self.is_free(node, dx, 0) && self.is_free(node, 0, dy) {
            node = self.beside(node, dx, dy);
            if node == self.goal_node {
                self.reach(node, Direction::of(dx, 0));
                return;
            }
            self.straight(node, Direction::of(dx, 0));
            self.straight(node, Direction::of(0, dy));
        }
    }

    /// Notes a way from what is being expanded to a node: diagonally first, then straight.
    fn reach(&mut self, node: u32, direction: Direction) {
        let (here, there) = (self.lattice.cell(self.node), self.lattice.cell(node));
        let cost = self.cost.saturating_add(octile(here, there));
        let known = self.memory.cost[node as usize];
        if cost > known || (cost == known && self.entered[node as usize] & direction.bit() != 0) {
            return;
        }
        let to_go = octile(there, self.goal);
        let estimate = cost.saturating_add(to_go);
        if estimate == UNREACHED {
            return;
        }
        if cost < known {
            self.entered[node as usize] = 0;
            self.parents[node as usize] = self.node;
            self.memory.reach(node, cost);
        }
        self.entered[node as usize] |= direction.bit();
        self.open.push(Reverse(Open {
            estimate,
            to_go,
            node,
            direction,
        }));
    }

    /// The way, start first.
    fn trace(&self, start: u32) -> GridPath {
        let mut cells = vec![self.goal];
        let mut node = self.goal_node;
        while node != start {
            let parent = self.parents[node as usize];
            let (from, to) = (self.lattice.cell(parent), self.lattice.cell(node));
            let diagonal = from.x.abs_diff(to.x).min(from.y.abs_diff(to.y));
            let toward = |a: u32, b: u32| if b > a { a + diagonal } else { a - diagonal };
            let corner = Cell::new(toward(from.x, to.x), toward(from.y, to.y));
            if diagonal > 0 && corner != to {
                cells.push(corner);
            }
            cells.push(from);
            node = parent;
        }
        cells.reverse();
        GridPath::through(&cells)
    }
}

/// Where a run towards higher positions ends: at a jump point (`true`), or at the first blocked position.
fn forward(words: &[u64], stride: usize, line: u32, from: u32) -> (u32, bool) {
    let start = line as usize * stride;
    let mut word = from as usize / 64;
    let mut mask = (u64::MAX << (from % 64)) << 1;
    let before = |row: usize, word: usize| if word == 0 { 0 } else { words[row + word - 1] >> 63 };
    loop {
        let blocked = !words[start + word];
        let ends = |row: usize| {
            let bits = words[row + word];
            bits & !(bits << 1 | before(row, word))
        };
        let found = (blocked | ends(start - stride) | ends(start + stride)) & mask;
        if found != 0 {
            let bit = found.trailing_zeros();
            return (word as u32 * 64 + bit, blocked >> bit & 1 == 0);
        }
        word += 1;
        if word == stride {
            // Never: the border is blocked.
            return (from, false);
        }
        mask = u64::MAX;
    }
}

/// As [`forward`], towards lower positions.
fn backward(words: &[u64], stride: usize, line: u32, from: u32) -> (u32, bool) {
    let start = line as usize * stride;
    let mut word = from as usize / 64;
    let mut mask = !(u64::MAX << (from % 64));
    let after = |row: usize, word: usize| {
        if word + 1 == stride {
            0
        } else {
            words[row + word + 1] << 63
        }
    };
    loop {
        let blocked = !words[start + word];
        let ends = |row: usize| {
            let bits = words[row + word];
            bits & !(bits >> 1 | after(row, word))
        };
        let found = (blocked | ends(start - stride) | ends(start + stride)) & mask;
        if found != 0 {
            let bit = 63 - found.leading_zeros();
            return (word as u32 * 64 + bit, blocked >> bit & 1 == 0);
        }
        if word == 0 {
            return (from, false);
        }
        word -= 1;
        mask = u64::MAX;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::super::astar::{self, Uniform};
    use super::*;
    use crate::space::BitGrid;
    use proptest::prelude::*;

    #[test]
    fn a_block_is_transposed() {
        let mut block = [0_u64; 64];
        for (row, bits) in block.iter_mut().enumerate() {
            *bits = (row as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        }
        let original = block;
        transpose(&mut block);
        for (row, bits) in block.iter().enumerate() {
            for (column, before) in original.iter().enumerate() {
                assert_eq!(bits >> column & 1, before >> row & 1);
            }
        }
    }

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
            let mut grid = JumpGrid::new(&lattice);
            let (mut ours, mut theirs) = (Memory::default(), Memory::default());
            for (a, b, c, d) in queries {
                let (start, goal) = (Cell::new(a % w, b % h), Cell::new(c % w, d % h));
                let found = search(&lattice, &mut grid, start, goal, &mut ours, Budget::UNLIMITED).result;
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
