//! Correlative search. The best-fitting pose of a window, and its margin over any other place.
//!
//! The score of a pose is the mean likelihood of the cells that the points fall into (Olson 2009). The step of the headings moves the
//! farthest point by one cell. Blocks of positions and, in wide windows, of headings are bounded by the pyramid, and the block with the
//! highest bound is split next (branch and bound, best first; Hess et al. 2016). The first result is the global optimum, not just a good
//! pose.
//!
//! A block of `2^k` positions each way and `s` headings is bounded from its middle heading: its points lie within `(s - 1) / 2` cells of
//! their positions there, so that a square of `2^k + s - 1` cells contains them all. Points beyond the window's [lever](Window::lever) move
//! by twice as much, by four times as much, and so on.
//!
//! A block is split into four of half its side, which are scored together. The score of a part of the points in the whole block bounds its
//! score in each of them: mostly a few points suffice to reject all four.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use crate::headings::{FARTHEST, Headings, PARTS};
use crate::pyramid::{Pyramid, corners};
use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};

/// Most poses kept while the search continues.
const MOST_KEPT: usize = 400;

/// Search window, and the effort allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Middle of the window, `field_from_scan`.
    pub center: Pose2,
    /// Half width along x of the field, m.
    pub reach: f64,
    /// Half width along y of the field, m.
    pub across: f64,
    /// Half width in heading, rad; pi is the full circle.
    pub turn: f64,
    /// The step of the headings moves points this far out by one cell, m; those farther out move by more. Without a limit it is the
    /// farthest point.
    pub lever: f64,
    /// Poses that score less are ignored, 0 to 1.
    pub min_score: f64,
    /// Poses that score this much less than the best one are ignored, too, 0 to 1.
    pub within: f64,
    /// Number of distinct poses to return, best first.
    pub count: usize,
    /// Poses closer than this, m, and turned by less than [`Self::apart_turn`] count as the same place.
    pub apart: f64,
    /// See [`Self::apart`], rad.
    pub apart_turn: f64,
    /// Most blocks scored: the effort. Some 30 ns each for 60 points.
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

/// Result of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// Distinct poses, best first; empty if nothing scores enough.
    pub found: Vec<Candidate>,
    /// Whether the budget sufficed, so that nothing else in the window can score higher.
    pub is_exact: bool,
    /// Blocks that were scored.
    pub scored: usize,
}

impl Search {
    /// Score margin of the best pose over the second-best place; its own score if there is no second. Places below the window's
    /// [`min_score`](Window::min_score) are not known: there may be one just below it.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_scan_matching::{FieldSettings, LikelihoodField, Pyramid, Window, search};
    /// # let corner: Vec<_> = (0..40).flat_map(|i| [Point2::new(0.05 * i as f64, 2.0), Point2::new(2.0, 0.05 * i as f64)]).collect();
    /// # let mut field = LikelihoodField::new(&FieldSettings::default());
    /// # field.insert(Pose2::IDENTITY, &corner);
    /// # let pyramid = Pyramid::new(field, 5);
    /// // The corner of a room, and the two best places for it.
    /// let found = search(&pyramid, &corner, &Window { count: 2, ..Window::around(Pose2::IDENTITY, 0.5, 0.3) });
    /// assert!(found.is_exact && found.found.len() == 2);
    /// assert!(found.margin().unwrap() > 0.1, "{found:?}");
    /// ```
    #[must_use]
    pub fn margin(&self) -> Option<f64> {
        let best = self.found.first()?.score;
        Some(best - self.found.get(1).map_or(0.0, |second| second.score))
    }
}

/// A block of positions, counted in cells from the lower left of the window, and of headings starting at the one it names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Block {
    bound: u32,
    /// The bound of each part of the points.
    parts: [u32; PARTS],
    level: u32,
    heading: u32,
    x: i32,
    y: i32,
}

