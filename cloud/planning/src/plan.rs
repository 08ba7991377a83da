//! Is there a way for this robot from here to there? Where a search starts and ends, and what its answer means.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::Cell;
use zenav_protocol::messages::{PlanOrigin, PlanOutcome};
use zenav_protocol::robot::Footprint;

use super::astar::{NotFound, PARTS};
use super::budget::Budget;
use super::circumscribed_search;
use super::planner::PlanOptions;
use super::se2_search;
use super::searcher::{Query, Searched, Searcher};
use zenav_space::{ConfigurationSpace, DistanceCost, LineOfSight as _};

/// An answer, and what it took.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// The answer.
    pub outcome: PlanOutcome,
    /// Nodes expanded.
    pub expansions: u64,
    /// How it came about.
    pub origin: PlanOrigin,
}

/// A way for the robot from one pose to another. `searcher` was made from `space.free()`.
///
/// The way leads from the exact start to the exact goal: over cell centres where the planner's search is on a grid, straight from the ends
/// where it grows trees. The true footprint can drive it as it stands: legs straight, turns on the spot at the corners, the first one from
/// the start's heading. A robot that stands a little inside the margin that its footprint asks for leaves by the nearest free cell; it is
/// refused only where it stands in an obstacle.
pub fn plan(
    space: &ConfigurationSpace,
    searcher: &mut Searcher,
    start: Pose2,
    goal: Pose2,
    options: &PlanOptions,
    budget: Budget<'_>,
) -> Planned {
    answer(space, start, goal, options, budget, |first, last| {
        let searched = between(space, searcher, first, last, options, budget);
        (searched, PlanOrigin::Searched)
    })
}

/// A way between two poses, where `find` gives one between two ends on the grid.
///
/// That one is for the inscribed disc; where the true footprint cannot drive it, one that it can drive takes its place.
pub(super) fn answer(
    space: &ConfigurationSpace,
    start: Pose2,
    goal: Pose2,
    options: &PlanOptions,
    budget: Budget<'_>,
    find: impl FnOnce(End, End) -> (Searched, PlanOrigin),
) -> Planned {
    let (from, to) = (start.position(), goal.position());
    let mut planned = for_disc(space, from, to, find);
    if matches!(space.footprint(), Footprint::Polygon(_)) {
        let heading = (!options.any_heading).then_some(start.yaw);
        let query = se2_search::Query {
            start: from,
            heading,
            goal: to,
        };
        fit_footprint(space, &query, options, budget, &mut planned);
    }
    planned
}

/// Puts a way that the true footprint can drive, if there is one, in place of one that only the inscribed disc can.
fn fit_footprint(
    space: &ConfigurationSpace,
    query: &se2_search::Query,
    options: &PlanOptions,
    budget: Budget<'_>,
    planned: &mut Planned,
) {
    let is_fine = match &planned.outcome {
        PlanOutcome::Found { path, .. } => se2_search::is_drivable(space, path, query.heading),
        PlanOutcome::NoPath | PlanOutcome::StartOccupied { .. } | PlanOutcome::GoalOccupied { .. } => false,
        _ => true,
    };
    // A robot that stands where it does not fit by the map leaves by the disc's way, as far as it gets.
    if is_fine
        || !se2_search::can_stand(space, query.start, query.heading)
        || !se2_search::can_stand(space, query.goal, None)
    {
        return;
    }
    let costs = comfort(space, options);
    if let PlanOutcome::Found { length, .. } = planned.outcome {
        let roomy = circumscribed_search::search(space, &costs, query, budget);
        planned.expansions += roomy.expansions;
        if let Ok(path) = roomy.result
            && let outcome @ PlanOutcome::Found { length: longer, .. } = found(path)
            && longer <= length * DETOUR
        {
            (planned.outcome, planned.origin) = (outcome, PlanOrigin::Searched);
            return;
        }
    }
    let searched = se2_search::search(space, &costs, query, budget);
    planned.expansions += searched.expansions;
    planned.origin = PlanOrigin::Searched;
    match (searched.result, &planned.outcome) {
        (Ok(path), _) => planned.outcome = found(path),
        (Err(NotFound::TimedOut), _) => planned.outcome = PlanOutcome::TimedOut,
        (Err(_), PlanOutcome::Found { .. }) => planned.outcome = PlanOutcome::NoPath,
        (Err(_), _) => {}
    }
}

