//! Sparse blocks. Solves a symmetric system of small blocks, one for each node.
//!
//! The blocks are ordered by approximate minimum degree (Amestoy et al. 1996), and the matrix is factorised as `L D Lᵀ` without pivoting,
//! row by row of `L` (Davis, "Direct methods for sparse linear systems", 2006, chapter 4), with a dense block in place of each number: the
//! elimination tree is a tree of nodes, one for all systems over a graph, and a product of blocks takes each number from memory once. `D` has
//! blocks, too, factorised in the same way: the signs of their pivots are the inertia of the matrix.

use nalgebra::{Matrix3, SMatrix};

/// The elimination order of the nodes, and the blocks of matrices and factors that are not zero.
#[derive(Clone, Debug)]
pub(crate) struct Pattern {
    /// Position of a node in the elimination; the anchor has none.
    position: Vec<Option<usize>>,
    /// For each position, the earlier positions connected to it, ascending.
    above: Lists,
    /// For each requested pair: place in `above`, and whether the pair runs downwards. `None` for the anchor.
    slots: Vec<Option<(usize, bool)>>,
    /// For each position, the earlier ones in its row of `L`, ascending.
    rows: Lists,
    /// For each position, the later ones in its column of `L`, ascending: the first is its parent in the elimination tree.
    columns: Lists,
}

/// Lists of positions, one after the other.
#[derive(Clone, Debug)]
struct Lists {
    starts: Vec<usize>,
    all: Vec<usize>,
}

impl Lists {
    fn new(lists: &[Vec<usize>]) -> Self {
        let mut starts = vec![0];
        starts.extend(lists.iter().scan(0, |end, list| {
            *end += list.len();
            Some(*end)
        }));
        Self {
            starts,
            all: lists.concat(),
        }
    }

    fn range(&self, list: usize) -> std::ops::Range<usize> {
        self.starts[list]..self.starts[list + 1]
    }

    fn of(&self, list: usize) -> &[usize] {
        &self.all[self.range(list)]
    }
}

impl Pattern {
    /// The pattern of `nodes` nodes, without node 0, connected by `pairs`. `None` if the ordering fails, which does not occur.
    pub(crate) fn new(nodes: usize, pairs: &[(usize, usize)]) -> Option<Self> {
        let free = nodes.saturating_sub(1);
        let mut joined: Vec<Vec<usize>> = (0..free).map(|node| vec![node]).collect();
        for &(a, b) in pairs {
            if a > 0 && b > 0 {
                joined[a.max(b) - 1].push(a.min(b) - 1);
            }
        }
        for column in &mut joined {
            column.sort_unstable();
            column.dedup();
        }
        let Lists { starts, all } = Lists::new(&joined);
        let (_, inverse, _) = amd::order(free, &starts, &all, &amd::Control::default()).ok()?;
        let position: Vec<Option<usize>> = (0..nodes)
            .map(|node| node.checked_sub(1).map(|free| inverse[free]))
            .collect();
        let mut above: Vec<Vec<usize>> = vec![Vec::new(); free];
        let positions = |a: usize, b: usize| Some((position[a]?, position[b]?));
        for &(a, b) in pairs {
            if let Some((a, b)) = positions(a, b) {
                above[a.max(b)].push(a.min(b));
            }
        }
        for rows in &mut above {
            rows.sort_unstable();
            rows.dedup();
        }
        let above = Lists::new(&above);
        let slot = |&(a, b): &(usize, usize)| {
            let (a, b) = positions(a, b)?;
            let place = above.of(a.max(b)).binary_search(&a.min(b)).ok()?;
            Some((above.starts[a.max(b)] + place, a > b))
        };
        let slots = pairs.iter().map(slot).collect();
        let (rows, columns) = eliminated(&above, free);
        Some(Self {
            position,
            above,
            slots,
            rows,
            columns,
        })
    }
}

/// The rows and columns of `L` below its diagonal: an entry in a column enters the column's parent, which is the first below.
fn eliminated(above: &Lists, size: usize) -> (Lists, Lists) {
    let mut columns: Vec<Vec<usize>> = vec![Vec::new(); size];
    let mut rows: Vec<Vec<usize>> = vec![Vec::new(); size];
    let mut reached_by = vec![usize::MAX; size];
    for row in 0..size {
        reached_by[row] = row;
        for first in above.of(row) {
            let mut next = Some(*first);
            while let Some(column) = next.filter(|column| reached_by[*column] != row) {
                reached_by[column] = row;
                next = columns[column].first().copied();
                columns[column].push(row);
                rows[row].push(column);
            }
        }
        rows[row].sort_unstable();
    }
    (Lists::new(&rows), Lists::new(&columns))
}

