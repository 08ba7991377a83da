//! Claims about moving obstacles that went out of sight.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::collections::HashSet;

use super::*;
use crate::field_of_view::ScanProjector;
use nalgebra::Vector2;
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

/// What a Jackal at rest has seen for some seconds of outlines with this range along a ray.
fn beside_jackal(secs: f64, range: impl Fn(f64, Point2<f64>, Vector2<f64>) -> f64) -> MovingObstacles {
    let robot = zenav_fixtures::robot("jackal");
    let lidar = robot.first_lidar().unwrap();
    let view = FieldOfView::new(robot.first_lidar(), &robot.footprint);
    let mut moving = MovingObstacles::new(&robot, view, &EdgeSettings::default());
    let mut projector = ScanProjector::new(lidar);
    let laser = lidar.mount.position();
    for step in 1..=(20.0 * secs) as u32 {
        let now = 0.05 * f64::from(step);
        let sweep = zenav_fixtures::sweep(lidar, now, |angle| {
            range(now, laser, Vector2::new(angle.cos(), angle.sin()))
        });
        moving.insert(0, &projector.project(&sweep, Pose2::IDENTITY).unwrap());
    }
    moving
}

/// What it has seen of two: one walks along its left side almost to the blind spot, at this distance, and turns round; the other one overtakes
/// at another distance and a speed, from a place ahead. Returns also where that one is at last.
fn of_two(secs: f64, (stays, passes): (f64, f64), (speed, from): (f64, f64)) -> (MovingObstacles, Point2<f64>) {
    let turn = 2.6;
    let turns_round = |now: f64| Point2::new(0.8 - 0.6 * turn + 0.6 * (now - turn).abs(), stays);
    let goes_in = |now: f64| Point2::new(from - speed * now, passes - 0.6 * (now - turn).clamp(0.0, 1.0));
    let seen = beside_jackal(secs, |now, laser, ray| {
        let first = zenav_fixtures::way_to_disc(laser, ray, (turns_round(now), 0.3));
        first.min(zenav_fixtures::way_to_disc(laser, ray, (goes_in(now), 0.3)))
    });
    (seen, goes_in(secs))
}

/// The numbers of the obstacles that are hidden near the robot.
fn hidden(moving: &MovingObstacles, secs: f64) -> HashSet<u64> {
    moving.occluded(Stamp::from_secs(secs)).map(|place| place.of).collect()
}

#[test]
fn of_two_who_walk_into_one_track_the_one_who_goes_into_the_blind_spot_is_not_forgotten() {
    let sides = [(1.35, 1.15), (1.2, 1.6), (1.5, 1.2), (1.0, 1.4), (1.4, 1.0)];
    for (side, pace) in sides
        .into_iter()
        .flat_map(|side| [(1.5, 2.6), (1.2, 2.0)].map(|pace| (side, pace)))
    {
        let secs = 4.5;
        let (both, place) = of_two(secs, side, pace);
        let hides = both.occluded(Stamp::from_secs(secs)).any(|known| {
            let travelled = known.speed * (secs - known.stamp.as_secs());
            known.is_within(travelled + 0.6, place)
        });
        assert!(hides, "{side:?} {pace:?}: {:?}", both.occluded);
        // Others must not be pushed out of the list.
        assert!(
            both.occluded.iter().count() <= 8,
            "{side:?} {pace:?}: {:?}",
            both.occluded
        );
    }
}

#[test]
fn two_who_pass_one_another_and_walk_on_in_sight_leave_nobody_hidden() {
    // Both turn round before the blind spot.
    let place = |now: f64, speed: f64, y: f64| Point2::new(0.8 - 1.56 * speed + 0.6 * speed * (now - 2.6).abs(), y);
    let both = beside_jackal(6.0, |now, laser, ray| {
        let first = zenav_fixtures::way_to_disc(laser, ray, (place(now, 1.0, 1.35), 0.3));
        first.min(zenav_fixtures::way_to_disc(laser, ray, (place(now, 0.9, 1.8), 0.3)))
    });
    assert!(hidden(&both, 6.0).is_empty(), "{:?}", both.occluded);
}
