//! Claims about the collision monitor.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::*;
use nalgebra::{Point2, Vector2};
use proptest::prelude::*;
use zenav_fixtures::way_to_disc;
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::Footprint;

const NO_BUMP: Bump = Bump {
    stamp: Stamp::ZERO,
    pressed: false,
    bearing: None,
};

fn tiago() -> RobotModel {
    zenav_fixtures::robot("tiago")
}

/// A TIAGo with an all-round view.
fn all_seeing() -> RobotModel {
    let mut model = tiago();
    model.lidar.as_mut().unwrap().field_of_view = std::f64::consts::TAU;
    model
}

/// A sweep with this range at each angle.
fn sweep(model: &RobotModel, secs: f64, range: impl Fn(f64) -> f64) -> Sweep {
    zenav_fixtures::sweep(model.first_lidar().unwrap(), secs, range)
}

/// A wall across the path, `distance` ahead of the base.
fn wall(model: &RobotModel, distance: f64) -> LocalObstacles {
    let ahead = distance - model.first_lidar().unwrap().mount.x;
    let mut obstacles = LocalObstacles::new(model);
    let range = |angle: f64| {
        if angle.cos() > 0.05 {
            ahead / angle.cos()
        } else {
            f64::INFINITY
        }
    };
    obstacles.insert(&sweep(model, 1.0, range), Pose2::IDENTITY);
    obstacles
}

fn judge(model: &RobotModel, obstacles: &LocalObstacles, wanted: Twist2) -> Verdict {
    let mut monitor = CollisionMonitor::new(model, 0.02);
    at(&mut monitor, 1.05, wanted, obstacles, &NO_BUMP)
}

/// The verdict of a monitor, of a robot that is where it started.
fn at(monitor: &mut CollisionMonitor, secs: f64, wanted: Twist2, obstacles: &LocalObstacles, bump: &Bump) -> Verdict {
    monitor.judge(Stamp::from_secs(secs), wanted, obstacles, Pose2::IDENTITY, bump)
}

#[test]
fn full_speed_at_a_wall_is_slowed_and_stopped_before_it() {
    let model = tiago();
    let full = Twist2::new(0.6, 0.0);
    assert_eq!(judge(&model, &wall(&model, 2.0), full).zone, GuardZone::Clear);
    let near = judge(&model, &wall(&model, 0.42), full);
    assert!(near.zone == GuardZone::Slow && near.twist.v < 0.5, "{near:?}");
    assert_eq!(judge(&model, &wall(&model, 0.27), full).twist.v, 0.0);
    assert_eq!(judge(&model, &wall(&model, 0.27), full).zone, GuardZone::Stop);
}

/// Outlines unlike those of the shipped robots: with the axle at the rear end, far wider than long, and with an arm on one side.
const OUTLINES: [[(f64, f64); 4]; 3] = [
    [(-0.2, -0.3), (1.2, -0.3), (1.2, 0.3), (-0.2, 0.3)],
    [(-0.2, -0.8), (0.2, -0.8), (0.2, 0.8), (-0.2, 0.8)],
    [(-0.3, -0.2), (0.5, -0.2), (0.5, 0.7), (-0.3, 0.7)],
];

