//! Is there a way for a robot that is longer than wide? A* over places and headings, with the true footprint.
//!
//! Sixteen headings, each with the step that leads along it, and turns on the spot from one to the next: whatever comes out is driven as
//! stop, turn and go without touching anything, through gaps that a disc around the robot would be shut out of. Where cells are coarse for
//! the robot, places lie between their centres as well. What is left to the goal is told by a search backwards over the cells
//! where the robot can stand with any heading: it can do no better, and where there is room it does as well.
//!
//! Sources: Pivtoraiko, Knepper and Kelly, "Differentially Constrained Mobile Robot Motion Planning in State Lattices", J. Field Robotics
//! 2009; Likhachev and Ferguson, "Planning Long Dynamically Feasible Maneuvers for Autonomous Vehicles", IJRR 2009 (the estimate).

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::Cell;
use zenav_protocol::robot::Footprint;

use super::astar::{CellCost, NotFound, PARTS};
use super::budget::Budget;
use super::searcher::Searched;
use crate::space::body::{hull, swept};
use crate::space::{BitGrid, ConfigurationSpace};

/// The steps along the headings, in places, counter-clockwise.
const STEPS: [(i64, i64); 16] = [
    (1, 0),
    (2, 1),
    (1, 1),
    (1, 2),
    (0, 1),
    (-1, 2),
    (-1, 1),
    (-2, 1),
    (-1, 0),
    (-2, -1),
    (-1, -1),
    (-1, -2),
    (0, -1),
    (1, -2),
    (1, -1),
    (2, -1),
];
/// Places are at most about this far apart, m, and at most this many to a cell's side (an odd number: one lies at its centre).
const SPACING: f64 = 0.06;
const MOST_PLACES: u32 = 9;
/// What a turn to the next heading costs, m.
const TURN: f64 = 0.08;
/// Outlines for which the turn to the next heading is taken as convex.
const PARTS_OF_TURN: u32 = 3;
/// From so many places away a start or a goal that lies between places is gone to straight.
const FAR: f64 = 10.0;
/// How far a robot that cannot turn where it stands goes straight on to where it can, m.
const STRAIGHT_ON: f64 = 2.0;

/// What is looked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Query {
    pub(super) start: Point2<f64>,
    /// Heading at the start, rad; any without.
    pub(super) heading: Option<f64>,
    pub(super) goal: Point2<f64>,
}

/// Whether the true footprint can drive a way as it stands: legs straight, turns on the spot.
pub(super) fn is_drivable(space: &ConfigurationSpace, way: &[Point2<f64>], heading: Option<f64>) -> bool {
    let mut heading = heading;
    for leg in way.windows(2) {
        let along = leg[1] - leg[0];
        if along.norm_squared() == 0.0 {
            continue;
        }
        let yaw = along.y.atan2(along.x);
        if space.leg_clearance(leg[0], leg[1], HAIR) < HAIR
            || heading.is_some_and(|from| !space.turn_is_free(leg[0], from, yaw))
        {
            return false;
        }
        heading = Some(yaw);
    }
    true
}

/// Kept clear, m.
const HAIR: f64 = 5e-4;
/// Beyond this the shorter way round may be the other one, rad.
const HALF_TURN: f32 = 3.1;

/// Whether the footprint stands free with a heading that the robot may begin with.
pub(super) fn can_stand(space: &ConfigurationSpace, at: Point2<f64>, heading: Option<f64>) -> bool {
    let stands = |yaw: f64| space.is_valid(Pose2::new(at.x, at.y, yaw));
    heading.map_or_else(|| (0..STEPS.len()).any(|i| stands(yaw_of(i))), stands)
}

fn yaw_of(heading: usize) -> f64 {
    let (x, y) = STEPS[heading];
    (y as f64).atan2(x as f64)
}

/// A way that the true footprint can drive, corner by corner; `costs` as for the cells of the map.
pub(super) fn search(
    space: &ConfigurationSpace,
    costs: &impl CellCost,
    query: &Query,
    budget: Budget<'_>,
) -> Searched<Vec<Point2<f64>>> {
    let mut expansions = 0;
    let result = match Footing::new(space) {
        Some(footing) => expand(&footing, costs, query, budget, &mut expansions),
        None => Err(NotFound::NoPath),
    };
    Searched { result, expansions }
}

