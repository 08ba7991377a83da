//! Jerk limit. The fastest law with a limited jerk: a few quadratic programmes, each around the law of the one before.
//!
//! The squared speed `b(s)` is a quadratic spline on the path's samples; its coefficients are the unknowns. The acceleration `a = b'/2`
//! is continuous and linear between samples, and the jerk there is `a' √b`. On an interval the wheels' accelerations
//! `a (1 ± k h) ± h k' b` are quadratic: they are bounded where their three Bernstein coefficients are, which is linear in the unknowns. The bound of the
//! jerk `|a'| <= J / √b` is not, but `1 / √b` is convex and lies above its tangents: with the tangent at the last law's `b` each
//! programme's answer keeps the true limit, and the next one can only be faster. The first tangents are at the sweep's law, which no law
//! exceeds. The objective is the time, `∫ b^(-1/2) ds`, as a parabola around the last law. From rest and into rest the jerk is constant
//! on one interval: there `b = 3/2 a s`.
//!
//! Sources: Verscheure, Demeulenaere, Swevers, De Schutter and Diehl, "Time-Optimal Path Tracking for Robots: A Convex Optimization
//! Approach", TAC 2009 (squared speed as the unknown); Debrouwere et al., "Time-Optimal Path Following for Robots With Convex-Concave
//! Constraints Using Sequential Convex Programming", T-RO 2013 (the jerk's tangents).

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus};

use super::law::TimeLaw;
use super::limits::Limits;
use super::linear_rows::{Form, Rows, columns};
use super::path::GeometricPath;
use super::sweep::ceilings;

/// Largest number of programmes solved in sequence.
const PASSES: usize = 3;
/// A pass that shortens the law by a smaller share is the last one.
const GAIN: f64 = 5e-3;
/// Share of the limits that the programmes leave for the solver's own tolerance.
const MARGIN: f64 = 1e-5;

/// Squared speeds below this share of the highest get no more weight: near rest they would dominate the others.
const SLOW: f64 = 1e-3;

/// A law, with the solver's figures.
#[derive(Clone, Debug, PartialEq)]
pub struct JerkLimited {
    /// The time law within the jerk limit.
    pub law: TimeLaw,
    /// Number of programmes solved.
    pub passes: usize,
    /// The solver's last status.
    pub status: String,
    /// Iterations of all passes.
    pub iterations: u32,
    /// Relative duality gap of the last pass.
    pub gap: f64,
}

/// Why there is no law.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JerkError {
    /// The path has too few samples.
    #[error("too_short")]
    TooShort,
    /// The solver's status.
    #[error("{0}")]
    Solver(String),
}

