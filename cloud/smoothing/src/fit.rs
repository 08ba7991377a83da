//! Curve fitting. The curve through a corridor that bends least: Bezier pieces of degree five whose control points lie in their polygons.
//!
//! With `p`, `v`, `a` (position, first and second derivative by a parameter that runs as fast as the path's length) at every joint, a
//! piece of length `T` has the control points `p`, `p + vT/5`, `p + 2vT/5 + aT²/20` and the same from its end: joints are C² by
//! construction. The curve minimises `∫ |p'|² + l² |p''|² + l⁴ |p'''|²` (length, curvature, change of curvature; `l` is the preferred
//! turning length) subject to `normal · control <= offset` for every side of the piece's polygon. A Bezier curve lies in the convex hull
//! of its control points, so it does not leave the polygon. The path itself is always such a curve.
//!
//! The quadratic programme is solved by Clarabel's interior-point method. Of some two thousand pairs of a side and a control point fewer
//! than a tenth matter in the end: at first only those near the path are imposed, then those that the curve violates.
//!
//! Sources: Gao, Wu, Lin and Shen, "Online Safe Trajectory Generation for Quadrotors Using Fast Marching Method and Bernstein Basis
//! Polynomial", ICRA 2018; Goulart and Chen, "Clarabel: An interior-point solver for conic programs with quadratic objectives", 2024;
//! Kelley, "The Cutting-Plane Method for Solving Convex Programs", 1960.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT,
};
use nalgebra::{Point2, Vector2};

use super::corridor::FreePolygon;
use super::cost::{JOINT, controls, cost};
use super::csc::by_columns;
use super::curve::{Curve, CurveError};

/// Heading and curvature that an end of the curve must have.
///
/// ```
/// use std::f64::consts::FRAC_PI_2;
/// use nalgebra::{Point2, Vector2};
/// use zenav_smoothing::{CorridorSettings, EndTangent, Ends, corridor, fit};
/// # use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::Footprint;
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 100 };
/// # let map = Grid::filled(spec, Occupancy::FREE);
/// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
/// // The path leads along x, and the robot looks along y.
/// let polygons = corridor(&space, &[Point2::new(1.5, 2.5), Point2::new(3.5, 2.5)], &CorridorSettings::default());
/// let start = Some(EndTangent { direction: Vector2::y(), curvature: None });
/// let curve = fit(&polygons, &Ends { start, end: None }, 0.25, 60)?;
/// let first = curve.sampled(0.02)?.geometry.points()[0];
/// assert!((first.yaw - FRAC_PI_2).abs() < 1e-3);
/// # Ok::<(), zenav_smoothing::CurveError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EndTangent {
    /// Unit vector.
    pub direction: Vector2<f64>,
    /// Curvature, 1/m; `None`: free.
    pub curvature: Option<f64>,
}

/// Tangents required at the ends of a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ends {
    /// At the start; `None`: free.
    pub start: Option<EndTangent>,
    /// At the end; `None`: free.
    pub end: Option<EndTangent>,
}

/// Sides this close to the path are imposed from the beginning, in turning lengths.
const NEAR: f64 = 2.0;
/// A control point may lie this far outside its polygon, m: a fifth of the margin that polygons keep.
const OUTSIDE: f64 = 1e-4;
/// Rounds with only some of the sides; after that all are imposed.
const ROUNDS: usize = 4;

/// The best curve through polygons, from the first polygon's `from` to the last one's `to`. `turning_length` in m, `max_iterations` of
/// the solver.
///
/// # Errors
/// [`CurveError::Solver`]: the polygons do not admit the ends' tangents, or the solver failed.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_smoothing::{CorridorSettings, Ends, corridor, fit};
/// # use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::Footprint;
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 100 };
/// # let map = Grid::filled(spec, Occupancy::FREE);
/// # let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
/// let path = [(1.0, 1.0), (3.0, 1.0), (3.0, 3.0)].map(|(x, y)| Point2::new(x, y));
/// let polygons = corridor(&space, &path, &CorridorSettings::default());
/// let curve = fit(&polygons, &Ends::default(), 0.25, 60)?;
/// assert!(curve.sampled(0.02)?.geometry.length() < 4.0, "the corner is cut");
/// // All control points of a piece lie in its polygon, so the curve does.
/// assert!(curve.pieces().iter().zip(&polygons).all(|(piece, polygon)| piece.iter().all(|point| polygon.holds(*point, 1e-3))));
/// # Ok::<(), zenav_smoothing::CurveError>(())
/// ```
pub fn fit(
    polygons: &[FreePolygon],
    ends: &Ends,
    turning_length: f64,
    max_iterations: u32,
) -> Result<Curve, CurveError> {
    let program = Program::new(polygons, ends, turning_length)?;
    let mut asked = program.near(NEAR * turning_length);
    let mut iterations = 0;
    for _ in 0..ROUNDS {
        let solved = program.solve(&asked, max_iterations, false, &mut iterations)?;
        if !solved.is_solved() {
            break;
        }
        if program.ask_for_crossed(&solved.x, &mut asked) <= OUTSIDE {
            return Ok(program.curve(solved, iterations));
        }
    }
    asked.fill(true);
    let solved = program.solve(&asked, max_iterations, true, &mut iterations)?;
    if !solved.is_solved() {
        return Err(CurveError::Solver(format!("{:?}", solved.status)));
    }
    if program.ask_for_crossed(&solved.x, &mut asked) > OUTSIDE {
        return Err(CurveError::Solver("Inaccurate".to_owned()));
    }
    Ok(program.curve(solved, iterations))
}

