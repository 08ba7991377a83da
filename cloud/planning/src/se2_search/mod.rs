//! SE(2) search. A path for a robot that is longer than wide: A* over positions and headings, with the true footprint.
//!
//! There are sixteen headings, each with steps forwards and backwards along it, and turns on the spot to the next heading on either side.
//! The result can be driven as stop, turn, go without contact: through gaps that are too narrow for a disc around the robot, and out of
//! lanes without room to turn. If cells are coarse for the robot, places (the positions of the lattice) also lie between the cell
//! centres. The cost to go comes from a search backwards from the goal over the cells where the robot fits with some heading.
//!
//! Sources: Pivtoraiko, Knepper and Kelly, "Differentially Constrained Mobile Robot Motion Planning in State Lattices", J. Field Robotics
//! 2009; Likhachev and Ferguson, "Planning Long Dynamically Feasible Maneuvers for Autonomous Vehicles", IJRR 2009 (the estimate).

mod cost_to_go;
mod footprint_masks;
#[cfg(test)]
mod tests;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::{Point2, Vector2};
use rustc_hash::FxHashMap;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::polygon::cross;

use cost_to_go::{CostToGo, UNIT};
use footprint_masks::{FootprintMasks, MARGIN, STEPS, yaw_of};

use super::budget::Budget;
use super::cell_cost::{CellCost, PARTS};
use super::searcher::{NotFound, Searched};
use super::settings::Se2Settings;
use zenav_space::ConfigurationSpace;

/// Spacing of the places behind the start from which the search may begin, m.
const BACK: f64 = 0.1;
/// Longest last leg to a goal between places, and longest first leg from a start, m: the longer the leg, the smaller the angle, and at a
/// small angle a robot fits beside a wall.
const FAR: f64 = 0.5;
/// The roomiest end of a path is sought in this many directions from the goal, at this share of the tolerance: the robot does not reach
/// its ends exactly.
const ENDS: u32 = 16;
const END_SHARE: f64 = 0.5;

/// Start and goal of a search.
#[derive(Clone, Copy, Debug)]
pub(super) struct Query {
    pub(super) start: Point2<f64>,
    /// Heading at the start, rad; `None`: any.
    pub(super) heading: Option<f64>,
    pub(super) goal: Point2<f64>,
    /// If the goal has no room to turn, the path may end this close to it, m.
    pub(super) tolerance: f64,
}

/// A path that the true footprint can drive.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct DrivenPath {
    /// Corner by corner, start and goal included.
    pub(super) corners: Vec<Point2<f64>>,
    /// Legs that are driven backwards, by the index of the corner where they begin, ascending.
    pub(super) backwards: Vec<usize>,
}

/// Whether the true footprint can drive a path: straight legs, turns on the spot, some legs backwards.
pub(super) fn is_drivable(
    space: &ConfigurationSpace,
    path: &[Point2<f64>],
    backwards: &[usize],
    heading: Option<f64>,
) -> bool {
    let mut heading = heading;
    for (number, leg) in path.windows(2).enumerate() {
        // Driving backwards is driving forwards from the other end.
        let [from, to] = if backwards.contains(&number) {
            [leg[1], leg[0]]
        } else {
            [leg[0], leg[1]]
        };
        let along = to - from;
        if along.norm_squared() == 0.0 {
            continue;
        }
        let yaw = along.y.atan2(along.x);
        if space.leg_clearance(from, to, MARGIN) < MARGIN
            || heading.is_some_and(|from| !space.turn_is_free(leg[0], from, yaw))
        {
            return false;
        }
        heading = Some(yaw);
    }
    true
}

/// From this turn on, the shorter way round may be the other one, rad.
const HALF_TURN: f32 = 3.1;

