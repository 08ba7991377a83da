//! Frontier. What has a tree not seen yet, and how does it get there? Runs of free cells, row by row, next to those in which the tree has a place.
//!
//! All cells of a run (free cells side by side in one row) are seen from each of them, and two runs of neighbouring rows that share a column
//! are connected by a step. So a run counts as covered once the tree has a place in it, the runs above and below that are not covered make
//! up its frontier, and a tree that always takes one of them reaches every cell that it can ever reach after at most as many steps as the map
//! has runs: chance alone needs very many samples to meet a passage of one cell. The idea, to prefer samples at the border of what is covered
//! in a projection, is KPIECE's (Sucan and Kavraki, "A Sampling-Based Tree Planner for Systems With Complex Dynamics", 2012); the
//! decomposition is that of a sweep line.

use crate::grid_graph::GridGraph;

/// A path out of what is covered.
#[derive(Clone, Copy, Debug)]
pub struct Exit {
    /// The vertex of the tree from which `via` is seen.
    pub vertex: u32,
    /// The cell of a covered run in which the tree has a place (a graph's node).
    pub via: u32,
    /// A cell that was not covered, in a row next to that of `via`.
    pub cell: u32,
}

/// The covered cells of one tree, and what lies next to them.
#[derive(Clone, Debug, Default)]
pub struct Frontier {
    /// One bit for each of the graph's nodes.
    covered: Vec<u64>,
    /// Words of `covered` that are not zero, some of them more than once.
    touched: Vec<u32>,
    exits: Vec<Exit>,
}

impl Frontier {
    /// Nothing is covered any more.
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

    /// Covers the run of a free cell whose centre is seen from a vertex; returns the run.
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
            // From where the tree is, straight over where it can be.
            let exit = |[first, last]: [u32; 2]| Exit {
                vertex,
                via,
                cell: beside(via.clamp(first, last)),
            };
            for_each_run(run, bits, |next| exits.push(exit(next)));
        }
        run
    }

    /// Exits, some of which may have been covered since.
    #[must_use]
    pub fn exits(&self) -> &[Exit] {
        &self.exits
    }

    /// Takes an exit; `None` when it has been covered since.
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
