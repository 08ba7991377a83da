//! Whatever is commanded, nothing is hit.

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{EventKind, LeaseRole, TrajectoryPoint};
use zenav_protocol::robot::RobotModel;
use zenav_sim::World;

use crate::rig::Rig;

/// A world of its own.
fn world(text: &str) -> World {
    World::from_toml(text, "world.toml", &|_| Err("no map".into())).unwrap()
}

/// A TIAGo with motors of another time constant, s, and a lidar of another rate, Hz.
fn tiago(lag: f64, rate: f64) -> RobotModel {
    let mut model = zenav_fixtures::robot("tiago");
    model.drive.motor_lag = lag;
    model.lidar.as_mut().unwrap().rate_hz = rate;
    model
}

#[test]
fn wild_commands_hit_nothing_that_stands_still() {
    for (robot, seed) in [
        ("tiago", 1),
        ("tiago", 2),
        ("tiago", 3),
        ("jackal", 4),
        ("turtlebot3_waffle", 5),
        ("neato", 6),
    ] {
        let mut rig = Rig::new("kitchen", robot, seed, LeaseRole::Operator);
        let mut random = seed;
        let mut unit = || {
            // Knuth's 64-bit linear congruence: any spread of commands will do.
            random = u64::wrapping_mul(random, 6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) as f64 / f64::from(1_u32 << 31)
        };
        let (top, yaw) = (rig.model.drive.top_speed(), rig.model.drive.top_yaw_rate());
        for _ in 0..60 {
            // Full speed ahead three times in four: the lidar sees it. Backwards only floor seen before is known.
            let forward = if unit() < 0.75 { 1.0 } else { -0.3 };
            let turn = if unit() < 0.5 {
                0.0
            } else {
                (2.0 * unit() - 1.0) * yaw.min(2.0)
            };
            rig.teleop = Some(Twist2::new(forward * top, turn));
            rig.run(1.5);
        }
        let truth = rig.truth();
        eprintln!(
            "{robot} {seed}: {:.1} m, clearance {:.3} m, {} contacts {:?}",
            truth.length, truth.min_clearance, truth.collisions, truth.last_contact
        );
        assert_eq!(truth.collisions, 0, "{robot} {seed}: {truth:?}");
    }
}

/// A corridor 0.73 m wide, 0.1 m wider on each side than TIAGo, that ends at a wall at x = 4.
const CORRIDOR: &str = r#"
name = "corridor"
size = [6.0, 2.0]
origin = [-1.0, -1.0]
[start]
x = 0.0
y = 0.0
yaw = 0.0
[[polygon]]
points = [[-0.5, 0.365], [4.5, 0.365], [4.5, 0.6], [-0.5, 0.6]]
[[polygon]]
points = [[-0.5, -0.6], [4.5, -0.6], [4.5, -0.365], [-0.5, -0.365]]
[[polygon]]
points = [[4.0, -0.3], [4.2, -0.3], [4.2, 0.3], [4.0, 0.3]]
"#;

#[test]
fn a_corridor_with_a_tenth_of_a_metre_on_each_side_is_driven_to_a_tenth_of_a_metre_from_its_end() {
    let world = world(CORRIDOR);
    for seed in 1..=5 {
        let mut rig = Rig::within(&world, "tiago", seed, LeaseRole::Mission);
        rig.run(1.0);
        let length = 4.0 - 0.265 - 0.11;
        let (top, acceleration) = (0.55, 0.6);
        let (ramp, duration) = (top / acceleration, length / top + top / acceleration);
        let points = (0..=(duration * 50.0) as usize).map(|i| {
            let t = i as f64 * 0.02;
            let v = (acceleration * t).min(top).min(acceleration * (duration - t));
            let left = duration - t;
            let x = match t {
                t if t < ramp => 0.5 * acceleration * t * t,
                t if left > ramp => top * (t - 0.5 * ramp),
                _ => length - 0.5 * acceleration * left * left,
            };
            TrajectoryPoint {
                t,
                x,
                v,
                ..TrajectoryPoint::default()
            }
        });
        let plan = rig.plan(&[], points.collect::<Vec<_>>());
        let secs = rig.drive(plan, 15.0, |_| {});
        let truth = rig.truth();
        let guard: Vec<_> = rig
            .events
            .iter()
            .filter(|event| matches!(event, EventKind::Guard { .. }))
            .collect();
        eprintln!(
            "seed {seed}: {secs:.1} s of {duration:.1}, clearance {:.3} m, {guard:?}",
            truth.min_clearance
        );
        assert_eq!(truth.collisions, 0);
        assert!(
            truth.map_from_base.distance(&Pose2::new(length, 0.0, 0.0)) < 0.05,
            "{truth:?}"
        );
        assert!(secs < duration + 2.0, "{secs}");
    }
}

