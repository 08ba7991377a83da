//! Motion detector. Which returns of one lidar's scans evidently belong to something that moves?

use std::collections::VecDeque;
use std::f64::consts::TAU;

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::robot::LidarModel;
use zenav_protocol::time::Stamp;

use crate::field_of_view::ProjectedScan;
use crate::range_noise::RangeNoise;
use crate::recent_places::{RecentPlace, RecentPlaces};
use crate::scan_reprojection::ScanReprojection;
use crate::settings::{EdgeSettings, MovingObstacleSettings};

/// Beams through neighbouring points are at most this far apart, in beams.
const APART: usize = 8;
/// Most places kept where something moved.
const MOVED_PLACES: usize = 48;

/// Finds what moves in the scans of one lidar.
#[derive(Clone, Debug)]
pub(super) struct Detector {
    lidar: LidarModel,
    reprojection: ScanReprojection,
    noise: RangeNoise,
    settings: MovingObstacleSettings,
    /// Assumed speed of moving obstacles, m/s.
    fastest: f64,
    /// Up to which range each beam of the newest scan saw free space, m.
    free: Vec<f32>,
    references: VecDeque<ReferenceScan>,
    /// Where the lidar was at the newest scan.
    odom_from_laser: Isometry2<f64>,
    /// Points of moving obstacles in the newest scan, odometry frame.
    pub(super) points: Vec<Point2<f64>>,
    /// The beams that evidently met something that moves.
    pub(super) moved_beams: Vec<bool>,
    /// Beams beyond this range tell nothing about motion, m.
    range: f64,
    /// Returns that others pass through even if they are farther away than they were measured.
    passed: Vec<bool>,
    /// Beams of the newest scan whose return lies just behind a departed one.
    departed: Vec<bool>,
    /// Beams of the newest scan whose return lies where a reference scan saw free space.
    appeared: Vec<bool>,
    /// Places where something moved recently.
    pub(super) moved: RecentPlaces,
}

/// An earlier scan that new ones are compared with.
#[derive(Clone, Debug)]
struct ReferenceScan {
    stamp: Stamp,
    odom_from_laser: Isometry2<f64>,
    ranges: Vec<f32>,
    /// Up to which range each beam saw free space, m.
    free: Vec<f32>,
}

/// A run of neighbouring returns of a reference scan that beams pass through now.
#[derive(Clone, Copy, Debug)]
struct DepartedRun {
    /// The first and the last return, in the lidar frame now.
    ends: [Point2<f64>; 2],
    /// The first and the last beam through them.
    beams: (usize, usize),
    /// Range of the farthest return, m.
    depth: f64,
}

impl Detector {
    pub(super) fn new(lidar: &LidarModel, settings: &EdgeSettings, fastest: f64) -> Self {
        Self {
            lidar: lidar.clone(),
            reprojection: ScanReprojection::new(lidar, settings.scan_reprojection),
            noise: RangeNoise::new(lidar.noise),
            settings: settings.moving_obstacles.clone(),
            fastest,
            free: Vec::new(),
            references: VecDeque::new(),
            odom_from_laser: Isometry2::identity(),
            points: Vec::new(),
            moved_beams: Vec::new(),
            range: settings.moving_obstacles.range.max(settings.tracking.range),
            passed: Vec::new(),
            departed: Vec::new(),
            appeared: Vec::new(),
            moved: RecentPlaces::new(MOVED_PLACES, settings.moving_obstacles.place_spacing),
        }
    }

    /// Least width of a moving obstacle at a range, m.
    fn least_width(&self, range: f64) -> f64 {
        let spacing = self.lidar.angle_increment() * range;
        self.settings.least_width.max(self.settings.least_beams * spacing)
    }

