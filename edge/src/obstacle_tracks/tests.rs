//! Claims about tracks.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::field_of_view::{FieldOfView, ScanProjector};
use crate::moving_obstacles::MovingObstacles;
use zenav_fixtures::way_to_disc;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::{LidarModel, RobotModel};

/// What a lidar sees of discs in front of a wall at x = 7.
fn sweep(lidar: &LidarModel, secs: f64, base: Pose2, discs: &[Point2<f64>]) -> Sweep {
    let laser = base * lidar.mount;
    let range = |beam: usize| {
        let angle = laser.yaw + lidar.angle_min() + beam as f64 * lidar.angle_increment();
        let ray = Vector2::new(angle.cos(), angle.sin());
        let wall = if ray.x > 0.05 {
            (7.0 - laser.x) / ray.x
        } else {
            f64::INFINITY
        };
        let discs = discs
            .iter()
            .map(|disc| way_to_disc(laser.position(), ray, (*disc, 0.25)));
        discs.fold(wall, f64::min) as f32
    };
    Sweep::new(Stamp::from_secs(secs), (0..lidar.beams).map(range).collect())
}

/// Ten scans a second of a robot that drives at 0.3 m/s past discs that move as `place` says.
pub(crate) fn watch(robot: &RobotModel, secs: f64, place: impl Fn(f64) -> Vec<Point2<f64>>) -> MovingObstacles {
    let lidar = robot.first_lidar().unwrap();
    let view = FieldOfView::new(robot.first_lidar(), &robot.footprint);
    let mut moving = MovingObstacles::new(robot, view, &crate::settings::EdgeSettings::default());
    let mut projector = ScanProjector::new(lidar);
    for step in 0..=(10.0 * secs) as u32 {
        let now = 0.1 * f64::from(step);
        let base = Pose2::new(0.3 * now, 0.0, 0.1 * now);
        moving.insert(
            0,
            &projector.project(&sweep(lidar, now, base, &place(now)), base).unwrap(),
        );
    }
    moving
}

#[test]
fn a_walker_has_a_track_with_its_velocity_and_what_stands_has_none() {
    let robot = zenav_fixtures::robot("tiago");
    let walker = |now: f64| Point2::new(3.0, -1.5 + 0.8 * now);
    let post = Point2::new(2.5, 1.8);
    let moving = watch(&robot, 2.5, |now| vec![walker(now), post]);
    let tracks: Vec<_> = moving.tracks().iter().collect();
    assert_eq!(tracks.len(), 1, "{tracks:?}");
    let off = tracks[0].position - walker(2.5);
    assert!(off.norm() < 0.1, "{off}");
    assert!(
        (tracks[0].velocity - Vector2::new(0.0, 0.8)).norm() < 0.2,
        "{}",
        tracks[0].velocity
    );
    assert!((tracks[0].radius - 0.25).abs() < 0.08, "{}", tracks[0].radius);
    assert!(moving.tracks().at(walker(2.5)).is_some() && moving.tracks().at(post).is_none());
}

#[test]
fn two_walkers_who_meet_keep_their_tracks() {
    let robot = zenav_fixtures::robot("tiago");
    let places = |now: f64| vec![Point2::new(2.5, -1.2 + 0.6 * now), Point2::new(4.2, 1.2 - 0.6 * now)];
    let before: Vec<_> = watch(&robot, 1.2, places).tracks().iter().cloned().collect();
    let moving = watch(&robot, 3.2, places);
    assert_eq!(before.len(), 2, "{before:?}");
    for track in before {
        let after = moving.tracks().iter().find(|after| after.id == track.id);
        let after = after.unwrap_or_else(|| panic!("{} was lost", track.id));
        assert!(after.velocity.dot(&track.velocity) > 0.0, "{after:?} was {track:?}");
    }
}

#[test]
fn a_walker_who_stops_is_an_obstacle_like_any_other_after_a_while() {
    let robot = zenav_fixtures::robot("tiago");
    let settings = TrackingSettings::default();
    let place = |now: f64| vec![Point2::new(3.0, -1.0 + 0.8 * now.min(1.5))];
    assert_eq!(watch(&robot, 1.5, place).tracks().iter().count(), 1);
    assert_eq!(watch(&robot, 3.0 + settings.standing, place).tracks().iter().count(), 0);
}

#[test]
fn a_hidden_track_goes_on_and_one_whose_place_is_empty_ends() {
    let robot = zenav_fixtures::robot("tiago");
    let nowhere = Point2::new(-9.0, 0.0);
    let walker = |now: f64| Point2::new(3.0, -1.5 + 0.8 * now);
    let gone = watch(&robot, 2.6, |now| vec![if now < 2.0 { walker(now) } else { nowhere }]);
    assert_eq!(gone.tracks().iter().count(), 0);
    // A column comes in between.
    let column = |now: f64| Point2::new(1.6, if now < 2.0 { -9.0 } else { 0.25 });
    let hidden = watch(&robot, 2.6, |now| {
        vec![if now < 2.0 { walker(now) } else { nowhere }, column(now)]
    });
    let walkers: Vec<_> = hidden.tracks().iter().filter(|track| track.velocity.y > 0.4).collect();
    assert_eq!(walkers.len(), 1, "{:?}", hidden.tracks());
    assert!((walkers[0].position - walker(2.6)).norm() < 0.2);
}

