//! Open list. The node with the lowest estimate is expanded next; of almost equal ones, the latest.
//!
//! Estimates never fall in a search with a consistent heuristic, so no heap is needed: near estimates lie in fine buckets, later ones in
//! coarser and coarser buckets, which are spread over finer ones when their turn comes. A push or a pop costs a few instructions,
//! whatever the number of nodes. Latest-first leads a search straight on towards its goal where many paths are equally short.
//!
//! Sources: Dial, "Algorithm 360: Shortest-Path Forest with Topological Ordering", 1969; Varghese and Lauck, "Hashed and Hierarchical
//! Timing Wheels", 1987.

/// Estimates that differ by less than this, an eleventh of a straight step, come in any order.
const WIDTH_BITS: u32 = 9;
/// Buckets per level: one bit of a word each.
const SLOT_BITS: u32 = 6;
const SLOTS: usize = 1 << SLOT_BITS;
const LEVELS: usize = 4;
const _: () = assert!(WIDTH_BITS + SLOT_BITS * LEVELS as u32 >= u32::BITS);

/// Open nodes by estimate.
#[derive(Clone, Debug)]
pub(super) struct OpenList {
    buckets: Vec<Vec<Open>>,
    /// The buckets of each level that are not empty, a bit each.
    filled: [u64; LEVELS],
    /// The bucket of the finest level that is being emptied.
    now: u32,
}

/// A node that was reached but not expanded yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Open {
    /// Least cost of a path through it.
    pub(super) estimate: u32,
    /// Identifier given by the search.
    pub(super) name: u32,
}

impl Default for OpenList {
    fn default() -> Self {
        Self {
            buckets: vec![Vec::new(); SLOTS * LEVELS],
            filled: [0; LEVELS],
            now: 0,
        }
    }
}

/// Whether no node popped from `estimate` on can be better than `cost`.
pub(super) fn is_past(estimate: u32, cost: u32) -> bool {
    estimate >> WIDTH_BITS > cost >> WIDTH_BITS
}

impl OpenList {
    /// Empty, for estimates from `first` on.
    pub(super) fn clear(&mut self, first: u32) {
        for (level, filled) in self.filled.iter_mut().enumerate() {
            while *filled != 0 {
                self.buckets[level * SLOTS + filled.trailing_zeros() as usize].clear();
                *filled &= *filled - 1;
            }
        }
        self.now = first >> WIDTH_BITS;
    }

    /// Adds a node. Its estimate is not below that of the last node popped.
    pub(super) fn push(&mut self, open: Open) {
        let bucket = (open.estimate >> WIDTH_BITS).max(self.now);
        let differs = bucket ^ self.now;
        // The highest digit that differs selects the level.
        let level = if differs < SLOTS as u32 {
            0
        } else {
            (differs.ilog2() / SLOT_BITS) as usize
        };
        let slot = (bucket >> (level as u32 * SLOT_BITS)) as usize % SLOTS;
        self.filled[level] |= 1 << slot;
        self.buckets[level * SLOTS + slot].push(open);
    }

    /// Removes the next node.
    pub(super) fn pop(&mut self) -> Option<Open> {
        while self.filled[0] == 0 {
            self.spread()?;
        }
        let slot = self.filled[0].trailing_zeros();
        self.now = self.now & !(SLOTS as u32 - 1) | slot;
        let bucket = &mut self.buckets[slot as usize];
        let open = bucket.pop();
        if bucket.is_empty() {
            self.filled[0] &= self.filled[0] - 1;
        }
        open
    }

    /// Spreads the next coarse bucket over finer ones.
    fn spread(&mut self) -> Option<()> {
        let level = self.filled.iter().position(|filled| *filled != 0)?;
        let slot = self.filled[level].trailing_zeros();
        self.filled[level] &= self.filled[level] - 1;
        let digit = level as u32 * SLOT_BITS;
        self.now = (self.now >> digit & !(SLOTS as u32 - 1) | slot) << digit;
        let at = level * SLOTS + slot as usize;
        let mut bucket = std::mem::take(&mut self.buckets[at]);
        for open in bucket.drain(..) {
            self.push(open);
        }
        self.buckets[at] = bucket;
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn whatever_is_put_in_comes_out_once_and_in_order(first in any::<u32>(), rises in prop::collection::vec((0_u32..28, any::<u32>(), any::<bool>()), 1..300)) {
            let mut list = OpenList::default();
            // Leftovers of an earlier search do not matter.
            list.push(Open { estimate: 7, name: 7 });
            list.clear(first);
            let (mut last, mut inside) = (first, Vec::new());
            for (name, (bits, rise, take)) in rises.into_iter().enumerate() {
                if take {
                    let out = list.pop();
                    let least = inside.iter().map(|open: &Open| open.estimate >> WIDTH_BITS).min();
                    prop_assert_eq!(out.map(|open| open.estimate >> WIDTH_BITS), least);
                    if let Some(open) = out {
                        // The latest of those in one bucket.
                        let latest = inside.iter().rposition(|other| other.estimate >> WIDTH_BITS == open.estimate >> WIDTH_BITS).unwrap();
                        prop_assert_eq!(inside.remove(latest), open);
                        last = last.max(open.estimate);
                    }
                } else {
                    let open = Open { estimate: last.saturating_add(rise >> (31 - bits)), name: name as u32 };
                    list.push(open);
                    inside.push(open);
                }
            }
            while let Some(open) = list.pop() {
                prop_assert!(open.estimate >> WIDTH_BITS >= last >> WIDTH_BITS);
                last = last.max(open.estimate);
                inside.retain(|other| *other != open);
            }
            prop_assert!(inside.is_empty());
        }
    }
}