/// The fastest law with at most `jerk` (m/s³) along a path, from the sweep's squared speeds (m²/s²) on it; ends at rest.
///
/// # Errors
/// [`JerkError`].
///
/// # Panics
/// With fewer speeds than the path has samples.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_smoothing::{GeometricPath, Limits, TimeLaw, fastest, jerk_limited};
///
/// # let limits = Limits { wheel_speed: 0.6, wheel_acceleration: 0.75, half_separation: 0.2, speed: 0.5, lateral_acceleration: 0.5,
/// #     yaw_rate: 2.5, jerk: None };
/// let path = GeometricPath::straight(Point2::origin(), Point2::new(2.0, 0.0), 0.02).unwrap();
/// let squared = fastest(&path, &limits, 0.0)?;
/// let limited = jerk_limited(&path, &limits, 1.0, &squared)?.law;
/// // 4 s at 0.5 m/s, and the root of 0.5 s² more for each change of speed with a jerk of 1 m/s³.
/// assert!((limited.duration() - (4.0 + 2.0 * 0.5_f64.sqrt())).abs() < 0.1);
/// assert!(limited.duration() > TimeLaw::steady(&path, &squared).duration());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn limited(path: &GeometricPath, limits: &Limits, jerk: f64, squared: &[f64]) -> Result<JerkLimited, JerkError> {
    let spline = Spline::new(path, squared[0], jerk).ok_or(JerkError::TooShort)?;
    let bounds = Bounds {
        ceilings: ceilings(path, limits, squared),
        sweep: squared,
        jerk: jerk * (1.0 - MARGIN),
    };
    let mut reference = spline.heights(squared);
    let mut best: Option<JerkLimited> = None;
    let (mut iterations, mut last) = (0, f64::INFINITY);
    for pass in 1..=PASSES {
        let rows = spline.rows(path, limits, &bounds, &reference);
        let answer = match (spline.solve(&rows, &reference), best.is_some()) {
            (Ok(answer), _) => answer,
            (Err(error), false) => return Err(error),
            (Err(_), true) => break,
        };
        iterations += answer.iterations;
        let (squared, accelerations) = spline.law(path, &answer.x);
        let law = TimeLaw::continuous(path, &squared, &accelerations);
        let duration = law.duration();
        if best.as_ref().is_none_or(|best| duration < best.law.duration()) {
            best = Some(JerkLimited {
                law,
                passes: pass,
                status: answer.status,
                iterations,
                gap: answer.gap,
            });
        }
        // Another reference only changes the tangents, which has no effect if none of them binds.
        let tangents = &rows[..4 * spline.lengths.len()];
        let binds = tangents.iter().any(|row| row.at(&answer.x) > 0.99);
        if !binds || duration > (1.0 - GAIN) * last {
            break;
        }
        last = duration;
        reference = spline.heights(&squared);
    }
    best.ok_or(JerkError::TooShort)
}

/// The squared speed as a quadratic spline, outside the intervals of constant jerk.
struct Spline {
    /// Sample at which the spline begins: 1 if the robot starts from rest, else 0.
    begin: usize,
    lengths: Vec<f64>,
    /// Squared speed and acceleration at the knots.
    squared: Vec<Form>,
    accelerations: Vec<Form>,
    /// Largest accelerations at the inner ends of the intervals of constant jerk.
    ends: [f64; 2],
}

impl Spline {
    fn new(path: &GeometricPath, start: f64, jerk: f64) -> Option<Self> {
        let lengths: Vec<f64> = path.points().windows(2).map(|pair| pair[1].s - pair[0].s).collect();
        let begin = usize::from(start == 0.0);
        let (last, inner) = lengths.split_last()?;
        let inner = inner.get(begin..)?;
        let (first_length, last_length) = (*inner.first()?, *inner.last()?);
        let end_knot = inner.len();
        let rest = |outer: f64, inner: f64| {
            let ratio = 1.5 * outer / inner;
            ratio / (1.0 + ratio)
        };
        let knot = |j: usize| {
            if j == 0 {
                let height = if begin == 1 {
                    Form::unknown(0).scaled(rest(lengths[0], first_length))
                } else {
                    Form::constant(start)
                };
                return (
                    height,
                    Form::unknown(0).plus(height.scaled(-1.0)).scaled(1.0 / first_length),
                );
            }
            if j == end_knot {
                let height = Form::unknown(j - 1).scaled(rest(*last, last_length));
                return (
                    height,
                    height.plus(Form::unknown(j - 1).scaled(-1.0)).scaled(1.0 / last_length),
                );
            }
            let both = inner[j - 1] + inner[j];
            let (before, after) = (Form::unknown(j - 1), Form::unknown(j));
            (
                before.scaled(inner[j] / both).plus(after.scaled(inner[j - 1] / both)),
                after.plus(before.scaled(-1.0)).scaled(1.0 / both),
            )
        };
        let (squared, accelerations) = (0..=end_knot).map(knot).unzip();
        let largest = |length: f64| (6.0 * length * jerk * jerk).cbrt();
        Some(Self {
            begin,
            ends: [largest(lengths[0]), largest(*last)],
            lengths: inner.to_vec(),
            squared,
            accelerations,
        })
    }

