//! Trajectory. Where is the robot to be, at which time, at which velocity?
//!
//! A path is a list of points; a trajectory is a path over time; a plan is a trajectory under the contract of
//! [`Plan`](crate::messages::Plan). On the wire a trajectory is the list of its points.

use std::fmt;
use std::ops::Deref;

use nalgebra::Point2;
use serde::{Deserialize, Serialize, Serializer};

use crate::geometry::{Pose2, Twist2, wrap_angle};

/// Greatest deviation of a thinned trajectory from any point of the original: m and rad, m/s and rad/s.
const STRAY: (f64, f64) = (5e-4, 2e-3);
const STRAY_SPEED: (f64, f64) = (5e-3, 1e-2);
/// Longest time between two points of a thinned trajectory, s.
const LONGEST_LEG: f64 = 2.0;
/// Most points inserted between two.
const MOST_BETWEEN: f64 = 1e4;

/// Desired pose and velocity of the robot at a time of the trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TrajectoryPoint {
    /// Time since the trajectory's start, s.
    pub t: f64,
    /// Map x, m.
    pub x: f64,
    /// Map y, m.
    pub y: f64,
    /// Heading in the map, rad.
    pub yaw: f64,
    /// Forward speed, m/s.
    pub v: f64,
    /// Yaw rate, rad/s.
    pub w: f64,
}

impl TrajectoryPoint {
    /// Column names of a displayed point.
    pub const CSV_HEADER: &str = "t,x,y,yaw,v,w";

    /// A pose and a velocity at a time (s).
    #[must_use]
    pub fn new(t: f64, pose: Pose2, twist: Twist2) -> Self {
        Self {
            t,
            x: pose.x,
            y: pose.y,
            yaw: pose.yaw,
            v: twist.v,
            w: twist.w,
        }
    }

    /// Its pose, map frame.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        Pose2 {
            x: self.x,
            y: self.y,
            yaw: self.yaw,
        }
    }

    /// Its position, map frame, m.
    #[must_use]
    pub fn position(&self) -> Point2<f64> {
        Point2::new(self.x, self.y)
    }

    /// Its velocity, base frame.
    #[must_use]
    pub fn twist(&self) -> Twist2 {
        Twist2::new(self.v, self.w)
    }

    /// Linear interpolation of time, pose and velocity: `share` 0 is this point, 1 is `to`.
    #[must_use]
    pub fn interpolate(&self, to: &Self, share: f64) -> Self {
        let between = |from: f64, to: f64| from + share * (to - from);
        Self::new(
            between(self.t, to.t),
            self.pose().interpolate(&to.pose(), share),
            Twist2::new(between(self.v, to.v), between(self.w, to.w)),
        )
    }

    /// Whether it is the same point to within the tolerance of thinning.
    fn is_near(&self, other: &Self) -> bool {
        self.pose().distance(&other.pose()) <= STRAY.0
            && wrap_angle(self.yaw - other.yaw).abs() <= STRAY.1
            && (self.v - other.v).abs() <= STRAY_SPEED.0
            && (self.w - other.w).abs() <= STRAY_SPEED.1
    }
}

impl fmt::Display for TrajectoryPoint {
    /// A row of a CSV file with the columns [`Self::CSV_HEADER`]; the digits round-trip.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { t, x, y, yaw, v, w } = self;
        write!(f, "{t},{x},{y},{yaw},{v},{w}")
    }
}

/// Points in the order of time, interpolated linearly. Dereferences to the slice of its points.
///
/// Time begins at zero, or below: a spliced trajectory keeps the rest of the previous one at negative times. A trajectory from an external
/// source may hold any numbers; it must be checked before it is driven. Sampling never panics.
///
/// ```
/// use zenav_protocol::geometry::{Pose2, Twist2};
/// use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};
///
/// let straight: Trajectory = [0.0, 1.0, 2.0]
///     .map(|t| TrajectoryPoint::new(t, Pose2::new(0.5 * t, 0.0, 0.0), Twist2::new(0.5, 0.0)))
///     .into_iter()
///     .collect();
/// assert_eq!((straight.duration(), straight.length()), (2.0, 1.0));
/// assert_eq!(straight.sample(1.5).x, 0.75);
/// assert_eq!(straight.length_left(1.5), 0.25);
/// ```
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(from = "Vec<TrajectoryPoint>")]
pub struct Trajectory {
    points: Vec<TrajectoryPoint>,
    /// Length of the path from the first point to each, m.
    lengths: Vec<f64>,
}

