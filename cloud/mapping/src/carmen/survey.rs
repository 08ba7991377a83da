//! Survey. What a log as a whole says and no single line does: whose poses move, which clock runs on, what a missing return reads like.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::io::BufRead;

use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;

use super::view::{self, Turns, View};
use super::{CarmenError, CarmenReader, Kind, Line, NOTHING_SEEN, RANGE_MIN, Sweep};
use crate::no_return::Readings;

/// Sweeps without a time are this far apart, s.
const APART: f64 = 0.1;
/// A path, m and rad together, from which on something moves.
const MOVES: f64 = 0.1;
/// A pose that covers less than this share of another one's path stands still: at all, or for much of the log.
const STILL: (f64, f64) = (0.01, 0.75);
/// A laser is mounted at most this far from the robot's origin, m, this far to its side, m, and this far, rad, from looking straight ahead or back.
const REACH: f64 = 1.0;
const ASIDE: f64 = 0.3;
const ASKEW: f64 = 0.1;
/// A clock is of use if at most one time in this many has no place in the order of the others.
const LATE: usize = 20;
/// Scans of a log in which nothing moves that are worth a remark.
const MANY: usize = 20;
/// Most `ODOM` lines that are passed over to find those around a scan's time: a line may be logged late.
const AROUND: usize = 20;

/// How the lines of a log are read.
#[derive(Clone, Debug)]
pub(super) struct Reading {
    /// Readings from here on mean no return, m.
    pub(super) nothing_seen: f64,
    poses: Poses,
    clock: Clock,
    /// Whether `RAWLASER1` lines are read.
    pub(super) reads_raw: bool,
    /// Views that differ from what the lines say.
    views: BTreeMap<view::Layout, View>,
}

/// Where the pose of a scan is.
#[derive(Clone, Debug)]
enum Poses {
    /// In its line: that of the laser.
    Laser,
    /// In its line: the odometry, with the laser on the robot here.
    Robot(Pose2),
    /// In the `ODOM` lines.
    Odometry(Track),
}

/// Where the time of a scan is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Clock {
    /// In its line.
    Robot,
    /// At the end of its line.
    Logger,
    /// Nowhere: the scans are counted.
    Counted,
}

/// The `ODOM` lines of a log: number of the line, time, s, and pose.
#[derive(Clone, Debug, Default)]
struct Track(Vec<(u64, Option<f64>, Pose2)>);

impl Track {
    /// Way and turn between two lines, m and rad together.
    fn path(&self, from: u64, to: u64) -> f64 {
        let pairs = self.0.windows(2).filter(|pair| from <= pair[0].0 && pair[1].0 <= to);
        pairs.map(|pair| step(pair[0].2, pair[1].2)).sum()
    }

    /// The pose at a line and time, s: between the two lines around it that were measured before and after.
    fn at(&self, line: u64, time: Option<f64>) -> Option<Pose2> {
        let next = self.0.partition_point(|(number, ..)| *number < line);
        let first = next.saturating_sub(AROUND);
        let last = (next + AROUND).min(self.0.len());
        let around = self.0[first..last].windows(2).filter_map(|pair| {
            let ((from, Some(t0), a), (_, Some(t1), b), time) = (pair[0], pair[1], time?) else {
                return None;
            };
            let is_between = t0 <= time && time <= t1 && t0 < t1;
            is_between.then(|| (from.abs_diff(line), a.interpolate(&b, (time - t0) / (t1 - t0))))
        });
        let between = around.min_by_key(|(far, _)| *far).map(|(_, pose)| pose);
        let (_, _, nearest) = self.0.get(next.saturating_sub(1)).or_else(|| self.0.first())?;
        Some(between.unwrap_or(*nearest))
    }
}

impl Default for Reading {
    fn default() -> Self {
        Self {
            nothing_seen: NOTHING_SEEN,
            poses: Poses::Laser,
            clock: Clock::Robot,
            reads_raw: false,
            views: BTreeMap::new(),
        }
    }
}