impl Ord for Block {
    /// The highest bound first; among equals the finer block, then the order of headings and positions, so that the result is
    /// deterministic.
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

/// The best poses of a window, best first.
///
/// Poses lie on a grid of cells and headings around the middle of the window. `points`: of the scan, in its frame, m.
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

/// As [`search`], for a scan that was taken where `places` is above zero; `places` is a pyramid over the same cells as `pyramid`.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_protocol::geometry::Pose2;
/// # use zenav_scan_matching::{FieldSettings, LikelihoodField, Pyramid, Window, search_among};
/// # let corner: Vec<_> = (0..40).flat_map(|i| [Point2::new(0.05 * i as f64, 2.0), Point2::new(2.0, 0.05 * i as f64)]).collect();
/// # let mut field = LikelihoodField::new(&FieldSettings::default());
/// // Two corners that look alike, 4 m apart; a robot may only be where x is more than 3 m.
/// for x in [0.0, 4.0] {
///     field.insert(Pose2::new(x, 0.0, 0.0), &corner);
/// }
/// let spec = *field.spec();
/// let allowed = (0..spec.len()).map(|index| u8::from(spec.center(spec.cell(index)).x > 3.0)).collect();
/// let places = Pyramid::new(LikelihoodField::from_values(spec, allowed).unwrap(), 5);
/// let window = Window::around(Pose2::new(2.0, 0.0, 0.0), 2.5, 0.1);
/// let best = search_among(&Pyramid::new(field, 5), Some(&places), &corner, &window).found[0];
/// assert!(best.pose.distance(&Pose2::new(4.0, 0.0, 0.0)) < 0.1);
/// ```
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
    let spec = *pyramid.field().spec();
    let cells = |side: f64| (side.max(0.0) / spec.resolution).floor().min(1e6) as i32;
    let (reach, across) = (cells(window.reach), cells(window.across));
    // Blocks at the start are no larger than the window is wide, and reach over all of it.
    let wide = reach.max(across) as u32;
    let top = (32 - wide.leading_zeros()).min(pyramid.highest());
    let headings = Headings::new(pyramid, points, window, (reach, across), top);
    let middle = (window.center.position() - spec.origin) / spec.resolution;
    let corner = |middle: f64, reach: i32| (middle.floor() as i32).clamp(-FARTHEST, FARTHEST) - reach;
    let corner = (corner(middle.x, reach), corner(middle.y, across));
    let full = 255.0 * points.len() as f64;
    let score_of = |share: f64| (share * full).ceil().max(0.0) as u32;
    let mut least = score_of(window.min_score);
    let is_place = |block: &Block| {
        places.is_none_or(|places| places.bound(1 << block.level, corner.0 + block.x, corner.1 + block.y) > 0)
    };
    // Scores four blocks of one size, two by two, and keeps those that may count. `first` is the first of them, with the bounds of a block
    // that contains them all.
    let score_four = |first: Block, least: u32, kept: &mut Vec<Block>| -> usize {
        let Block {
            level,
            heading,
            parts: most,
            ..
        } = first;
        let four = corners(1 << level).map(|(dx, dy)| (first.x + dx, first.y + dy));
        let is_within = |&(x, y): &(i32, i32)| x <= 2 * reach && y <= 2 * across;
        if let Some(bounds) = headings.bounds(level, heading, four[0], &most, least) {
            for ((x, y), parts) in four.into_iter().zip(bounds) {
                let block = Block {
                    bound: parts.iter().sum(),
                    parts,
                    x,
                    y,
                    ..first
                };
                if block.bound >= least && is_within(&(x, y)) && is_place(&block) {
                    kept.push(block);
                }
            }
        }
        four.iter().filter(|at| is_within(at)).count()
    };
    let pose_of = |heading: u32, x: i32, y: i32| {
        Pose2::new(
            window.center.x + f64::from(x - reach) * spec.resolution,
            window.center.y + f64::from(y - across) * spec.resolution,
            window.center.yaw + headings.turn(heading),
        )
    };

    let mut frontier = Frontier {
        is_deep: window.within < 1.0,
        ..Frontier::default()
    };
    let mut found: Vec<(u32, Candidate)> = Vec::new();
    let mut scored = 0;
    let mut blocks = Vec::new();
    for heading in (0..headings.count()).step_by(1 << headings.span(top)) {
        for y in (0..=2 * across).step_by(2 << top) {
            for x in (0..=2 * reach).step_by(2 << top) {
                let first = Block {
                    bound: 0,
                    parts: headings.most(),
                    level: top,
                    heading,
                    x,
                    y,
                };
                scored += score_four(first, least, &mut blocks);
            }
        }
    }
    frontier.push(&mut blocks);
    let mut is_exact = true;
    while let Some(block) = frontier.pop() {
        if block.bound < least {
            continue;
        }
        // A block that lies within the surroundings of a known pose, and is no better, is that pose.
        let side = (1 << block.level) - 1;
        let first = pose_of(block.heading, block.x, block.y);
        let last = pose_of(
            block.heading + (1 << headings.span(block.level)) - 1,
            block.x + side,
            block.y + side,
        );
        let is_known = last.x - first.x < std::f64::consts::SQRT_2 * window.apart
            && found
                .iter()
                .take_while(|(score, _)| block.bound <= *score)
                .any(|(_, known)| is_around(known, first, last, window));
        if is_known {
            continue;
        }
        if block.level == 0 {
            let candidate = Candidate {
                pose: first,
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
        let end = (block.heading + (1 << headings.span(block.level))).min(headings.count());
        for heading in (block.heading..end).step_by(1 << headings.span(level)) {
            let quarter = Block {
                level,
                heading,
                ..block
            };
            scored += score_four(quarter, least, &mut blocks);
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

/// Blocks still to be split. Normally the block with the highest bound comes next. If all places about as good as the best are wanted,
/// everything above a bound is examined anyway, so the newest block comes first, which needs little memory.
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

/// Keeps a pose, best first, unless a better one is the same place; worse ones at the same place are dropped.
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

/// Whether every pose of a block, from its first to its last, is the same place as a known one.
fn is_around(known: &Candidate, first: Pose2, last: Pose2, window: &Window) -> bool {
    let known = known.pose;
    let farthest = |first: f64, known: f64, last: f64| (known - first).max(last - known);
    let (x, y) = (farthest(first.x, known.x, last.x), farthest(first.y, known.y, last.y));
    let turns_less = |yaw: f64| wrap_angle(yaw - known.yaw).abs() < window.apart_turn;
    x < window.apart && y < window.apart && x.hypot(y) < window.apart && turns_less(first.yaw) && turns_less(last.yaw)
}

impl Window {
    /// A window that asks for the single best pose, of any score, with a budget of a million blocks.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_scan_matching::{FieldSettings, LikelihoodField, Pyramid, Window, search};
    /// # let wall: Vec<_> = (-50..=50).map(|i| Point2::new(2.0, 0.02 * f64::from(i))).collect();
    /// # let mut field = LikelihoodField::new(&FieldSettings::default());
    /// # field.insert(Pose2::IDENTITY, &wall);
    /// # let pyramid = Pyramid::new(field, 5);
    /// // The wall is elsewhere: no pose of this window scores 0.5, and that is certain.
    /// let far = Window { min_score: 0.5, ..Window::around(Pose2::new(50.0, 0.0, 0.0), 0.5, 0.2) };
    /// let nothing = search(&pyramid, &wall, &far);
    /// assert!(nothing.found.is_empty() && nothing.is_exact);
    /// assert_eq!(nothing.margin(), None);
    /// ```
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
