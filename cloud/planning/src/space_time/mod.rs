//! Space-time search. A path past robots whose courses are known, with the time of arrival.
//!
//! A* over positions and times on a coarse grid, on which waiting is a move (Silver, "Cooperative pathfinding", AIIDE 2005). The robot is the
//! disc around its footprint and moves at one speed. A place is taken from some time before another robot's disc comes near until some time
//! after it has left. A taken place may be crossed at a cost, so a robot that already stands in the way of another one gets out of it. After
//! the end of a course nothing is taken. The cost to go is the time among static obstacles alone, exact on the same grid.
//!
//! [`SpaceTimePath::meets`] marks where the other robots are when this one passes them. A path that is pulled taut among these discs
//! ([`pulled`]) stays on the side of each robot that the search chose.

mod cost_to_go;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Point2;
use rustc_hash::FxHashMap;
use zenav_protocol::messages::KnownCourse;
use zenav_protocol::polygon::Edge;
use zenav_space::{ConfigurationSpace, LineOfSight as _};

use super::budget::Budget;
use super::settings::SpaceTimeSettings;
use super::string_pulling::pull_string;
use cost_to_go::CostToGo;

/// Ticks of a straight step, and of a diagonal one: their ratio is the square root of two within 1 %.
const STRAIGHT: u32 = 5;
const DIAGONAL: u32 = 7;
/// The neighbours of a node, and the ticks that the step takes.
const STEPS: [(i32, i32, u32); 8] = [
    (1, 0, STRAIGHT),
    (-1, 0, STRAIGHT),
    (0, 1, STRAIGHT),
    (0, -1, STRAIGHT),
    (1, 1, DIAGONAL),
    (1, -1, DIAGONAL),
    (-1, 1, DIAGONAL),
    (-1, -1, DIAGONAL),
];
/// Other robots are marked up to this far beyond the distance kept from them, m.
const BESIDE: f64 = 1.0;
/// Spacing of the discs that mark a robot on its course, m.
const SPACING: f64 = 0.1;
/// Least distance by which string pulling moves a corner, cells.
const FINEST: f64 = 0.5;

/// Start, goal, speed, and the robots to give way to.
#[derive(Clone, Copy, Debug)]
pub struct SpaceTimeQuery<'a> {
    /// Map frame.
    pub start: Point2<f64>,
    /// Map frame.
    pub goal: Point2<f64>,
    /// m/s.
    pub speed: f64,
    /// Radius of the disc around the footprint, m.
    pub radius: f64,
    /// Courses of the robots with right of way.
    pub courses: &'a [KnownCourse],
}

/// A path in space and time.
#[derive(Clone, Debug, PartialEq)]
pub struct SpaceTimePath {
    /// Times, s from the start, and positions, map frame.
    pub places: Vec<(f64, Point2<f64>)>,
    /// Time that the robot waits on the way, s.
    pub waits: f64,
    /// Time in which it is in another robot's way, s.
    pub in_the_way: f64,
    /// Nodes expanded.
    pub expansions: u64,
}

impl SpaceTimePath {
    /// Time of arrival at the goal, s.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_planning::{Budget, SpaceTimeQuery, SpaceTimeSettings, search_space_time};
    /// # use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 200, height: 160 };
    /// # let map = Grid::filled(spec, Occupancy::FREE);
    /// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.3), UnknownPolicy::Blocked, 0.0);
    /// // 8 m of open floor, and nobody else on it.
    /// let (start, goal) = (Point2::new(1.0, 4.0), Point2::new(9.0, 4.0));
    /// let arrival = |speed| {
    ///     let query = SpaceTimeQuery { start, goal, speed, radius: 0.3, courses: &[] };
    ///     let path = search_space_time(&space, &query, &SpaceTimeSettings::default(), Budget::UNLIMITED);
    ///     path.unwrap().arrival()
    /// };
    /// assert!((arrival(0.5) - 16.0).abs() < 0.1 && (arrival(1.0) - 8.0).abs() < 0.1);
    /// ```
    #[must_use]
    pub fn arrival(&self) -> f64 {
        self.places.last().map_or(0.0, |(secs, _)| *secs)
    }

