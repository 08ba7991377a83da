//! Obstacle tracks. Which moving obstacles are around the robot, where are they going, and how sure is that?
//!
//! Each scan is cut into segments of neighbouring returns. A segment that holds points which evidently moved
//! ([`crate::moving_obstacles`]) begins a track; one that lies where a track is expected continues it. A track is a disc with a position
//! and a velocity, estimated by a Kalman filter with a constant-velocity model (white acceleration on each axis; Bar-Shalom, Li,
//! Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 6.2). A track that is hidden goes on by its
//! prediction for a while; one whose place is seen to be empty ends. What is too slow for that evidence is watched for longer
//! (`slow_movers`). A robot that tells its course ([`crate::other_robots`]) is a track by its own word.

use std::f64::consts::PI;

use nalgebra::{Point2, Rotation2, Vector2};
use zenav_protocol::time::Stamp;

use crate::course::{Course, PredictedPath};
use crate::field_of_view::ProjectedScan;
use crate::settings::TrackingSettings;
use crate::slow_movers::{Round, SlowMover, SlowMovers};

/// Most tracks kept.
const MAX_TRACKS: usize = 64;
/// Variance of a new track's velocity, (m/s)².
const START_VELOCITY_VARIANCE: f64 = 1.0;
/// Scans in which a track must evidently have moved before its velocity counts.
const LEAST_EVIDENCE: u32 = 3;
/// Scans after which the filter has settled.
const SETTLED: u32 = 6;
/// And how far it must have come, m: what only appears, as from behind a corner, stands.
const LEAST_TRAVEL: f64 = 0.12;
/// The greatest speed of late is forgotten this fast, m/s².
const SLOWS_DOWN: f64 = 0.1;
/// Two obstacles this near to one another may be taken for one, m.
const MAY_BE_ONE: f64 = 0.6;
/// Scans in which its place was seen to be empty, after which a track ends.
const MOST_MISSES: u32 = 3;
/// Neighbouring returns belong together up to this distance, m, and this many times their spacing.
const GAP: (f64, f64) = (0.12, 3.0);
/// A point this near to a track's disc belongs to it, m.
const ON_TRACK: f64 = 0.2;
/// Radius of a tracked disc, m, and of one of which only a part has ever been seen, at least.
const RADII: (f64, f64) = (0.05, 0.6);
const HALF_SEEN: f64 = 0.2;
/// The ends of something round are farther away than its middle by this share of its radius, at least.
const BULGE: f64 = 0.4;

/// A point this near to a robot's disc belongs to it, and the center of what looks like a thing of its own, m: the robot may be a little
/// beside the place that it told.
const ON_ROBOT: (f64, f64) = (0.1, 0.3);
/// A robot is seen where it says if this many returns lie within its disc.
const IN_PLACE: usize = 3;

/// A moving obstacle: a disc that goes on at constant velocity, or as it has told.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Its number, never given twice.
    pub id: u64,
    /// Center, odometry frame, m.
    pub position: Point2<f64>,
    /// Velocity over the floor, odometry frame, m/s.
    pub velocity: Vector2<f64>,
    /// Variance of the position on each axis, m²; covariance of position and velocity, m²/s; variance of the velocity, (m/s)².
    pub variance: [f64; 3],
    /// Radius of the disc, m.
    pub radius: f64,
    /// Whether it was ever seen whole: before that its radius is a guess.
    seen_whole: bool,
    /// When it was seen first.
    pub born: Stamp,
    /// Stamp of the scan that saw it last.
    pub seen: Stamp,
    /// The time that position and velocity are for: when the beams met it.
    pub stamp: Stamp,
    /// Where it was seen first, odometry frame, and whether it has clearly moved since.
    origin: Point2<f64>,
    moved: bool,
    /// The greatest speed of late, m/s.
    most_speed: f64,
    /// Scans that it was seen in, and in how many of them it evidently moved.
    hits: u32,
    evidence: u32,
    /// Scans in a row that saw its place empty.
    misses: u32,
    /// Since when it has been slower than anything that moves.
    still_since: Option<Stamp>,
    /// Of a robot that tells it.
    course: Option<Course>,
}

