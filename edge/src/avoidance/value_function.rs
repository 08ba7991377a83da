//! Space-time value function. How long does it take from a place and a time to the end of the plan, among static and moving obstacles?
//!
//! Dynamic programming backwards in time over a small grid around the robot, in layers of time up to the horizon; waiting is a move (after
//! Silver, "Cooperative pathfinding", AIIDE 2005). Beyond the horizon nothing moves.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::Range;

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::robot::RobotModel;

use super::{AvoidanceInput, cell_of, kept, lead};
use crate::blind_spot_grid::Floor;
use crate::field_of_view::rigid;
use crate::obstacle_tracks::Track;
use crate::settings::AvoidanceSettings;

/// Cells a side of the value function.
const SIDE: usize = 48;
const CELLS: usize = SIDE * SIDE;
/// Time layers of the value function.
const LAYERS: usize = 24;
/// Cost of a place from which the end cannot be reached, s.
const NO_WAY: f32 = 1e4;
/// Cost of being beside a track, as a share of the time spent there.
const NEARNESS: f32 = 6.0;
/// Cost of one time layer on a robot that announces its course, s: finite, so that the least bad course can be found.
const HIT: f32 = 60.0;
/// Cost of a turn, as a share of its duration at the top yaw rate.
const TURN_COST: f64 = 0.6;
/// Driving backwards counts as a turn by this much, rad.
const BACKWARDS_TURN: f64 = 0.8;
/// Floor this near to the plan counts as free even where no lidar sees it, m.
const ALONG_PLAN: f64 = 0.3;
/// Largest speed assumed, m/s: at higher speeds the cells would be too coarse for a door.
const MOST_SPEED: f64 = 1.6;
/// Distance kept from static obstacles and from a track's disc, beyond the inscribed radius, m.
const LEAST_CLEARANCE: f64 = 0.03;

/// The time to the end of the plan from the places around the robot.
#[derive(Clone, Debug)]
pub(super) struct ValueFunction {
    settings: AvoidanceSettings,
    /// Radius kept free, m.
    inscribed: f64,
    /// Side of a cell, m, and time of a layer, s.
    cell: f64,
    layer: f64,
    /// Lower-left corner, odometry frame.
    origin: Point2<f64>,
    /// Least value of a cell: [`NO_WAY`] where the robot cannot be.
    floor: Vec<f32>,
    /// Time to the end of the plan from each cell of each layer, s.
    values: Vec<f32>,
    /// By layer and cell: whether a robot with right of way is there.
    hits: Vec<bool>,
}

/// Moves to the neighbours of a cell: offset of the index, and duration in layers.
const NEIGHBOURS: [(isize, f32); 8] = [
    (1, 1.0),
    (-1, 1.0),
    (SIDE as isize, 1.0),
    (-(SIDE as isize), 1.0),
    (SIDE as isize + 1, std::f32::consts::SQRT_2),
    (SIDE as isize - 1, std::f32::consts::SQRT_2),
    (1 - SIDE as isize, std::f32::consts::SQRT_2),
    (-1 - SIDE as isize, std::f32::consts::SQRT_2),
];

/// Computes a layer from the next one and the last one. Row by row and without branches, so that the compiler vectorises it.
fn step_back(step: f32, floor: &[f32], [next, last]: [&[f32]; 2], now: &mut [f32]) {
    // `f32::min` and `max` also check for NaN.
    let less = |a: f32, b: f32| if a < b { a } else { b };
    let more = |a: f32, b: f32| if a > b { a } else { b };
    let diagonal = step * std::f32::consts::SQRT_2;
    let (next, last, floor) = (rows(next), rows(last), rows(floor));
    for (row, now) in now.as_chunks_mut::<SIDE>().0.iter_mut().enumerate() {
        let (here, last, floor) = (&next[row], &last[row], &floor[row]);
        let mut least = [0.0; SIDE];
        for column in 0..SIDE {
            // At the end of the plan waiting costs nothing.
            least[column] = here[column] + if last[column] < step { 0.0 } else { step };
        }
        if (1..SIDE - 1).contains(&row) {
            let (below, above) = (&next[row - 1], &next[row + 1]);
            let mut beside = [0.0; SIDE];
            for column in 0..SIDE {
                beside[column] = less(below[column], above[column]);
            }
            for column in 1..SIDE - 1 {
                let straight = less(less(here[column - 1], here[column + 1]), beside[column]);
                let aslant = less(beside[column - 1], beside[column + 1]);
                least[column] = less(least[column], less(straight + step, aslant + diagonal));
            }
        }
        for column in 0..SIDE {
            now[column] = less(more(least[column], floor[column]), NO_WAY);
        }
    }
}

