//! Local obstacle memory. Which obstacles are around the robot, and which of them move? The newest sweep of every lidar, and in the blind
//! spot what earlier sweeps saw; and what the robot has touched that no beam shows (`contact_memory`).
//!
//! Points lie on surfaces, as far as the noise of single beams allows (`range_filter`). They are kept in the odometry frame: it is
//! continuous, so a correction of the map never moves an obstacle.

use std::collections::VecDeque;

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::blind_corners::{self, BlindCorner};
use crate::blind_spot_grid::BlindSpotGrid;
use crate::contact_memory::ContactMemory;
use crate::field_of_view::{FieldOfView, ProjectedScan, ScanProjector, nearest_beam, rigid};
use crate::moving_obstacles::MovingObstacles;
use crate::obstacle_tracks::Track;
use crate::passive_safety::Hidden;
use crate::range_filter::RangeFilter;
use crate::settings::{EdgeSettings, LocalObstacleSettings};

/// A sweep is missing if none has come for longer than this, in periods of the lidar.
const MISSING: f64 = 1.5;
/// A return this near to a robot's disc belongs to that robot, m.
const ON_ROBOT: f64 = 0.1;
/// Anything that moves this near to a contact is what was touched, m.
const MOVES: f64 = 0.5;

/// Obstacle points around the robot.
#[derive(Clone, Debug)]
pub struct LocalObstacles {
    lidars: Vec<LidarView>,
    view: FieldOfView,
    /// Where the robot was at the newest sweep.
    odom_from_base: Isometry2<f64>,
    /// Points that lie in the present blind spot, until they are seen again or left behind.
    remembered: VecDeque<Point2<f64>>,
    /// The present contact point.
    touched: Option<Point2<f64>>,
    /// What was touched and no beam shows.
    contacts: ContactMemory,
    /// Radius of a person who may stand behind a corner, m.
    person_radius: f64,
    moving: MovingObstacles,
    blind_spots: BlindSpotGrid,
    settings: LocalObstacleSettings,
}

/// What one lidar sees.
#[derive(Clone, Debug)]
struct LidarView {
    name: String,
    projector: ScanProjector,
    /// When its newest sweep was taken.
    stamp: Option<Stamp>,
    /// The returns of its newest sweep, odometry frame.
    seen: Vec<Point2<f64>>,
    /// Pose of the lidar at that sweep.
    odom_from_laser: Isometry2<f64>,
    /// Its ranges, with the noise filtered out.
    filter: RangeFilter,
    /// Corners behind which its newest sweep leaves room for a person.
    corners: Vec<BlindCorner>,
}

impl LidarView {
    /// Whether a beam of the newest sweep passes through a place (odometry frame).
    fn passes(&self, place: Point2<f64>) -> bool {
        let model = self.projector.lidar();
        let local = self.odom_from_laser.inverse() * place;
        let angle = local.y.atan2(local.x) - model.angle_min();
        let beam = nearest_beam(model, angle);
        let range = beam.and_then(|beam| self.filter.ranges().get(beam));
        range.is_some_and(|range| f64::from(*range) > local.coords.norm())
    }
}

impl LocalObstacles {
    /// Nothing seen yet, default settings.
    #[must_use]
    pub fn new(model: &RobotModel) -> Self {
        Self::with_settings(model, &EdgeSettings::default())
    }

    /// Nothing seen yet.
    #[must_use]
    pub fn with_settings(model: &RobotModel, settings: &EdgeSettings) -> Self {
        let view = FieldOfView::new(model.all_lidars().map(|(_, lidar)| lidar), &model.footprint);
        let lidars = model.all_lidars().map(|(name, lidar)| LidarView {
            name: name.to_owned(),
            projector: ScanProjector::new(lidar),
            stamp: None,
            seen: Vec::new(),
            odom_from_laser: Isometry2::identity(),
            filter: RangeFilter::new(lidar.angle_increment(), lidar.noise),
            corners: Vec::new(),
        });
        Self {
            lidars: lidars.collect(),
            odom_from_base: Isometry2::identity(),
            remembered: VecDeque::new(),
            touched: None,
            contacts: ContactMemory::new(
                &model.footprint,
                settings.local_obstacles.range,
                settings.contact_memory,
            ),
            person_radius: settings.passive_safety.person_radius,
            moving: MovingObstacles::new(model, view.clone(), settings),
            blind_spots: BlindSpotGrid::new(view.clone(), &model.footprint, settings),
            view,
            settings: settings.local_obstacles.clone(),
        }
    }

