//! Moving obstacles. Which returns of a scan belong to something that moves? Those where earlier scans saw free space, and those just
//! behind a return that has departed.
//!
//! No motion model: a return well inside the range of an earlier scan's beams through the same place has appeared there
//! (visibility-based detection, after Pomerleau et al., "Long-term 3D map maintenance in dynamic environments", ICRA 2014). An obstacle
//! that moves away leaves no such evidence: there, beams pass through a return of an earlier scan, and the next return behind it, no farther
//! than anything moves in that time, is the same obstacle. What moves for a few scans becomes a track ([`crate::obstacle_tracks`]) with a
//! velocity of its own; for the rest the collision monitor assumes a speed. One last seen beside the blind spot is remembered there for a
//! while.

use std::collections::VecDeque;

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::{LidarModel, RobotModel};
use zenav_protocol::time::Stamp;

use crate::field_of_view::{FieldOfView, ProjectedScan, rigid};
use crate::obstacle_tracks::{ObstacleTracks, Track};
use crate::range_noise::RangeNoise;
use crate::recent_places::{RecentPlace, RecentPlaces};
use crate::scan_reprojection::ScanReprojection;
use crate::settings::{EdgeSettings, MovingObstacleSettings};

/// Beams through neighbouring points are at most this far apart, in beams.
const APART: usize = 8;
/// Most places kept where something moved.
const MOVED_PLACES: usize = 48;
/// Most places kept where an obstacle entered the blind spot.
const OCCLUDED_PLACES: usize = 32;

/// Points of moving obstacles, and the places where some left the field of view.
#[derive(Clone, Debug)]
pub struct MovingObstacles {
    /// One for each lidar.
    detectors: Vec<Detector>,
    view: FieldOfView,
    settings: MovingObstacleSettings,
    /// Assumed speed of moving obstacles in view and out of sight, m/s.
    fastest: f64,
    fastest_out_of_sight: f64,
    /// Circumscribed radius of the robot, m.
    circumscribed_radius: f64,
    /// Places where a moving obstacle entered the blind spot.
    occluded: RecentPlaces,
    /// The tracks that were taken for one that had entered it.
    came_out: VecDeque<u64>,
    /// What moves, over time.
    tracks: ObstacleTracks,
}

/// Finds what moves in the scans of one lidar.
#[derive(Clone, Debug)]
struct Detector {
    lidar: LidarModel,
    reprojection: ScanReprojection,
    noise: RangeNoise,
    settings: MovingObstacleSettings,
    /// Assumed speed of moving obstacles, m/s.
    fastest: f64,
    /// Up to which range each beam of the newest scan saw free space, m.
    free: Vec<f32>,
    references: VecDeque<ReferenceScan>,
    /// Points of moving obstacles in the newest scan, odometry frame.
    points: Vec<Point2<f64>>,
    /// The beams that evidently met something that moves.
    moved_beams: Vec<bool>,
    /// Beams beyond this range tell nothing about motion, m.
    range: f64,
    /// Returns that others pass through even if they are farther away than they were measured.
    passed: Vec<bool>,
    /// Beams of the newest scan whose return lies just behind a departed one.
    departed: Vec<bool>,
    /// Beams of the newest scan whose return lies where a reference scan saw free space.
    appeared: Vec<bool>,
    /// Places where something moved recently.
    moved: RecentPlaces,
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

impl MovingObstacles {
    /// No scan yet.
    #[must_use]
    pub(crate) fn new(model: &RobotModel, view: FieldOfView, settings: &EdgeSettings) -> Self {
        let top_speed = model.drive.top_speed();
        let fastest = settings.passive_safety.speed_in_view(top_speed);
        let detectors = model
            .all_lidars()
            .map(|(_, lidar)| Detector::new(lidar, settings, fastest));
        Self {
            detectors: detectors.collect(),
            view,
            settings: settings.moving_obstacles.clone(),
            fastest,
            fastest_out_of_sight: settings.passive_safety.speed_out_of_sight(top_speed),
            circumscribed_radius: model.footprint.circumscribed_radius(),
            occluded: RecentPlaces::new(OCCLUDED_PLACES, settings.moving_obstacles.place_spacing),
            came_out: VecDeque::new(),
            tracks: ObstacleTracks::new(&settings.tracking),
        }
    }

    /// Obstacles beyond this distance from the lidar are not followed into the blind spot, m.
    fn near(&self) -> f64 {
        2.0 * self.circumscribed_radius + self.settings.near_secs * self.fastest_out_of_sight
    }