/// So many times longer than the inscribed disc's way, a way with room to turn is as good as any.
const DETOUR: f64 = 1.1;

fn found(path: Vec<Point2<f64>>) -> PlanOutcome {
    let length = path.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    PlanOutcome::Found { path, length }
}

/// A way for the inscribed disc.
fn for_disc(
    space: &ConfigurationSpace,
    start: Point2<f64>,
    goal: Point2<f64>,
    find: impl FnOnce(End, End) -> (Searched, PlanOrigin),
) -> Planned {
    let without_search = |outcome| Planned {
        outcome,
        expansions: 0,
        origin: PlanOrigin::Searched,
    };
    if space.spec().cell_at(start).is_none() || space.spec().cell_at(goal).is_none() {
        return without_search(PlanOutcome::OutOfMap);
    }
    let Some(first) = leaving(space, start) else {
        let nearest_free = space.nearest_free(start);
        return without_search(PlanOutcome::StartOccupied { nearest_free });
    };
    let Some(last) = cell_beside(space, goal, space.radius()) else {
        let nearest_free = space.nearest_free(goal);
        return without_search(PlanOutcome::GoalOccupied { nearest_free });
    };
    if start == goal {
        let path = vec![start, goal];
        return without_search(PlanOutcome::Found { path, length: 0.0 });
    }
    let end = |point, cell| End {
        point: space.spec().to_cells(point),
        cell,
    };
    let (searched, origin) = find(end(start, first), end(goal, last));
    let outcome = match searched.result {
        Ok(found) => {
            let corners = found.corners.iter().map(|corner| space.spec().from_cells(*corner));
            let mut path = vec![start];
            // Ends that were searched from come back rounded.
            path.extend(
                corners.filter(|corner| (corner - start).norm() > ROUNDING && (corner - goal).norm() > ROUNDING),
            );
            path.push(goal);
            self::found(path)
        }
        Err(NotFound::TimedOut) => PlanOutcome::TimedOut,
        // Both ends were found free above; a searcher of another map says so by the last three.
        Err(NotFound::NoPath | NotFound::OutOfMap | NotFound::StartBlocked | NotFound::GoalBlocked) => {
            PlanOutcome::NoPath
        }
    };
    Planned {
        outcome,
        expansions: searched.expansions,
        origin,
    }
}

/// Points closer together than this are one, m.
const ROUNDING: f64 = 1e-9;

/// Where a search begins or ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct End {
    /// Exactly, in cells.
    pub(super) point: Point2<f64>,
    /// The free cell at or close to it.
    pub(super) cell: Cell,
}

impl End {
    /// Where a planner starts from: the point itself where the planner is not bound to cells and the robot fits there.
    pub(super) fn of(&self, space: &ConfigurationSpace, options: &PlanOptions) -> Point2<f64> {
        if options.planner.grows_trees() && space.admits(self.point) {
            self.point
        } else {
            center(self.cell)
        }
    }
}

/// A way between two ends, as the options ask for it.
pub(super) fn between(
    space: &ConfigurationSpace,
    searcher: &mut Searcher,
    first: End,
    last: End,
    options: &PlanOptions,
    budget: Budget<'_>,
) -> Searched {
    if let Some(costs) = comfort(space, options) {
        return searcher.search_with(&costs, first.cell, last.cell, budget);
    }
    let [start, goal] = [first, last].map(|end| end.of(space, options));
    let seed = options.seed;
    searcher.search(options.planner, space, &Query { start, goal, seed }, budget)
}

/// A cell's centre, in cells.
fn center(cell: Cell) -> Point2<f64> {
    Point2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5)
}

/// Cells looked at around a point that is not at a free cell's centre, in each direction.
const NEARBY: i64 = 3;

