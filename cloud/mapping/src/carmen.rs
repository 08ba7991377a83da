//! CARMEN logs. Reads and writes recorded laser scans at known poses.
//!
//! `FLASER n r1 … rn x y theta odom_x odom_y odom_theta time host logger_time` is a sweep of half a circle; the first pose is the laser's,
//! the second one the robot's raw odometry. `ROBOTLASER1` states its own field of view. Other lines are skipped.

use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use flate2::read::MultiGzDecoder;
use thiserror::Error;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;

use crate::settings::BeamSettings;

/// Longest line that is read, bytes.
const MAX_LINE: u64 = 1 << 20;
/// Most readings in a sweep.
const MAX_BEAMS: usize = 10_000;
/// Readings from here on, m, mean no return: lasers of that time report 81.9 m.
const NOTHING_SEEN: f64 = 80.0;
/// The reading, m, of a beam without a return in a sweep of half a circle.
const NO_RETURN: f64 = 81.91;
/// Shorter readings, m, are none.
const RANGE_MIN: f64 = 0.02;
/// Angles that differ by less, rad, are the same.
const SAME_ANGLE: f64 = 1e-9;

/// Why a log could not be read.
#[derive(Debug, Error)]
pub enum CarmenError {
    /// A line is malformed.
    #[error("line {line}: {what}")]
    Line {
        /// Number of the line, from 1.
        line: u64,
        /// What was expected, and what was found.
        what: String,
    },
    /// The file could not be read, or its compression is broken.
    #[error("after line {line}: {source}")]
    Io {
        /// Number of lines read before.
        line: u64,
        /// Error of the file system.
        source: std::io::Error,
    },
}

/// Iterator over the scans of a log.
pub struct CarmenReader<R> {
    input: R,
    line: u64,
    buffer: Vec<u8>,
    failed: bool,
}

/// Opens a log, compressed by gzip or not.
///
/// # Errors
/// [`CarmenError::Io`].
pub fn open(path: &Path) -> Result<CarmenReader<Box<dyn BufRead>>, CarmenError> {
    let failed = |source| CarmenError::Io { line: 0, source };
    let mut file = BufReader::new(File::open(path).map_err(failed)?);
    let compressed = file.fill_buf().map_err(failed)?.starts_with(&[0x1f, 0x8b]);
    let input: Box<dyn BufRead> = if compressed {
        Box::new(BufReader::new(MultiGzDecoder::new(file)))
    } else {
        Box::new(file)
    };
    Ok(CarmenReader::new(input))
}

impl<R: BufRead> CarmenReader<R> {
    /// Reads scans from plain text.
    pub fn new(input: R) -> Self {
        Self {
            input,
            line: 0,
            buffer: Vec::new(),
            failed: false,
        }
    }

    fn next_scan(&mut self) -> Result<Option<Scan>, CarmenError> {
        loop {
            self.buffer.clear();
            let read = (&mut self.input).take(MAX_LINE).read_until(b'\n', &mut self.buffer);
            if read.map_err(|source| CarmenError::Io {
                line: self.line,
                source,
            })? == 0
            {
                return Ok(None);
            }
            self.line += 1;
            let line = self.line;
            let wrong = |what: String| CarmenError::Line { line, what };
            if self.buffer.len() as u64 == MAX_LINE {
                return Err(wrong(format!("longer than {MAX_LINE} bytes")));
            }
            if !["FLASER", "ROBOTLASER1"]
                .iter()
                .any(|kind| self.buffer.starts_with(kind.as_bytes()))
            {
                continue;
            }
            let Ok(text) = std::str::from_utf8(&self.buffer) else {
                return Err(wrong("expected text".to_owned()));
            };
            let mut words = Words {
                words: text.split_ascii_whitespace(),
            };
            let scan = match words.words.next() {
                Some("FLASER") => words.front_laser(),
                Some("ROBOTLASER1") => words.robot_laser(),
                _ => continue,
            };
            let scan = scan.map_err(wrong)?;
            if !scan.is_sane() {
                return Err(wrong(
                    "expected a finite pose and a field of view of at most a full circle".to_owned(),
                ));
            }
            return Ok(Some(scan));
        }
    }
}

impl<R: BufRead> Iterator for CarmenReader<R> {
    type Item = Result<Scan, CarmenError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let next = self.next_scan().transpose();
        self.failed = matches!(next, Some(Err(_)));
        next
    }
}

struct Words<'t> {
    words: std::str::SplitAsciiWhitespace<'t>,
}