#[test]
fn no_corner_of_an_unusual_outline_meets_a_wall_whatever_is_wanted() {
    const HALF: f64 = 1.7;
    for outline in OUTLINES {
        let corners = outline.map(|(x, y)| Point2::new(x, y));
        let mut model = all_seeing();
        model.footprint = Footprint::Polygon(corners.to_vec());
        let lidar = model.lidar.as_mut().unwrap();
        (lidar.beams, lidar.mount) = (720, Pose2::IDENTITY);
        for (v, w) in [
            (0.6, 0.0),
            (-0.6, 0.0),
            (0.0, 2.0),
            (0.0, -2.0),
            (0.4, 0.8),
            (0.4, -0.8),
            (-0.3, 0.6),
        ] {
            let mut monitor = CollisionMonitor::new(&model, 0.02);
            let mut obstacles = LocalObstacles::new(&model);
            let (mut pose, mut way) = (Pose2::IDENTITY, 0.0);
            for tick in 0..400_u32 {
                let secs = 1.0 + 0.02 * f64::from(tick);
                if tick.is_multiple_of(5) {
                    let lidar = model.first_lidar().unwrap();
                    let sweep = zenav_fixtures::sweep_in_room(lidar, secs, pose, (HALF, HALF), &[]);
                    assert!(obstacles.insert(&sweep, pose));
                }
                let (now, wanted) = (Stamp::from_secs(secs), Twist2::new(v, w));
                let twist = monitor.judge(now, wanted, &obstacles, pose, &NO_BUMP).twist;
                pose = pose.advance(twist, 0.02);
                way += 0.02 * model.drive.surface_speed(twist);
                let reach = corners.map(|corner| pose.transform_point(corner).coords.amax());
                let farthest = reach.into_iter().fold(0.0, f64::max);
                assert!(farthest < HALF + 0.005, "{outline:?}, {v} {w}: {farthest} m");
            }
            assert!(way > 0.3, "{outline:?}, {v} {w}: it drove {way} m");
        }
    }
}

#[test]
fn a_robot_at_a_wall_may_turn_and_back_away() {
    let model = all_seeing();
    let obstacles = wall(&model, 0.28);
    assert_eq!(judge(&model, &obstacles, Twist2::new(0.0, 1.5)).twist.w, 1.5);
    assert_eq!(judge(&model, &obstacles, Twist2::new(-0.3, 0.0)).twist.v, -0.3);
}

#[test]
fn a_wall_alongside_at_a_tenth_of_a_metre_slows_nothing() {
    let model = tiago();
    let mut obstacles = LocalObstacles::new(&model);
    let range = |angle: f64| {
        if angle.sin() > 0.05 {
            0.365 / angle.sin()
        } else {
            f64::INFINITY
        }
    };
    obstacles.insert(&sweep(&model, 1.0, range), Pose2::IDENTITY);
    assert_eq!(judge(&model, &obstacles, Twist2::new(0.6, 0.0)).twist.v, 0.6);
}

#[test]
fn without_a_fresh_scan_nothing_moves() {
    let model = tiago();
    let mut monitor = CollisionMonitor::new(&model, 0.02);
    let creeps = Twist2::new(0.1, 0.0);
    let stale = at(&mut monitor, 1.6, creeps, &wall(&model, 3.0), &NO_BUMP);
    assert_eq!((stale.twist, stale.zone), (Twist2::ZERO, GuardZone::Stop));
    assert_eq!(stale.change.as_deref(), Some("lidar scan too old"));
    let none = at(&mut monitor, 1.6, creeps, &LocalObstacles::new(&model), &NO_BUMP);
    assert_eq!(none.twist, Twist2::ZERO);
}

#[test]
fn a_scan_of_the_future_and_an_odometry_that_is_no_number_move_nothing() {
    let model = tiago();
    let mut obstacles = LocalObstacles::new(&model);
    looked(&mut obstacles, &model, 10.0, 0.0);
    let driven = |secs: f64, here: Pose2| {
        let (now, ahead) = (Stamp::from_secs(secs), Twist2::new(0.3, 0.0));
        let mut monitor = CollisionMonitor::new(&model, 0.02);
        monitor.judge(now, ahead, &obstacles, here, &NO_BUMP).twist
    };
    assert_eq!(driven(10.05, Pose2::IDENTITY).v, 0.3);
    // The clock was set back: what the scan shows may be gone, and anything else may have come.
    assert_eq!(driven(5.0, Pose2::IDENTITY), Twist2::ZERO);
    for lost in [Pose2::new(f64::NAN, 0.0, 0.0), Pose2::new(0.0, 0.0, f64::NAN)] {
        assert_eq!(driven(10.05, lost), Twist2::ZERO);
    }
}

