//! Cost to go. The cost from each cell to the goal, by a search backwards over the cells where the footprint fits with some heading.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use zenav_protocol::grid::Cell;

use super::footprint_masks::FootprintMasks;
use crate::budget::Budget;
use crate::cell_cost::{CellCost, PARTS};
use crate::searcher::NotFound;
use zenav_space::BitGrid;

/// Costs are integers in units of this part of a cell's side.
pub(super) const UNIT: f64 = 1024.0;
/// Cost to the goal from each cell.
pub(super) struct CostToGo {
    width: u32,
    cost: Vec<u32>,
    /// Cells that were not expanded cost at least this.
    beyond: u32,
}

/// Cost of a cell that the search did not reach.
pub(super) const NEVER: u32 = u32::MAX;

impl CostToGo {
    /// Searches from the goal back to the start; `None` if the start is not reached.
    pub(super) fn new(
        masks: &FootprintMasks<'_>,
        costs: &impl CellCost,
        start: Cell,
        goal: Cell,
        budget: Budget<'_>,
        expansions: &mut u64,
    ) -> Result<Option<Self>, NotFound> {
        let spec = masks.space.spec();
        // The robot stands at the start, even if its footprint does not fit at the centres of the cells there.
        let is_beside_start = |cell: Cell| cell.x.abs_diff(start.x) <= 1 && cell.y.abs_diff(start.y) <= 1;
        let mut cost = vec![NEVER; spec.len()];
        let mut refused = BitGrid::new(spec.width, spec.height);
        let mut open = BinaryHeap::from([Reverse((0_u32, spec.index(goal) as u32))]);
        cost[spec.index(goal)] = 0;
        while let Some(Reverse((known, index))) = open.pop() {
            let cell = spec.cell(index as usize);
            if known > cost[index as usize] {
                continue;
            }
            if cell == start {
                let width = spec.width;
                let beyond = known;
                return Ok(Some(Self { width, cost, beyond }));
            }
            if budget.is_spent(*expansions) {
                return Err(NotFound::TimedOut);
            }
            *expansions += 1;
            let part = 1.0 + f64::from(costs.extra(cell)) / f64::from(PARTS);
            for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
                let (x, y) = (i64::from(cell.x) + dx, i64::from(cell.y) + dy);
                if (dx, dy) == (0, 0) || !spec.contains(x, y) {
                    continue;
                }
                let next = Cell::new(x as u32, y as u32);
                let step = if dx != 0 && dy != 0 {
                    std::f64::consts::SQRT_2
                } else {
                    1.0
                };
                let better = known.saturating_add((step * part * UNIT) as u32);
                let known = cost[spec.index(next)];
                if better >= known || refused.get(next) {
                    continue;
                }
                if known == NEVER && !is_beside_start(next) && !masks.admits_cell(next) {
                    refused.set(next, true);
                    continue;
                }
                cost[spec.index(next)] = better;
                open.push(Reverse((better, spec.index(next) as u32)));
            }
        }
        Ok(None)
    }

    pub(super) fn from(&self, cell: Cell) -> u32 {
        self.cost[cell.y as usize * self.width as usize + cell.x as usize].min(self.beyond)
    }
}
