//! Correlative search. Which pose of a window fits best, and by how much better than any other place?
//!
//! The score of a pose is the mean likelihood of the cells that the points fall into (Olson 2009). Headings are tried on a step by which
//! the farthest point moves a cell; for each, blocks of positions are bounded by the pyramid, and the block with the highest bound is split
//! next (branch and bound, best first; Hess et al. 2016). What comes out first is the best of all, not a good one.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};

use crate::field::placed;
use crate::pyramid::Pyramid;

/// Finest and coarsest step of headings, rad.
const STEPS: (f64, f64) = (1e-3, 0.2);

/// Where is searched, and for how long.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Middle of the window, `field_from_scan`.
    pub center: Pose2,
    /// To each side along x and along y of the field, m.
    pub reach: f64,
    /// To each side in heading, rad; pi is all around.
    pub turn: f64,
    /// Poses that score less are of no interest, 0 to 1.
    pub min_score: f64,
    /// How many distinct poses are wanted, best first.
    pub count: usize,
    /// Poses nearer than this, m, and turned by less than [`Self::apart_turn`] are the same place.
    pub apart: f64,
    /// See [`Self::apart`], rad.
    pub apart_turn: f64,
    /// Blocks that are scored, at most: the work. About a microsecond each for 360 points.
    pub budget: usize,
}

/// A pose and its score.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// `field_from_scan`.
    pub pose: Pose2,
    /// Mean likelihood of the points' cells, 0 to 1.
    pub score: f64,
}

/// What a search found.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// Distinct poses, best first; none where nothing scores enough.
    pub found: Vec<Candidate>,
    /// Whether nothing in the window can score higher than what is said here: the budget sufficed.
    pub is_exact: bool,
    /// Blocks that were scored.
    pub scored: usize,
}

impl Search {
    /// By how much the best pose scores higher than the second best place; its own score where there is no second.
    #[must_use]
    pub fn margin(&self) -> Option<f64> {
        let best = self.found.first()?.score;
        Some(best - self.found.get(1).map_or(0.0, |second| second.score))
    }
}

/// A block of positions at one heading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Block {
    bound: u32,
    level: u32,
    heading: u32,
    x: i32,
    y: i32,
}

impl Ord for Block {
    /// The highest bound first; among equals the finer block, then the order of headings and positions: the result is the same each time.
    fn cmp(&self, other: &Self) -> Ordering {
        let order = |block: &Self| (block.heading, block.y, block.x);
        self.bound
            .cmp(&other.bound)
            .then(other.level.cmp(&self.level))
            .then(order(other).cmp(&order(self)))
    }
}