#[test]
fn a_body_slower_than_the_control_period_is_allowed_less_and_a_single_late_tick_changes_nothing() {
    let model = tiago();
    let obstacles = wall(&model, 0.42);
    let allowed = |before: [f64; 2]| {
        let mut monitor = CollisionMonitor::new(&model, 0.02);
        let mut last = 0.0;
        for secs in before.into_iter().chain([1.05]) {
            last = at(&mut monitor, secs, Twist2::new(0.6, 0.0), &obstacles, &NO_BUMP)
                .twist
                .v;
        }
        last
    };
    let in_time = allowed([1.01, 1.03]);
    let slow = allowed([0.95, 1.0]);
    assert!(0.1 < slow && slow < in_time - 0.01, "{slow} {in_time}");
    assert_eq!(allowed([0.98, 1.0]), in_time, "one late tick");
}

#[test]
fn slow_motors_slow_nothing_while_scans_come_and_stop_sooner_after_the_last_one() {
    for lag in [0.05, 0.3, 1.0] {
        let mut model = tiago();
        model.drive.motor_lag = lag;
        let (obstacles, full) = (wall(&model, 5.0), Twist2::new(0.6, 0.0));
        let mut monitor = CollisionMonitor::new(&model, 0.02);
        // The next scan is due 0.1 s after the one at 1 s.
        let soon = at(&mut monitor, 1.1, full, &obstacles, &NO_BUMP);
        assert!(soon.twist.v > 0.9 * full.v, "{lag}: {soon:?}");
        let commanded_until = EdgeSettings::default().rest_after_silence(&model, 0.02) - 4.0 * lag;
        let late = at(&mut monitor, 1.0 + commanded_until, full, &obstacles, &NO_BUMP);
        assert_eq!(late.twist, Twist2::ZERO, "{lag}: its motors need the rest of the time");
    }
}

#[test]
fn contact_allows_only_the_way_back() {
    let model = all_seeing();
    let obstacles = wall(&model, 3.0);
    let bump = Bump {
        stamp: Stamp::ZERO,
        pressed: true,
        bearing: Some(0.3),
    };
    let mut monitor = CollisionMonitor::new(&model, 0.02);
    let mut allowed = |v: f64| at(&mut monitor, 1.05, Twist2::new(v, 0.0), &obstacles, &bump).twist;
    assert_eq!(allowed(0.2), Twist2::ZERO);
    assert_eq!(allowed(-0.2).v, -0.2);
}

#[test]
fn another_reason_to_stop_is_reported_too() {
    let model = tiago();
    let mut monitor = CollisionMonitor::new(&model, 0.02);
    let obstacles = wall(&model, 0.27);
    let mut reported = |secs: f64| {
        let verdict = at(&mut monitor, secs, Twist2::new(0.5, 0.0), &obstacles, &NO_BUMP);
        assert_eq!(verdict.twist, Twist2::ZERO);
        verdict.change
    };
    assert_eq!(reported(1.05).as_deref(), Some("obstacle in the way"));
    assert_eq!(reported(1.45), None);
    assert_eq!(reported(1.55).as_deref(), Some("lidar scan too old"));
    assert_eq!(reported(1.57), None);
}

fn jackal() -> RobotModel {
    zenav_fixtures::robot("jackal")
}

/// One second of a Jackal at rest while a post of 0.2 m comes from `from` along x at `velocity` m/s.
fn beside(model: &RobotModel, from: Point2<f64>, velocity: f64) -> (LocalObstacles, Stamp) {
    passing(model, from, velocity, 0.2)
}

/// The same with a post of another radius, m.
fn passing(model: &RobotModel, from: Point2<f64>, velocity: f64, radius: f64) -> (LocalObstacles, Stamp) {
    let laser = model.first_lidar().unwrap().mount.position();
    let mut obstacles = LocalObstacles::new(model);
    let mut secs = 1.0;
    for step in 0..20 {
        secs = 1.0 + 0.05 * f64::from(step);
        let center = from + Vector2::new(velocity * (secs - 1.0), 0.0);
        let range = |angle: f64| {
            let along = Vector2::new(angle.cos(), angle.sin());
            way_to_disc(laser, along, (center, radius))
        };
        assert!(obstacles.insert(&sweep(model, secs, range), Pose2::IDENTITY));
    }
    (obstacles, Stamp::from_secs(secs))
}

