//! Polyline path. Where on a path is the robot, how much of it is left, what is a part of it, and which legs are driven backwards? In m, map
//! frame.
//!
//! Nav2's paths have a pose every few centimetres, and its nodes search the closest pose; here the closest point of the line is used.

use nalgebra::Point2;
use zenav_protocol::polygon::cross;
use zenav_protocol::trajectory::TrajectoryPoint;

/// Mean speed above which a leg of a trajectory has a direction, m/s; below it, it is a turn on the spot.
const MOVES: f64 = 1e-3;
/// Stretches of a path whose distances from the robot differ by less than this are equally near, m: about as well as it is localised.
const AS_NEAR: f64 = 0.05;

/// A path, and which of its legs are driven backwards.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DrivenPath {
    /// Corner points.
    pub points: Vec<Point2<f64>>,
    /// Legs driven backwards, each by the index of its first corner, ascending.
    pub backwards: Vec<usize>,
}

impl DrivenPath {
    /// A path that is driven forwards.
    #[must_use]
    pub fn forwards(points: Vec<Point2<f64>>) -> Self {
        Self {
            points,
            backwards: Vec::new(),
        }
    }

    /// The path of a trajectory, to within `tolerance` m. Every point where the robot changes between forwards and backwards is a corner.
    #[must_use]
    pub fn of(trajectory: &[TrajectoryPoint], tolerance: f64) -> Self {
        let mut is_backwards = trajectory.windows(2).find_map(goes_backwards).unwrap_or(false);
        let mut whole = Self::default();
        let mut piece: Vec<Point2<f64>> = trajectory.first().map(TrajectoryPoint::position).into_iter().collect();
        for leg in trajectory.windows(2) {
            let [from, to] = leg else { continue };
            let is_next_backwards = goes_backwards(leg).unwrap_or(is_backwards);
            if is_next_backwards != is_backwards {
                whole.extend(simplified(&piece, tolerance), is_backwards);
                (piece, is_backwards) = (vec![from.position()], is_next_backwards);
            }
            piece.push(to.position());
        }
        whole.extend(simplified(&piece, tolerance), is_backwards);
        whole
    }

    /// Appends a piece that begins at the last corner.
    fn extend(&mut self, piece: Vec<Point2<f64>>, is_backwards: bool) {
        let known = usize::from(!self.points.is_empty());
        for point in piece.into_iter().skip(known) {
            self.push(point, is_backwards);
        }
    }

    /// Appends a corner, and the leg that leads to it.
    pub fn push(&mut self, point: Point2<f64>, is_backwards: bool) {
        if is_backwards && let Some(leg) = self.points.len().checked_sub(1) {
            self.backwards.push(leg);
        }
        self.points.push(point);
    }

    /// Every corner, and whether the leg that leads to it is driven backwards.
    pub fn corners(&self) -> impl Iterator<Item = (Point2<f64>, bool)> {
        self.points.iter().enumerate().map(move |(corner, point)| {
            let leg = corner.checked_sub(1);
            (*point, leg.is_some_and(|leg| self.is_backwards(leg)))
        })
    }

    /// The part from `from` to `to` m, including the cut ends.
    #[must_use]
    pub fn part(&self, from: f64, to: f64) -> Self {
        let mut part = Self::default();
        for (point, leg) in cut(&self.points, from, to) {
            part.push(point, self.is_backwards(leg));
        }
        part
    }

    /// The point nearest to `place` between `from` and `to` m, as [`nearest`].
    ///
    /// A path with reverse legs leads back over itself. Of stretches that are equally near, the first one counts that is not driven yet: none
    /// within the first `driven` m, and none whose end is reached if a later one is nearer. If the robot is near none of them, because a
    /// correction has set it back, it is still on the stretch that it was on.
    #[must_use]
    pub(crate) fn nearest(&self, place: Point2<f64>, from: f64, to: f64, driven: f64) -> Option<Nearest> {
        let anywhere = nearest(&self.points, place, from, to)?;
        if self.backwards.is_empty() {
            return Some(anywhere);
        }
        let begin = from.max(driven);
        let is_left = |(first, last): &(f64, f64)| *last > begin && *first <= to;
        let is_near = |near: &Nearest| near.distance <= anywhere.distance + AS_NEAR;
        let stretches = self.stretches();
        let near: Vec<(Nearest, bool)> = stretches
            .iter()
            .copied()
            .filter(is_left)
            .filter_map(|(first, last)| {
                let near = nearest(&self.points, place, first.max(begin), last.min(to))?;
                let is_at_end = last - near.along <= AS_NEAR.min(0.5 * (last - first));
                Some((near, is_at_end))
            })
            .filter(|(near, _)| is_near(near))
            .collect();
        let first = near.iter().find(|(_, is_at_end)| !is_at_end);
        let closest = near.iter().min_by(|(a, _), (b, _)| a.distance.total_cmp(&b.distance));
        let chosen = [first, closest].into_iter().flatten().map(|(near, _)| *near);
        let set_back = || {
            let mut stretches = stretches.iter().copied();
            let (first, last) = stretches.find(|(first, last)| (*first..*last).contains(&begin))?;
            nearest(&self.points, place, first.max(from), last.min(to)).filter(is_near)
        };
        let ahead = chosen.min_by(|a, b| a.along.total_cmp(&b.along));
        ahead.or_else(set_back).or(Some(anywhere))
    }

