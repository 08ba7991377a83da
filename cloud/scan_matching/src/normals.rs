//! Normals. Normal of the surface at each point, estimated from its neighbours in the scan.
//!
//! A straight surface is fitted by a line through the neighbours, a round one by a parabola, both to within the noise of the scan itself.
//! Where neither fits, as around a corner, the neighbours on one side may suffice: a door jamb is shorter than the stretch used otherwise,
//! and constrains the position along a corridor more than all its walls. Elsewhere the normal is unknown. In a
//! scan that lost most of its beams neighbours are farther apart.

use nalgebra::{Matrix3, Point2, Vector2, Vector3};

/// Neighbours on one surface are at most this far apart, m and rad as seen from the base, or this close to each other, m. Neighbours joined
/// by distance alone never form a round surface: points around the corners of a door next to the robot would seem to lie on one.
const FARTHEST: f64 = 1.0;
const NEIGHBOURS: f64 = 0.03;
const NEAR: f64 = 0.1;
/// A scan is sparse if at least this share of its points is farther than `NEAR` from the next, and more than `NEIGHBOURS` in the median. There
/// neighbours are at most this many times that median apart, and no more than the last number, rad.
const SPARSE: f64 = 0.33;
const GAPS: f64 = 1.35;
const WIDEST: f64 = 0.12;
/// The direction of a surface is taken from neighbours up to this distance to each side, and the first beyond, m.
const STRETCH: f64 = 0.2;
/// They lie on it to within this many standard deviations of the noise, which is clamped to these bounds, m.
const DEVIATIONS: f64 = 1.8;
const NOISE: [f64; 2] = [0.0035, 0.017];
/// On a straight surface the variance across it is at most this share of that along it.
const FLAT: f64 = 0.05;
/// On one side of a point a surface is at least this long, m, and its variance across it is at most this share of the limit for both sides.
const SHORTEST: f64 = 0.05;
const SURER: f64 = 0.5;
/// A round surface has at least this many points, and its curvature is at most this, 1/m.
const ROUND: usize = 5;
const CURVATURE: f64 = 6.0;
/// Three points in a row are used to measure noise if the outer ones are closer than this, m.
const CHORD: f64 = 0.4;
/// Median distance of the middle of three points from the chord of the others, in standard deviations of a point.
const MEDIAN: f64 = 0.6745 * 1.2247;

/// The unit normals of the surfaces at points, towards the `laser` that saw them.
pub(crate) fn normals(laser: Point2<f64>, points: &[Point2<f64>]) -> Vec<Option<Vector2<f64>>> {
    let widest = sparse_gap(points)
        .map_or(NEIGHBOURS, |gap| (GAPS * gap).min(WIDEST))
        .tan();
    let joins = |pair: &[Point2<f64>]| {
        let [a, b] = [pair[0].coords, pair[1].coords];
        let apart = (b - a).norm_squared();
        let by_angle = apart <= FARTHEST * FARTHEST && a.perp(&b).abs() <= widest * a.dot(&b);
        (by_angle || apart <= NEAR * NEAR).then_some(by_angle)
    };
    // Whether a point and the next one lie on one surface, and whether by the angle between them.
    let joined: Vec<Option<bool>> = points.windows(2).map(joins).collect();
    let variance = (DEVIATIONS * noise(points).clamp(NOISE[0], NOISE[1])).powi(2);
    let of = |number: usize| {
        let is_within = |other: usize| (points[number] - points[other]).norm_squared() < STRETCH * STRETCH;
        let (mut first, mut last) = (number, number);
        while first > 0 && joined[first - 1].is_some() && is_within(first) {
            first -= 1;
        }
        while last + 1 < points.len() && joined[last].is_some() && is_within(last) {
            last += 1;
        }
        let around = &points[first..=last];
        let normal = match Line::through(around).filter(|line| line.holds(variance)) {
            Some(line) => line.normal,
            None => {
                let by_angle = joined[first..last].iter().all(|by_angle| *by_angle == Some(true));
                match by_angle.then(|| round(around, points[number], variance)).flatten() {
                    // At the end of a round surface the normal is unknown.
                    Some(normal) => (first < number && number < last).then_some(normal)?,
                    None => beside(&points[first..=number], &points[number..=last], variance)?,
                }
            }
        };
        Some(if normal.dot(&(points[number] - laser)) > 0.0 {
            -normal
        } else {
            normal
        })
    };
    (0..points.len()).map(of).collect()
}

/// The normal from the neighbours on one side of a point, if they lie on a straight surface with it; of both sides, the longer one.
fn beside(before: &[Point2<f64>], after: &[Point2<f64>], variance: f64) -> Option<Vector2<f64>> {
    let holds = |line: &Line| line.holds(SURER * variance) && 12.0 * line.along >= SHORTEST * SHORTEST;
    // The longest stretch from the point on for which all shorter ones hold, too.
    let longest = |stretches: &mut dyn Iterator<Item = &[Point2<f64>]>| {
        let lines = stretches.filter_map(Line::through);
        lines
            .skip_while(|line| !holds(line))
            .take_while(|line| holds(line))
            .last()
    };
    let back = longest(&mut (3..=before.len()).map(|count| &before[before.len() - count..]));
    let on = longest(&mut (3..=after.len()).map(|count| &after[..count]));
    let sides = [back, on].into_iter().flatten();
    sides.max_by(|a, b| a.along.total_cmp(&b.along)).map(|line| line.normal)
}

