//! Grid graph, 8-connected. The steps that can be made from a cell, and their costs.
//!
//! A diagonal step needs both cells beside it to be free (no corner cutting). A blocked border pads the bitmap, so that no search checks
//! the bounds of the map. Costs are integers, [`STRAIGHT`] and [`DIAGONAL`] a step: 8119/5741 is a convergent of the square root of two,
//! and two paths whose counts of diagonal steps differ by less than 5741 compare as their exact lengths do.

use nalgebra::Point2;
use zenav_protocol::grid::{Cell, MAX_SIDE};

use zenav_space::BitGrid;

use super::lines::Lines;
use super::searcher::NotFound;

/// Cost of a step along an axis.
pub const STRAIGHT: u32 = 5741;
/// Cost of a diagonal step.
pub const DIAGONAL: u32 = 8119;
/// Cost of a node that was not reached; longer paths (about 748,000 cells) are not found.
pub const UNREACHED: u32 = u32::MAX;

/// A padded bitmap of free cells. A node is the position of a cell's bit.
#[derive(Clone, Debug)]
pub struct GridGraph {
    words: Vec<u64>,
    width: u32,
    height: u32,
    /// Bits of a row, the padding included.
    pitch: u32,
    /// Grows with every change.
    revision: u64,
}

/// The bitmap is too large for a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0} x {1} cells: a search takes at most {MAX_SIDE} a side and {MAX_NODES} in all")]
pub struct TooManyCells(u32, u32);

/// Largest number of nodes, border included.
const MAX_NODES: u64 = u32::MAX as u64 - 64;

impl GridGraph {
    /// The graph of a bitmap of free cells. Linear in its words.
    ///
    /// # Errors
    /// [`TooManyCells`].
    pub fn new(free: &BitGrid) -> Result<Self, TooManyCells> {
        let (width, height) = (free.width(), free.height());
        // A blocked column on each side, and one extra word at the end because three bits are read at once.
        let stride = (width as usize + 2).div_ceil(64);
        let rows = height as usize + 2;
        if width.max(height) > MAX_SIDE || (stride * 64 * rows) as u64 > MAX_NODES {
            return Err(TooManyCells(width, height));
        }
        let mut graph = Self {
            words: vec![0; stride * rows + 1],
            width,
            height,
            pitch: (stride * 64) as u32,
            revision: 0,
        };
        for y in 0..height {
            for word in 0..free.stride() {
                graph.update(free, y, word);
            }
        }
        Ok(graph)
    }

    /// Copies one changed word of a row.
    pub(super) fn update(&mut self, free: &BitGrid, y: u32, word: usize) {
        self.revision += 1;
        let stride = self.pitch as usize / 64;
        let source = free.row(y);
        let row = &mut self.words[(y as usize + 1) * stride..][..stride];
        // The border shifts all cells by one bit.
        for at in [word, word + 1] {
            let bits = |at: usize| source.get(at).copied().unwrap_or(0);
            if let Some(to) = row.get_mut(at) {
                *to = bits(at) << 1 | at.checked_sub(1).map_or(0, bits) >> 63;
            }
        }
    }

    /// Revision of the bitmap: anything prepared from an earlier revision is stale.
    pub(super) fn revision(&self) -> u64 {
        self.revision
    }

