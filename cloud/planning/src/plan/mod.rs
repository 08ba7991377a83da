//! Path planning for a robot. A path from start to goal that the true footprint can drive.
//!
//! See [`plan`] for the order in which searches are tried.

mod straight_out;
#[cfg(test)]
mod tests;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::Cell;
use zenav_protocol::messages::{PlanOrigin, PlanOutcome};
use zenav_protocol::robot::Footprint;
use zenav_space::{ConfigurationSpace, DistanceCost};

use super::budget::Budget;
use super::cell_cost::clearance_cost;
use super::circumscribed_search;
use super::ends::{End, cell_beside, leaving};
use super::options::PlanOptions;
use super::path::length;
use super::se2_search;
use super::searcher::{NotFound, Query, Searched, Searcher};
use straight_out::straight_out;

/// Points closer together than this are one, m.
const ROUNDING: f64 = 1e-9;
/// Search range for the nearest place where the footprint fits, around a goal where it does not, m.
const BESIDE_GOAL: f64 = 0.5;

/// Model of the footprint in the search that found a path.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_planning::{Budget, FootprintSearch, PlanOptions, Planner, Searcher, plan};
/// # use zenav_protocol::geometry::Pose2;
/// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::Footprint;
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 80 };
/// # let mut map = Grid::filled(spec, Occupancy::FREE);
/// # (0..60).for_each(|y| map[Cell::new(50, y)] = Occupancy::OCCUPIED);
/// // A room of 5 m by 4 m; a wall leaves 1 m at its upper end, wide enough to turn in.
/// let found_by = |footprint| {
///     let space = ConfigurationSpace::new(&map, &footprint, UnknownPolicy::Blocked, 0.0);
///     let mut searcher = Searcher::new(space.free()).unwrap();
///     let [start, goal] = [1.0, 4.0].map(|x| Pose2::new(x, 1.0, 0.0));
///     plan(&space, &mut searcher, start, goal, &PlanOptions::new(Planner::Jps), Budget::UNLIMITED).found_by
/// };
/// let corners = [(-0.4, -0.15), (0.4, -0.15), (0.4, 0.15), (-0.4, 0.15)];
/// let long = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
/// assert_eq!(found_by(long), Some(FootprintSearch::Circumscribed));
/// assert_eq!(found_by(Footprint::Radius(0.25)), Some(FootprintSearch::Inscribed));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FootprintSearch {
    /// The circumscribed disc: the robot may turn anywhere on the path.
    Circumscribed,
    /// A disc halfway between the circumscribed and the inscribed one.
    Intermediate,
    /// The inscribed disc. For a round robot this is the robot itself.
    Inscribed,
    /// The footprint itself, by a search over positions and headings.
    Se2,
}

/// A plan and its effort.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// The path, or why there is none.
    pub outcome: PlanOutcome,
    /// Legs of the path that are driven backwards, by the index of the corner where they begin, ascending. Smoothing has to know them: a
    /// path is free for a long footprint only if each leg is driven in its own direction.
    pub backwards: Vec<usize>,
    /// Which search found the path; `None` without a path.
    pub found_by: Option<FootprintSearch>,
    /// Whether the path begins with a leg out of an obstacle of the map ([`PlanOptions::escape`]).
    pub escapes: bool,
    /// Nodes expanded and samples drawn, by all searches together.
    pub expansions: u64,
    /// Whether the path was searched for or is an earlier one ([`Replanner`](super::Replanner)).
    pub origin: PlanOrigin,
}

impl Planned {
    fn without_search(outcome: PlanOutcome) -> Self {
        Self {
            outcome,
            backwards: Vec::new(),
            found_by: None,
            escapes: false,
            expansions: 0,
            origin: PlanOrigin::Searched,
        }
    }
}

