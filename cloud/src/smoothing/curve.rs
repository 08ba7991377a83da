//! Which curve through a corridor bends least? Bezier pieces of degree five whose control points lie in their rooms.
//!
//! With `p`, `v`, `a` (place, first and second derivative by a parameter that runs as fast as the way's length) at every joint, a piece of
//! length `T` has the control points `p`, `p + vT/5`, `p + 2vT/5 + aT²/20` and the same from its end: joints are C² by construction. The
//! curve minimises `∫ |p'|² + l² |p''|² + l⁴ |p'''|²` (length, curvature, change of curvature; `l` is the length over which the robot
//! likes to turn) under `normal · control <= offset` for every side of the piece's room. A Bezier curve lies in the convex hull of its
//! control points, so it does not leave the room. The quadratic program is solved by the interior point method of Clarabel.
//!
//! Sources: Gao, Wu, Lin and Shen, "Online Safe Trajectory Generation for Quadrotors Using Fast Marching Method and Bernstein Basis
//! Polynomial", ICRA 2018; Goulart and Chen, "Clarabel: An interior-point solver for conic programs with quadratic objectives", 2024.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT};
use nalgebra::{Matrix6, Point2, Vector2};

use super::corridor::Room;
use super::timing::{GeometricPath, PathPoint};

/// Heading and curvature that an end of the curve must have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EndTangent {
    /// Length one.
    pub direction: Vector2<f64>,
    /// Curvature, 1/m; free without.
    pub curvature: Option<f64>,
}

/// What a curve is asked to be.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ends {
    /// At the start; free without.
    pub start: Option<EndTangent>,
    /// At the end; free without.
    pub end: Option<EndTangent>,
}

/// A curve, and how the solver ended.
#[derive(Clone, Debug)]
pub struct Curve {
    pieces: Vec<[Point2<f64>; 6]>,
    /// The solver's status.
    pub solver: String,
    /// Iterations it took.
    pub iterations: u32,
    /// Its relative duality gap.
    pub gap: f64,
}

/// Why there is no curve.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CurveError {
    /// The solver found none.
    #[error("{0}")]
    Solver(String),
    /// The curve stops and turns back somewhere: no heading there.
    #[error("cusp")]
    Cusp,
}

/// Variables a joint: `px py vx vy ax ay`.
const JOINT: usize = 6;

/// The best curve through rooms, from the first room's `from` to the last one's `to`. `turning_length` in m, `max_iterations` of the solver.
///
/// # Errors
/// [`CurveError::Solver`]: the rooms do not admit the ends' tangents, or the solver failed.
pub fn fit(rooms: &[Room], ends: &Ends, turning_length: f64, max_iterations: u32) -> Result<Curve, CurveError> {
    let (Some(first), Some(last)) = (rooms.first(), rooms.last()) else {
        return Err(CurveError::Solver("no rooms".to_owned()));
    };
    let origin = first.from;
    let variables = JOINT * (rooms.len() + 1);
    let mut rows = Rows::default();
    let end = JOINT * rooms.len();
    rows.equal(&[(0, 1.0)], 0.0);
    rows.equal(&[(1, 1.0)], 0.0);
    rows.equal(&[(end, 1.0)], last.to.x - origin.x);
    rows.equal(&[(end + 1, 1.0)], last.to.y - origin.y);
    for (joint, tangent) in [(0, ends.start), (end, ends.end)] {
        let Some(tangent) = tangent else { continue };
        let EndTangent { direction, curvature } = tangent;
        rows.equal(&[(joint + 2, 1.0)], direction.x);
        rows.equal(&[(joint + 3, 1.0)], direction.y);
        if let Some(k) = curvature {
            // At a speed of one along the parameter, curvature is the second derivative across.
            rows.equal(&[(joint + 4, -direction.y), (joint + 5, direction.x)], k);
        }
    }
    let equalities = rows.bounds.len();
    for (i, room) in rooms.iter().enumerate() {
        for side in &room.sides {
            let offset = side.offset - side.normal.dot(&origin.coords);
            // The curve's own ends are given: they lie where they lie.
            let from = usize::from(i == 0);
            let to = if i + 1 == rooms.len() { 5 } else { 6 };
            for control in &controls(room.length)[from..to] {
                let mut row = [(0, 0.0); 6];
                for (slot, (joint, order, factor)) in control.iter().enumerate() {
                    let variable = JOINT * (i + joint) + 2 * order;
                    row[2 * slot] = (variable, factor * side.normal.x);
                    row[2 * slot + 1] = (variable + 1, factor * side.normal.y);
                }
                rows.at_most(&row, offset);
            }
        }
    }
    let inequalities = rows.bounds.len() - equalities;
    let cones = [ZeroConeT(equalities), NonnegativeConeT(inequalities)];
    let settings = DefaultSettingsBuilder::default()
        .verbose(false)
        .max_iter(max_iterations)
        .presolve_enable(false)
        .build();
    let settings = settings.map_err(|error| CurveError::Solver(error.to_string()))?;
    let (a, b) = rows.into_matrix(variables);
    let cost = cost(rooms, turning_length);
    let mut solver = DefaultSolver::new(&cost, &vec![0.0; variables], &a, &b, &cones, settings)
        .map_err(|error| CurveError::Solver(error.to_string()))?;
    solver.solve();
    let status = solver.solution.status;
    if !matches!(status, SolverStatus::Solved | SolverStatus::AlmostSolved) {
        return Err(CurveError::Solver(format!("{status:?}")));
    }
    let x = &solver.solution.x;
    let vector = |variable: usize| Vector2::new(x[variable], x[variable + 1]);
    let piece = |(i, room): (usize, &Room)| {
        controls(room.length).map(|control| {
            control.iter().fold(origin, |sum, (joint, order, factor)| {
                sum + vector(JOINT * (i + joint) + 2 * order) * *factor
            })
        })
    };
    let mut pieces: Vec<[Point2<f64>; 6]> = rooms.iter().enumerate().map(piece).collect();
    // What was asked for to the last digit, not to the solver's tolerance.
    let count = pieces.len();
    pieces[0][0] = origin;
    pieces[count - 1][5] = last.to;
    Ok(Curve {
        pieces,
        solver: format!("{status:?}"),
        iterations: solver.solution.iterations,
        gap: solver.info.gap_rel,
    })
}

