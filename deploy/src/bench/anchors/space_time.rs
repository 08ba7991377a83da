//! A* over cells and time. Finds the path that is free at the time when the robot is there. Everybody's future is known; a step to one of
//! the eight surrounding cells, or a wait, takes one layer of time.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::{Point2, Vector2};

use super::{Field, Replay};
use crate::bench::suites::Case;

/// Side of a cell, m.
const CELL: f64 = 0.2;
/// Speed along a row, as a share of the top speed; diagonal steps are faster.
const SHARE: f64 = 0.65;
/// Clearance beyond contact from everybody and everything, m: nearly half a cell's diagonal.
const MARGIN: f64 = 0.12;
/// Period of replanning, s.
const AGAIN: f64 = 1.0;
/// At its start a path may violate the clearance, for so many layers.
const LENIENT: usize = 2;

/// Positions over time.
#[derive(Clone, Debug, Default)]
pub(super) struct Reference {
    begins: f64,
    layer: f64,
    points: Vec<Point2<f64>>,
}

impl Reference {
    /// The position at a time (s).
    pub(super) fn at(&self, secs: f64) -> Point2<f64> {
        let share = ((secs - self.begins) / self.layer).max(0.0);
        let point = |index: usize| {
            self.points
                .get(index)
                .or(self.points.last())
                .copied()
                .unwrap_or_default()
        };
        let from = point(share as usize);
        from + (point(share as usize + 1) - from) * share.fract()
    }
}

/// Cells, layers of time, and everybody's positions.
pub(super) struct SpaceTime {
    low: Point2<f64>,
    size: [usize; 2],
    /// Duration of a layer, s.
    layer: f64,
    /// For each layer: cells that somebody comes too close to.
    taken: Vec<Vec<bool>>,
    /// Steps to the goal around static obstacles; `None` without a path.
    steps: Vec<Option<u32>>,
    goal: Point2<f64>,
    replay: Replay,
    radii: Vec<f64>,
    reference: Reference,
}

impl SpaceTime {
    pub(super) fn new(case: &Case, field: &Field, replay: Replay, radii: &[f64]) -> Self {
        let reach = case.model.footprint.circumscribed_radius();
        let (low, sides) = field.extent();
        let size = sides.map(|side| (side / CELL).ceil() as usize);
        let layer = CELL / (SHARE * case.model.drive.top_speed());
        let mut all = Self {
            low,
            size,
            layer,
            taken: Vec::new(),
            steps: vec![None; size[0] * size[1]],
            goal: case.goal,
            replay,
            radii: radii.to_vec(),
            reference: Reference::default(),
        };
        let layers = (case.timeout / layer).ceil() as usize;
        all.taken = (0..layers).map(|index| all.near(index, reach + MARGIN)).collect();
        all.flood(|cell| field.clearance(cell) >= reach + 0.03);
        all
    }

    /// Discs of all movers at a time (s).
    pub(super) fn walkers(&self, secs: f64) -> Vec<(Point2<f64>, f64)> {
        let disc = |(mover, radius): (usize, &f64)| (self.replay.at(mover, secs), *radius);
        self.radii.iter().enumerate().map(disc).collect()
    }

    /// Cells that somebody comes within a distance of during a layer.
    fn near(&self, layer: usize, distance: f64) -> Vec<bool> {
        let mut taken = vec![false; self.size[0] * self.size[1]];
        for share in [-0.5, 0.0, 0.5] {
            for (at, radius) in self.walkers((layer as f64 + share) * self.layer) {
                let reach = radius + distance;
                let [left, right] = [-reach, reach].map(|off| ((at.x - self.low.x + off) / CELL).max(0.0) as usize);
                let [low, high] = [-reach, reach].map(|off| ((at.y - self.low.y + off) / CELL).max(0.0) as usize);
                for y in low..=high.min(self.size[1] - 1) {
                    for x in left..=right.min(self.size[0] - 1) {
                        let cell = y * self.size[0] + x;
                        taken[cell] |= (self.center(cell) - at).norm() < reach;
                    }
                }
            }
        }
        taken
    }

