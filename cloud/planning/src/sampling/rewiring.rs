//! Rewiring. The cheapest known path to each vertex: a tree with costs whose branches move to better parents.
//!
//! Source: Karaman and Frazzoli, "Sampling-Based Algorithms for Optimal Motion Planning", 2011 (RRT*): a new vertex takes the nearby
//! parent that makes it cheapest, and becomes the parent of nearby vertices that get cheaper through it.

use nalgebra::Point2;

use super::nearest::Nearest;
use zenav_space::LineOfSight;

/// No vertex.
const NONE: u32 = u32::MAX;
/// Least distance between vertices, cells.
const LEAST_DISTANCE: f64 = 0.125;
/// Gains below this are rounding, cells.
const ROUNDING: f64 = 1e-9;

/// Number of nearest vertices that are considered at most, where points are denser than the radius assumes: 1.1 times the least number
/// that optimality in the limit requires (k-nearest RRT*).
fn neighbours(vertices: usize) -> usize {
    (1.1 * 1.5 * std::f64::consts::E * (vertices as f64).ln()).ceil() as usize
}

#[derive(Clone, Copy, Debug)]
struct Vertex {
    point: Point2<f64>,
    /// Length of the path from the root, cells.
    cost: f64,
    parent: u32,
    first_child: u32,
    /// Its previous and next sibling.
    siblings: [u32; 2],
}

/// A tree with a root (vertex 0), a goal (vertex 1) and further vertices.
#[derive(Clone, Debug, Default)]
pub struct CostTree {
    vertices: Vec<Vertex>,
    nearest: Nearest,
    near: Vec<(f32, u32)>,
    candidates: Vec<(f64, u32)>,
    stack: Vec<u32>,
}

impl CostTree {
    /// Removes all vertices.
    pub fn clear(&mut self) {
        self.vertices.clear();
    }

    /// Starts from a path on a map of the given size: its ends are root and goal.
    pub fn plant(&mut self, size: [u32; 2], path: &[Point2<f64>]) {
        self.vertices.clear();
        self.nearest.clear(size);
        let [root, inner @ .., goal] = path else { return };
        let vertex = |point, parent| Vertex {
            point,
            cost: 0.0,
            parent,
            first_child: NONE,
            siblings: [NONE; 2],
        };
        self.vertices.push(vertex(*root, NONE));
        self.vertices.push(vertex(*goal, NONE));
        self.nearest.insert(*root, 0);
        self.nearest.insert(*goal, 1);
        let mut last = 0;
        for point in inner {
            last = self.add(*point, last);
        }
        self.hang(1, last);
        self.vertices[1].cost =
            self.vertices[last as usize].cost + self.distance(1, *path.get(path.len() - 2).unwrap_or(goal));
    }

    /// Number of vertices.
    #[must_use]
    #[allow(clippy::len_without_is_empty, reason = "a planted tree has two")]
    pub fn len(&self) -> usize {
        self.vertices.len()
    }

    /// Length of the best path to the goal that the tree knows, cells.
    #[must_use]
    pub fn cost(&self) -> f64 {
        self.vertices.get(1).map_or(f64::INFINITY, |goal| goal.cost)
    }

    /// The best path that the tree knows.
    #[must_use]
    pub fn path(&self) -> Vec<Point2<f64>> {
        let mut path = Vec::new();
        let mut at = 1;
        while let Some(vertex) = self.vertices.get(at as usize) {
            path.push(vertex.point);
            at = vertex.parent;
        }
        path.reverse();
        path
    }

