//! Moving obstacles. Which returns of a scan belong to something that moves? Those where earlier scans saw free space, and those just
//! behind a return that has departed.
//!
//! No motion model: a return well inside the range of an earlier scan's beams through the same place has appeared there
//! (visibility-based detection, after Pomerleau et al., "Long-term 3D map maintenance in dynamic environments", ICRA 2014). An obstacle
//! that moves away leaves no such evidence: there, beams pass through a return of an earlier scan, and the next return behind it, no farther
//! than anything moves in that time, is the same obstacle. What moves for a few scans becomes a track ([`crate::obstacle_tracks`]) with a
//! velocity of its own; for the rest the collision monitor assumes a speed. One last seen beside the blind spot is remembered there for a
//! while.

mod detector;

use std::collections::VecDeque;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::field_of_view::{FieldOfView, ProjectedScan, rigid};
use crate::obstacle_tracks::{ObstacleTracks, Track};
use crate::passive_safety::Mover;
use crate::recent_places::{RecentPlace, RecentPlaces};
use crate::settings::{EdgeSettings, MovingObstacleSettings};
use detector::Detector;

/// Most places kept where an obstacle entered the blind spot.
const OCCLUDED_PLACES: usize = 128;

/// An obstacle that entered the blind spot and has not come out is forgotten once the robot is this far away, m.
const STAYS: f64 = 2.0;

/// Most of the radius of a hidden obstacle that is relied on, m: two people side by side look like one.
const SURE_RADIUS: f64 = 0.25;

/// Points without a track that are nearer to one another than this are one obstacle, m.
const ONE: f64 = 0.5;

/// An obstacle may be noted so many scans before its track begins.
const FEW_SCANS: f64 = 3.5;

/// Obstacles without a track are numbered from here on; the numbers of tracks are lower. One that the bumper felt has another bit.
const UNTRACKED: u64 = 1 << 62;
const FELT: u64 = 1 << 63;

/// Whether a number is that of an obstacle that a lidar saw and that has no track yet.
fn is_provisional(of: u64) -> bool {
    (UNTRACKED..FELT).contains(&of)
}

