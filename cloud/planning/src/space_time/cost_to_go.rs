//! Cost to go. The time to the goal among static obstacles, from every position that a search may need.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rustc_hash::FxHashMap;

use super::super::budget::Budget;
use super::{CoarseGrid, STEPS};

/// Ticks to the goal, by position.
pub(super) struct CostToGo(FxHashMap<(i32, i32), u32>);

impl CostToGo {
    /// Dijkstra from the goal until the start is reached, and for `slack` ticks beyond. `None` if the start cannot be reached.
    pub(super) fn new(
        grid: &CoarseGrid<'_>,
        goal: (i32, i32),
        start: (i32, i32),
        slack: u32,
        budget: Budget<'_>,
    ) -> Option<Self> {
        let mut ticks: FxHashMap<(i32, i32), u32> = FxHashMap::default();
        let mut open = BinaryHeap::from([(Reverse(0_u32), goal)]);
        ticks.insert(goal, 0);
        let (mut most, mut expanded) = (u32::MAX, 0_u64);
        while let Some((Reverse(here), place)) = open.pop() {
            if here > most {
                break;
            }
            if ticks.get(&place).is_some_and(|known| *known < here) {
                continue;
            }
            if place == start {
                most = here.saturating_add(slack);
            }
            expanded += 1;
            if budget.is_spent(expanded) {
                return None;
            }
            for (x, y, step) in STEPS {
                let next = (place.0 + x, place.1 + y);
                let there = here + step;
                if ticks.get(&next).is_some_and(|known| *known <= there)
                    || !grid.is_free(place.0, place.1, next.0, next.1)
                {
                    continue;
                }
                ticks.insert(next, there);
                open.push((Reverse(there), next));
            }
        }
        ticks.contains_key(&start).then_some(Self(ticks))
    }

    /// Ticks from a position to the goal; `None` for positions that the search does not need.
    pub(super) fn at(&self, place: (i32, i32)) -> Option<u32> {
        self.0.get(&place).copied()
    }
}
