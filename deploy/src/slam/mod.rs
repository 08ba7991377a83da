//! SLAM. Maps and poses from logs of scans and odometry, and solutions of pose graphs.
//!
//! | file | answers |
//! |---|---|
//! | `log` | `zenav slam --log`: a map and poses from scans and odometry alone |
//! | `merge` | `zenav map merge`: one map from two sessions |
//! | `session` | session files, their maps, and scans rebuilt from their points |
//! | `written` | the files of a map |
//! | `graph` | `zenav slam --graph`: which poses agree best, and is that the optimum? |
//! | `picture` | the path by odometry, and the path in the map |
//! | `drive` | the simulated log of the tests |

#[cfg(test)]
pub(crate) mod drive;
mod graph;
mod log;
mod merge;
mod picture;
mod session;
mod written;

use std::path::PathBuf;

use crate::failure::Outcome;
use crate::output::Format;

pub(crate) use log::read_in_order;
pub(crate) use merge::{MergeArgs, merge};
pub(crate) use session::drawn;

/// Make a map from a log, or solve a pose graph.
///
/// A log's poses count as raw odometry: use an uncorrected log. Times are processor times of the thread, independent of other load on the
/// machine.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav slam --log drive.log.gz --out map\n  zenav slam --graph graph.g2o --robust --out solved"
)]
#[command(group(clap::ArgGroup::new("input").required(true).args(["log", "graph"])))]
pub struct SlamArgs {
    /// CARMEN log of scans and raw odometry, compressed by gzip or not; several: consecutive drives in one building
    #[arg(long, value_name = "FILE", requires = "out")]
    log: Vec<PathBuf>,
    /// Session to continue, if the file exists; saved at the end, or as session.slam in --out if a robot's mapping service keeps the file
    #[arg(long, value_name = "FILE", requires = "log")]
    session: Option<PathBuf>,
    /// Start of the first log in the existing session's map, to within 1 m and 0.5 rad: m, m, rad [default: searched for]
    #[arg(long, value_names = ["X", "Y", "YAW"], num_args = 3, requires = "session", value_parser = crate::arguments::finite)]
    start: Option<Vec<f64>>,
    /// Reference relations: lines `t1 t2 x y z roll pitch yaw`
    #[arg(long, value_name = "FILE", requires = "log")]
    relations: Option<PathBuf>,
    /// Pose graph in g2o's or TORO's format (2D) to solve and certify, instead of a log
    #[arg(long, value_name = "FILE")]
    graph: Option<PathBuf>,
    /// Reject false loop closures of the graph
    #[arg(long, requires = "graph")]
    robust: bool,
    /// Folder for trajectory.csv, carmen.log, graph.g2o, map.pgm, map.yaml and slam.png; with --graph, for graph.g2o
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Side of a cell of the map, m
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = crate::arguments::resolution)]
    resolution: f64,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Maps a log, or solves a graph.
///
/// # Errors
/// Exit code 3 if a file is missing, 2 if it is bad, 1 if there is no solution.
pub fn slam(args: &SlamArgs) -> Outcome {
    match &args.graph {
        Some(graph) => graph::solve(graph, args),
        // clap requires one of them.
        None => log::map(args),
    }
}