/// Adds a number to a bounded list.
fn remember(numbers: &mut VecDeque<u64>, number: u64) {
    if numbers.len() == OCCLUDED_PLACES {
        numbers.pop_front();
    }
    numbers.push_back(number);
}

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
    /// And out of sight when somebody new is taken for a hidden one, who is then forgotten: slower, so that fewer are.
    fastest_to_come_out: f64,
    /// Circumscribed radius of the robot, m.
    circumscribed_radius: f64,
    /// Places where a moving obstacle entered the blind spot, with the number of its track.
    occluded: RecentPlaces,
    /// The number of the next obstacle without a track.
    next_untracked: u64,
    /// Tracks that were taken for an obstacle that had entered it.
    came_out: VecDeque<u64>,
    /// Tracks that were noted under another number before they were tracks.
    adopted: VecDeque<u64>,
    /// Stamp of the newest scan.
    scanned: Option<Stamp>,
    /// The tracks of moving obstacles.
    tracks: ObstacleTracks,
    /// When motion was last seen.
    moved: Option<Stamp>,
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
            fastest_to_come_out: settings.passive_safety.speed_out_of_sight.unwrap_or(top_speed),
            circumscribed_radius: model.footprint.circumscribed_radius(),
            occluded: RecentPlaces::new(OCCLUDED_PLACES, settings.moving_obstacles.place_spacing),
            next_untracked: UNTRACKED,
            came_out: VecDeque::new(),
            adopted: VecDeque::new(),
            scanned: None,
            tracks: ObstacleTracks::new(&settings.tracking),
            moved: None,
        }
    }

    /// Distance from the lidar within which an obstacle can reach the robot in this time, m.
    fn within(&self, secs: f64) -> f64 {
        2.0 * self.circumscribed_radius + secs * self.fastest_out_of_sight
    }

    /// Takes a scan of the lidar with this index.
    pub(crate) fn insert(&mut self, index: usize, scan: &ProjectedScan<'_>) {
        let Some(evident) = self.detectors.get_mut(index).map(|detector| detector.insert(scan)) else {
            return;
        };
        let (tracks, mut left) = (&mut self.tracks, evident);
        if let Some(detector) = self.detectors.get_mut(index) {
            tracks.insert(scan, &detector.moved_beams);
            if !tracks.robots().is_empty() {
                left = detector.leave_out(evident, |point| tracks.is_by_robot(point));
            }
        }
        // A robot that announces its course is known in the blind spot, too.
        if self.tracks.iter().any(|track| !track.is_robot()) {
            self.moved = Some(scan.stamp);
        }
        self.track_occlusions(index, scan);
        if let Some(detector) = self.detectors.get_mut(index) {
            detector.note_moved(left, scan.stamp);
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
        let far = self.within(settings.far_secs);
        let (beside, near, laser) = (
            settings.beside_blind_spot + step,
            self.within(settings.near_secs),
            scan.laser(),
        );
        let (now, base_from_odom) = (scan.stamp, scan.odom_from_base.inverse());
        // Motion in a single scan may be a false detection.
        let since = settings.turning_distance + step;
        let goes = |place: &&Point2<f64>| {
            self.view.distance_to_blind_spot(base_from_odom * **place) <= beside
                && (**place - laser).norm() <= far
                && detector.moved.any_within(since, **place)
        };
        let places: Vec<_> = points.iter().filter(goes).copied().collect();
        self.forget_reappeared(scan, beside);
        self.scanned = Some(now);
        for place in places {
            let track = self
                .tracks
                .at(place)
                .map(|track| (track.id, track.born, track.sure_radius()));
            let speed = self.tracks.most_speed_at(place).unwrap_or(self.fastest_out_of_sight);
            let was_near = match track {
                Some((id, born, _)) => self.supersede(id, born, place, speed, now, FEW_SCANS / scan.lidar.rate_hz),
                None => false,
            };
            let of = track
                .map(|(id, ..)| id)
                .unwrap_or_else(|| self.untracked_at(place, now));
            self.occluded.note(RecentPlace {
                place,
                stamp: now,
                speed,
                is_near: was_near || (place - laser).norm() <= near,
                radius: track.map_or(0.0, |(.., radius)| radius.min(SURE_RADIUS)),
                of,
            });
        }
    }

    /// Drops what was noted of a track before it was seen at a place (odometry frame): its earlier positions, and once the number under which
    /// it was noted before it had a track. Returns whether any of that was near the robot.
    fn supersede(&mut self, id: u64, born: Stamp, place: Point2<f64>, speed: f64, now: Stamp, lately: f64) -> bool {
        let before = |known: &RecentPlace| {
            let secs = now.secs_since(known.stamp);
            is_provisional(known.of)
                && secs > 0.0
                && born.secs_since(known.stamp) <= lately
                && known.is_within(ONE + speed * secs, place)
        };
        let known = self.occluded.iter().find(|known| before(known)).map(|known| known.of);
        let adopted = known.filter(|_| !self.adopted.contains(&id));
        if adopted.is_some() {
            remember(&mut self.adopted, id);
        }
        let is_it = |known: &RecentPlace| {
            Some(known.of) == adopted || known.of == id && known.stamp < now && self.may_be_at(known, place, now)
        };
        let near = |known: &RecentPlace| known.is_near && (known.of == id || is_it(known));
        let (was_near, superseded): (bool, Vec<RecentPlace>) = (
            self.occluded.iter().any(near),
            self.occluded.iter().filter(|known| is_it(known)).copied().collect(),
        );
        self.occluded.retain(|known| !superseded.contains(known));
        was_near
    }

    /// The number of an obstacle without a track at a place (odometry frame): that of one seen there a moment ago, or a new one.
    fn untracked_at(&mut self, place: Point2<f64>, now: Stamp) -> u64 {
        let is_it = |known: &&RecentPlace| {
            let secs = now.secs_since(known.stamp);
            is_provisional(known.of)
                && secs <= self.settings.turning_secs
                && known.is_within(ONE + known.speed * secs.max(0.0), place)
        };
        let known = self.occluded.iter().find(is_it).map(|known| known.of);
        known.unwrap_or_else(|| self.next_number())
    }

    fn next_number(&mut self) -> u64 {
        self.next_untracked += 1;
        self.next_untracked
    }

    /// Whether a hidden obstacle may be at a place (odometry frame) by now, so that what is there counts as it.
    fn may_be_at(&self, hidden: &RecentPlace, place: Point2<f64>, now: Stamp) -> bool {
        // The speed of one that never had a track is only assumed.
        let speed = match hidden.of {
            UNTRACKED.. => hidden.speed.min(self.fastest_to_come_out),
            _ => hidden.speed,
        };
        let reach = speed * now.secs_since(hidden.stamp).max(0.0) + self.settings.reappearance_tolerance;
        hidden.is_within(reach, place)
    }

    /// The newest place of each hidden obstacle.
    fn newest(&self) -> Vec<RecentPlace> {
        let mut newest: Vec<RecentPlace> = Vec::new();
        for hidden in self.occluded.iter() {
            match newest.iter_mut().find(|known| known.of == hidden.of) {
                Some(known) if known.stamp < hidden.stamp => *known = *hidden,
                Some(_) => {}
                None => newest.push(*hidden),
            }
        }
        newest
    }

    /// Forgets obstacles that are too old, and one for each that has come out of the blind spot.
    fn forget_reappeared(&mut self, scan: &ProjectedScan<'_>, beside: f64) {
        let now = scan.stamp;
        let base_from_odom = scan.odom_from_base.inverse();
        let robot = scan.odom_from_base * Point2::origin();
        let memory = self.settings.memory.max(self.settings.memory_backing);
        self.occluded
            .retain(|hidden| now.secs_since(hidden.stamp) <= memory || hidden.is_within(STAYS, robot));
        let in_sight = |track: &&Track| self.view.distance_to_blind_spot(base_from_odom * track.position) > beside;
        let seen: Vec<_> = self.tracks.seen(now).filter(in_sight).cloned().collect();
        for hidden in self.newest() {
            let is_itself = |track: &&Track| track.id == hidden.of && self.may_be_at(&hidden, track.position, now);
            if let Some(track) = seen.iter().find(is_itself) {
                self.forget(hidden.of, track.id);
            }
        }
        // A track that went in itself has come out for nobody else.
        let newest = self.newest();
        for hidden in &newest {
            let is_new = |track: &&Track| {
                track.born > hidden.stamp
                    && !self.came_out.contains(&track.id)
                    && newest.iter().all(|other| other.of != track.id)
                    && self.may_be_at(hidden, track.position, now)
            };
            if let Some(track) = seen.iter().find(is_new) {
                self.forget(hidden.of, track.id);
            }
        }
    }

    /// Forgets the hidden obstacle of this number: the track has come out for it.
    fn forget(&mut self, hidden: u64, track: u64) {
        self.occluded.retain(|known| known.of != hidden);
        remember(&mut self.came_out, track);
    }

    /// Notes a moving obstacle that the bumper felt at a place (odometry frame), or that may be there: a hidden one that is not in sight and can
    /// have come there, else a new one.
    pub fn note_occlusion(&mut self, place: Point2<f64>, stamp: Stamp) {
        let is_hidden = |hidden: &RecentPlace| {
            let in_sight = self.scanned.is_some_and(|scanned| {
                hidden.stamp == scanned || self.tracks.seen(scanned).any(|track| track.id == hidden.of)
            });
            !in_sight && self.may_be_at(hidden, place, stamp)
        };
        let known = self.newest().into_iter().find(is_hidden).map(|hidden| hidden.of);
        let of = known.unwrap_or_else(|| self.next_number() | FELT);
        self.occluded.note(RecentPlace {
            place,
            stamp,
            speed: self.fastest_out_of_sight,
            is_near: true,
            radius: 0.0,
            of,
        });
    }

    /// Where moving obstacles entered the blind spot lately, near the robot.
    pub fn occluded(&self, now: Stamp) -> impl Iterator<Item = &RecentPlace> + '_ {
        self.entered_within(self.settings.memory, now)
            .filter(|occluded| occluded.is_near)
    }

    /// Whether a moving obstacle may still be in the blind spot, at rest or not, and near the robot at a place (odometry frame) by now.
    #[must_use]
    pub fn may_be_in_blind_spot(&self, now: Stamp, robot: Point2<f64>) -> bool {
        let mut entered = self.entered_within(self.settings.memory_backing, now);
        entered.any(|occluded| {
            let secs = now.secs_since(occluded.stamp).max(0.0) + self.settings.near_secs;
            occluded.is_within(2.0 * self.circumscribed_radius + secs * occluded.speed, robot)
        })
    }

    /// Whether nothing has been seen to move since the start, or for as long as somebody in the blind spot is remembered, and nobody went in
    /// there, or was felt there, and may stand there still.
    #[must_use]
    pub fn is_quiet(&self, now: Stamp) -> bool {
        let memory = self.settings.memory_backing;
        self.moved.is_none_or(|moved| now.secs_since(moved) > memory) && self.occluded.iter().next().is_none()
    }

    fn entered_within(&self, secs: f64, now: Stamp) -> impl Iterator<Item = &RecentPlace> + '_ {
        self.occluded
            .iter()
            .filter(move |occluded| now.secs_since(occluded.stamp) <= secs)
    }

    /// Points of moving obstacles, in the base frame of a robot at `odom_from_base`, each as fast as its track or, without one, as is assumed, and on
    /// its way since its beam met it. Without robots that tell their course.
    pub fn in_base(&self, odom_from_base: Pose2) -> impl Iterator<Item = Mover> + '_ {
        let base_from_odom = rigid(odom_from_base.inverse());
        self.detectors.iter().flat_map(move |detector| {
            detector.points.iter().map(move |point| {
                let speed = self.tracks.most_speed_at(*point).unwrap_or(self.fastest);
                Mover {
                    travelled: speed * detector.met_before(*point),
                    ..Mover::at_will(base_from_odom * point, 0.0, speed)
                }
            })
        })
    }

    /// Takes the robots that tell their course: what is known of them need not be guessed.
    pub(crate) fn set_robots(&mut self, robots: impl Iterator<Item = Track>) {
        self.tracks.set_robots(robots);
    }

    /// The tracks of moving obstacles.
    #[must_use]
    pub fn tracks(&self) -> &ObstacleTracks {
        &self.tracks
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::field_of_view::ScanProjector;
    use zenav_protocol::readings::Sweep;
    use zenav_protocol::robot::LidarModel;

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
        zenav_fixtures::sweep(lidar, secs, |angle| {
            let wall = if angle.cos() > 0.2 {
                (3.0 - laser.x) / angle.cos()
            } else {
                f64::INFINITY
            };
            let before = post.filter(|_| angle.abs() < 0.05).map_or(wall, |at| at - laser.x);
            wall.min(before)
        })
    }

    #[test]
    fn a_departed_return_at_the_seam_of_a_full_circle_marks_only_what_lies_behind_it() {
        let robot = zenav_fixtures::robot("neato");
        let lidar = robot.first_lidar().unwrap();
        let mut tracked = none_yet(&robot, 0.3);
        for (secs, nearer) in [(0.0, 0.1), (0.4, 0.0)] {
            let range = |angle: f64| 1.6 - if angle.cos() < -0.99 { nearer } else { 0.0 };
            let sweep = zenav_fixtures::sweep(lidar, secs, range);
            tracked.insert(0, &ScanProjector::new(lidar).project(&sweep, Pose2::IDENTITY).unwrap());
        }
        let points: Vec<_> = tracked.in_base(Pose2::IDENTITY).map(|mover| mover.at).collect();
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
        let (now, long_after) = (Stamp::from_secs(2.0), Stamp::from_secs(100.0));
        assert_eq!([still.is_quiet(now), moving.is_quiet(now)], [true, false]);
        assert!(moving.is_quiet(long_after));
    }

    #[test]
    fn somebody_felt_behind_is_not_forgotten_for_somebody_who_has_been_in_sight_all_along() {
        let robot = zenav_fixtures::robot("tiago");
        let lidar = robot.first_lidar().unwrap();
        let mut moving = none_yet(&robot, 6.0);
        let mut projector = ScanProjector::new(lidar);
        for step in 0..30 {
            let secs = 0.1 * f64::from(step);
            let sweep = sweep(lidar, secs, Pose2::IDENTITY, Some(2.6 - 0.03 * f64::from(step)));
            moving.insert(0, &projector.project(&sweep, Pose2::IDENTITY).unwrap());
            if step == 20 {
                moving.note_occlusion(Point2::new(-0.4, 0.0), Stamp::from_secs(secs));
            }
        }
        assert!(moving.tracks().iter().next().is_some(), "it has not become a track");
        assert_eq!(moving.occluded(Stamp::from_secs(2.9)).count(), 1);
    }

    #[test]
    fn of_two_who_are_hidden_one_who_comes_out_takes_one_along() {
        let robot = zenav_fixtures::robot("tiago");
        let lidar = robot.first_lidar().unwrap();
        let mut moving = none_yet(&robot, 1.4);
        for y in [-0.6, 0.6] {
            moving.note_occlusion(Point2::new(-0.4, y), Stamp::ZERO);
        }
        let mut projector = ScanProjector::new(lidar);
        for step in 1..40 {
            let secs = 0.1 * f64::from(step);
            let sweep = sweep(lidar, secs, Pose2::IDENTITY, Some(2.6 - 0.03 * f64::from(step)));
            moving.insert(0, &projector.project(&sweep, Pose2::IDENTITY).unwrap());
        }
        assert!(moving.tracks().iter().next().is_some(), "it has not become a track");
        assert_eq!(moving.occluded(Stamp::from_secs(4.0)).count(), 1);
    }

    #[test]
    fn somebody_hidden_is_not_forgotten_for_one_whom_only_a_walking_person_could_be() {
        let robot = zenav_fixtures::robot("tiago");
        let lidar = robot.first_lidar().unwrap();
        // The robot's own top speed counts, unless another speed is set.
        for (speed, left) in [(None, 1), (Some(1.4), 0)] {
            let mut settings = EdgeSettings::default();
            settings.passive_safety.speed_out_of_sight = speed;
            let view = FieldOfView::new(robot.first_lidar(), &robot.footprint);
            let mut moving = MovingObstacles::new(&robot, view, &settings);
            moving.note_occlusion(Point2::new(-2.0, 0.0), Stamp::ZERO);
            let mut projector = ScanProjector::new(lidar);
            for step in 1..40 {
                let secs = 0.1 * f64::from(step);
                let sweep = sweep(lidar, secs, Pose2::IDENTITY, Some(2.6 - 0.03 * f64::from(step)));
                moving.insert(0, &projector.project(&sweep, Pose2::IDENTITY).unwrap());
            }
            assert!(moving.tracks().iter().next().is_some(), "it has not become a track");
            assert_eq!(moving.occluded(Stamp::from_secs(3.9)).count(), left, "{speed:?}");
            let hidden = moving.occluded(Stamp::from_secs(3.9)).next();
            assert!(hidden.is_none_or(|hidden| hidden.speed > 1.39), "it may be that fast");
        }
    }

    #[test]
    fn a_track_that_went_in_itself_comes_out_for_nobody_else() {
        let robot = zenav_fixtures::robot("tiago");
        let lidar = robot.first_lidar().unwrap();
        let mut moving = none_yet(&robot, 6.0);
        let mut projector = ScanProjector::new(lidar);
        let mut hidden = false;
        for step in 1..30 {
            let stamp = Stamp::from_secs(0.1 * f64::from(step));
            let sweep = sweep(
                lidar,
                stamp.as_secs(),
                Pose2::IDENTITY,
                Some(2.6 - 0.03 * f64::from(step)),
            );
            moving.insert(0, &projector.project(&sweep, Pose2::IDENTITY).unwrap());
            let track = moving.tracks().iter().next().cloned();
            if let Some(track) = track.filter(|_| !hidden) {
                // One was felt before the track was born, which could be that one; but the track was noted itself.
                hidden = true;
                let at = |of, place, stamp| RecentPlace {
                    place,
                    stamp,
                    speed: 6.0,
                    is_near: true,
                    radius: 0.0,
                    of,
                };
                moving.came_out.clear();
                moving.occluded.note(at(FELT | 1, Point2::new(-0.4, 0.0), Stamp::ZERO));
                moving.occluded.note(at(track.id, track.position, track.seen));
            }
        }
        assert!(hidden, "it has not become a track");
        let left: Vec<u64> = moving.occluded.iter().map(|hidden| hidden.of).collect();
        assert_eq!(left, [FELT | 1]);
    }

    #[test]
    fn somebody_felt_for_a_while_is_not_forgotten_for_somebody_who_was_in_sight_meanwhile() {
        let robot = zenav_fixtures::robot("tiago");
        let lidar = robot.first_lidar().unwrap();
        let mut moving = none_yet(&robot, 6.0);
        let mut projector = ScanProjector::new(lidar);
        for step in 0..30 {
            let secs = 0.1 * f64::from(step);
            // The contact lasts while the robot creeps away from it.
            if step < 15 {
                moving.note_occlusion(Point2::new(-0.4 - 0.02 * f64::from(step), 0.0), Stamp::from_secs(secs));
            }
            let post = (step >= 5).then(|| 2.6 - 0.03 * f64::from(step));
            let sweep = sweep(lidar, secs, Pose2::IDENTITY, post);
            moving.insert(0, &projector.project(&sweep, Pose2::IDENTITY).unwrap());
        }
        assert!(moving.tracks().iter().next().is_some(), "it has not become a track");
        assert!(moving.occluded(Stamp::from_secs(2.9)).next().is_some());
    }

    #[test]
    fn a_track_of_a_lidar_that_sweeps_is_where_its_beams_met_it() {
        let robot = zenav_fixtures::robot("neato");
        let lidar = LidarModel {
            sweep_time: 0.199,
            ..robot.lidar.clone().unwrap()
        };
        let place = |secs: f64| Point2::new(2.0, -1.5 + secs);
        let range = |at: Stamp, beam: usize| {
            // Distance to a disc, seen from the lidar, and to a wall all around.
            let center = place(at.as_secs() - lidar.before_end(beam as f64)) - lidar.mount.position();
            let angle = lidar.angle_min() + beam as f64 * lidar.angle_increment();
            let (sin, cos) = angle.sin_cos();
            let (along, aside) = (center.x * cos + center.y * sin, center.y * cos - center.x * sin);
            let half = 0.0625 - aside * aside;
            (if along > 0.0 && half > 0.0 {
                along - half.sqrt()
            } else {
                4.0
            }) as f32
        };
        let mut robot = robot;
        robot.lidar = Some(lidar.clone());
        let mut moving = none_yet(&robot, 1.5);
        let mut projector = ScanProjector::new(&lidar);
        for step in 1..=15 {
            let stamp = Stamp::from_secs(0.2 * f64::from(step));
            let ranges = (0..lidar.beams).map(|beam| range(stamp, beam)).collect();
            let sweep = Sweep::new(stamp, ranges);
            moving.insert(0, &projector.project(&sweep, Pose2::IDENTITY).unwrap());
        }
        let tracks: Vec<&Track> = moving.tracks().iter().collect();
        assert_eq!(tracks.len(), 1);
        // Straight ahead is in the middle of the sweep: a tenth of a second, and of a metre.
        let off = tracks[0].at(Stamp::from_secs(3.0).secs_since(tracks[0].stamp)) - place(3.0);
        assert!(off.norm() < 0.06, "{off:?}");
    }
}