    /// Takes a sweep, with the robot's odometry at the sweep's stamp. Returns whether it was accepted: a sweep of an unknown lidar, with
    /// another number of beams, or not newer than that lidar's last, is ignored.
    pub fn insert(&mut self, sweep: &Sweep, odom_from_base: Pose2) -> bool {
        let Some(index) = self.lidars.iter().position(|lidar| lidar.name == sweep.lidar) else {
            return false;
        };
        let Some(LidarView {
            projector,
            stamp,
            seen,
            odom_from_laser,
            filter,
            corners,
            ..
        }) = self.lidars.get_mut(index)
        else {
            return false;
        };
        if stamp.is_some_and(|last| sweep.stamp <= last) {
            return false;
        }
        let Some(scan) = projector.project(sweep, odom_from_base) else {
            return false;
        };
        if self.view.has_blind_spot() {
            let gap = self.settings.scan_gap.max(MISSING / scan.lidar.rate_hz);
            if stamp.is_some_and(|last| sweep.stamp.secs_since(last) > gap) {
                self.moving.note_occlusion(odom_from_base.position(), sweep.stamp);
            }
            let base_from_odom = scan.odom_from_base.inverse();
            // A robot that announces its course need not be remembered.
            let robots = self.moving.tracks();
            seen.retain(|point| robots.robot_at(*point).is_none());
            remember(&mut self.remembered, seen, &self.view, base_from_odom, &self.settings);
        }
        let unseen = kept_at_the_ends(seen, &scan);
        seen.clear();
        *odom_from_laser = scan.odom_from_laser;
        filter.update(&sweep.ranges, |range| scan.is_return(range));
        let laser = scan.laser();
        for (range, ray) in filter.ranges().iter().zip(scan.rays) {
            let range = f64::from(*range);
            if scan.is_return(range) {
                seen.push(laser + ray * range);
            }
        }
        seen.extend(unseen);
        self.moving.insert(index, &scan);
        let tracks = self.moving.tracks();
        let moves = |corner: Point2<f64>| tracks.at(corner).is_some();
        blind_corners::find(&scan, filter.ranges(), self.person_radius, moves, corners);
        self.blind_spots.insert(&scan);
        *stamp = Some(sweep.stamp);
        self.odom_from_base = scan.odom_from_base;
        self.judge_contact(index);
        true
    }

    /// Remembers the present contact if the beams of a lidar's newest sweep, taken while it lasted, pass through it, and nothing seen or
    /// moving is near.
    fn judge_contact(&mut self, index: usize) {
        let Some(lidar) = self.lidars.get(index) else { return };
        let sweep_time = lidar.projector.lidar().sweep_time.abs();
        let begun = lidar.stamp.map(|stamp| stamp.plus_secs(-sweep_time));
        let Some(contact) = begun.and_then(|begun| self.contacts.lasting(begun)) else {
            return;
        };
        let is_shown = |point: &Point2<f64>| self.contacts.is_shown_at(&contact, *point);
        let is_seen = || self.lidars.iter().flat_map(|lidar| &lidar.seen).any(is_shown);
        let moves = |track: &Track| (track.position - contact.place).norm() <= track.radius + MOVES;
        if lidar.passes(contact.behind()) && !is_seen() && !self.moving.tracks().iter().any(moves) {
            self.contacts.remember(&contact);
        }
    }

