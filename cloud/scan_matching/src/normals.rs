//! Normals. Which way does the surface look that a point lies on, as far as its neighbours in the scan tell?
//!
//! A straight surface is a line through the neighbours, a round one a parabola: both to within the noise that the scan itself shows. Where
//! neither fits, as about a corner, nobody knows.

use nalgebra::{Matrix3, Point2, Vector2, Vector3};

/// Neighbours on one surface are at most this far apart, m and rad as seen from the base. Joined by distance as well, points about the corners
/// of a door next to the robot seem to lie on a round surface.
const FARTHEST: f64 = 1.0;
const NEIGHBOURS: f64 = 0.03;
/// Neighbours up to this distance to each side, and the first beyond, tell the direction of a surface, m.
const STRETCH: f64 = 0.2;
/// They lie on it to within so many standard deviations of the noise, which is at least and at most this, m.
const DEVIATIONS: f64 = 1.8;
const NOISE: [f64; 2] = [0.0035, 0.017];
/// On a straight surface their variance across it is at most this share of that along it.
const FLAT: f64 = 0.05;
/// A round surface has at least so many points, and its curvature is at most this, 1/m.
const ROUND: usize = 5;
const CURVATURE: f64 = 6.0;
/// Three points in a row show noise where the outer ones are nearer than this, m.
const CHORD: f64 = 0.4;
/// Median distance of the middle of three points from the chord of the others, in standard deviations of a point.
const MEDIAN: f64 = 0.6745 * 1.2247;

/// The unit normals of the surfaces that points lie on, towards the `laser` that saw them.
pub(crate) fn normals(laser: Point2<f64>, points: &[Point2<f64>]) -> Vec<Option<Vector2<f64>>> {
    let is_near = |pair: &[Point2<f64>]| {
        let [a, b] = [pair[0].coords, pair[1].coords];
        (b - a).norm_squared() <= FARTHEST * FARTHEST && a.perp(&b).abs() <= NEIGHBOURS.tan() * a.dot(&b)
    };
    // Whether a point and the one after it lie on one surface.
    let joined: Vec<bool> = points.windows(2).map(is_near).collect();
    let within = DEVIATIONS * noise(points).clamp(NOISE[0], NOISE[1]);
    let of = |number: usize| {
        let is_within = |other: usize| (points[number] - points[other]).norm_squared() < STRETCH * STRETCH;
        let (mut first, mut last) = (number, number);
        while first > 0 && joined[first - 1] && is_within(first) {
            first -= 1;
        }
        while last + 1 < points.len() && joined[last] && is_within(last) {
            last += 1;
        }
        let around = &points[first..=last];
        let normal = straight(around, within).or_else(|| {
            let is_between = first < number && number < last;
            is_between.then(|| round(around, points[number], within)).flatten()
        })?;
        Some(if normal.dot(&(points[number] - laser)) > 0.0 {
            -normal
        } else {
            normal
        })
    };
    (0..points.len()).map(of).collect()
}

/// Standard deviation of the points across their surfaces, m.
fn noise(points: &[Point2<f64>]) -> f64 {
    let off = points.windows(3).filter_map(|three| {
        let chord = three[2] - three[0];
        let length = chord.norm();
        let is_short = length > f64::EPSILON && length < CHORD;
        is_short.then(|| (three[1] - three[0]).perp(&chord).abs() / length)
    });
    let mut off: Vec<f64> = off.collect();
    let middle = off.len() / 2;
    if off.is_empty() {
        return 0.0;
    }
    let (_, median, _) = off.select_nth_unstable_by(middle, f64::total_cmp);
    *median / MEDIAN
}

