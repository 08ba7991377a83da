//! Field. How much room is there, and how long is the shortest path of a disc? From the world's true geometry.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;
use zenav_sim::World;

use crate::cells::Cells;

/// Side of a cell, m.
const CELL: f64 = 0.05;
/// A cell centre may be this much nearer than the disc's radius, m: a passable gap may have no cell on its centre line.
const SLACK: f64 = 0.012;
/// Greatest clearance, m: in a world without obstacles it would be infinite.
const FAR: f64 = 100.0;

/// Clearances in a world, and distances to a goal.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_reference_drivers::Field;
/// # use zenav_sim::World;
/// // A wall with its end at (3, 3).
/// let text = "size = [6, 4]\n[[wall]]\nfrom = [3, 0]\nto = [3, 3]\nthickness = 0.02\n";
/// let world = World::from_toml(text, "wall.toml", &|_| Err("no map here".to_owned()))?;
/// let field = Field::new(&world, 0.25, Point2::new(5.0, 1.0));
/// let metres = field.shortest(Point2::new(1.0, 1.0));
/// assert!((5.7..6.3).contains(&metres), "round the end of the wall: {metres} m");
/// # Ok::<(), zenav_sim::WorldError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Field {
    cells: Cells,
    clearance: Vec<f32>,
    to_goal: Vec<f32>,
    radius: f64,
    goal: Point2<f64>,
}

impl Field {
    /// The field of a disc of a radius (m) that drives to `goal` (map frame, m).
    ///
    /// Cost: one query of clearance for each cell of 5 cm, and a search over all of them.
    #[must_use]
    pub fn new(world: &World, radius: f64, goal: Point2<f64>) -> Self {
        let (low, high) = world.bounds();
        let cells = Cells::new(low, high, CELL);
        let point = Footprint::Radius(0.0);
        let clearance = |cell| {
            let at = cells.center(cell);
            world.clearance(&point, Pose2::new(at.x, at.y, 0.0)).min(FAR) as f32
        };
        let mut field = Self {
            clearance: (0..cells.count()).map(clearance).collect(),
            to_goal: vec![f32::INFINITY; cells.count()],
            cells,
            radius,
            goal,
        };
        field.flood();
        field
    }

    /// Dijkstra's algorithm from the goal, over steps to the sixteen surrounding cells.
    fn flood(&mut self) {
        let mut open = BinaryHeap::new();
        if let Some(goal) = self.cells.cell(self.goal) {
            self.to_goal[goal] = 0.0;
            open.push((Reverse(0_u32), goal));
        }
        while let Some((Reverse(bits), cell)) = open.pop() {
            let here = f32::from_bits(bits);
            if here > self.to_goal[cell] {
                continue;
            }
            for (next, length) in around(&self.cells, cell) {
                let there = here + length;
                if there < self.to_goal[next] && self.is_free(next) {
                    self.to_goal[next] = there;
                    // Non-negative floats have the order of their bits.
                    open.push((Reverse(there.to_bits()), next));
                }
            }
        }
    }

    fn is_free(&self, cell: usize) -> bool {
        f64::from(self.clearance[cell]) >= self.radius - SLACK
    }

    /// Distance from a point to the nearest static obstacle, m: interpolated, to within a centimetre or two.
    pub(crate) fn clearance(&self, at: Point2<f64>) -> f64 {
        self.cells.interpolate(&self.clearance, at)
    }

    /// Length of the shortest path from a point to the goal, m: along the cells, then shortened by line of sight. Infinite without a path.
    #[must_use]
    pub fn shortest(&self, from: Point2<f64>) -> f64 {
        let Some(mut cell) = self.cells.cell(from).filter(|cell| self.to_goal[*cell].is_finite()) else {
            return f64::INFINITY;
        };
        let mut way = vec![from];
        while self.to_goal[cell] > 0.0 {
            let down = around(&self.cells, cell).min_by(|a, b| {
                let [a, b] = [a, b].map(|(next, length)| self.to_goal[*next] + length);
                a.total_cmp(&b)
            });
            let Some((next, _)) = down.filter(|(next, _)| self.to_goal[*next] < self.to_goal[cell]) else {
                break;
            };
            cell = next;
            way.push(self.cells.center(cell));
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
            self.cells.cell(at).is_some_and(|cell| self.is_free(cell))
        })
    }
}

/// The sixteen surrounding cells, and the lengths of the steps to them, m.
fn around(cells: &Cells, cell: usize) -> impl Iterator<Item = (usize, f32)> {
    const STEPS: [[i64; 2]; 4] = [[1, 0], [1, 1], [2, 1], [1, 2]];
    STEPS.into_iter().flat_map(move |[dx, dy]| {
        let length = (CELL * (dx as f64).hypot(dy as f64)) as f32;
        [[dx, dy], [-dy, dx], [-dx, -dy], [dy, -dx]]
            .into_iter()
            .filter_map(move |step| Some((cells.beside(cell, step)?, length)))
    })
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
