//! Polyline path. Where on a path is the robot, how much of it is left, and what is a part of it? In m, map frame.
//!
//! Nav2's paths have a pose every few centimetres, and its nodes search the closest pose; here the closest point of the line is used.

use nalgebra::Point2;

/// The point of a path nearest to a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Length of the path up to the point, m.
    pub along: f64,
    /// Distance from the place, m.
    pub distance: f64,
    /// Signed distance, positive to the left of the path; before its beginning, only the lateral part.
    pub left: f64,
    /// Heading of the path there, rad.
    pub heading: f64,
}

/// Length, m.
#[must_use]
pub fn length(points: &[Point2<f64>]) -> f64 {
    segments(points).map(|(_, a, b)| (b - a).norm()).sum()
}

/// Every segment of a path: its beginning, m along the path, and its ends.
fn segments(points: &[Point2<f64>]) -> impl Iterator<Item = (f64, Point2<f64>, Point2<f64>)> {
    let mut along = 0.0;
    points.iter().zip(points.iter().skip(1)).map(move |(a, b)| {
        let begin = along;
        along += (b - a).norm();
        (begin, *a, *b)
    })
}

/// The point nearest to `place` between `from` and `to` m of the path; `None` for a path without points or an empty part.
#[must_use]
pub fn nearest(points: &[Point2<f64>], place: Point2<f64>, from: f64, to: f64) -> Option<Nearest> {
    if let [only] = points {
        let distance = (place - only).norm();
        return Some(Nearest {
            along: 0.0,
            distance,
            left: distance,
            heading: 0.0,
        });
    }
    let mut best: Option<Nearest> = None;
    for (begin, a, b) in segments(points) {
        let step = b - a;
        let long = step.norm();
        if begin > to || begin + long < from {
            continue;
        }
        let (first, last) = ((from - begin).max(0.0), (to - begin).min(long));
        let unit = if long > 0.0 { step / long } else { step };
        let at = (place - a).dot(&unit).clamp(first, last.max(first));
        let across = place - (a + unit * at);
        let distance = across.norm();
        if best.is_none_or(|best| distance < best.distance) {
            let aside = unit.x * across.y - unit.y * across.x;
            best = Some(Nearest {
                along: begin + at,
                distance,
                left: if begin + at > 0.0 {
                    distance.copysign(aside)
                } else {
                    aside
                },
                heading: unit.y.atan2(unit.x),
            });
        }
    }
    best
}

/// The part from `from` to `to` m of the path, including the cut ends. A part without length is one point.
#[must_use]
pub fn part(points: &[Point2<f64>], from: f64, to: f64) -> Vec<Point2<f64>> {
    let Some(first) = points.first() else { return Vec::new() };
    let whole = length(points);
    let (from, to) = (from.clamp(0.0, whole), to.clamp(0.0, whole));
    let mut cut: Vec<Point2<f64>> = Vec::new();
    for (begin, a, b) in segments(points) {
        let long = (b - a).norm();
        if long <= 0.0 || begin + long < from || begin > to {
            continue;
        }
        let at = |along: f64| a + (b - a) * ((along - begin) / long).clamp(0.0, 1.0);
        if cut.is_empty() {
            cut.push(at(from));
        }
        let end = at(to.min(begin + long));
        if cut.last() != Some(&end) {
            cut.push(end);
        }
    }
    if cut.is_empty() {
        cut.push(*first);
    }
    cut
}

/// The corners needed to keep the path within `tolerance` m (Douglas and Peucker, 1973); always includes both ends.
#[must_use]
pub fn simplified(points: &[Point2<f64>], tolerance: f64) -> Vec<Point2<f64>> {
    let Some(last) = points.len().checked_sub(1) else {
        return Vec::new();
    };
    let mut kept = vec![0, last];
    let mut parts = vec![(0, last)];
    while let Some((first, last)) = parts.pop() {
        let (Some(from), Some(to), Some(between)) = (points.get(first), points.get(last), points.get(first..last))
        else {
            continue;
        };
        let off =
            |point: &Point2<f64>| nearest(&[*from, *to], *point, 0.0, f64::INFINITY).map_or(0.0, |near| near.distance);
        let worst = between
            .iter()
            .map(off)
            .enumerate()
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        if let Some((index, _)) = worst.filter(|(_, off)| *off > tolerance) {
            let middle = first + index;
            kept.push(middle);
            parts.extend([(first, middle), (middle, last)]);
        }
    }
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter()
        .filter_map(|index| points.get(index).copied())
        .collect()
}