/// Where the footprint stands, how it steps and turns. Lengths in cells.
struct Footing<'a> {
    space: &'a ConfigurationSpace,
    /// Places to a cell's side, and their distance.
    places: i64,
    spacing: f64,
    width: i64,
    height: i64,
    /// What a step along each heading sweeps, and a turn to the next one, about the place.
    steps: Vec<Vec<Point2<f64>>>,
    turns: Vec<[Vec<Point2<f64>>; PARTS_OF_TURN as usize]>,
    /// The footprint itself with each heading, about the place.
    standing: Vec<Vec<Point2<f64>>>,
    /// With so much to the nearest obstacle at the cell's centre, m, nothing that starts in the cell collides.
    roomy: f64,
}

impl<'a> Footing<'a> {
    fn new(space: &'a ConfigurationSpace) -> Option<Self> {
        let Footprint::Polygon(corners) = space.footprint() else {
            return None;
        };
        let spec = space.spec();
        let places = (spec.resolution / SPACING).ceil().clamp(1.0, f64::from(MOST_PLACES)) as u32 | 1;
        let spacing = 1.0 / f64::from(places);
        // A little larger on all sides than what is asked for afterwards.
        let grown = 1.0 + 2.0 * HAIR / space.footprint().inscribed_radius();
        let corners: Vec<_> = corners
            .iter()
            .map(|corner| *corner * (grown / spec.resolution))
            .collect();
        let at_rest = |yaw: f64| Pose2 { x: 0.0, y: 0.0, yaw };
        let step = |(i, (x, y)): (usize, &(i64, i64))| {
            let to = Point2::new(*x as f64, *y as f64) * spacing;
            hull(&swept(&corners, at_rest(yaw_of(i)), to))
        };
        let turn = |i: usize| {
            let (from, turn) = (yaw_of(i), wrap_angle(yaw_of((i + 1) % STEPS.len()) - yaw_of(i)));
            let part = turn / f64::from(PARTS_OF_TURN);
            // Between two of the outlines a corner runs on an arc: it stays inside the tangents at both ends.
            let bulge = 1.0 / (0.125 * part).cos();
            std::array::from_fn(|j| {
                let yaws = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| from + part * (j as f64 + share));
                let outlines = yaws.iter().flat_map(|yaw| {
                    let pose = at_rest(*yaw);
                    corners.iter().map(move |corner| pose.transform_point(*corner * bulge))
                });
                hull(&outlines.collect::<Vec<_>>())
            })
        };
        let around = space.footprint().circumscribed_radius();
        Some(Self {
            space,
            places: i64::from(places),
            spacing,
            width: i64::from(spec.width) * i64::from(places),
            height: i64::from(spec.height) * i64::from(places),
            steps: STEPS.iter().enumerate().map(step).collect(),
            turns: (0..STEPS.len()).map(turn).collect(),
            standing: (0..STEPS.len())
                .map(|i| {
                    let pose = at_rest(yaw_of(i));
                    corners.iter().map(|corner| pose.transform_point(*corner)).collect()
                })
                .collect(),
            roomy: around + (0.75 + 2.3 * spacing) * spec.resolution + HAIR,
        })
    }

    /// The place of a point, cells.
    fn nearest(&self, p: Point2<f64>) -> (i64, i64) {
        let place = |at: f64| (at * self.places as f64).floor() as i64;
        (place(p.x), place(p.y))
    }

    fn point(&self, (x, y): (i64, i64)) -> Point2<f64> {
        Point2::new(x as f64 + 0.5, y as f64 + 0.5) * self.spacing
    }

    fn cell(&self, (x, y): (i64, i64)) -> Cell {
        Cell::new((x / self.places) as u32, (y / self.places) as u32)
    }

    fn contains(&self, (x, y): (i64, i64)) -> bool {
        (0..self.width).contains(&x) && (0..self.height).contains(&y)
    }

    fn is_roomy(&self, place: (i64, i64)) -> bool {
        self.space.field().distance(self.cell(place)) > self.roomy
    }

    fn admits(&self, outline: &[Point2<f64>], p: Point2<f64>) -> bool {
        let mut moved = [Point2::origin(); 128];
        let moved = moved.get_mut(..outline.len());
        moved.is_some_and(|moved| {
            for (to, corner) in moved.iter_mut().zip(outline) {
                *to = corner + p.coords;
            }
            self.space.is_clear_of(moved)
        })
    }

    /// Whether the footprint stands anywhere in a cell, with any heading.
    fn admits_cell(&self, cell: Cell) -> bool {
        let distance = self.space.field().distance(cell);
        let beside = 0.5 * std::f64::consts::SQRT_2 * self.space.spec().resolution;
        let footprint = self.space.footprint();
        if self.space.forbidden().get(cell) || distance + beside <= footprint.inscribed_radius() {
            return false;
        }
        let (x, y) = (i64::from(cell.x) * self.places, i64::from(cell.y) * self.places);
        let mut places = (0..self.places).flat_map(|dy| (0..self.places).map(move |dx| (x + dx, y + dy)));
        distance > footprint.circumscribed_radius() + HAIR
            || places.any(|place| {
                self.standing
                    .iter()
                    .any(|outline| self.admits(outline, self.point(place)))
            })
    }

    fn can_step(&self, place: (i64, i64), to: (i64, i64), heading: usize) -> bool {
        let spec = self.space.spec();
        let [a, b] = [place, to].map(|place| spec.from_cells(self.point(place)));
        self.space.is_permitted_between(a, b)
            && (self.is_roomy(place) || self.admits(&self.steps[heading], self.point(place)))
    }

    /// Whether there is room to turn all the way round.
    fn can_turn_round(&self, place: (i64, i64)) -> bool {
        (0..STEPS.len()).all(|heading| self.can_turn(place, heading))
    }

    /// From `heading` to the next one, or back.
    fn can_turn(&self, place: (i64, i64), heading: usize) -> bool {
        self.is_roomy(place)
            || self.turns[heading]
                .iter()
                .all(|part| self.admits(part, self.point(place)))
    }
}