impl Words<'_> {
    fn number(&mut self, what: &str) -> Result<f64, String> {
        let word = self
            .words
            .next()
            .ok_or_else(|| format!("expected {what}, found the end of the line"))?;
        word.parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .ok_or_else(|| format!("expected {what}, found `{}`", word.chars().take(40).collect::<String>()))
    }

    fn count(&mut self, what: &str) -> Result<usize, String> {
        let number = self.number(what)?;
        if number.fract() == 0.0 && (0.0..=MAX_BEAMS as f64).contains(&number) {
            Ok(number as usize)
        } else {
            Err(format!("expected {what} up to {MAX_BEAMS}, found {number}"))
        }
    }

    fn ranges(&mut self) -> Result<Vec<f32>, String> {
        let count = self.count("the number of readings")?;
        (0..count)
            .map(|_| self.number("a reading").map(|range| range as f32))
            .collect()
    }

    fn pose(&mut self) -> Result<Pose2, String> {
        Ok(Pose2::new(self.number("x")?, self.number("y")?, self.number("theta")?))
    }

    /// Reads the time. Only the logging host and its time may follow; more words mean a wrong number of readings.
    fn time(&mut self) -> Result<f64, String> {
        let time = self.number("the time");
        let left = self.words.clone().count();
        let time = match time {
            Ok(_) if left > 2 => Err(format!(
                "expected the host and its time at the end of the line, found {left} words"
            )),
            time => time,
        };
        time.map_err(|error| format!("{error}: is the number of readings right?"))
    }

    fn front_laser(mut self) -> Result<Scan, String> {
        let ranges = self.ranges()?;
        let laser = self.pose()?;
        self.pose()?;
        let time = self.time()?;
        let angle_increment = half_circle_increment(ranges.len());
        Ok(scan(time, laser, -FRAC_PI_2, angle_increment, NOTHING_SEEN, ranges))
    }

    fn robot_laser(mut self) -> Result<Scan, String> {
        self.number("the laser's type")?;
        let angle_min = self.number("the start angle")?;
        self.number("the field of view")?;
        let angle_increment = self.number("the angular resolution")?;
        let range_max = self.number("the maximum range")?.min(NOTHING_SEEN);
        self.number("the accuracy")?;
        self.number("the remission mode")?;
        let mut ranges = self.ranges()?;
        // The maximum range itself means no return.
        for range in ranges.iter_mut().filter(|range| **range >= range_max as f32) {
            *range = f32::INFINITY;
        }
        for _ in 0..self.count("the number of remissions")? {
            self.number("a remission")?;
        }
        let laser = self.pose()?;
        self.pose()?;
        for what in [
            "the forward speed",
            "the turning speed",
            "the forward safety distance",
            "the side safety distance",
            "the turn axis",
        ] {
            self.number(what)?;
        }
        let time = self.time()?;
        Ok(scan(time, laser, angle_min, angle_increment, range_max, ranges))
    }
}

/// Angle, rad, between the readings of a sweep of half a circle: 180 readings are a degree apart, and so are 181.
fn half_circle_increment(readings: usize) -> f64 {
    match readings {
        180 | 181 => PI / 180.0,
        360 | 361 => PI / 360.0,
        count => PI / count.saturating_sub(1).max(1) as f64,
    }
}

fn scan(time: f64, laser: Pose2, angle_min: f64, angle_increment: f64, range_max: f64, ranges: Vec<f32>) -> Scan {
    Scan {
        stamp: Stamp::from_secs(time),
        angle_min,
        angle_increment,
        range_min: RANGE_MIN,
        range_max,
        ranges,
        boot_id: String::new(),
        moving: Vec::new(),
        base_from_laser: Pose2::IDENTITY,
        map_from_odom: Pose2::IDENTITY,
        odom_from_base: laser,
    }
}