    fn flood(&mut self, is_free: impl Fn(Point2<f64>) -> bool) {
        let goal = self.cell(self.goal);
        let mut ring = vec![goal];
        self.steps[goal] = Some(0);
        let mut steps = 0;
        while !ring.is_empty() {
            steps += 1;
            let mut next = Vec::new();
            for cell in ring {
                for there in self.around(cell) {
                    if self.steps[there].is_none() && is_free(self.center(there)) {
                        self.steps[there] = Some(steps);
                        next.push(there);
                    }
                }
            }
            ring = next;
        }
    }

    fn cell(&self, at: Point2<f64>) -> usize {
        let index = |off: f64, size: usize| ((off / CELL).max(0.0) as usize).min(size - 1);
        index(at.y - self.low.y, self.size[1]) * self.size[0] + index(at.x - self.low.x, self.size[0])
    }

    fn center(&self, cell: usize) -> Point2<f64> {
        self.low + Vector2::new((cell % self.size[0]) as f64 + 0.5, (cell / self.size[0]) as f64 + 0.5) * CELL
    }

    /// The cell itself and its neighbours.
    fn around(&self, cell: usize) -> impl Iterator<Item = usize> + use<> {
        let [width, height] = self.size.map(|side| side as i64);
        let (x, y) = (cell as i64 % width, cell as i64 / width);
        (0..9).filter_map(move |index| {
            let (x, y) = (x + index % 3 - 1, y + index / 3 - 1);
            let inside = (0..width).contains(&x) && (0..height).contains(&y);
            inside.then(|| (y * width + x) as usize)
        })
    }

    /// The path from a place at a time (s); replanned after [`AGAIN`].
    pub(super) fn reference(&mut self, now: f64, from: Point2<f64>) -> Reference {
        if self.reference.points.is_empty() || now - self.reference.begins >= AGAIN {
            let begins = (now / self.layer) as usize;
            if let Some(points) = self.search(begins, from) {
                self.reference = Reference {
                    begins: now,
                    layer: self.layer,
                    points,
                };
            } else if self.reference.points.is_empty() {
                return Reference {
                    begins: now,
                    layer: self.layer,
                    points: vec![from],
                };
            }
        }
        self.reference.clone()
    }

    fn search(&self, begins: usize, from: Point2<f64>) -> Option<Vec<Point2<f64>>> {
        let cells = self.steps.len();
        let (start, goal) = (self.cell(from), self.cell(self.goal));
        let layers = self.taken.len().checked_sub(begins)?;
        // Predecessor of each state; the start is its own.
        let mut parents = vec![u32::MAX; cells * layers];
        let mut open = BinaryHeap::new();
        parents[start] = start as u32;
        open.push((Reverse(self.steps[start]?), 0_usize, start));
        while let Some((_, layer, cell)) = open.pop() {
            if cell == goal {
                return Some(self.way(&parents, layer, cell, from));
            }
            let next = layer + 1;
            if next >= layers {
                continue;
            }
            for there in self.around(cell) {
                let Some(left) = self.steps[there] else { continue };
                let state = next * cells + there;
                let free = next <= LENIENT || !(self.taken[begins + next][there] || self.taken[begins + layer][there]);
                if free && parents[state] == u32::MAX {
                    parents[state] = (layer * cells + cell) as u32;
                    open.push((Reverse(next as u32 + left), next, there));
                }
            }
        }
        None
    }

    fn way(&self, parents: &[u32], layer: usize, cell: usize, from: Point2<f64>) -> Vec<Point2<f64>> {
        let cells = self.steps.len();
        let mut state = layer * cells + cell;
        let mut points = vec![self.goal];
        while state >= cells {
            points.push(self.center(state % cells));
            state = parents[state] as usize;
        }
        points.push(from);
        points.reverse();
        points
    }
}
