//! `zenav map merge`. Merges two sessions of one building into one map.

use std::path::{Path, PathBuf};

use serde::Serialize;
use zenav_slam::MergeError;

use super::graph::Solved;
use super::picture::Ways;
use super::written::Drawn;
use super::{session, written};
use crate::batch::thread_time;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Merge two SLAM sessions into one map.
///
/// The sessions are files saved by `zenav slam --session` or kept by a robot's mapping service (`slam.session`): of two robots, or of two
/// days. The transform between their maps need not be known; if it is not certain, nothing is written.
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
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = crate::arguments::resolution)]
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
    /// Processor time of the whole merge, ms: search, closures, finish and solves.
    merge_ms: f64,
}

/// Merges two sessions.
///
/// # Errors
/// Exit code 3 if a file is missing, 2 if it is not a session or the other one holds the same scans, 1 if the transform between the maps is
/// not certain.
pub fn merge(args: &MergeArgs, format: Format) -> Outcome {
    let (a, b) = (session::read(&args.a)?.slam, session::read(&args.b)?.slam);
    let mut clock = || thread_time().as_secs_f64();
    let begin = clock();
    let (merged, solved, solving) =
        zenav_slam::merge_timed(a, b, &mut clock).map_err(|error| refused(&args.a, &args.b, &error))?;
    let merge_ms = 1e3 * (clock() - begin);
    let nodes = merged.nodes().len();
    let drawn = Drawn {
        slam: &merged,
        trajectory: &merged.trajectory(),
        placed: &session::scans(&merged, 0..nodes),
        ways: Ways {
            before: &[],
            after: merged.nodes(),
            degenerate: &[],
        },
    };
    let map = written::write(&args.out, args.resolution, &drawn)?;
    let file = args.out.join("session.slam");
    session::write(&file, &merged)?;
    let report = Merged {
        map,
        session: file,
        sessions: merged.sessions(),
        graph: Solved::new(nodes, &solved, 1e3 * solving),
        merge_ms,
    };
    output::value(format, &report, |report| {
        format!(
            "{}, {}\n{}; merged in {:.0} ms",
            report.map.display(),
            report.session.display(),
            report.graph.told(),
            report.merge_ms
        )
    })
}

fn refused(a: &Path, b: &Path, error: &MergeError) -> Failure {
    let (a, b) = (a.display(), b.display());
    match error {
        MergeError::Repeated { first, second } => Failure::usage(format!(
            "session {first} of {a} is session {second} of {b}: its measurements would count twice"
        )),
        error => Failure::failed(format!("{a} and {b}: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::super::drive;
    use super::*;

    #[test]
    fn a_session_is_not_merged_with_itself() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("room.slam");
        session::write(&file, &drive::mapped(&drive::scans(20))).unwrap();
        let args = MergeArgs {
            a: file.clone(),
            b: file.clone(),
            out: folder.path().join("both"),
            resolution: 0.05,
        };
        let refused = merge(&args, Format::Json).unwrap_err();
        let name = file.display();
        assert_eq!(
            refused.message,
            format!("session 1 of {name} is session 1 of {name}: its measurements would count twice")
        );
        assert!(!args.out.exists());
    }
}
