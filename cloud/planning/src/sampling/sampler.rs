//! Sampler. Draws samples uniformly from the free cells; once a path is known, only where a shorter one can lead.
//!
//! Points are drawn from the bitmap's box or from the ellipse of all points through which a path can be shorter than the best one,
//! whichever is smaller, and rejected if the cell is not free: uniform over the free cells of both. Source: Gammell, Srinivasa and
//! Barfoot, "Informed RRT*", 2014.

use nalgebra::{Matrix2, Point2, Vector2};
use rand::Rng;
use rand_pcg::Pcg64Mcg;

use crate::grid_graph::GridGraph;

/// Draws before the sampler gives up on a sample.
const TRIES: u32 = 64;
/// Samples keep this far from the border of their cell, so that they touch no neighbouring square.
const INSET: f64 = 1.0 / 64.0;

/// The points through which a path between two foci can be shorter than a length.
#[derive(Clone, Copy, Debug)]
pub struct Ellipse {
    foci: [Point2<f64>; 2],
    /// Length of the path to beat.
    length: f64,
    center: Point2<f64>,
    /// Maps the unit disc to the ellipse.
    shape: Matrix2<f64>,
}

impl Ellipse {
    /// The ellipse of paths between two points.
    #[must_use]
    pub fn new(foci: [Point2<f64>; 2], length: f64) -> Self {
        let across = foci[1] - foci[0];
        let distance = across.norm();
        let along = if distance > 0.0 {
            across / distance
        } else {
            Vector2::x()
        };
        let half = [
            0.5 * length,
            0.5 * (length * length - distance * distance).max(0.0).sqrt(),
        ];
        Self {
            foci,
            length,
            center: nalgebra::center(&foci[0], &foci[1]),
            shape: Matrix2::new(
                along.x * half[0],
                -along.y * half[1],
                along.y * half[0],
                along.x * half[1],
            ),
        }
    }

    /// Its area, square cells.
    #[must_use]
    pub fn area(&self) -> f64 {
        std::f64::consts::PI * self.shape.determinant().abs()
    }

    /// Whether a path through a point can be shorter.
    #[must_use]
    pub fn contains(&self, p: Point2<f64>) -> bool {
        (p - self.foci[0]).norm() + (self.foci[1] - p).norm() < self.length
    }
}

/// Draws points of the map by a seeded generator.
#[derive(Clone, Debug)]
pub struct Sampler {
    rng: Pcg64Mcg,
    low: Point2<f64>,
    side: Vector2<f64>,
    ellipse: Option<Ellipse>,
    tries: u64,
    hits: u64,
}

impl Sampler {
    /// A sampler of a box (low and high corner, cells); the same seed gives the same points.
    #[must_use]
    pub fn new(seed: u64, domain: [Point2<f64>; 2]) -> Self {
        Self {
            rng: Pcg64Mcg::new(0xCAFE_F00D_D15E_A5E5 ^ (u128::from(seed) << 64 | u128::from(seed))),
            low: domain[0],
            side: domain[1] - domain[0],
            ellipse: None,
            tries: 0,
            hits: 0,
        }
    }

    /// Restricts further samples to the ellipse.
    pub fn narrow(&mut self, ellipse: Ellipse) {
        self.ellipse = Some(ellipse);
        (self.tries, self.hits) = (0, 0);
    }

    /// A number in `[0, 1)`.
    pub fn unit(&mut self) -> f64 {
        (self.rng.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// A whole number below `bound`.
    pub fn below(&mut self, bound: usize) -> usize {
        ((u128::from(self.rng.next_u64()) * bound as u128) >> 64) as usize
    }

    /// A point anywhere in the box.
    pub fn anywhere(&mut self) -> Point2<f64> {
        self.low + Vector2::new(self.unit() * self.side.x, self.unit() * self.side.y)
    }

    /// A point in a free cell; `None` if no draw hit one.
    pub fn free(&mut self, graph: &GridGraph) -> Option<Point2<f64>> {
        for _ in 0..TRIES {
            self.tries += 1;
            let p = self.point();
            let [x, y] = [p.x, p.y].map(f64::floor);
            let inset = |value: f64, cell: f64| cell + (value - cell).clamp(INSET, 1.0 - INSET);
            if graph.node_at(p).is_some_and(|node| graph.is_free(node)) {
                self.hits += 1;
                return Some(Point2::new(inset(p.x, x), inset(p.y, y)));
            }
        }
        None
    }

    /// A point beside the convex corner of an obstacle; `None` if no draw hit one.
    pub fn corner(&mut self, graph: &GridGraph) -> Option<Point2<f64>> {
        for _ in 0..TRIES {
            let p = self.point();
            let Some(node) = graph.node_at(p) else { continue };
            let [x, y] = [self.next() & 1 == 0, self.next() & 1 == 0];
            let corners = graph.corners(node >> 6, x, y);
            if corners != 0 {
                // A random one of the word's corners.
                let turn = self.below(64) as u32;
                let bit = (corners.rotate_right(turn).trailing_zeros() + turn) & 63;
                let cell = graph.cell((node & !63) | bit);
                let beside = |cell: u32, up: bool| f64::from(cell) + if up { 1.0 - INSET } else { INSET };
                let p = Point2::new(beside(cell.x, x), beside(cell.y, y));
                if self.ellipse.is_none_or(|ellipse| ellipse.contains(p)) {
                    return Some(p);
                }
            }
        }
        None
    }

    fn next(&mut self) -> u64 {
        self.rng.next_u64() >> 32
    }

    /// Estimated number of free cells that samples are drawn from, by the share of draws that were free.
    #[must_use]
    pub fn free_area(&self) -> f64 {
        let from = match &self.ellipse {
            Some(ellipse) if ellipse.area() < self.area() => ellipse.area(),
            _ => self.area(),
        };
        from * (self.hits + 1) as f64 / (self.tries + 1) as f64
    }

    fn area(&self) -> f64 {
        self.side.x * self.side.y
    }

    fn point(&mut self) -> Point2<f64> {
        let area = self.area();
        match self.ellipse {
            Some(ellipse) if ellipse.area() < area => {
                let (angle, radius) = (std::f64::consts::TAU * self.unit(), self.unit().sqrt());
                let p = ellipse.center + ellipse.shape * Vector2::new(radius * angle.cos(), radius * angle.sin());
                let inside = p - self.low;
                let on = |value: f64, side: f64| value >= 0.0 && value < side;
                if on(inside.x, self.side.x) && on(inside.y, self.side.y) {
                    p
                } else {
                    Point2::new(-1.0, -1.0)
                }
            }
            ellipse => {
                let p = self.anywhere();
                if ellipse.is_none_or(|ellipse| ellipse.contains(p)) {
                    p
                } else {
                    Point2::new(-1.0, -1.0)
                }
            }
        }
    }
}
