//! Shape clearance. The distance of discs, moved discs and convex polygons to the nearest occupied square, in closed form.
//!
//! Candidates come from bit scans of the rows that the shape can reach; each is measured exactly. The bits follow the map tile by tile and
//! need no tree. A footprint is measured 0.9 to 1.7 times as fast as by parry's tree over the same squares; where squares join to few
//! boxes, parry's tree over those is 1.7 to 4 times as fast as this, but it is built anew for every change
//! (`cargo bench -p zenav-space --bench space`).

use nalgebra::{Point2, Vector2};
use zenav_protocol::grid::GridSpec;
use zenav_protocol::polygon::{Edge, cross, edges};

use super::bits::BitGrid;

/// Exact distance from a point to the nearest obstacle (m), at most `limit`; zero for a non-finite point.
pub(super) fn disc_clearance(obstacles: &BitGrid, spec: &GridSpec, point: Point2<f64>, limit: f64) -> f64 {
    let p = spec.to_cells(point);
    if !(p.x.is_finite() && p.y.is_finite()) {
        return 0.0;
    }
    let height = i64::from(obstacles.height());
    let beyond = |at: f64, end: u32| (-at).max(at - f64::from(end)).max(0.0);
    if beyond(p.x, obstacles.width()).hypot(beyond(p.y, obstacles.height())) * spec.resolution >= limit {
        // No cell of the grid is near; below, all numbers are of a grid's size.
        return limit;
    }
    // A hair more than the limit, so that an obstacle exactly at a bound is still found.
    let mut least = limit / spec.resolution * (1.0 + 1e-12) + 1e-12;
    let (column, row) = (column(p.x), column(p.y));
    let (mut below, mut above) = (row.min(height - 1), (row + 1).max(0));
    let scan = |y: i64, least: &mut f64| -> bool {
        let dy = (y as f64 - p.y).max(p.y - (y + 1) as f64).max(0.0);
        if y < 0 || y >= height || dy >= *least {
            return false;
        }
        // Columns that could still be nearer.
        let half = (*least * *least - dy * dy).sqrt();
        let (low, high) = (self::column(p.x - half) - 1, self::column(p.x + half));
        let left = obstacles
            .previous_set(y as u32, low, column)
            .map(|x| (p.x - f64::from(x + 1)).max(0.0));
        let right = obstacles
            .next_set(y as u32, column, high)
            .map(|x| (f64::from(x) - p.x).max(0.0));
        for dx in [left, right].into_iter().flatten() {
            *least = least.min(dx.hypot(dy));
        }
        true
    };
    let (mut down, mut up) = (true, true);
    while down || up {
        down = down && scan(below, &mut least);
        up = up && scan(above, &mut least);
        below -= 1;
        above += 1;
    }
    (least * spec.resolution).min(limit)
}

/// Least distance from a segment to an obstacle, both in cells, if it is at most `limit`, else some greater value. Minus one for a
/// non-finite segment.
pub(super) fn capsule_clearance(obstacles: &BitGrid, a: Point2<f64>, b: Point2<f64>, limit: f64) -> f64 {
    let d = b - a;
    if !(d.x.is_finite() && d.y.is_finite() && a.x.is_finite() && a.y.is_finite() && limit.is_finite()) {
        return -1.0;
    }
    let mut least = f64::INFINITY;
    let (low, high) = (a.y.min(b.y), a.y.max(b.y));
    let rows = rows_within(obstacles, low - limit, high + limit);
    for y in rows {
        let reach = limit.min(least);
        // The part of the segment within reach of this row, and the columns within reach of that part.
        let (bottom, top) = (f64::from(y) - reach, f64::from(y) + 1.0 + reach);
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        if d.y == 0.0 {
            if a.y < bottom || a.y > top {
                continue;
            }
        } else {
            let (at_bottom, at_top) = ((bottom - a.y) / d.y, (top - a.y) / d.y);
            enter = enter.max(at_bottom.min(at_top));
            leave = leave.min(at_bottom.max(at_top));
            // A rounding error must not lose a touching row.
            if enter > leave + 1e-9 {
                continue;
            }
        }
        let (x0, x1) = (a.x + d.x * enter, a.x + d.x * leave);
        let (from, to) = (column(x0.min(x1) - reach) - 1, column(x0.max(x1) + reach) + 1);
        for x in obstacles.set_in_row(y, from, to) {
            least = least.min(segment_to_square(a, b, x, y));
        }
    }
    least
}

/// The column or row of a coordinate in cells; far outside any grid it is clamped.
fn column(at: f64) -> i64 {
    at.floor().clamp(-1e12, 1e12) as i64
}

