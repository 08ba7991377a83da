//! A peer of the sweep: the same time law as a linear programme, solved by Clarabel.
//!
//! The unknowns are the squared speeds at the samples, and their sum is maximised; bounds are the sweep's own (ceilings, both wheels'
//! accelerations at both ends of every interval), so that the same law comes out.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT};
use zenav_smoothing::{GeometricPath, Limits, ceilings};

/// Squared speeds (m²/s²) at the samples, from rest to rest; `None` if the solver fails.
pub fn fastest(path: &GeometricPath, limits: &Limits) -> Option<Vec<f64>> {
    let points = path.points();
    let last = points.len() - 1;
    let ceilings = ceilings(path, limits, &[0.0]);
    // Each row: up to two unknowns and a bound.
    let mut rows: Vec<([(usize, f64); 2], f64)> = vec![([(0, 1.0), (0, 0.0)], 0.0), ([(last, 1.0), (last, 0.0)], 0.0)];
    for i in 1..last {
        rows.push(([(i, -1.0), (i, 0.0)], 0.0));
        rows.push(([(i, 1.0), (i, 0.0)], ceilings[i].min(ceilings[i - 1])));
    }
    for i in 0..last {
        let length = points[i + 1].s - points[i].s;
        for wheel in [limits.half_separation, -limits.half_separation] {
            let bend = wheel * path.slope(i);
            for (k, at_end) in [(points[i].k, false), (points[i + 1].k, true)] {
                let gain = (1.0 + wheel * k) / (2.0 * length);
                let (start, end) = if at_end {
                    (-gain, gain + bend)
                } else {
                    (bend - gain, gain)
                };
                rows.push(([(i, start), (i + 1, end)], limits.wheel_acceleration));
                rows.push(([(i, -start), (i + 1, -end)], limits.wheel_acceleration));
            }
        }
    }
    let mut entries: Vec<(usize, usize, f64)> = Vec::with_capacity(2 * rows.len());
    for (row, (terms, _)) in rows.iter().enumerate() {
        entries.extend(
            terms
                .iter()
                .filter(|(_, factor)| *factor != 0.0)
                .map(|(unknown, factor)| (*unknown, row, *factor)),
        );
    }
    entries.sort_unstable_by_key(|(unknown, row, _)| (*unknown, *row));
    let mut starts = vec![0; points.len() + 1];
    for (unknown, _, _) in &entries {
        starts[unknown + 1] += 1;
    }
    for i in 0..points.len() {
        starts[i + 1] += starts[i];
    }
    let (indices, values) = entries.iter().map(|(_, row, factor)| (*row, *factor)).unzip();
    let matrix = CscMatrix::new(rows.len(), points.len(), starts, indices, values);
    let bounds: Vec<f64> = rows.iter().map(|(_, bound)| *bound).collect();
    let cost = CscMatrix::zeros((points.len(), points.len()));
    let cones = [ZeroConeT(2), NonnegativeConeT(rows.len() - 2)];
    let settings = DefaultSettingsBuilder::default()
        .verbose(false)
        .presolve_enable(false)
        .build()
        .ok()?;
    let mut solver = DefaultSolver::new(&cost, &vec![-1.0; points.len()], &matrix, &bounds, &cones, settings).ok()?;
    solver.solve();
    let solved = matches!(
        solver.solution.status,
        SolverStatus::Solved | SolverStatus::AlmostSolved
    );
    solved.then(|| solver.solution.x.iter().map(|b| b.max(0.0)).collect())
}
