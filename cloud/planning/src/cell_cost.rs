//! Cell costs. What does a step cost beyond its length?

use zenav_protocol::grid::Cell;
use zenav_space::{ConfigurationSpace, DistanceCost};

use super::grid_graph::{GridGraph, STEPS};
use super::settings::ClearanceSettings;

/// Costs beyond the path's length.
pub trait CellCost {
    /// What it costs to be at a cell, in parts of [`PARTS`] of the step that leads there or away: 0 is the length alone.
    fn extra(&self, cell: Cell) -> u8;
}

/// Extra costs are counted in parts of this many of a step's own cost.
pub const PARTS: u32 = 32;

/// The path's length alone.
#[derive(Clone, Copy, Debug)]
pub struct Uniform;

impl CellCost for Uniform {
    fn extra(&self, _cell: Cell) -> u8 {
        0
    }
}

/// Nearness to obstacles; none where none is asked for.
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

/// Costs from the first of some neighbouring cells to each of them; `None` where one is not free, or a step would cut a corner.
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

/// Cost of being near obstacles: it falls with the square of the clearance still wanted. `None` where none is asked for.
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
