//! Correlative search. Which pose of a window fits best, and by how much better than any other place?
//!
//! The score of a pose is the mean likelihood of the cells that the points fall into (Olson 2009). Headings are tried on a step by which
//! the farthest point moves a cell. Blocks of positions and, where the window is wide, of headings are bounded by the pyramid, and the block
//! with the highest bound is split next (branch and bound, best first; Hess et al. 2016). What comes out first is the best of all, not a
//! good one.
//!
//! A block of `2^k` positions each way and `s` headings is bounded from its middle heading: its points lie within `(s - 1) / 2` cells of where
//! that puts them, so that a square of `2^k + s - 1` cells holds them all. Points beyond the window's [lever](Window::lever) move by twice as
//! much, by four times as much, and so on.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::GridSpec;

use crate::field::placed;
use crate::pyramid::{Pyramid, Table};

/// Finest and coarsest step of headings, rad.
const STEPS: (f64, f64) = (1e-3, 0.2);
/// Headings are grouped so that at least so many groups remain.
const FEWEST_GROUPS: u32 = 24;
/// Most poses that are kept while more are looked for.
const MOST_KEPT: usize = 400;
/// Headings are grouped by at most two to this power.
const MOST_GROUPED: u32 = 6;

/// Where is searched, and for how long.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Middle of the window, `field_from_scan`.
    pub center: Pose2,
    /// To each side along x of the field, m.
    pub reach: f64,
    /// To each side along y of the field, m.
    pub across: f64,
    /// To each side in heading, rad; pi is all around.
    pub turn: f64,
    /// Headings are tried on steps by which points so far out move a cell, m; those farther out move by more. Without a limit it is the
    /// farthest point.
    pub lever: f64,
    /// Poses that score less are of no interest, 0 to 1.
    pub min_score: f64,
    /// Poses that score this much less than the best one are of no interest either, 0 to 1.
    pub within: f64,
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

/// A block of positions, and of headings from the one it names on.
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
    search_among(pyramid, None, points, window)
}