impl Reading {
    /// The scan of a line, which is the `number`th, from 0.
    pub(super) fn scan(&self, sweep: Sweep, line: u64, number: u64) -> Scan {
        let (time, logged) = sweep.times;
        let time_by_clock = match self.clock {
            Clock::Robot => time,
            Clock::Logger => logged,
            Clock::Counted => None,
        };
        let pose = match (&self.poses, sweep.poses) {
            (Poses::Odometry(track), _) => track.at(line, time),
            (Poses::Laser, poses) => poses.map(|(laser, _)| laser),
            (Poses::Robot(mount), poses) => poses.map(|(_, robot)| robot * *mount),
        };
        let mut ranges = sweep.ranges;
        let range_max = match sweep.range_max {
            Some(stated) if stated > RANGE_MIN => {
                let range_max = stated.min(self.nothing_seen);
                // The maximum range itself means no return.
                for range in ranges.iter_mut().filter(|range| **range >= range_max as f32) {
                    *range = f32::INFINITY;
                }
                range_max
            }
            _ => self.nothing_seen,
        };
        let layout = (sweep.kind == Kind::Front, ranges.len());
        let view = self.views.get(&layout).copied().unwrap_or(sweep.view);
        if view.is_clockwise {
            ranges.reverse();
        }
        Scan {
            stamp: Stamp::from_secs(time_by_clock.unwrap_or(APART * number as f64)),
            angle_min: view.angle_min,
            angle_increment: view.angle_increment,
            range_min: RANGE_MIN,
            range_max,
            ranges,
            odom_from_base: pose.unwrap_or_default(),
            ..Scan::default()
        }
    }
}

/// What a log as a whole says about its lines.
///
/// Made by [`survey()`](super::survey()), and heeded by [`open()`](super::open()).
#[derive(Clone, Debug, Default)]
pub struct Survey {
    pub(super) reading: Reading,
    lines: Vec<u64>,
    remarks: Vec<String>,
}

impl Survey {
    /// What a user should know about the log: each where it is not read as its lines say, and why.
    #[must_use]
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// The line of a scan, both counted from 1.
    #[must_use]
    pub fn line(&self, scan: usize) -> Option<u64> {
        self.lines.get(scan.checked_sub(1)?).copied()
    }
}

/// Surveys a log; `again` opens it anew.
pub(super) fn survey<R: BufRead>(
    log: CarmenReader<R>,
    again: impl FnOnce() -> Result<CarmenReader<R>, CarmenError>,
) -> Result<Survey, CarmenError> {
    let mut reading = Reading::default();
    let mut remarks = Vec::new();
    let mut gathered = Gathered::of(log, &reading);
    let (poses, remark) = gathered.poses();
    remarks.extend(remark);
    if !matches!(poses, Poses::Laser) {
        (reading.poses, reading.reads_raw) = (poses, gathered.lines.is_empty());
        gathered = Gathered::of(again()?, &reading);
    }
    let (clock, remark) = gathered.clock();
    remarks.extend(remark);
    reading.clock = clock;
    reading.nothing_seen = gathered.readings.no_return().unwrap_or(NOTHING_SEEN);
    reading.views = gathered.turns.others();
    remarks.extend(reading.views.iter().map(|(layout, view)| told(*layout, view)));
    Ok(Survey {
        reading,
        lines: gathered.lines,
        remarks,
    })
}

/// A remark about a view.
fn told((is_front, readings): view::Layout, view: &View) -> String {
    let tag = if is_front { "FLASER" } else { "ROBOTLASER1" };
    let degrees = (readings.saturating_sub(1) as f64 * view.angle_increment).to_degrees();
    let way = if view.is_clockwise {
        ", clockwise: the laser is mounted upside down"
    } else {
        ""
    };
    format!("by the robot's turns, the {readings} readings of {tag} lines span {degrees:.0} degrees{way}")
}