#[test]
fn an_obstacle_that_moves_away_may_turn_round() {
    let model = jackal();
    let fast = Twist2::new(1.5, 0.0);
    let share = |velocity: f64| {
        let (obstacles, stamp) = beside(&model, Point2::new(0.9 - 0.95 * velocity, 0.0), velocity);
        let mut monitor = CollisionMonitor::new(&model, 0.02);
        let verdict = monitor.judge(stamp.plus_secs(0.02), fast, &obstacles, Pose2::IDENTITY, &NO_BUMP);
        (verdict.twist.v / fast.v, verdict.change.unwrap_or_default())
    };
    assert_eq!(share(0.0).0, 1.0, "it stands");
    let (goes, reason) = share(0.5);
    assert!(
        goes < 0.9 && reason.contains("moving obstacle nearby"),
        "{goes} {reason}"
    );
}

#[test]
fn with_a_moving_obstacle_in_the_blind_spot_a_robot_does_not_swing_its_corners() {
    let model = jackal();
    // Along the left side, backwards into the blind sector.
    let (obstacles, stamp) = beside(&model, Point2::new(0.6, 0.5), -1.0);
    let turn = Twist2::new(0.0, 2.0);
    let judge = |secs: f64, twist: Twist2| {
        let mut obstacles = obstacles.clone();
        let mut now = stamp;
        while now < stamp.plus_secs(secs) {
            now = now.plus_secs(0.2);
            let sweep = Sweep::new(now, vec![f32::INFINITY; model.first_lidar().unwrap().beams]);
            assert!(obstacles.insert(&sweep, Pose2::IDENTITY));
        }
        CollisionMonitor::new(&model, 0.02).judge(now.plus_secs(0.02), twist, &obstacles, Pose2::IDENTITY, &NO_BUMP)
    };
    let soon = judge(1.0, turn);
    assert!(
        soon.twist.w * 0.21 < 0.01 && soon.change.unwrap().contains("may be in the lidar's blind spot"),
        "{:?}",
        soon.twist
    );
    assert_eq!(judge(1.0, Twist2::new(0.5, 0.0)).twist.v, 0.5, "it may drive off");
    assert!(judge(8.0, turn).twist.w * 0.21 < 0.01, "it may still stand there");
    assert_eq!(judge(11.0, turn).twist.w, 2.0, "not for ever");
}

#[test]
fn a_robot_that_drives_may_turn_where_nobody_wide_enough_to_be_seen_can_reach_its_side_in_time() {
    let model = jackal();
    let nothing = vec![f32::INFINITY; model.first_lidar().unwrap().beams];
    // A wide and a narrow obstacle enter the blind spot along the left side.
    let turn = |radius: f64, twist: Twist2| {
        let (mut obstacles, stamp) = passing(&model, Point2::new(0.4, 0.3 + radius), -0.6, radius);
        let mut now = stamp;
        for _ in 0..10 {
            now = now.plus_secs(0.1);
            assert!(obstacles.insert(&Sweep::new(now, nothing.clone()), Pose2::IDENTITY));
        }
        let monitor = &mut CollisionMonitor::new(&model, 0.02);
        monitor
            .judge(now.plus_secs(0.02), twist, &obstacles, Pose2::IDENTITY, &NO_BUMP)
            .twist
            .w
            / twist.w
    };
    assert!(turn(0.3, Twist2::new(0.3, 0.6)) > 0.9);
    assert!(
        turn(0.06, Twist2::new(0.3, 0.6)) < 0.1,
        "it may be just beside the rear corner"
    );
    assert!(
        turn(0.3, Twist2::new(0.0, 0.6)) < 0.2,
        "where the robot stands its rear swings into the blind spot"
    );
}