/// A block, column by column.
type Block<const B: usize> = [[f64; B]; B];

/// Subtracts the product of a block with columns.
fn subtract_product<const B: usize, const C: usize>(from: &mut [[f64; B]; C], block: &Block<B>, by: &[[f64; B]; C]) {
    for (from, by) in from.iter_mut().zip(by) {
        for (column, factor) in block.iter().zip(by) {
            for (sum, entry) in from.iter_mut().zip(column) {
                *sum -= entry * factor;
            }
        }
    }
}

/// A block of `D`, factorised: the pivots, and what is below the diagonal of a triangle of ones.
#[derive(Clone, Copy, Debug)]
struct Pivots<const B: usize> {
    below: Block<B>,
    inverse: [f64; B],
}

impl<const B: usize> Pivots<B> {
    const NONE: Self = Self {
        below: [[0.0; B]; B],
        inverse: [0.0; B],
    };

    /// Factorises a block, of which the upper triangle counts. Returns the number of pivots that are not positive, too; `None` if one is zero
    /// or not finite.
    fn of(mut block: Block<B>) -> Option<(Self, usize)> {
        let (mut pivots, mut negative) = (Self::NONE, 0);
        for at in 0..B {
            let pivot = block[at][at];
            if pivot == 0.0 || !pivot.is_finite() {
                return None;
            }
            negative += usize::from(pivot < 0.0);
            pivots.inverse[at] = pivot.recip();
            for row in at + 1..B {
                let factor = block[row][at] / pivot;
                pivots.below[at][row] = factor;
                for column in block.iter_mut().skip(row) {
                    column[row] -= factor * column[at];
                }
            }
        }
        Some((pivots, negative))
    }

    /// Solves with the lower triangle.
    fn forward(&self, values: &mut [f64; B]) {
        for at in 0..B {
            for row in at + 1..B {
                values[row] -= self.below[at][row] * values[at];
            }
        }
    }

    /// Solves with the whole block.
    fn solve(&self, values: &mut [f64; B]) {
        self.forward(values);
        for (value, inverse) in values.iter_mut().zip(&self.inverse) {
            *value *= inverse;
        }
        for at in (0..B).rev() {
            for row in at + 1..B {
                values[at] -= self.below[at][row] * values[row];
            }
        }
    }
}

/// A symmetric matrix of `B` by `B` blocks over a [`Pattern`], and its factors.
pub(crate) struct BlockSystem<'p, const B: usize> {
    pattern: &'p Pattern,
    /// The blocks on the diagonal, and those above it.
    diagonal: Vec<Block<B>>,
    above: Vec<Block<B>>,
    /// `L` by columns, and `D`.
    lower: Vec<Block<B>>,
    pivots: Vec<Pivots<B>>,
    is_factorised: bool,
}

impl<'p, const B: usize> BlockSystem<'p, B> {
    /// All zero.
    pub(crate) fn new(pattern: &'p Pattern) -> Self {
        let size = pattern.columns.starts.len() - 1;
        Self {
            pattern,
            diagonal: vec![[[0.0; B]; B]; size],
            above: vec![[[0.0; B]; B]; pattern.above.all.len()],
            lower: vec![[[0.0; B]; B]; pattern.columns.all.len()],
            pivots: vec![Pivots::NONE; size],
            is_factorised: false,
        }
    }

    /// Makes all entries zero; the factors stay until [`Self::factorise`].
    pub(crate) fn clear(&mut self) {
        self.diagonal.fill([[0.0; B]; B]);
        self.above.fill([[0.0; B]; B]);
    }

    /// Adds to the diagonal block of a node; only the upper triangle counts.
    pub(crate) fn add_node(&mut self, node: usize, block: &SMatrix<f64, B, B>) {
        let Some(position) = self.pattern.position[node] else {
            return;
        };
        let sums = self.diagonal[position].as_flattened_mut();
        for (sum, entry) in sums.iter_mut().zip(block.iter()) {
            *sum += entry;
        }
    }

    /// Adds to the block in the rows of the first and the columns of the second node of a pair (and, transposed, to its mirror).
    pub(crate) fn add_pair(&mut self, pair: usize, block: &SMatrix<f64, B, B>) {
        let Some((place, is_downwards)) = self.pattern.slots[pair] else {
            return;
        };
        let turned = if is_downwards { block.transpose() } else { *block };
        let sums = self.above[place].as_flattened_mut();
        for (sum, entry) in sums.iter_mut().zip(turned.iter()) {
            *sum += entry;
        }
    }