    /// Its stretches between two changes of direction: begin and end of each, m. The last one has no end.
    fn stretches(&self) -> Vec<(f64, f64)> {
        let changes = segments(&self.points)
            .enumerate()
            .filter(|(leg, _)| *leg > 0 && self.is_backwards(*leg) != self.is_backwards(leg - 1))
            .map(|(_, (begin, ..))| begin);
        let begins: Vec<f64> = std::iter::once(0.0).chain(changes).collect();
        let ends = begins.iter().skip(1).copied().chain([f64::INFINITY]);
        begins.iter().copied().zip(ends).collect()
    }

    fn is_backwards(&self, leg: usize) -> bool {
        self.backwards.binary_search(&leg).is_ok()
    }
}

/// Whether the robot drives backwards between two points of a trajectory; `None` if it hardly moves.
fn goes_backwards(leg: &[TrajectoryPoint]) -> Option<bool> {
    let [from, to] = leg else { return None };
    let speed = 0.5 * (from.v + to.v);
    (speed.abs() > MOVES).then_some(speed < 0.0)
}

/// The point of a path nearest to a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearest {
    /// Length of the path up to the point, m.
    pub along: f64,
    /// Distance from the place, m.
    pub distance: f64,
    /// Signed distance, positive to the left of the path; before its beginning, only the lateral part.
    pub left: f64,
    /// Heading of the path there, rad.
    pub heading: f64,
    /// The leg that it lies on, by the index of its first corner.
    pub leg: usize,
}

/// Length, m.
#[must_use]
pub(crate) fn length(points: &[Point2<f64>]) -> f64 {
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
pub(crate) fn nearest(points: &[Point2<f64>], place: Point2<f64>, from: f64, to: f64) -> Option<Nearest> {
    if let [only] = points {
        let distance = (place - only).norm();
        return Some(Nearest {
            along: 0.0,
            distance,
            left: distance,
            heading: 0.0,
            leg: 0,
        });
    }
    let mut best: Option<Nearest> = None;
    for (leg, (begin, a, b)) in segments(points).enumerate() {
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
            let aside = cross(unit, across);
            best = Some(Nearest {
                along: begin + at,
                distance,
                left: if begin + at > 0.0 {
                    distance.copysign(aside)
                } else {
                    aside
                },
                heading: unit.y.atan2(unit.x),
                leg,
            });
        }
    }
    best
}

/// The part from `from` to `to` m of the path, including the cut ends. A part without length is one point.
#[must_use]
pub(crate) fn part(points: &[Point2<f64>], from: f64, to: f64) -> Vec<Point2<f64>> {
    let cut = cut(points, from, to);
    cut.into_iter().map(|(point, _)| point).collect()
}

/// The corners of a part, each with the leg of the whole path that leads to it.
fn cut(points: &[Point2<f64>], from: f64, to: f64) -> Vec<(Point2<f64>, usize)> {
    let Some(first) = points.first() else { return Vec::new() };
    let whole = length(points);
    let (from, to) = (from.clamp(0.0, whole), to.clamp(0.0, whole));
    let mut cut: Vec<(Point2<f64>, usize)> = Vec::new();
    for (leg, (begin, a, b)) in segments(points).enumerate() {
        let long = (b - a).norm();
        if long <= 0.0 || begin + long < from || begin > to {
            continue;
        }
        let at = |along: f64| a + (b - a) * ((along - begin) / long).clamp(0.0, 1.0);
        if cut.is_empty() {
            cut.push((at(from), leg));
        }
        let end = at(to.min(begin + long));
        if cut.last().is_none_or(|(last, _)| *last != end) {
            cut.push((end, leg));
        }
    }
    if cut.is_empty() {
        cut.push((*first, 0));
    }
    cut
}