/// A remark about a laser's pose that stands still, with the laser on the robot here.
fn told_still(mount: Pose2) -> String {
    let place = if mount == Pose2::IDENTITY {
        String::new()
    } else {
        let (x, y, degrees) = (mount.x, mount.y, mount.yaw.to_degrees());
        format!(
            ", with the laser on the robot at x {x:.2} m, y {y:.2} m, yaw {degrees:.0} degrees, where it stood at first"
        )
    };
    format!("the laser's pose stands still while odometry moves: odometry is taken for the laser's pose{place}")
}

/// Way and turn between two poses, m and rad together.
fn step(a: Pose2, b: Pose2) -> f64 {
    a.distance(&b) + wrap_angle(b.yaw - a.yaw).abs()
}

/// What the times of one clock say.
#[derive(Clone, Debug, Default)]
struct Times {
    /// Scans, and those with a time.
    scans: usize,
    given: usize,
    first: Option<f64>,
    newest: Option<f64>,
    /// Whether the times differ.
    runs: bool,
    /// For each length, the least time, s, that a sequence of so many times that do not go back ends with: patience sorting. A time far ahead
    /// costs the longest sequence one time, not all that follow.
    ends: Vec<f64>,
    /// The first time before an earlier scan's: its line, the newest time before, and it, s.
    first_late: Option<(u64, f64, f64)>,
}

impl Times {
    fn add(&mut self, line: u64, time: Option<f64>) {
        self.scans += 1;
        let Some(time) = time else { return };
        self.given += 1;
        self.runs |= *self.first.get_or_insert(time) != time;
        let newest = self.newest.unwrap_or(time);
        if time < newest {
            self.first_late.get_or_insert((line, newest, time));
        }
        self.newest = Some(newest.max(time));
        let length = self.ends.partition_point(|end| *end <= time);
        match self.ends.get_mut(length) {
            Some(end) => *end = time,
            None => self.ends.push(time),
        }
    }

    fn is_of_use(&self) -> bool {
        let late = self.given - self.ends.len();
        self.given == self.scans && (self.runs || self.scans < 2) && LATE * late <= self.scans
    }
}

/// What was found in a log.
struct Gathered {
    /// The line of each scan.
    lines: Vec<u64>,
    track: Track,
    /// Sweeps without a pose that were not read.
    raw: usize,
    /// Poses of the laser and of odometry at the first sweep and at the one before.
    first: Option<(Pose2, Pose2)>,
    before: Option<(Pose2, Pose2)>,
    /// Paths of the laser and of odometry, and that of odometry while the laser stood still, m and rad together.
    by_laser: f64,
    by_robot: f64,
    idle: f64,
    /// Times of the robot's and of the logger's clock.
    robot: Times,
    logger: Times,
    readings: Readings,
    turns: Turns,
}

impl Gathered {
    fn of<R: BufRead>(mut log: CarmenReader<R>, reading: &Reading) -> Self {
        let mut gathered = Self {
            lines: Vec::new(),
            track: Track::default(),
            raw: 0,
            first: None,
            before: None,
            by_laser: 0.0,
            by_robot: 0.0,
            idle: 0.0,
            robot: Times::default(),
            logger: Times::default(),
            readings: Readings::new(NOTHING_SEEN),
            turns: Turns::default(),
        };
        (log.is_survey, log.survey.reading.reads_raw) = (true, reading.reads_raw);
        // The pass that reads the scans tells what is wrong.
        while let Ok(Some(line)) = log.next_line() {
            match line {
                Line::Odometry(pose, time) => gathered.track.0.push((log.line, time, pose)),
                Line::Sweep(sweep) if sweep.poses.is_none() && !reading.reads_raw => gathered.raw += 1,
                Line::Sweep(sweep) if log.is_repeated(&sweep) => {}
                Line::Sweep(sweep) => gathered.add(sweep, log.line, reading),
            }
        }
        gathered
    }