    /// Adds a share of the diagonal to it, and a minimal amount.
    pub(crate) fn damp(&mut self, share: f64) {
        for block in &mut self.diagonal {
            for (at, column) in block.iter_mut().enumerate() {
                column[at] += share * column[at].abs().max(f64::MIN_POSITIVE);
            }
        }
    }

    /// Factorises; returns the number of pivots that are not positive, `None` if one is zero or not finite.
    pub(crate) fn factorise(&mut self) -> Option<usize> {
        let Pattern {
            above, rows, columns, ..
        } = self.pattern;
        self.is_factorised = false;
        let size = self.diagonal.len();
        // The row of `L` at work, by position, before it is divided by `D`; and where each column of `L` ends so far.
        let mut row = vec![[[0.0; B]; B]; size];
        let mut ends = columns.starts[..size].to_vec();
        let mut negative = 0;
        for at in 0..size {
            for place in above.range(at) {
                row[above.all[place]] = self.above[place];
            }
            let mut pivot = self.diagonal[at];
            for column in rows.of(at) {
                let value = std::mem::replace(&mut row[*column], [[0.0; B]; B]);
                let (start, end) = (columns.starts[*column], ends[*column]);
                for (below, factor) in columns.all[start..end].iter().zip(&self.lower[start..end]) {
                    subtract_product(&mut row[*below], factor, &value);
                }
                let mut divided = value;
                for values in &mut divided {
                    self.pivots[*column].solve(values);
                }
                for (upper, divided) in pivot.iter_mut().zip(&divided) {
                    for (sum, value) in upper.iter_mut().zip(&value) {
                        *sum -= value.iter().zip(divided).map(|(a, b)| a * b).sum::<f64>();
                    }
                }
                let factor = &mut self.lower[end];
                for (one, divided) in divided.iter().enumerate() {
                    for (other, entry) in divided.iter().enumerate() {
                        factor[other][one] = *entry;
                    }
                }
                ends[*column] += 1;
            }
            let (pivots, below_zero) = Pivots::of(pivot)?;
            self.pivots[at] = pivots;
            negative += below_zero;
        }
        self.is_factorised = true;
        Some(negative)
    }

    /// Solves with the latest factors: `nodes` blocks in, `nodes` blocks out, by node; the anchor's is zero. All zero without factors.
    pub(crate) fn solve(&self, by_node: &mut [[f64; B]]) {
        let columns = &self.pattern.columns;
        let mut ordered = vec![[0.0; B]; self.diagonal.len()];
        for (block, position) in by_node.iter().zip(&self.pattern.position) {
            if let Some(position) = position {
                ordered[*position] = *block;
            }
        }
        if !self.is_factorised {
            ordered.fill([0.0; B]);
        }
        for at in 0..ordered.len() {
            let value = [ordered[at]];
            for place in columns.range(at) {
                let below = std::array::from_mut(&mut ordered[columns.all[place]]);
                subtract_product(below, &self.lower[place], &value);
            }
        }
        for at in (0..ordered.len()).rev() {
            let mut value = ordered[at];
            self.pivots[at].solve(&mut value);
            for place in columns.range(at) {
                let below = &ordered[columns.all[place]];
                for (sum, column) in value.iter_mut().zip(&self.lower[place]) {
                    *sum -= column.iter().zip(below).map(|(a, b)| a * b).sum::<f64>();
                }
            }
            ordered[at] = value;
        }
        for (block, position) in by_node.iter_mut().zip(&self.pattern.position) {
            *block = position.map_or([0.0; B], |position| ordered[position]);
        }
    }

    /// Computes halves of covariances with the latest factors. `None` without factors of a positive definite matrix.
    pub(crate) fn halves(&self) -> Option<Halves<'_, B>> {
        let is_positive = self
            .pivots
            .iter()
            .flat_map(|pivots| &pivots.inverse)
            .all(|inverse| *inverse > 0.0);
        (self.is_factorised && is_positive).then(|| Halves {
            system: self,
            values: vec![[[0.0; B]; 3]; self.diagonal.len()],
            is_reached: vec![false; self.diagonal.len()],
        })
    }
}

/// Halves of covariances: see [`Self::of`].
pub(crate) struct Halves<'s, const B: usize> {
    system: &'s BlockSystem<'s, B>,
    values: Vec<[[f64; B]; 3]>,
    is_reached: Vec<bool>,
}