/// The point of a trajectory nearest to a given position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Time of the trajectory there, s.
    pub t: f64,
    /// Distance from the point, m.
    pub distance: f64,
}

impl Trajectory {
    /// From points in the order of time.
    #[must_use]
    pub fn new(points: Vec<TrajectoryPoint>) -> Self {
        let mut length = 0.0;
        let mut lengths = Vec::with_capacity(points.len());
        let mut last: Option<Pose2> = None;
        for point in &points {
            length += last.map_or(0.0, |last| last.distance(&point.pose()));
            lengths.push(length);
            last = Some(point.pose());
        }
        Self { points, lengths }
    }

    /// This trajectory, continued by another one that begins where this one ends.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        let (later, known) = (self.end_time() - next.start_time(), usize::from(!self.is_empty()));
        let shifted = next.iter().skip(known).map(|point| TrajectoryPoint {
            t: point.t + later,
            ..*point
        });
        self.iter().copied().chain(shifted).collect()
    }

    /// The same for a robot with rear and front exchanged: what was driven forwards is driven backwards.
    #[must_use]
    pub fn turned(&self) -> Self {
        let turned = self
            .iter()
            .map(|point| TrajectoryPoint::new(point.t, point.pose().turned(), Twist2::new(-point.v, point.w)));
        turned.collect()
    }

    /// The same trajectory in another frame.
    #[must_use]
    pub fn moved(&self, new_from_old: Pose2) -> Self {
        let moved = self
            .iter()
            .map(|point| TrajectoryPoint::new(point.t, new_from_old * point.pose(), point.twist()));
        moved.collect()
    }

    /// Its first time, s; zero without points.
    #[must_use]
    pub fn start_time(&self) -> f64 {
        self.points.first().map_or(0.0, |point| point.t)
    }

    /// Its last time, s; zero without points.
    #[must_use]
    pub fn end_time(&self) -> f64 {
        self.points.last().map_or(0.0, |point| point.t)
    }

    /// Time from the first point to the last, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.end_time() - self.start_time()
    }

    /// Length of its path, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.lengths.last().copied().unwrap_or(0.0)
    }

    /// Length of its path from a time (s) to the end, m.
    #[must_use]
    pub fn length_left(&self, t: f64) -> f64 {
        let next = self.next_index(t);
        let Some((to, length)) = self.points.get(next).zip(self.lengths.get(next)) else {
            return 0.0;
        };
        self.length() - length + self.sample(t).pose().distance(&to.pose())
    }

    /// The point at a time (s), interpolated linearly and held at both ends. Cost: logarithmic in the number of points.
    #[must_use]
    pub fn sample(&self, t: f64) -> TrajectoryPoint {
        let next = self.next_index(t);
        let (Some(from), to) = (self.points.get(next.saturating_sub(1)), self.points.get(next)) else {
            return TrajectoryPoint::default();
        };
        match to.filter(|to| next > 0 && to.t > from.t) {
            Some(to) => TrajectoryPoint {
                t,
                ..from.interpolate(to, (t - from.t) / (to.t - from.t))
            },
            None => TrajectoryPoint { t, ..*from },
        }
    }

    /// This trajectory from `now` up to `until` (s), then `next`, whose time zero is `until` here.
    ///
    /// ```
    /// use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};
    ///
    /// let at = |t: f64, x: f64| TrajectoryPoint { t, x, v: 1.0, ..TrajectoryPoint::default() };
    /// let driven = Trajectory::new(vec![at(0.0, 0.0), at(10.0, 10.0)]);
    /// // At 2 s a replan arrives that begins where the robot will be at 3 s.
    /// let replanned = Trajectory::new(vec![at(0.0, 3.0), at(5.0, 8.0)]);
    /// let spliced = driven.spliced(2.0, 3.0, &replanned);
    /// assert_eq!((spliced.start_time(), spliced.end_time()), (-1.0, 5.0));
    /// assert_eq!(spliced.sample(-0.5).x, 2.5);
    /// ```
    #[must_use]
    pub fn spliced(&self, now: f64, until: f64, next: &Self) -> Self {
        let mut points = Vec::with_capacity(next.len() + 64);
        if now < until && !self.is_empty() {
            let first = self.sample(now);
            let rest = self.points.iter().filter(|point| point.t > now && point.t < until);
            points.extend(std::iter::once(&first).chain(rest).map(|point| TrajectoryPoint {
                t: point.t - until,
                ..*point
            }));
        }
        points.extend_from_slice(next);
        Self::new(points)
    }

    /// The same with fewer digits for transmission: poses and velocities to a millionth of their units, times to a nanosecond. Halves the
    /// size.
    #[must_use]
    pub fn rounded(&self) -> Self {
        let millionth = |number: f64| (1e6 * number).round() / 1e6 + 0.0;
        self.points
            .iter()
            .map(|point| TrajectoryPoint {
                t: (1e9 * point.t).round() / 1e9,
                x: millionth(point.x),
                y: millionth(point.y),
                yaw: millionth(point.yaw),
                v: millionth(point.v),
                w: millionth(point.w),
            })
            .collect()
    }

    /// The same motion with fewer points: a point is dropped if it lies on the line between its neighbours to within half a millimetre, 2
    /// mrad, 5 mm/s and 10 mrad/s. Both ends are kept, and points at most 2 s apart.
    ///
    /// ```
    /// use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};
    ///
    /// // A straight metre at 1 m/s, a point every 10 ms.
    /// let points = (0..=100).map(|step| 0.01 * f64::from(step));
    /// let dense: Trajectory = points.map(|t| TrajectoryPoint { t, x: t, v: 1.0, ..TrajectoryPoint::default() }).collect();
    /// let thinned = dense.thinned();
    /// assert_eq!((dense.len(), thinned.len()), (101, 2));
    /// assert!((thinned.sample(0.5).x - 0.5).abs() < 5e-4);
    /// ```
    #[must_use]
    pub fn thinned(&self) -> Self {
        let mut kept: Vec<TrajectoryPoint> = self.points.first().copied().into_iter().collect();
        let mut from = 0;
        while let Some(begin) = self.points.get(from).filter(|_| from + 1 < self.points.len()) {
            let reaches = |to: &usize| {
                let Some(end) = self.points.get(*to).filter(|end| end.t - begin.t <= LONGEST_LEG) else {
                    return false;
                };
                let between = self.points.get(from + 1..*to).unwrap_or_default();
                between.iter().all(|point| {
                    let share = (point.t - begin.t) / (end.t - begin.t);
                    begin.interpolate(end, share).is_near(point)
                })
            };
            from = (from + 2..).take_while(reaches).last().unwrap_or(from + 1);
            kept.extend(self.points.get(from));
        }
        Self::new(kept)
    }

    /// The points from time `from` (s) on, with further points at even times between those that are more than `way` (m) or `turn` (rad)
    /// apart.
    pub fn spaced(&self, from: f64, way: f64, turn: f64) -> impl Iterator<Item = TrajectoryPoint> {
        let rest = self.rest(from);
        let legs = rest.windows(2).flat_map(move |leg| {
            let (begin, end) = (leg[0], leg[1]);
            let turned = wrap_angle(end.yaw - begin.yaw).abs();
            let steps = (begin.pose().distance(&end.pose()) / way).max(turned / turn).ceil();
            let steps = steps.clamp(1.0, MOST_BETWEEN) as u32;
            (1..=steps).map(move |step| match step == steps {
                true => end,
                false => begin.interpolate(&end, f64::from(step) / f64::from(steps)),
            })
        });
        let all = rest.first().copied().into_iter().chain(legs);
        all.filter(move |point| point.t >= from)
    }

    /// The points from the last one at or before a time (s) on.
    #[must_use]
    pub fn rest(&self, t: f64) -> &[TrajectoryPoint] {
        self.points
            .get(self.next_index(t).saturating_sub(1)..)
            .unwrap_or_default()
    }

    /// The point nearest to a position (map frame) from time `from` (s) on, searched `window` (m) ahead along the path, so that a path that
    /// returns close to itself is not cut short. Of several equally near points, the last.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};
    ///
    /// // 2 m along the x axis in 2 s, and back.
    /// let at = |t: f64, x: f64| TrajectoryPoint { t, x, ..TrajectoryPoint::default() };
    /// let trajectory = Trajectory::new(vec![at(0.0, 0.0), at(2.0, 2.0), at(4.0, 0.0)]);
    /// let robot = Point2::new(0.5, 0.1);
    /// assert_eq!(trajectory.nearest_ahead(0.0, robot, 1.0).t, 0.5, "on the way there");
    /// assert_eq!(trajectory.nearest_ahead(2.5, robot, 1.0).t, 3.5, "on the way back");
    /// ```
    #[must_use]
    pub fn nearest_ahead(&self, from: f64, point: Point2<f64>, window: f64) -> Nearest {
        let first = self.next_index(from).saturating_sub(1);
        let limit = self.lengths.get(first).copied().unwrap_or(0.0) + window;
        let mut best = Nearest {
            t: from,
            distance: f64::INFINITY,
        };
        let legs = self.points.windows(2).zip(&self.lengths).skip(first);
        for (leg, _) in legs.take_while(|(_, length)| **length <= limit) {
            let [begin, end] = leg else { continue };
            let (origin, along) = (begin.position(), end.position() - begin.position());
            let squared = along.norm_squared();
            // A turn on the spot counts as passed at once.
            let share = if squared > 0.0 {
                ((point - origin).dot(&along) / squared).clamp(0.0, 1.0)
            } else {
                1.0
            };
            let distance = (point - (origin + along * share)).norm();
            if distance <= best.distance + 1e-9 {
                let t = begin.t + share * (end.t - begin.t);
                best = Nearest { t, distance };
            }
        }
        if !best.distance.is_finite() {
            best.distance = (self.sample(from).position() - point).norm();
        }
        best
    }

    /// Positions along the path, `spacing` (m) apart, without the first but with the last.
    #[must_use]
    pub fn positions_spaced(&self, spacing: f64) -> Vec<Point2<f64>> {
        let mut positions = Vec::new();
        let (mut length, mut last) = (0.0, None::<TrajectoryPoint>);
        for point in self.spaced(f64::NEG_INFINITY, 0.1 * spacing, f64::INFINITY) {
            length += last.map_or(0.0, |last| last.pose().distance(&point.pose()));
            last = Some(point);
            if length >= spacing {
                positions.push(point.position());
                length = 0.0;
            }
        }
        positions.extend(self.points.last().map(TrajectoryPoint::position));
        positions
    }

    /// Index of the first point after a time.
    fn next_index(&self, t: f64) -> usize {
        self.points.partition_point(|point| point.t <= t)
    }
}

