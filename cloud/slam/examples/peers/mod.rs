//! Others' SLAM beside ours, on the same odometry and scans: programs built from the sources here, each named by a variable.

use std::ffi::OsString;
use std::fmt::Write as _;
use std::io::Write as _;
use std::process::{Command, Stdio};

use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;

/// The programs; `scan.h` says how they take a log and answer.
pub const PEERS: [Peer; 2] = [
    Peer {
        variable: "LAMA_PEER",
        uses: &[
            (&["slam", "node", "1"], "LaMa Slam2D with its node's defaults"),
            (&["slam", "each_scan", "1"], "LaMa Slam2D with each scan"),
            (&["graph", "node", "1"], "LaMa GraphSlam2D with its node's defaults"),
            (&["graph", "each_scan", "1"], "LaMa GraphSlam2D with each scan"),
            (&["particles", "node", "1"], "LaMa PFSlam2D with its node's defaults"),
            (&["particles", "each_scan", "1"], "LaMa PFSlam2D with each scan"),
        ],
    },
    Peer {
        variable: "CARTOGRAPHER_PEER",
        uses: &[
            (&["ceres", "odometry"], "Cartographer with odometry"),
            (
                &["correlative", "odometry"],
                "Cartographer with odometry and correlative matching",
            ),
            (
                &["correlative", "scans"],
                "Cartographer with correlative matching, without odometry",
            ),
        ],
    },
];

/// A program that may be there.
pub struct Peer {
    /// Environment variable that names it.
    variable: &'static str,
    /// Its uses: the program's arguments, and in words.
    pub uses: &'static [(&'static [&'static str], &'static str)],
}

/// What a peer made of a log.
pub struct Answer {
    /// The poses as the scans arrive.
    pub online: Vec<Pose2>,
    /// Those that all scans together lead to; none if the method has no such.
    pub finished: Vec<Pose2>,
    /// Number of scans that were used.
    pub updates: usize,
    /// Processor time while the scans arrive, s.
    pub online_secs: f64,
    /// Processor time with the finish, s.
    pub secs: f64,
}

impl Peer {
    /// Where it is, if anywhere.
    pub fn program(&self) -> Option<OsString> {
        std::env::var_os(self.variable)
    }

    /// Runs the program.
    pub fn run(&self, program: &OsString, arguments: &[&str], log: &str) -> Answer {
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut input = child.stdin.take().unwrap();
        // It may answer while it reads.
        let output = std::thread::scope(|scope| {
            scope.spawn(move || input.write_all(log.as_bytes()).unwrap());
            child.wait_with_output().unwrap()
        });
        assert!(output.status.success(), "{} failed", self.variable);
        let text = String::from_utf8(output.stdout).unwrap();
        let lines: Vec<Vec<f64>> = text
            .lines()
            .map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect())
            .collect();
        let poses = |lines: &[Vec<f64>]| lines.iter().map(|line| Pose2::new(line[0], line[1], line[2])).collect();
        let secs = |lines: &[Vec<f64>]| lines.iter().map(|line| 1e-3 * line[3]).sum();
        let (online, finished) = lines.split_at(log.lines().count());
        Answer {
            online: poses(online),
            finished: poses(finished),
            updates: online.iter().filter(|line| line[4] == 1.0).count(),
            online_secs: secs(online),
            secs: secs(&lines),
        }
    }
}

/// A log as the peers read it.
pub fn log(scans: &[Scan]) -> String {
    let mut log = String::new();
    for scan in scans {
        write!(log, "scan {}", scan.stamp.as_secs()).unwrap();
        for Pose2 { x, y, yaw } in [scan.odom_from_base, scan.base_from_laser] {
            write!(log, " {x} {y} {yaw}").unwrap();
        }
        let (first, step, beams) = (scan.angle_min, scan.angle_increment, scan.ranges.len());
        write!(log, " {first} {step} {} {} {beams}", scan.range_min, scan.range_max).unwrap();
        for range in &scan.ranges {
            write!(log, " {range}").unwrap();
        }
        log.push('\n');
    }
    log
}
