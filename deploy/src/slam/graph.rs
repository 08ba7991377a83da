//! `zenav slam --graph`. Solves a pose graph file, and certifies whether the solution is the global optimum.

use std::path::Path;

use serde::Serialize;
use zenav_pose_graph::{
    Certificate, DescentSettings, Optimality, RobustSettings, RobustSolution, SolveError, g2o, solve as solve_graph,
    solve_robust,
};

use super::SlamArgs;
use crate::batch::thread_time;
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
    /// With `--robust`: ends, by the file's numbers, of the closures that were accepted or rejected on weak evidence.
    doubtful: Vec<[u64; 2]>,
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
            doubtful: Vec::new(),
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
        let reason = output::piece(self.reason.as_ref(), |reason| format!(" ({reason})"));
        let doubtful = match self.doubtful.len() {
            0 => String::new(),
            count => format!(" ({count} closures on weak evidence)"),
        };
        format!(
            "graph: {} nodes, {} edges, {} held to be false{doubtful}, chi squared {:.3}, {}{reason} in {:.1} ms",
            self.nodes, self.edges, self.dropped, self.chi_squared, self.optimality, self.solve_ms
        )
    }
}

/// Solves the graph of a file, and writes the files for `--out`.
pub(super) fn solve(path: &Path, args: &SlamArgs) -> Outcome {
    output::value(args.output, &solved(path, args)?, Solved::told)
}

fn solved(path: &Path, args: &SlamArgs) -> Result<Solved, Failure> {
    let text = files::text_within(path, MAX_GRAPH)?;
    let g2o::Document { mut graph, ids } = g2o::read(&text).map_err(Failure::usage_at(path))?;
    let descent = DescentSettings::default();
    let settings = RobustSettings::default();
    let start = thread_time();
    let robust = if args.robust {
        solve_robust(&graph, &descent, &settings)
    } else {
        solve_graph(&graph, &descent).map(|solution| RobustSolution {
            solution,
            weights: vec![1.0; graph.edges().len()],
            rounds: 0,
        })
    };
    let robust = robust.map_err(|error| Failure::failed_at(path)(unsolved(&error, &ids, args.robust)))?;
    let solve_ms = 1e3 * thread_time().saturating_sub(start).as_secs_f64();
    let mut told = Solved::new(graph.poses().len(), &robust, solve_ms);
    if args.robust {
        let ends = |index: usize| {
            let edge = &graph.edges()[index];
            [ids[edge.from], ids[edge.to]]
        };
        told.doubtful = robust.doubtful(&graph, &settings).into_iter().map(ends).collect();
    }
    if let Some(out) = &args.out {
        std::fs::create_dir_all(out).map_err(Failure::failed_at(out))?;
        graph.set_poses(&robust.solution.poses).map_err(Failure::failed)?;
        files::write(
            &out.join("graph.g2o"),
            g2o::write_weighted(&graph, &ids, &robust.weights),
        )?;
    }
    Ok(told)
}

/// Why a graph of a file has no solution, by the vertices' ids.
fn unsolved(error: &SolveError, ids: &[u64], is_robust: bool) -> String {
    match error {
        SolveError::Disconnected { node } => {
            let id = |node: usize| ids.get(node).copied().unwrap_or_default();
            let edges = if is_robust { "edges of odometry" } else { "edges" };
            format!(
                "vertex {} is not joined to vertex {} by {edges}: solve the parts one by one",
                id(*node),
                id(0)
            )
        }
        error => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::*;

    #[test]
    fn a_square_in_a_compressed_file_is_solved_and_certified() {
        let folder = tempfile::tempdir().unwrap();
        let (file, out) = (folder.path().join("square.g2o.gz"), folder.path().join("out"));
        let mut packed = GzEncoder::new(std::fs::File::create(&file).unwrap(), Compression::fast());
        for (from, to) in [(0, 1), (1, 2), (2, 3), (3, 0)] {
            writeln!(packed, "EDGE_SE2 {from} {to} 1 0 1.5707963 100 0 0 100 0 100").unwrap();
        }
        packed.finish().unwrap();
        let [graph, to] = [&file, &out].map(|path| path.to_str().unwrap());
        let args = crate::cli::parsed(&["--graph", graph, "--out", to]).unwrap();
        let found = solved(&file, &args).unwrap();
        assert_eq!((found.nodes, found.edges, found.certified), (4, 4, true));
        assert!(found.chi_squared < 1e-6, "{}", found.chi_squared);
        let written = files::text(&out.join("graph.g2o")).unwrap();
        assert_eq!(g2o::read(&written).unwrap().graph.edges().len(), 4);
    }
    #[test]
    fn a_part_without_a_link_is_named_by_its_vertex_and_a_false_closure_is_a_comment() {
        let folder = tempfile::tempdir().unwrap();
        let (file, out) = (folder.path().join("graph.g2o"), folder.path().join("out"));
        let [graph, to] = [&file, &out].map(|path| path.to_str().unwrap());
        let edge = |from: u64, to: u64, x: f64| format!("EDGE_SE2 {from} {to} {x} 0 0 100 0 0 100 0 400\n");
        let args = crate::cli::parsed(&["--graph", graph, "--robust", "--out", to]).unwrap();
        std::fs::write(&file, [edge(7, 8, 1.0), edge(20, 21, 1.0)].concat()).unwrap();
        let refused = solved(&file, &args).unwrap_err();
        assert!(
            refused
                .message
                .ends_with("vertex 20 is not joined to vertex 7 by edges of odometry: solve the parts one by one"),
            "{refused}"
        );
        let drive: String = (0..5).map(|from| edge(from, from + 1, 1.0)).collect();
        std::fs::write(&file, [drive, edge(0, 5, 5.0), edge(1, 4, 0.0)].concat()).unwrap();
        assert_eq!(solved(&file, &args).unwrap().dropped, 1);
        let written = files::text(&out.join("graph.g2o")).unwrap();
        assert!(
            written.ends_with("# EDGE_SE2 1 4 0 0 0 100 0 0 100 0 400\n"),
            "{written}"
        );
        assert_eq!(g2o::read(&written).unwrap().graph.edges().len(), 6);
    }
}