/// Whether the footprint fits at a point with the heading, or with any of the sixteen if there is none.
pub(super) fn can_stand(space: &ConfigurationSpace, at: Point2<f64>, heading: Option<f64>) -> bool {
    let stands = |yaw: f64| space.is_valid(Pose2::new(at.x, at.y, yaw));
    heading.map_or_else(|| (0..STEPS.len()).any(|i| stands(yaw_of(i))), stands)
}

/// A path that the true footprint can drive, corner by corner; `costs` are those of the map's cells.
pub(super) fn search(
    space: &ConfigurationSpace,
    costs: &impl CellCost,
    query: &Query,
    settings: &Se2Settings,
    budget: Budget<'_>,
) -> Searched<DrivenPath> {
    let mut expansions = 0;
    let result = match FootprintMasks::new(space) {
        Some(masks) => expand(&masks, costs, query, settings, budget, &mut expansions),
        None => Err(NotFound::NoPath),
    };
    Searched { result, expansions }
}

/// A place (position of the lattice) and a heading.
type Node = u64;

/// The best path known to a node.
#[derive(Clone, Copy)]
struct Reached {
    cost: u32,
    /// The previous node, or, from [`STARTS`] on, the number of a start.
    before: u64,
    /// Angle turned since the place was reached, rad: robots turn the shorter way round.
    turned: f32,
    /// Whether the last step was driven backwards.
    backwards: bool,
    closed: bool,
}

/// Values of `Reached::before` from here on are numbers of starts.
const STARTS: u64 = 1 << 63;

/// The best paths known, and the nodes to expand.
struct Frontier<'a> {
    masks: &'a FootprintMasks<'a>,
    left: CostToGo,
    /// Weight of the cost to go, in parts of 256. Integers throughout: the same order on every platform.
    weight: u64,
    reached: FxHashMap<Node, Reached>,
    open: BinaryHeap<Reverse<(u32, Node)>>,
}

impl Frontier<'_> {
    /// Keeps a way to a place and heading if it is better than the one known.
    fn reach(&mut self, place: (i64, i64), heading: usize, way: Reached) {
        let node = ((place.1 * self.masks.width + place.0) as u64) << 4 | heading as u64;
        let known = self.reached.get(&node);
        if known.is_none_or(|known| !known.closed && way.cost < known.cost) {
            let left = (u64::from(self.left.from(self.masks.cell(place))) * self.weight) >> 8;
            let estimate = way.cost.saturating_add(u32::try_from(left).unwrap_or(u32::MAX));
            self.open.push(Reverse((estimate, node)));
            self.reached.insert(node, way);
        }
    }

    /// The place and heading of a node.
    fn place(&self, node: Node) -> ((i64, i64), usize) {
        let index = (node >> 4) as i64;
        (
            (index % self.masks.width, index / self.masks.width),
            (node & 15) as usize,
        )
    }

    /// Reaches all that is one step or turn away from a node.
    fn leave(&mut self, node: Node, here: Reached, costs: &impl CellCost, settings: &Se2Settings) {
        let masks = self.masks;
        let resolution = masks.space.spec().resolution;
        let (place, heading) = self.place(node);
        let way = |step: u32, turned: f32, backwards: bool| Reached {
            cost: here.cost.saturating_add(step),
            before: node,
            turned,
            backwards,
            closed: false,
        };
        let (x, y) = STEPS[heading];
        for backwards in [false, true] {
            let to = if backwards {
                (place.0 - x, place.1 - y)
            } else {
                (place.0 + x, place.1 + y)
            };
            // Driving backwards is driving forwards from the other end.
            let (from, until) = if backwards { (to, place) } else { (place, to) };
            if masks.contains(to) && masks.can_step(from, until, heading) {
                let extra = f64::from(costs.extra(masks.cell(to))) / f64::from(PARTS);
                let length = masks.spacing * ((x * x + y * y) as f64).sqrt();
                let times = if backwards { settings.reverse_cost } else { 1.0 };
                let changes = backwards != here.backwards;
                let cusp = if changes { settings.cusp_cost / resolution } else { 0.0 };
                let step = (length * times * (1.0 + extra) + cusp) * UNIT;
                self.reach(to, heading, way(step as u32, 0.0, backwards));
            }
        }
        let turn_cost = (settings.turn_cost / resolution * UNIT) as u32;
        let (next, previous) = ((heading + 1) % STEPS.len(), (heading + STEPS.len() - 1) % STEPS.len());
        for (to, between) in [(next, heading), (previous, previous)] {
            let turned = here.turned + wrap_angle(yaw_of(to) - yaw_of(heading)) as f32;
            let is_shorter = turned.abs() < HALF_TURN || masks.can_turn_round(place);
            if is_shorter && masks.can_turn(place, between) {
                self.reach(place, to, way(turn_cost, turned, here.backwards));
            }
        }
    }
}