#[test]
fn whoever_went_into_the_blind_spot_and_did_not_come_out_is_not_backed_into() {
    let model = jackal();
    // One obstacle passes close by, one out of reach of the corners.
    for (from, velocity, may_touch) in [((0.6, 0.5), -1.0, true), ((-1.2, 2.5), -1.3, false)] {
        let (obstacles, stamp) = beside(&model, Point2::new(from.0, from.1), velocity);
        let there = |secs: f64| {
            let here = Point2::origin();
            obstacles.moving().may_be_in_blind_spot(stamp.plus_secs(secs), here)
        };
        assert_eq!(there(0.1), may_touch, "{from:?}: who is far off has not come yet");
        assert!(there(2.5) && there(55.0) && !there(61.0), "{from:?}");
        let corners = |secs: f64| obstacles.moving().occluded(stamp.plus_secs(secs)).next().is_some();
        assert_eq!((corners(0.1), corners(11.0)), (may_touch, false), "{from:?}");
    }
    let mut nobody = LocalObstacles::new(&model);
    looked(&mut nobody, &model, 1.0, 0.0);
    assert!(
        !nobody
            .moving()
            .may_be_in_blind_spot(Stamp::from_secs(1.1), Point2::origin())
    );
    // Over floor that it has seen the robot backs up as fast as is allowed, until an obstacle may be there.
    let mut floor = LocalObstacles::new(&model);
    looked(&mut floor, &model, 0.8, std::f64::consts::PI);
    looked(&mut floor, &model, 1.0, 0.0);
    let back = |obstacles: &LocalObstacles| {
        let mut monitor = CollisionMonitor::new(&model, 0.02);
        monitor.blind_speed = 0.15;
        let wanted = Twist2::new(-0.3, 0.0);
        -at(&mut monitor, 1.05, wanted, obstacles, &NO_BUMP).twist.v
    };
    assert!((back(&floor) - 0.15).abs() < 1e-9, "{}", back(&floor));
    floor.touch(
        Stamp::from_secs(1.02),
        Some(Point2::new(-0.25, 0.0)),
        true,
        Pose2::IDENTITY,
    );
    floor.touch(Stamp::from_secs(1.04), None, false, Pose2::IDENTITY);
    assert!(back(&floor) <= 0.01, "{}", back(&floor));
}

#[test]
fn after_a_lidar_outage_a_moving_obstacle_may_be_in_the_blind_spot() {
    let turn = |rate: f64, second: f64| {
        let mut model = jackal();
        model.lidar.as_mut().unwrap().rate_hz = rate;
        let mut obstacles = LocalObstacles::new(&model);
        looked(&mut obstacles, &model, 0.0, 0.0);
        looked(&mut obstacles, &model, second, 0.0);
        let mut monitor = CollisionMonitor::new(&model, 0.02);
        let wanted = Twist2::new(0.0, 1.0);
        at(&mut monitor, second + 0.05, wanted, &obstacles, &NO_BUMP).twist.w
    };
    assert_eq!(turn(10.0, 0.2), 1.0);
    assert!(turn(10.0, 1.0) * 0.21 < 0.01);
    // The scans of a slow lidar come in time, too.
    assert_eq!(turn(1.0, 1.0), 1.0);
    assert!(turn(1.0, 2.0) * 0.21 < 0.01);
}

#[test]
fn a_bumper_contact_in_the_blind_spot_counts_as_a_moving_obstacle() {
    let model = jackal();
    let mut obstacles = LocalObstacles::new(&model);
    looked(&mut obstacles, &model, 1.0, 0.0);
    let turn = |obstacles: &LocalObstacles| judge(&model, obstacles, Twist2::new(0.0, 1.0)).twist.w;
    assert_eq!(turn(&obstacles), 1.0);
    let bump = Bump {
        bearing: Some(3.0),
        ..NO_BUMP
    };
    obstacles.touch(
        Stamp::from_secs(1.0),
        Some(contact_point(&model.footprint, bump.bearing.unwrap())),
        true,
        Pose2::IDENTITY,
    );
    assert!(turn(&obstacles) * 0.21 < 0.01);
}

