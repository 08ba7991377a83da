//! Replanning for one disc. Decides whether an earlier path is still good enough after the map has changed or the robot has moved on, and
//! repairs it if not.
//!
//! Each answer is kept with a lower bound on the cost of any path. At first it is the cost of the path itself. It stays valid while the
//! map changes, except for cells that became cheaper or free: a path through such a cell `c` costs at least the octile distance from the
//! start to `c` and on to the goal, and the bound drops to the least of these. A cell that became free also allows the diagonal steps
//! beside it, which are shorter than the two straight steps through it: by that much the bound drops farther. A cell without a neighbour
//! that the search had reached does not count: a path to it leaves the expanded cells through a cell that stayed open because no path
//! through it was cheaper. From a cell `s'` no path costs less than the bound minus the cost from the start to `s'`; along the path, that
//! is the cost of the part left behind.
//!
//! So an earlier path, or the rest of it, is as good as a new search while it costs no more than the bound; the check takes a comparison
//! of two bitmaps and a walk along the path. If the path is cut, a piece around the cut is searched for; the result is taken if the bound
//! proves it at most 2 % too expensive (`[planning.replanning]`). Everything else is searched for from scratch.
//!
//! These costs exist for paths over the grid. Paths of the other planners stay valid while nothing blocks them and no cell became free
//! through which they could have been shorter.
//!
//! The bounds are those of the estimates of Hart, Nilsson and Raphael, 1968; that a local repair is enough in most cases is the idea of
//! Stentz, "The Focussed D* Algorithm for Real-Time Replanning", IJCAI 1995.

use std::collections::VecDeque;

use nalgebra::Point2;
use zenav_protocol::grid::{Cell, GridSpec};
use zenav_protocol::messages::PlanOrigin;

use super::span::Span;
use crate::budget::Budget;
use crate::cell_cost::{Uniform, costs_along};
use crate::ends::End;
use crate::grid_graph::{DIAGONAL, GridPath, STRAIGHT, TooManyCells, UNREACHED, octile};
use crate::node_table::Written;
use crate::options::PlanOptions;
use crate::path::Path;
use crate::plan::{between, costs_of};
use crate::planners::Planner;
use crate::searcher::{NotFound, Searched, Searcher};
use zenav_space::{BitGrid, ConfigurationSpace, LineOfSight};

/// Number of answers that are kept.
const KEPT: usize = 16;
/// Largest distance of the robot from the path, cells.
const BESIDE: u32 = 6;
/// A diagonal step beside a cell is this much cheaper than the two straight steps through it.
const CUT_CORNER: u32 = 2 * STRAIGHT - DIAGONAL;

/// Paths for one disc on one changing map.
#[derive(Clone, Debug)]
pub(super) struct DiscReplanner {
    /// Runs the searches for what is not known.
    pub(super) searcher: Searcher,
    spec: GridSpec,
    pub(super) free: BitGrid,
    obstacles: BitGrid,
    pub(super) kept: VecDeque<Kept>,
}

/// An answer and its query.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    options: PlanOptions,
    /// The goal of the path, in cells.
    goal: Point2<f64>,
    pub(super) known: Known,
}

#[derive(Clone, Debug)]
pub(super) enum Known {
    /// A result of a search over the grid.
    Grid {
        /// The path, cell by cell; only the start if there is no path.
        cells: Vec<Cell>,
        /// No path from the first cell to the goal costs less; [`UNREACHED`] if there is no path.
        bound: u32,
        /// Nodes reached by the search; `None` if they were not recorded.
        reached: Option<Written>,
    },
    /// A path of a planner that is not bound to the grid.
    Free { path: Path },
}

impl DiscReplanner {
    /// Prepares a space: linear in its words.
    ///
    /// # Errors
    /// [`TooManyCells`].
    pub(super) fn new(space: &ConfigurationSpace) -> Result<Self, TooManyCells> {
        Ok(Self {
            searcher: Searcher::new(space.free())?,
            spec: *space.spec(),
            free: space.free().clone(),
            obstacles: space.obstacles().clone(),
            kept: VecDeque::new(),
        })
    }

    /// Updates to the present state of the space: the words that have changed, and the bounds of the answers.
    pub(super) fn follow(&mut self, space: &ConfigurationSpace) -> Result<(), TooManyCells> {
        if *space.spec() != self.spec {
            *self = Self::new(space)?;
            return Ok(());
        }
        let mut changed = Vec::new();
        for y in 0..self.spec.height {
            let is_new = self.free.row(y) != space.free().row(y) || self.obstacles.row(y) != space.obstacles().row(y);
            for word in (0..self.free.stride()).filter(|_| is_new) {
                let [before, after] = [&self.free, space.free()].map(|bits| bits.row(y)[word]);
                let [stood, stand] = [&self.obstacles, space.obstacles()].map(|bits| bits.row(y)[word]);
                if before != after {
                    changed.push((y, word));
                }
                self.ease(space, y, word, after & !before, stood & !stand);
            }
            if is_new {
                self.free.row_mut(y).copy_from_slice(space.free().row(y));
                self.obstacles.row_mut(y).copy_from_slice(space.obstacles().row(y));
            }
        }
        self.searcher.update(space.free(), &changed);
        Ok(())
    }