impl Track {
    /// A robot that tells its course.
    #[must_use]
    pub fn of_robot(id: u64, radius: f64, velocity: Vector2<f64>, stamp: Stamp, course: Course) -> Self {
        let position = course.at(0.0);
        Self {
            id,
            position,
            velocity,
            variance: [0.0; 3],
            radius,
            seen_whole: true,
            born: stamp,
            seen: stamp,
            stamp,
            origin: position,
            moved: true,
            most_speed: 0.0,
            hits: SETTLED,
            evidence: LEAST_EVIDENCE,
            misses: 0,
            still_since: None,
            course: Some(course),
        }
    }

    /// Its radius as far as that was seen, m.
    #[must_use]
    pub(crate) fn sure_radius(&self) -> f64 {
        if self.seen_whole { self.radius } else { 0.0 }
    }

    /// Whether it is a robot that tells its course.
    #[must_use]
    pub fn is_robot(&self) -> bool {
        self.course.is_some()
    }

    /// Whether it is a robot that makes way for this one.
    #[must_use]
    pub fn makes_way(&self) -> bool {
        self.course.as_ref().is_some_and(|course| course.makes_way)
    }

    /// Whether it drives by a plan, and has right of way over this robot.
    pub(crate) fn goes_first(&self) -> bool {
        self.course
            .as_ref()
            .is_some_and(|course| course.planned && !course.makes_way)
    }

    /// Where it says that it will be, and when, s after its stamp; nothing where it tells no course.
    pub(crate) fn told_course(&self) -> Vec<(f64, Point2<f64>)> {
        self.course.as_ref().map(Course::timed).unwrap_or_default()
    }

    fn new(id: u64, seen: &Segment, scan: &ProjectedScan<'_>, settings: &TrackingSettings) -> Self {
        let (laser, stamp) = (scan.laser(), scan.stamp);
        let radius = if seen.is_cut() {
            seen.radius.max(HALF_SEEN)
        } else {
            seen.radius
        };
        let center = seen.center_of(radius, laser);
        Self {
            id,
            position: center,
            velocity: Vector2::zeros(),
            variance: [settings.position_noise.powi(2), 0.0, START_VELOCITY_VARIANCE],
            radius,
            seen_whole: !seen.is_cut(),
            born: stamp,
            seen: stamp,
            stamp: scan.met(0.5 * (seen.beams.0 + seen.beams.1) as f64),
            origin: center,
            moved: false,
            most_speed: 0.0,
            hits: 1,
            evidence: 1,
            misses: 0,
            still_since: None,
            course: None,
        }
    }

    /// Whether it has clearly moved, and been seen often enough to have a velocity.
    #[must_use]
    pub fn is_confirmed(&self) -> bool {
        self.moved && self.evidence >= LEAST_EVIDENCE
    }

    /// As fast as it may be: the greatest of late of its speed and a standard deviation of it, m/s. Who turns round is slow for a moment.
    #[must_use]
    pub fn most_speed(&self) -> f64 {
        self.most_speed.max(self.speed_bound())
    }

    fn speed_bound(&self) -> f64 {
        self.velocity.norm() + self.variance[2].max(0.0).sqrt()
    }

    /// Standard deviation of its position on an axis `secs` after its stamp, m.
    #[must_use]
    pub fn position_std(&self, secs: f64) -> f64 {
        let [position, mixed, velocity] = self.variance;
        (position + 2.0 * secs * mixed + secs * secs * velocity).max(0.0).sqrt()
    }

    /// Center `secs` after its stamp, odometry frame.
    #[must_use]
    pub fn at(&self, secs: f64) -> Point2<f64> {
        match &self.course {
            Some(course) => course.at(secs),
            None => self.position + self.velocity * secs,
        }
    }

    /// The path that it takes from `secs` after its stamp for another `lead` s, odometry frame.
    #[must_use]
    pub fn path(&self, secs: f64, lead: f64) -> PredictedPath {
        let (first, last) = (self.at(secs), self.at(secs + lead));
        if self.course.is_none() {
            return PredictedPath::straight(first, last);
        }
        let third = lead / 3.0;
        PredictedPath::bent([first, self.at(secs + third), self.at(secs + 2.0 * third), last])
    }

