//! Moving-obstacle detection. What moves around the robot? What stands where earlier sweeps saw free floor, and what lies behind a thing that has gone.
//!
//! No tracking and no model of what moves: a return that lies well inside the range of an earlier sweep's beams past the
//! same place is an intruder, whatever it is (visibility-based detection, after Pomerleau et al., "Long-term 3D map
//! maintenance in dynamic environments", ICRA 2014). What goes away leaves no such trace: there, beams go through a place that an
//! earlier sweep met, and what they meet next, no farther on than anything goes in that time, is the same thing. How fast it may go
//! is for the guard to assume; where it was last seen beside the blind sector is remembered for a while.

use std::collections::VecDeque;

use nalgebra::{Isometry2, Point2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::{LidarModel, RobotModel};
use zenav_protocol::time::Stamp;

use crate::field_of_view::{FieldOfView, ProjectedScan, rigid};
use crate::recent_places::{RecentPlace, RecentPlaces};
use crate::scan_reprojection::ScanReprojection;

/// Returns farther off than this do not matter yet, m.
const RANGE: f64 = 3.5;
/// Sweeps looked back at, and the time between two of them at least, s.
const LOOKS: (usize, f64) = (3, 0.32);
/// An intruder is at least this wide, m, and so many times as wide as the beams lie apart where it is: an earlier sweep may
/// have missed what is thinner.
const WIDTH: (f64, f64) = (0.04, 2.5);
/// What has gone away is sought by a look at least so old, s: by then it is clearly farther off.
const GONE_AFTER: f64 = 0.3;
/// Beams through neighbouring points lie no farther apart than this.
const APART: usize = 8;
/// What is met this near to where something moved within this time moves, too: something that turns round seems to rest, m and s.
const STILL: (f64, f64) = (0.2, 1.0);
/// Points of what moves are no nearer together than this, m.
const SPACING: f64 = 0.02;
/// Places kept where something moved.
const MOVED_PLACES: usize = 48;
/// What was last seen as near to the blind sector as this may have gone into it, m, beyond what it moves between two sweeps.
const BESIDE: f64 = 0.3;
/// What was farther from the robot than anything goes in this time, s, is not followed into the blind sector.
const NEAR_SECS: f64 = 0.75;
/// What was lost in the blind sector is reckoned with for this long, s.
const LOST_SECS: f64 = 10.0;
/// Places kept where something was lost.
const LOST_PLACES: usize = 32;
/// What comes out of the blind sector this much farther off than it could have gone is the same thing all the same, m.
const SURFACE: f64 = 0.1;

/// Returns on what moves, and where it was lost.
#[derive(Clone, Debug)]
pub struct MovingObstacles {
    /// One a lidar.
    detectors: Vec<Detector>,
    view: FieldOfView,
    /// As fast as anything may move, m/s.
    fastest: f64,
    /// What is farther from the lidar than this is not followed into the blind sector, m.
    near: f64,
    /// Where something was lost in the blind sector.
    lost: RecentPlaces,
}

/// Finds what moves in the sweeps of one lidar.
#[derive(Clone, Debug)]
struct Detector {
    lidar: LidarModel,
    aim: ScanReprojection,
    /// As fast as anything may move, m/s.
    fastest: f64,
    /// How far the beams of the newest sweep went past what stands there, m.
    past: Vec<f32>,
    looks: VecDeque<ReferenceScan>,
    /// Points of the newest sweep, odometry frame.
    points: Vec<Point2<f64>>,
    /// Which beams of the newest sweep met what has gone away.
    receded: Vec<bool>,
    /// Which beams of the newest sweep met something where an earlier look went past.
    intruding: Vec<bool>,
    /// Where something has moved lately.
    moved: RecentPlaces,
}

#[derive(Clone, Debug)]
struct ReferenceScan {
    stamp: Stamp,
    odom_from_laser: Isometry2<f64>,
    ranges: Vec<f32>,
    /// How far the beams went past what stood there, m.
    past: Vec<f32>,
}

/// A run of neighbouring returns of an earlier look that beams go through now.
#[derive(Clone, Copy, Debug)]
struct Gone {
    /// The first and the last, in the frame of the lidar now.
    ends: [Point2<f64>; 2],
    /// The first and the last beam that go through them.
    beams: (usize, usize),
    /// The farthest, m.
    depth: f64,
}

impl MovingObstacles {
    /// None yet. Nothing moves faster than `fastest`, m/s.
    #[must_use]
    pub(crate) fn new(model: &RobotModel, view: FieldOfView, fastest: f64) -> Self {
        Self {
            detectors: model
                .all_lidars()
                .map(|(_, lidar)| Detector::new(lidar, fastest))
                .collect(),
            view,
            fastest,
            near: 2.0 * model.footprint.circumscribed_radius() + NEAR_SECS * fastest,
            lost: RecentPlaces::new(LOST_PLACES),
        }
    }

    /// Takes a sweep of the lidar of this index.
    pub(crate) fn insert(&mut self, index: usize, cast: &ProjectedScan<'_>) {
        let Some(evident) = self.detectors.get_mut(index).map(|detector| detector.insert(cast)) else {
            return;
        };
        self.lose(index, cast);
        if let Some(detector) = self.detectors.get_mut(index) {
            detector.note_moved(evident, cast.stamp);
        }
    }

    /// Notes what may go into the blind sector before the lidar's next sweep, and forgets what was lost long ago or has come out again.
    fn lose(&mut self, index: usize, cast: &ProjectedScan<'_>) {
        let Some(detector) = self.detectors.get(index) else {
            return;
        };
        let step = self.fastest / cast.lidar.rate_hz;
        let (beside, near, laser) = (BESIDE + step, self.near, cast.laser());
        let (now, base_from_odom) = (cast.stamp, cast.odom_from_base.inverse());
        // What moves by a single sweep may be a mistake: it is not worth the wait for it to come out.
        let since = STILL.0 + step;
        let goes = |place: &&Point2<f64>| {
            self.view.distance_to_blind(base_from_odom * **place) <= beside
                && (**place - laser).norm() <= near
                && detector.moved.any_within(since, **place)
        };
        let points = &detector.points;
        let places: Vec<_> = points.iter().filter(goes).copied().collect();
        let fastest = self.fastest;
        self.lost.retain(|lost| {
            let age = now.secs_since(lost.stamp);
            let reach = fastest * age + SURFACE;
            let is_out = places.is_empty() && points.iter().any(|place| lost.is_within(reach, *place));
            age <= LOST_SECS && !is_out
        });
        for place in places {
            self.lose_at(place, now);
        }
    }

    /// Something was last seen, or felt, at a place (odometry frame).
    pub fn lose_at(&mut self, place: Point2<f64>, stamp: Stamp) {
        self.lost.note(place, stamp);
    }

    /// What may be in the blind sector now.
    pub fn lost(&self) -> impl Iterator<Item = &RecentPlace> + '_ {
        self.lost.iter()
    }

    /// What moves, in the base frame of a robot at `odom_from_base`.
    pub fn in_base(&self, odom_from_base: Pose2) -> impl Iterator<Item = Point2<f64>> + '_ {
        let base_from_odom = rigid(odom_from_base.inverse());
        self.detectors
            .iter()
            .flat_map(|detector| &detector.points)
            .map(move |point| base_from_odom * point)
    }
}