    /// Takes a scan; returns how many of the points found in it moved by themselves, not only near to something that moves.
    pub(super) fn insert(&mut self, scan: &ProjectedScan<'_>) -> usize {
        self.points.clear();
        self.odom_from_laser = scan.odom_from_laser;
        let near = self.lidar.range_min..=self.settings.range.min(self.lidar.range_max);
        let noise = self.noise.update(scan.ranges, |range| near.contains(&range));
        self.reprojection.set_noise(noise);
        self.reprojection.free_ranges(scan.ranges, &mut self.free);
        self.find_departed(scan);
        self.find_appeared(scan);
        self.moved
            .retain(|place| scan.stamp.secs_since(place.stamp) <= self.settings.turning_secs);
        let laser = scan.laser();
        let (low, high) = self.moved.bounds(self.settings.turning_distance);
        let (mut begun, mut still) = (0, Vec::new());
        self.moved_beams.clear();
        self.moved_beams.resize(scan.ranges.len(), false);
        for (beam, (range, ray)) in scan.ranges.iter().zip(scan.rays).enumerate() {
            let range = f64::from(*range);
            if !self.is_near(range) {
                self.end_run(&mut begun, laser, beam);
                continue;
            }
            let point = laser + ray * range;
            let is_one = |marked: &[bool]| marked.get(beam).is_some_and(|marked| *marked);
            if is_one(&self.departed) || is_one(&self.appeared) {
                self.points.push(point);
                continue;
            }
            self.end_run(&mut begun, laser, beam);
            if point >= low && point <= high && self.moved.any_within(self.settings.turning_distance, point) {
                still.push(point);
            }
        }
        self.end_run(&mut begun, laser, scan.ranges.len());
        let range = self.settings.range;
        self.points.retain(|point| (point - laser).norm() <= range);
        thin(&mut self.points, self.settings.spacing);
        let evident = self.points.len();
        thin(&mut still, self.settings.spacing);
        self.points.append(&mut still);
        self.keep_reference(scan);
        evident
    }

    /// How long before the stamp of the newest scan a beam met a point (odometry frame), s.
    pub(super) fn met_before(&self, point: Point2<f64>) -> f64 {
        if self.lidar.sweep_time == 0.0 {
            return 0.0;
        }
        let off = self.odom_from_laser.inverse() * point;
        let angle = (off.y.atan2(off.x) - self.lidar.angle_min()).rem_euclid(TAU);
        let last = self.lidar.beams.saturating_sub(1) as f64;
        self.lidar.before_end((angle / self.lidar.angle_increment()).min(last))
    }

    /// Leaves out the points that something else is known about; of `evident` ones, how many are left.
    pub(super) fn leave_out(&mut self, evident: usize, is_known: impl Fn(Point2<f64>) -> bool) -> usize {
        let known = self.points.iter().take(evident).filter(|point| is_known(**point));
        let left = evident - known.count().min(evident);
        self.points.retain(|point| !is_known(*point));
        left
    }

    /// Notes where something has evidently moved: the first of the points.
    pub(super) fn note_moved(&mut self, evident: usize, stamp: Stamp) {
        for place in self.points.iter().take(evident) {
            self.moved.note(RecentPlace {
                place: *place,
                stamp,
                speed: self.fastest,
                is_near: true,
                radius: 0.0,
                of: 0,
            });
        }
    }

    /// Whether a range is a return near enough to matter.
    fn is_near(&self, range: f64) -> bool {
        range >= self.lidar.range_min && range <= self.range.min(self.lidar.range_max)
    }

    /// Finds the beams whose return lies just behind a departed one.
    fn find_departed(&mut self, scan: &ProjectedScan<'_>) {
        self.departed.clear();
        let old = |reference: &&ReferenceScan| scan.stamp.secs_since(reference.stamp) >= self.settings.departed_after;
        let Some(reference) = self.references.iter().rev().find(old) else {
            return;
        };
        self.departed.resize(scan.ranges.len(), false);
        let gone_for = scan.stamp.secs_since(reference.stamp);
        let laser_from_reference = scan.odom_from_laser.inverse() * reference.odom_from_laser;
        self.reprojection
            .reproject(&laser_from_reference, &reference.ranges, self.reprojection.beyond);
        self.passed.clear();
        self.passed
            .extend(self.reprojection.beams_through(&self.free).map(|beam| beam.is_some()));
        self.reprojection
            .reproject(&laser_from_reference, &reference.ranges, 0.0);
        let (mut runs, mut run): (Vec<DepartedRun>, Option<DepartedRun>) = (Vec::new(), None);
        let beams = self.reprojection.beams_through(&self.free).zip(&self.passed);
        for (from, ((beam, passed), range)) in beams.zip(&reference.ranges).enumerate() {
            let beam = beam.filter(|_| *passed && self.is_near(f64::from(*range)));
            let through = beam.and_then(|beam| Some((beam, self.reprojection.point(from)?)));
            if let Some((beam, here)) = through {
                // At the seam of a full circle the beam numbers wrap.
                if run.is_some_and(|gone| beam.abs_diff(gone.beams.1) > APART && beam.abs_diff(gone.beams.0) > APART) {
                    runs.extend(run.take());
                }
                let gone = run.get_or_insert(DepartedRun {
                    ends: [here; 2],
                    beams: (beam, beam),
                    depth: 0.0,
                });
                gone.ends[1] = here;
                gone.beams = (gone.beams.0.min(beam), gone.beams.1.max(beam));
                gone.depth = gone.depth.max(here.coords.norm());
            } else {
                runs.extend(run.take());
            }
        }
        runs.extend(run);
        for gone in runs {
            self.mark(&gone, scan.ranges, gone_for);
        }
    }