impl PartialOrd for Block {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// The step of headings by which the farthest point moves a cell, rad.
#[must_use]
pub fn heading_step(points: &[Point2<f64>], resolution: f64) -> f64 {
    let farthest = points.iter().map(|point| point.coords.norm()).fold(0.0, f64::max);
    (resolution / farthest.max(f64::MIN_POSITIVE)).clamp(STEPS.0, STEPS.1)
}

/// The best poses of a window, best first.
///
/// Poses are those on the steps of cells and headings about the middle of the window. `points`: of the scan, in its frame, m.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::geometry::Pose2;
/// use zenav_scan_matching::{FieldSettings, LikelihoodField, Pyramid, Window, search};
///
/// let corner: Vec<_> = (0..40).flat_map(|i| [Point2::new(0.05 * i as f64, 2.0), Point2::new(2.0, 0.05 * i as f64)]).collect();
/// let mut field = LikelihoodField::new(&FieldSettings::default());
/// field.insert(Pose2::new(1.0, 1.0, 0.0), &corner);
/// let window = Window::around(Pose2::new(0.8, 1.1, 0.1), 0.5, 0.3);
/// let best = search(&Pyramid::new(field, 5), &corner, &window).found[0];
/// assert!(best.pose.distance(&Pose2::new(1.0, 1.0, 0.0)) < 0.08 && best.score > 0.7);
/// ```
#[must_use]
pub fn search(pyramid: &Pyramid, points: &[Point2<f64>], window: &Window) -> Search {
    let nothing = Search {
        found: Vec::new(),
        is_exact: true,
        scored: 0,
    };
    if points.is_empty() || window.count == 0 || !window.center.is_finite() {
        return nothing;
    }
    let spec = *pyramid.field().spec();
    let step = heading_step(points, spec.resolution);
    let turns = (window.turn.clamp(0.0, std::f64::consts::PI) / step).floor() as i64;
    let reach = (window.reach.max(0.0) / spec.resolution).floor().min(1e6) as i32;
    let headings: Vec<f64> = (-turns..=turns).map(|turn| turn as f64 * step).collect();
    // The cells of the points at the middle of the window, for each heading.
    let cells_at = |turn: &f64| -> Vec<(i32, i32)> {
        let center = Pose2::new(window.center.x, window.center.y, window.center.yaw + turn);
        let cell = |point: &Point2<f64>| {
            let at = (point - spec.origin) / spec.resolution;
            (at.x.floor() as i32, at.y.floor() as i32)
        };
        placed(center, points).iter().map(cell).collect()
    };
    let cells: Vec<Vec<(i32, i32)>> = headings.iter().map(cells_at).collect();
    let score =
        |heading: u32, level: u32, x: i32, y: i32| -> u32 { pyramid.sum(level, &cells[heading as usize], x, y) };
    let full = 255.0 * points.len() as f64;
    let least = (window.min_score * full).ceil().max(0.0) as u32;
    let pose_of = |block: &Block| {
        let Pose2 { x, y, yaw } = window.center;
        Pose2::new(
            x + f64::from(block.x) * spec.resolution,
            y + f64::from(block.y) * spec.resolution,
            yaw + headings[block.heading as usize],
        )
    };

    // Blocks at the start are no larger than the window is wide, and reach over all of it.
    let top = (32 - (reach as u32).leading_zeros()).min(pyramid.highest());
    let mut heap = BinaryHeap::new();
    let mut found: Vec<Candidate> = Vec::new();
    let mut scored = 0;
    for heading in 0..headings.len() as u32 {
        let side = 1_i32 << top;
        let starts = |_: ()| (-reach..=reach).step_by(side as usize);
        for y in starts(()) {
            for x in starts(()) {
                let bound = score(heading, top, x, y);
                scored += 1;
                if bound >= least {
                    heap.push(Block {
                        bound,
                        level: top,
                        heading,
                        x,
                        y,
                    });
                }
            }
        }
    }
    while let Some(block) = heap.pop() {
        // A block that lies within the surroundings of a pose that was found is that pose.
        let is_known = found
            .iter()
            .any(|known| is_inside(&block, known, &pose_of(&block), window, spec.resolution));
        if is_known {
            continue;
        }
        if block.level == 0 {
            found.push(Candidate {
                pose: pose_of(&block),
                score: f64::from(block.bound) / full,
            });
            if found.len() == window.count {
                break;
            }
            continue;
        }
        if scored >= window.budget {
            return Search {
                found,
                is_exact: false,
                scored,
            };
        }
        let half = 1_i32 << (block.level - 1);
        for (dx, dy) in [(0, 0), (half, 0), (0, half), (half, half)] {
            let (x, y) = (block.x + dx, block.y + dy);
            if x > reach || y > reach {
                continue;
            }
            let bound = score(block.heading, block.level - 1, x, y);
            scored += 1;
            if bound >= least {
                heap.push(Block {
                    bound,
                    level: block.level - 1,
                    x,
                    y,
                    ..block
                });
            }
        }
    }
    Search {
        found,
        is_exact: true,
        scored,
    }
}

/// Whether every pose of a block is the same place as one that is known.
fn is_inside(block: &Block, known: &Candidate, corner: &Pose2, window: &Window, resolution: f64) -> bool {
    let side = f64::from((1_i32 << block.level) - 1) * resolution;
    let farthest = |corner: f64, known: f64| (corner - known).abs().max((corner + side - known).abs());
    let away = farthest(corner.x, known.pose.x).hypot(farthest(corner.y, known.pose.y));
    away < window.apart && wrap_angle(corner.yaw - known.pose.yaw).abs() < window.apart_turn
}

impl Window {
    /// A window that asks for the best pose alone, of any score, with a budget of a million blocks.
    #[must_use]
    pub fn around(center: Pose2, reach: f64, turn: f64) -> Self {
        Self {
            center,
            reach,
            turn,
            min_score: 0.0,
            count: 1,
            apart: 0.3,
            apart_turn: 0.1,
            budget: 1_000_000,
        }
    }
}