/// The line of a scan, `FLASER` for a sweep of half a circle and `ROBOTLASER1` for any other. Its laser stands where the scan's own poses
/// put it, corrected ones for example; `odom_from_base` is the robot's raw odometry, which only `FLASER` has room for.
///
/// The lines of [`CarmenReader`]'s scans are read back as the same scans, with their stamps to a double's precision. A beam without a return
/// gets a reading that means none.
///
/// ```
/// use zenav_mapping::carmen::{CarmenReader, line};
///
/// let log = "FLASER 3 1 2 81.91 0.5 -0.5 0.1 0.4 -0.5 0.2 1.25 zenav 1.25\n";
/// let scan = CarmenReader::new(log.as_bytes()).next().unwrap().unwrap();
/// let odometry = zenav_protocol::geometry::Pose2::new(0.4, -0.5, 0.2);
/// assert_eq!(line(&scan, odometry), log);
/// ```
#[must_use]
pub fn line(scan: &Scan, odom_from_base: Pose2) -> String {
    let is_half_circle = (scan.angle_min + FRAC_PI_2).abs() < SAME_ANGLE
        && (scan.angle_increment - half_circle_increment(scan.ranges.len())).abs() < SAME_ANGLE;
    let laser = scan.map_from_laser();
    let mut line = String::new();
    if is_half_circle {
        line.push_str("FLASER");
        push_readings(&mut line, scan, NOTHING_SEEN, NO_RETURN);
        push_poses(&mut line, [laser, odom_from_base]);
    } else {
        let range_max = scan.range_max.min(NOTHING_SEEN);
        let view = scan.angle_increment * scan.ranges.len().saturating_sub(1) as f64;
        // Writing to a string does not fail.
        let _ = write!(
            line,
            "ROBOTLASER1 0 {} {view} {} {range_max} 0 0",
            scan.angle_min, scan.angle_increment
        );
        push_readings(&mut line, scan, range_max, range_max);
        line.push_str(" 0");
        push_poses(&mut line, [laser, scan.map_from_odom * scan.odom_from_base]);
        line.push_str(" 0 0 0 0 0");
    }
    let time = scan.stamp.as_secs();
    let _ = writeln!(line, " {time} zenav {time}");
    line
}

/// Appends the number of readings and the readings. What is read from `farthest` on means no return, and so does `none`, m.
fn push_readings(line: &mut String, scan: &Scan, farthest: f64, none: f64) {
    let _ = write!(line, " {}", scan.ranges.len());
    for range in &scan.ranges {
        let is_read_as_return = f64::from(*range) >= RANGE_MIN && *range < farthest as f32;
        let _ = if range.is_finite() && is_read_as_return == scan.is_return(*range) {
            write!(line, " {range}")
        } else {
            write!(line, " {none}")
        };
    }
}

fn push_poses(line: &mut String, poses: [Pose2; 2]) {
    for Pose2 { x, y, yaw } in poses {
        let _ = write!(line, " {x} {y} {yaw}");
    }
}

