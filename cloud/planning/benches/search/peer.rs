//! Peer. A* of the crate `pathfinding` over the same grid, with costs in millionths of a cell; successors need no memory of their own.

use pathfinding::prelude::astar;
use zenav_planning::Query;
use zenav_protocol::grid::Cell;
use zenav_space::BitGrid;

const STRAIGHT: u64 = 1_000_000;
const DIAGONAL: u64 = 1_414_214;

/// Length of the shortest path, cells.
pub fn length(free: &BitGrid, query: &Query) -> f64 {
    let [start, goal] = [query.start, query.goal].map(|point| (point.x as i32, point.y as i32));
    let (path, _) = astar(
        &start,
        |at| successors(free, *at),
        |at| octile(*at, goal),
        |at| *at == goal,
    )
    .unwrap();
    // The length is counted from the steps: a sum of rounded costs would not compare.
    let diagonal = |step: &[(i32, i32)]| step[0].0 != step[1].0 && step[0].1 != step[1].1;
    path.windows(2)
        .map(|step| if diagonal(step) { 2.0_f64.sqrt() } else { 1.0 })
        .sum()
}

fn octile(from: (i32, i32), to: (i32, i32)) -> u64 {
    let (dx, dy) = (u64::from(from.0.abs_diff(to.0)), u64::from(from.1.abs_diff(to.1)));
    STRAIGHT * dx.max(dy) + (DIAGONAL - STRAIGHT) * dx.min(dy)
}

fn successors(free: &BitGrid, (x, y): (i32, i32)) -> impl Iterator<Item = ((i32, i32), u64)> {
    let is_free = |x: i32, y: i32| x >= 0 && y >= 0 && free.get(Cell::new(x as u32, y as u32));
    let (east, west, north, south) = (
        is_free(x + 1, y),
        is_free(x - 1, y),
        is_free(x, y + 1),
        is_free(x, y - 1),
    );
    let straight = [
        (east, (x + 1, y)),
        (west, (x - 1, y)),
        (north, (x, y + 1)),
        (south, (x, y - 1)),
    ];
    let diagonal = [
        (north && east, (x + 1, y + 1)),
        (north && west, (x - 1, y + 1)),
        (south && east, (x + 1, y - 1)),
        (south && west, (x - 1, y - 1)),
    ]
    .map(|(open, to)| (open && is_free(to.0, to.1), to));
    let straight = straight.into_iter().map(|(open, to)| (open, to, STRAIGHT));
    let diagonal = diagonal.into_iter().map(|(open, to)| (open, to, DIAGONAL));
    let steps = straight.chain(diagonal).filter(|(open, _, _)| *open);
    steps.map(|(_, to, cost)| (to, cost))
}