/// A layer as its rows.
fn rows(layer: &[f32]) -> &[[f32; SIDE]] {
    layer.as_chunks::<SIDE>().0
}

impl ValueFunction {
    /// A value function for a robot of this model, over the horizon of the settings.
    pub(super) fn new(model: &RobotModel, settings: &AvoidanceSettings) -> Self {
        let layer = settings.horizon / LAYERS as f64;
        Self {
            settings: settings.clone(),
            inscribed: model.footprint.inscribed_radius(),
            cell: (layer * model.drive.top_speed().min(MOST_SPEED)).max(0.02),
            layer,
            origin: Point2::origin(),
            floor: vec![0.0; CELLS],
            values: vec![NO_WAY; CELLS * (LAYERS + 1)],
            hits: vec![false; CELLS * LAYERS],
        }
    }

    /// Time of a layer, s.
    pub(super) fn layer(&self) -> f64 {
        self.layer
    }

    fn center(&self, index: usize) -> Point2<f64> {
        let (column, row) = ((index % SIDE) as f64 + 0.5, (index / SIDE) as f64 + 0.5);
        self.origin + Vector2::new(column, row) * self.cell
    }

    /// Columns and rows of the cells around a disc.
    fn around(&self, center: Point2<f64>, radius: f64) -> [Range<usize>; 2] {
        let low = (center - self.origin) / self.cell - Vector2::repeat(radius / self.cell + 0.5);
        let high = (center - self.origin) / self.cell + Vector2::repeat(radius / self.cell - 0.5);
        let range = |low: f64, high: f64| {
            let last = SIDE as f64;
            (low.ceil().clamp(0.0, last) as usize)..((high.floor() + 1.0).clamp(0.0, last) as usize)
        };
        [range(low.x, high.x), range(low.y, high.y)]
    }

    /// The cells whose centers lie in a disc.
    fn disc(&self, center: Point2<f64>, radius: f64) -> impl Iterator<Item = usize> + use<> {
        let (origin, cell) = (self.origin, self.cell);
        let [columns, rows] = self.around(center, radius);
        rows.flat_map(move |row| columns.clone().map(move |column| (column, row)))
            .filter(move |(column, row)| {
                let at = origin + Vector2::new(*column as f64 + 0.5, *row as f64 + 0.5) * cell;
                (at - center).norm_squared() <= radius * radius
            })
            .map(|(column, row)| row * SIDE + column)
    }

    /// Computes all values; obstacles that lean on the robot count as static.
    pub(super) fn fill(
        &mut self,
        input: &AvoidanceInput<'_>,
        standing: &[Point2<f64>],
        tracks: &[&Track],
        leaning: &[&Track],
    ) {
        let here = input.odom_from_base.position();
        self.origin = here - Vector2::repeat(0.5 * SIDE as f64 * self.cell);
        self.block(input, standing, leaning);
        self.static_values(input);
        self.hits.fill(false);
        // Backwards in time.
        for nth in (0..LAYERS).rev() {
            let (before, after) = self.values.split_at_mut((nth + 1) * CELLS);
            let (now, next) = (&mut before[nth * CELLS..], &after[..CELLS]);
            let last = &after[(LAYERS - nth - 1) * CELLS..];
            step_back(self.layer as f32, &self.floor, [next, last], now);
            for track in tracks {
                self.add_track(nth, track, input.now.secs_since(track.stamp));
            }
        }
    }

    /// Makes the cells of a layer impassable that a track occupies then or in the moments after, and the cells beside them costly.
    fn add_track(&mut self, nth: usize, track: &Track, age: f64) {
        let secs = self.layer * nth as f64;
        let Some(kept) = kept(&self.settings, track, secs) else {
            return;
        };
        let path = track.path(secs + age, lead(&self.settings, track));
        let near = track.radius + self.inscribed + LEAST_CLEARANCE;
        let far = near.max(track.radius + self.inscribed + kept);
        let (middle, reach) = path.disc();
        let [columns, rows] = self.around(middle, far + reach);
        let xs: [f32; SIDE] = std::array::from_fn(|column| (column as f32 + 0.5) * self.cell as f32);
        let (near, far, cost) = (near as f32, far as f32, NEARNESS * self.layer as f32);
        let per_depth = 1.0 / (far - near).max(1e-6);
        let mut distances = [0.0; SIDE];
        for row in rows {
            let (xs, y) = (&xs[columns.clone()], (row as f32 + 0.5) * self.cell as f32);
            let distances = &mut distances[columns.clone()];
            path.distances(self.origin, xs, y, distances);
            let start = nth * CELLS + row * SIDE;
            let values = &mut self.values[start..][columns.clone()];
            let hits = &mut self.hits[start..][columns.clone()];
            let taken = |value: f32| if track.is_robot() { value + HIT } else { NO_WAY };
            for (value, distance) in values.iter_mut().zip(&*distances) {
                let depth = (far - distance) * per_depth;
                let beside = *value + cost * if depth > 0.0 { depth } else { 0.0 };
                let with = if *distance > near { beside } else { taken(*value) };
                *value = if with < NO_WAY { with } else { NO_WAY };
            }
            if track.is_robot() {
                for (hit, distance) in hits.iter_mut().zip(&*distances) {
                    *hit |= *distance <= near && !track.makes_way();
                }
            }
        }
    }

