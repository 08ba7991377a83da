//! Field. Distance to the goal around static obstacles, for a disc, on cells, from the world's true geometry.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;
use zenav_sim::World;

/// Side of a cell, m.
const CELL: f64 = 0.05;
/// A cell centre may be this much nearer than the disc's radius, m: a passable gap may have no cell on its centre line.
const SLACK: f64 = 0.012;

/// Clearances, and distances to a goal.
pub(in crate::bench) struct Field {
    low: Point2<f64>,
    size: [usize; 2],
    clearance: Vec<f32>,
    to_goal: Vec<f32>,
    radius: f64,
    goal: Point2<f64>,
}

impl Field {
    /// The field of a disc that drives to `goal` in a world, m.
    pub(in crate::bench) fn new(world: &World, radius: f64, goal: Point2<f64>) -> Self {
        let (low, high) = world.bounds();
        let size = [high.x - low.x, high.y - low.y].map(|side| (side / CELL).ceil() as usize);
        let mut field = Self {
            low,
            size,
            clearance: Vec::new(),
            to_goal: vec![f32::INFINITY; size[0] * size[1]],
            radius,
            goal,
        };
        let point = Footprint::Radius(0.0);
        let clearance = |cell| {
            let at = field.center(cell);
            world.clearance(&point, Pose2::new(at.x, at.y, 0.0)) as f32
        };
        field.clearance = (0..size[0] * size[1]).map(clearance).collect();
        field.flood();
        field
    }

    /// Dijkstra's algorithm from the goal, over steps to the sixteen surrounding cells.
    fn flood(&mut self) {
        let mut open = BinaryHeap::new();
        if let Some(goal) = self.cell(self.goal) {
            self.to_goal[goal] = 0.0;
            open.push((Reverse(0_u32), goal));
        }
        while let Some((Reverse(bits), cell)) = open.pop() {
            let here = f32::from_bits(bits);
            if here > self.to_goal[cell] {
                continue;
            }
            for (next, length) in self.around(cell) {
                let there = here + length;
                if there < self.to_goal[next] && self.is_free(next) {
                    self.to_goal[next] = there;
                    // Non-negative floats have the order of their bits.
                    open.push((Reverse(there.to_bits()), next));
                }
            }
        }
    }

    fn around(&self, cell: usize) -> impl Iterator<Item = (usize, f32)> + use<> {
        const STEPS: [[i64; 2]; 4] = [[1, 0], [1, 1], [2, 1], [1, 2]];
        let [width, height] = self.size.map(|side| side as i64);
        let (x, y) = (cell as i64 % width, cell as i64 / width);
        STEPS.into_iter().flat_map(move |[dx, dy]| {
            [[dx, dy], [-dy, dx], [-dx, -dy], [dy, -dx]]
                .into_iter()
                .filter_map(move |[dx, dy]| {
                    let (x, y) = (x + dx, y + dy);
                    let inside = (0..width).contains(&x) && (0..height).contains(&y);
                    inside.then(|| ((y * width + x) as usize, (CELL * (dx as f64).hypot(dy as f64)) as f32))
                })
        })
    }

    fn is_free(&self, cell: usize) -> bool {
        f64::from(self.clearance[cell]) >= self.radius - SLACK
    }

    fn center(&self, cell: usize) -> Point2<f64> {
        let (x, y) = (cell % self.size[0], cell / self.size[0]);
        self.low + Vector2::new(x as f64 + 0.5, y as f64 + 0.5) * CELL
    }

    fn cell(&self, at: Point2<f64>) -> Option<usize> {
        let off = (at - self.low) / CELL;
        let inside = off.x >= 0.0 && off.y >= 0.0 && (off.x as usize) < self.size[0] && (off.y as usize) < self.size[1];
        inside.then(|| off.y as usize * self.size[0] + off.x as usize)
    }

    /// Distance from a point to the nearest static obstacle, m; to within a cell.
    pub(super) fn clearance(&self, at: Point2<f64>) -> f64 {
        self.cell(at).map_or(0.0, |cell| f64::from(self.clearance[cell]))
    }

    /// Distance to the goal along the cells, m; infinite without a path.
    pub(super) fn to_goal(&self, at: Point2<f64>) -> f64 {
        let near = (at - self.goal).norm();
        if near < 4.0 * CELL {
            return near;
        }
        self.cell(at)
            .map_or(f64::INFINITY, |cell| f64::from(self.to_goal[cell]))
    }

    /// The goal, m.
    pub(super) fn goal(&self) -> Point2<f64> {
        self.goal
    }

    /// Lower-left corner and sides of the field, m.
    pub(super) fn extent(&self) -> (Point2<f64>, [f64; 2]) {
        (self.low, self.size.map(|side| side as f64 * CELL))
    }

    /// Length of the shortest path from a point to the goal, m: along the cells, then shortened by line of sight. Infinite without a path.
    pub(in crate::bench) fn shortest(&self, from: Point2<f64>) -> f64 {
        let Some(mut cell) = self.cell(from).filter(|cell| self.to_goal[*cell].is_finite()) else {
            return f64::INFINITY;
        };
        let mut way = vec![from];
        while self.to_goal[cell] > 0.0 {
            let down = self.around(cell).min_by(|a, b| {
                let [a, b] = [a, b].map(|(next, length)| self.to_goal[*next] + length);
                a.total_cmp(&b)
            });
            let Some((next, _)) = down.filter(|(next, _)| self.to_goal[*next] < self.to_goal[cell]) else {
                break;
            };
            cell = next;
            way.push(self.center(cell));
        }
        way.push(self.goal);
        let (mut length, mut anchor) = (0.0, 0);
        while anchor + 1 < way.len() {
            let farthest = (anchor + 1..way.len())
                .rev()
                .find(|last| self.sees(way[anchor], way[*last]));
            let next = farthest.unwrap_or(anchor + 1);
            length += (way[next] - way[anchor]).norm();
            anchor = next;
        }
        length
    }

    fn sees(&self, from: Point2<f64>, to: Point2<f64>) -> bool {
        let steps = ((to - from).norm() / (0.5 * CELL)).ceil().max(1.0);
        (0..=steps as u32).all(|step| {
            let at = from + (to - from) * (f64::from(step) / steps);
            self.cell(at).is_some_and(|cell| self.is_free(cell))
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn the_shortest_way_is_straight_or_taut_round_the_corner() {
        let world =
            |things: &str| World::from_toml(&format!("size = [8, 8]\n{things}"), "w", &|_| Err(String::new())).unwrap();
        let length = |world: &World| Field::new(world, 0.25, Point2::new(7.0, 3.0)).shortest(Point2::new(1.0, 2.0));
        assert!((length(&world("")) - 37.0_f64.sqrt()).abs() < 0.01);
        // Around the end of a wall at (4, 6), with a radius of 0.25 m.
        let around = length(&world("[[wall]]\nfrom = [4, 0]\nto = [4, 6]\nthickness = 0.02\n"));
        let corner = |x: f64, y: f64| (x - 4.0).hypot(y - 6.0);
        let least = corner(1.0, 2.0) + corner(7.0, 3.0);
        assert!(around > least && around < 1.06 * least, "{around} {least}");
        assert!(length(&world("[[wall]]\nfrom = [4, 0]\nto = [4, 8]\nthickness = 0.02\n")).is_infinite());
    }
}