/// Rows of the grid whose closed squares meet a range of y, cells.
fn rows_within(obstacles: &BitGrid, low: f64, high: f64) -> std::ops::Range<u32> {
    // Casts saturate; one more row at both ends for closed squares.
    let first = (low.floor() - 1.0).max(0.0) as u32;
    let end = ((high.floor() + 2.0).max(0.0) as u32).min(obstacles.height());
    first.min(end)..end
}

/// Exact distance from a segment to the closed square of a cell, cells.
fn segment_to_square(a: Point2<f64>, b: Point2<f64>, x: u32, y: u32) -> f64 {
    let (low, high) = (
        Vector2::new(f64::from(x), f64::from(y)),
        Vector2::new(f64::from(x) + 1.0, f64::from(y) + 1.0),
    );
    if segment_meets_box(a, b, low, high) {
        return 0.0;
    }
    // They do not meet, so the nearest pair contains an end of the segment or a corner of the square.
    let point_to_box = |p: Point2<f64>| {
        let (dx, dy) = (
            (low.x - p.x).max(p.x - high.x).max(0.0),
            (low.y - p.y).max(p.y - high.y).max(0.0),
        );
        dx.hypot(dy)
    };
    let corners = [(low.x, low.y), (high.x, low.y), (high.x, high.y), (low.x, high.y)];
    let to_corner = corners
        .iter()
        .map(|(u, v)| point_to_segment(Point2::new(*u, *v), a, b))
        .fold(f64::INFINITY, f64::min);
    to_corner.min(point_to_box(a)).min(point_to_box(b))
}

fn point_to_segment(p: Point2<f64>, a: Point2<f64>, b: Point2<f64>) -> f64 {
    let (d, to) = (b - a, p - a);
    let length = d.norm_squared();
    let share = if length > 0.0 {
        (to.dot(&d) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (to - d * share).norm()
}

/// Whether a closed segment meets a closed box: separating axes are x, y and the segment's normal.
fn segment_meets_box(a: Point2<f64>, b: Point2<f64>, low: Vector2<f64>, high: Vector2<f64>) -> bool {
    if a.x.max(b.x) < low.x || a.x.min(b.x) > high.x || a.y.max(b.y) < low.y || a.y.min(b.y) > high.y {
        return false;
    }
    let d = b - a;
    let side = |u: f64, v: f64| d.x * (v - a.y) - d.y * (u - a.x);
    let sides = [
        side(low.x, low.y),
        side(high.x, low.y),
        side(high.x, high.y),
        side(low.x, high.y),
    ];
    !(sides.iter().all(|s| *s > 0.0) || sides.iter().all(|s| *s < 0.0))
}

/// Least distance from a convex polygon to an obstacle, both in cells; at most `limit`.
///
/// Along a row of squares the distance grows to both sides of the columns where the polygon meets the row, or comes nearest to it: the
/// first obstacle on each side counts. Rows come nearest first.
pub(super) fn polygon_clearance(obstacles: &BitGrid, outline: &[Point2<f64>], limit: f64) -> f64 {
    let by_height = |a: &&Point2<f64>, b: &&Point2<f64>| a.y.total_cmp(&b.y);
    let (Some(bottom), Some(top)) = (outline.iter().min_by(by_height), outline.iter().max_by(by_height)) else {
        return limit;
    };
    let leftmost = outline.iter().map(|p| p.x).fold(f64::INFINITY, f64::min);
    let rightmost = outline.iter().map(|p| p.x).fold(f64::NEG_INFINITY, f64::max);
    let scan = |y: u32, least: f64| -> f64 {
        // Most rows are empty here.
        let window = (column(leftmost - least) - 1, column(rightmost + least) + 1);
        if obstacles.next_set(y, window.0, window.1).is_none() {
            return least;
        }
        let (low, high) = (f64::from(y), f64::from(y) + 1.0);
        let Some((left, right)) = columns_between(outline, (low - least, high + least)) else {
            return least;
        };
        let reached = (column(left - least) - 1, column(right + least) + 1);
        let (from, to) = columns_between(outline, (low, high)).unwrap_or_else(|| {
            let nearest = if low > top.y { top } else { bottom };
            (nearest.x, nearest.x)
        });
        let (from, to) = (column(from), column(to));
        if to - from > 1 && obstacles.next_set(y, from + 1, to - 1).is_some() {
            return 0.0;
        }
        let beside = [
            obstacles.previous_set(y, reached.0, from),
            obstacles.next_set(y, to, reached.1),
        ];
        let distances = beside.into_iter().flatten().map(|x| polygon_to_square(outline, x, y));
        distances.fold(least, f64::min)
    };
    let met = rows_within(obstacles, bottom.y, top.y);
    let within = rows_within(obstacles, bottom.y - limit, top.y + limit);
    let mut least = met.clone().fold(limit, |least, y| scan(y, least));
    let (mut below, mut above) = (met.start, met.end);
    loop {
        let is_below = below > within.start && bottom.y - f64::from(below) < least;
        let is_above = above < within.end && f64::from(above) - top.y < least;
        if is_below {
            below -= 1;
            least = scan(below, least);
        }
        if is_above {
            least = scan(above, least);
            above += 1;
        }
        if least <= 0.0 || !(is_below || is_above) {
            return least.max(0.0);
        }
    }
}

/// The range of x over the part of a convex polygon whose y lies between two values; `None` if there is no such part.
fn columns_between(outline: &[Point2<f64>], (low, high): (f64, f64)) -> Option<(f64, f64)> {
    let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
    let mut last = outline.last()?;
    for point in outline {
        let (below, above) = if point.y < last.y { (point, last) } else { (last, point) };
        if below.y <= high && above.y >= low {
            // A level edge has no slope; only its ends count.
            let slope = (above.x - below.x) / (above.y - below.y).max(f64::MIN_POSITIVE);
            let enter = if below.y < low {
                below.x + (low - below.y) * slope
            } else {
                below.x
            };
            let leave = if above.y > high {
                above.x + (high - above.y) * slope
            } else {
                above.x
            };
            left = left.min(enter.min(leave));
            right = right.max(enter.max(leave));
        }
        last = point;
    }
    (left <= right).then_some((left, right))
}

/// Whether a convex polygon, in cells, touches the closed square of an obstacle, to within rounding.
pub(super) fn polygon_touches(obstacles: &BitGrid, outline: &[Point2<f64>]) -> bool {
    let (low, high) = outline
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
            (low.min(p.y), high.max(p.y))
        });
    rows_within(obstacles, low, high).any(|y| {
        let row = (f64::from(y) - ROUNDING, f64::from(y) + 1.0 + ROUNDING);
        columns_between(outline, row).is_some_and(|(left, right)| {
            obstacles
                .next_set(y, column(left - ROUNDING), column(right + ROUNDING))
                .is_some()
        })
    })
}