/// A path that the robot can drive from one pose to another. `searcher` was made from `space.free()`.
///
/// The path leads from the exact start to the exact goal (m, map frame), and the footprint can drive it: straight legs, and turns on the
/// spot at the corners, the first one from the start's heading (ignored with [`PlanOptions::any_heading`]). A path of the SE(2) search
/// may have legs driven backwards ([`Planned::backwards`]). The goal's heading is ignored. A robot that stands slightly inside its
/// footprint's margin leaves through the nearest free cell. A start in an obstacle is refused unless [`PlanOptions::escape`] lets the
/// robot leave it: straight ahead or back if its footprint is not a disc, else to the nearest free place. A goal where the robot does not
/// fit is refused unless it is within [`PlanOptions::goal_tolerance`] of a free place; the path then ends there. A path of the SE(2) search
/// may also end that close to a goal without room to turn.
///
/// A round robot takes one search. For a polygon the searches are tried in a fixed order until one gives a path that the footprint can
/// drive; [`Planned::found_by`] names that search.
///
/// | planner | 1 | 2 | 3 | 4 |
/// |---|---|---|---|---|
/// | keeps clear of obstacles ([`Planner::keeps_clear`](super::Planner::keeps_clear)) | inscribed disc | A* for the circumscribed disc, if at most 10 % longer than 1 | SE(2) search | |
/// | any other: its paths pass obstacles as close as possible | circumscribed disc | disc halfway | inscribed disc | SE(2) search |
///
/// The budget applies to each search, not to their sum. A search that exhausts it ends the plan with [`PlanOutcome::TimedOut`].
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_planning::{Budget, PlanOptions, Searcher, plan};
/// # use zenav_protocol::geometry::Pose2;
/// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
/// # use zenav_protocol::messages::PlanOutcome;
/// # use zenav_protocol::robot::Footprint;
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 80 };
/// # let mut map = Grid::filled(spec, Occupancy::FREE);
/// // A room of 5 m by 4 m; a wall at x = 2.5 m ends at y = 3 m.
/// (0..60).for_each(|y| map[Cell::new(50, y)] = Occupancy::OCCUPIED);
/// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
/// let mut searcher = Searcher::new(space.free())?;
/// let mut ask = |x| {
///     let (start, goal) = (Pose2::new(1.0, 1.0, 0.0), Pose2::new(x, 1.0, 0.0));
///     plan(&space, &mut searcher, start, goal, &PlanOptions::default(), Budget::UNLIMITED).outcome
/// };
/// assert!(matches!(ask(4.0), PlanOutcome::Found { length, .. } if length > 5.0));
/// assert!(matches!(ask(2.5), PlanOutcome::GoalOccupied { nearest_free: Some(_) }));
/// assert_eq!(ask(9.0), PlanOutcome::OutOfMap);
/// # Ok::<(), zenav_planning::TooManyCells>(())
/// ```
pub fn plan(
    space: &ConfigurationSpace,
    searcher: &mut Searcher,
    start: Pose2,
    goal: Pose2,
    options: &PlanOptions,
    budget: Budget<'_>,
) -> Planned {
    let mut find = |by: FootprintSearch, disc: &ConfigurationSpace, first: End, last: End| {
        let searched = if by == FootprintSearch::Inscribed {
            between(disc, searcher, first, last, options, budget)
        } else {
            match Searcher::new(disc.free()) {
                Ok(mut searcher) => between(disc, &mut searcher, first, last, options, budget),
                Err(_) => Searched::failed(NotFound::OutOfMap),
            }
        };
        (searched, PlanOrigin::Searched)
    };
    answer(space, start, goal, options, budget, &mut find)
}

/// Finds a path between two ends for a disc, in the space made for it.
pub(super) type Find<'a> = dyn FnMut(FootprintSearch, &ConfigurationSpace, End, End) -> (Searched, PlanOrigin) + 'a;

/// A path between two poses; `find` runs the searches for discs.
pub(super) fn answer(
    space: &ConfigurationSpace,
    start: Pose2,
    goal: Pose2,
    options: &PlanOptions,
    budget: Budget<'_>,
    find: &mut Find<'_>,
) -> Planned {
    let straight = (!options.any_heading)
        .then(|| straight_out(space, start, options.escape))
        .flatten();
    let mut ask = Ask {
        space,
        options,
        budget,
        find,
    };
    let Some(out) = straight else {
        return ask.starting_at(start, start, goal);
    };
    let planned = ask.starting_at(start, Pose2::new(out.x, out.y, start.yaw), goal);
    if matches!(planned.outcome, PlanOutcome::Found { .. }) {
        return planned;
    }
    let before = planned.expansions;
    let mut planned = ask.starting_at(start, start, goal);
    planned.expansions += before;
    planned
}

/// What is the same for all searches of a plan.
struct Ask<'a, 'f> {
    space: &'a ConfigurationSpace,
    options: &'a PlanOptions,
    budget: Budget<'a>,
    find: &'a mut Find<'f>,
}