    /// Takes a scan of the lidar with this index.
    pub(crate) fn insert(&mut self, index: usize, scan: &ProjectedScan<'_>) {
        let Some(evident) = self.detectors.get_mut(index).map(|detector| detector.insert(scan)) else {
            return;
        };
        if let Some(detector) = self.detectors.get(index) {
            self.tracks.insert(scan, &detector.moved_beams);
        }
        self.track_occlusions(index, scan);
        if let Some(detector) = self.detectors.get_mut(index) {
            detector.note_moved(evident, scan.stamp);
        }
    }

    /// Remembers obstacles that may enter the blind spot before the lidar's next scan, and forgets those that are too old or have left it
    /// again.
    fn track_occlusions(&mut self, index: usize, scan: &ProjectedScan<'_>) {
        let Some(detector) = self.detectors.get(index) else {
            return;
        };
        let (points, settings) = (&detector.points, &self.settings);
        let step = self.fastest / scan.lidar.rate_hz;
        let (beside, near, laser) = (settings.beside_blind_spot + step, self.near(), scan.laser());
        let (now, base_from_odom) = (scan.stamp, scan.odom_from_base.inverse());
        // Motion in a single scan may be a false detection: it is not worth waiting for.
        let since = settings.turning_distance + step;
        let goes = |place: &&Point2<f64>| {
            self.view.distance_to_blind_spot(base_from_odom * **place) <= beside
                && (**place - laser).norm() <= near
                && detector.moved.any_within(since, **place)
        };
        let places: Vec<_> = points.iter().filter(goes).copied().collect();
        self.forget_reappeared(index, scan, beside, places.is_empty());
        for place in places {
            let track = self.tracks.at(place);
            self.occluded.note(RecentPlace {
                place,
                stamp: now,
                speed: self.tracks.most_speed_at(place).unwrap_or(self.fastest_out_of_sight),
                track: track.map(|track| track.id),
            });
        }
    }

    /// Forgets obstacles that are too old, or have come out of the blind spot: no more than have come out.
    fn forget_reappeared(&mut self, index: usize, scan: &ProjectedScan<'_>, beside: f64, none_beside: bool) {
        let (now, settings, view) = (scan.stamp, &self.settings, &self.view);
        let base_from_odom = scan.odom_from_base.inverse();
        let points = self.detectors.get(index).map_or(&[][..], |detector| &detector.points);
        let may_be = |occluded: &RecentPlace, place: Point2<f64>| {
            let reach = occluded.speed * now.secs_since(occluded.stamp) + settings.reappearance_tolerance;
            occluded.is_within(reach, place)
        };
        self.occluded.retain(|occluded| {
            let untracked = occluded.track.is_none() && none_beside;
            let is_out = untracked && points.iter().any(|point| may_be(occluded, *point));
            now.secs_since(occluded.stamp) <= settings.memory && !is_out
        });
        let mut waiting: Vec<RecentPlace> = Vec::new();
        for occluded in self.occluded.iter().filter(|occluded| occluded.track.is_some()) {
            if waiting.iter().all(|known| known.track != occluded.track) {
                waiting.push(*occluded);
            }
        }
        for occluded in waiting {
            // The same one, or somebody new who has not been taken for another one before.
            let in_sight = |track: &&Track| {
                track.seen == now && view.distance_to_blind_spot(base_from_odom * track.position) > beside
            };
            let out = self
                .tracks
                .iter()
                .filter(in_sight)
                .map(|track| (track.id, track))
                .find(|(id, track)| {
                    occluded.track == Some(*id)
                        || (track.born > occluded.stamp
                            && !self.came_out.contains(id)
                            && may_be(&occluded, track.position))
                });
            let Some((id, _)) = out else { continue };
            self.occluded.retain(|known| known.track != occluded.track);
            if self.came_out.len() == OCCLUDED_PLACES {
                self.came_out.pop_front();
            }
            self.came_out.push_back(id);
        }
    }

    /// A moving obstacle was last seen, or felt by the bumper, at a place (odometry frame).
    pub fn note_occlusion(&mut self, place: Point2<f64>, stamp: Stamp) {
        self.occluded.note(RecentPlace {
            place,
            stamp,
            speed: self.fastest_out_of_sight,
            track: None,
        });
    }

    /// Where moving obstacles entered the blind spot.
    pub fn occluded(&self) -> impl Iterator<Item = &RecentPlace> + '_ {
        self.occluded.iter()
    }

