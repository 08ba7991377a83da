//! `zenav map merge`. Merges two sessions of one building into one map.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::graph::Solved;
use super::{session, written};
use crate::batch::thread_time;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Merge two SLAM sessions into one map.
///
/// The sessions are files saved by `zenav slam --session`: of two robots, or of two days. The transform between their maps need not be
/// known; if it is not certain, nothing is written.
#[derive(Debug, clap::Args)]
pub struct MergeArgs {
    /// Session that gives the map its frame
    #[arg(value_name = "SESSION")]
    a: PathBuf,
    /// Session to be aligned with it
    #[arg(value_name = "OTHER")]
    b: PathBuf,
    /// Folder for session.slam, trajectory.csv, graph.g2o, map.pgm, map.yaml and slam.png
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Side of a cell of the map, m
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = crate::connect::resolution)]
    resolution: f64,
}

/// A merged map, as printed.
#[derive(Debug, Serialize)]
struct Merged {
    map: PathBuf,
    session: PathBuf,
    /// Nodes of each session.
    sessions: Vec<usize>,
    graph: Solved,
}

/// Merges two sessions.
///
/// # Errors
/// Exit code 3 if a file is missing, 2 if it is not a session, 1 if the transform between the maps is not certain.
pub fn merge(args: &MergeArgs, format: Format) -> Outcome {
    let (a, b) = (session::read(&args.a)?, session::read(&args.b)?);
    let start = thread_time();
    let (merged, solved) = zenav_slam::merge(a, b).map_err(|error| refused(&args.a, &args.b, &error))?;
    let solve_ms = 1e3 * thread_time().saturating_sub(start).as_secs_f64();
    let nodes = merged.nodes().len();
    let placed = session::scans(&merged, 0..nodes);
    let map = written::write(&args.out, args.resolution, &merged.trajectory(), &placed, &[], &merged)?;
    let file = args.out.join("session.slam");
    session::write(&file, &merged)?;
    let report = Merged {
        map,
        session: file,
        sessions: merged.sessions(),
        graph: Solved::new(nodes, &solved, solve_ms),
    };
    output::value(format, &report, |report| {
        format!(
            "{}, {}\n{}",
            report.map.display(),
            report.session.display(),
            report.graph.told()
        )
    })?;
    Ok(exit_code::OK)
}

fn refused(a: &Path, b: &Path, error: &zenav_slam::MergeError) -> Failure {
    Failure::failed(format!("{} and {}: {error}", a.display(), b.display()))
}