/// The normal of the line on which three points and more lie to within a standard deviation, m, if they do.
fn straight(points: &[Point2<f64>], within: f64) -> Option<Vector2<f64>> {
    if points.len() < 3 {
        return None;
    }
    let count = points.len() as f64;
    let middle = points.iter().map(|point| point.coords).sum::<Vector2<f64>>() / count;
    let squares = |away: Vector2<f64>| Vector3::new(away.x * away.x, away.x * away.y, away.y * away.y);
    let spread = points.iter().map(|point| squares(point.coords - middle));
    let spread = spread.sum::<Vector3<f64>>() / count;
    // Half the sum of the eigenvalues, half their difference, and the angle of the larger one's axis.
    let (half, difference) = (0.5 * (spread.x + spread.z), 0.5 * (spread.x - spread.z));
    let root = (difference * difference + spread.y * spread.y).sqrt();
    let (small, large) = (half - root, half + root);
    (small <= within * within && small <= FLAT * large).then(|| {
        let (sin, cos) = (0.5 * spread.y.atan2(difference)).sin_cos();
        Vector2::new(-sin, cos)
    })
}

/// The normal at one of the points of the parabola over their chord on which they lie to within a standard deviation, m, if they do.
fn round(points: &[Point2<f64>], at: Point2<f64>, within: f64) -> Option<Vector2<f64>> {
    let [first, .., last] = points else { return None };
    let along = (last - first).try_normalize(f64::EPSILON)?;
    let across = Vector2::new(-along.y, along.x);
    let (mut squares, mut sums, mut total) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for away in points.iter().map(|point| point - at) {
        let (way, height) = (away.dot(&along), away.dot(&across));
        let powers = Vector3::new(1.0, way, way * way);
        squares += powers * powers.transpose();
        sums += powers * height;
        total += height * height;
    }
    let fitted = squares.cholesky()?.solve(&sums);
    let left = (total - fitted.dot(&sums)).max(0.0) / points.len().checked_sub(3)? as f64;
    let is_round = points.len() >= ROUND && left <= within * within && 2.0 * fitted.z.abs() <= CURVATURE;
    is_round.then(|| (across - along * fitted.y).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points seen from the origin at these ranges, a degree apart about straight ahead, each off by up to 4 mm.
    fn seen(range: impl Fn(f64) -> f64) -> Vec<Point2<f64>> {
        let of = |beam: i32| {
            let angle = f64::from(beam).to_radians();
            let length = range(angle) + 0.004 * (f64::from(beam) * 2.4).sin();
            Point2::new(length * angle.cos(), length * angle.sin())
        };
        (-20..=20).map(of).collect()
    }

    #[test]
    fn a_wall_looks_at_the_base_all_along() {
        let normals = normals(Point2::origin(), &seen(|angle| 2.0 / angle.cos()));
        for normal in normals {
            assert!(normal.is_some_and(|normal| normal.x < -0.99), "{normal:?}");
        }
    }

    #[test]
    fn a_pillar_looks_away_from_its_middle() {
        // Of 0.3 m radius, 2 m away.
        let range = |angle: f64| 2.0 * angle.cos() - (0.09 - (2.0 * angle.sin()).powi(2)).max(0.0).sqrt();
        let points: Vec<_> = seen(range).into_iter().filter(|point| point.y.abs() < 0.25).collect();
        let normals = normals(Point2::origin(), &points);
        let known: Vec<_> = points
            .iter()
            .zip(&normals)
            .filter_map(|(at, normal)| Some((at, (*normal)?)))
            .collect();
        assert!(known.len() > points.len() / 2, "{} of {}", known.len(), points.len());
        for (at, normal) in known {
            let away = (at - Point2::new(2.0, 0.0)).normalize();
            assert!(away.dot(&normal) > 0.97, "{at}: {normal}, {away}");
        }
    }

    #[test]
    fn about_a_corner_nobody_knows() {
        // Two walls that meet straight ahead, each at 45 degrees.
        let points = seen(|angle| 2.0 / (angle.cos() + angle.sin().abs()));
        let normals = normals(Point2::origin(), &points);
        let is_known = |at: f64| {
            normals
                .iter()
                .zip(&points)
                .any(|(normal, point)| point.y.abs() < at && normal.is_some())
        };
        assert!(!is_known(0.06) && is_known(0.4));
    }
}