    /// Marks the returns just behind a departed run.
    fn mark(&mut self, gone: &DepartedRun, ranges: &[f32], gone_for: f64) {
        let least = self.least_width(gone.depth);
        if width(gone.ends[0].coords, gone.ends[1].coords) < least {
            return;
        }
        let farthest = gone.depth + self.fastest * gone_for + self.reprojection.depth;
        let (first, last) = gone.beams;
        for (marked, range) in self.departed.iter_mut().zip(ranges).take(last + 1).skip(first) {
            *marked |= f64::from(*range) <= farthest;
        }
    }

    /// Ends a run of neighbouring returns before a beam: one that is too narrow to be trusted is dropped.
    fn end_run(&mut self, begun: &mut usize, laser: Point2<f64>, beam: usize) {
        if let [first, .., last] = self.points.get(*begun..).unwrap_or_default() {
            let least = self.least_width((first - laser).norm());
            if width(first - laser, last - laser) >= least {
                let beams = beam.saturating_sub(self.points.len() - *begun)..beam;
                for moved in self.moved_beams.get_mut(beams).unwrap_or_default() {
                    *moved = true;
                }
                *begun = self.points.len();
            }
        }
        self.points.truncate(*begun);
    }

    /// Finds the beams whose return lies where a reference scan saw free space.
    fn find_appeared(&mut self, scan: &ProjectedScan<'_>) {
        self.appeared.clear();
        self.appeared.resize(scan.ranges.len(), false);
        for reference in &self.references {
            let reference_from_laser = reference.odom_from_laser.inverse() * scan.odom_from_laser;
            self.reprojection
                .reproject(&reference_from_laser, scan.ranges, self.reprojection.beyond);
            self.passed.clear();
            let passed = self.reprojection.beams_through(&reference.free);
            self.passed.extend(passed.map(|beam| beam.is_some()));
            self.reprojection.reproject(&reference_from_laser, scan.ranges, 0.0);
            let passed = self.reprojection.beams_through(&reference.free).zip(&self.passed);
            for (appeared, (beam, passed)) in self.appeared.iter_mut().zip(passed) {
                *appeared |= beam.is_some() && *passed;
            }
        }
    }

    fn keep_reference(&mut self, scan: &ProjectedScan<'_>) {
        let due = self
            .references
            .back()
            .is_none_or(|last| scan.stamp.secs_since(last.stamp) >= self.settings.reference_period);
        if !due {
            return;
        }
        let oldest = (self.references.len() == self.settings.references)
            .then(|| self.references.pop_front())
            .flatten();
        let (mut ranges, mut free) = oldest
            .map(|reference| (reference.ranges, reference.free))
            .unwrap_or_default();
        ranges.clear();
        ranges.extend_from_slice(scan.ranges);
        free.clone_from(&self.free);
        self.references.push_back(ReferenceScan {
            stamp: scan.stamp,
            odom_from_laser: scan.odom_from_laser,
            ranges,
            free,
        });
    }
}

/// How far apart two returns are across the beams, m: along them it may be noise.
fn width(from: Vector2<f64>, to: Vector2<f64>) -> f64 {
    from.perp(&to).abs() / from.norm().max(to.norm()).max(1e-9)
}

/// Drops points nearer than this, m, to the one before.
fn thin(points: &mut Vec<Point2<f64>>, spacing: f64) {
    let mut last = Point2::new(f64::INFINITY, 0.0);
    points.retain(|point| {
        let keeps = (point - last).norm_squared() >= spacing * spacing;
        if keeps {
            last = *point;
        }
        keeps
    });
}