/// Standard deviation of the points across their surfaces, m.
fn noise(points: &[Point2<f64>]) -> f64 {
    let off = points.windows(3).filter_map(|three| {
        let chord = three[2] - three[0];
        let length = chord.norm();
        let is_short = length > f64::EPSILON && length < CHORD;
        is_short.then(|| (three[1] - three[0]).perp(&chord).abs() / length)
    });
    median(off.collect()).map_or(0.0, |off| off / MEDIAN)
}

/// The median angle between neighbours, rad, if the scan is sparse; neighbours on one surface alone count.
fn sparse_gap(points: &[Point2<f64>]) -> Option<f64> {
    let pairs = points.windows(2).map(|pair| (pair[0].coords, pair[1].coords));
    let is_far = |(a, b): &(Vector2<f64>, Vector2<f64>)| (NEAR..=FARTHEST).contains(&(b - a).norm());
    let far: Vec<f64> = pairs.filter(is_far).map(|(a, b)| a.angle(&b)).collect();
    let is_sparse = far.len() as f64 >= SPARSE * points.len() as f64;
    median(far).filter(|gap| is_sparse && *gap > NEIGHBOURS)
}

/// The upper median.
fn median(mut numbers: Vec<f64>) -> Option<f64> {
    let middle = numbers.len() / 2;
    (middle < numbers.len()).then(|| *numbers.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// A line through points: its normal, and the variance of the points across and along it, m².
struct Line {
    normal: Vector2<f64>,
    across: f64,
    along: f64,
}

impl Line {
    /// The best line through at least three points.
    fn through(points: &[Point2<f64>]) -> Option<Self> {
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
        let (sin, cos) = (0.5 * spread.y.atan2(difference)).sin_cos();
        Some(Self {
            normal: Vector2::new(-sin, cos),
            across: half - root,
            along: half + root,
        })
    }

    /// Whether the points lie on it, with at most this variance across it, m².
    fn holds(&self, variance: f64) -> bool {
        self.across <= variance && self.across <= FLAT * self.along
    }
}

/// The normal at one of the points, from a parabola over their chord, if they lie on it with at most this variance, m².
fn round(points: &[Point2<f64>], at: Point2<f64>, variance: f64) -> Option<Vector2<f64>> {
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
    let is_round = points.len() >= ROUND && left <= variance && 2.0 * fitted.z.abs() <= CURVATURE;
    is_round.then(|| (across - along * fitted.y).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points seen from the origin at these ranges, a degree apart, centred straight ahead, each off by up to 4 mm.
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
        // A radius of 0.3 m, 2 m away.
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
    fn up_to_a_corner_each_wall_looks_its_own_way() {
        // Two walls that meet straight ahead, each at 45 degrees.
        let points = seen(|angle| 2.0 / (angle.cos() + angle.sin().abs()));
        let normals = normals(Point2::origin(), &points);
        let known: Vec<_> = points
            .iter()
            .zip(&normals)
            .filter_map(|(at, normal)| Some((at, (*normal)?)))
            .collect();
        assert!(known.len() + 3 >= points.len(), "{} of {}", known.len(), points.len());
        for (at, normal) in known.iter().filter(|(at, _)| at.y.abs() > 0.03) {
            let wall = Vector2::new(-1.0, -at.y.signum()).normalize();
            assert!(wall.dot(normal) > 0.97, "{at}: {normal}");
        }
    }

    #[test]
    fn a_jamb_of_a_thin_wall_looks_along_the_corridor() {
        // A corridor's wall 1 m to the left that ends in a jamb of 0.1 m, 1 m ahead, and the room's far wall behind the door.
        let jamb = |along: f64| Point2::new(1.0, 1.0 + along);
        let wall = |along: f64| Point2::new(1.0 - along, 1.0);
        let mut points: Vec<Point2<f64>> = (0..5).map(|step| jamb(0.1 - 0.025 * f64::from(step))).collect();
        points.extend((1..12).map(|step| wall(0.04 * f64::from(step))));
        let laser = Point2::new(1.6, 0.0);
        let normals = normals(laser, &points);
        for (at, normal) in points.iter().zip(&normals).take(4) {
            assert!(normal.is_some_and(|normal| normal.x > 0.97), "{at}: {normal:?}");
        }
        for (at, normal) in points.iter().zip(&normals).skip(5) {
            assert!(normal.is_some_and(|normal| normal.y < -0.97), "{at}: {normal:?}");
        }
    }

    #[test]
    fn walls_are_walls_for_a_fifth_of_the_beams() {
        // Walls 1.5 m to the left and to the right, seen by beams a degree apart, each off by up to a centimetre; most are lost.
        let of = |beam: u32| {
            let angle = f64::from(beam + if beam > 90 { 134 } else { 45 }).to_radians();
            let noise = 2.0 * (f64::from(beam) * 0.618_034).fract() - 1.0;
            let length = 1.5 / angle.sin().abs() + 0.01 * noise;
            Point2::new(length * angle.cos(), length * angle.sin())
        };
        let kept = (0..182_u32).filter(|beam| beam.is_multiple_of(5) || beam.is_multiple_of(31));
        let points: Vec<Point2<f64>> = kept.map(of).collect();
        let normals = normals(Point2::origin(), &points);
        let known: Vec<f64> = normals.into_iter().flatten().map(|normal| normal.y.abs()).collect();
        assert!(
            10 * known.len() > 7 * points.len(),
            "{} of {}",
            known.len(),
            points.len()
        );
        assert!(known.iter().all(|across| *across > 0.985), "{known:?}");
    }
}
