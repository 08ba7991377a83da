//! Node table. A value for each node, for searches that visit few of them: unwritten parts cost nothing.
//!
//! The table is allocated as zeros, which the operating system backs page by page on the first write. Written cache lines are recorded,
//! so that a new search clears only those.

/// Bytes cleared at a time: a cache line.
const LINE: usize = 64;

/// A number for each node, 0 at first.
#[derive(Clone, Debug, Default)]
pub(super) struct NodeTable<T> {
    values: Vec<T>,
    /// One bit for each cache line that was written.
    written: Vec<u64>,
}

impl<T: Copy + Default> NodeTable<T> {
    const PER_LINE: usize = LINE / size_of::<T>();

    /// Sets all values to zero, for `nodes` nodes.
    pub(super) fn clear(&mut self, nodes: usize) {
        if self.values.len() != nodes {
            // The old table is dropped first: memory may not hold both.
            *self = Self {
                values: Vec::new(),
                written: Vec::new(),
            };
            self.values = vec![T::default(); nodes];
            self.written = vec![0; nodes.div_ceil(Self::PER_LINE * 64)];
            return;
        }
        for (word, written) in self.written.iter_mut().enumerate() {
            while *written != 0 {
                let first = (word * 64 + written.trailing_zeros() as usize) * Self::PER_LINE;
                *written &= *written - 1;
                let end = nodes.min(first + Self::PER_LINE);
                self.values[first..end].fill(T::default());
            }
        }
    }

    /// The lines written since the last `clear`.
    pub(super) fn written(&self) -> Written {
        Written {
            lines: self.written.clone(),
            per_line: Self::PER_LINE,
        }
    }

    #[inline]
    pub(super) fn get(&self, node: u32) -> T {
        self.values[node as usize]
    }

    #[inline]
    pub(super) fn set(&mut self, node: u32, value: T) {
        let line = node as usize / Self::PER_LINE;
        self.written[line / 64] |= 1 << (line % 64);
        self.values[node as usize] = value;
    }
}

/// Snapshot of the written lines of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Written {
    lines: Vec<u64>,
    per_line: usize,
}

impl Written {
    /// Whether a node from `first` to `last` may have been written.
    pub(super) fn any(&self, first: u32, last: u32) -> bool {
        let line = |node: u32| node as usize / self.per_line;
        (line(first)..=line(last)).any(|line| {
            self.lines
                .get(line / 64)
                .is_some_and(|word| word >> (line % 64) & 1 == 1)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_search_finds_nothing_of_the_last_one() {
        let mut records = NodeTable::<u32>::default();
        for nodes in [1000, 1000, 1003] {
            records.clear(nodes);
            assert!((0..nodes as u32).all(|node| records.get(node) == 0));
            for node in [0, 15, 16, 500, nodes as u32 - 1] {
                records.set(node, node + 1);
                assert_eq!(records.get(node), node + 1);
            }
        }
    }
}