    /// Number of nodes, the border included.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pitch as usize * (self.height as usize + 2)
    }

    /// The node of a cell; `None` outside the map.
    #[must_use]
    pub fn node(&self, cell: Cell) -> Option<u32> {
        (cell.x < self.width && cell.y < self.height).then(|| (cell.y + 1) * self.pitch + cell.x + 1)
    }

    /// The nodes of start and goal; an error if one is outside the map or blocked.
    pub(crate) fn ends(&self, start: Cell, goal: Cell) -> Result<(u32, u32), NotFound> {
        let start = self.node(start).ok_or(NotFound::OutOfMap)?;
        let goal = self.node(goal).ok_or(NotFound::OutOfMap)?;
        if !self.is_free(start) {
            return Err(NotFound::StartBlocked);
        }
        if !self.is_free(goal) {
            return Err(NotFound::GoalBlocked);
        }
        Ok((start, goal))
    }

    /// The cell of a node inside the map.
    #[must_use]
    pub fn cell(&self, node: u32) -> Cell {
        Cell::new((node % self.pitch).wrapping_sub(1), (node / self.pitch).wrapping_sub(1))
    }

    /// Node number of the cell above minus that of the cell itself.
    #[must_use]
    pub fn pitch(&self) -> u32 {
        self.pitch
    }

    /// The padded bitmap and one extra word.
    #[must_use]
    pub(super) fn words(&self) -> &[u64] {
        &self.words
    }

    /// The rows of the padded bitmap.
    #[must_use]
    pub(super) fn rows(&self) -> Lines {
        let stride = self.pitch as usize / 64;
        Lines {
            words: self.words[..stride * (self.height as usize + 2)].to_vec(),
            stride,
        }
    }

    /// The node of a cell in padded coordinates, counted from the border.
    #[inline]
    pub(super) fn padded(&self, cell: Cell) -> u32 {
        cell.y * self.pitch + cell.x
    }

    /// Whether a diagonal step can be made from a node inside the map.
    #[inline]
    pub(super) fn can_step(&self, node: u32, step: Step) -> bool {
        let beside = node.wrapping_add_signed(step.x);
        let rows = step.y * self.pitch.cast_signed();
        self.is_free(beside)
            && self.is_free(node.wrapping_add_signed(rows))
            && self.is_free(beside.wrapping_add_signed(rows))
    }

    /// The node of the cell that holds a point, in cells; `None` outside the map.
    #[must_use]
    pub fn node_at(&self, p: Point2<f64>) -> Option<u32> {
        // Casts saturate; NaN fails both comparisons.
        (p.x >= 0.0 && p.y >= 0.0)
            .then(|| Cell::new(p.x as u32, p.y as u32))
            .and_then(|cell| self.node(cell))
    }

    /// First and last node of the horizontal run of free cells that contains a free node.
    #[must_use]
    pub(super) fn run(&self, node: u32) -> [u32; 2] {
        // Every row begins and ends with a blocked column.
        let (home, bit) = ((node >> 6) as usize, node & 63);
        let mut word = home;
        let mut blocked = !self.words[word] & (u64::MAX >> (63 - bit));
        while blocked == 0 {
            word -= 1;
            blocked = !self.words[word];
        }
        let first = ((word as u32) << 6) + 64 - blocked.leading_zeros();
        word = home;
        blocked = !self.words[word] & (u64::MAX << bit);
        while blocked == 0 {
            word += 1;
            blocked = !self.words[word];
        }
        [first, ((word as u32) << 6) + blocked.trailing_zeros() - 1]
    }

    /// Of the 64 nodes of a word inside the map: the free nodes whose neighbours in the given horizontal and vertical directions are free
    /// while the diagonal cell between them is blocked, that is, the nodes at an obstacle's convex corner.
    #[must_use]
    pub(super) fn corners(&self, word: u32, right: bool, up: bool) -> u64 {
        let stride = (self.pitch >> 6) as usize;
        let here = word as usize;
        let there = if up { here + stride } else { here - stride };
        // Each node's right or left neighbour, moved to the node's own bit.
        let beside = |word: usize| {
            if right {
                self.words[word] >> 1 | self.words[word + 1] << 63
            } else {
                self.words[word] << 1 | self.words[word.saturating_sub(1)] >> 63
            }
        };
        self.words[here] & beside(here) & self.words[there] & !beside(there)
    }

    /// Whether a node is free.
    #[must_use]
    pub fn is_free(&self, node: u32) -> bool {
        self.words[(node >> 6) as usize] >> (node & 63) & 1 == 1
    }

    /// Steps that can be made from a node inside the map, as bits in the order of [`STEPS`].
    #[must_use]
    pub fn steps(&self, node: u32) -> u32 {
        let below = self.three(node - self.pitch);
        let here = self.three(node);
        let above = self.three(node + self.pitch);
        let (west, east) = (here & 1, here >> 2);
        let (south, north) = (below >> 1 & 1, above >> 1 & 1);
        let diagonals = (below >> 2 & south & east) << 4
            | (below & south & west & 1) << 5
            | (above >> 2 & north & east) << 6
            | (above & north & west & 1) << 7;
        east | west << 1 | north << 2 | south << 3 | diagonals
    }

    /// The node reached by a step.
    #[must_use]
    pub fn beside(&self, node: u32, step: Step) -> u32 {
        node.wrapping_add_signed(step.y * self.pitch as i32 + step.x)
    }

    /// The bits of a node's left neighbour, itself, and its right neighbour.
    fn three(&self, node: u32) -> u32 {
        let first = node - 1;
        let (word, bit) = ((first >> 6) as usize, first & 63);
        let bits = self.words[word] >> bit | self.words[word + 1] << 1 << (63 - bit);
        bits as u32 & 7
    }
}

/// A step: columns, rows, cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Columns to the right.
    pub x: i32,
    /// Rows upwards.
    pub y: i32,
    /// Cost: [`STRAIGHT`] or [`DIAGONAL`].
    pub cost: u32,
}

