//! A* in space and time. Which path is free at the time when the robot is there?
//!
//! Everybody's future is known. The time is cut into layers: a step leads to one of the twenty cells within two columns or rows, of which
//! the farthest, a knight's move away, is reached at top speed; or it is a wait. In every direction the robot advances at 0.89 of its top
//! speed or more.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::{Point2, center};
use zenav_sim::Simulation;

use crate::cells::Cells;
use crate::driver::{Disc, HORIZON};
use crate::field::Field;
use crate::replay::Replay;
use crate::task::DrivingTask;

/// Side of a cell, m.
const CELL: f64 = 0.2;
/// Squared length of the longest step, cells.
const LONGEST: i64 = 5;
/// Clearance beyond contact from everybody, m: nearly half a cell's diagonal. Without a path, none.
const MARGINS: [f64; 2] = [0.12, 0.0];
/// Clearance beyond contact from walls, m: of the disc around the outline, or if that finds no path, of the robot's width.
const OFF_WALLS: [f64; 2] = [0.03, -0.02];
/// Somebody this far from where the record has him was held up, and the record is made anew, m.
const STRAYED: f64 = 0.02;

/// Positions of the robot over time.
#[derive(Debug, Default)]
struct Reference {
    begins: f64,
    points: Vec<Point2<f64>>,
}

/// Cells, steps between them, and everybody's positions.
pub(crate) struct SpaceTime {
    cells: Cells,
    /// Duration of a step, s.
    layer: f64,
    /// For each cell the steps from it: the cell halfway, and the cell at the end.
    steps: Vec<Vec<[usize; 2]>>,
    /// Number of steps to the goal around static obstacles; `None` without a path.
    left: Vec<Option<u32>>,
    goal: Point2<f64>,
    timeout: f64,
    replay: Replay,
    /// Radii of the movers and of the disc around the robot, m.
    radii: Vec<f64>,
    reach: f64,
    reference: Reference,
}

impl SpaceTime {
    pub(crate) fn new(task: &DrivingTask<'_>, field: &Field, simulation: &Simulation, radii: &[f64]) -> Self {
        let reach = task.model.footprint.circumscribed_radius();
        let (low, high) = task.world.bounds();
        let cells = Cells::new(low, high, CELL);
        let start = cells.nearest(task.start.position(), |_| true);
        let way = |clearance: f64| ways(&cells, task.goal, |at| field.clearance(at) >= clearance);
        let roomy = way(reach + OFF_WALLS[0]);
        let (steps, left) = if start.is_some_and(|start| roomy.1[start].is_some()) {
            roomy
        } else {
            way(task.model.footprint.half_width() + OFF_WALLS[1])
        };
        Self {
            layer: CELL * (LONGEST as f64).sqrt() / task.model.drive.top_speed(),
            steps,
            left,
            cells,
            goal: task.goal,
            timeout: task.timeout,
            replay: Replay::new(simulation, task.timeout + HORIZON),
            radii: radii.to_vec(),
            reach,
            reference: Reference::default(),
        }
    }

    /// Discs of all movers at a time (s).
    pub(crate) fn walkers(&self, secs: f64) -> Vec<Disc> {
        let disc = |(mover, radius): (usize, &f64)| (self.replay.at(mover, secs), *radius);
        self.radii.iter().enumerate().map(disc).collect()
    }

    /// Where the robot should be at a time (s).
    pub(crate) fn reference(&self, secs: f64) -> Point2<f64> {
        let Reference { begins, points } = &self.reference;
        let share = ((secs - begins) / self.layer).max(0.0);
        let point = |index: usize| points.get(index).or(points.last()).copied().unwrap_or(self.goal);
        let from = point(share as usize);
        from + (point(share as usize + 1) - from) * share.fract()
    }

    /// Plans the path from a place on, now. Without a path the last one is kept; at first the robot stays where it is.
    pub(crate) fn plan(&mut self, simulation: &Simulation, from: Point2<f64>) {
        let now = simulation.now().as_secs();
        let mut movers = simulation.movers().enumerate();
        if movers.any(|(mover, at)| (self.replay.at(mover, now) - at).norm() > STRAYED) {
            self.replay = Replay::new(simulation, self.timeout + HORIZON);
        }
        let found = MARGINS.iter().find_map(|margin| self.search(now, from, *margin));
        if found.is_some() || self.reference.points.is_empty() {
            self.reference = Reference {
                begins: now,
                points: found.unwrap_or_else(|| vec![from]),
            };
        }
    }