    /// The same with the velocity that it was seen to have.
    fn creeping(self, seen: &SlowMover) -> Self {
        Self {
            velocity: seen.velocity,
            // Of two places, each as uncertain as this one.
            variance: [self.variance[0], 0.0, 2.0 * self.variance[0] / seen.secs.powi(2)],
            moved: true,
            most_speed: seen.velocity.norm(),
            hits: SETTLED,
            evidence: LEAST_EVIDENCE,
            ..self
        }
    }

    /// Goes on to a time.
    fn predict(&mut self, stamp: Stamp, acceleration: f64) {
        let dt = stamp.secs_since(self.stamp).max(0.0);
        let [position, mixed, velocity] = self.variance;
        let q = acceleration * acceleration;
        self.position += self.velocity * dt;
        self.variance = [
            position + 2.0 * dt * mixed + dt * dt * velocity + 0.25 * q * dt.powi(4),
            mixed + dt * velocity + 0.5 * q * dt.powi(3),
            velocity + q * dt * dt,
        ];
        self.stamp = self.stamp.max(stamp);
        self.most_speed = (self.most_speed - SLOWS_DOWN * dt).max(0.0);
    }

    /// Takes in how a scan shows it.
    fn update(&mut self, seen: &Segment, scan: &ProjectedScan<'_>, settings: &TrackingSettings) {
        let [position, mixed, velocity] = self.variance;
        let gain = Vector2::new(position, mixed) / (position + settings.position_noise.powi(2));
        let off = seen.center_of(self.radius, scan.laser()) - self.position;
        self.position += off * gain.x;
        self.velocity += off * gain.y;
        self.variance = [
            (1.0 - gain.x) * position,
            (1.0 - gain.x) * mixed,
            velocity - gain.y * mixed,
        ];
        // What is half hidden looks smaller than it is.
        let share = match seen.radius > self.radius {
            true => 0.5,
            false if seen.is_cut() => 0.0,
            false => 0.05,
        };
        self.radius += share * (seen.radius - self.radius);
        self.seen_whole |= !seen.is_cut();
        self.seen = scan.stamp;
        self.hits += 1;
        self.evidence += u32::from(seen.is_moving());
        self.misses = 0;
        if self.hits >= SETTLED {
            self.most_speed = self.most_speed.max(self.speed_bound());
        }
        self.moved |= (self.position - self.origin).norm() > LEAST_TRAVEL;
        let moves = self.velocity.norm() > settings.least_speed;
        self.still_since = if moves {
            None
        } else {
            self.still_since.or(Some(self.stamp))
        };
    }
}

/// Neighbouring returns that look like one thing.
#[derive(Clone, Copy, Debug)]
struct Segment {
    /// Center of the disc that would look so, odometry frame.
    center: Point2<f64>,
    /// Its radius, m.
    radius: f64,
    /// Its first and its last beam.
    beams: (usize, usize),
    /// Its ends at these beams.
    ends: [End; 2],
    /// How many of its returns evidently moved.
    moved: usize,
}

/// One end of a segment.
#[derive(Clone, Copy, Debug)]
struct End {
    /// Where it was seen from the lidar, odometry frame, m.
    off: Vector2<f64>,
    /// Whether the view ends there, or something nearer hides what may be beside it.
    is_cut: bool,
}

impl Segment {
    /// Whether a part of it is hidden.
    fn is_cut(&self) -> bool {
        self.ends.iter().any(|end| end.is_cut)
    }

    /// Center of the disc of a radius (m) that would look so from a place: where one side of it is hidden the other one tells.
    fn center_of(&self, radius: f64, laser: Point2<f64>) -> Point2<f64> {
        let [first, last] = &self.ends;
        let (end, side) = match (first.is_cut, last.is_cut) {
            (true, false) => (last, -1.0),
            (false, true) => (first, 1.0),
            _ => return self.center,
        };
        if radius <= self.radius {
            return self.center;
        }
        // The end lies where the line of sight touches the disc.
        let distance = end.off.norm().hypot(radius);
        let turn = Rotation2::new(side * (radius / distance).asin());
        laser + turn * end.off.normalize() * distance
    }

    /// Whether most of it evidently moved; a few returns alone may be noise.
    fn is_moving(&self) -> bool {
        self.moved >= 2 && 2 * self.moved > self.beams.1 - self.beams.0
    }