impl Ask<'_, '_> {
    /// A path whose search begins at `first`, which the robot reaches from `start` by a straight leg.
    fn starting_at(&mut self, start: Pose2, mut first: Pose2, goal: Pose2) -> Planned {
        let options = self.options;
        let mut last = goal;
        let mut planned = self.drivable(first, last, options.goal_tolerance);
        // Each end may be moved once.
        for _ in 0..2 {
            match planned.outcome {
                PlanOutcome::StartOccupied {
                    nearest_free: Some(free),
                } if first == start && (free - start.position()).norm() <= options.escape => {
                    first = Pose2::new(free.x, free.y, start.yaw);
                }
                PlanOutcome::GoalOccupied {
                    nearest_free: Some(free),
                } if last == goal && (free - goal.position()).norm() <= options.goal_tolerance => {
                    last = Pose2::new(free.x, free.y, goal.yaw);
                }
                _ => break,
            }
            let before = planned.expansions;
            // The distance by which the goal was moved is used up.
            let tolerance = options.goal_tolerance - last.distance(&goal);
            planned = self.drivable(first, last, tolerance);
            planned.expansions += before;
        }
        planned.escapes = first != start;
        if planned.escapes
            && let PlanOutcome::Found { path, length } = &mut planned.outcome
        {
            path.insert(0, start.position());
            *length += first.distance(&start);
            planned.backwards.iter_mut().for_each(|leg| *leg += 1);
            let turns_anywhere = matches!(self.space.footprint(), Footprint::Radius(_));
            if !turns_anywhere && (first.position() - start.position()).dot(&start.heading()) < 0.0 {
                planned.backwards.insert(0, 0);
            }
        }
        planned
    }

    /// The searches of [`plan`] in their order; if the goal has no room to turn, the SE(2) search may end within `tolerance` metres of it.
    fn drivable(&mut self, start: Pose2, goal: Pose2, tolerance: f64) -> Planned {
        let (space, options) = (self.space, self.options);
        let query = se2_search::Query {
            start: start.position(),
            heading: (!options.any_heading).then_some(start.yaw),
            goal: goal.position(),
            tolerance,
        };
        let footprint = space.footprint();
        if matches!(footprint, Footprint::Radius(_)) {
            return self.for_disc(space, FootprintSearch::Inscribed, &query);
        }
        let mut expansions = 0;
        if !options.planner.keeps_clear() {
            let (inner, outer) = (footprint.inscribed_radius(), footprint.circumscribed_radius());
            let discs = [
                (FootprintSearch::Circumscribed, outer),
                (FootprintSearch::Intermediate, 0.5 * (inner + outer)),
            ];
            for (by, radius) in discs {
                let mut planned = self.for_disc(&space.for_disc(radius), by, &query);
                planned.expansions += expansions;
                if is_final(space, &planned.outcome, &query) {
                    return planned;
                }
                expansions = planned.expansions;
            }
        }
        let mut planned = self.for_disc(space, FootprintSearch::Inscribed, &query);
        planned.expansions += expansions;
        if !is_final(space, &planned.outcome, &query) {
            self.fit_footprint(&query, &mut planned);
        }
        planned
    }

    /// Replaces a path that only the inscribed disc can drive by one that the footprint can drive, if there is one.
    fn fit_footprint(&self, query: &se2_search::Query, planned: &mut Planned) {
        let (space, options) = (self.space, self.options);
        if !se2_search::can_stand(space, query.start, query.heading) {
            return;
        }
        if !se2_search::can_stand(space, query.goal, None) {
            if let PlanOutcome::Found { .. } | PlanOutcome::GoalOccupied { .. } = planned.outcome {
                let nearest_free = nearest_standing(space, query.goal);
                planned.outcome = PlanOutcome::GoalOccupied { nearest_free };
                planned.found_by = None;
            }
            return;
        }
        let costs = costs_of(space, options);
        if let PlanOutcome::Found { length, .. } = planned.outcome
            && options.planner.keeps_clear()
        {
            let searched = circumscribed_search::search(space, &costs, query, self.budget);
            planned.expansions += searched.expansions;
            if let Ok(path) = searched.result
                && let outcome @ PlanOutcome::Found { length: longer, .. } = found(path)
                && longer <= length * options.settings.se2.detour
            {
                (planned.outcome, planned.origin) = (outcome, PlanOrigin::Searched);
                planned.found_by = Some(FootprintSearch::Circumscribed);
                return;
            }
        }
        let searched = se2_search::search(space, &costs, query, &options.settings.se2, self.budget);
        planned.expansions += searched.expansions;
        planned.origin = PlanOrigin::Searched;
        planned.found_by = searched.result.is_ok().then_some(FootprintSearch::Se2);
        match (searched.result, &planned.outcome) {
            (Ok(path), _) => {
                planned.outcome = found(path.corners);
                planned.backwards = path.backwards;
            }
            (Err(NotFound::TimedOut | NotFound::TooLong), _) => planned.outcome = PlanOutcome::TimedOut,
            (Err(_), PlanOutcome::Found { .. }) => planned.outcome = PlanOutcome::NoPath,
            (Err(_), _) => {}
        }
    }