    /// Discs, center and radius (m), that the other robots occupy while this one passes them. Each leaves room for this robot's own disc on
    /// the path, and `kept` m beside it.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_planning::{Budget, SpaceTimeQuery, SpaceTimeSettings, search_space_time};
    /// # use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::messages::{CoursePlace, KnownCourse};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 200, height: 160 };
    /// # let map = Grid::filled(spec, Occupancy::FREE);
    /// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.3), UnknownPolicy::Blocked, 0.0);
    /// # let places = [(0.0, 9.0), (16.0, 1.0)].map(|(secs, x)| CoursePlace { secs, x, y: 4.0 });
    /// # let courses = [KnownCourse { radius: 0.3, places: places.to_vec() }];
    /// # let (start, goal, settings) = (Point2::new(1.0, 4.0), Point2::new(9.0, 4.0), SpaceTimeSettings::default());
    /// // A robot of 0.3 m radius comes towards this one along y = 4 m.
    /// let query = SpaceTimeQuery { start, goal, speed: 0.5, radius: 0.3, courses: &courses };
    /// let path = search_space_time(&space, &query, &settings, Budget::UNLIMITED).unwrap();
    /// let discs = path.meets(&query, &settings, 0.1);
    /// assert!(!discs.is_empty());
    /// let most = 0.3 + settings.clearance;
    /// assert!(discs.iter().all(|(center, radius)| (center.y - 4.0).abs() < 1e-9 && *radius <= most));
    /// ```
    #[must_use]
    pub fn meets(
        &self,
        query: &SpaceTimeQuery<'_>,
        settings: &SpaceTimeSettings,
        kept: f64,
    ) -> Vec<(Point2<f64>, f64)> {
        let line: Vec<Point2<f64>> = self.places.iter().map(|(_, place)| *place).collect();
        let mut discs: Vec<(Point2<f64>, f64)> = Vec::new();
        for course in query.courses {
            let near = query.radius + course.radius + settings.clearance + BESIDE;
            for (secs, place) in &self.places {
                let legs = pieces(course, secs - settings.after, secs + settings.before);
                for other in legs.flat_map(|leg| positions_near(leg, *place, near)) {
                    let is_known = |(known, _): &(Point2<f64>, f64)| (known - other).norm() < 0.5 * SPACING;
                    if discs.iter().any(is_known) {
                        continue;
                    }
                    let beside = distance_to_line(other, &line) - query.radius - kept;
                    let radius = beside.min(course.radius + settings.clearance);
                    if radius > 0.0 {
                        discs.push((other, radius));
                    }
                }
            }
        }
        discs
    }
}

/// The corners of a path, pulled taut in a space for the same disc in which [`SpaceTimePath::meets`] is occupied.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_planning::{Budget, SpaceTimeQuery, SpaceTimeSettings, pulled, search_space_time};
/// # use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::Footprint;
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 200, height: 160 };
/// # let map = Grid::filled(spec, Occupancy::FREE);
/// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.3), UnknownPolicy::Blocked, 0.0);
/// let (start, goal) = (Point2::new(1.0, 4.0), Point2::new(9.0, 6.0));
/// let query = SpaceTimeQuery { start, goal, speed: 0.5, radius: 0.3, courses: &[] };
/// let path = search_space_time(&space, &query, &SpaceTimeSettings::default(), Budget::UNLIMITED).unwrap();
/// let corners = pulled(&space, &path);
/// // Steps to eight neighbours become one straight leg.
/// assert!(path.places.len() > 30 && corners.len() <= 4);
/// assert!((corners[corners.len() - 1] - goal).norm() < 1e-9);
/// ```
#[must_use]
pub fn pulled(space: &ConfigurationSpace, path: &SpaceTimePath) -> Vec<Point2<f64>> {
    let spec = space.spec();
    let mut corners: Vec<Point2<f64>> = path.places.iter().map(|(_, place)| spec.to_cells(*place)).collect();
    corners.dedup();
    pull_string(space, &mut corners, FINEST, || false);
    corners.into_iter().map(|corner| spec.from_cells(corner)).collect()
}

/// Distance of a point from a polyline, m.
fn distance_to_line(point: Point2<f64>, line: &[Point2<f64>]) -> f64 {
    let first = line.first().map_or(f64::INFINITY, |at| (at - point).norm());
    let leg = |leg: &[Point2<f64>]| Edge { a: leg[0], b: leg[1] };
    let pieces = line.windows(2).map(|ends| (leg(ends).nearest(point) - point).norm());
    pieces.fold(first, f64::min)
}