/// Control points of a piece as sums of (joint 0 or 1, order of the derivative, factor).
fn controls(length: f64) -> [[(usize, usize, f64); 3]; 6] {
    let (v, a) = (length / 5.0, length * length / 20.0);
    let none = |joint| (joint, 1, 0.0);
    [
        [(0, 0, 1.0), none(0), (0, 2, 0.0)],
        [(0, 0, 1.0), (0, 1, v), (0, 2, 0.0)],
        [(0, 0, 1.0), (0, 1, 2.0 * v), (0, 2, a)],
        [(1, 0, 1.0), (1, 1, -2.0 * v), (1, 2, a)],
        [(1, 0, 1.0), (1, 1, -v), (1, 2, 0.0)],
        [(1, 0, 1.0), none(1), (1, 2, 0.0)],
    ]
}

/// The cost's matrix (upper triangle).
fn cost(rooms: &[Room], turning_length: f64) -> CscMatrix<f64> {
    let weights = [1.0, turning_length.powi(2), turning_length.powi(4)];
    let blocks: Vec<Matrix6<f64>> = rooms.iter().map(|room| piece_cost(room.length, weights)).collect();
    let variables = JOINT * (rooms.len() + 1);
    let (mut starts, mut indices, mut values) = (vec![0], Vec::new(), Vec::new());
    for variable in 0..variables {
        let (joint, order, axis) = (variable / JOINT, variable % JOINT / 2, variable % 2);
        let before = joint.checked_sub(1).map(|i| &blocks[i]);
        let after = blocks.get(joint);
        if let Some(block) = before {
            for other in 0..3 {
                indices.push(JOINT * (joint - 1) + 2 * other + axis);
                values.push(2.0 * block[(other, 3 + order)]);
            }
        }
        for other in 0..=order {
            indices.push(JOINT * joint + 2 * other + axis);
            let sum = before.map_or(0.0, |block| block[(3 + other, 3 + order)])
                + after.map_or(0.0, |block| block[(other, order)]);
            values.push(2.0 * sum);
        }
        starts.push(indices.len());
    }
    CscMatrix::new(variables, variables, starts, indices, values)
}

/// Cost of one piece over `(p, v, a)` of its start and end, one axis.
fn piece_cost(length: f64, weights: [f64; 3]) -> Matrix6<f64> {
    let mut from_joints = Matrix6::zeros();
    for (i, control) in controls(length).iter().enumerate() {
        for (joint, order, factor) in control {
            from_joints[(i, 3 * joint + order)] += factor;
        }
    }
    // Differences of neighbouring control points are the control points of the derivative, but for a factor.
    let mut derivative = from_joints;
    let mut factor = 1.0;
    let mut sum = Matrix6::zeros();
    for (order, weight) in weights.into_iter().enumerate() {
        let degree = 4 - order;
        for i in 0..=degree {
            let difference = derivative.row(i + 1) - derivative.row(i);
            derivative.set_row(i, &difference);
        }
        factor *= (degree + 1) as f64 / length;
        for i in 0..=degree {
            for j in 0..=degree {
                let product =
                    binomial(degree, i) * binomial(degree, j) / binomial(2 * degree, i + j) / (2 * degree + 1) as f64;
                sum +=
                    derivative.row(i).transpose() * derivative.row(j) * (weight * factor * factor * length * product);
            }
        }
    }
    sum
}