/// The corners needed to keep the path within `tolerance` m (Douglas and Peucker, 1973); always includes both ends.
#[must_use]
pub(crate) fn simplified(points: &[Point2<f64>], tolerance: f64) -> Vec<Point2<f64>> {
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
pub(crate) fn spaced(points: &[Point2<f64>], spacing: f64, most: usize) -> Vec<(Point2<f64>, f64)> {
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

    #[test]
    fn the_path_of_a_trajectory_has_a_corner_where_the_robot_changes_direction() {
        let at = |x: f64, v: f64| TrajectoryPoint {
            x,
            v,
            ..TrajectoryPoint::default()
        };
        let driven = |trajectory: &[TrajectoryPoint]| {
            let path = DrivenPath::of(trajectory, 0.01);
            let along: Vec<f64> = path.points.iter().map(|point| point.x).collect();
            (along, path.backwards)
        };
        // All on one line: two metres, a turn on the spot, one metre back, and on.
        let ahead = [at(0.0, 0.0), at(1.0, 0.5), at(2.0, 0.0), at(2.0, 0.0)];
        let back = [at(1.5, -0.5), at(1.0, 0.0)];
        let on = [at(3.0, 0.5), at(4.0, 0.0)];
        let expected = (vec![0.0, 2.0, 1.0, 4.0], vec![1]);
        assert_eq!(driven(&[&ahead[..], &back, &on].concat()), expected);
        // It turns first.
        let backs = [at(0.0, 0.0), at(0.0, 0.0), at(-1.0, -0.5), at(-2.0, 0.0)];
        assert_eq!(driven(&backs), (vec![0.0, -2.0], vec![0]));
        assert_eq!(driven(&ahead), (vec![0.0, 2.0], Vec::new()));
        assert_eq!(driven(&[]), (Vec::new(), Vec::new()));
    }

    #[test]
    fn a_part_keeps_which_of_its_legs_are_driven_backwards() {
        let path = DrivenPath {
            points: [0.0, 4.0, 2.0, 3.0].map(|x| Point2::new(x, 0.0)).to_vec(),
            backwards: vec![1],
        };
        let legs = |from: f64, to: f64| {
            let rest = path.part(from, to);
            assert_eq!(rest.points, part(&path.points, from, to));
            (rest.points.len() - 1, rest.backwards)
        };
        assert_eq!(legs(0.0, 9.0), (3, vec![1]));
        assert_eq!(legs(4.0, 9.0), (2, vec![0]), "from its beginning on");
        assert_eq!(legs(5.0, 6.5), (2, vec![0]), "from within it");
        assert_eq!(legs(1.0, 4.0), (1, vec![]), "up to it");
        assert_eq!(legs(6.0, 9.0), (1, vec![]), "after it");
        assert_eq!(legs(5.0, 5.0), (0, vec![]));
    }

    #[test]
    fn of_two_legs_that_are_equally_near_the_first_one_counts_that_is_not_driven_yet() {
        let path = |corners: &[(f64, f64)], backwards: &[usize]| DrivenPath {
            points: corners.iter().map(|(x, y)| Point2::new(*x, *y)).collect(),
            backwards: backwards.to_vec(),
        };
        let along = |path: &DrivenPath, x: f64, y: f64, driven: f64| {
            let near = path.nearest(Point2::new(x, y), 0.0, f64::INFINITY, driven).unwrap();
            (near.along * 1e3).round() / 1e3
        };
        // One metre back, then ahead over the same ground.
        let back = path(&[(0.0, 0.0), (-1.0, 0.0), (12.0, 0.0)], &[0]);
        for (x, expected) in [(0.001, 0.0), (0.04, 0.0), (0.2, 2.2), (-0.4, 0.4)] {
            assert_eq!(along(&back, x, 0.0, 0.0), expected, "at {x}");
        }
        for (x, driven, expected) in [(-0.9, 1.03, 1.1), (-0.91, 1.1, 1.1), (0.001, 1.9, 2.001)] {
            assert_eq!(along(&back, x, 0.0, driven), expected, "at {x}, after {driven} m");
        }
        // A correction sets it back on the leg that it is on, not to one that it has driven.
        for (x, driven, expected) in [(-0.57, 1.5, 1.43), (-0.4, 9.0, 1.6)] {
            assert_eq!(along(&back, x, 0.0, driven), expected, "at {x}, after {driven} m");
        }
        // A leg of two centimetres counts, too.
        let short = path(&[(0.0, 0.0), (-0.02, 0.0), (12.0, 0.0)], &[0]);
        assert_eq!(along(&short, 0.001, 0.0, 0.0), 0.0);
        // Near the corner between two legs, the robot neither returns to it nor skips what is left before it.
        let aside = path(&[(0.0, 0.0), (4.0, 0.0), (4.0, -3.0)], &[1]);
        assert_eq!(along(&aside, 3.98, 0.0, 0.0), 3.98);
        assert_eq!(along(&aside, 4.0, -0.02, 0.0), 4.02);
        assert_eq!(along(&aside, 1.0, 0.0, 5.0), 1.0, "it was moved off that leg");
        // Without reverse legs, the nearest point of all.
        let forwards = path(&[(0.0, 0.0), (-1.0, 0.0), (12.0, 0.0)], &[]);
        assert_eq!(along(&forwards, 0.001, 0.0, 0.0), 2.001);
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