    /// Writes the best course from a place into `out`, one point per layer; returns in how many layers it meets a robot with right of way.
    pub(super) fn course(&self, from: Point2<f64>, out: &mut Vec<Point2<f64>>) -> u32 {
        out.clear();
        let Some(mut index) = cell_of(from, self.origin, self.cell, SIDE) else {
            return 0;
        };
        out.push(from);
        let mut hits = 0;
        for nth in 1..=LAYERS {
            let layer = &self.values[nth * CELLS..][..CELLS];
            let (row, column) = (index / SIDE, index % SIDE);
            if (1..SIDE - 1).contains(&row) && (1..SIDE - 1).contains(&column) {
                let step = self.layer as f32;
                let mut least = layer[index] + step;
                let here = index;
                for (shift, steps) in &NEIGHBOURS {
                    let there = (here as isize + shift) as usize;
                    let value = layer[there] + step * steps;
                    if value < least {
                        (least, index) = (value, there);
                    }
                }
            }
            // The first layers do not count: nothing can be changed there any more.
            hits += u32::from(nth > 2 && nth < LAYERS && self.hits[nth * CELLS + index]);
            out.push(self.center(index));
        }
        hits
    }

    /// Marks the cells that the robot cannot be in: too near to a static obstacle, or not seen free.
    fn block(&mut self, input: &AvoidanceInput<'_>, standing: &[Point2<f64>], leaning: &[&Track]) {
        let odom_from_base = rigid(input.odom_from_base);
        let base_from_odom = odom_from_base.inverse();
        let grid = input.obstacles.blind_spots();
        for index in 0..CELLS {
            let at = self.center(index);
            let place = base_from_odom * at;
            let is_free = if grid.in_blind_spot(place) {
                matches!(grid.floor(&odom_from_base, place), Floor::Free)
            } else {
                input.obstacles.is_seen_free(at)
            };
            self.floor[index] = if is_free { 0.0 } else { NO_WAY };
        }
        let along = input.ahead.iter().map(|ahead| (ahead.pose.position(), ALONG_PLAN, 0.0));
        let around = (input.odom_from_base.position(), 1.5 * self.inscribed, 0.0);
        let standing = standing.iter().map(|point| (*point, 0.0));
        let leaning = leaning.iter().map(|track| (track.position, track.radius));
        // An obstacle in contact does not block the robot's own cell.
        let here = input.odom_from_base.position();
        let blocking = standing.chain(leaning).map(|(place, radius)| {
            let kept = (radius + self.inscribed + LEAST_CLEARANCE).min((place - here).norm() - 0.01);
            (place, kept, NO_WAY)
        });
        for (place, radius, floor) in along.chain([around]).chain(blocking) {
            for index in self.disc(place, radius) {
                self.floor[index] = floor;
            }
        }
    }

    /// Fills the last layer with the time to the end of the plan among static obstacles: Dijkstra from the plan.
    fn static_values(&mut self, input: &AvoidanceInput<'_>) {
        let last = LAYERS * CELLS;
        let end = input.ahead.last().map_or(0.0, |ahead| ahead.secs);
        let values = &mut self.values[last..];
        values.fill(NO_WAY);
        // Times as integers, ms: the heap needs a total order.
        let mut open = BinaryHeap::new();
        let mut reach = |open: &mut BinaryHeap<_>, index: usize, secs: f32| {
            let millis = (1e3 * secs) as u32;
            if self.floor[index] < NO_WAY && 1e-3 * (millis as f32) < values[index] {
                values[index] = 1e-3 * millis as f32;
                open.push((Reverse(millis), index));
            }
        };
        for ahead in input.ahead {
            if let Some(index) = cell_of(ahead.pose.position(), self.origin, self.cell, SIDE) {
                reach(&mut open, index, (end - ahead.secs) as f32);
            }
        }
        let mut done = [false; CELLS];
        while let Some((Reverse(millis), index)) = open.pop() {
            let (row, column) = (index / SIDE, index % SIDE);
            if std::mem::replace(&mut done[index], true)
                || !(1..SIDE - 1).contains(&row)
                || !(1..SIDE - 1).contains(&column)
            {
                continue;
            }
            for (shift, steps) in &NEIGHBOURS {
                let there = (index as isize + shift) as usize;
                reach(&mut open, there, 1e-3 * millis as f32 + 1.2 * self.layer as f32 * steps);
            }
        }
    }

