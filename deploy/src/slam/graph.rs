//! `zenav slam --graph`. Which poses agree best with the measurements of a file, and is that certain?

use std::path::Path;

use serde::Serialize;
use zenav_pose_graph::{
    Certificate, DescentSettings, Optimality, RobustSettings, RobustSolution, g2o, solve as solve_graph, solve_robust,
};

use super::SlamArgs;
use crate::batch::thread_time;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output;

/// Largest graph that is read, bytes.
const MAX_GRAPH: u64 = 1 << 30;

/// A solved graph, as printed.
#[derive(Debug, Serialize)]
pub(super) struct Solved {
    nodes: usize,
    edges: usize,
    /// Closures held to be false.
    dropped: usize,
    chi_squared: f64,
    /// `certified`, `refused`, `elsewhere` or `unknown`.
    optimality: &'static str,
    certified: bool,
    negative_pivots: usize,
    /// Largest distance to the optimum of the problem that the certificate is about, m.
    companion_distance: f64,
    /// Time of this thread.
    solve_ms: f64,
}

impl Solved {
    pub(super) fn new(nodes: usize, robust: &RobustSolution, solve_ms: f64) -> Self {
        let Certificate {
            optimality,
            negative_pivots,
            distance,
            ..
        } = robust.solution.certificate;
        Self {
            nodes,
            edges: robust.weights.len(),
            dropped: robust.weights.iter().filter(|weight| **weight == 0.0).count(),
            chi_squared: robust.solution.chi_squared,
            optimality: match optimality {
                Optimality::Certified => "certified",
                Optimality::Refused => "refused",
                Optimality::Elsewhere => "elsewhere",
                Optimality::Unknown => "unknown",
            },
            certified: optimality == Optimality::Certified,
            negative_pivots,
            companion_distance: distance,
            solve_ms,
        }
    }

    /// In a sentence.
    pub(super) fn told(&self) -> String {
        format!(
            "graph: {} nodes, {} edges, {} held to be false, chi squared {:.3}, {} in {:.1} ms",
            self.nodes, self.edges, self.dropped, self.chi_squared, self.optimality, self.solve_ms
        )
    }
}

/// Solves the graph of a file.
pub(super) fn solve(path: &Path, args: &SlamArgs) -> Outcome {
    let text = files::text_within(path, MAX_GRAPH)?;
    let g2o::Document { mut graph, ids } = g2o::read(&text).map_err(Failure::usage_at(path))?;
    let descent = DescentSettings::default();
    let start = thread_time();
    let robust = if args.robust {
        solve_robust(&graph, &descent, &RobustSettings::default())
    } else {
        solve_graph(&graph, &descent).map(|solution| RobustSolution {
            solution,
            weights: vec![1.0; graph.edges().len()],
            rounds: 0,
        })
    };
    let robust = robust.map_err(Failure::failed_at(path))?;
    let solve_ms = 1e3 * thread_time().saturating_sub(start).as_secs_f64();
    if let Some(out) = &args.out {
        std::fs::create_dir_all(out).map_err(Failure::failed_at(out))?;
        graph.set_poses(&robust.solution.poses).map_err(Failure::failed)?;
        files::write(&out.join("graph.g2o"), g2o::write(&graph, &ids))?;
    }
    output::value(
        args.output,
        &Solved::new(graph.poses().len(), &robust, solve_ms),
        Solved::told,
    )?;
    Ok(exit_code::OK)
}