    /// The rows of one programme, each at most one: limits, and the jerk's tangents at a reference, a squared speed on each interval.
    fn rows(&self, path: &GeometricPath, limits: &Limits, bounds: &Bounds<'_>, reference: &[f64]) -> Vec<Form> {
        let mut rows = Rows {
            rows: Vec::with_capacity(9 * self.lengths.len()),
        };
        for (j, length) in self.lengths.iter().enumerate() {
            // |c| √b <= J with c = a' and b at most its larger end and |c| L² / 4: |c| (√r / J + L² / (8 r)) + b / (2 r) <= 3/2.
            let r = reference[j];
            let change = self.accelerations[j + 1].plus(self.accelerations[j].scaled(-1.0));
            let change = change.scaled(r.sqrt() / (bounds.jerk * length) + length / (8.0 * r));
            for b in [self.squared[j], self.squared[j + 1]] {
                let bend = b.scaled(0.5 / r);
                rows.at_most(change.plus(bend), 1.5);
                rows.at_most(change.scaled(-1.0).plus(bend), 1.5);
            }
        }
        // By the rows above |c| is at most this; and the base's acceleration changes by no more than its wheels allow.
        let largest_change = |j: usize| {
            let jerk = 1.5 * bounds.jerk / reference[j].sqrt();
            jerk.min(2.0 * limits.wheel_acceleration / self.lengths[j])
        };
        self.add_ceilings(bounds, &largest_change, &mut rows);
        self.add_wheels(path, limits, bounds, &largest_change, &mut rows);
        rows.rows
    }

    /// `b` lies below its coefficients, and at most `|c| L² / 4` above its larger end.
    fn add_ceilings(&self, bounds: &Bounds<'_>, largest_change: &dyn Fn(usize) -> f64, rows: &mut Rows) {
        let count = self.lengths.len();
        let ceiling = |j: usize| bounds.ceilings[self.begin + j] * (1.0 - MARGIN);
        let mut bulge_before = None;
        for j in 0..count {
            let (here, bulge) = (ceiling(j), 0.25 * largest_change(j) * self.lengths[j].powi(2));
            let even = (j == 0 || ceiling(j - 1) == here) && (j + 1 == count || ceiling(j + 1) == here);
            // Where the ceiling is constant, or a bulge would cost too much, the middle coefficient is kept below it.
            let by_coefficient = even || bulge > 1e-3 * here;
            if by_coefficient {
                rows.at_most(Form::unknown(j), here);
            }
            let bulge = if by_coefficient { 0.0 } else { bulge };
            if j > 0 && (ceiling(j - 1) != here || bulge > 0.0 || bulge_before > Some(0.0)) {
                let before = ceiling(j - 1) - bulge_before.unwrap_or(0.0);
                rows.at_most(self.squared[j], before.min(here - bulge));
            }
            bulge_before = Some(bulge);
        }
    }