impl Deref for Trajectory {
    type Target = [TrajectoryPoint];

    fn deref(&self) -> &[TrajectoryPoint] {
        &self.points
    }
}

impl From<Vec<TrajectoryPoint>> for Trajectory {
    fn from(points: Vec<TrajectoryPoint>) -> Self {
        Self::new(points)
    }
}

impl FromIterator<TrajectoryPoint> for Trajectory {
    fn from_iter<I: IntoIterator<Item = TrajectoryPoint>>(points: I) -> Self {
        Self::new(points.into_iter().collect())
    }
}

impl Serialize for Trajectory {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.points.serialize(serializer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// An L of 3 m and 1 m at 0.5 m/s, points 0.1 s apart.
    fn corner() -> Trajectory {
        let at = |t: f64| {
            if t < 6.0 {
                Pose2::new(0.5 * t, 0.0, 0.0)
            } else {
                Pose2::new(3.0, 0.5 * t - 3.0, std::f64::consts::FRAC_PI_2)
            }
        };
        let times = (0..=80).map(|step| f64::from(step) * 0.1);
        times
            .map(|t| TrajectoryPoint::new(t, at(t), Twist2::new(0.5, 0.0)))
            .collect()
    }

    #[test]
    fn rounded_numbers_are_short_and_near() {
        let exact: Trajectory = [(0.0, 1.0), (0.1234567891234, -1e-13)]
            .map(|(t, x)| TrajectoryPoint {
                t,
                x: x / 3.0,
                v: -0.0,
                ..TrajectoryPoint::default()
            })
            .into_iter()
            .collect();
        let rounded = exact.rounded();
        let text = serde_json::to_string(&rounded).unwrap();
        assert_eq!(
            text,
            r#"[{"t":0.0,"x":0.333333,"y":0.0,"yaw":0.0,"v":0.0,"w":0.0},{"t":0.123456789,"x":0.0,"y":0.0,"yaw":0.0,"v":0.0,"w":0.0}]"#
        );
        assert_eq!(rounded.rounded(), rounded);
    }

    #[test]
    fn a_thinned_trajectory_is_the_same_motion_by_fewer_points() {
        // Speeds up, drives a bend and a straight, and brakes.
        let mut at = TrajectoryPoint::default();
        let points = (0..=400).map(|step| {
            let here = at;
            let t = 0.05 * f64::from(step);
            at.v = (0.4 * t).min(0.6).min(0.4 * (20.0 - t));
            at.w = if (5.0..8.0).contains(&t) { 0.5 * at.v } else { 0.0 };
            let pose = here.pose().advance(at.twist(), 0.05);
            at = TrajectoryPoint::new(t + 0.05, pose, at.twist());
            here
        });
        let dense: Trajectory = points.collect();
        let thinned = dense.thinned();
        assert!(4 * thinned.len() < dense.len(), "{}", thinned.len());
        assert_eq!((thinned.first(), thinned.last()), (dense.first(), dense.last()));
        assert!(dense.iter().all(|point| thinned.sample(point.t).is_near(point)));
        assert!(thinned.windows(2).all(|pair| pair[1].t - pair[0].t <= LONGEST_LEG));
        let again: Vec<_> = thinned.spaced(f64::NEG_INFINITY, 0.05, 0.1).collect();
        assert!(
            again
                .windows(2)
                .all(|pair| pair[0].t < pair[1].t && pair[0].pose().distance(&pair[1].pose()) < 0.051)
        );
        assert_eq!((again.first(), again.last()), (dense.first(), dense.last()));
        let alone = Trajectory::new(vec![dense[0]]);
        assert_eq!(
            (alone.thinned(), Trajectory::default().thinned()),
            (alone.clone(), Trajectory::default())
        );
    }

    #[test]
    fn a_splice_keeps_the_old_trajectory_until_the_new_one_begins() {
        let old = corner();
        let next: Trajectory = old
            .iter()
            .filter(|point| point.t >= 3.0)
            .map(|point| TrajectoryPoint {
                t: point.t - 3.0,
                ..*point
            })
            .collect();
        let merged = old.spliced(2.5, 3.0, &next);
        assert!((merged.start_time() + 0.5).abs() < 1e-12 && (merged.end_time() - 5.0).abs() < 1e-9);
        assert!(merged.sample(-0.25).pose().distance(&old.sample(2.75).pose()) < 1e-9);
        assert!(merged.windows(2).all(|pair| pair[0].t < pair[1].t));
    }

    #[test]
    fn a_trajectory_is_held_at_both_ends_and_as_long_as_its_legs() {
        let corner = corner();
        assert_eq!((corner.sample(-1.0).x, corner.sample(99.0).y), (0.0, corner[80].y));
        assert_eq!(Trajectory::default().sample(1.0), TrajectoryPoint::default());
        assert!((corner.length() - 4.0).abs() < 1e-9 && (corner.length_left(0.0) - 4.0).abs() < 1e-9);
        assert!((corner.length_left(7.0) - 0.5).abs() < 1e-9 && corner.length_left(8.0) == 0.0);
        let positions = corner.positions_spaced(0.5);
        assert!(positions.len() >= 8 && *positions.last().unwrap() == corner[80].position());
    }

    #[test]
    fn the_nearest_place_is_looked_for_ahead_and_not_beyond_the_window() {
        let there = corner();
        let back = there.iter().rev().map(|point| TrajectoryPoint {
            t: 16.0 - point.t,
            ..*point
        });
        let there_and_back: Trajectory = there.iter().copied().chain(back.skip(1)).collect();
        let near = |from, window| there_and_back.nearest_ahead(from, Point2::new(1.0, 0.2), window);
        assert!((near(0.0, 2.0).t - 2.0).abs() < 1e-9 && (near(0.0, 2.0).distance - 0.2).abs() < 1e-9);
        assert!((near(3.0, f64::INFINITY).t - 14.0).abs() < 1e-9);
        assert!((near(3.0, 0.4).t - 3.0).abs() < 1e-9);
        let alone = Trajectory::new(vec![there[0]]).nearest_ahead(0.0, Point2::new(0.0, 2.0), 1.0);
        assert_eq!((alone.t, alone.distance), (0.0, 2.0));
    }

    #[test]
    fn on_the_wire_it_is_the_list_of_its_points() {
        let text = r#"[{"t":0.0,"x":1.0,"y":2.0,"yaw":0.5,"v":0.25,"w":0.0}]"#;
        let trajectory: Trajectory = serde_json::from_str(text).unwrap();
        assert_eq!(trajectory.len(), 1);
        assert_eq!(serde_json::to_string(&trajectory).unwrap(), text);
    }

    proptest! {
        #[test]
        fn sampling_any_numbers_does_no_harm(numbers in prop::collection::vec((any::<f64>(), any::<f64>()), 0..6), t in any::<f64>()) {
            let points = numbers.into_iter().map(|(t, x)| TrajectoryPoint { t, x, ..TrajectoryPoint::default() });
            let trajectory: Trajectory = points.collect();
            let _ = (trajectory.sample(t), trajectory.length_left(t), trajectory.rest(t));
            let _ = trajectory.nearest_ahead(t, Point2::new(t, 0.0), 1.0);
            let _ = trajectory.spliced(t, 2.0 * t, &trajectory);
        }
    }
}
