//! Cost to go. The time to the goal among static obstacles, from every position that a search may need.
//!
//! A* from the goal to the start, continued over all positions on paths that are longer than the shortest by no more than a slack: an ellipse
//! around start and goal in free space.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rustc_hash::FxHashMap;

use super::super::budget::Budget;
use super::{CoarseGrid, DIAGONAL, STEPS, STRAIGHT};

/// Ticks to the goal, by position.
pub(super) struct CostToGo(FxHashMap<(i32, i32), u32>);

impl CostToGo {
    /// For paths of at most `slack` ticks more than the shortest. `None` if the start cannot be reached, or after `most` nodes.
    pub(super) fn new(
        grid: &CoarseGrid<'_>,
        goal: (i32, i32),
        start: (i32, i32),
        slack: u32,
        most: u64,
        budget: Budget<'_>,
    ) -> Option<Self> {
        let to_start = |place: (i32, i32)| {
            let (x, y) = (place.0.abs_diff(start.0), place.1.abs_diff(start.1));
            DIAGONAL * x.min(y) + STRAIGHT * (x.max(y) - x.min(y))
        };
        let mut ticks: FxHashMap<(i32, i32), u32> = FxHashMap::default();
        let mut open = BinaryHeap::from([(Reverse(to_start(goal)), 0_u32, goal)]);
        ticks.insert(goal, 0);
        let (mut longest, mut expanded) = (u32::MAX, 0_u64);
        while let Some((Reverse(whole), here, place)) = open.pop() {
            if whole > longest {
                break;
            }
            if ticks.get(&place).is_some_and(|known| *known < here) {
                continue;
            }
            if place == start {
                longest = whole.saturating_add(slack);
            }
            expanded += 1;
            if expanded > most || budget.is_spent(expanded) {
                return None;
            }
            for (x, y, step) in STEPS {
                let next = (place.0 + x, place.1 + y);
                let there = here + step;
                if ticks.get(&next).is_some_and(|known| *known <= there) || !grid.is_free(place, next) {
                    continue;
                }
                ticks.insert(next, there);
                open.push((Reverse(there + to_start(next)), there, next));
            }
        }
        ticks.contains_key(&start).then_some(Self(ticks))
    }

    /// Ticks from a position to the goal; `None` for positions that the search does not need.
    pub(super) fn at(&self, place: (i32, i32)) -> Option<u32> {
        self.0.get(&place).copied()
    }
}