    /// What it is if it is whole and bulges towards the lidar.
    fn round(&self, laser: Point2<f64>) -> Option<Round> {
        let Self { center, radius, .. } = *self;
        let nearest = (center - laser).norm() - radius;
        let bulges = self.ends.iter().all(|end| end.off.norm() >= nearest + BULGE * radius);
        (bulges && !self.is_cut() && radius <= RADII.1).then_some(Round { center, radius })
    }
}

/// All tracks of a robot.
#[derive(Clone, Debug, Default)]
pub struct ObstacleTracks {
    settings: TrackingSettings,
    tracks: Vec<Track>,
    segments: Vec<Segment>,
    /// For each segment whether a track has taken it.
    taken: Vec<bool>,
    slow: SlowMovers,
    /// Robots that tell their course.
    robots: Vec<Track>,
    next_id: u64,
}

impl ObstacleTracks {
    /// None yet.
    #[must_use]
    pub fn new(settings: &TrackingSettings) -> Self {
        Self {
            settings: settings.clone(),
            ..Self::default()
        }
    }

    /// Takes the robots that tell their course.
    pub(crate) fn set_robots(&mut self, robots: impl Iterator<Item = Track>) {
        self.robots.clear();
        self.robots.extend(robots);
        let robots = &self.robots;
        self.tracks
            .retain(|track| on_robot(robots, track.position, ON_ROBOT.0).is_none());
    }

    /// The robots that tell their course.
    #[must_use]
    pub fn robots(&self) -> &[Track] {
        &self.robots
    }

    /// The robot that a point (odometry frame) belongs to.
    #[must_use]
    pub fn robot_at(&self, point: Point2<f64>) -> Option<&Track> {
        on_robot(&self.robots, point, ON_ROBOT.0)
    }

    /// Whether what evidently moves at a point (odometry frame) is one of the robots, or its shadow: not somebody beside it.
    #[must_use]
    pub(crate) fn is_by_robot(&self, point: Point2<f64>) -> bool {
        let on = |track: &Track| track.is_confirmed() && (point - track.position).norm() <= track.radius + ON_ROBOT.0;
        let is_beside = || self.robot_at(point).is_none() && self.tracks.iter().any(on);
        on_robot(&self.robots, point, ON_ROBOT.1).is_some() && !is_beside()
    }

    /// Takes a scan; `moved` says of each beam whether its return evidently moved.
    pub(crate) fn insert(&mut self, scan: &ProjectedScan<'_>, moved: &[bool]) {
        self.cut(scan, moved);
        for track in &mut self.tracks {
            let beam = scan.beam_to(track.position).map_or(0, |(beam, _)| beam);
            track.predict(scan.met(beam as f64), self.settings.acceleration);
        }
        self.associate(scan);
        let laser = scan.laser();
        let left = self.segments.iter().zip(&self.taken).enumerate();
        let left = left.filter(|(_, (segment, taken))| !**taken && !segment.is_moving());
        let round = left.filter_map(|(index, (segment, _))| Some((index, segment.round(laser)?)));
        let slow = self.slow.insert(scan, round);
        let begin = |segment: &Segment, id: u64| Track::new(id, segment, scan, &self.settings);
        for (index, (segment, taken)) in self.segments.iter().zip(&self.taken).enumerate() {
            let slow = slow.iter().find(|slow| slow.index == index);
            let track = match slow {
                _ if *taken => continue,
                Some(slow) => begin(segment, self.next_id).creeping(slow),
                None if segment.is_moving() => begin(segment, self.next_id),
                None => continue,
            };
            if self.tracks.len() < MAX_TRACKS {
                self.tracks.push(track);
                self.next_id += 1;
            }
        }
    }