/// As [`search`], for a scan that was taken where `places` is above zero: a pyramid over the same cells as `pyramid`.
#[must_use]
pub fn search_among(pyramid: &Pyramid, places: Option<&Pyramid>, points: &[Point2<f64>], window: &Window) -> Search {
    let nothing = Search {
        found: Vec::new(),
        is_exact: true,
        scored: 0,
    };
    if points.is_empty() || window.count == 0 || !window.center.is_finite() {
        return nothing;
    }
    let headings = Headings::new(pyramid.field().spec(), points, window);
    let spec = *pyramid.field().spec();
    let cells = |side: f64| (side.max(0.0) / spec.resolution).floor().min(1e6) as i32;
    let (reach, across) = (cells(window.reach), cells(window.across));
    let middle = (window.center.position() - spec.origin) / spec.resolution;
    let middle = (middle.x.floor() as i32, middle.y.floor() as i32);
    let full = 255.0 * points.len() as f64;
    let score_of = |share: f64| (share * full).ceil().max(0.0) as u32;
    let mut least = score_of(window.min_score);
    // For each level the tables of what points can meet, by how far out they are: those beyond all tables can meet anything.
    let tables: Vec<Vec<Option<&Table>>> = (0..=pyramid.highest())
        .map(|level| {
            let spread = (1_u32 << headings.span(level)) - 1;
            let of_class = |class| pyramid.table((1 << level) + (spread << class));
            (0..headings.classes).map(of_class).collect()
        })
        .collect();
    // What a block scores at most; nothing where it cannot count.
    let bounded = |level: u32, heading: u32, x: i32, y: i32, least: u32| -> Option<u32> {
        let is_place = |places: &Pyramid| places.bound(1 << level, middle.0 + x, middle.1 + y) > 0;
        if !places.is_none_or(is_place) {
            return None;
        }
        let (mut bound, mut left) = (0, points.len() as u32);
        let tables = &tables[level as usize];
        for (cells, table) in headings.cells(headings.span(level), heading).iter().zip(tables) {
            left -= cells.len() as u32;
            let rest = left * u32::from(u8::MAX);
            let needed = least.saturating_sub(bound + rest);
            bound += match table {
                _ if level == 0 => pyramid.sum(cells, x, y, needed),
                Some(table) => table.sum(cells, x, y, needed),
                None => cells.len() as u32 * u32::from(u8::MAX),
            };
            if bound + rest < least {
                return None;
            }
        }
        (bound >= least).then_some(bound)
    };
    let pose_of = |block: &Block| {
        let Pose2 { x, y, yaw } = window.center;
        Pose2::new(
            x + f64::from(block.x) * spec.resolution,
            y + f64::from(block.y) * spec.resolution,
            yaw + headings.turn(block.heading),
        )
    };

    // Blocks at the start are no larger than the window is wide, and reach over all of it.
    let wide = reach.max(across) as u32;
    let top = (32 - wide.leading_zeros()).min(pyramid.highest());
    let mut frontier = Frontier {
        is_deep: window.within < 1.0,
        ..Frontier::default()
    };
    let mut found: Vec<(u32, Candidate)> = Vec::new();
    let mut scored = 0;
    let mut blocks = Vec::new();
    for heading in (0..headings.count).step_by(1 << headings.span(top)) {
        let side = 1_usize << top;
        for y in (-across..=across).step_by(side) {
            for x in (-reach..=reach).step_by(side) {
                scored += 1;
                if let Some(bound) = bounded(top, heading, x, y, least) {
                    blocks.push(Block {
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
    frontier.push(&mut blocks);
    let mut is_exact = true;
    while let Some(block) = frontier.pop() {
        if block.bound < least {
            continue;
        }
        let last = headings.turn(block.heading + (1 << headings.span(block.level)) - 1);
        // A block that lies within the surroundings of a pose that was found, and is no better, is that pose.
        let is_known = found.iter().any(|(score, known)| {
            let turns = window.center.yaw + last - known.pose.yaw;
            block.bound <= *score
                && wrap_angle(turns).abs() < window.apart_turn
                && is_inside(&block, known, &pose_of(&block), window, spec.resolution)
        });
        if is_known {
            continue;
        }
        if block.level == 0 {
            let candidate = Candidate {
                pose: pose_of(&block),
                score: f64::from(block.bound) / full,
            };
            if frontier.is_deep {
                keep(&mut found, block.bound, candidate, window);
                least = least.max(score_of(found[0].1.score - window.within));
            } else {
                found.push((block.bound, candidate));
                if found.len() == window.count {
                    break;
                }
            }
            continue;
        }
        if scored >= window.budget {
            is_exact = false;
            break;
        }
        let level = block.level - 1;
        let half = 1_i32 << level;
        let (own, halves) = (headings.span(level), headings.span(block.level));
        for heading in (block.heading..block.heading + (1 << halves)).step_by(1 << own) {
            if heading >= headings.count {
                break;
            }
            for (dx, dy) in [(0, 0), (half, 0), (0, half), (half, half)] {
                let (x, y) = (block.x + dx, block.y + dy);
                if x > reach || y > across {
                    continue;
                }
                scored += 1;
                if let Some(bound) = bounded(level, heading, x, y, least) {
                    blocks.push(Block {
                        bound,
                        level,
                        heading,
                        x,
                        y,
                    });
                }
            }
        }
        frontier.push(&mut blocks);
    }
    found.retain(|(score, _)| *score >= least);
    let found = found.into_iter().map(|(_, candidate)| candidate);
    Search {
        found: found.take(window.count).collect(),
        is_exact,
        scored,
    }
}

/// Blocks that are still to be split. The one with the highest bound comes next; where all places are wanted that are about as good as the
/// best, everything above a bound is looked at anyway, and the newest comes first: that needs no memory.
#[derive(Default)]
struct Frontier {
    is_deep: bool,
    heap: BinaryHeap<Block>,
    stack: Vec<Block>,
}

impl Frontier {
    fn push(&mut self, blocks: &mut Vec<Block>) {
        if self.is_deep {
            blocks.sort_unstable();
            self.stack.append(blocks);
        } else {
            self.heap.extend(blocks.drain(..));
        }
    }

    fn pop(&mut self) -> Option<Block> {
        if self.is_deep {
            self.stack.pop()
        } else {
            self.heap.pop()
        }
    }
}

/// Keeps a pose, best first, unless a better one is the same place; those that are the same place and worse go.
fn keep(found: &mut Vec<(u32, Candidate)>, score: u32, candidate: Candidate, window: &Window) {
    let is_same = |known: &Candidate| {
        known.pose.distance(&candidate.pose) < window.apart
            && wrap_angle(known.pose.yaw - candidate.pose.yaw).abs() < window.apart_turn
    };
    if found.iter().any(|(better, known)| *better >= score && is_same(known)) {
        return;
    }
    found.retain(|(_, known)| !is_same(known));
    let place = found.partition_point(|(better, _)| *better >= score);
    found.insert(place, (score, candidate));
    found.truncate(MOST_KEPT.max(window.count));
}

/// The cells of points, by how far out the points are: those within the lever first.
type ByDistance = Vec<Vec<(i32, i32)>>;

/// The headings of a window, and the cells of the points from each and from the middle of each group of them: the lower left corner of where
/// the group spreads them.
struct Headings {
    count: u32,
    /// Into how many classes points fall by how far out they are, each twice as far as the one before.
    classes: u32,
    first: f64,
    step: f64,
    /// Headings are grouped by up to two to this power.
    grouped: u32,
    /// For each size of groups, and in it for each group.
    cells: Vec<Vec<ByDistance>>,
}

impl Headings {
    fn new(spec: &GridSpec, points: &[Point2<f64>], window: &Window) -> Self {
        let farthest = points.iter().map(|point| point.coords.norm()).fold(0.0, f64::max);
        let lever = farthest.min(window.lever).max(f64::MIN_POSITIVE);
        let step = (spec.resolution / lever).clamp(STEPS.0, STEPS.1);
        let turns = (window.turn.clamp(0.0, std::f64::consts::PI) / step).floor();
        let count = 2 * turns as u32 + 1;
        // With steps that move a point by more than a cell a group's bound would not hold.
        let is_fine = lever * step <= spec.resolution * (1.0 + 1e-9);
        let grouped = if is_fine {
            (count / FEWEST_GROUPS).checked_ilog2().unwrap_or(0).min(MOST_GROUPED)
        } else {
            0
        };
        let mut headings = Self {
            count,
            classes: 0,
            first: -turns * step,
            step,
            grouped,
            cells: Vec::new(),
        };
        // Neighbouring beams tell the same: in another order, less of them shows that a block is too bad.
        let stride = (0..)
            .map(|more| points.len() * 5 / 8 + 1 + more)
            .find(|stride| coprime(*stride, points.len()));
        let stride = stride.unwrap_or(1);
        let mixed = (0..points.len()).map(|index| points[index * stride % points.len()]);
        let mut classes: Vec<Vec<Point2<f64>>> = vec![Vec::new()];
        for point in mixed {
            let class = (point.coords.norm() / lever * (1.0 - 1e-9)).log2().ceil().max(0.0) as usize;
            if classes.len() <= class {
                classes.resize(class + 1, Vec::new());
            }
            classes[class].push(point);
        }
        headings.classes = classes.len() as u32;
        for span in 0..=grouped {
            let size = 1_u32 << span;
            let groups = (0..count.div_ceil(size)).map(|group| {
                let middle = f64::from(group * size) + 0.5 * f64::from(size - 1);
                let yaw = window.center.yaw + headings.first + middle * step;
                let center = Pose2::new(window.center.x, window.center.y, yaw);
                let of_class = |(class, points): (u32, &Vec<_>)| {
                    let away = 0.5 * f64::from((size - 1) << class);
                    let cell = |point: Point2<f64>| {
                        let at = (point - spec.origin) / spec.resolution;
                        ((at.x - away).floor() as i32, (at.y - away).floor() as i32)
                    };
                    placed(center, points).into_iter().map(cell).collect()
                };
                (0..).zip(&classes).map(of_class).collect()
            });
            let groups = groups.collect();
            headings.cells.push(groups);
        }
        headings
    }

    /// Two to this power headings are in a block of a level.
    fn span(&self, level: u32) -> u32 {
        level.saturating_sub(1).min(self.grouped)
    }

    /// The cells of the points, at the middle of the window, from the group that begins with a heading.
    fn cells(&self, span: u32, heading: u32) -> &[Vec<(i32, i32)>] {
        &self.cells[span as usize][(heading >> span) as usize]
    }

    /// A heading beside the middle of the window, rad.
    fn turn(&self, heading: u32) -> f64 {
        self.first + f64::from(heading) * self.step
    }
}

fn coprime(a: usize, b: usize) -> bool {
    let (mut a, mut b) = (a, b);
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a == 1
}

/// Whether every pose of a block, at its first heading, is the same place as one that is known.
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
            across: reach,
            turn,
            lever: f64::INFINITY,
            min_score: 0.0,
            within: 1.0,
            count: 1,
            apart: 0.3,
            apart_turn: 0.1,
            budget: 1_000_000,
        }
    }
}