impl Detector {
    fn new(lidar: &LidarModel, fastest: f64) -> Self {
        Self {
            lidar: lidar.clone(),
            aim: ScanReprojection::new(lidar),
            fastest,
            past: Vec::new(),
            looks: VecDeque::new(),
            points: Vec::new(),
            receded: Vec::new(),
            intruding: Vec::new(),
            moved: RecentPlaces::new(MOVED_PLACES),
        }
    }

    /// Takes a sweep; returns how many of the points found in it moved by themselves, not only near to what does.
    fn insert(&mut self, cast: &ProjectedScan<'_>) -> usize {
        self.points.clear();
        self.aim.past(cast.ranges, &mut self.past);
        self.find_receded(cast);
        self.find_intruding(cast);
        self.moved.retain(|trace| cast.stamp.secs_since(trace.stamp) <= STILL.1);
        let laser = cast.laser();
        let (low, high) = self.moved.bounds(STILL.0);
        let (mut begun, mut still) = (0, Vec::new());
        for (beam, (range, ray)) in cast.ranges.iter().zip(cast.rays).enumerate() {
            let range = f64::from(*range);
            if !self.is_near(range) {
                self.end_run(&mut begun, laser);
                continue;
            }
            let point = laser + ray * range;
            let is_one = |marked: &[bool]| marked.get(beam).is_some_and(|marked| *marked);
            if is_one(&self.receded) || is_one(&self.intruding) {
                self.points.push(point);
                continue;
            }
            self.end_run(&mut begun, laser);
            if point >= low && point <= high && self.moved.any_within(STILL.0, point) {
                still.push(point);
            }
        }
        self.end_run(&mut begun, laser);
        thin(&mut self.points);
        let evident = self.points.len();
        thin(&mut still);
        self.points.append(&mut still);
        self.look(cast);
        evident
    }