    /// Time to the end from a pose `secs` from now, s: interpolated between the cells around it, plus the turn towards the best neighbour.
    pub(super) fn at(&self, pose: Pose2, secs: f64, yaw_rate: f64) -> f64 {
        let nth = ((secs / self.layer).round() as usize).min(LAYERS);
        let layer = &self.values[nth * CELLS..(nth + 1) * CELLS];
        let off = (pose.position() - self.origin) / self.cell - Vector2::repeat(0.5);
        let (column, row) = (off.x.floor(), off.y.floor());
        if !(0.0..SIDE as f64 - 1.0).contains(&column) || !(0.0..SIDE as f64 - 1.0).contains(&row) {
            return f64::from(NO_WAY);
        }
        let (share_x, share_y) = (off.x - column, off.y - row);
        let corner = row as usize * SIDE + column as usize;
        let corners = [
            (corner, (1.0 - share_x) * (1.0 - share_y)),
            (corner + 1, share_x * (1.0 - share_y)),
            (corner + SIDE, (1.0 - share_x) * share_y),
            (corner + SIDE + 1, share_x * share_y),
        ];
        // A cell without a way to the end adds a bounded cost, and does not dominate the others.
        let ways = corners
            .iter()
            .map(|(index, share)| (f64::from(layer[*index]), share))
            .filter(|(value, _)| *value < f64::from(NO_WAY));
        let (sum, weight) = ways.fold((0.0, 0.0), |(sum, weight), (value, share)| {
            (sum + value * share, weight + share)
        });
        if weight < 1e-3 {
            return f64::from(NO_WAY);
        }
        let value = sum / weight + 2.0 * (1.0 - weight);
        let nearest = (off.y.round() as usize).clamp(1, SIDE - 2) * SIDE + (off.x.round() as usize).clamp(1, SIDE - 2);
        let next = &self.values[(nth + 1).min(LAYERS) * CELLS..][..CELLS];
        let wait = next[nearest] + self.layer as f32;
        let moves = NEIGHBOURS.iter().map(|(shift, steps)| {
            let there = (nearest as isize + shift) as usize;
            (next[there] + self.layer as f32 * steps, there)
        });
        let best = moves
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .filter(|(secs, _)| *secs < wait);
        let turn = best.map_or(0.0, |(_, there)| {
            let toward = self.center(there) - self.center(nearest);
            let turn = wrap_angle(toward.y.atan2(toward.x) - pose.yaw).abs();
            turn.min(std::f64::consts::PI - turn + BACKWARDS_TURN)
        });
        value + TURN_COST * turn / yaw_rate.max(0.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layer_is_the_best_of_waiting_and_the_eight_moves() {
        let mut state = 1_u32;
        let mut share = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let mut layer = |no_way: f32, most: f32| -> Vec<f32> {
            let value = |share: f32, other: f32| if share < no_way { NO_WAY } else { most * other };
            (0..CELLS).map(|_| value(share(), share())).collect()
        };
        let (floor, next, last) = (layer(0.2, 0.0), layer(0.1, 8.0), layer(0.1, 1.0));
        let (step, mut now) = (0.16, vec![0.0; CELLS]);
        step_back(step, &floor, [&next, &last], &mut now);
        for index in 0..CELLS {
            let (row, column) = (index / SIDE, index % SIDE);
            let mut least = next[index] + if last[index] < step { 0.0 } else { step };
            if (1..SIDE - 1).contains(&row) && (1..SIDE - 1).contains(&column) {
                let there = |shift: isize| next[(index as isize + shift) as usize];
                let moves = NEIGHBOURS.iter().map(|(shift, steps)| there(*shift) + step * steps);
                least = moves.fold(least, f32::min);
            }
            let expected = if floor[index] > 0.0 { NO_WAY } else { least.min(NO_WAY) };
            assert_eq!(now[index], expected, "row {row}, column {column}");
        }
    }
}