    /// Lowers the bounds of the answers for one word of a row: cells that became free, and obstacles that disappeared.
    fn ease(&mut self, space: &ConfigurationSpace, y: u32, word: usize, freed: u64, gone: u64) {
        if freed | gone == 0 {
            return;
        }
        let span = |bits: u64, margin: u32| {
            let first = word as u32 * 64;
            (bits != 0).then(|| Span {
                columns: [first + bits.trailing_zeros(), first + 63 - bits.leading_zeros()],
                row: y,
                margin,
            })
        };
        // Range of clearance costs around obstacles.
        let reach = space.field().reach_cells();
        let pitch = self.searcher.graph().pitch();
        self.kept.retain_mut(|kept| {
            let gone = if kept.options.planner.keeps_clear() { gone } else { 0 };
            let mut spans = [span(freed, 0), span(gone, reach)].into_iter().flatten();
            match &mut kept.known {
                Known::Grid { cells, bound, reached } => {
                    let goal = Cell::new(kept.goal.x as u32, kept.goal.y as u32);
                    for span in spans {
                        if reached.as_ref().is_none_or(|reached| span.touches(reached, pitch)) {
                            if *bound == UNREACHED {
                                // There was no path, and now there may be one.
                                return false;
                            }
                            let through = span.distance(cells[0]).saturating_add(span.distance(goal));
                            *bound = through.saturating_sub(CUT_CORNER).min(*bound);
                        }
                    }
                    true
                }
                Known::Free { path } => {
                    let start = path.corners.first().copied();
                    spans.all(|span| {
                        start.is_none_or(|start| span.length(start) + span.length(kept.goal) >= path.length)
                    })
                }
            }
        });
    }

    /// The path between two ends, and its origin.
    pub(super) fn find(
        &mut self,
        space: &ConfigurationSpace,
        first: End,
        last: End,
        options: &PlanOptions,
        budget: Budget<'_>,
    ) -> (Searched, PlanOrigin) {
        let goal = last.of(space, options.planner);
        let known = self
            .kept
            .iter()
            .position(|kept| kept.options == *options && kept.goal == goal);
        let mut expansions = 0;
        if let Some(mut kept) = known.and_then(|at| self.kept.remove(at)) {
            let stands = match &mut kept.known {
                Known::Grid { cells, bound, .. } => {
                    self.grid_path(space, first.cell, options, budget, (cells, bound), &mut expansions)
                }
                Known::Free { path } => rest(space, path, first.of(space, options.planner)).map(|rest| {
                    *path = rest.clone();
                    (Ok(rest), PlanOrigin::Reused)
                }),
            };
            if let Some((result, origin)) = stands {
                self.kept.push_front(kept);
                return (Searched { result, expansions }, origin);
            }
        }
        let mut searched = between(space, &mut self.searcher, first, last, options, budget);
        searched.expansions += expansions;
        if let Some(known) = self.known(space, first.cell, options, &searched.result) {
            self.kept.push_front(Kept {
                options: options.clone(),
                goal,
                known,
            });
            self.kept.truncate(KEPT);
        }
        (searched, PlanOrigin::Searched)
    }

    /// The part of a search's result that is kept.
    fn known(
        &self,
        space: &ConfigurationSpace,
        first: Cell,
        options: &PlanOptions,
        result: &Result<Path, NotFound>,
    ) -> Option<Known> {
        let reached = (options.planner == Planner::AStar).then(|| self.searcher.reached());
        let is_grid = options.planner.is_on_the_grid();
        match result {
            Ok(path) if is_grid => {
                let cells = cells_along(path);
                let costs = costs_along(self.searcher.graph(), &costs_of(space, options), &cells)?;
                let bound = *costs.last()?;
                Some(Known::Grid { cells, bound, reached })
            }
            Ok(path) => Some(Known::Free { path: path.clone() }),
            Err(NotFound::NoPath) if is_grid => Some(Known::Grid {
                cells: vec![first],
                bound: UNREACHED,
                reached,
            }),
            Err(_) => None,
        }
    }

