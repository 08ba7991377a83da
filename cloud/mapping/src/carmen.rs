//! CARMEN logs. Reads and writes recorded laser scans at known poses.
//!
//! `FLASER n r1 … rn x y theta odom_x odom_y odom_theta time host logger_time` is a sweep whose field of view follows from the number of
//! readings; the first pose is the laser's, the second one the robot's raw odometry. `ROBOTLASER1` states its own field of view. Other lines
//! are skipped. The time may be missing.
//!
//! [`open`] looks at the whole log first ([`survey()`]), and reads it accordingly:
//!
//! - a laser's pose that stands still while odometry moves is not taken; that of `ODOM` lines is, if neither pose in the lines moves, or if
//!   the log has only `RAWLASER1` lines, which have none;
//! - if the robot's clock was set back or stands still, the logger's is taken, if that runs on;
//! - the reading that means no return, and a field of view other than usual, are found.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use flate2::read::MultiGzDecoder;
use thiserror::Error;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;

use crate::settings::BeamSettings;

mod survey;
mod view;

pub use survey::Survey;
use view::View;

/// Longest line that is read, bytes.
const MAX_LINE: u64 = 1 << 20;
/// Most readings in a sweep.
const MAX_BEAMS: usize = 10_000;
/// Readings from here on, m, mean no return in any log: lasers of that time report 81.9 m.
const NOTHING_SEEN: f64 = 80.0;
/// The reading, m, of a beam without a return in a sweep of half a circle.
const NO_RETURN: f64 = 81.91;
/// Shorter readings, m, are none.
const RANGE_MIN: f64 = 0.02;
/// Numbers of a `ROBOTLASER1` and of a `RAWLASER1` line behind the remissions, time included.
const BEHIND_REMISSIONS: (usize, usize) = (12, 1);

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

/// Kind of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// `FLASER`.
    Front,
    /// `ROBOTLASER1`.
    Robot,
    /// `RAWLASER1`.
    Raw,
    /// `ODOM`.
    Odometry,
}

impl Kind {
    /// The kind of a line, by its first word.
    fn of(line: &[u8]) -> Option<Self> {
        match line.split(u8::is_ascii_whitespace).next()? {
            b"FLASER" => Some(Self::Front),
            b"ROBOTLASER1" => Some(Self::Robot),
            b"RAWLASER1" => Some(Self::Raw),
            b"ODOM" => Some(Self::Odometry),
            _ => None,
        }
    }
}

/// A sweep as its line has it.
struct Sweep {
    kind: Kind,
    view: View,
    /// The maximum range that the line states, m.
    range_max: Option<f64>,
    /// Readings in the order of the line, m.
    ranges: Vec<f32>,
    /// Of the laser and of the robot.
    poses: Option<(Pose2, Pose2)>,
    /// By the robot's and by the logger's clock, s.
    times: (Option<f64>, Option<f64>),
}

/// A line that is read.
enum Line {
    Sweep(Sweep),
    /// Pose and time, s.
    Odometry(Pose2, Option<f64>),
}

/// Iterator over the scans of a log.
pub struct CarmenReader<R> {
    input: R,
    line: u64,
    buffer: Vec<u8>,
    failed: bool,
    cut_off: Option<CarmenError>,
    survey: Survey,
    /// Whether all lines are read, to find out what the log says as a whole.
    is_survey: bool,
    /// Whether a sweep had a time.
    is_timed: bool,
    /// Kind, time and number of readings of the last sweep.
    last: Option<(Kind, Option<f64>, usize)>,
    /// Scans read.
    scans: u64,
}

/// Opens a log, compressed by gzip or not, and reads it as its [`survey()`] says, which [`CarmenReader::into_survey`] hands over.
///
/// # Errors
/// [`CarmenError::Io`].
pub fn open(path: &Path) -> Result<CarmenReader<Box<dyn BufRead>>, CarmenError> {
    Ok(CarmenReader {
        survey: survey(path)?,
        ..plain(path)?
    })
}

/// Finds out what a log says as a whole: where the poses are, which clock runs on, what a missing return reads like, and the field of view.
/// A mistake in a line ends the survey, and is told by the reader.
///
/// ```
/// // The laser's pose stands still; the odometry beside it does not.
/// let line = |i: u32| format!("FLASER 3 1 2 1 0 0 0 0.{i} 0 0 {i} host {i}\n");
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("drive.log");
/// std::fs::write(&path, (0..9).map(line).collect::<String>())?;
/// let survey = zenav_mapping::carmen::survey(&path)?;
/// assert!(survey.remarks()[0].starts_with("the laser's pose stands still while odometry moves"));
/// assert_eq!(survey.line(9), Some(9));
/// let last = zenav_mapping::carmen::open(&path)?.last().unwrap()?;
/// assert_eq!(last.odom_from_base.x, 0.8);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`CarmenError::Io`].
pub fn survey(path: &Path) -> Result<Survey, CarmenError> {
    survey::survey(plain(path)?, || plain(path))
}

