//! Headings. The headings of a window, and the cells of a scan's points at each of them.

use std::cell::OnceCell;
use std::collections::BTreeMap;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::GridSpec;

use crate::field::placed;
use crate::pyramid::{Pyramid, Spots, Squares};
use crate::search::Window;

/// Number of parts into which points are divided; after each part the search checks whether the rest can still make a block good enough.
pub(crate) const PARTS: usize = 6;
/// Approximate number of points of a part; more when there are more points.
const PART: usize = 12;
/// Points farther out than two to this power levers count as that far out: no table covers their spread.
const LAST_CLASS: f64 = 16.0;
/// Cells farther away than this count as this far.
pub(crate) const FARTHEST: i32 = 1 << 28;
/// Finest and coarsest step of headings, rad.
const STEPS: (f64, f64) = (1e-3, 0.2);
/// Headings are grouped such that at least this many groups remain.
const FEWEST_GROUPS: u32 = 24;
/// Headings are grouped by at most two to this power.
const MOST_GROUPED: u32 = 6;

/// The step of headings that moves the farthest point by one cell, rad.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_scan_matching::heading_step;
///
/// // The farthest point is 5 m away: 0.01 rad move it by 5 cm.
/// let scan = [Point2::new(1.0, 0.0), Point2::new(3.0, 4.0)];
/// assert!((heading_step(&scan, 0.05) - 0.01).abs() < 1e-12);
/// ```
#[must_use]
pub fn heading_step(points: &[Point2<f64>], resolution: f64) -> f64 {
    let farthest = points.iter().map(|point| point.coords.norm()).fold(0.0, f64::max);
    (resolution / farthest.max(f64::MIN_POSITIVE)).clamp(STEPS.0, STEPS.1)
}

/// The headings of a window, and where the points fall at each of them and at the middle of each group of them.
pub(crate) struct Headings<'a> {
    spec: GridSpec,
    center: Pose2,
    /// Half size of the window, cells.
    reach: (i32, i32),
    count: u32,
    first: f64,
    step: f64,
    /// Headings are grouped by up to two to this power.
    grouped: u32,
    points: Vec<Group>,
    levels: Vec<Level<'a>>,
}

/// Points at similar distances.
struct Group {
    /// Zero for points within the lever, one for those within twice the lever, and so on.
    class: u32,
    points: Vec<Point2<f64>>,
}

/// Blocks of one size.
struct Level<'a> {
    /// The squares that bound each group of points; `None` for points beyond all tables, which have no bound.
    squares: Vec<Option<Squares<'a>>>,
    /// For each group of headings, computed on demand: where each group of points falls.
    spots: Vec<OnceCell<Vec<Spots>>>,
}

impl<'a> Headings<'a> {
    /// The headings of a window that reaches this many cells to each side, for blocks up to a level.
    pub(crate) fn new(
        pyramid: &'a Pyramid,
        points: &[Point2<f64>],
        window: &Window,
        reach: (i32, i32),
        top: u32,
    ) -> Self {
        let spec = *pyramid.field().spec();
        let farthest = points.iter().map(|point| point.coords.norm()).fold(0.0, f64::max);
        let lever = farthest.min(window.lever).max(f64::MIN_POSITIVE);
        let step = (spec.resolution / lever).clamp(STEPS.0, STEPS.1);
        let turns = (window.turn.clamp(0.0, std::f64::consts::PI) / step).floor();
        let count = 2 * turns as u32 + 1;
        // With steps that move a point by more than a cell, a group's bound would not hold.
        let is_fine = lever * step <= spec.resolution * (1.0 + 1e-9);
        let grouped = if is_fine {
            (count / FEWEST_GROUPS).checked_ilog2().unwrap_or(0).min(MOST_GROUPED)
        } else {
            0
        };
        let mut headings = Self {
            spec,
            center: window.center,
            reach,
            count,
            first: -turns * step,
            step,
            grouped,
            points: grouped_points(points, lever),
            levels: Vec::new(),
        };
        for level in 0..=top {
            let squares = |group: &Group| pyramid.squares((1 << level) + headings.spread(level, group.class));
            headings.levels.push(Level {
                squares: headings.points.iter().map(squares).collect(),
                spots: vec![OnceCell::new(); count.div_ceil(1 << headings.span(level)) as usize],
            });
        }
        headings
    }