/// A place and a heading.
type Node = u64;

/// The best way known to a node.
struct Reached {
    cost: u32,
    /// The node before; a start's own number beyond [`STARTS`].
    before: u64,
    /// Turned since the place was come to, rad: robots turn the shorter way round.
    turned: f32,
    closed: bool,
}

/// Nodes before the first ones are numbers of starts from here on.
const STARTS: u64 = 1 << 63;

/// Hashes a node: one multiplication, its high bits first.
#[derive(Default)]
struct NodeHasher(u64);

impl Hasher for NodeHasher {
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u64(u64::from(*byte));
        }
    }

    fn write_u64(&mut self, node: u64) {
        self.0 = (self.0 ^ node).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    }

    fn finish(&self) -> u64 {
        self.0.rotate_left(26)
    }
}

/// Costs are whole numbers of this part of a cell's side.
const UNIT: f64 = 1024.0;
/// The estimate counts so many times, in halves: the way may be as much longer, and hardly ever is; the search looks at far less.
const HALVES: u32 = 3;
/// Places and headings that are looked at, at most: some seconds.
const MOST_NODES: u64 = 2_000_000;
/// A place and heading takes as long as so many cells of a search.
const CELLS_A_NODE: u64 = 16;

fn estimate(cost: u32, left: u32) -> u32 {
    cost.saturating_add((left / 2).saturating_mul(HALVES))
}

