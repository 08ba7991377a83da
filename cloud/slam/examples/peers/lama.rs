//! LaMa beside SLAM, on the same odometry and scans. `LAMA_PEER` names the program built from `lama.cpp`.

use std::ffi::OsString;
use std::fmt::Write as _;
use std::io::Write as _;
use std::process::{Command, Stdio};

use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;

/// LaMa's methods and how each uses the scans: as the program calls them, and in words.
pub const USES: [(&str, &str, &str); 6] = [
    ("slam", "node", "LaMa Slam2D with its node's defaults"),
    ("slam", "each_scan", "LaMa Slam2D with each scan"),
    ("graph", "node", "LaMa GraphSlam2D with its node's defaults"),
    ("graph", "each_scan", "LaMa GraphSlam2D with each scan"),
    ("particles", "node", "LaMa PFSlam2D with its node's defaults"),
    ("particles", "each_scan", "LaMa PFSlam2D with each scan"),
];

/// LaMa, and a log as it reads it.
pub struct Lama {
    program: OsString,
    log: String,
}

/// What LaMa made of the log.
pub struct Answer {
    /// The poses as the scans arrive.
    pub online: Vec<Pose2>,
    /// Those that all scans together lead to; none with Slam2D.
    pub finished: Vec<Pose2>,
    /// Number of scans that were used.
    pub updates: usize,
    /// Processor time, s.
    pub secs: f64,
}

impl Lama {
    /// If there is a program.
    pub fn new(scans: &[Scan]) -> Option<Self> {
        let program = std::env::var_os("LAMA_PEER")?;
        let mut log = String::new();
        for scan in scans {
            log.push_str("scan");
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
        Some(Self { program, log })
    }

    /// Runs the program.
    pub fn run(&self, method: &str, how: &str) -> Answer {
        let mut child = Command::new(&self.program)
            .args([method, how, "1"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut input = child.stdin.take().unwrap();
        // It answers while it reads.
        let output = std::thread::scope(|scope| {
            scope.spawn(move || input.write_all(self.log.as_bytes()).unwrap());
            child.wait_with_output().unwrap()
        });
        assert!(output.status.success(), "LAMA_PEER failed");
        let text = String::from_utf8(output.stdout).unwrap();
        let lines: Vec<Vec<f64>> = text
            .lines()
            .map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect())
            .collect();
        let poses = |lines: &[Vec<f64>]| lines.iter().map(|line| Pose2::new(line[0], line[1], line[2])).collect();
        let (online, finished) = lines.split_at(self.log.lines().count());
        Answer {
            online: poses(online),
            finished: poses(finished),
            updates: online.iter().filter(|line| line[4] == 1.0).count(),
            secs: lines.iter().map(|line| 1e-3 * line[3]).sum(),
        }
    }
}