    /// The number of cells, less one, over which the headings of a block spread a point of a class.
    fn spread(&self, level: u32, class: u32) -> u32 {
        ((1 << self.span(level)) - 1) << class
    }

    /// Where the points fall for the group of headings that begins at `first`: the lower-left corner of each point's spread, for a block at
    /// the lower left of the window.
    fn spots(&self, level: u32, first: u32) -> &[Spots] {
        let Level { squares, spots } = &self.levels[level as usize];
        let middle = f64::from(first) + 0.5 * f64::from((1 << self.span(level)) - 1);
        let center = Pose2 {
            yaw: self.center.yaw + self.first + middle * self.step,
            ..self.center
        };
        let spots_of = |(group, squares): (&Group, &Option<Squares>)| {
            let away = 0.5 * f64::from(self.spread(level, group.class));
            let cell = |at: f64, reach: i32| ((at - away).floor() as i32).clamp(-FARTHEST, FARTHEST) - reach;
            let cells = placed(center, &group.points).into_iter().map(|point| {
                let at = (point - self.spec.origin) / self.spec.resolution;
                (cell(at.x, self.reach.0), cell(at.y, self.reach.1))
            });
            Spots::new(cells.collect(), squares.as_ref())
        };
        let all = || self.points.iter().zip(squares).map(spots_of).collect();
        spots[(first >> self.span(level)) as usize].get_or_init(all)
    }

    /// Number of headings.
    pub(crate) fn count(&self) -> u32 {
        self.count
    }

    /// Largest possible score of each part of the points.
    pub(crate) fn most(&self) -> [u32; PARTS] {
        let mut most = [0; PARTS];
        for (number, group) in self.points.iter().enumerate() {
            most[number.min(PARTS - 1)] += group.points.len() as u32 * u32::from(u8::MAX);
        }
        most
    }

    /// A block of a level spans two to this power headings.
    pub(crate) fn span(&self, level: u32) -> u32 {
        level.saturating_sub(1).min(self.grouped)
    }

    /// Offset of a heading from the middle of the window, rad.
    pub(crate) fn turn(&self, heading: u32) -> f64 {
        self.first + f64::from(heading) * self.step
    }

    /// Upper bounds on the score of each part of the points in four blocks of a level, in the order of
    /// [`corners`](crate::pyramid::corners). The first block begins at a heading and at an offset in cells from the lower left of the
    /// window. `most`: bounds known so far. `None` if none of the blocks can reach `least`.
    pub(crate) fn bounds(
        &self,
        level: u32,
        heading: u32,
        (x, y): (i32, i32),
        most: &[u32; PARTS],
        least: u32,
    ) -> Option<[[u32; PARTS]; 4]> {
        let (squares, spots) = (&self.levels[level as usize].squares, self.spots(level, heading));
        let mut bounds = [[0; PARTS]; 4];
        let mut totals = [0; 4];
        let mut rest: u32 = most.iter().sum();
        for (number, (spots, squares)) in spots.iter().zip(squares).enumerate() {
            let mut sums = [0; 4];
            match squares {
                Some(squares) => squares.add(spots, x, y, 1 << level, &mut sums),
                None => sums = [spots.most(); 4],
            }
            let part = number.min(PARTS - 1);
            for block in 0..4 {
                bounds[block][part] += sums[block];
                totals[block] += sums[block];
            }
            if part + 1 < PARTS {
                rest -= most[part];
                if totals.iter().all(|total| total + rest < least) {
                    return None;
                }
            }
        }
        Some(bounds)
    }
}

/// Groups points, those within the lever first. Neighbouring beams carry the same information, so each group has points from all around: a
/// few of them then suffice to reject a block.
fn grouped_points(points: &[Point2<f64>], lever: f64) -> Vec<Group> {
    let class = |point: &Point2<f64>| (point.coords.norm() / lever * (1.0 - 1e-9)).log2().ceil();
    let mut classes: BTreeMap<u32, Vec<Point2<f64>>> = BTreeMap::new();
    for point in points {
        classes
            .entry(class(point).clamp(0.0, LAST_CLASS) as u32)
            .or_default()
            .push(*point);
    }
    let size = PART.max(points.len().div_ceil(PARTS));
    let split = |(class, points): (u32, Vec<Point2<f64>>)| {
        let parts = points.len().div_ceil(size);
        (0..parts).map(move |first| Group {
            class,
            points: points.iter().copied().skip(first).step_by(parts).collect(),
        })
    };
    classes.into_iter().flat_map(split).collect()
}
