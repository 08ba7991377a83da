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

/// A point this near to a track's disc belongs to it, m.
const ON_TRACK: f64 = 0.2;

/// Two obstacles with no more than this between their discs may be one track, m.
const BETWEEN: f64 = 0.25;

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
        self.note_lost(&places, scan, near);
        for place in places {
            let track = self.track_at(place, now);
            // Where a track is only expected, what is there may be another one.
            let is_seen = track.is_some_and(|track| track.seen == now || track.is_robot());
            let track = track.map(|track| (track.id, track.born, track.sure_radius()));
            let speed = self.tracks.most_speed_at(place).unwrap_or(self.fastest_out_of_sight);
            let was_near = match track {
                Some((id, born, _)) if is_seen => {
                    self.supersede(id, born, place, speed, now, FEW_SCANS / scan.lidar.rate_hz)
                }
                _ => false,
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

    /// Notes the tracks that the scan does not show, but that may be in one that it shows at these places beside the blind spot: two obstacles
    /// that overlap look like one, and either may go in. Each is noted once, and what was noted of it before stays: it may have gone in there.
    fn note_lost(&mut self, places: &[Point2<f64>], scan: &ProjectedScan<'_>, near: f64) {
        let (now, base_from_odom) = (scan.stamp, scan.odom_from_base.inverse());
        let to_blind_spot = |place: &Point2<f64>| self.view.distance_to_blind_spot(base_from_odom * place);
        let is_lost = |track: &&Track| track.seen < now && !track.is_robot();
        let note = |lost: &Track| {
            let may_hide = |track: &Track| {
                let between = (track.position - lost.position).norm() - track.radius - lost.radius;
                track.seen == now && between <= BETWEEN
            };
            let hides = |place: &&Point2<f64>| self.track_at(**place, now).is_some_and(may_hide);
            let place = *places
                .iter()
                .filter(hides)
                .min_by(|a, b| to_blind_spot(a).total_cmp(&to_blind_spot(b)))?;
            let speed = self.tracks.most_speed_at(place).unwrap_or(self.fastest_out_of_sight);
            Some(RecentPlace {
                place,
                stamp: now,
                speed: speed.max(lost.most_speed()),
                is_near: (place - scan.laser()).norm() <= near,
                radius: lost.sure_radius().min(SURE_RADIUS),
                of: lost.id,
            })
        };
        let noted: Vec<RecentPlace> = self.tracks.iter().filter(is_lost).filter_map(note).collect();
        noted.into_iter().for_each(|place| self.occluded.note(place));
    }

    /// The track that a place (odometry frame) of the newest scan belongs to: rather one that the scan shows.
    fn track_at(&self, place: Point2<f64>, now: Stamp) -> Option<&Track> {
        let off = |track: &Track| (place - track.position).norm() - track.radius;
        let seen = self.tracks.seen(now).filter(|track| off(track) <= ON_TRACK);
        let nearest = seen.min_by(|a, b| off(a).total_cmp(&off(b)));
        nearest.or_else(|| self.tracks.at(place))
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
mod tests;