fn binomial(n: usize, k: usize) -> f64 {
    (0..k).map(|i| (n - i) as f64 / (i + 1) as f64).product()
}

/// Rows of the constraints, in the order in which they come.
#[derive(Default)]
struct Rows {
    entries: Vec<(usize, usize, f64)>,
    bounds: Vec<f64>,
}

impl Rows {
    fn equal(&mut self, row: &[(usize, f64)], value: f64) {
        let index = self.bounds.len();
        self.entries.extend(
            row.iter()
                .filter(|(_, factor)| *factor != 0.0)
                .map(|(variable, factor)| (*variable, index, *factor)),
        );
        self.bounds.push(value);
    }

    fn at_most(&mut self, row: &[(usize, f64)], bound: f64) {
        self.equal(row, bound);
    }

    fn into_matrix(mut self, variables: usize) -> (CscMatrix<f64>, Vec<f64>) {
        self.entries
            .sort_unstable_by_key(|(variable, row, _)| (*variable, *row));
        let mut starts = vec![0; variables + 1];
        for (variable, _, _) in &self.entries {
            starts[variable + 1] += 1;
        }
        for i in 0..variables {
            starts[i + 1] += starts[i];
        }
        let (rows, values) = self.entries.iter().map(|(_, row, value)| (*row, *value)).unzip();
        (
            CscMatrix::new(self.bounds.len(), variables, starts, rows, values),
            self.bounds,
        )
    }
}

/// Largest turn from one sample to the next, rad.
const FINE_TURN: f64 = 0.04;
/// A turn from one sample to the next that halving does not make finer is a cusp, rad.
const CUSP: f64 = 0.5;
/// Curvature of a turn on the spot in all but name, 1/m.
const SHARPEST: f64 = 500.0;

impl Curve {
    /// Control points of the pieces.
    #[must_use]
    pub fn pieces(&self) -> &[[Point2<f64>; 6]] {
        &self.pieces
    }

    /// Samples at most about `step` metres apart, closer where the curve turns.
    ///
    /// # Errors
    /// [`CurveError::Cusp`] where the curve has no heading.
    pub fn sampled(&self, step: f64) -> Result<GeometricPath, CurveError> {
        let mut points: Vec<PathPoint> = Vec::new();
        for (i, piece) in self.pieces.iter().enumerate() {
            let polygon: f64 = piece.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            let mut samples = (polygon / step).ceil().clamp(2.0, 4096.0) as usize;
            let before = points.len();
            loop {
                points.truncate(before);
                let finest = samples >= 1024;
                match append(piece, samples, i == 0, &mut points) {
                    Some(turn) if turn <= FINE_TURN || (finest && turn <= CUSP) => break,
                    _ if finest => return Err(CurveError::Cusp),
                    _ => samples *= 2,
                }
            }
        }
        GeometricPath::new(points).ok_or(CurveError::Cusp)
    }
}

/// Appends samples of a piece; the largest turn between two of them. `None` where there is no heading.
fn append(piece: &[Point2<f64>; 6], samples: usize, with_first: bool, points: &mut Vec<PathPoint>) -> Option<f64> {
    let mut largest = 0.0_f64;
    let speed = |u: f64| derivatives(piece, u).1.norm();
    let step = 1.0 / samples as f64;
    for i in usize::from(!with_first)..=samples {
        let u = i as f64 * step;
        let (place, first, second) = derivatives(piece, u);
        let rate = first.norm();
        let k = (first.x * second.y - first.y * second.x) / (rate * rate * rate);
        // Without speed the curvature is not a number: that is a cusp as well.
        if rate <= 1e-6 || k.is_nan() || k.abs() >= SHARPEST {
            return None;
        }
        let mut point = PathPoint {
            s: 0.0,
            x: place.x,
            y: place.y,
            yaw: first.y.atan2(first.x),
            k,
        };
        if let Some(last) = points.last() {
            let turn = zenav_protocol::geometry::wrap_angle(point.yaw - last.yaw);
            largest = largest.max(turn.abs());
            point.yaw = last.yaw + turn;
            // Gauss and Legendre, three points.
            let (middle, reach) = (u - 0.5 * step, 0.5 * step * 0.6_f64.sqrt());
            point.s = last.s
                + step / 18.0 * (5.0 * speed(middle - reach) + 8.0 * speed(middle) + 5.0 * speed(middle + reach));
        }
        points.push(point);
    }
    Some(largest)
}