/// Expanding a node takes as long as expanding this many cells of a grid search.
const CELLS_A_NODE: u64 = 16;

fn expand(
    masks: &FootprintMasks<'_>,
    costs: &impl CellCost,
    query: &Query,
    settings: &Se2Settings,
    budget: Budget<'_>,
    expansions: &mut u64,
) -> Result<DrivenPath, NotFound> {
    let space = masks.space;
    let spec = space.spec();
    let goal = spec.to_cells(query.goal);
    let is_tight = space.clearance(query.goal) <= space.footprint().circumscribed_radius() + MARGIN;
    let enough = if is_tight {
        query.tolerance / spec.resolution
    } else {
        0.0
    };
    let (first, last) = (spec.cell_at(query.start), spec.cell_at(query.goal));
    let (Some(first), Some(last)) = (first, last) else {
        return Err(NotFound::OutOfMap);
    };
    let Some(left) = CostToGo::new(masks, costs, first, last, budget, expansions)? else {
        return Err(NotFound::NoPath);
    };
    let mut frontier = Frontier {
        masks,
        left,
        weight: (settings.heuristic_weight * 256.0) as u64,
        reached: FxHashMap::default(),
        open: BinaryHeap::new(),
    };
    let ends = [Some(query.goal), roomiest_end(space, query).filter(|_| is_tight)];
    let ends: Vec<Point2<f64>> = ends.into_iter().flatten().collect();
    let starts = starts(masks, query, settings, budget);
    if budget.is_cancelled() {
        return Err(NotFound::TimedOut);
    }
    for (number, start) in starts.iter().enumerate() {
        let begun = Reached {
            cost: (start.cost / spec.resolution * UNIT) as u32,
            before: STARTS + number as u64,
            turned: start.turned as f32,
            backwards: false,
            closed: false,
        };
        frontier.reach(start.place, start.heading, begun);
    }
    let mut nodes = 0;
    // Multiples only, so that the budget checks its flag regularly.
    *expansions = expansions.next_multiple_of(CELLS_A_NODE);
    while let Some(Reverse((_, at))) = frontier.open.pop() {
        let Some(known) = frontier.reached.get_mut(&at).filter(|known| !known.closed) else {
            continue;
        };
        known.closed = true;
        let here = *known;
        nodes += 1;
        if nodes > settings.max_nodes {
            return Err(NotFound::TimedOut);
        }
        *expansions += CELLS_A_NODE;
        if budget.is_spent(*expansions) {
            return Err(NotFound::TimedOut);
        }
        let (place, heading) = frontier.place(at);
        let come_to = yaw_of(heading) - f64::from(here.turned);
        if let Some(end) = ends.iter().find(|end| arrives(masks, place, come_to, **end)) {
            return Ok(trace(&frontier, &starts, at, *end));
        }
        if (masks.point(place) - goal).norm() < enough {
            let end = spec.from_cells(masks.point(place));
            return Ok(trace(&frontier, &starts, at, end));
        }
        frontier.leave(at, here, costs, settings);
    }
    Err(NotFound::NoPath)
}