/// A sum of six variables with factors, and its bound.
struct Row {
    terms: [(usize, f64); 6],
    bound: f64,
}

impl Row {
    fn slack(&self, x: &[f64]) -> f64 {
        let sum: f64 = self.terms.iter().map(|(variable, factor)| factor * x[*variable]).sum();
        self.bound - sum
    }

    /// A row of one or two variables.
    fn short(terms: &[(usize, f64)], bound: f64) -> Self {
        let mut row = Self {
            terms: [(0, 0.0); 6],
            bound,
        };
        for (to, term) in row.terms.iter_mut().zip(terms) {
            *to = *term;
        }
        row
    }
}

/// The quadratic programme. Positions are relative to the first one.
struct Program<'a> {
    polygons: &'a [FreePolygon],
    origin: Point2<f64>,
    cost: CscMatrix<f64>,
    /// Equalities: both ends.
    given: Vec<Row>,
    /// Inequalities: every control point of a piece, except the ends, against every side of its polygon.
    walls: Vec<Row>,
}

struct Solved {
    /// Relative duality gap.
    gap: f64,
    status: SolverStatus,
    x: Vec<f64>,
}

impl Solved {
    fn is_solved(&self) -> bool {
        matches!(self.status, SolverStatus::Solved | SolverStatus::AlmostSolved)
    }
}

impl<'a> Program<'a> {
    fn new(polygons: &'a [FreePolygon], ends: &Ends, turning_length: f64) -> Result<Self, CurveError> {
        let (Some(first), Some(last)) = (polygons.first(), polygons.last()) else {
            return Err(CurveError::Solver("no polygons".to_owned()));
        };
        let origin = first.from;
        let end = JOINT * polygons.len();
        let mut given = Vec::new();
        for (joint, place, tangent) in [(0, first.from, ends.start), (end, last.to, ends.end)] {
            let place = place - origin;
            given.push(Row::short(&[(joint, 1.0)], place.x));
            given.push(Row::short(&[(joint + 1, 1.0)], place.y));
            let Some(EndTangent { direction, curvature }) = tangent else {
                continue;
            };
            given.push(Row::short(&[(joint + 2, 1.0)], direction.x));
            given.push(Row::short(&[(joint + 3, 1.0)], direction.y));
            if let Some(k) = curvature {
                // With unit speed along the parameter, curvature is the second derivative across.
                given.push(Row::short(&[(joint + 4, -direction.y), (joint + 5, direction.x)], k));
            }
        }
        let mut walls = Vec::new();
        for (i, polygon) in polygons.iter().enumerate() {
            for side in &polygon.sides {
                let bound = side.offset - side.normal.dot(&origin.coords);
                for control in &controls(polygon.length)[inner(i, polygons.len())] {
                    let mut terms = [(0, 0.0); 6];
                    for (slot, (joint, order, factor)) in control.iter().enumerate() {
                        let variable = JOINT * (i + joint) + 2 * order;
                        terms[2 * slot] = (variable, factor * side.normal.x);
                        terms[2 * slot + 1] = (variable + 1, factor * side.normal.y);
                    }
                    walls.push(Row { terms, bound });
                }
            }
        }
        Ok(Self {
            polygons,
            origin,
            cost: cost(polygons, turning_length),
            given,
            walls,
        })
    }

    /// Which walls are nearer than `near` (m) to the place of their control points on the path itself.
    fn near(&self, near: f64) -> Vec<bool> {
        let mut asked = Vec::with_capacity(self.walls.len());
        for (i, polygon) in self.polygons.iter().enumerate() {
            for side in &polygon.sides {
                let [from, to] = [polygon.from, polygon.to].map(|p| side.depth(p));
                let depth = |control: usize| from + (to - from) * control as f64 / 5.0;
                asked.extend(inner(i, self.polygons.len()).map(|control| depth(control) < near));
            }
        }
        asked
    }

    /// Imposes all walls that a solution violates; returns the largest violation, m.
    fn ask_for_crossed(&self, x: &[f64], asked: &mut [bool]) -> f64 {
        let mut most = 0.0_f64;
        for (wall, asked) in self.walls.iter().zip(asked) {
            let slack = wall.slack(x);
            *asked |= slack < 0.0;
            most = most.max(-slack);
        }
        most
    }

