//! What is a short way in any direction? Lazy Theta*: from cell centre to cell centre, as far as one sees.
//!
//! As A*, but a cell's parent may be any cell that it is seen from. That a cell is seen is assumed until it is its turn: one look an
//! expansion. Where it is not seen, the best of its neighbours that had their turn takes over; and where that makes its way longer, it has
//! to wait for its new turn. At the end the corners are moved to where the way is taut.
//!
//! Sources: Nash, Koenig and Tovey, "Lazy Theta*: Any-Angle Path Planning and Path Length Analysis in 3D", AAAI 2010; Daniel, Nash,
//! Koenig and Felner, "Theta*: Any-Angle Path Planning on Grids", JAIR 2010.

use nalgebra::Point2;
use zenav_protocol::grid::Cell;

use super::astar::{NotFound, ends};
use super::budget::Budget;
use super::lattice::{Lattice, STEPS, STRAIGHT};
use super::open::{Open, OpenList, is_past};
use super::records::Records;
use super::searcher::{Query, Searched};
use super::taut::tighten;
use super::way::Way;
use crate::space::Sight;

/// Working memory, kept from one search to the next.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    reached: Records<Reached>,
    open: OpenList,
}

/// What is known of a cell; nothing at first. Ways longer than about 374,000 cells are not told from none.
#[derive(Clone, Copy, Debug, Default)]
struct Reached {
    /// Length of the best way to it, turned over so that 0 stands for none; the lowest bit tells that it had its turn.
    mark: u32,
    /// Node that it is seen from, or so it is assumed.
    parent: u32,
}

impl Reached {
    fn new(cost: u32, parent: u32) -> Self {
        Self {
            mark: !(cost << 1) & !1,
            parent,
        }
    }

    fn cost(self) -> u32 {
        !self.mark >> 1
    }

    fn had_its_turn(self) -> bool {
        self.mark & 1 == 1
    }

    fn with_its_turn(self) -> Self {
        Self {
            mark: self.mark | 1,
            ..self
        }
    }
}

/// A short way between two points; `sight` is the space that the lattice's free cells belong to. Deterministic.
pub fn search(
    lattice: &Lattice,
    sight: &impl Sight,
    query: &Query,
    memory: &mut Memory,
    budget: Budget<'_>,
) -> Searched {
    let mut expansions = 0;
    let result = expand(lattice, sight, query, memory, budget, &mut expansions);
    Searched { result, expansions }
}

fn expand(
    lattice: &Lattice,
    sight: &impl Sight,
    query: &Query,
    memory: &mut Memory,
    budget: Budget<'_>,
    expansions: &mut u64,
) -> Result<Way, NotFound> {
    let (start, goal) = query.cells().ok_or(NotFound::OutOfMap)?;
    let (start_node, goal_node) = ends(lattice, start, goal)?;
    if !sight.sees(query.start, center(start)) {
        return Err(NotFound::StartBlocked);
    }
    if !sight.sees(center(goal), query.goal) {
        return Err(NotFound::GoalBlocked);
    }
    if sight.sees(query.start, query.goal) {
        return Ok(Way::through(vec![query.start, query.goal]));
    }
    memory.reached.clear(lattice.len());
    memory.open.clear(distance(start, goal));
    memory.reached.set(start_node, Reached::new(0, start_node));
    memory.open.push(Open {
        estimate: distance(start, goal),
        name: start_node,
    });
    while let Some(Open { estimate, name: node }) = memory.open.pop() {
        let mut here = memory.reached.get(node);
        if here.had_its_turn() {
            continue;
        }
        if budget.is_spent(*expansions) {
            return Err(NotFound::TimedOut);
        }
        let cell = lattice.cell(node);
        let mut parent = lattice.cell(here.parent);
        if !sight.sees(center(parent), center(cell)) {
            here = beside(lattice, memory, node);
            memory.reached.set(node, here);
            let true_estimate = here.cost() + distance(cell, goal);
            if is_past(true_estimate, estimate) {
                memory.open.push(Open {
                    estimate: true_estimate,
                    name: node,
                });
                continue;
            }
            parent = lattice.cell(here.parent);
        }
        memory.reached.set(node, here.with_its_turn());
        if node == goal_node {
            return Ok(way(lattice, memory, sight, query, goal_node));
        }
        *expansions += 1;
        let base = memory.reached.get(here.parent).cost();
        let mut steps = lattice.steps(node);
        while steps != 0 {
            let step = STEPS[steps.trailing_zeros() as usize];
            steps &= steps - 1;
            let next = lattice.beside(node, step);
            let known = memory.reached.get(next);
            if known.had_its_turn() {
                continue;
            }
            let to = Cell::new(cell.x.wrapping_add_signed(step.x), cell.y.wrapping_add_signed(step.y));
            let cost = base + distance(parent, to);
            if cost < known.cost() {
                memory.reached.set(next, Reached::new(cost, here.parent));
                memory.open.push(Open {
                    estimate: cost + distance(to, goal),
                    name: next,
                });
            }
        }
    }
    Err(NotFound::NoPath)
}

/// The best way to a cell over one of its neighbours that had their turn; the cell's own parent is not seen.
fn beside(lattice: &Lattice, memory: &Memory, node: u32) -> Reached {
    let mut best = Reached::default();
    let mut steps = lattice.steps(node);
    while steps != 0 {
        let step = STEPS[steps.trailing_zeros() as usize];
        steps &= steps - 1;
        let neighbour = lattice.beside(node, step);
        let known = memory.reached.get(neighbour);
        if known.had_its_turn() && known.cost() + step.cost < best.cost() {
            best = Reached::new(known.cost() + step.cost, neighbour);
        }
    }
    best
}

fn way(lattice: &Lattice, memory: &Memory, sight: &impl Sight, query: &Query, goal_node: u32) -> Way {
    let mut corners = vec![query.goal];
    let mut node = goal_node;
    loop {
        corners.push(center(lattice.cell(node)));
        let parent = memory.reached.get(node).parent;
        if parent == node {
            break;
        }
        node = parent;
    }
    corners.push(query.start);
    corners.reverse();
    corners.dedup();
    tighten(sight, &mut corners);
    Way::through(corners)
}

fn center(cell: Cell) -> Point2<f64> {
    Point2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5)
}

/// Straight distance, in parts of a step along an axis like the lattice's costs.
fn distance(from: Cell, to: Cell) -> u32 {
    let (dx, dy) = (f64::from(from.x) - f64::from(to.x), f64::from(from.y) - f64::from(to.y));
    ((dx * dx + dy * dy).sqrt() * f64::from(STRAIGHT) + 0.5) as u32
}
