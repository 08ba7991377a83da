//! Random tree. A tree of points from a root, each in sight of its parent, extended towards samples or out of the region it covers.
//!
//! Source: LaValle, "Rapidly-Exploring Random Trees", 1998. An extension that meets an obstacle is dropped: vertices in front of an
//! obstacle would be nearest to everything behind it and see none of it.

use nalgebra::Point2;

use super::frontier::{Exit, Frontier};
use super::nearest::Nearest;
use super::sampler::Sampler;
use crate::grid_graph::GridGraph;
use zenav_space::LineOfSight;

/// The root's parent.
const NONE: u32 = u32::MAX;

/// The map that trees grow on.
#[derive(Debug)]
pub struct SearchSpace<'a, S> {
    /// Line of sight.
    pub sight: &'a S,
    /// Free cells.
    pub graph: &'a GridGraph,
    /// Longest edge, cells.
    pub step: f64,
}

impl<S: LineOfSight> SearchSpace<'_, S> {
    /// The free cell that holds a point (a graph's node).
    pub fn free_at(&self, p: Point2<f64>) -> Option<u32> {
        self.graph.node_at(p).filter(|cell| self.graph.is_free(*cell))
    }

    fn center(&self, node: u32) -> Point2<f64> {
        self.graph.cell(node).center()
    }
}

/// Result of an extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extended {
    /// The target was reached, as this vertex.
    Arrived(u32),
    /// A whole step was made, to this vertex.
    Stepped(u32),
    /// An obstacle blocks the step.
    Trapped,
}

/// A growing tree.
#[derive(Clone, Debug, Default)]
pub struct Tree {
    points: Vec<Point2<f64>>,
    parents: Vec<u32>,
    nearest: Nearest,
    frontier: Frontier,
    /// Number of vertices processed by the frontier.
    covered: usize,
    /// Whether no exit was lost: cells that stay uncovered to the end are then unreachable.
    complete: bool,
}

/// Result of steering a tree out of the region it covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Explored {
    /// There was an exit.
    Left,
    /// No exit is left: the tree covers every run of free cells that is reachable from its root.
    Everything,
    /// No exit is left, but some could not be taken.
    Stuck,
}

impl Tree {
    /// Starts a new tree at a root.
    pub fn plant<S: LineOfSight>(&mut self, space: &SearchSpace<'_, S>, root: Point2<f64>) {
        self.clear();
        self.nearest.clear(space.sight.size());
        self.add(root, NONE);
    }

    /// Removes all vertices.
    pub fn clear(&mut self) {
        self.points.clear();
        self.parents.clear();
        self.covered = 0;
        self.complete = true;
    }

    /// Number of vertices.
    #[must_use]
    pub fn vertices(&self) -> u32 {
        self.points.len() as u32
    }

    /// Position of a vertex.
    #[must_use]
    pub fn point(&self, vertex: u32) -> Point2<f64> {
        self.points[vertex as usize]
    }