/// The free cell nearest to a point from whose centre a disc of `radius` goes straight to the point; none further than a few cells away.
fn cell_beside(space: &ConfigurationSpace, point: Point2<f64>, radius: f64) -> Option<Cell> {
    nearest_reachable(space, point, radius, NEARBY)
}

/// The free cell that a robot leaves by, which may stand closer to obstacles than it would be led.
fn leaving(space: &ConfigurationSpace, start: Point2<f64>) -> Option<Cell> {
    let radius = space.radius();
    if let Some(cell) = cell_beside(space, start, radius) {
        return Some(cell);
    }
    // A map is no truer than its cells: an obstacle may reach that far into the robot without the robot having touched it.
    let clearance = space.clearance(start);
    let tolerance = TOUCHING_CELLS * space.spec().resolution;
    if clearance < space.footprint().inscribed_radius() - tolerance {
        return None;
    }
    let cells = (LEAVING / space.spec().resolution).ceil().clamp(1.0, 64.0) as i64;
    nearest_reachable(space, start, radius.min(clearance * (1.0 - 1e-9) - 1e-9), cells)
}

/// How deep an obstacle may reach into a standing robot, cells.
const TOUCHING_CELLS: f64 = 1.5;
/// How far such a robot may go for a free place, m.
const LEAVING: f64 = 0.6;

fn nearest_reachable(space: &ConfigurationSpace, point: Point2<f64>, radius: f64, cells: i64) -> Option<Cell> {
    let spec = space.spec();
    let home = spec.cell_at(point)?;
    let mut around: Vec<(f64, Cell)> = Vec::new();
    for dy in -cells..=cells {
        for dx in -cells..=cells {
            let (x, y) = (i64::from(home.x) + dx, i64::from(home.y) + dy);
            if spec.contains(x, y) && space.is_free(Cell::new(x as u32, y as u32)) {
                let cell = Cell::new(x as u32, y as u32);
                around.push(((spec.center(cell) - point).norm_squared(), cell));
            }
        }
    }
    around.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    around
        .into_iter()
        .map(|(_, cell)| cell)
        .find(|cell| space.segment_is_free(point, spec.center(*cell), radius))
}

