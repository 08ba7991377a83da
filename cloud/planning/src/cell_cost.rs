//! Cell costs. The cost of a step beyond its length.

use zenav_protocol::grid::Cell;
use zenav_space::{ConfigurationSpace, DistanceCost};

use super::grid_graph::{GridGraph, STEPS};
use super::settings::ClearanceSettings;

/// Costs beyond the path's length.
pub trait CellCost {
    /// Extra cost of being at a cell, in units of 1/[`PARTS`] of the cost of a step to or from it; 0 is the length alone.
    fn extra(&self, cell: Cell) -> u8;
}

/// Extra costs are counted in this many parts of a step's own cost.
pub const PARTS: u32 = 32;

/// The path's length alone.
#[derive(Clone, Copy, Debug)]
pub struct Uniform;

impl CellCost for Uniform {
    fn extra(&self, _cell: Cell) -> u8 {
        0
    }
}

/// Nearness to obstacles; `None` costs nothing extra.
impl CellCost for Option<DistanceCost<'_>> {
    fn extra(&self, cell: Cell) -> u8 {
        self.as_ref().map_or(0, |costs| costs.at(cell))
    }
}

impl CellCost for DistanceCost<'_> {
    fn extra(&self, cell: Cell) -> u8 {
        self.at(cell)
    }
}

/// Cost of a step with half the extra cost of each end: the same in both directions.
pub(crate) fn weighted(step: u32, here: u32, there: u8) -> u32 {
    step + step * (here + u32::from(there)) / (2 * PARTS)
}

/// Cumulative costs from the first of a chain of neighbouring cells to each of them; `None` if a cell is not free or a step would cut a
/// corner.
pub(crate) fn costs_along(graph: &GridGraph, costs: &impl CellCost, cells: &[Cell]) -> Option<Vec<u32>> {
    let first = graph.node(*cells.first()?)?;
    let mut total = vec![0];
    let mut sum = 0_u32;
    for pair in cells.windows(2) {
        let (node, [from, to]) = (graph.node(pair[0])?, [pair[0], pair[1]]);
        let i = STEPS.iter().position(|step| step.after(from) == to)?;
        if graph.steps(node) >> i & 1 == 0 {
            return None;
        }
        sum = sum.saturating_add(weighted(STEPS[i].cost, u32::from(costs.extra(from)), costs.extra(to)));
        total.push(sum);
    }
    graph.is_free(first).then_some(total)
}

/// Cost of being near obstacles: it falls with the square of the missing clearance. `None` if the settings ask for none.
pub(crate) fn clearance_cost<'a>(
    space: &'a ConfigurationSpace,
    settings: &ClearanceSettings,
) -> Option<DistanceCost<'a>> {
    let ClearanceSettings {
        distance: wanted,
        weight,
    } = *settings;
    let cost = |distance: f64| {
        let clearance = distance - space.radius();
        let share = (1.0 - clearance.max(0.0) / wanted).max(0.0);
        (weight * f64::from(PARTS) * share * share) as u8
    };
    (weight > 0.0 && wanted > 0.0).then(|| DistanceCost::new(space.field(), cost))
}