    /// Cuts a scan into segments that may be a moving obstacle.
    fn cut(&mut self, scan: &ProjectedScan<'_>, moved: &[bool]) {
        self.segments.clear();
        let (laser, spacing) = (scan.laser(), scan.lidar.angle_increment());
        let mut run: Option<(usize, usize)> = None;
        let mut last: Option<(usize, f64)> = None;
        let mut open = 0;
        for (beam, range) in scan.ranges.iter().enumerate() {
            let range = f64::from(*range);
            if !scan.is_return(range) || range > self.settings.range {
                // A lost beam does not part what belongs together; one that is known to be lost has no range.
                open += usize::from(range > 0.0);
                if last.is_some() && open > 2 {
                    self.segments
                        .extend(run.take().and_then(|run| segment(scan, moved, run, laser)));
                    last = None;
                }
                continue;
            }
            open = 0;
            let apart = last.map_or(1, |(at, _)| beam - at) as f64;
            let gap = GAP.0.max(GAP.1 * apart * spacing * range);
            if last.is_some_and(|(_, before)| (range - before).abs() > gap) {
                self.segments
                    .extend(run.take().and_then(|run| segment(scan, moved, run, laser)));
            }
            run = Some((run.map_or(beam, |(first, _)| first), beam));
            last = Some((beam, range));
        }
        self.segments
            .extend(run.and_then(|run| segment(scan, moved, run, laser)));
        let widest = self.settings.widest;
        self.segments.retain(|segment| 2.0 * segment.radius <= widest);
        self.taken.clear();
        let robots = &self.robots;
        let segments = self.segments.iter();
        self.taken
            .extend(segments.map(|segment| is_robot(robots, segment, scan)));
    }

