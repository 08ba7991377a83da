//! Queries of a map. The longest published ones, or the longest of many random pairs.

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use zenav_mapping::{cell_from_top, parse_moving_ai_scenarios};
use zenav_planning::{Budget, Planner, Query, Searcher};
use zenav_protocol::grid::{Cell, GridSpec};
use zenav_space::{BitGrid, PointLineOfSight};

/// Queries per map.
const COUNT: usize = 50;
/// Number of pairs drawn if nothing is published.
const DRAWN: usize = 1000;
/// Seed of the drawn pairs.
pub const SEED: u64 = 1;

/// The hardest queries of a scenario file; ties in file order.
pub fn published(spec: &GridSpec, scenarios: &[u8]) -> Vec<Query> {
    let mut scenarios = parse_moving_ai_scenarios(scenarios).unwrap();
    scenarios.sort_by(|a, b| b.optimum.total_cmp(&a.optimum));
    scenarios.truncate(COUNT);
    let cell = |at| cell_from_top(spec, at).unwrap();
    scenarios
        .iter()
        .map(|scenario| query(cell(scenario.start), cell(scenario.goal)))
        .collect()
}

/// The longest connected pairs of those drawn from the free cells.
pub fn drawn(free: &BitGrid) -> Vec<Query> {
    let rows = 0..free.height();
    let cells: Vec<Cell> = rows
        .flat_map(|y| free.set_in_row(y, 0, i64::MAX).map(move |x| Cell::new(x, y)))
        .collect();
    if cells.is_empty() {
        return Vec::new();
    }
    let mut random = Pcg64Mcg::seed_from_u64(SEED);
    let mut searcher = Searcher::new(free).unwrap();
    let sight = PointLineOfSight::new(free);
    let mut found: Vec<(f64, Query)> = Vec::new();
    for _ in 0..DRAWN {
        let mut draw = || cells[random.random_range(0..cells.len())];
        let query = query(draw(), draw());
        if let Ok(path) = searcher
            .search(Planner::AStar, &sight, &query, Budget::UNLIMITED)
            .result
        {
            found.push((path.length, query));
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(COUNT).map(|(_, query)| query).collect()
}

fn query(start: Cell, goal: Cell) -> Query {
    Query {
        start: start.center(),
        goal: goal.center(),
        seed: SEED,
    }
}