#[test]
fn a_walker_who_leaves_the_view_or_goes_behind_a_column_keeps_its_velocity() {
    let robot = zenav_fixtures::robot("tiago");
    // Out over the left edge of the view, at 120 degrees.
    let beside = |now: f64| Point2::new(0.8 - 0.8 * now, 1.6);
    for secs in [1.2, 1.6, 2.0, 2.4] {
        let moving = watch(&robot, secs, |now| vec![beside(now)]);
        let track = moving
            .tracks()
            .iter()
            .next()
            .unwrap_or_else(|| panic!("lost after {secs} s"));
        let off = track.velocity - Vector2::new(-0.8, 0.0);
        assert!(off.norm() < 0.25, "after {secs} s: {}", track.velocity);
    }
    let behind = |now: f64| Point2::new(3.0, -1.5 + 0.8 * now);
    for secs in [1.6, 1.8, 2.0, 2.2] {
        let moving = watch(&robot, secs, |now| vec![behind(now), Point2::new(1.9, 0.4)]);
        let track = moving
            .tracks()
            .iter()
            .next()
            .unwrap_or_else(|| panic!("lost after {secs} s"));
        let off = track.velocity - Vector2::new(0.0, 0.8);
        assert!(off.norm() < 0.25, "after {secs} s: {}", track.velocity);
    }
}

#[test]
fn a_wall_that_comes_within_range_does_not_move() {
    let robot = zenav_fixtures::robot("tiago");
    let lidar = robot.first_lidar().unwrap();
    let view = FieldOfView::new(robot.first_lidar(), &robot.footprint);
    let mut moving = MovingObstacles::new(&robot, view, &crate::settings::EdgeSettings::default());
    let mut projector = ScanProjector::new(lidar);
    for step in 0..60 {
        let now = 0.1 * f64::from(step);
        let base = Pose2::new(0.6 * now, 0.0, 0.0);
        let laser = base * lidar.mount;
        let sweep = zenav_fixtures::sweep(lidar, now, |angle| {
            let range = (7.0 - laser.x) / angle.cos();
            let is_seen = (0.0..lidar.range_max).contains(&range);
            if is_seen { range } else { f64::INFINITY }
        });
        moving.insert(0, &projector.project(&sweep, base).unwrap());
        assert_eq!(moving.tracks().iter().count(), 0, "after {now} s");
    }
}

#[test]
fn walls_around_the_robot_are_no_disc_where_they_end_behind_it() {
    let robot = zenav_fixtures::robot("turtlebot3_waffle");
    let lidar = robot.first_lidar().unwrap();
    // The dead end of a lane 0.7 m wide, which is open behind.
    let sweep = zenav_fixtures::sweep(lidar, 1.0, |angle| {
        let (sin, cos) = angle.sin_cos();
        match cos > 0.0 {
            true => (0.35 / sin.abs()).min(0.6 / cos),
            false if sin.abs() < 0.25 => f64::INFINITY,
            false => 0.35 / sin.abs(),
        }
    });
    let mut projector = ScanProjector::new(lidar);
    let scan = projector.project(&sweep, Pose2::IDENTITY).unwrap();
    let mut tracks = ObstacleTracks::new(&TrackingSettings::default());
    tracks.cut(&scan, &vec![true; lidar.beams]);
    assert!(tracks.segments.is_empty(), "{:?}", tracks.segments);
}

/// The lidar tracks after some seconds of a robot at rest in a room, among discs (centers and radii) and a robot that says to be at the place
/// of that time.
fn beside_robot(
    secs: f64,
    told: impl Fn(f64) -> Point2<f64>,
    discs: impl Fn(f64) -> Vec<(Point2<f64>, f64)>,
) -> MovingObstacles {
    let robot = zenav_fixtures::robot("tiago");
    let lidar = robot.first_lidar().unwrap();
    let view = FieldOfView::new(robot.first_lidar(), &robot.footprint);
    let mut moving = MovingObstacles::new(&robot, view, &crate::settings::EdgeSettings::default());
    let mut projector = ScanProjector::new(lidar);
    for step in 0..=(10.0 * secs).round() as u32 {
        let now = 0.1 * f64::from(step);
        let course = Course {
            places: vec![told(now)],
            step: 0.4,
            ..Course::default()
        };
        let stamp = Stamp::from_secs(now);
        let other = Track::of_robot(1 << 48, 0.27, Vector2::zeros(), stamp, course);
        moving.set_robots(std::iter::once(other));
        let sweep = zenav_fixtures::sweep_in_room(lidar, now, Pose2::IDENTITY, (5.0, 5.0), &discs(now));
        moving.insert(0, &projector.project(&sweep, Pose2::IDENTITY).unwrap());
    }
    moving
}

#[test]
fn who_walks_closely_past_a_robot_that_is_where_it_says_keeps_a_track() {
    let other = Point2::new(3.0, 0.0);
    // A leg, 0.15 m beside the robot's disc at the end.
    let leg = |now: f64| Point2::new(4.6 - 0.8 * now, -0.5);
    let moving = beside_robot(2.0, |_| other, |now| vec![(other, 0.25), (leg(now), 0.08)]);
    let tracks: Vec<_> = moving.tracks().iter().filter(|track| !track.is_robot()).collect();
    assert_eq!(tracks.len(), 1, "{tracks:?}");
    assert!((tracks[0].position - leg(2.0)).norm() < 0.1, "{:?}", tracks[0]);
    assert!(!moving.tracks().is_by_robot(leg(2.0)) && moving.tracks().is_by_robot(other));
}

#[test]
fn a_robot_beside_the_place_that_it_told_has_no_track_of_its_own() {
    let body = |now: f64| Point2::new(3.5 - 0.4 * now, 0.5);
    let told = |now: f64| body(now) - Vector2::new(0.2, 0.0);
    for secs in [1.0, 2.0, 3.0] {
        let moving = beside_robot(secs, told, |now| vec![(body(now), 0.25)]);
        assert!(moving.tracks().iter().all(Track::is_robot), "after {secs} s");
    }
}