fn expand(
    footing: &Footing<'_>,
    costs: &impl CellCost,
    query: &Query,
    budget: Budget<'_>,
    expansions: &mut u64,
) -> Result<Vec<Point2<f64>>, NotFound> {
    let space = footing.space;
    let spec = space.spec();
    let goal = spec.to_cells(query.goal);
    let (first, last) = (spec.cell_at(query.start), spec.cell_at(query.goal));
    let (Some(first), Some(last)) = (first, last) else {
        return Err(NotFound::OutOfMap);
    };
    let Some(left) = Left::new(footing, costs, first, last, budget, expansions)? else {
        return Err(NotFound::NoPath);
    };
    let node = |(x, y): (i64, i64), heading: usize| ((y * footing.width + x) as u64) << 4 | heading as u64;
    let mut reached: HashMap<Node, Reached, BuildHasherDefault<NodeHasher>> = HashMap::default();
    let mut open: BinaryHeap<Reverse<(u32, Node)>> = BinaryHeap::new();
    let starts = starts(footing, query);
    for (number, start) in starts.iter().enumerate() {
        let cost = (start.length / spec.resolution * UNIT) as u32;
        let at = node(start.place, start.heading);
        if reached.get(&at).is_none_or(|known| cost < known.cost) {
            let begun = Reached {
                cost,
                before: STARTS + number as u64,
                turned: start.turned as f32,
                closed: false,
            };
            reached.insert(at, begun);
            open.push(Reverse((estimate(cost, left.from(footing.cell(start.place))), at)));
        }
    }
    let mut nodes = 0;
    // So that the budget's flag is looked at now and then.
    *expansions = expansions.next_multiple_of(CELLS_A_NODE);
    let turn_cost = (TURN / spec.resolution * UNIT) as u32;
    while let Some(Reverse((_, at))) = open.pop() {
        let Some(known) = reached.get_mut(&at).filter(|known| !known.closed) else {
            continue;
        };
        known.closed = true;
        let (cost, since) = (known.cost, known.turned);
        nodes += 1;
        if nodes > MOST_NODES {
            break;
        }
        *expansions += CELLS_A_NODE;
        if budget.is_spent(*expansions) {
            return Err(NotFound::TimedOut);
        }
        let (index, heading) = ((at >> 4) as i64, (at & 15) as usize);
        let place = (index % footing.width, index / footing.width);
        if arrives(footing, place, yaw_of(heading) - f64::from(since), goal) {
            return Ok(trace(footing, &reached, &starts, at, query));
        }
        let mut reach = |place: (i64, i64), heading: usize, step: u32, turned: f32| {
            let (next, cost) = (node(place, heading), cost.saturating_add(step));
            if reached
                .get(&next)
                .is_none_or(|known| !known.closed && cost < known.cost)
            {
                let better = Reached {
                    cost,
                    before: at,
                    turned,
                    closed: false,
                };
                reached.insert(next, better);
                open.push(Reverse((estimate(cost, left.from(footing.cell(place))), next)));
            }
        };
        let (x, y) = STEPS[heading];
        let to = (place.0 + x, place.1 + y);
        if footing.contains(to) && footing.can_step(place, to, heading) {
            let extra = f64::from(costs.extra(footing.cell(to))) / f64::from(PARTS);
            let length = footing.spacing * ((x * x + y * y) as f64).sqrt();
            reach(to, heading, (length * (1.0 + extra) * UNIT) as u32, 0.0);
        }
        let (next, previous) = ((heading + 1) % STEPS.len(), (heading + STEPS.len() - 1) % STEPS.len());
        for (to, between) in [(next, heading), (previous, previous)] {
            let turned = since + wrap_angle(yaw_of(to) - yaw_of(heading)) as f32;
            let is_shorter = turned.abs() < HALF_TURN || footing.can_turn_round(place);
            if is_shorter && footing.can_turn(place, between) {
                reach(place, to, turn_cost, turned);
            }
        }
    }
    Err(NotFound::NoPath)
}

/// How a search begins: at a place with a heading, after a few straight legs (m) from the start.
struct Start {
    corners: Vec<Point2<f64>>,
    length: f64,
    place: (i64, i64),
    heading: usize,
    /// Turned at the place into the heading, rad.
    turned: f64,
}

/// Every place beside the start, or straight on from it, where the robot can turn to a heading.
fn starts(footing: &Footing<'_>, query: &Query) -> Vec<Start> {
    let mut starts = Vec::new();
    match query.heading {
        Some(yaw) => starts_with(footing, query.start, yaw, &mut starts),
        None => (0..STEPS.len())
            .map(yaw_of)
            .filter(|yaw| {
                let pose = Pose2::new(query.start.x, query.start.y, *yaw);
                footing.space.is_valid(pose)
            })
            .for_each(|yaw| starts_with(footing, query.start, yaw, &mut starts)),
    }
    starts
}