    /// Edges, from parent to child.
    pub fn edges(&self) -> impl Iterator<Item = [Point2<f64>; 2]> + '_ {
        let parent = |vertex: &Vertex| self.vertices.get(vertex.parent as usize).map(|parent| parent.point);
        self.vertices
            .iter()
            .filter_map(move |vertex| Some([parent(vertex)?, vertex.point]))
    }

    /// Adds a point below the cheapest parent among the nearest vertices within a radius; if there are none, a point one step from the
    /// nearest vertex towards it. Nearby vertices become its children if that is cheaper. A point through which no path can be shorter
    /// than `bound` is not added.
    pub fn insert(&mut self, sight: &impl LineOfSight, point: Point2<f64>, radius: f64, step: f64, bound: f64) {
        let mut point = point;
        self.nearest.within(point, radius, &mut self.near);
        if self.near.is_empty() {
            let Some(nearest) = self.nearest.nearest(point) else {
                return;
            };
            let from = self.vertices[nearest as usize].point;
            let distance = (point - from).norm();
            if distance > step {
                point = from + (point - from) * (step / distance);
            }
            self.nearest.within(point, radius, &mut self.near);
            if self.near.is_empty() {
                self.near.push((0.0, nearest));
            }
        }
        let enough = neighbours(self.len());
        if self.near.len() > enough {
            self.near.select_nth_unstable_by(enough, |a, b| a.0.total_cmp(&b.0));
            self.near.truncate(enough);
        }
        let goal = self.vertices[1].point;
        let left = (goal - point).norm();
        self.candidates.clear();
        for (_, near) in &self.near {
            let vertex = &self.vertices[*near as usize];
            let distance = (vertex.point - point).norm();
            if distance < LEAST_DISTANCE {
                return;
            }
            self.candidates.push((vertex.cost + distance, *near));
        }
        while let Some(best) =
            (0..self.candidates.len()).min_by(|a, b| self.candidates[*a].0.total_cmp(&self.candidates[*b].0))
        {
            let (cost, parent) = self.candidates.swap_remove(best);
            if cost + left >= bound {
                return;
            }
            if parent != 1 && sight.sees(self.vertices[parent as usize].point, point) {
                let vertex = self.add(point, parent);
                self.rewire(sight, vertex);
                return;
            }
        }
    }

    /// Adds a path that is known to be free; its ends are root and goal.
    pub fn lay(&mut self, sight: &impl LineOfSight, path: &[Point2<f64>], radius: f64) {
        let mut last = 0;
        for point in path.iter().skip(1).take(path.len().saturating_sub(2)) {
            self.nearest.within(*point, radius, &mut self.near);
            last = self.add(*point, last);
            self.rewire(sight, last);
        }
        let cost = self.vertices[last as usize].cost + self.distance(1, self.vertices[last as usize].point);
        if cost + ROUNDING < self.vertices[1].cost {
            self.move_to(1, last, cost);
        }
    }

    /// Offers a vertex as parent to the vertices nearby.
    fn rewire(&mut self, sight: &impl LineOfSight, vertex: u32) {
        let Vertex {
            point, cost, parent, ..
        } = self.vertices[vertex as usize];
        for i in 0..self.near.len() {
            let near = self.near[i].1;
            let other = self.vertices[near as usize];
            let better = cost + (other.point - point).norm();
            if near != parent && better + ROUNDING < other.cost && sight.sees(point, other.point) {
                self.move_to(near, vertex, better);
            }
        }
    }

    fn distance(&self, vertex: u32, to: Point2<f64>) -> f64 {
        (self.vertices[vertex as usize].point - to).norm()
    }

    fn add(&mut self, point: Point2<f64>, parent: u32) -> u32 {
        let vertex = self.vertices.len() as u32;
        self.vertices.push(Vertex {
            point,
            cost: self.vertices[parent as usize].cost + self.distance(parent, point),
            parent: NONE,
            first_child: NONE,
            siblings: [NONE; 2],
        });
        self.nearest.insert(point, vertex);
        self.hang(vertex, parent);
        vertex
    }

    /// Attaches a vertex without a parent.
    fn hang(&mut self, vertex: u32, parent: u32) {
        let next = std::mem::replace(&mut self.vertices[parent as usize].first_child, vertex);
        if let Some(next) = self.vertices.get_mut(next as usize) {
            next.siblings[0] = vertex;
        }
        let child = &mut self.vertices[vertex as usize];
        child.parent = parent;
        child.siblings = [NONE, next];
    }

    /// Moves a branch to a better parent; all its vertices get cheaper.
    fn move_to(&mut self, vertex: u32, parent: u32, cost: f64) {
        let Vertex {
            parent: old,
            siblings: [before, after],
            cost: old_cost,
            ..
        } = self.vertices[vertex as usize];
        match self.vertices.get_mut(before as usize) {
            Some(before) => before.siblings[1] = after,
            None => self.vertices[old as usize].first_child = after,
        }
        if let Some(after) = self.vertices.get_mut(after as usize) {
            after.siblings[0] = before;
        }
        self.hang(vertex, parent);
        let gain = old_cost - cost;
        self.stack.clear();
        self.stack.push(vertex);
        while let Some(at) = self.stack.pop() {
            self.vertices[at as usize].cost -= gain;
            let mut child = self.vertices[at as usize].first_child;
            while let Some(vertex) = self.vertices.get(child as usize) {
                self.stack.push(child);
                child = vertex.siblings[1];
            }
        }
    }
}
