//! SLAM. What do a log's scans and odometry, or a pose graph, say of where the robot was?
//!
//! | file | answers |
//! |---|---|
//! | `log` | `zenav slam --log`: a map and poses from scans and odometry alone |
//! | `merge` | `zenav map merge`: one map of two sessions |
//! | `session` | which map does a session file hold, and how does a map look of which only the points are left? |
//! | `written` | what is written of a map |
//! | `graph` | `zenav slam --graph`: which poses agree best, and is that certain? |
//! | `picture` | how did the way look before, and how after? |

mod graph;
mod log;
mod merge;
mod picture;
mod session;
mod written;

use std::path::PathBuf;

use crate::failure::Outcome;
use crate::output::Format;

pub(crate) use merge::{MergeArgs, merge};

/// A map from a log, or the solution of a pose graph.
///
/// A log's poses are taken for raw odometry: those of a corrected log leave nothing to do. The time is that of the thread: what others do on
/// the machine does not count.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav slam --log drive.log.gz --out map\n  zenav slam --graph graph.g2o --robust --out solved"
)]
#[command(group(clap::ArgGroup::new("input").required(true).args(["log", "graph"])))]
pub struct SlamArgs {
    /// CARMEN log of scans and raw odometry, compressed by gzip or not; several: drives one after the other in one building
    #[arg(long, value_name = "FILE", requires = "out")]
    log: Vec<PathBuf>,
    /// The map so far: gone on with where the file exists, saved at the end
    #[arg(long, value_name = "FILE", requires = "log")]
    session: Option<PathBuf>,
    /// Where the first log begins in the session's map, to within 1 m and 0.5 rad: m, m, rad [default: searched for]
    #[arg(long, value_names = ["X", "Y", "YAW"], num_args = 3, requires = "session")]
    start: Option<Vec<f64>>,
    /// Reference relations: lines `t1 t2 x y z roll pitch yaw`
    #[arg(long, value_name = "FILE", requires = "log")]
    relations: Option<PathBuf>,
    /// Pose graph in g2o's format (2D): solved and certified, nothing else
    #[arg(long, value_name = "FILE")]
    graph: Option<PathBuf>,
    /// Tell false closures of the graph from true ones
    #[arg(long, requires = "graph")]
    robust: bool,
    /// Folder for trajectory.csv, graph.g2o, map.pgm, map.yaml and slam.png; of a graph for graph.g2o
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Side of a cell of the map, m
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = crate::connect::resolution)]
    resolution: f64,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Maps a log, or solves a graph.
///
/// # Errors
/// Exit code 3 when a file is missing, 2 when it is bad, 1 when there is no solution.
pub fn slam(args: &SlamArgs) -> Outcome {
    match &args.graph {
        Some(graph) => graph::solve(graph, args),
        // clap asks for one of them.
        None => log::map(args),
    }
}