fn starts_with(footing: &Footing<'_>, start: Point2<f64>, heading: f64, starts: &mut Vec<Start>) {
    let (space, spec) = (footing.space, footing.space.spec());
    let spacing = footing.spacing * spec.resolution;
    let ahead = Vector2::new(heading.cos(), heading.sin());
    let known = starts.len();
    for i in 0..=(STRAIGHT_ON / spacing) as u32 {
        let from = start + ahead * (spacing * f64::from(i));
        if i > 0 && space.leg_clearance(start, from, HAIR) < HAIR {
            break;
        }
        // Places beside the line ahead take a small turn only.
        for near in [from, from + ahead * (spacing * FAR)] {
            let (x, y) = footing.nearest(spec.to_cells(near));
            for place in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy))) {
                let to = spec.from_cells(footing.point(place));
                let leg = to - from;
                let is_there = leg.norm() < 1e-9;
                let along = if is_there { heading } else { leg.y.atan2(leg.x) };
                let goes = || {
                    space.turn_is_free(from, heading, along)
                        && space.leg_clearance(from, to, HAIR) >= HAIR
                        && space.is_permitted_between(from, to)
                };
                if !footing.contains(place) || !(is_there || goes()) {
                    continue;
                }
                let corners = if i > 0 { vec![start, from, to] } else { vec![start, to] };
                for into in 0..STEPS.len() {
                    let turned = wrap_angle(yaw_of(into) - along);
                    // What is farther off comes by turns from heading to heading.
                    if turned.abs() < 0.5 && space.turn_is_free(to, along, yaw_of(into)) {
                        starts.push(Start {
                            corners: corners.clone(),
                            length: spacing * f64::from(i) + leg.norm(),
                            place,
                            heading: into,
                            turned,
                        });
                    }
                }
            }
        }
        if starts.len() > known {
            break;
        }
    }
}

/// Whether the goal (cells) is at a place that was come to with a heading (rad), or a last turn and a last leg away.
fn arrives(footing: &Footing<'_>, place: (i64, i64), heading: f64, goal: Point2<f64>) -> bool {
    let space = footing.space;
    let at = footing.point(place);
    let leg = goal - at;
    if leg.norm() < 1e-9 {
        return true;
    }
    let is_beside = leg.amax() < 1.01 * footing.spacing;
    let turn = wrap_angle(leg.y.atan2(leg.x) - heading).abs();
    // From farther away with a small turn only.
    if !is_beside && (leg.norm() > FAR * footing.spacing || turn > 0.2) {
        return false;
    }
    let [from, to] = [at, goal].map(|p| space.spec().from_cells(p));
    space.leg_clearance(from, to, HAIR) >= HAIR
        && space.is_permitted_between(from, to)
        && space.turn_is_free(from, heading, leg.y.atan2(leg.x))
}

/// The corners of the way to a node, and on to the goal.
fn trace<S>(
    footing: &Footing<'_>,
    reached: &HashMap<Node, Reached, S>,
    starts: &[Start],
    last: Node,
    query: &Query,
) -> Vec<Point2<f64>>
where
    S: std::hash::BuildHasher,
{
    let spec = footing.space.spec();
    let mut points = vec![query.goal];
    let mut at = last;
    loop {
        let index = (at >> 4) as i64;
        points.push(spec.from_cells(footing.point((index % footing.width, index / footing.width))));
        match reached.get(&at) {
            Some(known) if known.before < STARTS => at = known.before,
            Some(known) => {
                let start = &starts[(known.before - STARTS) as usize];
                points.extend(start.corners.iter().rev().skip(1));
                break;
            }
            None => break,
        }
    }
    points.reverse();
    let mut corners: Vec<Point2<f64>> = Vec::new();
    for point in points {
        if corners.last().is_some_and(|last| (point - last).norm() < 1e-9) {
            continue;
        }
        if let [.., a, b] = corners[..] {
            let (before, after) = (b - a, point - b);
            let across = before.x * after.y - before.y * after.x;
            if across.abs() < 1e-9 && before.dot(&after) > 0.0 {
                corners.pop();
            }
        }
        corners.push(point);
    }
    corners
}

