//! AMCL beside the localiser, on the same map, start, odometry and scans. `AMCL_PEER` names the program built from
//! `cloud/localisation/benches/peers/amcl.cpp`.

use std::fmt::Write as _;
use std::io::{Seek as _, Write as _};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::messages::Scan;

/// How AMCL uses the scans: as the program calls it, and in words.
pub const USES: [(&str, &str); 2] = [
    ("node", "beluga AMCL with its node's defaults"),
    ("each_scan", "beluga AMCL with each scan"),
];

/// Sums over drives.
#[derive(Clone, Debug, Default)]
pub struct Sums {
    /// Error of the pose at each scan, m and rad.
    pub errors: [Vec<f64>; 2],
    /// Processor time of each scan, s.
    pub took: Vec<f64>,
    /// Number of scans that updated the filter.
    pub updates: usize,
}

/// A drive, as the program reads it.
pub(super) struct Log {
    program: PathBuf,
    text: String,
    truths: Vec<Option<Pose2>>,
}

impl Log {
    /// If there is a program.
    pub(super) fn new(map: &OccupancyGrid) -> Option<Self> {
        let program = PathBuf::from(std::env::var_os("AMCL_PEER")?);
        let spec = map.spec();
        let mut text = format!(
            "map {} {} {} {} {} ",
            spec.width, spec.height, spec.resolution, spec.origin.x, spec.origin.y
        );
        text.extend(map.values().iter().map(|value| match Occupancy::of(*value) {
            Occupancy::Occupied => '#',
            Occupancy::Free => '.',
            _ => '?',
        }));
        text.push('\n');
        Some(Self {
            program,
            text,
            truths: Vec::new(),
        })
    }

    /// Takes in a scan, and the true pose at its stamp.
    pub(super) fn note(&mut self, scan: &Scan, truth: Option<Pose2>) {
        // Writing to a string does not fail.
        if self.truths.is_empty() {
            let Pose2 { x, y, yaw } = scan.map_from_odom * scan.odom_from_base;
            let _ = writeln!(self.text, "start {x} {y} {yaw}");
        }
        self.text.push_str("scan");
        for Pose2 { x, y, yaw } in [scan.odom_from_base, scan.base_from_laser] {
            let _ = write!(self.text, " {x} {y} {yaw}");
        }
        let (first, step, beams) = (scan.angle_min, scan.angle_increment, scan.ranges.len());
        let _ = write!(
            self.text,
            " {first} {step} {} {} {beams}",
            scan.range_min, scan.range_max
        );
        for range in &scan.ranges {
            let _ = write!(self.text, " {range}");
        }
        self.text.push('\n');
        self.truths.push(truth);
    }

    /// Runs the program in both ways, and adds to the sums.
    pub(super) fn run(&self, seed: u64, sums: &mut [Sums; 2]) -> Result<(), String> {
        for ((how, _), sums) in USES.iter().zip(sums) {
            let answer = self.answer(how, seed).map_err(|error| format!("AMCL_PEER: {error}"))?;
            for (line, truth) in answer.lines().zip(&self.truths) {
                let numbers: Vec<f64> = line.split(' ').filter_map(|word| word.parse().ok()).collect();
                let [x, y, yaw, ms, is_update] = numbers[..] else {
                    return Err(format!("AMCL_PEER: expected five numbers, found `{line}`"));
                };
                sums.took.push(1e-3 * ms);
                sums.updates += usize::from(is_update == 1.0);
                if let Some(truth) = truth {
                    sums.errors[0].push(truth.distance(&Pose2::new(x, y, yaw)));
                    sums.errors[1].push(wrap_angle(yaw - truth.yaw).abs());
                }
            }
        }
        Ok(())
    }

    fn answer(&self, how: &str, seed: u64) -> std::io::Result<String> {
        let mut file = tempfile::tempfile()?;
        file.write_all(self.text.as_bytes())?;
        file.rewind()?;
        let seed = seed.to_string();
        let output = Command::new(&self.program)
            .args([how, &seed])
            .stdin(Stdio::from(file))
            .stderr(Stdio::inherit())
            .output()?;
        String::from_utf8(output.stdout).map_err(std::io::Error::other)
    }
}