#[test]
fn a_bumper_without_a_bearing_stops_the_way_that_the_robot_moved() {
    let model = jackal();
    let mut obstacles = LocalObstacles::new(&model);
    looked(&mut obstacles, &model, 1.0, 0.0);
    let touched = Bump {
        pressed: true,
        ..NO_BUMP
    };
    for back in [-1.0, 1.0] {
        let mut monitor = CollisionMonitor::new(&model, 0.02);
        let mut judge = |v: f64, bump: &Bump| at(&mut monitor, 1.0, Twist2::new(v, 0.0), &obstacles, bump).twist.v;
        for _ in 0..20 {
            assert_ne!(judge(0.1 * back, &NO_BUMP), 0.0);
        }
        // Also after it has driven off a little, and the switch chatters.
        for _ in 0..20 {
            assert_eq!(judge(0.1 * back, &touched), 0.0);
            judge(-0.1 * back, &NO_BUMP);
        }
        assert_ne!(judge(-0.1 * back, &touched), 0.0);
        assert!(monitor.feel(Stamp::from_secs(1.0), &touched).unwrap().x * back > 0.0);
    }
}

#[test]
fn a_robot_touched_at_its_side_slides_along_slowly_and_turns_away_only() {
    let model = zenav_fixtures::robot("jackal");
    let mut obstacles = LocalObstacles::new(&model);
    looked(&mut obstacles, &model, 1.0, 0.0);
    let bump = Bump {
        pressed: true,
        bearing: Some(1.5),
        ..NO_BUMP
    };
    let place = contact_point(&model.footprint, bump.bearing.unwrap());
    obstacles.touch(Stamp::from_secs(1.0), Some(place), true, Pose2::IDENTITY);
    let allowed = |twist: Twist2| {
        let mut monitor = CollisionMonitor::new(&model, 0.02);
        at(&mut monitor, 1.0, twist, &obstacles, &bump).twist
    };
    let slides = allowed(Twist2::new(0.5, 0.0)).v;
    assert!(slides > 0.05 && slides <= 0.1, "{slides}");
    // The contact is ahead of the axle: turning left swings it outwards.
    assert!(place.x > 0.0);
    assert_eq!(allowed(Twist2::new(0.0, 0.5)).w, 0.0);
    assert!(allowed(Twist2::new(0.0, -0.05)).w < -0.04);
}

#[test]
fn a_round_robot_on_which_somebody_leans_turns_on_the_spot_though_its_controller_creeps() {
    let model = tiago();
    let turn = Twist2::new(-0.001, 1.2);
    let allowed = |obstacles: &LocalObstacles, bump: &Bump| {
        let mut monitor = CollisionMonitor::new(&model, 0.02);
        at(&mut monitor, 1.05, turn, obstacles, bump).twist
    };
    let behind = Bump {
        pressed: true,
        bearing: Some(3.0),
        ..NO_BUMP
    };
    assert_eq!(allowed(&wall(&model, 3.0), &behind), turn);
    for distance in [0.27, 0.276, 0.28] {
        assert_eq!(allowed(&wall(&model, distance), &NO_BUMP), turn, "{distance}");
    }
}

/// Free floor as seen by a robot that faces `yaw`.
fn looked(obstacles: &mut LocalObstacles, model: &RobotModel, secs: f64, yaw: f64) {
    let sweep = sweep(model, secs, |_| f64::INFINITY);
    assert!(obstacles.insert(&sweep, Pose2::new(0.0, 0.0, yaw)));
}

#[test]
fn into_the_blind_spot_it_backs_up_only_over_floor_seen_before_and_at_the_allowed_speed() {
    let model = tiago();
    let mut monitor = CollisionMonitor::new(&model, 0.02);
    let mut back = |obstacles: &LocalObstacles, allowed: f64| {
        monitor.blind_speed = allowed;
        let wanted = Twist2::new(-0.3, 0.0);
        -at(&mut monitor, 1.05, wanted, obstacles, &NO_BUMP).twist.v
    };
    let mut ahead = LocalObstacles::new(&model);
    looked(&mut ahead, &model, 1.0, 0.0);
    assert!(back(&ahead, 0.15) <= 0.01, "never seen");
    let mut both = LocalObstacles::new(&model);
    looked(&mut both, &model, 0.5, std::f64::consts::PI);
    looked(&mut both, &model, 1.0, 0.0);
    assert!((back(&both, 0.15) - 0.15).abs() < 1e-9);
    assert!(back(&both, 0.0) <= 0.01, "somebody may have come up");
}