/// What is left to the goal at least, from each cell.
struct Left {
    width: u32,
    cost: Vec<u32>,
    /// Cells that were not looked at are not nearer than this.
    beyond: u32,
}

/// Where nobody came.
const NEVER: u32 = u32::MAX;

impl Left {
    /// From the goal backwards until the start; `None` when it is not reached.
    fn new(
        footing: &Footing<'_>,
        costs: &impl CellCost,
        start: Cell,
        goal: Cell,
        budget: Budget<'_>,
        expansions: &mut u64,
    ) -> Result<Option<Self>, NotFound> {
        let spec = footing.space.spec();
        let mut cost = vec![NEVER; spec.len()];
        let mut refused = BitGrid::new(spec.width, spec.height);
        let mut open = BinaryHeap::from([Reverse((0_u32, spec.index(goal) as u32))]);
        cost[spec.index(goal)] = 0;
        while let Some(Reverse((known, index))) = open.pop() {
            let cell = spec.cell(index as usize);
            if known > cost[index as usize] {
                continue;
            }
            if cell == start {
                let width = spec.width;
                let beyond = known;
                return Ok(Some(Self { width, cost, beyond }));
            }
            if budget.is_spent(*expansions) {
                return Err(NotFound::TimedOut);
            }
            *expansions += 1;
            let part = 1.0 + f64::from(costs.extra(cell)) / f64::from(PARTS);
            for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
                let (x, y) = (i64::from(cell.x) + dx, i64::from(cell.y) + dy);
                if (dx, dy) == (0, 0) || !spec.contains(x, y) {
                    continue;
                }
                let next = Cell::new(x as u32, y as u32);
                let step = if dx != 0 && dy != 0 {
                    std::f64::consts::SQRT_2
                } else {
                    1.0
                };
                let better = known.saturating_add((step * part * UNIT) as u32);
                let known = cost[spec.index(next)];
                if better >= known || refused.get(next) {
                    continue;
                }
                if known == NEVER && !footing.admits_cell(next) {
                    refused.set(next, true);
                    continue;
                }
                cost[spec.index(next)] = better;
                open.push(Reverse((better, spec.index(next) as u32)));
            }
        }
        Ok(None)
    }

    fn from(&self, cell: Cell) -> u32 {
        self.cost[cell.y as usize * self.width as usize + cell.x as usize].min(self.beyond)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use proptest::prelude::*;
    use zenav_protocol::grid::{Grid, GridSpec, Occupancy, OccupancyGrid};

    use super::super::astar::Uniform;
    use super::*;
    use crate::space::UnknownPolicy;

    /// 0.8 m long, 0.3 m wide, the base at a third of its length.
    fn long() -> Footprint {
        let outline = [(-0.5, -0.15), (0.3, -0.15), (0.3, 0.15), (-0.5, 0.15)];
        Footprint::Polygon(outline.iter().map(|(x, y)| Point2::new(*x, *y)).collect())
    }

    /// A room of 6 m by 4 m, 5 cm cells, of which `is_wall` says where the walls are (m).
    fn room(is_wall: impl Fn(f64, f64) -> bool) -> OccupancyGrid {
        let spec = GridSpec {
            origin: Point2::origin(),
            resolution: 0.05,
            width: 120,
            height: 80,
        };
        let mut grid = Grid::filled(spec, Occupancy::FREE);
        for y in 0..80 {
            for x in 0..120 {
                let center = spec.center(Cell::new(x, y));
                if x == 0 || y == 0 || x == 119 || y == 79 || is_wall(center.x, center.y) {
                    grid[Cell::new(x, y)] = Occupancy::OCCUPIED;
                }
            }
        }
        grid
    }

    fn way(grid: &OccupancyGrid, start: Pose2, goal: (f64, f64), any: bool) -> Result<Vec<Point2<f64>>, NotFound> {
        let space = ConfigurationSpace::new(grid, &long(), UnknownPolicy::Blocked, 0.0);
        let heading = (!any).then_some(start.yaw);
        let query = Query {
            start: start.position(),
            heading,
            goal: Point2::new(goal.0, goal.1),
        };
        let found = search(&space, &Uniform, &query, Budget::UNLIMITED).result;
        if let Ok(way) = &found {
            assert!(is_drivable(&space, way, heading), "{way:?}");
            assert_eq!((way[0], way[way.len() - 1]), (query.start, query.goal));
        }
        found
    }

    #[test]
    fn a_long_robot_goes_through_a_gap_that_it_only_fits_lengthways() {
        // A gap of 0.4 m in a wall of 1 m.
        let grid = room(|x, y| (2.5..3.5).contains(&x) && !(1.8..2.2).contains(&y));
        let found = way(&grid, Pose2::new(1.0, 1.0, 0.0), (5.0, 3.0), false).unwrap();
        assert!(found.len() >= 4);
    }

    #[test]
    fn where_there_is_no_room_to_turn_there_is_no_way() {
        // A gap of 0.45 m round a corner.
        let grid = room(|x, y| {
            let along = x < 4.5 && (1.0..1.45).contains(&y);
            let up = (4.05..4.5).contains(&x) && (1.0..3.0).contains(&y);
            x > 1.5 && !along && !up
        });
        assert_eq!(
            way(&grid, Pose2::new(1.0, 1.225, 0.0), (4.275, 2.9), false),
            Err(NotFound::NoPath)
        );
        assert!(way(&grid, Pose2::new(2.0, 1.225, 0.0), (4.0, 1.225), false).is_ok());
    }

    #[test]
    fn a_robot_that_cannot_turn_where_it_stands_goes_on_to_where_it_can() {
        let grid = room(|x, y| x < 2.0 && !(1.8..2.2).contains(&y));
        let start = Pose2::new(0.8, 2.0, 0.0);
        let found = way(&grid, start, (5.0, 1.0), false).unwrap();
        assert!((found[1].y - 2.0).abs() < 0.05 && found[2].x > 2.0, "{found:?}");
        assert!(way(&grid, Pose2 { yaw: 1.5, ..start }, (5.0, 1.0), false).is_err());
        assert!(way(&grid, Pose2 { yaw: 1.5, ..start }, (5.0, 1.0), true).is_ok());
    }

    #[test]
    fn coarse_cells_leave_places_between_their_centres() {
        let spec = GridSpec {
            origin: Point2::origin(),
            resolution: 0.2,
            width: 30,
            height: 20,
        };
        let mut grid = Grid::filled(spec, Occupancy::FREE);
        for y in 0..20 {
            // Two cells: the only place to go through is the border between them.
            if y != 9 && y != 10 {
                grid[Cell::new(15, y)] = Occupancy::OCCUPIED;
            }
        }
        assert!(way(&grid, Pose2::new(1.0, 1.0, 0.0), (5.0, 3.0), false).is_ok());
    }

    #[test]
    fn a_search_without_budget_times_out() {
        let space = ConfigurationSpace::new(&room(|_, _| false), &long(), UnknownPolicy::Blocked, 0.0);
        let query = Query {
            start: Point2::new(1.0, 1.0),
            heading: None,
            goal: Point2::new(5.0, 3.0),
        };
        for max_expansions in [10, 5000] {
            let budget = Budget {
                max_expansions,
                cancel: None,
            };
            assert_eq!(search(&space, &Uniform, &query, budget).result, Err(NotFound::TimedOut));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn whatever_is_found_can_be_driven(
            boxes in prop::collection::vec((0.3..5.5_f64, 0.3..3.5_f64, 0.1..0.8_f64, 0.1..0.8_f64), 0..9),
            ends in prop::array::uniform2((0.3..5.7_f64, 0.3..3.7_f64)), yaw in -3.1..3.1_f64, any in any::<bool>(),
        ) {
            let grid = room(|x, y| boxes.iter().any(|(left, low, w, h)| (*left..left + w).contains(&x) && (*low..low + h).contains(&y)));
            let [start, goal] = ends;
            let _ = way(&grid, Pose2::new(start.0, start.1, yaw), goal, any);
        }
    }
}