    /// Takes the bumper's present contact point (base frame): an obstacle while the contact lasts. In the blind spot it counts as a moving
    /// one; elsewhere it is remembered if no beam shows it, unless the place is a guess (`is_felt` is false).
    pub fn touch(&mut self, now: Stamp, place: Option<Point2<f64>>, is_felt: bool, odom_from_base: Pose2) {
        self.touched = place.map(|place| odom_from_base.transform_point(place));
        match place {
            None => self.contacts.forget(now, odom_from_base),
            Some(place) if is_felt && !self.view.in_blind_spot(place) => {
                self.contacts.touch(now, place, odom_from_base);
            }
            Some(_) => {}
        }
        if let Some((place, touched)) = place.zip(self.touched)
            && self.view.in_blind_spot(place)
        {
            self.moving.note_occlusion(touched, now);
        }
    }

    /// Age of the view, s: that of the lidar whose newest sweep is the oldest; `None` until every lidar has sent one.
    #[must_use]
    pub fn age(&self, now: Stamp) -> Option<f64> {
        self.oldest().map(|stamp| now.secs_since(stamp))
    }

    /// Stamp of the oldest of the lidars' newest sweeps; `None` until every lidar has sent one.
    #[must_use]
    pub fn oldest(&self) -> Option<Stamp> {
        let stamps = self.lidars.iter().map(|lidar| lidar.stamp);
        stamps.reduce(|oldest, stamp| Some(oldest?.min(stamp?))).flatten()
    }

    /// Stamp of the newest sweep of any lidar.
    #[must_use]
    pub fn stamp(&self) -> Option<Stamp> {
        self.lidars.iter().filter_map(|lidar| lidar.stamp).max()
    }