    /// Notes where something has evidently moved: the first of the points.
    fn note_moved(&mut self, evident: usize, stamp: Stamp) {
        for place in self.points.iter().take(evident) {
            self.moved.note(*place, stamp);
        }
    }

    /// Whether a range is a return that matters.
    fn is_near(&self, range: f64) -> bool {
        range >= self.lidar.range_min && range <= RANGE.min(self.lidar.range_max)
    }

    /// Notes the beams that meet what stood nearer at an earlier look.
    fn find_receded(&mut self, cast: &ProjectedScan<'_>) {
        self.receded.clear();
        let old = |look: &&ReferenceScan| cast.stamp.secs_since(look.stamp) >= GONE_AFTER;
        let Some(look) = self.looks.iter().rev().find(old) else {
            return;
        };
        self.receded.resize(cast.ranges.len(), false);
        let gone_for = cast.stamp.secs_since(look.stamp);
        let laser_from_look = cast.odom_from_laser.inverse() * look.odom_from_laser;
        self.aim.lay(&laser_from_look, &look.ranges);
        let (mut runs, mut run): (Vec<Gone>, Option<Gone>) = (Vec::new(), None);
        let beams = self.aim.beams_past(&self.past).zip(&look.ranges);
        for (from, (beam, range)) in beams.enumerate() {
            let beam = beam.filter(|_| self.is_near(f64::from(*range)));
            let through = beam.and_then(|beam| Some((beam, self.aim.point(from)?)));
            if let Some((beam, here)) = through {
                // At the seam of a full circle the beams begin anew.
                if run.is_some_and(|gone| beam.abs_diff(gone.beams.1) > APART && beam.abs_diff(gone.beams.0) > APART) {
                    runs.extend(run.take());
                }
                let gone = run.get_or_insert(Gone {
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
            self.mark(&gone, cast.ranges, gone_for);
        }
    }

    /// Marks what is met behind a run of points that have gone.
    fn mark(&mut self, gone: &Gone, ranges: &[f32], gone_for: f64) {
        let least = WIDTH.0.max(WIDTH.1 * self.lidar.angle_increment() * gone.depth);
        if (gone.ends[1] - gone.ends[0]).norm() < least {
            return;
        }
        let farthest = gone.depth + self.fastest * gone_for + self.aim.depth;
        let (first, last) = gone.beams;
        for (marked, range) in self.receded.iter_mut().zip(ranges).take(last + 1).skip(first) {
            *marked |= f64::from(*range) <= farthest;
        }
    }

    /// Drops a run of neighbouring returns that is too narrow to be trusted.
    fn end_run(&mut self, begun: &mut usize, laser: Point2<f64>) {
        if let [first, .., last] = self.points.get(*begun..).unwrap_or_default() {
            let least = WIDTH
                .0
                .max(WIDTH.1 * self.lidar.angle_increment() * (first - laser).norm());
            if (last - first).norm() >= least {
                *begun = self.points.len();
            }
        }
        self.points.truncate(*begun);
    }

    /// Notes the beams that met something where an earlier look went past.
    fn find_intruding(&mut self, cast: &ProjectedScan<'_>) {
        self.intruding.clear();
        self.intruding.resize(cast.ranges.len(), false);
        for look in &self.looks {
            let look_from_laser = look.odom_from_laser.inverse() * cast.odom_from_laser;
            self.aim.lay(&look_from_laser, cast.ranges);
            for (intruding, beam) in self.intruding.iter_mut().zip(self.aim.beams_past(&look.past)) {
                *intruding |= beam.is_some();
            }
        }
    }

    fn look(&mut self, cast: &ProjectedScan<'_>) {
        let due = self
            .looks
            .back()
            .is_none_or(|last| cast.stamp.secs_since(last.stamp) >= LOOKS.1);
        if !due {
            return;
        }
        let oldest = (self.looks.len() == LOOKS.0).then(|| self.looks.pop_front()).flatten();
        let (mut ranges, mut past) = oldest.map(|look| (look.ranges, look.past)).unwrap_or_default();
        ranges.clear();
        ranges.extend_from_slice(cast.ranges);
        past.clone_from(&self.past);
        self.looks.push_back(ReferenceScan {
            stamp: cast.stamp,
            odom_from_laser: cast.odom_from_laser,
            ranges,
            past,
        });
    }
}

/// Leaves out points close to the one before.
fn thin(points: &mut Vec<Point2<f64>>) {
    let mut last = Point2::new(f64::INFINITY, 0.0);
    points.retain(|point| {
        let keeps = (point - last).norm_squared() >= SPACING * SPACING;
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
    use zenav_protocol::robot::shipped;

    fn robot(name: &str) -> RobotModel {
        RobotModel::from_toml(shipped(name).unwrap(), name).unwrap()
    }

    fn none_yet(model: &RobotModel, fastest: f64) -> MovingObstacles {
        let view = FieldOfView::new(model.first_lidar(), &model.footprint);
        MovingObstacles::new(model, view, fastest)
    }

    /// A wall across the way at `wall`, and a post of some beams at `post`, both in the odometry frame.
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
    fn what_has_gone_from_the_seam_of_a_full_circle_marks_only_what_lies_behind_it() {
        let robot = robot("neato");
        let lidar = robot.first_lidar().unwrap();
        let mut intruders = none_yet(&robot, 0.3);
        for (secs, nearer) in [(0.0, 0.1), (0.4, 0.0)] {
            let range = |beam: usize| {
                let angle: f64 = lidar.angle_min() + beam as f64 * lidar.angle_increment();
                (1.6 - if angle.cos() < -0.99 { nearer } else { 0.0 }) as f32
            };
            let sweep = Sweep::new(Stamp::from_secs(secs), (0..lidar.beams).map(range).collect());
            intruders.insert(0, &ScanProjector::new(lidar).project(&sweep, Pose2::IDENTITY).unwrap());
        }
        let points: Vec<_> = intruders.in_base(Pose2::IDENTITY).collect();
        assert!(
            !points.is_empty() && points.iter().all(|point| point.x < -1.0),
            "{points:?}"
        );
    }

    #[test]
    fn what_comes_nearer_intrudes_and_what_stands_does_not() {
        let robot = robot("tiago");
        let lidar = robot.first_lidar().unwrap();
        let (mut still, mut moving) = (none_yet(&robot, 0.6), none_yet(&robot, 0.6));
        let mut projector = ScanProjector::new(lidar);
        for step in 0..20 {
            let secs = 0.1 * f64::from(step);
            // The robot drives and turns: what stands still stands.
            let base = Pose2::new(0.05 * f64::from(step), 0.0, 0.0);
            for (intruders, post) in [(&mut still, 2.0), (&mut moving, 2.4 - 0.03 * f64::from(step))] {
                let sweep = sweep(lidar, secs, base, Some(post));
                intruders.insert(0, &projector.project(&sweep, base).unwrap());
            }
        }
        assert_eq!(still.in_base(Pose2::IDENTITY).count(), 0);
        assert!(moving.in_base(Pose2::IDENTITY).count() >= 2);
    }
}
