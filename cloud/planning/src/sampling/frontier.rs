//! Frontier. The runs of free cells that a tree has not covered yet, row by row, next to those that it has.
//!
//! All cells of a run (adjacent free cells of one row) see each other, and two runs of neighbouring rows that share a column are
//! connected by a step. So a run counts as covered once the tree has a point in it, and the uncovered runs above and below form its
//! frontier. A tree that always takes one of them reaches every reachable cell after at most as many steps as the map has runs; random
//! samples alone need very many tries to hit a passage of one cell. Preferring samples at the border of what is covered in a projection
//! is the idea of KPIECE (Sucan and Kavraki, "A Sampling-Based Tree Planner for Systems With Complex Dynamics", 2012); the decomposition
//! is that of a sweep line.

use crate::grid_graph::GridGraph;

/// A way out of the covered region.
#[derive(Clone, Copy, Debug)]
pub struct Exit {
    /// The vertex of the tree that sees `via`.
    pub vertex: u32,
    /// A cell of a covered run (a graph's node).
    pub via: u32,
    /// An uncovered cell in a row next to that of `via`.
    pub cell: u32,
}

/// The covered cells of one tree, and its exits.
#[derive(Clone, Debug, Default)]
pub struct Frontier {
    /// One bit for each of the graph's nodes.
    covered: Vec<u64>,
    /// Words of `covered` that are not zero, possibly with duplicates.
    touched: Vec<u32>,
    exits: Vec<Exit>,
}

impl Frontier {
    /// Marks every cell as uncovered.
    pub fn clear(&mut self, graph: &GridGraph) {
        let len = graph.words().len();
        if self.covered.len() == len {
            for word in self.touched.drain(..) {
                self.covered[word as usize] = 0;
            }
        } else {
            self.touched.clear();
            // Fresh zeros cost nothing until they are touched.
            self.covered = vec![0; len];
        }
        self.exits.clear();
    }

    /// Whether a cell is covered.
    #[must_use]
    pub fn covers(&self, cell: u32) -> bool {
        self.covered[(cell >> 6) as usize] >> (cell & 63) & 1 == 1
    }

    /// Covers the run of a free cell whose centre a vertex sees; returns the run.
    pub fn cover(&mut self, graph: &GridGraph, vertex: u32, via: u32) -> [u32; 2] {
        let words = graph.words();
        let run = graph.run(via);
        for word in run[0] >> 6..=run[1] >> 6 {
            self.covered[word as usize] |= mask(run, word);
            self.touched.push(word);
        }
        let pitch = graph.pitch();
        for up in [false, true] {
            let beside = |node: u32| if up { node + pitch } else { node - pitch };
            let (covered, exits) = (&self.covered, &mut self.exits);
            let bits = |word: u32| {
                let word = (beside(word << 6) >> 6) as usize;
                words[word] & !covered[word]
            };
            // Cross to the next row as close to `via` as possible.
            let exit = |[first, last]: [u32; 2]| Exit {
                vertex,
                via,
                cell: beside(via.clamp(first, last)),
            };
            for_each_run(run, bits, |next| exits.push(exit(next)));
        }
        run
    }

    /// The exits; some may have been covered since.
    #[must_use]
    pub fn exits(&self) -> &[Exit] {
        &self.exits
    }

    /// Takes an exit; `None` if it has been covered since.
    pub fn take(&mut self, number: usize) -> Option<Exit> {
        let exit = self.exits.swap_remove(number);
        (!self.covers(exit.cell)).then_some(exit)
    }
}

/// Finds the runs of set bits in a range of nodes of one row.
fn for_each_run(range: [u32; 2], bits: impl Fn(u32) -> u64, mut found: impl FnMut([u32; 2])) {
    let mut first = None;
    for word in range[0] >> 6..=range[1] >> 6 {
        let bits = bits(word) & mask(range, word);
        let mut at = 0;
        while at < 64 {
            let rest = bits >> at;
            if let Some(begin) = first {
                at += rest.trailing_ones().min(64 - at);
                if at < 64 {
                    found([begin, (word << 6 | at) - 1]);
                    first = None;
                }
            } else if rest == 0 {
                break;
            } else {
                at += rest.trailing_zeros();
                first = Some(word << 6 | at);
            }
        }
    }
    if let Some(begin) = first {
        found([begin, range[1]]);
    }
}

/// Bits of a word that lie in a range of nodes.
fn mask(range: [u32; 2], word: u32) -> u64 {
    let low = if range[0] >> 6 == word {
        u64::MAX << (range[0] & 63)
    } else {
        u64::MAX
    };
    let high = if range[1] >> 6 == word {
        u64::MAX >> (63 - (range[1] & 63))
    } else {
        u64::MAX
    };
    low & high
}