/// A wall at x = 5, with room on both sides of the way to it.
const WALL: &str = r#"
name = "wall"
size = [8.0, 6.0]
origin = [-2.0, -3.0]
[start]
x = 0.0
y = 0.0
yaw = 0.0
[[polygon]]
points = [[5.0, -2.5], [5.2, -2.5], [5.2, 2.5], [5.0, 2.5]]
"#;

#[test]
fn slow_motors_and_slow_lidars_drive_up_to_a_wall_and_stop_before_it() {
    let world = world(WALL);
    for (lag, rate, limit) in [
        (0.05, 10.0, 20.0),
        (0.17, 10.0, 20.0),
        (0.3, 10.0, 20.0),
        (1.0, 10.0, 40.0),
        (0.05, 2.0, 20.0),
        (0.05, 1.0, 60.0),
    ] {
        let mut rig = Rig::of(&world, tiago(lag, rate), 1, LeaseRole::Operator);
        rig.teleop = Some(Twist2::new(rig.model.drive.top_speed(), 0.0));
        rig.run(limit);
        let truth = rig.truth();
        eprintln!(
            "motors {lag} s, lidar {rate} Hz: {:.2} m, clearance {:.3} m, {:.3} m/s",
            truth.length, truth.min_clearance, truth.twist.v
        );
        assert_eq!(truth.collisions, 0, "motors {lag} s, lidar {rate} Hz: {truth:?}");
        assert!(
            truth.length > 4.0,
            "motors {lag} s, lidar {rate} Hz: {truth:?} {:?}",
            rig.events
        );
        assert!(truth.twist.v.abs() < 0.05, "motors {lag} s, lidar {rate} Hz: {truth:?}");
    }
}

#[test]
fn slow_motors_and_slow_lidars_follow_a_plan() {
    for (lag, rate) in [(0.3, 10.0), (0.05, 2.0)] {
        let mut rig = Rig::of(
            &World::shipped("empty").unwrap(),
            tiago(lag, rate),
            1,
            LeaseRole::Mission,
        );
        rig.run(1.0);
        let goal = rig.truth().map_from_base * Pose2::new(4.0, 0.0, 0.0);
        let plan = rig.plan(&[(goal.x, goal.y)], Vec::new());
        let secs = rig.drive(plan, 30.0, |_| {});
        let off = rig.truth().map_from_base.distance(&goal);
        eprintln!("motors {lag} s, lidar {rate} Hz: {secs:.1} s, {off:.3} m off");
        assert!(off < 0.2, "motors {lag} s, lidar {rate} Hz: {off}");
    }
}

#[test]
fn a_rear_lidar_lets_a_robot_back_up_as_fast_as_it_drives_ahead() {
    for robot in ["tiago", "jackal"] {
        let fastest = |options: &str| {
            let mut rig = Rig::new("empty", &format!("{robot}{options}"), 1, LeaseRole::Mission);
            rig.run(1.0);
            // The floor behind has been seen by then.
            let ahead = rig.drive_straight("ahead", 2.0, 0.45);
            let back = rig.drive_straight("back", -1.5, 0.45);
            assert_eq!(rig.truth().collisions, 0);
            (ahead, back)
        };
        let (ahead, back) = fastest("");
        assert!(
            ahead > 0.4 && (0.1..0.17).contains(&back),
            "{robot} alone: {ahead} {back}"
        );
        let (ahead, back) = fastest("+rear_lidar");
        assert!(ahead > 0.4 && back > 0.4, "{robot} with a rear lidar: {ahead} {back}");
    }
}

#[test]
fn a_rear_lidar_stops_a_robot_that_backs_up_to_somebody_who_came_from_behind() {
    const COMES: &str = r#"
size = [12.0, 12.0]
origin = [-6.0, -6.0]
[start]
x = 0.0
y = 0.0
[[mover]]
radius = 0.25
path = [[-4.5, 0.0], [-1.5, 0.0]]
speed = 0.3
"#;
    let world = world(COMES);
    for seed in 1..=3 {
        let mut rig = Rig::within(&world, "jackal+rear_lidar", seed, LeaseRole::Operator);
        rig.teleop = Some(Twist2::new(-1.0, 0.0));
        rig.run(20.0);
        let truth = rig.truth();
        assert!(truth.length > 0.3, "it backs up: {truth:?}");
        assert!(truth.hardest_contact < 0.01, "{truth:?}");
    }
}