    /// Cells in which the disc around the robot comes within a distance of somebody at about a time (s).
    fn taken(&self, secs: f64, distance: f64) -> Vec<bool> {
        let mut taken = vec![false; self.cells.count()];
        for share in [-0.25, 0.0, 0.25] {
            for (at, radius) in self.walkers(secs + share * self.layer) {
                let reach = self.reach + radius + distance;
                for cell in self.cells.around(at, reach) {
                    taken[cell] |= (self.cells.center(cell) - at).norm() < reach;
                }
            }
        }
        taken
    }

    fn search(&self, now: f64, from: Point2<f64>, margin: f64) -> Option<Vec<Point2<f64>>> {
        let cells = self.cells.count();
        let start = self.cells.nearest(from, |cell| self.left[cell].is_some())?;
        let layers = ((self.timeout - now) / self.layer).ceil().max(1.0) as usize;
        // For each half of a layer, when it is needed.
        let mut taken: Vec<Vec<bool>> = Vec::new();
        // Predecessor of each state.
        let mut parents = vec![u32::MAX; cells * layers];
        let mut open = BinaryHeap::new();
        parents[start] = start as u32;
        // Of paths that take equally long, the one that gets on first: the next plan begins anew.
        let away = |cell: usize| Reverse((self.cells.center(cell) - self.goal).norm().to_bits());
        open.push((Reverse(self.left[start]?), 0_usize, away(start), start));
        while let Some((_, layer, _, cell)) = open.pop() {
            if self.left[cell] == Some(0) {
                return Some(self.path(&parents, layer * cells + cell, from));
            }
            let next = layer + 1;
            if next >= layers {
                continue;
            }
            while taken.len() <= 2 * next {
                taken.push(self.taken(now + 0.5 * self.layer * taken.len() as f64, margin));
            }
            for [halfway, there] in &self.steps[cell] {
                let Some(left) = self.left[*there] else { continue };
                let state = next * cells + there;
                let is_free = !taken[2 * next - 1][*halfway] && !taken[2 * next][*there];
                if is_free && parents[state] == u32::MAX {
                    parents[state] = (layer * cells + cell) as u32;
                    open.push((Reverse(next as u32 + left), next, away(*there), *there));
                }
            }
        }
        None
    }

    /// The points of a path to a state in the goal's cell, one per layer; the last is the goal itself.
    fn path(&self, parents: &[u32], mut state: usize, from: Point2<f64>) -> Vec<Point2<f64>> {
        let cells = self.cells.count();
        let mut points = vec![self.goal];
        while state >= cells {
            state = parents[state] as usize;
            points.push(if state < cells {
                from
            } else {
                self.cells.center(state % cells)
            });
        }
        if points.len() <= 2 {
            // The last step need not take as long as a whole one.
            points.truncate(1);
        }
        points.reverse();
        points
    }
}

/// The steps from each cell, and their number to the goal.
type Ways = (Vec<Vec<[usize; 2]>>, Vec<Option<u32>>);

/// The steps between free places, and their number from each cell to the free cell nearest to the goal.
fn ways(cells: &Cells, goal: Point2<f64>, is_free: impl Fn(Point2<f64>) -> bool) -> Ways {
    let offsets: Vec<[i64; 2]> = (-2..=2)
        .flat_map(|dx| (-2..=2).map(move |dy| [dx, dy]))
        .filter(|[dx, dy]| dx * dx + dy * dy <= LONGEST)
        .collect();
    let steps_from = |cell: usize| {
        let step = |offset: &[i64; 2]| {
            let there = cells.beside(cell, *offset)?;
            let halfway = center(&cells.center(cell), &cells.center(there));
            let is_step = is_free(cells.center(there)) && is_free(halfway);
            is_step.then_some([cells.cell(halfway)?, there])
        };
        offsets.iter().filter_map(step).collect()
    };
    let steps: Vec<Vec<[usize; 2]>> = (0..cells.count()).map(steps_from).collect();
    let mut left: Vec<Option<u32>> = vec![None; cells.count()];
    let end = cells.nearest(goal, |cell| is_free(cells.center(cell)));
    let mut ring: Vec<usize> = end.into_iter().collect();
    let mut number = 0;
    while !ring.is_empty() {
        ring.retain(|cell| {
            let is_new = left[*cell].is_none();
            left[*cell].get_or_insert(number);
            is_new
        });
        number += 1;
        let next = |cell: usize| steps[cell].iter().map(|[_, there]| *there);
        ring = ring.into_iter().flat_map(next).collect();
    }
    (steps, left)
}