impl<const B: usize> Halves<'_, B> {
    /// With the matrix `A = L D Lᵀ` and three columns `J` that are zero but in the blocks of some nodes: `D^-½ L⁻¹ J`. The product of two
    /// such is a covariance, `Jᵀ A⁻¹ K`. Cost: the blocks of `L` in the columns of these nodes and of those that depend on them.
    pub(crate) fn of(&mut self, blocks: &[(usize, SMatrix<f64, B, 3>)]) -> Half<B> {
        let (system, columns) = (self.system, &self.system.pattern.columns);
        let mut positions = Vec::new();
        for (node, block) in blocks {
            let Some(first) = system.pattern.position[*node] else {
                continue;
            };
            let sums = self.values[first].as_flattened_mut();
            for (sum, entry) in sums.iter_mut().zip(block.iter()) {
                *sum += entry;
            }
            // Up the elimination tree.
            let mut next = Some(first);
            while let Some(at) = next.filter(|at| !self.is_reached[*at]) {
                self.is_reached[at] = true;
                positions.push(at);
                next = columns.of(at).first().copied();
            }
        }
        positions.sort_unstable();
        let mut values = Vec::with_capacity(positions.len());
        for at in &positions {
            let mut value = std::mem::replace(&mut self.values[*at], [[0.0; B]; 3]);
            self.is_reached[*at] = false;
            for place in columns.range(*at) {
                subtract_product(&mut self.values[columns.all[place]], &system.lower[place], &value);
            }
            let pivots = &system.pivots[*at];
            for column in &mut value {
                pivots.forward(column);
                for (value, inverse) in column.iter_mut().zip(&pivots.inverse) {
                    *value *= inverse.sqrt();
                }
            }
            values.push(value);
        }
        Half { positions, values }
    }
}

/// Half of a covariance, sparse: the positions that are not zero, ascending.
#[derive(Clone, Debug)]
pub(crate) struct Half<const B: usize> {
    positions: Vec<usize>,
    values: Vec<[[f64; B]; 3]>,
}

impl<const B: usize> Half<B> {
    /// The covariance of this, by rows, and another one, by columns.
    pub(crate) fn covariance(&self, other: &Self) -> Matrix3<f64> {
        let (mut product, mut at) = (Matrix3::zeros(), 0);
        for (position, left) in self.positions.iter().zip(&self.values) {
            while other.positions.get(at).is_some_and(|other| other < position) {
                at += 1;
            }
            if other.positions.get(at) == Some(position) {
                let right = &other.values[at];
                product += Matrix3::from_fn(|row, column| {
                    left[row].iter().zip(&right[column]).map(|(a, b)| a * b).sum::<f64>()
                });
            }
        }
        product
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn the_product_of_two_halves_is_the_covariance() {
        // A ring of six nodes with a chord; node 0 is the anchor.
        let pairs = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 0), (1, 4)];
        let pattern = Pattern::new(6, &pairs).unwrap();
        let mut system = BlockSystem::<3>::new(&pattern);
        for (pair, (a, b)) in pairs.into_iter().enumerate() {
            let own = Matrix3::new(3.0, 0.5, 0.1, 0.5, 2.0, 0.2, 0.1, 0.2, 1.0) * (1.0 + pair as f64);
            system.add_node(a, &own);
            system.add_node(b, &own);
            system.add_pair(pair, &-own);
        }
        assert!(system.halves().is_none(), "no factors yet");
        assert_eq!(system.factorise(), Some(0));
        let jacobians = [
            vec![(2, Matrix3::identity()), (5, -Matrix3::identity())],
            vec![(4, Matrix3::new(1.0, 2.0, 3.0, 0.0, 1.0, 4.0, 0.0, 0.0, 1.0))],
            vec![(0, Matrix3::identity()), (3, Matrix3::identity() * 2.0)],
        ];
        let mut halves = system.halves().unwrap();
        let half: Vec<Half<3>> = jacobians.iter().map(|blocks| halves.of(blocks)).collect();
        for (a, blocks_a) in jacobians.iter().enumerate() {
            for (b, blocks_b) in jacobians.iter().enumerate() {
                let mut wanted = Matrix3::zeros();
                for column in 0..3 {
                    let mut by_node = vec![[0.0; 3]; 6];
                    for (node, block) in blocks_b {
                        by_node[*node] = block.column(column).into_owned().into();
                    }
                    system.solve(&mut by_node);
                    for (node, block) in blocks_a {
                        let part = block.transpose() * Vector3::from(by_node[*node]);
                        wanted.set_column(column, &(wanted.column(column) + part));
                    }
                }
                assert!((half[a].covariance(&half[b]) - wanted).amax() < 1e-12, "{a} and {b}");
            }
        }
    }
}
