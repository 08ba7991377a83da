//! Sparse blocks. Solves a symmetric system of small blocks, one for each node.
//!
//! The blocks are ordered by approximate minimum degree (Amestoy et al. 1996), the entries of a block stay together, and the matrix is
//! factorised as `L D Lᵀ` without pivoting; the signs of `D` are the inertia of the matrix.

use clarabel::algebra::CscMatrix;
use clarabel::qdldl::{QDLDLFactorisation, QDLDLSettings};
use nalgebra::SMatrix;

/// The elimination order of the nodes, and the pairs of connected nodes.
#[derive(Clone, Debug)]
pub(crate) struct Pattern {
    /// Position of a node in the elimination; the anchor has none.
    position: Vec<Option<usize>>,
    /// For each position, the earlier positions connected to it, ascending.
    above: Vec<Vec<usize>>,
    /// For each requested pair: position of the column, place in `above`, and whether the pair runs downwards. `None` for the anchor.
    slots: Vec<Option<(usize, usize, bool)>>,
}

impl Pattern {
    /// The pattern of `nodes` nodes, without node 0, connected by `pairs`. `None` if the ordering fails, which does not occur.
    pub(crate) fn new(nodes: usize, pairs: &[(usize, usize)]) -> Option<Self> {
        let free = nodes.saturating_sub(1);
        let mut columns: Vec<Vec<usize>> = (0..free).map(|node| vec![node]).collect();
        for &(a, b) in pairs {
            if a > 0 && b > 0 {
                columns[a.max(b) - 1].push(a.min(b) - 1);
            }
        }
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for column in &mut columns {
            column.sort_unstable();
            column.dedup();
            rows.extend_from_slice(column);
            starts.push(rows.len());
        }
        let (_, inverse, _) = amd::order(free, &starts, &rows, &amd::Control::default()).ok()?;
        let position: Vec<Option<usize>> = (0..nodes)
            .map(|node| node.checked_sub(1).map(|free| inverse[free]))
            .collect();
        let mut above: Vec<Vec<usize>> = vec![Vec::new(); free];
        let joined = |a: usize, b: usize| Some((position[a]?, position[b]?));
        for &(a, b) in pairs {
            if let Some((a, b)) = joined(a, b) {
                above[a.max(b)].push(a.min(b));
            }
        }
        for rows in &mut above {
            rows.sort_unstable();
            rows.dedup();
        }
        let slot = |&(a, b): &(usize, usize)| {
            let (a, b) = joined(a, b)?;
            let place = above[a.max(b)].binary_search(&a.min(b)).ok()?;
            Some((a.max(b), place, a > b))
        };
        let slots = pairs.iter().map(slot).collect();
        Some(Self { position, above, slots })
    }
}

/// A symmetric matrix of `B` by `B` blocks over a [`Pattern`], and its factors.
pub(crate) struct BlockSystem<'p, const B: usize> {
    pattern: &'p Pattern,
    matrix: CscMatrix<f64>,
    indices: Vec<usize>,
    factors: Option<QDLDLFactorisation<f64>>,
}

impl<'p, const B: usize> BlockSystem<'p, B> {
    /// All zero.
    pub(crate) fn new(pattern: &'p Pattern) -> Self {
        let size = B * pattern.above.len();
        let (mut starts, mut rows) = (Vec::with_capacity(size + 1), Vec::new());
        starts.push(0);
        for (column, above) in pattern.above.iter().enumerate() {
            for inner in 0..B {
                for row in above {
                    rows.extend((0..B).map(|part| B * row + part));
                }
                rows.extend((0..=inner).map(|part| B * column + part));
                starts.push(rows.len());
            }
        }
        let values = vec![0.0; rows.len()];
        let indices = (0..rows.len()).collect();
        Self {
            pattern,
            matrix: CscMatrix::new(size, size, starts, rows, values),
            indices,
            factors: None,
        }
    }

    /// Makes all entries zero; the factors stay until [`Self::factorise`].
    pub(crate) fn clear(&mut self) {
        self.matrix.nzval.fill(0.0);
    }

    /// Adds to the diagonal block of a node; only the upper triangle counts.
    pub(crate) fn add_node(&mut self, node: usize, block: &SMatrix<f64, B, B>) {
        let Some(position) = self.pattern.position[node] else {
            return;
        };
        let offset = B * self.pattern.above[position].len();
        for inner in 0..B {
            let at = self.matrix.colptr[B * position + inner] + offset;
            for row in 0..=inner {
                self.matrix.nzval[at + row] += block[(row, inner)];
            }
        }
    }

    /// Adds to the block in the rows of the first and the columns of the second node of a pair (and, transposed, to its mirror).
    pub(crate) fn add_pair(&mut self, pair: usize, block: &SMatrix<f64, B, B>) {
        let Some((column, place, is_downwards)) = self.pattern.slots[pair] else {
            return;
        };
        for inner in 0..B {
            let at = self.matrix.colptr[B * column + inner] + B * place;
            for row in 0..B {
                self.matrix.nzval[at + row] += if is_downwards {
                    block[(inner, row)]
                } else {
                    block[(row, inner)]
                };
            }
        }
    }

    /// Adds a share of the diagonal to it, and a minimal amount.
    pub(crate) fn damp(&mut self, share: f64) {
        for column in 0..self.matrix.n {
            let at = self.matrix.colptr[column + 1] - 1;
            self.matrix.nzval[at] += share * self.matrix.nzval[at].abs().max(f64::MIN_POSITIVE);
        }
    }

    /// Factorises; returns the number of pivots that are not positive, `None` if one is zero or not finite.
    pub(crate) fn factorise(&mut self) -> Option<usize> {
        if self.matrix.n == 0 {
            return Some(0);
        }
        let is_done = match &mut self.factors {
            Some(factors) => {
                factors.update_values(&self.indices, &self.matrix.nzval);
                factors.refactor().is_ok()
            }
            None => {
                let settings = QDLDLSettings {
                    perm: Some((0..self.matrix.n).collect()),
                    regularize_enable: false,
                    ..QDLDLSettings::default()
                };
                self.factors = QDLDLFactorisation::new(&self.matrix, Some(settings)).ok();
                self.factors.is_some()
            }
        };
        let factors = self.factors.as_ref().filter(|_| is_done)?;
        let is_finite = factors.D.iter().all(|pivot| pivot.is_finite());
        is_finite.then(|| self.matrix.n - factors.positive_inertia())
    }

    /// Solves with the latest factors: `nodes` blocks in, `nodes` blocks out, by node; the anchor's is zero. All zero without factors.
    pub(crate) fn solve(&mut self, by_node: &mut [[f64; B]]) {
        let mut ordered = vec![0.0; self.matrix.n];
        for (block, position) in by_node.iter().zip(&self.pattern.position) {
            if let Some(position) = position {
                ordered[B * position..B * (position + 1)].copy_from_slice(block);
            }
        }
        match &mut self.factors {
            Some(factors) => factors.solve(&mut ordered),
            None => ordered.fill(0.0),
        }
        for (block, position) in by_node.iter_mut().zip(&self.pattern.position) {
            match position {
                Some(position) => block.copy_from_slice(&ordered[B * position..B * (position + 1)]),
                None => block.fill(0.0),
            }
        }
    }
}