/// What it costs to be near obstacles, where the options ask for it: a share that falls with the square of the room that is wanted.
pub(super) fn comfort<'a>(space: &'a ConfigurationSpace, options: &PlanOptions) -> Option<DistanceCost<'a>> {
    let asked = options.planner.keeps_away() && options.comfort_weight > 0.0 && options.comfort > 0.0;
    let cost = |distance: f64| {
        let clearance = distance - space.radius();
        let share = (1.0 - clearance.max(0.0) / options.comfort).max(0.0);
        (options.comfort_weight * f64::from(PARTS) * share * share) as u8
    };
    asked.then(|| DistanceCost::new(space.field(), cost))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::Planner;
    use zenav_protocol::grid::{Grid, GridSpec, Occupancy, OccupancyGrid};
    use zenav_protocol::robot::Footprint;
    use zenav_space::UnknownPolicy;

    const RADIUS: f64 = 0.26;

    /// A room of 5 m by 4 m, 5 cm cells, with walls and a wall across that leaves a door of 1 m at the top.
    fn room() -> OccupancyGrid {
        let spec = GridSpec {
            origin: Point2::new(-1.0, -1.0),
            resolution: 0.05,
            width: 100,
            height: 80,
        };
        let mut grid = Grid::filled(spec, Occupancy::FREE);
        for y in 0..80 {
            for x in 0..100 {
                if x == 0 || y == 0 || x == 99 || y == 79 || (x == 50 && y < 60) {
                    grid[Cell::new(x, y)] = Occupancy::OCCUPIED;
                }
            }
        }
        grid
    }

    fn ask(grid: &OccupancyGrid, start: (f64, f64), goal: (f64, f64), options: &PlanOptions) -> PlanOutcome {
        let space = ConfigurationSpace::new(grid, &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0);
        let mut searcher = Searcher::new(space.free()).unwrap();
        plan(
            &space,
            &mut searcher,
            Pose2::new(start.0, start.1, 0.0),
            Pose2::new(goal.0, goal.1, 0.0),
            options,
            Budget::UNLIMITED,
        )
        .outcome
    }

    #[test]
    fn a_way_leads_from_start_to_goal_and_the_robot_fits_all_along() {
        let space = ConfigurationSpace::new(&room(), &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0);
        for options in [PlanOptions::default(), PlanOptions::shortest(Planner::AStar)] {
            let PlanOutcome::Found { path, length } = ask(&room(), (0.013, 0.027), (3.011, 0.049), &options) else {
                panic!("no way")
            };
            assert_eq!(
                (path[0], path[path.len() - 1]),
                (Point2::new(0.013, 0.027), Point2::new(3.011, 0.049))
            );
            assert!(
                path.windows(2)
                    .all(|pair| space.segment_is_free(pair[0], pair[1], RADIUS))
            );
            assert!(length > 4.5 && length < 7.0, "{length}");
        }
    }

    #[test]
    fn with_room_to_spare_a_way_keeps_off_the_walls() {
        let space = ConfigurationSpace::new(&room(), &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0);
        let least = |options: &PlanOptions| {
            let PlanOutcome::Found { path, .. } = ask(&room(), (0.0, 0.0), (3.0, 0.0), options) else {
                panic!("no way")
            };
            path.windows(2)
                .map(|pair| space.segment_clearance(pair[0], pair[1]))
                .fold(f64::INFINITY, f64::min)
                - RADIUS
        };
        assert!(least(&PlanOptions::shortest(Planner::AStar)) < 0.05);
        assert!(
            least(&PlanOptions::default()) > 0.12,
            "{}",
            least(&PlanOptions::default())
        );
    }

    #[test]
    fn places_where_the_robot_does_not_fit_are_named_with_the_nearest_that_do() {
        let options = PlanOptions::default();
        let PlanOutcome::GoalOccupied {
            nearest_free: Some(near),
        } = ask(&room(), (0.0, 0.0), (1.52, 0.0), &options)
        else {
            panic!()
        };
        assert!((near - Point2::new(1.52, 0.0)).norm() < 0.4);
        assert!(matches!(
            ask(&room(), (1.52, 0.0), (0.0, 0.0), &options),
            PlanOutcome::StartOccupied { nearest_free: Some(_) }
        ));
        assert_eq!(ask(&room(), (0.0, 0.0), (9.0, 0.0), &options), PlanOutcome::OutOfMap);
        assert_eq!(
            ask(&room(), (f64::NAN, 0.0), (0.0, 0.0), &options),
            PlanOutcome::OutOfMap
        );
        let mut closed = room();
        for y in 60..80 {
            closed[Cell::new(50, y)] = Occupancy::OCCUPIED;
        }
        assert_eq!(ask(&closed, (0.0, 0.0), (3.0, 0.0), &options), PlanOutcome::NoPath);
    }

    #[test]
    fn to_stay_where_it_is_is_a_way_without_length() {
        let outcome = ask(&room(), (0.0, 0.0), (0.0, 0.0), &PlanOptions::default());
        assert_eq!(
            outcome,
            PlanOutcome::Found {
                path: vec![Point2::origin(); 2],
                length: 0.0
            }
        );
    }

    #[test]
    fn a_robot_close_to_a_wall_leaves_it() {
        // The wall's face is at x = -0.95: 1 cm between robot and wall, then 1 cm of the robot in the wall's cell.
        for x in [-0.95 + RADIUS + 0.01, -0.95 + RADIUS - 0.01] {
            assert!(
                matches!(
                    ask(&room(), (x, 0.0), (1.0, 0.0), &PlanOptions::default()),
                    PlanOutcome::Found { .. }
                ),
                "{x}"
            );
        }
        assert!(matches!(
            ask(&room(), (-0.9, 0.0), (1.0, 0.0), &PlanOptions::default()),
            PlanOutcome::StartOccupied { .. }
        ));
    }
}