/// Opens a log of which nothing else is known.
fn plain(path: &Path) -> Result<CarmenReader<Box<dyn BufRead>>, CarmenError> {
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
    /// Reads scans from plain text, each line by itself: the pose is the laser's, the time the robot's. Scans without a time are taken to
    /// be 0.1 s apart.
    ///
    /// ```
    /// use zenav_mapping::carmen::CarmenReader;
    ///
    /// let mut scans = CarmenReader::new("ODOM 0 0 0 0 0 0 0.1 host 0.1\nFLASER 2 1.0\n".as_bytes());
    /// let refused = scans.next().unwrap().unwrap_err();
    /// assert_eq!(refused.to_string(), "line 2: expected a reading, found the end of the line");
    /// assert!(scans.next().is_none(), "nothing is read after an error");
    /// ```
    pub fn new(input: R) -> Self {
        Self {
            input,
            line: 0,
            buffer: Vec::new(),
            failed: false,
            cut_off: None,
            survey: Survey::default(),
            is_survey: false,
            is_timed: false,
            last: None,
            scans: 0,
        }
    }

    /// What is wrong with the log's last line, if that was cut off, as by a recorder that was killed: it is not read. Known after the last
    /// scan.
    ///
    /// ```
    /// use zenav_mapping::carmen::CarmenReader;
    ///
    /// let mut scans = CarmenReader::new("FLASER 1 2.5 0 0 0 0 0 0 0.1 host 0.1\nFLASER 1 2.5 0 0".as_bytes());
    /// assert_eq!(scans.by_ref().count(), 1);
    /// assert_eq!(scans.cut_off().unwrap().to_string(), "line 2: expected theta, found the end of the line");
    /// ```
    pub const fn cut_off(&self) -> Option<&CarmenError> {
        self.cut_off.as_ref()
    }

    /// What the log as a whole says, by which its lines are read. Nothing but for a log that [`open`] opened.
    ///
    /// ```
    /// # let folder = tempfile::tempdir()?;
    /// # let path = folder.path().join("drive.log");
    /// std::fs::write(&path, "PARAM a b\nFLASER 1 2.5 0 0 0 0 0 0 0.1 host 0.1\n")?;
    /// let mut scans = zenav_mapping::carmen::open(&path)?;
    /// assert_eq!(scans.by_ref().count(), 1);
    /// assert_eq!(scans.into_survey().line(1), Some(2));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn into_survey(self) -> Survey {
        self.survey
    }

    const fn reads(&self, kind: Kind) -> bool {
        match kind {
            Kind::Front | Kind::Robot => true,
            Kind::Raw => self.is_survey || self.survey.reading.reads_raw,
            Kind::Odometry => self.is_survey,
        }
    }

    /// The next line that is read.
    fn next_line(&mut self) -> Result<Option<Line>, CarmenError> {
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
            // Editors put a byte order mark before the first line.
            let text = self.buffer.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&self.buffer);
            let text = text.trim_ascii_start();
            let Some(kind) = Kind::of(text).filter(|kind| self.reads(*kind)) else {
                continue;
            };
            let parsed = Words::of(&String::from_utf8_lossy(text)).line(kind);
            let is_timed = matches!(&parsed, Ok(Line::Sweep(sweep)) if sweep.times.0.is_some());
            let parsed = match parsed {
                Ok(Line::Sweep(_)) if self.is_timed && !is_timed => {
                    Err(with_hint("expected the time, found the end of the line"))
                }
                parsed => parsed,
            };
            let is_needed = kind != Kind::Odometry && (kind != Kind::Raw || self.survey.reading.reads_raw);
            self.is_timed |= is_timed && is_needed;
            match parsed.map_err(wrong) {
                // Of a log that can do without them.
                Err(_) if !is_needed => {}
                Err(error) if !self.buffer.ends_with(b"\n") => {
                    self.cut_off = Some(error);
                    return Ok(None);
                }
                parsed => return parsed.map(Some),
            }
        }
    }

    /// Whether a sweep was just read from a line of another kind: loggers write a sweep as several lines.
    fn is_repeated(&mut self, sweep: &Sweep) -> bool {
        let (kind, time, readings) = (sweep.kind, sweep.times.0, sweep.ranges.len());
        let before = self.last.replace((kind, time, readings));
        before.is_some_and(|before| before.0 != kind && time.is_some() && (before.1, before.2) == (time, readings))
    }

    fn next_scan(&mut self) -> Result<Option<Scan>, CarmenError> {
        while let Some(line) = self.next_line()? {
            let Line::Sweep(sweep) = line else { continue };
            if self.is_repeated(&sweep) {
                continue;
            }
            let scan = self.survey.reading.scan(sweep, self.line, self.scans);
            self.scans += 1;
            if !scan.is_sane() {
                return Err(CarmenError::Line {
                    line: self.line,
                    what: "expected a finite pose and a field of view of at most a full circle".to_owned(),
                });
            }
            return Ok(Some(scan));
        }
        Ok(None)
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

/// A mistake that a wrong number of readings leads to.
fn with_hint(mistake: &str) -> String {
    format!("{mistake}: is the number of readings right?")
}

struct Words<'t> {
    words: std::str::SplitAsciiWhitespace<'t>,
}