/// Beginning of a search: a place with a heading, reached by a few straight legs from the start.
struct Start {
    corners: Vec<Point2<f64>>,
    /// Whether the first leg is driven backwards.
    backwards: bool,
    /// Cost of the legs, m.
    cost: f64,
    place: (i64, i64),
    heading: usize,
    /// Turn at the place into the heading, rad.
    turned: f64,
}

/// All places beside the start, or straight ahead of or behind it, where the robot can turn to a heading of the lattice; fewer once the
/// search is cancelled.
fn starts(masks: &FootprintMasks<'_>, query: &Query, settings: &Se2Settings, budget: Budget<'_>) -> Vec<Start> {
    let mut starts = Vec::new();
    match query.heading {
        Some(yaw) => starts_with(masks, query.start, yaw, settings, budget, &mut starts),
        None => (0..STEPS.len())
            .map(yaw_of)
            .filter(|yaw| {
                let pose = Pose2::new(query.start.x, query.start.y, *yaw);
                masks.space.is_valid(pose)
            })
            .for_each(|yaw| starts_with(masks, query.start, yaw, settings, budget, &mut starts)),
    }
    starts
}

fn starts_with(
    masks: &FootprintMasks<'_>,
    start: Point2<f64>,
    heading: f64,
    settings: &Se2Settings,
    budget: Budget<'_>,
    starts: &mut Vec<Start>,
) {
    let (space, spec) = (masks.space, masks.space.spec());
    let spacing = masks.spacing * spec.resolution;
    let ahead = Vector2::new(heading.cos(), heading.sin());
    let known = starts.len();
    for i in 0..=(settings.straight_on / spacing) as u32 {
        let way = spacing * f64::from(i);
        let from = start + ahead * way;
        let is_blocked =
            || space.leg_clearance(start, from, MARGIN) < MARGIN || !space.is_permitted_between(start, from);
        if budget.is_cancelled() || (i > 0 && is_blocked()) {
            break;
        }
        // Places beside the line ahead, for which a small turn is enough.
        for leg in [0.0, FAR.min(10.0 * spacing), FAR] {
            let near = from + ahead * leg;
            starts_beside(masks, (start, heading), from, near, (way, false), starts);
        }
        if starts.len() > known {
            break;
        }
    }
    // A robot that cannot turn round at the start may have to back out, whichever way its lane runs.
    if masks.can_turn_round(masks.nearest(spec.to_cells(start))) {
        return;
    }
    for i in 1..=(settings.straight_on / BACK) as u32 {
        let way = BACK * f64::from(i);
        let from = start - ahead * way;
        let is_blocked =
            || space.leg_clearance(from, start, MARGIN) < MARGIN || !space.is_permitted_between(start, from);
        if budget.is_cancelled() || is_blocked() {
            break;
        }
        let cost = settings.cusp_cost + settings.reverse_cost * way;
        starts_beside(masks, (start, heading), from, from, (cost, true), starts);
    }
}

/// The places around `near` that a robot can reach by a turn at `from` and a straight leg. `cost` (m) and `backwards` describe the leg
/// from the start to `from`.
fn starts_beside(
    masks: &FootprintMasks<'_>,
    (start, heading): (Point2<f64>, f64),
    from: Point2<f64>,
    near: Point2<f64>,
    (cost, backwards): (f64, bool),
    starts: &mut Vec<Start>,
) {
    let (space, spec) = (masks.space, masks.space.spec());
    let (x, y) = masks.nearest(spec.to_cells(near));
    for place in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy))) {
        let to = spec.from_cells(masks.point(place));
        let leg = to - from;
        let is_there = leg.norm() < 1e-9;
        let along = if is_there { heading } else { leg.y.atan2(leg.x) };
        let goes = || {
            space.turn_is_free(from, heading, along)
                && space.leg_clearance(from, to, MARGIN) >= MARGIN
                && space.is_permitted_between(from, to)
        };
        if !masks.contains(place) || !(is_there || goes()) {
            continue;
        }
        let corners = if from == start {
            vec![start, to]
        } else {
            vec![start, from, to]
        };
        for into in 0..STEPS.len() {
            let turned = wrap_angle(yaw_of(into) - along);
            // Larger turns are made of turns from heading to heading.
            if turned.abs() < 0.5 && space.turn_is_free(to, along, yaw_of(into)) {
                starts.push(Start {
                    corners: corners.clone(),
                    backwards,
                    cost: cost + leg.norm(),
                    place,
                    heading: into,
                    turned,
                });
            }
        }
    }
}