    /// All known points in the base frame of a robot at `odom_from_base`.
    pub fn in_base(&self, odom_from_base: Pose2) -> impl Iterator<Item = Point2<f64>> + '_ {
        let base_from_odom = rigid(odom_from_base.inverse());
        self.in_odom().map(move |point| base_from_odom * point)
    }

    /// All known points in the odometry frame.
    fn in_odom(&self) -> impl Iterator<Item = Point2<f64>> + '_ {
        let seen = self.lidars.iter().flat_map(|lidar| &lidar.seen);
        let unseen = self
            .remembered
            .iter()
            .chain(&self.touched)
            .chain(self.contacts.points());
        seen.chain(unseen).copied()
    }

    /// The known points that are on no track, in the odometry frame.
    pub fn standing(&self) -> impl Iterator<Item = Point2<f64>> + '_ {
        self.in_odom().filter(|point| self.moving.tracks().at(*point).is_none())
    }

    /// Whether a beam of a newest sweep passes through a place (odometry frame).
    #[must_use]
    pub fn is_seen_free(&self, place: Point2<f64>) -> bool {
        self.lidars.iter().any(|lidar| lidar.passes(place))
    }

    /// The points of all lidars' newest sweeps that are on no track, and what was touched and no beam shows, in another frame.
    pub fn standing_in(&self, frame_from_odom: Pose2) -> impl Iterator<Item = Point2<f64>> + '_ {
        let frame_from_odom = rigid(frame_from_odom);
        let seen = self.lidars.iter().flat_map(|lidar| &lidar.seen);
        let standing = seen.filter(|point| self.moving.tracks().at(**point).is_none());
        standing
            .chain(self.contacts.points())
            .map(move |point| frame_from_odom * point)
    }

    /// The runs of beams of a lidar's newest sweep that hit a tracked obstacle: the first beam, and the one after the last.
    #[must_use]
    pub fn moving_beams(&self, lidar: &str) -> Vec<[u32; 2]> {
        let mut runs: Vec<[u32; 2]> = Vec::new();
        let tracks = self.moving.tracks();
        let Some(lidar) = self.lidars.iter().find(|known| known.name == lidar) else {
            return runs;
        };
        if tracks.iter().next().is_none() {
            return runs;
        }
        let rays = lidar.projector.rays();
        let laser = Point2::from(lidar.odom_from_laser.translation.vector);
        for (beam, (range, ray)) in (0_u32..).zip(lidar.filter.ranges().iter().zip(rays)) {
            if !range.is_finite() || tracks.at(laser + ray * f64::from(*range)).is_none() {
                continue;
            }
            match runs.last_mut().filter(|run| run[1] == beam) {
                Some(run) => run[1] += 1,
                None => runs.push([beam, beam + 1]),
            }
        }
        runs
    }

    /// Takes the robots that announce their course.
    pub(crate) fn set_robots(&mut self, robots: impl Iterator<Item = Track>) {
        self.moving.set_robots(robots);
    }

    /// Points of robots that announce their course within a distance (m), in the base frame of a robot at `odom_from_base`, each with its
    /// velocity over the floor, m/s: the returns on them, and the near side of those in the blind spot.
    #[must_use]
    pub fn robots_in_base(&self, odom_from_base: Pose2, within: f64) -> Vec<(Point2<f64>, Vector2<f64>)> {
        let (here, base_from_odom) = (odom_from_base.position(), rigid(odom_from_base.inverse()));
        let robots = self.moving.tracks().robots().iter();
        let mut points = Vec::new();
        for robot in robots.filter(|robot| (robot.position - here).norm() <= within + robot.radius) {
            let velocity = base_from_odom * robot.velocity;
            let on = |point: &Point2<f64>| (point - robot.position).norm() <= robot.radius + ON_ROBOT;
            let seen = self.in_odom().filter(on).map(|point| base_from_odom * point);
            points.extend(seen.map(|point| (point, velocity)));
            let center = base_from_odom * robot.position;
            if self.view.in_blind_spot(center) {
                let toward = -center.coords.try_normalize(1e-6).unwrap_or_else(Vector2::x);
                let side = Vector2::new(-toward.y, toward.x);
                let near =
                    [-1.2, -0.8, -0.4, 0.0, 0.4, 0.8, 1.2_f64].map(|angle| toward * angle.cos() + side * angle.sin());
                points.extend(near.map(|off| (center + off * robot.radius, velocity)));
            }
        }
        points
    }

    /// Corners behind which a person may stand, unseen by every lidar, and come out.
    pub(crate) fn blind_corners(&self) -> impl Iterator<Item = &BlindCorner> {
        let corners = self.lidars.iter().flat_map(|lidar| &lidar.corners);
        corners.filter(|corner| !self.is_seen_free(corner.place))
    }

    /// What was touched lately and no beam shows, as straight lines: what is known of a surface, and how far it is assumed to go; x and y of
    /// either end, m, in the base frame of a robot at `odom_from_base`.
    #[must_use]
    pub fn touched_lines(&self, now: Stamp, odom_from_base: Pose2) -> Vec<[[f64; 4]; 2]> {
        self.contacts.lines(now, odom_from_base)
    }

    /// Forgets what was touched: odometry does not tell where the robot has been.
    pub(crate) fn forget_touched(&mut self) {
        self.contacts.clear();
    }

    /// The filtered ranges of a lidar's newest sweep, m; empty before its first.
    #[must_use]
    pub fn ranges(&self, lidar: &str) -> &[f32] {
        let known = self.lidars.iter().find(|known| known.name == lidar);
        known.map_or(&[], |lidar| lidar.filter.ranges())
    }

    /// Share of beams with a return in the newest sweep of the lidar that sees most; 1 before the first.
    pub(crate) fn in_sight(&self) -> f64 {
        let share = |lidar: &LidarView| lidar.seen.len() as f64 / lidar.filter.ranges().len().max(1) as f64;
        self.lidars
            .iter()
            .filter(|lidar| lidar.stamp.is_some())
            .map(share)
            .reduce(f64::max)
            .unwrap_or(1.0)
    }

    /// The points of each lidar's newest sweep in the order of its beams, odometry frame; after them, earlier points that it did not cover.
    pub fn seen_by_lidar(&self) -> impl Iterator<Item = &[Point2<f64>]> {
        self.lidars.iter().map(|lidar| &lidar.seen[..])
    }

    /// The moving obstacles among them.
    #[must_use]
    pub fn moving(&self) -> &MovingObstacles {
        &self.moving
    }

    /// Duration of the longest sweep of a lidar, s: a beam may have hit a moving obstacle this long before the sweep's stamp.
    #[must_use]
    pub fn sweep_time(&self) -> f64 {
        let sweeps = self.lidars.iter().map(|lidar| lidar.projector.lidar().sweep_time.abs());
        sweeps.fold(0.0, f64::max)
    }

    /// The moving obstacles that have left the field of view near the robot.
    pub fn hidden(&self, now: Stamp) -> impl Iterator<Item = Hidden> + '_ {
        let base_from_odom = self.odom_from_base.inverse();
        let sweep_time = self.sweep_time();
        self.moving.occluded(now).map(move |seen| Hidden {
            last_seen: base_from_odom * seen.place,
            travelled: seen.speed * (now.secs_since(seen.stamp).max(0.0) + sweep_time),
            radius: seen.radius,
            speed: seen.speed,
        })
    }

    /// Where the robot was when the newest sweep was taken, odometry frame.
    pub(crate) fn base_at_newest_sweep(&self) -> Isometry2<f64> {
        self.odom_from_base
    }

    /// Depth of a place (base frame of the newest sweep) out of sight, m: a disc is hidden only if its center lies deeper than its radius.
    pub(crate) fn depth_out_of_sight(&self, place: Point2<f64>) -> f64 {
        self.view.depth(place)
    }

    /// The floor known to be free in the blind spot.
    #[must_use]
    pub fn blind_spots(&self) -> &BlindSpotGrid {
        &self.blind_spots
    }
}