/// Points on a path, at most `spacing` m apart, including ends and corners, each with its heading; at most `most`.
#[must_use]
pub fn spaced(points: &[Point2<f64>], spacing: f64, most: usize) -> Vec<(Point2<f64>, f64)> {
    let mut poses = Vec::new();
    for (_, a, b) in segments(points) {
        let step = b - a;
        let heading = step.y.atan2(step.x);
        let count = (step.norm() / spacing).ceil().clamp(1.0, most as f64) as usize;
        for index in 0..=count {
            if poses.len() == most {
                return poses;
            }
            poses.push((a + step * (index as f64 / count as f64), heading));
        }
    }
    if let (true, Some(only)) = (poses.is_empty(), points.first()) {
        poses.push((*only, 0.0));
    }
    poses
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn corner() -> Vec<Point2<f64>> {
        vec![Point2::new(0.0, 0.0), Point2::new(2.0, 0.0), Point2::new(2.0, 3.0)]
    }

    #[test]
    fn the_nearest_point_is_on_the_line_with_its_side_and_heading() {
        let near = nearest(&corner(), Point2::new(1.5, 0.2), 0.0, f64::INFINITY).unwrap();
        assert!((near.along - 1.5).abs() < 1e-12 && (near.left - 0.2).abs() < 1e-12 && near.heading == 0.0);
        let near = nearest(&corner(), Point2::new(2.3, 1.0), 0.0, f64::INFINITY).unwrap();
        assert!(
            (near.along - 3.0).abs() < 1e-12 && (near.left + 0.3).abs() < 1e-12,
            "{near:?}"
        );
        let before = nearest(&corner(), Point2::new(-1.0, 0.1), 0.0, f64::INFINITY).unwrap();
        assert!((before.left - 0.1).abs() < 1e-12 && before.distance > 1.0);
        assert_eq!(nearest(&[], Point2::origin(), 0.0, 1.0), None);
    }

    #[test]
    fn a_search_that_is_bounded_does_not_jump_ahead() {
        // The path returns beside itself.
        let path = [(0.0, 0.0), (4.0, 0.0), (4.0, 0.5), (0.0, 0.5)].map(|(x, y)| Point2::new(x, y));
        let place = Point2::new(0.2, 0.4);
        assert!(nearest(&path, place, 0.0, f64::INFINITY).unwrap().along > 8.0);
        assert!(nearest(&path, place, 0.0, 1.5).unwrap().along < 0.3);
    }

    #[test]
    fn a_part_has_the_corners_in_it_and_its_own_ends() {
        let expected = [(1.0, 0.0), (2.0, 0.0), (2.0, 1.0)].map(|(x, y)| Point2::new(x, y));
        assert_eq!(part(&corner(), 1.0, 3.0), expected);
        assert_eq!(part(&corner(), 9.0, 9.0), [Point2::new(2.0, 3.0)]);
        assert_eq!(part(&corner(), 0.0, 0.0), [Point2::origin()]);
        assert!(part(&[], 0.0, 1.0).is_empty());
    }

    proptest! {
        #[test]
        fn a_simplified_path_is_nowhere_far_from_the_whole(
            points in prop::collection::vec((-3.0..3.0, -3.0..3.0).prop_map(|(x, y)| Point2::new(x, y)), 1..40),
        ) {
            let few = simplified(&points, 0.5);
            prop_assert_eq!((few.first(), few.last()), (points.first(), points.last()));
            for point in &points {
                prop_assert!(nearest(&few, *point, 0.0, f64::INFINITY).unwrap().distance <= 0.5 + 1e-9);
            }
        }

        #[test]
        fn two_parts_are_as_long_as_the_whole(
            points in prop::collection::vec((-9.0..9.0, -9.0..9.0).prop_map(|(x, y)| Point2::new(x, y)), 2..9),
            share in 0.0..1.0,
        ) {
            let whole = length(&points);
            let cut = whole * share;
            let both = length(&part(&points, 0.0, cut)) + length(&part(&points, cut, whole));
            prop_assert!((both - whole).abs() < 1e-9 * (1.0 + whole));
        }
    }
}