    fn add(&mut self, sweep: Sweep, line: u64, reading: &Reading) {
        let (time, logged) = sweep.times;
        self.robot.add(line, time);
        self.logger.add(line, logged);
        self.first = self.first.or(sweep.poses);
        if let Some((laser, robot)) = sweep.poses
            && let Some(before) = self.before.replace((laser, robot))
        {
            let (by_laser, by_robot) = (step(before.0, laser), step(before.1, robot));
            self.by_laser += by_laser;
            self.by_robot += by_robot;
            self.idle += if by_laser == 0.0 { by_robot } else { 0.0 };
        }
        let (layout, view) = ((sweep.kind == Kind::Front, sweep.ranges.len()), sweep.view);
        let scan = reading.scan(sweep, line, self.lines.len() as u64);
        self.lines.push(line);
        if scan.is_sane() {
            self.readings.add(scan.map_from_laser().position(), &scan.ranges);
            self.turns.add(layout, view, &scan);
        }
    }

    /// The laser on the robot, by the first sweep: a pose that stands still is still right there. One that was never set, or at which no laser is
    /// mounted, says nothing: a localiser may have set it once.
    fn mount(&self) -> Pose2 {
        let mount = self.first.filter(|(laser, _)| *laser != Pose2::IDENTITY);
        let mount = mount.map(|(laser, robot)| robot.inverse() * laser);
        let is_mount = |mount: &Pose2| {
            let yaw = wrap_angle(mount.yaw).abs();
            mount.x.hypot(mount.y) < REACH && mount.y.abs() < ASIDE && yaw.min(PI - yaw) < ASKEW
        };
        mount.filter(is_mount).unwrap_or_default()
    }

    /// Where the poses are, and a remark if that is not in the line, or nowhere. Takes the `ODOM` lines.
    fn poses(&mut self) -> (Poses, Option<String>) {
        let track = std::mem::take(&mut self.track);
        let ends = self.lines.first().zip(self.lines.last());
        let path = ends.map_or(0.0, |(first, last)| track.path(*first, *last));
        let in_lines = self.by_laser.max(self.by_robot);
        if self.lines.is_empty() && self.raw > 0 && !track.0.is_empty() {
            let remark = "RAWLASER1 lines have no pose: that of the ODOM lines is taken for the laser's";
            (Poses::Odometry(track), Some(remark.to_owned()))
        } else if self.by_robot > MOVES && 2.0 * self.idle > self.by_robot && self.by_laser < STILL.1 * self.by_robot {
            let mount = self.mount();
            (Poses::Robot(mount), Some(told_still(mount)))
        } else if path > MOVES && in_lines < STILL.0 * path {
            let remark = "the poses of the scans stand still: those of the ODOM lines are taken for the laser's";
            (Poses::Odometry(track), Some(remark.to_owned()))
        } else {
            let is_still = self.lines.len() >= MANY && in_lines < MOVES;
            (Poses::Laser, is_still.then(|| "no pose in the log moves".to_owned()))
        }
    }

    /// Which clock runs on, and a remark if it is another than the robot's.
    fn clock(&self) -> (Clock, Option<String>) {
        let Times {
            given,
            first,
            runs,
            first_late,
            ..
        } = self.robot;
        if self.lines.is_empty() || self.robot.is_of_use() {
            return (Clock::Robot, None);
        }
        let what = match (first, first_late) {
            (Some(_), Some((line, newest, late))) => {
                format!("line {line}: the time goes back from {newest} s to {late} s")
            }
            (Some(first), None) if given == self.lines.len() => format!("all scans have the time {first} s"),
            _ => "the scans have no times".to_owned(),
        };
        if self.logger.is_of_use() && self.logger.runs {
            (
                Clock::Logger,
                Some(format!("{what}: the logger's times at the ends of the lines are taken")),
            )
        } else if given < self.lines.len() || !runs {
            (
                Clock::Counted,
                Some(format!("{what}: they are taken to be {APART} s apart")),
            )
        } else {
            // The order of the scans is decided where it matters.
            (Clock::Robot, None)
        }
    }
}