impl Step {
    /// The cell reached by it.
    #[inline]
    #[must_use]
    pub const fn after(self, cell: Cell) -> Cell {
        Cell::new(cell.x.wrapping_add_signed(self.x), cell.y.wrapping_add_signed(self.y))
    }
}

const fn step(x: i32, y: i32) -> Step {
    Step {
        x,
        y,
        cost: if x != 0 && y != 0 { DIAGONAL } else { STRAIGHT },
    }
}

/// The eight steps: east, west, north, south, south-east, south-west, north-east, north-west.
pub const STEPS: [Step; 8] = [
    step(1, 0),
    step(-1, 0),
    step(0, 1),
    step(0, -1),
    step(1, -1),
    step(-1, -1),
    step(1, 1),
    step(-1, 1),
];

/// Octile distance: the cost between two cells on an empty map, a lower bound of the true cost.
#[must_use]
pub fn octile(from: Cell, to: Cell) -> u32 {
    let (dx, dy) = (from.x.abs_diff(to.x), from.y.abs_diff(to.y));
    let (long, short) = if dx > dy { (dx, dy) } else { (dy, dx) };
    // Sides are at most 32,768, so this is far from overflow.
    short * DIAGONAL + (long - short) * STRAIGHT
}

/// A path over neighbouring cells.
#[derive(Clone, Debug, PartialEq)]
pub struct GridPath {
    /// Start, cells where the direction changes, end.
    pub corners: Vec<Cell>,
    /// Steps along an axis.
    pub straight: u64,
    /// Number of diagonal steps.
    pub diagonal: u64,
}

impl GridPath {
    /// A path through cells that are straight or exactly diagonal to one another.
    #[must_use]
    pub fn through(cells: &[Cell]) -> Self {
        let mut path = Self {
            corners: Vec::new(),
            straight: 0,
            diagonal: 0,
        };
        for (i, cell) in cells.iter().enumerate() {
            if let Some(before) = i.checked_sub(1).map(|j| cells[j]) {
                let (dx, dy) = (before.x.abs_diff(cell.x), before.y.abs_diff(cell.y));
                path.diagonal += u64::from(dx.min(dy));
                path.straight += u64::from(dx.abs_diff(dy));
            }
            let direction = |a: Cell, b: Cell| (b.x.cmp(&a.x), b.y.cmp(&a.y));
            if let [.., a, b] = path.corners[..]
                && direction(a, b) == direction(b, *cell)
            {
                path.corners.pop();
            }
            path.corners.push(*cell);
        }
        path
    }

    /// Length in cells: a diagonal step counts the square root of two.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.straight as f64 + self.diagonal as f64 * std::f64::consts::SQRT_2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn steps_are_those_of_a_plain_look_at_the_neighbours(width in 1_u32..140, height in 1_u32..6, seed in any::<u64>()) {
            let free = |x: i64, y: i64| {
                let hash = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (y as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F) ^ seed;
                x >= 0 && y >= 0 && x < i64::from(width) && y < i64::from(height) && hash.wrapping_mul(0xD6E8_FEB8_6659_FD93) >> 62 != 0
            };
            let bits = BitGrid::from_fn(width, height, |cell| free(cell.x.into(), cell.y.into()));
            let graph = GridGraph::new(&bits).unwrap();
            for y in 0..height {
                for x in 0..width {
                    let node = graph.node(Cell::new(x, y)).unwrap();
                    prop_assert_eq!(graph.cell(node), Cell::new(x, y));
                    prop_assert_eq!(graph.is_free(node), free(x.into(), y.into()));
                    let (x, y) = (i64::from(x), i64::from(y));
                    for (i, step) in STEPS.iter().enumerate() {
                        let (dx, dy) = (i64::from(step.x), i64::from(step.y));
                        let expected = free(x + dx, y + dy) && free(x + dx, y) && free(x, y + dy);
                        // A straight step looks at its own cell only.
                        let expected = if dx == 0 || dy == 0 { free(x + dx, y + dy) } else { expected };
                        prop_assert_eq!(graph.steps(node) >> i & 1 == 1, expected);
                    }
                }
            }
        }
    }

    #[test]
    fn corners_are_where_the_direction_changes() {
        let path = GridPath::through(&[
            Cell::new(0, 0),
            Cell::new(1, 0),
            Cell::new(2, 0),
            Cell::new(3, 1),
            Cell::new(5, 3),
        ]);
        assert_eq!(path.corners, [Cell::new(0, 0), Cell::new(2, 0), Cell::new(5, 3)]);
        assert_eq!((path.straight, path.diagonal), (2, 3));
    }
}