    /// Gives each track the segment nearest to where it is expected, nearest pairs first; ends those whose place is empty.
    fn associate(&mut self, scan: &ProjectedScan<'_>) {
        let (settings, laser) = (&self.settings, scan.laser());
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (of, track) in self.tracks.iter().enumerate() {
            let gate = settings.gate + 2.0 * track.position_std(0.0).min(1.0);
            for (to, segment) in self.segments.iter().enumerate() {
                let off = (segment.center_of(track.radius, laser) - track.position).norm();
                if off <= gate {
                    // Rather with what moves than with what stands there, too.
                    let still = if segment.moved > 0 { 0.0 } else { settings.gate };
                    pairs.push((off + still, of, to));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut matched = vec![false; self.tracks.len()];
        for (_, of, to) in pairs {
            let (Some(track), Some(segment)) = (self.tracks.get_mut(of), self.segments.get(to)) else {
                continue;
            };
            let (Some(matched), Some(taken)) = (matched.get_mut(of), self.taken.get_mut(to)) else {
                continue;
            };
            if !*matched && !*taken {
                track.update(segment, scan, settings);
                (*matched, *taken) = (true, true);
            }
        }
        let mut nth = 0;
        self.tracks.retain_mut(|track| {
            let matched = matched.get(nth).copied().unwrap_or(false);
            nth += 1;
            if !matched && is_seen_empty(scan, track) {
                track.misses += 1;
            }
            let still = track.still_since.map_or(0.0, |since| track.stamp.secs_since(since));
            let hidden = scan.stamp.secs_since(track.seen);
            let memory = if track.is_confirmed() { settings.memory } else { 0.3 };
            track.misses < MOST_MISSES && still <= settings.standing && hidden <= memory
        });
    }

    /// The tracks whose velocity is known, and the robots that tell their course.
    pub fn iter(&self) -> impl Iterator<Item = &Track> + '_ {
        let confirmed = self.tracks.iter().filter(|track| track.is_confirmed());
        confirmed.chain(&self.robots)
    }

    /// As fast as what is seen at a point (odometry frame) may be, if it is on a track, m/s: as the fastest track near it.
    #[must_use]
    pub fn most_speed_at(&self, point: Point2<f64>) -> Option<f64> {
        self.at(point)?;
        let near = |track: &&Track| (point - track.position).norm() <= track.radius + MAY_BE_ONE;
        self.tracks.iter().filter(near).map(Track::most_speed).reduce(f64::max)
    }

    /// The track that a point (odometry frame) belongs to.
    #[must_use]
    pub fn at(&self, point: Point2<f64>) -> Option<&Track> {
        let off = |track: &Track| (point - track.position).norm() - track.radius;
        let tracks = self.tracks.iter().filter(|track| track.is_confirmed());
        let nearest = tracks
            .map(|track| (off(track), track))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let nearest = nearest.filter(|(off, _)| *off <= ON_TRACK).map(|(_, track)| track);
        nearest.or_else(|| self.robot_at(point))
    }

    /// The confirmed tracks in the scan of this time.
    pub(crate) fn seen(&self, now: Stamp) -> impl Iterator<Item = &Track> + '_ {
        let seen = self.tracks.iter().filter(move |track| track.seen == now);
        seen.filter(|track| track.is_confirmed())
    }
}

/// Whether a segment is one of the robots: it lies by its disc. But if that robot is seen where it says, something round beside it, none of
/// whose returns lie on the disc, is somebody else.
fn is_robot(robots: &[Track], segment: &Segment, scan: &ProjectedScan<'_>) -> bool {
    let all = (0, scan.ranges.len());
    let is_beside = |robot: &Track| {
        segment.round(scan.laser()).is_some()
            && returns_on(robot, scan, segment.beams, ON_ROBOT.0) == 0
            && returns_on(robot, scan, all, 0.0) >= IN_PLACE
    };
    let by = |robot: &&Track| (segment.center - robot.position).norm() <= robot.radius + ON_ROBOT.1;
    robots.iter().filter(by).any(|robot| !is_beside(robot))
}

/// How many returns of these beams, from the first to the last, lie on a robot's disc.
fn returns_on(robot: &Track, scan: &ProjectedScan<'_>, (first, last): (usize, usize), slack: f64) -> usize {
    let laser = scan.laser();
    let beams = scan.ranges.iter().zip(scan.rays).take(last + 1).skip(first);
    let is_on = |(range, ray): &(&f32, &Vector2<f64>)| {
        let range = f64::from(**range);
        scan.is_return(range) && (laser + *ray * range - robot.position).norm() <= robot.radius + slack
    };
    beams.filter(is_on).count()
}

/// The robot whose disc a point lies on.
fn on_robot(robots: &[Track], point: Point2<f64>, slack: f64) -> Option<&Track> {
    let on = |robot: &&Track| (point - robot.position).norm() <= robot.radius + slack;
    robots.iter().find(on)
}

/// The disc that a run of returns looks like; `None` for a single return, and for what encloses the robot.
fn segment(scan: &ProjectedScan<'_>, moved: &[bool], beams: (usize, usize), laser: Point2<f64>) -> Option<Segment> {
    let (first, last) = beams;
    if (last - first) as f64 * scan.lidar.angle_increment() >= PI {
        // The ends of what stands around the robot enclose the rest of the circle.
        return None;
    }
    let ranges = scan.ranges.get(first..=last)?;
    let nearest = ranges
        .iter()
        .map(|range| f64::from(*range))
        .filter(|range| scan.is_return(*range))
        .fold(f64::INFINITY, f64::min);
    let (from, to) = (scan.rays.get(first)?, scan.rays.get(last)?);
    let moved = moved.get(first..=last)?.iter().filter(|moved| **moved).count();
    if last == first {
        return None;
    }
    let toward = (from + to).try_normalize(1e-6)?;
    // The tangents to a disc of radius R in distance d + R enclose twice the angle asin(R / (d + R)).
    let half = 0.5 * from.angle(to) + 0.5 * scan.lidar.angle_increment();
    let sine = half.sin().min(0.9);
    let radius = (nearest * sine / (1.0 - sine)).clamp(RADII.0, f64::INFINITY);
    let depth = radius.min(RADII.1);
    let end = |beam: usize, beside: Option<usize>| {
        let range = f64::from(*scan.ranges.get(beam)?);
        let is_nearer = |beside: &f32| scan.is_return(f64::from(*beside)) && f64::from(*beside) < range - GAP.0;
        Some(End {
            off: scan.rays.get(beam)? * range,
            is_cut: beside.and_then(|beam| scan.ranges.get(beam)).is_none_or(is_nearer),
        })
    };
    let ends = [end(first, first.checked_sub(1))?, end(last, Some(last + 1))?];
    Some(Segment {
        center: laser + toward * (nearest + depth),
        radius,
        beams,
        ends,
        moved,
    })
}

/// Whether the beams through a track's place go on behind it.
fn is_seen_empty(scan: &ProjectedScan<'_>, track: &Track) -> bool {
    scan.beam_to(track.position).is_some_and(|(beam, range)| {
        let half = ((track.radius / range.max(0.1)) / scan.lidar.angle_increment()) as usize;
        scan.reaches(beam, half, range + track.radius)
    })
}

#[cfg(test)]
pub(crate) mod tests;