    /// Edges, from parent to child.
    pub fn edges(&self) -> impl Iterator<Item = [Point2<f64>; 2]> + '_ {
        let edges = self.points.iter().zip(&self.parents).skip(1);
        edges.map(|(p, parent)| [self.point(*parent), *p])
    }

    /// The points from a vertex back to the root.
    pub fn back(&self, vertex: u32) -> impl Iterator<Item = Point2<f64>> + '_ {
        let parent = |vertex: &u32| Some(self.parents[*vertex as usize]).filter(|parent| *parent != NONE);
        std::iter::successors(Some(vertex), parent).map(|vertex| self.point(vertex))
    }

    fn add(&mut self, point: Point2<f64>, parent: u32) -> u32 {
        let vertex = self.vertices();
        self.points.push(point);
        self.parents.push(parent);
        self.nearest.insert(point, vertex);
        vertex
    }

    /// Grows a step from the nearest vertex towards a point.
    pub fn extend<S: LineOfSight>(&mut self, space: &SearchSpace<'_, S>, to: Point2<f64>) -> Extended {
        match self.nearest.nearest(to) {
            Some(near) => self.extend_from(space, near, to),
            None => Extended::Trapped,
        }
    }

    /// Grows from the nearest vertex towards a point until it is reached or an obstacle blocks the way.
    pub fn connect<S: LineOfSight>(&mut self, space: &SearchSpace<'_, S>, to: Point2<f64>) -> Option<u32> {
        let mut near = self.nearest.nearest(to)?;
        loop {
            match self.extend_from(space, near, to) {
                Extended::Arrived(vertex) => return Some(vertex),
                Extended::Stepped(vertex) => near = vertex,
                Extended::Trapped => return None,
            }
        }
    }

    /// Grows a step from a vertex towards a point.
    pub fn extend_from<S: LineOfSight>(&mut self, space: &SearchSpace<'_, S>, near: u32, to: Point2<f64>) -> Extended {
        let from = self.point(near);
        let path = to - from;
        let length = path.norm();
        if length > space.step {
            let end = from + path * (space.step / length);
            if end != from && space.sight.sees(from, end) {
                return Extended::Stepped(self.add(end, near));
            }
        } else if length == 0.0 {
            return Extended::Arrived(near);
        } else if space.sight.sees(from, to) {
            return Extended::Arrived(self.add(to, near));
        }
        Extended::Trapped
    }

    /// Grows out of the covered region: through the exit nearest to `target` among some drawn at random, and straight on while the next
    /// run is uncovered. The cell `target` is connected as soon as its run is covered.
    pub fn explore<S: LineOfSight>(
        &mut self,
        space: &SearchSpace<'_, S>,
        sampler: &mut Sampler,
        draws: usize,
        target: Option<u32>,
    ) -> Explored {
        if self.covered == 0 {
            self.frontier.clear(space.graph);
        }
        while self.covered < self.points.len() {
            let vertex = self.covered as u32;
            self.covered += 1;
            let p = self.point(vertex);
            match space.free_at(p).filter(|cell| space.sight.sees(p, space.center(*cell))) {
                Some(cell) if !self.frontier.covers(cell) => self.cover(space, vertex, cell, target),
                Some(_) => {}
                None => self.complete &= vertex > 0,
            }
        }
        let goal = target.map(|target| space.center(target));
        while !self.frontier.exits().is_empty() {
            let exits = self.frontier.exits();
            let distance =
                |number: &usize| goal.map_or(0.0, |goal| (space.center(exits[*number].cell) - goal).norm_squared());
            let drawn = (0..draws.max(1)).map(|_| sampler.below(exits.len()));
            let number = drawn.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
            if let Some(exit) = self.frontier.take(number) {
                self.leave(space, exit, target);
                return Explored::Left;
            }
        }
        if self.complete {
            Explored::Everything
        } else {
            Explored::Stuck
        }
    }

    /// Steers the tree through an exit.
    fn leave<S: LineOfSight>(&mut self, space: &SearchSpace<'_, S>, exit: Exit, target: Option<u32>) {
        let pitch = space.graph.pitch();
        let up = exit.cell > exit.via;
        let corner = if up { exit.cell - pitch } else { exit.cell + pitch };
        let Some(vertex) = self.thread(space, exit.vertex, &[exit.via, corner, exit.cell]) else {
            self.complete = false;
            return;
        };
        let mut cell = exit.cell;
        loop {
            self.cover(space, vertex, cell, target);
            let next = if up { cell + pitch } else { cell - pitch };
            if !space.graph.is_free(next) || self.frontier.covers(next) {
                break;
            }
            cell = next;
        }
        self.thread(space, vertex, &[cell]);
    }

    fn cover<S: LineOfSight>(&mut self, space: &SearchSpace<'_, S>, vertex: u32, via: u32, target: Option<u32>) {
        let [first, last] = self.frontier.cover(space.graph, vertex, via);
        if let Some(target) = target.filter(|target| (first..=last).contains(target)) {
            self.thread(space, vertex, &[via, target]);
        }
    }

    /// Adds a path from a vertex to the last of some cells, through the centres of as few of the others as needed.
    fn thread<S: LineOfSight>(&mut self, space: &SearchSpace<'_, S>, vertex: u32, cells: &[u32]) -> Option<u32> {
        let (mut at, mut done) = (vertex, 0);
        while done < cells.len() {
            let from = self.point(at);
            let seen = (done..cells.len())
                .rev()
                .find(|i| space.sight.sees(from, space.center(cells[*i])))?;
            let end = space.center(cells[seen]);
            if end != from {
                at = self.add(end, at);
            }
            done = seen + 1;
        }
        Some(at)
    }
}