/// Place, first and second derivative of a piece at `u` in 0 to 1, by de Casteljau's scheme.
fn derivatives(piece: &[Point2<f64>; 6], u: f64) -> (Point2<f64>, Vector2<f64>, Vector2<f64>) {
    let mut row = *piece;
    for level in (3..6).rev() {
        for i in 0..level {
            row[i] += (row[i + 1] - row[i]) * u;
        }
    }
    let [a, b, c, ..] = row;
    let second = ((c - b) - (b - a)) * 20.0;
    let (ab, bc) = (a + (b - a) * u, b + (c - b) * u);
    (ab + (bc - ab) * u, (bc - ab) * 5.0, second)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::super::corridor::HalfPlane;
    use super::*;

    fn boxed(from: (f64, f64), to: (f64, f64), low: (f64, f64), high: (f64, f64)) -> Room {
        let side = |x: f64, y: f64, offset: f64| HalfPlane {
            normal: Vector2::new(x, y),
            offset,
        };
        let (from, to) = (Point2::new(from.0, from.1), Point2::new(to.0, to.1));
        Room {
            sides: vec![
                side(1.0, 0.0, high.0),
                side(0.0, 1.0, high.1),
                side(-1.0, 0.0, -low.0),
                side(0.0, -1.0, -low.1),
            ],
            from,
            to,
            length: (to - from).norm(),
        }
    }

    /// A corner to the left: east along a hall, then north along another.
    fn corner() -> Vec<Room> {
        vec![
            boxed((0.0, 0.0), (3.0, 0.0), (-0.5, -0.4), (3.4, 0.4)),
            boxed((3.0, 0.0), (3.0, 3.0), (2.6, -0.4), (3.4, 3.5)),
        ]
    }

    #[test]
    fn a_straight_hall_gives_a_straight_line() {
        let curve = fit(
            &[boxed((0.0, 0.0), (3.0, 0.0), (-1.0, -1.0), (4.0, 1.0))],
            &Ends::default(),
            0.5,
            50,
        )
        .unwrap();
        let path = curve.sampled(0.02).unwrap();
        assert!((path.length() - 3.0).abs() < 1e-6);
        assert!(path.points().iter().all(|p| p.y.abs() < 1e-6 && p.k.abs() < 1e-4));
    }

    #[test]
    fn around_a_corner_the_curve_stays_in_its_rooms_and_its_curvature_is_continuous() {
        let rooms = corner();
        let path = fit(&rooms, &Ends::default(), 0.5, 50).unwrap().sampled(0.01).unwrap();
        for p in path.points() {
            assert!(rooms.iter().any(|room| room.holds(Point2::new(p.x, p.y), 1e-7)));
        }
        assert!(path.points().windows(2).all(|pair| (pair[1].k - pair[0].k).abs() < 0.3));
        assert!(path.length() < 6.0, "corners are cut");
        for pair in path.points().windows(2) {
            let chord = (pair[1].x - pair[0].x).hypot(pair[1].y - pair[0].y);
            assert!((pair[1].s - pair[0].s - chord).abs() < 1e-4 * chord);
        }
    }

    #[test]
    fn ends_have_the_heading_and_curvature_asked_for() {
        let (sin, cos) = 0.2_f64.sin_cos();
        let start = EndTangent {
            direction: Vector2::new(cos, sin),
            curvature: Some(-0.4),
        };
        let end = EndTangent {
            direction: Vector2::new(-sin, cos),
            curvature: None,
        };
        let path = fit(
            &corner(),
            &Ends {
                start: Some(start),
                end: Some(end),
            },
            0.5,
            50,
        )
        .unwrap()
        .sampled(0.01)
        .unwrap();
        let (first, last) = (path.points()[0], path.points()[path.points().len() - 1]);
        assert!((first.yaw - 0.2).abs() < 1e-6 && (first.k + 0.4).abs() < 1e-4);
        assert!((last.yaw - 0.2 - std::f64::consts::FRAC_PI_2).abs() < 1e-6);
        assert_eq!((last.x, last.y), (3.0, 3.0));
    }

    #[test]
    fn a_room_that_does_not_admit_the_tangent_is_an_error() {
        let backwards = EndTangent {
            direction: Vector2::new(-1.0, 0.0),
            curvature: Some(0.0),
        };
        let tight = [boxed((0.0, 0.0), (3.0, 0.0), (-0.1, -0.1), (3.1, 0.1))];
        assert!(matches!(
            fit(
                &tight,
                &Ends {
                    start: Some(backwards),
                    end: None
                },
                0.5,
                50
            ),
            Err(CurveError::Solver(_))
        ));
        assert!(matches!(
            fit(&[], &Ends::default(), 0.5, 50),
            Err(CurveError::Solver(_))
        ));
    }
}