/// The straight legs of a course between two times, s; a course of one place is a leg without length.
fn pieces(course: &KnownCourse, from: f64, to: f64) -> impl Iterator<Item = (Point2<f64>, Point2<f64>)> + '_ {
    let at = |leg: &[zenav_protocol::messages::CoursePlace], secs: f64| {
        let (first, last) = (leg[0], leg[1]);
        let share = ((secs - first.secs) / (last.secs - first.secs).max(1e-9)).clamp(0.0, 1.0);
        first.at() + (last.at() - first.at()) * share
    };
    let begins = course.places.partition_point(|place| place.secs <= from).max(1) - 1;
    let legs = course.places.get(begins..).unwrap_or_default().windows(2);
    let legs = legs
        .take_while(move |leg| leg[0].secs < to)
        .filter(move |leg| leg[1].secs > from)
        .map(move |leg| (at(leg, from), at(leg, to)));
    let alone = match &course.places[..] {
        [place] if place.secs > from && place.secs < to => Some((place.at(), place.at())),
        _ => None,
    };
    legs.chain(alone)
}

/// Positions on a leg, [`SPACING`] apart, no farther than `near` m from a place.
fn positions_near(
    (first, last): (Point2<f64>, Point2<f64>),
    place: Point2<f64>,
    near: f64,
) -> impl Iterator<Item = Point2<f64>> {
    let length = (last - first).norm();
    let along = (last - first) / length.max(1e-9);
    let middle = (place - first).dot(&along);
    let (from, to) = ((middle - near).max(0.0), (middle + near).min(length));
    let count = ((to - from) / SPACING).ceil();
    let nth = if count >= 0.0 { 0..count as u32 + 1 } else { 0..0 };
    let share = move |nth: u32| if count > 0.0 { f64::from(nth) / count } else { 0.0 };
    nth.map(move |nth| first + along * (from + (to - from) * share(nth)))
        .filter(move |at| (at - place).norm() <= near)
}

/// Whether one of the robots takes a place at a time, s.
fn is_taken(query: &SpaceTimeQuery<'_>, settings: &SpaceTimeSettings, place: Point2<f64>, secs: f64) -> bool {
    query.courses.iter().any(|course| {
        let near = query.radius + course.radius + settings.clearance;
        let mut pieces = pieces(course, secs - settings.after, secs + settings.before);
        pieces.any(|(a, b)| (Edge { a, b }.nearest(place) - place).norm() < near)
    })
}

/// A node of the search: column, row, and time slice.
type Node = (i32, i32, u32);

/// How a node was reached; by default, at once.
#[derive(Clone, Copy, Debug, Default)]
struct Reached {
    from: Option<Node>,
    /// Ticks from the start, and how many of them were in the way of another robot.
    ticks: u32,
    taken: u32,
    cost: u32,
}

/// The path that costs least: time of arrival, plus a penalty for time in the way of other robots. `None` if no path on the coarse grid is
/// free of static obstacles, if an end lies outside the map or the speed is not positive, and once the budget is spent. `space`: for the
/// disc around the footprint. Every leg is in sight in it.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_planning::{Budget, SpaceTimeQuery, SpaceTimeSettings, search_space_time};
/// use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
/// use zenav_protocol::messages::{CoursePlace, KnownCourse};
/// use zenav_protocol::robot::Footprint;
/// use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 200, height: 160 };
/// let map = Grid::filled(spec, Occupancy::FREE);
/// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.3), UnknownPolicy::Blocked, 0.0);
/// // Another robot comes the other way.
/// let places = [(0.0, 9.0), (16.0, 1.0)].map(|(secs, x)| CoursePlace { secs, x, y: 4.0 });
/// let courses = [KnownCourse { radius: 0.3, places: places.to_vec() }];
/// let query = SpaceTimeQuery {
///     start: Point2::new(1.0, 4.0),
///     goal: Point2::new(9.0, 4.0),
///     speed: 0.5,
///     radius: 0.3,
///     courses: &courses,
/// };
/// let path = search_space_time(&space, &query, &SpaceTimeSettings::default(), Budget::UNLIMITED);
/// let path = path.expect("there is room to pass");
/// assert!(path.arrival() < 19.0 && path.in_the_way == 0.0);
/// ```
#[must_use]
pub fn search(
    space: &ConfigurationSpace,
    query: &SpaceTimeQuery<'_>,
    settings: &SpaceTimeSettings,
    budget: Budget<'_>,
) -> Option<SpaceTimePath> {
    let tick = settings.cell / query.speed / f64::from(STRAIGHT);
    let is_on_map = |end: Point2<f64>| space.spec().cell_at(end).is_some();
    if !(is_on_map(query.start) && is_on_map(query.goal) && tick.is_finite() && tick > 0.0) {
        return None;
    }
    let grid = CoarseGrid::new(space, query.start, settings.cell);
    let goal = grid.nearest(query.goal);
    if !grid.sees(grid.point(goal), query.goal) {
        return None;
    }
    let slack = (settings.slack / tick) as u32;
    let to_go = CostToGo::new(&grid, goal, (0, 0), slack, settings.max_nodes, budget)?;
    let secs = |ticks: u32| f64::from(ticks) * tick;
    let mut reached: FxHashMap<Node, Reached> = FxHashMap::default();
    let mut open = BinaryHeap::new();
    let start: Node = (0, 0, 0);
    reached.insert(start, Reached::default());
    open.push((Reverse(to_go.at((0, 0))?), 0_u32, start));
    let mut expanded: u64 = 0;
    while let Some((_, cost, node)) = open.pop() {
        let here = *reached.get(&node)?;
        if here.cost < cost {
            continue;
        }
        if (node.0, node.1) == goal {
            return Some(SpaceTimePath {
                expansions: expanded,
                ..found(&reached, node, &grid, query, tick)
            });
        }
        expanded += 1;
        if expanded > settings.max_nodes || budget.is_spent(expanded) {
            return None;
        }
        let waits = std::iter::once((0, 0, STRAIGHT));
        for (x, y, ticks) in STEPS.iter().copied().chain(waits) {
            let place = (node.0 + x, node.1 + y);
            let Some(rest) = to_go.at(place) else { continue };
            if (x, y) != (0, 0) && !grid.is_free((node.0, node.1), place) {
                continue;
            }
            let after = here.ticks + ticks;
            let taken = is_taken(query, settings, grid.point(place), secs(after));
            let taken = if taken { ticks } else { 0 };
            let cost = here.cost + ticks + (settings.taken_cost * f64::from(taken)).round() as u32;
            let next: Node = (place.0, place.1, after / STRAIGHT);
            if reached.get(&next).is_some_and(|known| known.cost <= cost) {
                continue;
            }
            reached.insert(
                next,
                Reached {
                    from: Some(node),
                    ticks: after,
                    taken: here.taken + taken,
                    cost,
                },
            );
            open.push((Reverse(cost + rest), cost, next));
        }
    }
    None
}