/// Visits every set cell that a convex polygon, in cells, touches, except those with four set neighbours: anything close to one of those
/// is closer to another.
pub(super) fn outer_squares(bits: &BitGrid, outline: &[Point2<f64>], mut visit: impl FnMut(u32, u32)) {
    let (low, high) = outline
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
            (low.min(p.y), high.max(p.y))
        });
    if !(low.is_finite() && high.is_finite() && bits.width() > 0) {
        return;
    }
    let last_column = f64::from(bits.width() - 1);
    let word = |x: f64| x.clamp(0.0, last_column) as usize / 64;
    let (left, right) = outline
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(left, right), p| {
            (left.min(p.x), right.max(p.x))
        });
    let words = word(left)..=word(right);
    for y in rows_within(bits, low, high) {
        // Most rows are empty here.
        if bits.row(y)[words.clone()].iter().all(|word| *word == 0) {
            continue;
        }
        let Some((left, right)) = columns_between(outline, (f64::from(y), f64::from(y) + 1.0)) else {
            continue;
        };
        if right < 0.0 || left > last_column + 1.0 {
            continue;
        }
        let (first, last) = (
            left.clamp(0.0, last_column) as u32,
            right.clamp(0.0, last_column) as u32,
        );
        let row = bits.row(y);
        let beside = |y: Option<u32>, word: usize| y.filter(|y| *y < bits.height()).map_or(0, |y| bits.row(y)[word]);
        let words = row
            .iter()
            .enumerate()
            .take((last / 64) as usize + 1)
            .skip((first / 64) as usize);
        for (word, here) in words {
            let mut here = *here;
            if here == 0 {
                continue;
            }
            // At a word's ends neighbours count as unset, which adds a few squares.
            here &= !(here << 1 & here >> 1 & beside(y.checked_sub(1), word) & beside(Some(y + 1), word));
            while here != 0 {
                let x = word as u32 * 64 + here.trailing_zeros();
                here &= here - 1;
                if (first..=last).contains(&x) {
                    visit(x, y);
                }
            }
        }
    }
}

/// Anything nearer to an obstacle than this touches it, cells.
const ROUNDING: f64 = 1e-9;

/// Exact distance from a convex polygon (counter-clockwise) to the closed square of a cell, cells.
fn polygon_to_square(outline: &[Point2<f64>], x: u32, y: u32) -> f64 {
    let center = Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    if edges(outline).all(|Edge { a, b }| cross(b - a, center - a) >= 0.0) {
        return 0.0;
    }
    // The square's centre is outside, so a polygon that meets the square has an edge that does.
    edges(outline)
        .map(|Edge { a, b }| segment_to_square(a, b, x, y))
        .fold(f64::INFINITY, f64::min)
}
