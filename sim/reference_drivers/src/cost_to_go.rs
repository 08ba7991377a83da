//! Cost to go. Which way leads to the goal, and how far is it, past walls and people who stand?
//!
//! Fast marching (Sethian, "A fast marching level set method for monotonically advancing fronts", 1996) on cells where a metre beside an
//! obstacle costs more, as on an inflated costmap. Between cells the cost is interpolated: everywhere it has the slope of the ground.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::f64::consts::TAU;

use nalgebra::{Point2, Vector2};

use crate::cells::Cells;
use crate::driver::Disc;
use crate::field::Field;
use crate::task::DrivingTask;

/// Side of a cell, m.
const CELL: f64 = 0.1;
/// Clearance beyond the disc around the outline from which obstacles cost nothing, m.
const KEPT: f64 = 0.15;
/// What a metre costs more where the robot just fits, m.
const BESIDE: f64 = 2.0;
/// What a metre costs through a wall, and through a person, who may leave, m.
const WALL: f64 = 50.0;
const PERSON: f64 = 20.0;
/// The way is looked for at this distance, m, in so many directions.
const AHEAD: f64 = 0.3;
const DIRECTIONS: u32 = 32;
/// A cost is lowered by no less, m.
const LEAST: f32 = 1e-4;

/// Costs from every place to one goal, in metres of open floor.
pub(crate) struct CostToGo {
    cells: Cells,
    goal: Point2<f64>,
    /// Clearance at which the robot just fits, and from which obstacles cost nothing, m.
    fits: [f64; 2],
    /// What a metre costs among walls alone.
    walls: Vec<f32>,
    costs: Vec<f32>,
}

impl CostToGo {
    /// The costs in a task's world; they are infinite until [`Self::update`].
    pub(crate) fn new(task: &DrivingTask<'_>, field: &Field) -> Self {
        let (low, high) = task.world.bounds();
        let cells = Cells::new(low, high, CELL);
        let footprint = &task.model.footprint;
        let fits = [footprint.half_width(), footprint.circumscribed_radius() + KEPT];
        let wall = |cell| rate(field.clearance(cells.center(cell)), fits, WALL);
        Self {
            walls: (0..cells.count()).map(wall).collect(),
            costs: vec![f32::INFINITY; cells.count()],
            cells,
            goal: task.goal,
            fits,
        }
    }

    /// Computes the costs around people who stand.
    pub(crate) fn update(&mut self, standing: impl IntoIterator<Item = Disc>) {
        let mut rates = self.walls.clone();
        for (at, radius) in standing {
            for cell in self.cells.around(at, radius + self.fits[1]) {
                let clearance = (self.cells.center(cell) - at).norm() - radius;
                rates[cell] = rates[cell].max(rate(clearance, self.fits, PERSON));
            }
        }
        self.costs.fill(f32::INFINITY);
        let mut open = BinaryHeap::new();
        for cell in self.cells.around(self.goal, CELL) {
            self.costs[cell] = (self.cells.center(cell) - self.goal).norm() as f32;
            open.push((Reverse(self.costs[cell].to_bits()), cell));
        }
        while let Some((Reverse(bits), cell)) = open.pop() {
            if f32::from_bits(bits) > self.costs[cell] {
                continue;
            }
            for next in self.sides(cell).into_iter().flatten() {
                let cost = self.upwind(next, rates[next]);
                if cost < self.costs[next] - LEAST {
                    self.costs[next] = cost;
                    // Non-negative floats have the order of their bits.
                    open.push((Reverse(cost.to_bits()), next));
                }
            }
        }
    }

    fn sides(&self, cell: usize) -> [Option<usize>; 4] {
        [[1, 0], [-1, 0], [0, 1], [0, -1]].map(|step| self.cells.beside(cell, step))
    }

    /// Cost of a cell after its neighbours': their slopes along both axes make up what a metre costs there.
    fn upwind(&self, cell: usize, rate: f32) -> f32 {
        let [east, west, north, south] = self
            .sides(cell)
            .map(|side| side.map_or(f32::INFINITY, |side| self.costs[side]));
        let (along, across) = (east.min(west), north.min(south));
        let (low, high, step) = (along.min(across), along.max(across), CELL as f32 * rate);
        if high - low < step {
            0.5 * (low + high + (2.0 * step * step - (high - low).powi(2)).sqrt())
        } else {
            low + step
        }
    }

    /// Cost from a place, m; at least the straight distance.
    pub(crate) fn at(&self, place: Point2<f64>) -> f64 {
        self.cells
            .interpolate(&self.costs, place)
            .max((place - self.goal).norm())
    }

    /// Direction of the way from a place; zero at the goal.
    pub(crate) fn way(&self, from: Point2<f64>) -> Vector2<f64> {
        let straight = self.goal - from;
        if straight.norm() <= AHEAD {
            return straight.try_normalize(1e-9).unwrap_or_default();
        }
        (0..DIRECTIONS)
            .map(|nth| {
                let (sin, cos) = (TAU * f64::from(nth) / f64::from(DIRECTIONS)).sin_cos();
                let direction = Vector2::new(cos, sin);
                (self.at(from + direction * AHEAD), direction)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map_or_else(Vector2::zeros, |(_, direction)| direction)
    }
}

/// What a metre costs at a clearance (m); `contact` where the robot does not fit.
fn rate(clearance: f64, [least, free]: [f64; 2], contact: f64) -> f32 {
    let beside = BESIDE * ((free - clearance) / (free - least)).clamp(0.0, 1.0);
    (if clearance < least { contact } else { 1.0 + beside }) as f32
}
