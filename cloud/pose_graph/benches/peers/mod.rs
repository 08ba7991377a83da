//! Programs beside the solver, in the same run. Which are there, and what do they answer?
//!
//! | variable | is | program |
//! |---|---|---|
//! | `GTSAM_PYTHON` | a Python with GTSAM's wheel | `gtsam_peer.py` |
//! | `FACTRS_PEER` | the program built from `factrs/` | itself |

use std::ffi::OsString;
use std::io::Write as _;
use std::process::{Command, Stdio};

use zenav_pose_graph::{PoseGraph, g2o};
use zenav_protocol::geometry::Pose2;

/// A program that solves a graph by a method.
pub struct Peer {
    pub name: &'static str,
    program: OsString,
    /// Before the method and the number of runs.
    script: Option<&'static str>,
    /// After them.
    limit: Option<f64>,
}

/// What a peer's method ended with.
pub struct Answer {
    /// Median processor time, ms.
    pub ms: f64,
    /// Chi squared with the peer's errors, which are the logarithm of a pose where ours are its x, y and yaw.
    pub chi_squared: f64,
    pub poses: Vec<Pose2>,
}

impl Peer {
    /// If `GTSAM_PYTHON` is set. `limit`: chi squared beyond which GNC holds a closure to be false.
    pub fn gtsam(limit: f64) -> Option<Self> {
        std::env::var_os("GTSAM_PYTHON").map(|program| Self {
            name: "gtsam",
            program,
            script: Some(concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peers/gtsam_peer.py")),
            limit: Some(limit),
        })
    }

    /// If `FACTRS_PEER` is set.
    pub fn factrs() -> Option<Self> {
        std::env::var_os("FACTRS_PEER").map(|program| Self {
            name: "factrs",
            program,
            script: None,
            limit: None,
        })
    }

    /// Runs a method from the graph's own poses.
    pub fn solve(&self, method: &str, graph: &PoseGraph, runs: usize) -> Answer {
        let mut child = Command::new(&self.program)
            .args(self.script)
            .args([method, &runs.to_string()])
            .args(self.limit.map(|limit| limit.to_string()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let text = g2o::write(graph, &[]);
        child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{} failed", self.name);
        let text = String::from_utf8(output.stdout).unwrap();
        let mut lines = text
            .lines()
            .map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect::<Vec<f64>>());
        let first = lines.next().unwrap();
        Answer {
            ms: first[0],
            chi_squared: first[1],
            poses: lines.map(|pose| Pose2::new(pose[0], pose[1], pose[2])).collect(),
        }
    }
}
