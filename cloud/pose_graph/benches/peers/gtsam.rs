//! GTSAM beside the solver, in the same run: `GTSAM_PYTHON` is a Python with its wheel; see `gtsam_peer.py`.

use std::ffi::OsString;
use std::io::Write as _;
use std::process::{Command, Stdio};

use zenav_pose_graph::{PoseGraph, g2o};
use zenav_protocol::geometry::Pose2;

/// GTSAM in a Python of its own.
pub struct Gtsam {
    python: OsString,
}

/// What a method of GTSAM ended with.
pub struct Answer {
    /// Median processor time, ms.
    pub ms: f64,
    /// Chi squared with GTSAM's errors, which are the logarithm of a pose where ours are its x, y and yaw.
    pub chi_squared: f64,
    pub poses: Vec<Pose2>,
}

impl Gtsam {
    /// If `GTSAM_PYTHON` is set.
    pub fn new() -> Option<Self> {
        std::env::var_os("GTSAM_PYTHON").map(|python| Self { python })
    }

    /// Runs a method from the graph's own poses. `limit`: chi squared beyond which GNC holds a closure to be false.
    pub fn solve(&self, method: &str, graph: &PoseGraph, runs: usize, limit: f64) -> Answer {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peers/gtsam_peer.py");
        let mut child = Command::new(&self.python)
            .args([script, method, &runs.to_string(), &limit.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let text = g2o::write(graph, &[]);
        child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "gtsam_peer.py failed");
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