    /// `a (1 ± k h) ± h k' b`: a quadratic, at most `|c| h |k'| L² / 2` beyond its larger end.
    fn add_wheels(
        &self,
        path: &GeometricPath,
        limits: &Limits,
        bounds: &Bounds<'_>,
        largest_change: &dyn Fn(usize) -> f64,
        rows: &mut Rows,
    ) {
        let points = path.points();
        let count = self.lengths.len();
        let most = limits.wheel_acceleration * (1.0 - MARGIN);
        for wheel in [limits.half_separation, -limits.half_separation] {
            let mut before: Option<(f64, f64)> = None;
            for j in 0..=count {
                let i = self.begin + j;
                let (a, b, factor) = (self.accelerations[j], self.squared[j], 1.0 + wheel * points[i].k);
                let mut here = None;
                if j < count && self.counts(path, limits, bounds, wheel, j) {
                    let slope = wheel * path.slope(i);
                    let bulge = 0.5 * largest_change(j) * slope.abs() * self.lengths[j].powi(2);
                    if bulge < 5e-3 * most {
                        here = Some((slope, bulge));
                    } else {
                        let (end, next) = (self.accelerations[j + 1], 1.0 + wheel * points[i + 1].k);
                        rows.within(a.scaled(factor).plus(b.scaled(slope)), most);
                        let middle = a.scaled(0.5 * next).plus(end.scaled(0.5 * factor));
                        rows.within(middle.plus(Form::unknown(j).scaled(slope)), most);
                        rows.within(end.scaled(next).plus(self.squared[j + 1].scaled(slope)), most);
                    }
                }
                // Both intervals beside a knot share a row: no squared speed is negative.
                let beside = [before, here];
                let slopes = beside.iter().flatten().map(|(slope, _)| *slope);
                let bulge = beside.iter().flatten().map(|(_, bulge)| *bulge).fold(0.0, f64::max);
                let (low, high) = slopes.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), slope| {
                    (low.min(slope), high.max(slope))
                });
                if low <= high {
                    rows.at_most(a.scaled(factor).plus(b.scaled(high)), most - bulge);
                    rows.at_most(a.scaled(-factor).plus(b.scaled(-low)), most - bulge);
                }
                before = here;
            }
        }
        // Where the jerk is constant the bound is linear up to a factor of at most one.
        let last = points.len() - 1;
        let rests = [
            (self.begin == 1).then_some((0, 0, 0, 1)),
            Some((count, last - 1, last, last - 1)),
        ];
        for (j, interval, at_rest, at_knot) in rests.into_iter().flatten() {
            let (a, b) = (self.accelerations[j], self.squared[j]);
            for wheel in [limits.half_separation, -limits.half_separation] {
                rows.within(a.scaled(1.0 + wheel * points[at_rest].k), most);
                let bend = b.scaled(wheel * path.slope(interval));
                rows.within(a.scaled(1.0 + wheel * points[at_knot].k).plus(bend), most);
            }
        }
        if self.begin == 1 {
            rows.at_most(self.accelerations[0], self.ends[0] * (1.0 - MARGIN));
        }
        rows.at_most(self.accelerations[count].scaled(-1.0), self.ends[1] * (1.0 - MARGIN));
    }

    /// Whether a wheel may be the first to reach its limit: on a straight line one wheel stands for both, and on an arc the inner wheel
    /// cannot be first where the curvature changes slowly, `|k'| b <= A |k|`.
    fn counts(&self, path: &GeometricPath, limits: &Limits, bounds: &Bounds<'_>, wheel: f64, j: usize) -> bool {
        let i = self.begin + j;
        let (k0, k1) = (path.points()[i].k, path.points()[i + 1].k);
        if k0 == 0.0 && k1 == 0.0 {
            return wheel > 0.0;
        }
        let highest = bounds.sweep[i].max(bounds.sweep[i + 1]);
        let (least, largest) = (k0.abs().min(k1.abs()), k0.abs().max(k1.abs()));
        let outer_alone = k0 * k1 > 0.0
            && path.slope(i).abs() * highest <= 0.9 * limits.wheel_acceleration * least
            && largest * limits.half_separation < 1.0;
        !outer_alone || wheel * k0 > 0.0
    }

    /// Highest squared speed on each interval.
    fn heights(&self, squared: &[f64]) -> Vec<f64> {
        squared[self.begin..]
            .windows(2)
            .map(|pair| pair[0].max(pair[1]).max(1e-6))
            .take(self.lengths.len())
            .collect()
    }

    /// Solves one programme: as fast as possible within the rows.
    fn solve(&self, rows: &[Form], reference: &[f64]) -> Result<Answer, JerkError> {
        let unknowns = self.lengths.len();
        // Time as a parabola around the reference: slope and curvature of `b^(-1/2)` there.
        let highest = reference.iter().copied().fold(0.0, f64::max);
        let time = |(length, b): (&f64, &f64)| {
            let (r, length) = (b.max(SLOW * highest) / highest, length / self.lengths[0]);
            (0.75 * length * r.powf(-2.5) / highest, -1.25 * length * r.powf(-1.5))
        };
        let cost: Vec<(f64, f64)> = self.lengths.iter().zip(reference).map(time).collect();
        // Rows are scaled and the answer is checked, so scaling, refinement and rows against standstill are mostly not worth their cost.
        match solve_within(&cost, rows, false).and_then(|answer| self.moving(answer)) {
            Err(_) => {
                let above_zero = (0..unknowns).map(|j| Form {
                    constant: 1.0,
                    ..Form::unknown(j).scaled(-1.0 / reference[j])
                });
                let rows: Vec<Form> = rows.iter().copied().chain(above_zero).collect();
                solve_within(&cost, &rows, true).and_then(|answer| self.moving(answer))
            }
            answer => answer,
        }
    }

    /// Accepts an answer that never stands still on the path.
    fn moving(&self, answer: Answer) -> Result<Answer, JerkError> {
        let moves = |j: usize| {
            let (begin, end) = (self.squared[j].at(&answer.x), self.squared[j + 1].at(&answer.x));
            // The parabola is positive for a coefficient above `-√(begin end)`; half of that is required.
            begin > 1e-9 && end > 1e-9 && answer.x[j] > -0.5 * (begin * end).sqrt()
        };
        if (0..answer.x.len()).all(|j| moves(j) || (j == 0 && self.begin == 0 && answer.x[0] > 0.0)) {
            Ok(answer)
        } else {
            Err(JerkError::Solver("standstill".to_owned()))
        }
    }

    /// Squared speed and acceleration at every sample of the path.
    fn law(&self, path: &GeometricPath, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut law = (vec![0.0; self.begin], vec![0.0; self.begin]);
        law.0.extend(self.squared.iter().map(|form| form.at(x)));
        law.1.extend(self.accelerations.iter().map(|form| form.at(x)));
        law.0.resize(path.points().len(), 0.0);
        law.1.resize(path.points().len(), 0.0);
        law
    }
}