/// Points of a lidar's previous sweep that this one did not cover: while the robot turns against the sweep, the sweep leaves out as much of
/// the circle as the robot turns.
fn kept_at_the_ends(before: &[Point2<f64>], scan: &ProjectedScan<'_>) -> Vec<Point2<f64>> {
    let is_seen = |range: &f32| *range != 0.0;
    let (Some(first), Some(last)) = (
        scan.ranges.iter().position(is_seen),
        scan.ranges.iter().rposition(is_seen),
    ) else {
        return Vec::new();
    };
    if scan.lidar.sweep_time == 0.0 || first == 0 && last + 1 == scan.ranges.len() {
        return Vec::new();
    }
    let at_ends = |point: &&Point2<f64>| {
        let beam = scan.beam_to(**point).map_or(first, |(beam, _)| beam);
        beam < first || beam > last && beam < scan.ranges.len()
    };
    before.iter().filter(at_ends).copied().collect()
}

/// Keeps the known points that lie in the present blind spot.
fn remember(
    remembered: &mut VecDeque<Point2<f64>>,
    seen: &[Point2<f64>],
    view: &FieldOfView,
    base_from_odom: Isometry2<f64>,
    settings: &LocalObstacleSettings,
) {
    let blind = |point: &Point2<f64>| {
        let place = base_from_odom * point;
        view.in_blind_spot(place) && place.coords.norm_squared() < settings.range * settings.range
    };
    remembered.retain(blind);
    let mut last = Point2::new(f64::INFINITY, 0.0);
    for point in seen.iter().filter(|point| blind(point)) {
        if (point - last).norm_squared() < settings.spacing * settings.spacing {
            continue;
        }
        last = *point;
        if remembered.len() >= settings.max_points {
            remembered.pop_front();
        }
        remembered.push_back(*point);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn tiago() -> RobotModel {
        zenav_fixtures::robot("tiago")
    }

    fn sweep(model: &RobotModel, secs: f64, hit: Option<(usize, f32)>) -> Sweep {
        let mut ranges = vec![f32::INFINITY; model.first_lidar().unwrap().beams];
        if let Some((beam, range)) = hit {
            ranges[beam] = range;
        }
        Sweep::new(Stamp::from_secs(secs), ranges)
    }

    #[test]
    fn a_full_circle_is_seen_free_all_around_at_its_seam_too() {
        let model = zenav_fixtures::robot("neato");
        let lidar = model.first_lidar().unwrap();
        let mut obstacles = LocalObstacles::new(&model);
        assert!(obstacles.insert(&zenav_fixtures::sweep(lidar, 1.0, |_| 2.0), Pose2::IDENTITY));
        for step in 0..3600_u32 {
            let (sin, cos) = (0.1 * f64::from(step) + 0.05).to_radians().sin_cos();
            let place = lidar.mount.transform_point(Point2::new(cos, sin));
            assert!(obstacles.is_seen_free(place), "{place:?}");
        }
    }

    #[test]
    fn a_point_that_leaves_the_field_of_view_is_remembered_until_it_is_left_behind() {
        let model = tiago();
        let mut obstacles = LocalObstacles::new(&model);
        assert!(obstacles.insert(&sweep(&model, 1.0, Some((333, 0.6))), Pose2::IDENTITY));
        let behind = Pose2::new(0.0, 0.0, std::f64::consts::PI);
        assert!(obstacles.insert(&sweep(&model, 1.1, None), behind));
        let points: Vec<_> = obstacles.in_base(behind).collect();
        assert_eq!(points.len(), 1);
        assert!((points[0].x + 0.8).abs() < 1e-3, "now behind: {:?}", points[0]);
        assert!(obstacles.insert(&sweep(&model, 100.0, None), behind));
        assert_eq!(obstacles.in_base(behind).count(), 1, "nobody has looked again");
        let gone = Pose2::new(-4.0, 0.0, std::f64::consts::PI);
        assert!(obstacles.insert(&sweep(&model, 110.0, None), gone));
        assert_eq!(obstacles.in_base(gone).count(), 0);
    }

    #[test]
    fn a_point_back_in_view_is_not_remembered() {
        let model = tiago();
        let mut obstacles = LocalObstacles::new(&model);
        obstacles.insert(&sweep(&model, 1.0, Some((333, 0.6))), Pose2::IDENTITY);
        obstacles.insert(&sweep(&model, 1.1, None), Pose2::IDENTITY);
        assert_eq!(obstacles.in_base(Pose2::IDENTITY).count(), 0);
    }

    #[test]
    fn what_is_felt_in_view_is_remembered_only_if_no_beam_shows_it() {
        let model = tiago();
        let at = |x: f64, is_felt: bool, hit: Option<(usize, f32)>| {
            let mut obstacles = LocalObstacles::new(&model);
            obstacles.insert(&sweep(&model, 1.0, hit), Pose2::IDENTITY);
            for tick in 0..10 {
                let now = Stamp::from_secs(1.0 + 0.02 * f64::from(tick));
                obstacles.touch(now, Some(Point2::new(x, 0.0)), is_felt, Pose2::IDENTITY);
            }
            for nth in 2..10 {
                obstacles.insert(&sweep(&model, 1.0 + 0.1 * f64::from(nth), hit), Pose2::IDENTITY);
            }
            let end = Stamp::from_secs(1.9);
            obstacles.touch(end, None, false, Pose2::IDENTITY);
            obstacles.insert(&sweep(&model, 2.0, None), Pose2::IDENTITY);
            let lines = obstacles.touched_lines(end, Pose2::new(1.0, 0.0, 0.0));
            (obstacles.standing().count(), lines)
        };
        let (points, lines) = at(0.266, true, None);
        assert!(points > 10);
        let [[known, [ax, ay, bx, by]]] = lines[..] else {
            panic!("{lines:?}")
        };
        assert!((ax + 0.734).abs() < 1e-6 && (bx - ax).abs() < 1e-6 && (ay + by).abs() < 1e-6);
        assert!((by - ay).abs() > 0.7, "{ay} {by}");
        assert!((known[0] + 0.734).abs() < 1e-6 && (known[1] - known[3]).abs() < 1e-6);
        assert_eq!(at(0.266, false, None), (0, Vec::new()), "a bumper without a bearing");
        for range in [0.066, 0.19] {
            let shown = at(0.266, true, Some((333, range)));
            assert_eq!(shown, (0, Vec::new()), "a beam shows it");
        }
        assert_eq!(at(-0.266, true, None), (0, Vec::new()), "nothing is seen there anyway");
    }

    #[test]
    fn what_was_touched_is_forgotten_when_the_robot_is_found_elsewhere() {
        let model = tiago();
        let mut obstacles = LocalObstacles::new(&model);
        obstacles.touch(
            Stamp::from_secs(1.0),
            Some(Point2::new(0.266, 0.0)),
            true,
            Pose2::IDENTITY,
        );
        obstacles.insert(&sweep(&model, 1.05, None), Pose2::IDENTITY);
        obstacles.touch(Stamp::from_secs(1.1), None, false, Pose2::IDENTITY);
        assert!(obstacles.standing().count() > 10);
        obstacles.forget_touched();
        assert_eq!(obstacles.standing().count(), 0);
    }

    #[test]
    fn a_malformed_scan_is_ignored() {
        let model = tiago();
        let mut obstacles = LocalObstacles::new(&model);
        assert!(!obstacles.insert(&Sweep::new(Stamp(5), vec![1.0; 3]), Pose2::IDENTITY));
        let stranger = Sweep {
            lidar: "rear".to_owned(),
            ..sweep(&model, 0.5, None)
        };
        assert!(!obstacles.insert(&stranger, Pose2::IDENTITY));
        assert_eq!(obstacles.age(Stamp(6)), None);
        assert!(obstacles.insert(&sweep(&model, 1.0, Some((0, f32::NAN))), Pose2::IDENTITY));
        assert_eq!(obstacles.in_base(Pose2::IDENTITY).count(), 0);
        assert!(
            !obstacles.insert(&sweep(&model, 1.0, None), Pose2::IDENTITY),
            "the same stamp twice"
        );
    }

    #[test]
    fn every_lidar_is_heard_and_the_oldest_sweep_says_how_old_all_is() {
        let model = RobotModel::with_options("jackal+rear_lidar", |name| Err(name.to_owned())).unwrap();
        let mut obstacles = LocalObstacles::new(&model);
        let rear = |secs: f64, range: f32| {
            let mut rear = Sweep::new(Stamp::from_secs(secs), vec![f32::INFINITY; 720]);
            rear.lidar = "rear".to_owned();
            rear.ranges[360] = range;
            rear
        };
        assert!(obstacles.insert(&sweep(&model, 1.0, Some((360, 1.0))), Pose2::IDENTITY));
        assert_eq!(
            obstacles.age(Stamp::from_secs(1.0)),
            None,
            "the rear lidar has not looked yet"
        );
        assert!(obstacles.insert(&rear(0.9, 2.0), Pose2::IDENTITY));
        assert!((obstacles.age(Stamp::from_secs(1.0)).unwrap() - 0.1).abs() < 1e-9);
        assert_eq!(obstacles.stamp(), Some(Stamp::from_secs(1.0)));
        let seen: Vec<f64> = obstacles
            .in_base(Pose2::IDENTITY)
            .map(|point| (100.0 * point.x).round())
            .collect();
        assert_eq!(seen, [112.0, -215.0]);
        assert!(obstacles.insert(&rear(1.1, f32::INFINITY), Pose2::IDENTITY));
        assert_eq!(
            obstacles.in_base(Pose2::IDENTITY).count(),
            1,
            "the rear lidar sees that it has gone"
        );
    }

    #[test]
    fn what_a_sweep_left_out_because_the_robot_turned_against_it_is_kept_for_that_long() {
        let mut model = zenav_fixtures::robot("neato");
        for sweep_time in [0.199, 0.0] {
            model.lidar.as_mut().unwrap().sweep_time = sweep_time;
            let mut obstacles = LocalObstacles::new(&model);
            let mut ranges = vec![1.0; 360];
            assert!(obstacles.insert(&Sweep::new(Stamp::from_secs(1.0), ranges.clone()), Pose2::IDENTITY));
            ranges[..30].fill(0.0);
            assert!(obstacles.insert(&Sweep::new(Stamp::from_secs(1.2), ranges.clone()), Pose2::IDENTITY));
            let kept = if sweep_time > 0.0 { 360 } else { 330 };
            assert_eq!(obstacles.in_base(Pose2::IDENTITY).count(), kept);
            // Seen again, and nothing is there any more.
            ranges[..30].fill(f32::INFINITY);
            assert!(obstacles.insert(&Sweep::new(Stamp::from_secs(1.4), ranges), Pose2::IDENTITY));
            assert_eq!(obstacles.in_base(Pose2::IDENTITY).count(), 330);
        }
    }
}