    /// A path for the disc that `space` is made for.
    fn for_disc(&mut self, space: &ConfigurationSpace, by: FootprintSearch, query: &se2_search::Query) -> Planned {
        let (start, goal) = (query.start, query.goal);
        if space.spec().cell_at(start).is_none() || space.spec().cell_at(goal).is_none() {
            return Planned::without_search(PlanOutcome::OutOfMap);
        }
        let Some(first) = leaving(space, start, &self.options.settings.leaving) else {
            let nearest_free = space.nearest_free(start);
            return Planned::without_search(PlanOutcome::StartOccupied { nearest_free });
        };
        let Some(last) = cell_beside(space, goal, space.radius()) else {
            let nearest_free = space.nearest_free(goal);
            return Planned::without_search(PlanOutcome::GoalOccupied { nearest_free });
        };
        if start == goal {
            return Planned {
                found_by: Some(by),
                ..Planned::without_search(found(vec![start, goal]))
            };
        }
        let end = |point, cell| End {
            point: space.spec().to_cells(point),
            cell,
        };
        let (searched, origin) = (self.find)(by, space, end(start, first), end(goal, last));
        let found_by = searched.result.is_ok().then_some(by);
        let outcome = match searched.result {
            Ok(path) => {
                let corners = path.corners.iter().map(|corner| space.spec().from_cells(*corner));
                let mut path = vec![start];
                // The search returns its ends rounded.
                path.extend(
                    corners.filter(|corner| (corner - start).norm() > ROUNDING && (corner - goal).norm() > ROUNDING),
                );
                path.push(goal);
                found(path)
            }
            Err(NotFound::TimedOut | NotFound::TooLong) => PlanOutcome::TimedOut,
            // Both ends are free, as checked above; the last three occur only if the searcher belongs to another map.
            Err(NotFound::NoPath | NotFound::OutOfMap | NotFound::StartBlocked | NotFound::GoalBlocked) => {
                PlanOutcome::NoPath
            }
        };
        Planned {
            outcome,
            backwards: Vec::new(),
            found_by,
            escapes: false,
            expansions: searched.expansions,
            origin,
        }
    }
}

/// Whether no other search can improve on this outcome of a search for a disc.
fn is_final(space: &ConfigurationSpace, outcome: &PlanOutcome, query: &se2_search::Query) -> bool {
    match outcome {
        // A robot that, by the map, does not fit at its start leaves along the disc's path.
        PlanOutcome::Found { path, .. } => {
            se2_search::is_drivable(space, path, &[], query.heading)
                || !se2_search::can_stand(space, query.start, query.heading)
        }
        PlanOutcome::NoPath | PlanOutcome::StartOccupied { .. } | PlanOutcome::GoalOccupied { .. } => false,
        PlanOutcome::OutOfMap | PlanOutcome::TimedOut | PlanOutcome::NoMap => true,
    }
}

/// The centre of the nearest cell, at most [`BESIDE_GOAL`] away, where the footprint fits with some heading.
fn nearest_standing(space: &ConfigurationSpace, place: Point2<f64>) -> Option<Point2<f64>> {
    let spec = space.spec();
    let home = spec.cell_at(place)?;
    let reach = (BESIDE_GOAL / spec.resolution).ceil().clamp(1.0, 64.0) as i64;
    let around = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)));
    let mut free: Vec<(f64, Point2<f64>)> = around
        .map(|(dx, dy)| (i64::from(home.x) + dx, i64::from(home.y) + dy))
        .filter(|(x, y)| spec.contains(*x, *y))
        .map(|(x, y)| Cell::new(x as u32, y as u32))
        .filter(|cell| space.is_free(*cell))
        .map(|cell| ((spec.center(cell) - place).norm(), spec.center(cell)))
        .collect();
    free.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut places = free.into_iter().map(|(_, place)| place);
    places.find(|place| se2_search::can_stand(space, *place, None))
}

fn found(path: Vec<Point2<f64>>) -> PlanOutcome {
    let length = length(&path);
    PlanOutcome::Found { path, length }
}

/// Runs the planner of the options between two ends.
pub(super) fn between(
    space: &ConfigurationSpace,
    searcher: &mut Searcher,
    first: End,
    last: End,
    options: &PlanOptions,
    budget: Budget<'_>,
) -> Searched {
    if let Some(costs) = costs_of(space, options) {
        return searcher.search_with(&costs, first.cell, last.cell, budget);
    }
    let [start, goal] = [first, last].map(|end| end.of(space, options.planner));
    let seed = options.seed;
    searcher.sampling.clone_from(&options.settings.sampling);
    searcher.search(options.planner, space, &Query { start, goal, seed }, budget)
}

/// Clearance costs, for a planner that takes them into account.
pub(super) fn costs_of<'a>(space: &'a ConfigurationSpace, options: &PlanOptions) -> Option<DistanceCost<'a>> {
    options
        .planner
        .keeps_clear()
        .then(|| clearance_cost(space, &options.settings.clearance))?
}