    fn solve(
        &self,
        asked: &[bool],
        max_iterations: u32,
        careful: bool,
        iterations: &mut u32,
    ) -> Result<Solved, CurveError> {
        let asked = self
            .walls
            .iter()
            .zip(asked)
            .filter_map(|(wall, asked)| asked.then_some(wall));
        let rows: Vec<&Row> = self.given.iter().chain(asked).collect();
        let cones = [
            ZeroConeT(self.given.len()),
            NonnegativeConeT(rows.len() - self.given.len()),
        ];
        let variables = self.cost.n;
        let (a, b) = matrix(&rows, variables);
        let settings = settings(max_iterations, careful)?;
        let mut solver = DefaultSolver::new(&self.cost, &vec![0.0; variables], &a, &b, &cones, settings)
            .map_err(|error| CurveError::Solver(error.to_string()))?;
        solver.solve();
        *iterations += solver.solution.iterations;
        Ok(Solved {
            status: solver.solution.status,
            gap: solver.info.gap_rel,
            x: std::mem::take(&mut solver.solution.x),
        })
    }

    fn curve(&self, mut solved: Solved, iterations: u32) -> Curve {
        // Equalities are made exact, beyond the solver's tolerance.
        for row in &self.given {
            let slack = row.slack(&solved.x);
            let squared: f64 = row.terms.iter().map(|(_, factor)| factor * factor).sum();
            for (variable, factor) in row.terms {
                solved.x[variable] += slack * factor / squared;
            }
        }

        let vector = |variable: usize| Vector2::new(solved.x[variable], solved.x[variable + 1]);
        let piece = |(i, polygon): (usize, &FreePolygon)| {
            controls(polygon.length).map(|control| {
                control.iter().fold(self.origin, |sum, (joint, order, factor)| {
                    sum + vector(JOINT * (i + joint) + 2 * order) * *factor
                })
            })
        };
        let mut pieces: Vec<[Point2<f64>; 6]> = self.polygons.iter().enumerate().map(piece).collect();
        let last = pieces.len() - 1;
        pieces[0][0] = self.origin;
        pieces[last][5] = self.polygons[last].to;
        Curve::new(pieces, format!("{:?}", solved.status), iterations, solved.gap)
    }
}

/// Control points of a piece without the curve's own ends, which are fixed.
fn inner(piece: usize, pieces: usize) -> std::ops::Range<usize> {
    usize::from(piece == 0)..if piece + 1 == pieces { 5 } else { 6 }
}

/// Tolerances of a hundredth of a millimetre; `careful` uses the solver's own.
fn settings(max_iterations: u32, careful: bool) -> Result<DefaultSettings<f64>, CurveError> {
    let mut builder = DefaultSettingsBuilder::default();
    builder.verbose(false).max_iter(max_iterations).presolve_enable(false);
    if !careful {
        let tolerance = 1e-5;
        builder
            .tol_feas(tolerance)
            .tol_gap_abs(tolerance)
            .tol_gap_rel(tolerance)
            .iterative_refinement_enable(false)
            .equilibrate_max_iter(1);
    }
    builder.build().map_err(|error| CurveError::Solver(error.to_string()))
}

/// The rows in the solver's format: by columns.
fn matrix(rows: &[&Row], variables: usize) -> (CscMatrix<f64>, Vec<f64>) {
    let terms = || {
        rows.iter().enumerate().flat_map(|(i, row)| {
            let terms = row.terms.iter().filter(|(_, factor)| *factor != 0.0);
            terms.map(move |(variable, factor)| (i, *variable, *factor))
        })
    };
    let bounds = rows.iter().map(|row| row.bound).collect();
    (by_columns(rows.len(), variables, terms), bounds)
}

#[cfg(test)]
mod tests {
    use super::super::corridor::HalfPlane;
    use super::*;

    fn boxed(from: (f64, f64), to: (f64, f64), low: (f64, f64), high: (f64, f64)) -> FreePolygon {
        let side = |x: f64, y: f64, offset: f64| HalfPlane {
            normal: Vector2::new(x, y),
            offset,
        };
        let (from, to) = (Point2::new(from.0, from.1), Point2::new(to.0, to.1));
        FreePolygon {
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
    fn corner() -> Vec<FreePolygon> {
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
        let geometry = curve.sampled(0.02).unwrap().geometry;
        assert!((geometry.length() - 3.0).abs() < 1e-6);
        assert!(geometry.points().iter().all(|p| p.y.abs() < 1e-6 && p.k.abs() < 1e-4));
    }

    #[test]
    fn around_a_corner_the_curve_stays_in_its_rooms_and_its_curvature_is_continuous() {
        let polygons = corner();
        let geometry = fit(&polygons, &Ends::default(), 0.5, 50)
            .unwrap()
            .sampled(0.01)
            .unwrap()
            .geometry;
        for p in geometry.points() {
            assert!(polygons.iter().any(|polygon| polygon.holds(p.position(), 2e-4)));
        }
        assert!(
            geometry
                .points()
                .windows(2)
                .all(|pair| (pair[1].k - pair[0].k).abs() < 0.3)
        );
        assert!(geometry.length() < 6.0, "corners are cut");
        for pair in geometry.points().windows(2) {
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
        let geometry = fit(
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
        .unwrap()
        .geometry;
        let (first, last) = (geometry.points()[0], geometry.points()[geometry.points().len() - 1]);
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