impl<'t> Words<'t> {
    fn of(line: &'t str) -> Self {
        Self {
            words: line.split_ascii_whitespace(),
        }
    }

    fn line(mut self, kind: Kind) -> Result<Line, String> {
        self.words.next();
        match kind {
            Kind::Front => self.front_laser().map(Line::Sweep),
            Kind::Robot | Kind::Raw => self.stated_laser(kind).map(Line::Sweep),
            Kind::Odometry => self.odometry(),
        }
    }

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

    /// A number, or infinity where some drivers write `inf`, `nan` or `-inf`.
    fn number_or_none(&mut self, what: &str) -> Result<f64, String> {
        let word = self.words.clone().next().unwrap_or_default();
        if word.parse().is_ok_and(|number: f64| !number.is_finite()) {
            self.words.next();
            return Ok(f64::INFINITY);
        }
        self.number(what)
    }

    fn count(&mut self, what: &str) -> Result<usize, String> {
        let number = self.number(what)?;
        if number.fract() == 0.0 && (0.0..=MAX_BEAMS as f64).contains(&number) {
            Ok(number as usize)
        } else {
            Err(format!("expected {what} up to {MAX_BEAMS}, found {number}"))
        }
    }

    /// Readings, m; infinite for a beam without a return.
    fn ranges(&mut self) -> Result<Vec<f32>, String> {
        let count = self.count("the number of readings")?;
        (0..count)
            .map(|_| Ok(self.number_or_none("a reading")? as f32))
            .collect()
    }

    fn pose(&mut self) -> Result<Pose2, String> {
        Ok(Pose2::new(self.number("x")?, self.number("y")?, self.number("theta")?))
    }

    /// Reads the time, if there is one, and that of the logger. Only the logging host stands between them; more words mean a wrong number of
    /// readings.
    fn times(&mut self) -> Result<(Option<f64>, Option<f64>), String> {
        let left = self.words.clone().count();
        if left == 0 {
            return Ok((None, None));
        }
        let time = self.number("the time").and_then(|time| match left {
            0..=3 => Ok(time),
            _ => Err(format!(
                "expected the host and its time at the end of the line, found {} words",
                left - 1
            )),
        });
        let time = time.map_err(|mistake| with_hint(&mistake))?;
        self.words.next();
        Ok((Some(time), self.number("the logger's time").ok()))
    }

    fn front_laser(mut self) -> Result<Sweep, String> {
        let ranges = self.ranges()?;
        Ok(Sweep {
            kind: Kind::Front,
            view: View::of_front(ranges.len()),
            range_max: None,
            ranges,
            poses: Some((self.pose()?, self.pose()?)),
            times: self.times()?,
        })
    }

    fn stated_laser(mut self, kind: Kind) -> Result<Sweep, String> {
        self.number("the laser's type")?;
        let start = self.number("the start angle")?;
        let field_of_view = self.number("the field of view")?;
        let resolution = self.number("the angular resolution")?;
        let range_max = self.number_or_none("the maximum range")?;
        self.number("the accuracy")?;
        self.number("the remission mode")?;
        let ranges = self.ranges()?;
        let poses = if kind == Kind::Robot {
            self.remissions(BEHIND_REMISSIONS.0)?;
            let poses = (self.pose()?, self.pose()?);
            for what in [
                "the forward speed",
                "the turning speed",
                "the forward safety distance",
                "the side safety distance",
                "the turn axis",
            ] {
                self.number_or_none(what)?;
            }
            Some(poses)
        } else {
            self.remissions(BEHIND_REMISSIONS.1)?;
            None
        };
        Ok(Sweep {
            kind,
            view: View::stated(start, field_of_view, resolution, ranges.len()),
            range_max: Some(range_max),
            ranges,
            poses,
            times: self.times()?,
        })
    }

    /// Passes over the remissions, with so many numbers behind them. Some logs state their number and leave them out.
    fn remissions(&mut self, behind: usize) -> Result<(), String> {
        let is_number = |word: &&str| word.parse::<f64>().is_ok();
        let numbers = self.words.clone().take_while(is_number).count();
        // The host tells where the numbers end.
        let is_whole = self.words.clone().nth(numbers).is_some();
        let count = self.count("the number of remissions")?;
        if !is_whole || numbers != behind + 1 {
            for _ in 0..count {
                self.number_or_none("a remission")?;
            }
        }
        Ok(())
    }

    /// `x y theta`, two speeds, an acceleration, and the time.
    fn odometry(mut self) -> Result<Line, String> {
        let pose = self.pose()?;
        Ok(Line::Odometry(pose, self.words.nth(3).and_then(finite)))
    }
}

/// A finite number.
fn finite(word: &str) -> Option<f64> {
    word.parse().ok().filter(|value: &f64| value.is_finite())
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
    let laser = scan.map_from_laser();
    let mut line = String::new();
    if View::is_half_circle(scan) {
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
mod tests;