    /// The known path, or the rest of it from `first` on, or a repaired one; `None` if it is not good enough.
    fn grid_path(
        &mut self,
        space: &ConfigurationSpace,
        first: Cell,
        options: &PlanOptions,
        budget: Budget<'_>,
        (cells, bound): (&mut Vec<Cell>, &mut u32),
        expansions: &mut u64,
    ) -> Option<(Result<Path, NotFound>, PlanOrigin)> {
        if *bound == UNREACHED {
            return (cells[0] == first).then_some((Err(NotFound::NoPath), PlanOrigin::Reused));
        }
        let settings = &options.settings.replanning;
        let costs = costs_of(space, options);
        let mut piece = |searcher: &mut Searcher, from: Cell, to: Cell| {
            let budget = Budget {
                max_expansions: budget.max_expansions.min(settings.max_expansions),
                ..budget
            };
            let searched = searcher.search_with(&costs, from, to, budget);
            *expansions += searched.expansions;
            searched.result.ok().map(|path| cells_along(&path))
        };
        // Connect to the robot's present position.
        let beside = |cell: &Cell| cell.x.abs_diff(first.x).max(cell.y.abs_diff(first.y));
        let (at, away) = (0..)
            .zip(cells.iter().map(beside))
            .min_by_key(|(at, away)| (*away, usize::MAX - at))?;
        let mut is_mended = false;
        if away > BESIDE {
            return None;
        }
        if away > 0 {
            let on = (at + settings.around).min(cells.len() - 1);
            let mut joined = piece(&mut self.searcher, first, cells[on])?;
            let back = costs_along(self.searcher.graph(), &costs, &joined)?;
            let left = costs_along(self.searcher.graph(), &costs, &cells[..=on])?;
            *bound = bound.saturating_sub(left[on]).saturating_sub(*back.last()?);
            *bound = octile(first, *cells.last()?).max(*bound);
            joined.extend_from_slice(&cells[on + 1..]);
            *cells = joined;
            is_mended = true;
        } else if at > 0 {
            let left = costs_along(self.searcher.graph(), &costs, &cells[..=at])?;
            *bound = bound.saturating_sub(left[at]);
            cells.drain(..at);
        }
        // Repair around the cells that are blocked now.
        if let Some([from, to]) = cut(&self.searcher, cells) {
            let [from, to] = [
                from.saturating_sub(settings.around),
                (to + settings.around).min(cells.len() - 1),
            ];
            let new = piece(&mut self.searcher, cells[from], cells[to])?;
            cells.splice(from..=to, new);
            is_mended = true;
        }
        let total = *costs_along(self.searcher.graph(), &costs, cells)?.last()?;
        let origin = match total.saturating_sub(*bound) {
            0 if !is_mended => PlanOrigin::Reused,
            more if f64::from(more) <= f64::from(*bound) * settings.slack => PlanOrigin::Repaired,
            _ => return None,
        };
        Some((Ok(GridPath::through(cells).into()), origin))
    }
}

/// Indices of the last cell before and the first cell after the part that is blocked now.
fn cut(searcher: &Searcher, cells: &[Cell]) -> Option<[usize; 2]> {
    let is_cut = |at: &usize| costs_along(searcher.graph(), &Uniform, &cells[*at..=at + 1]).is_none();
    let first = (0..cells.len() - 1).find(is_cut)?;
    let last = (0..cells.len() - 1).rev().find(is_cut)?;
    Some([first, last + 1])
}

/// The path from a point on it or close to it to its end, if nothing blocks it.
fn rest(space: &ConfigurationSpace, path: &Path, from: Point2<f64>) -> Option<Path> {
    let near = |leg: &[Point2<f64>]| {
        let (along, to) = (leg[1] - leg[0], from - leg[0]);
        let share = (to.dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        (to - along * share).norm() <= 1.0
    };
    let leg = path.corners.windows(2).rposition(near)?;
    let mut corners = vec![from];
    corners.extend_from_slice(&path.corners[leg + 1..]);
    let is_clear = corners.windows(2).all(|leg| space.sees(leg[0], leg[1]));
    is_clear.then(|| Path::through(corners))
}

/// Every cell of a path over the grid.
pub(super) fn cells_along(path: &Path) -> Vec<Cell> {
    let corners: Vec<Cell> = path.corners.iter().map(|p| Cell::new(p.x as u32, p.y as u32)).collect();
    let mut cells: Vec<Cell> = corners.first().copied().into_iter().collect();
    for leg in corners.windows(2) {
        let toward = |from: u32, to: u32| to.cmp(&from) as i32;
        let (x, y) = (toward(leg[0].x, leg[1].x), toward(leg[0].y, leg[1].y));
        let mut at = leg[0];
        for _ in 0..leg[0].x.abs_diff(leg[1].x).max(leg[0].y.abs_diff(leg[1].y)) {
            at = Cell::new(at.x.wrapping_add_signed(x), at.y.wrapping_add_signed(y));
            cells.push(at);
        }
    }
    cells
}