/// Bounds of the rows, besides the path.
struct Bounds<'a> {
    /// Largest squared speed on each interval of the path, m²/s².
    ceilings: Vec<f64>,
    /// The sweep's squared speeds at its samples, which no law exceeds, m²/s².
    sweep: &'a [f64],
    /// Jerk, m/s³.
    jerk: f64,
}

struct Answer {
    x: Vec<f64>,
    status: String,
    iterations: u32,
    gap: f64,
}

/// Minimises the sum of `bend x² / 2 + slope x` within the rows.
fn solve_within(cost: &[(f64, f64)], rows: &[Form], precise: bool) -> Result<Answer, JerkError> {
    let (matrix, bounds) = columns(rows, cost.len());
    let mut settings = DefaultSettingsBuilder::default();
    settings.verbose(false).max_iter(60).presolve_enable(false);
    settings
        .equilibrate_enable(precise)
        .iterative_refinement_enable(precise);
    if !precise {
        settings.tol_gap_rel(1e-5).tol_gap_abs(1e-6).tol_feas(1e-6);
    }
    let settings = settings.build().map_err(|error| JerkError::Solver(error.to_string()))?;
    let unknowns = cost.len();
    let (bends, slopes): (Vec<f64>, Vec<f64>) = cost.iter().copied().unzip();
    let bends = CscMatrix::new(
        unknowns,
        unknowns,
        (0..=unknowns).collect(),
        (0..unknowns).collect(),
        bends,
    );
    let cones = [NonnegativeConeT(bounds.len())];
    let mut solver = DefaultSolver::new(&bends, &slopes, &matrix, &bounds, &cones, settings)
        .map_err(|error| JerkError::Solver(error.to_string()))?;
    solver.solve();
    let status = solver.solution.status;
    let x = &solver.solution.x;
    if !matches!(status, SolverStatus::Solved | SolverStatus::AlmostSolved) {
        return Err(JerkError::Solver(format!("{status:?}")));
    }
    // The solver's status is not trusted: all rows are checked.
    if !rows.iter().all(|row| row.at(x) <= 1.0 + 0.9 * MARGIN) {
        return Err(JerkError::Solver(format!("{status:?}_over_a_limit")));
    }
    Ok(Answer {
        x: x.clone(),
        status: format!("{status:?}"),
        iterations: solver.solution.iterations,
        gap: solver.info.gap_rel,
    })
}