    /// Points of moving obstacles, in the base frame of a robot at `odom_from_base`, and how fast each moves at most, m/s: a tracked one
    /// as fast as its track, any other one as fast as is assumed.
    pub fn in_base(&self, odom_from_base: Pose2) -> impl Iterator<Item = (Point2<f64>, f64)> + '_ {
        let base_from_odom = rigid(odom_from_base.inverse());
        let points = self.detectors.iter().flat_map(|detector| &detector.points);
        points.map(move |point| {
            (
                base_from_odom * point,
                self.tracks.most_speed_at(*point).unwrap_or(self.fastest),
            )
        })
    }

    /// The tracks of moving obstacles.
    #[must_use]
    pub fn tracks(&self) -> &ObstacleTracks {
        &self.tracks
    }
}

impl Detector {
    fn new(lidar: &LidarModel, settings: &EdgeSettings, fastest: f64) -> Self {
        Self {
            lidar: lidar.clone(),
            reprojection: ScanReprojection::new(lidar, settings.scan_reprojection),
            noise: RangeNoise::new(lidar.noise),
            settings: settings.moving_obstacles.clone(),
            fastest,
            free: Vec::new(),
            references: VecDeque::new(),
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
    fn insert(&mut self, scan: &ProjectedScan<'_>) -> usize {
        self.points.clear();
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

    /// Notes where something has evidently moved: the first of the points.
    fn note_moved(&mut self, evident: usize, stamp: Stamp) {
        for place in self.points.iter().take(evident) {
            self.moved.note(RecentPlace {
                place: *place,
                stamp,
                speed: self.fastest,
                track: None,
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::field_of_view::ScanProjector;
    use zenav_protocol::readings::Sweep;

    fn none_yet(model: &RobotModel, fastest: f64) -> MovingObstacles {
        let view = FieldOfView::new(model.first_lidar(), &model.footprint);
        let mut settings = EdgeSettings::default();
        settings.passive_safety.speed_in_view = Some(fastest);
        settings.passive_safety.speed_out_of_sight = Some(fastest);
        MovingObstacles::new(model, view, &settings)
    }

    /// A wall at x = 3, and a post of some beams at x = `post`, both in the odometry frame.
    fn sweep(lidar: &LidarModel, secs: f64, base: Pose2, post: Option<f64>) -> Sweep {
        let laser = base * lidar.mount;
        let range = |beam: usize| {
            let angle = lidar.angle_min() + beam as f64 * lidar.angle_increment();
            let wall = if angle.cos() > 0.2 {
                (3.0 - laser.x) / angle.cos()
            } else {
                f64::INFINITY
            };
            let before = post.filter(|_| angle.abs() < 0.05).map_or(wall, |at| at - laser.x);
            wall.min(before) as f32
        };
        Sweep::new(Stamp::from_secs(secs), (0..lidar.beams).map(range).collect())
    }

    #[test]
    fn a_departed_return_at_the_seam_of_a_full_circle_marks_only_what_lies_behind_it() {
        let robot = zenav_fixtures::robot("neato");
        let lidar = robot.first_lidar().unwrap();
        let mut tracked = none_yet(&robot, 0.3);
        for (secs, nearer) in [(0.0, 0.1), (0.4, 0.0)] {
            let range = |beam: usize| {
                let angle: f64 = lidar.angle_min() + beam as f64 * lidar.angle_increment();
                (1.6 - if angle.cos() < -0.99 { nearer } else { 0.0 }) as f32
            };
            let sweep = Sweep::new(Stamp::from_secs(secs), (0..lidar.beams).map(range).collect());
            tracked.insert(0, &ScanProjector::new(lidar).project(&sweep, Pose2::IDENTITY).unwrap());
        }
        let points: Vec<_> = tracked.in_base(Pose2::IDENTITY).map(|(point, _)| point).collect();
        assert!(
            !points.is_empty() && points.iter().all(|point| point.x < -1.0),
            "{points:?}"
        );
    }

    #[test]
    fn an_approaching_post_is_detected_and_a_static_one_is_not() {
        let robot = zenav_fixtures::robot("tiago");
        let lidar = robot.first_lidar().unwrap();
        let (mut still, mut moving) = (none_yet(&robot, 0.6), none_yet(&robot, 0.6));
        let mut projector = ScanProjector::new(lidar);
        for step in 0..20 {
            let secs = 0.1 * f64::from(step);
            // The robot drives and turns: what stands still stands.
            let base = Pose2::new(0.05 * f64::from(step), 0.0, 0.0);
            for (tracked, post) in [(&mut still, 2.0), (&mut moving, 2.4 - 0.03 * f64::from(step))] {
                let sweep = sweep(lidar, secs, base, Some(post));
                tracked.insert(0, &projector.project(&sweep, base).unwrap());
            }
        }
        assert_eq!(still.in_base(Pose2::IDENTITY).count(), 0);
        assert!(moving.in_base(Pose2::IDENTITY).count() >= 2);
    }
}