/// The place within the query's tolerance with the most clearance, if it has more than the goal: the robot can reach it at more angles.
fn roomiest_end(space: &ConfigurationSpace, query: &Query) -> Option<Point2<f64>> {
    let around = (0..ENDS).map(|i| {
        let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / f64::from(ENDS)).sin_cos();
        query.goal + Vector2::new(cos, sin) * (END_SHARE * query.tolerance)
    });
    let roomiest = around.max_by(|a, b| space.clearance(*a).total_cmp(&space.clearance(*b)))?;
    (space.clearance(roomiest) > space.clearance(query.goal)).then_some(roomiest)
}

/// Whether an end of the path lies at a place that was reached with a heading (rad), or one turn and one leg away.
fn arrives(masks: &FootprintMasks<'_>, place: (i64, i64), heading: f64, to: Point2<f64>) -> bool {
    let space = masks.space;
    let spec = space.spec();
    let from = spec.from_cells(masks.point(place));
    let leg = to - from;
    if leg.norm() < 1e-9 {
        return true;
    }
    let is_beside = leg.amax() < 1.01 * masks.spacing * spec.resolution;
    let turn = wrap_angle(leg.y.atan2(leg.x) - heading).abs();
    // From farther away only with a small turn.
    if !is_beside && (leg.norm() > FAR || turn > 0.2) {
        return false;
    }
    space.leg_clearance(from, to, MARGIN) >= MARGIN
        && space.is_permitted_between(from, to)
        && space.turn_is_free(from, heading, leg.y.atan2(leg.x))
}

/// The path to a node, and on to the end.
fn trace(frontier: &Frontier<'_>, starts: &[Start], last: Node, end: Point2<f64>) -> DrivenPath {
    let spec = frontier.masks.space.spec();
    // Each point with whether the leg to it is driven backwards.
    let mut points = vec![(end, false)];
    let mut at = last;
    loop {
        let place = spec.from_cells(frontier.masks.point(frontier.place(at).0));
        match frontier.reached.get(&at) {
            Some(known) if known.before < STARTS => {
                points.push((place, known.backwards));
                at = known.before;
            }
            Some(known) => {
                let start = &starts[(known.before - STARTS) as usize];
                points.push((place, false));
                let corners = start.corners.iter().rev().skip(1);
                points.extend(corners.map(|corner| (*corner, start.backwards)));
                break;
            }
            None => break,
        }
    }
    let mut path = DrivenPath::default();
    let corners = &mut path.corners;
    let mut flags: Vec<bool> = Vec::new();
    for (point, backwards) in points.into_iter().rev() {
        if corners
            .last()
            .is_some_and(|last: &Point2<f64>| (point - last).norm() < 1e-9)
        {
            continue;
        }
        if let [.., a, b] = corners[..] {
            let (before, after) = (b - a, point - b);
            if cross(before, after).abs() < 1e-9 && before.dot(&after) > 0.0 && flags.last() == Some(&backwards) {
                corners.pop();
                flags.pop();
            }
        }
        corners.push(point);
        flags.push(backwards);
    }
    let legs = flags.into_iter().skip(1).enumerate();
    path.backwards = legs.filter_map(|(leg, backwards)| backwards.then_some(leg)).collect();
    path
}