/// Beam settings for logs: nothing is trimmed, and a beam without a return is ignored, since those lasers also lose black and glass.
pub const LOG_BEAMS: BeamSettings = BeamSettings {
    trim: 0,
    max_range: None,
    clear_without_return: false,
    lost_run: 0,
};

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const LOG: &str = "# a comment\nPARAM robot_length 70\nODOM 0 0 0 0 0 0 0.1 host 0.1\nFLASER 3 1.0 2.0 81.9 0.5 -0.5 0.1 0.5 -0.5 0.1 1.25 host 1.25\nROBOTLASER1 0 -1.5 3.0 0.5 20 0.01 0 3 1.5 2.5 20 0 1 2 0.3 1 2 0.3 0 0 0.3 0.3 1e6 2.5 host 2.5\n";

    #[test]
    fn scans_of_both_kinds_are_read_and_all_else_is_passed_over() {
        let scans: Vec<Scan> = CarmenReader::new(LOG.as_bytes()).map(Result::unwrap).collect();
        assert_eq!(scans.len(), 2);
        assert_eq!(
            (scans[0].ranges.as_slice(), scans[0].map_from_laser(), scans[0].stamp),
            (
                [1.0, 2.0, 81.9].as_slice(),
                Pose2::new(0.5, -0.5, 0.1),
                Stamp::from_secs(1.25)
            )
        );
        assert!((scans[0].angle(2) - FRAC_PI_2).abs() < 1e-12 && !scans[0].is_return(81.9));
        assert_eq!(
            (scans[1].angle_min, scans[1].angle_increment, scans[1].ranges.len()),
            (-1.5, 0.5, 3)
        );
        // The maximum range means no return.
        assert_eq!(scans[1].ranges, [1.5, 2.5, f32::INFINITY]);
    }

    /// What is read from the lines of scans.
    fn read_back(scans: &[Scan], odom_from_base: Pose2) -> Vec<Scan> {
        let text: String = scans.iter().map(|scan| line(scan, odom_from_base)).collect();
        CarmenReader::new(text.as_bytes()).map(Result::unwrap).collect()
    }

    #[test]
    fn the_lines_of_scans_are_read_back_as_the_same_scans() {
        let corrected = |scan: Scan| Scan {
            odom_from_base: Pose2::new(3.25, -7.5, 2.5),
            ..scan
        };
        let mut scans: Vec<Scan> = CarmenReader::new(LOG.as_bytes())
            .map(|scan| corrected(scan.unwrap()))
            .collect();
        // The maximum range of some lasers is no number of single precision.
        let wide =
            "ROBOTLASER1 0 -2.1 4.2 1.4 5.6 0.01 0 4 0.01 5.6 1.1 4.9 0 1 2 0.3 1 2 0.3 0 0 0.3 0.3 1e6 2.5 host 2.5\n";
        let wide = CarmenReader::new(wide.as_bytes()).next().unwrap().unwrap();
        assert_eq!(wide.ranges, [0.01, f32::INFINITY, 1.1, 4.9]);
        scans.push(corrected(wide));
        for readings in [180, 181, 360, 361, 541] {
            let ranges = (0..readings).map(|reading| 0.1 + reading as f32 * 0.01).collect();
            let laser = Pose2::new(0.1, 0.2, -0.3);
            scans.push(scan(
                7.5,
                laser,
                -FRAC_PI_2,
                half_circle_increment(readings),
                NOTHING_SEEN,
                ranges,
            ));
        }
        assert_eq!(read_back(&scans, Pose2::new(1.0, 2.0, 3.0)), scans);
        let words = line(&scans[0], Pose2::new(1.0, 2.0, 3.0));
        assert_eq!(words, "FLASER 3 1 2 81.9 3.25 -7.5 2.5 1 2 3 1.25 zenav 1.25\n");
        assert!(
            line(&scans[1], Pose2::IDENTITY)
                .starts_with("ROBOTLASER1 0 -1.5 1 0.5 20 0 0 3 1.5 2.5 20 0 3.25 -7.5 2.5 ")
        );
    }

    #[test]
    fn a_beam_without_a_return_is_read_back_without_one() {
        for angle_min in [-FRAC_PI_2, -1.0] {
            let near = Scan {
                range_min: 0.5,
                ranges: vec![f32::INFINITY, f32::NAN, 0.3, 9.0, 4.0],
                ..scan(
                    1.0,
                    Pose2::IDENTITY,
                    angle_min,
                    half_circle_increment(5),
                    8.0,
                    Vec::new(),
                )
            };
            let read = &read_back(std::slice::from_ref(&near), Pose2::IDENTITY)[0];
            let returns =
                |scan: &Scan| -> Vec<bool> { scan.ranges.iter().map(|range| scan.is_return(*range)).collect() };
            assert_eq!(returns(read), [false, false, false, false, true]);
            assert_eq!(returns(read), returns(&near));
        }
    }

    #[test]
    fn a_mistake_is_named_with_its_line() {
        let error = |text: &str| {
            CarmenReader::new(text.as_bytes())
                .find_map(Result::err)
                .unwrap()
                .to_string()
        };
        assert_eq!(
            error("ODOM\nFLASER 3 1.0 2.0\n"),
            "line 2: expected a reading, found the end of the line"
        );
        assert_eq!(
            error("FLASER many 1.0\n"),
            "line 1: expected the number of readings, found `many`"
        );
        assert_eq!(
            error("FLASER 1e9 1.0\n"),
            "line 1: expected the number of readings up to 10000, found 1000000000"
        );
        assert_eq!(
            error("FLASER 2 1.0 2.0 3.0 0.5 -0.5 0.1 0.5 -0.5 0.1 1.25 host 1.25\n"),
            "line 1: expected the host and its time at the end of the line, found 3 words: is the number of readings right?"
        );
        assert_eq!(
            error("FLASER 4 1.0 2.0 3.0 0.5 -0.5 0.1 0.5 -0.5 0.1 1.25 host 1.25\n"),
            "line 1: expected the time, found `host`: is the number of readings right?"
        );
        assert_eq!(
            error("FLASER 1 nan 0 0 0 0 0 0 1\n"),
            "line 1: expected a reading, found `nan`"
        );
    }

    #[test]
    fn a_compressed_log_reads_like_a_plain_one_and_a_broken_one_is_an_error() {
        use std::io::Write;
        let folder = tempfile::tempdir().unwrap();
        let (plain, packed, broken) = (
            folder.path().join("a.log"),
            folder.path().join("a.log.gz"),
            folder.path().join("b.log.gz"),
        );
        std::fs::write(&plain, LOG).unwrap();
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(LOG.as_bytes()).unwrap();
        let bytes = encoder.finish().unwrap();
        std::fs::write(&packed, &bytes).unwrap();
        std::fs::write(&broken, &bytes[..bytes.len() / 2]).unwrap();
        let read = |path| open(path).unwrap().collect::<Result<Vec<Scan>, CarmenError>>();
        assert_eq!(read(&plain).unwrap(), read(&packed).unwrap());
        assert!(matches!(read(&broken), Err(CarmenError::Io { .. })));
    }
}