/// The path that leads to a node.
fn found(
    reached: &FxHashMap<Node, Reached>,
    last: Node,
    grid: &CoarseGrid<'_>,
    query: &SpaceTimeQuery<'_>,
    tick: f64,
) -> SpaceTimePath {
    let (mut places, mut waits) = (Vec::new(), 0.0);
    let in_the_way = reached.get(&last).map_or(0.0, |last| f64::from(last.taken) * tick);
    let mut at = Some(last);
    while let Some(node) = at {
        let Some(here) = reached.get(&node) else { break };
        places.push((f64::from(here.ticks) * tick, grid.point((node.0, node.1))));
        if here.from.is_some_and(|from| (from.0, from.1) == (node.0, node.1)) {
            waits += f64::from(STRAIGHT) * tick;
        }
        at = here.from;
    }
    places.reverse();
    // The goal lies beside its node: in sight from the place before it, or else from the node.
    if let [.., (_, before), (_, end)] = &mut places[..]
        && grid.sees(*before, query.goal)
    {
        *end = query.goal;
    } else if let Some((secs, end)) = places.last().copied() {
        places.push((secs + (query.goal - end).norm() / query.speed, query.goal));
    }
    SpaceTimePath {
        places,
        waits,
        in_the_way,
        expansions: 0,
    }
}

/// A grid of positions around the start of the search.
struct CoarseGrid<'a> {
    space: &'a ConfigurationSpace,
    origin: Point2<f64>,
    cell: f64,
}

impl<'a> CoarseGrid<'a> {
    fn new(space: &'a ConfigurationSpace, origin: Point2<f64>, cell: f64) -> Self {
        Self { space, origin, cell }
    }

    fn point(&self, (x, y): (i32, i32)) -> Point2<f64> {
        Point2::new(
            self.origin.x + f64::from(x) * self.cell,
            self.origin.y + f64::from(y) * self.cell,
        )
    }

    fn nearest(&self, point: Point2<f64>) -> (i32, i32) {
        let off = (point - self.origin) / self.cell;
        (off.x.round() as i32, off.y.round() as i32)
    }

    /// Whether the robot can move straight between two nodes.
    fn is_free(&self, from: (i32, i32), to: (i32, i32)) -> bool {
        self.sees(self.point(from), self.point(to))
    }

    /// Whether the robot can move straight between two positions, m.
    fn sees(&self, from: Point2<f64>, to: Point2<f64>) -> bool {
        let [from, to] = [from, to].map(|end| self.space.spec().to_cells(end));
        self.space.sees(from, to)
    }
}

#[cfg(test)]
mod tests;
