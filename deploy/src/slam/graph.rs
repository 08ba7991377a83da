//! `zenav slam --graph`. Solves a pose graph file, and certifies whether the solution is the global optimum.

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

/// Largest graph file, bytes.
const MAX_GRAPH: u64 = 1 << 30;

/// A solved graph, as printed.
#[derive(Debug, Serialize)]
pub(super) struct Solved {
    nodes: usize,
    edges: usize,
    /// Loop closures rejected as false.
    dropped: usize,
    chi_squared: f64,
    /// `certified`, `refused`, `elsewhere` or `unknown`.
    optimality: &'static str,
    certified: bool,
    /// Reason if the optimality is unknown.
    reason: Option<String>,
    negative_pivots: usize,
    /// Largest distance to the optimum of the problem that was certified, m.
    companion_distance: f64,
    /// Processor time of the solves of the graph, certificate included, ms.
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
            reason: robust.solution.unknown_because().map(|unknown| unknown.to_string()),
            negative_pivots,
            companion_distance: distance,
            solve_ms,
        }
    }

    /// One-sentence summary.
    pub(super) fn told(&self) -> String {
        let reason = self.reason.as_ref();
        let reason = reason.map_or_else(String::new, |reason| format!(" ({reason})"));
        format!(
            "graph: {} nodes, {} edges, {} held to be false, chi squared {:.3}, {}{reason} in {:.1} ms",
            self.nodes, self.edges, self.dropped, self.chi_squared, self.optimality, self.solve_ms
        )
    }
}

/// Solves the graph of a file, and writes the files for `--out`.
pub(super) fn solve(path: &Path, args: &SlamArgs) -> Outcome {
    output::value(args.output, &solved(path, args)?, Solved::told)?;
    Ok(exit_code::OK)
}

fn solved(path: &Path, args: &SlamArgs) -> Result<Solved, Failure> {
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
    Ok(Solved::new(graph.poses().len(), &robust, solve_ms))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::io::Write as _;

    use clap::Parser as _;
    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::*;

    #[derive(clap::Parser)]
    struct Command {
        #[command(flatten)]
        slam: SlamArgs,
    }

    #[test]
    fn a_square_in_a_compressed_file_is_solved_and_certified() {
        let folder = tempfile::tempdir().unwrap();
        let (file, out) = (folder.path().join("square.g2o.gz"), folder.path().join("out"));
        let mut packed = GzEncoder::new(std::fs::File::create(&file).unwrap(), Compression::fast());
        for (from, to) in [(0, 1), (1, 2), (2, 3), (3, 0)] {
            writeln!(packed, "EDGE_SE2 {from} {to} 1 0 1.5707963 100 0 0 100 0 100").unwrap();
        }
        packed.finish().unwrap();
        let arguments = [
            "slam".as_ref(),
            "--graph".as_ref(),
            file.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ];
        let found = solved(&file, &Command::parse_from(arguments).slam).unwrap();
        assert_eq!((found.nodes, found.edges, found.certified), (4, 4, true));
        assert!(found.chi_squared < 1e-6, "{}", found.chi_squared);
        let written = files::text(&out.join("graph.g2o")).unwrap();
        assert_eq!(g2o::read(&written).unwrap().graph.edges().len(), 4);
    }
}