#[test]
fn over_floor_never_seen_it_feels_its_way_as_fast_as_is_allowed() {
    let model = tiago();
    let mut ahead = LocalObstacles::new(&model);
    looked(&mut ahead, &model, 1.0, 0.0);
    let mut monitor = CollisionMonitor::new(&model, 0.02);
    (monitor.blind_speed, monitor.unseen_speed) = (0.05, 0.05);
    let wanted = Twist2::new(-0.3, 0.0);
    let verdict = at(&mut monitor, 1.05, wanted, &ahead, &NO_BUMP);
    assert!((verdict.twist.v + 0.05).abs() < 1e-9, "{verdict:?}");
    // A contact felt there may be a moving obstacle.
    ahead.touch(
        Stamp::from_secs(1.05),
        Some(Point2::new(-0.29, 0.0)),
        true,
        Pose2::IDENTITY,
    );
    ahead.touch(Stamp::from_secs(1.06), None, false, Pose2::IDENTITY);
    let verdict = at(&mut monitor, 1.07, wanted, &ahead, &NO_BUMP);
    assert!(verdict.twist.v >= -0.01, "{verdict:?}");
}

#[test]
fn a_gentle_motion_waits_until_a_faster_one_has_faded() {
    let model = jackal();
    let nothing = wall(&model, 3.0);
    let mut monitor = CollisionMonitor::new(&model, 0.02);
    let mut judge = |secs: f64, wanted| at(&mut monitor, 1.05 + secs, wanted, &nothing, &NO_BUMP).twist;
    let gentle = Twist2::new(0.0, 0.03);
    assert_eq!(judge(0.0, gentle), gentle, "from rest");
    for tick in 1..=3 {
        judge(0.02 * f64::from(tick), Twist2::new(0.1, 0.0));
    }
    assert_eq!(judge(0.08, gentle), Twist2::ZERO);
    let later: Vec<Twist2> = (5..20).map(|tick| judge(0.02 * f64::from(tick), gentle)).collect();
    assert_eq!(later.last(), Some(&gentle), "{later:?}");
    // A faster motion is not held up.
    judge(0.42, Twist2::new(0.2, 0.0));
    assert_eq!(judge(0.44, Twist2::new(0.05, 0.3)).w, 0.3);
}

#[test]
fn a_corner_is_touched_from_between_its_sides_too() {
    let footprint = jackal().footprint;
    let turn = fastest_outward(&footprint, Twist2::new(0.0, 1.0));
    let both = fastest_outward(&footprint, Twist2::new(0.2, 1.0));
    // Driving straight moves only the front edge outwards, a turn only the ends of the sides; a corner does both.
    assert!((turn - 0.21).abs() < 1e-9 && both > 0.36, "{turn} {both}");
}

#[test]
fn a_moving_obstacle_stops_the_robot_earlier_than_a_static_one() {
    let model = tiago();
    let mut moving = LocalObstacles::new(&model);
    let mut standing = LocalObstacles::new(&model);
    let post = |distance: f64, secs: f64| {
        let range = |angle: f64| if angle.abs() < 0.2 { distance } else { f64::INFINITY };
        sweep(&model, secs, range)
    };
    for (secs, distance) in [(0.6, 0.7), (0.8, 0.6), (1.0, 0.5)] {
        moving.insert(&post(distance, secs), Pose2::IDENTITY);
        standing.insert(&post(0.5, secs), Pose2::IDENTITY);
    }
    let wanted = Twist2::new(0.5, 0.0);
    assert_eq!(judge(&model, &standing, wanted).twist.v, 0.5);
    let verdict = judge(&model, &moving, wanted);
    assert!(verdict.twist.v <= 0.4 && verdict.change.unwrap().contains("moving obstacle"));
}

proptest! {
    #[test]
    fn the_collision_monitor_only_ever_scales_down(v in prop::num::f64::ANY, w in prop::num::f64::ANY, distance in 0.3..3.0) {
        let model = tiago();
        let verdict = judge(&model, &wall(&model, distance), Twist2::new(v, w));
        prop_assert!(verdict.twist.is_finite());
        if v.is_finite() && w.is_finite() {
            prop_assert!(verdict.twist.v.abs() <= v.abs() && verdict.twist.w.abs() <= w.abs());
        }
    }
}
