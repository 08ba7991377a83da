//! Claims about predictive control.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::cell::Cell;

use super::*;
use crate::course::Course;
use nalgebra::Vector2;
use zenav_fixtures::sweep_in_room;
use zenav_protocol::time::Stamp;

const RATE: f64 = 20.0;

/// A hall with walls at y = ±`half`, in which walkers and a robot move; true poses, perfect odometry, no monitor.
struct Hall {
    model: RobotModel,
    avoidance: Avoidance,
    obstacles: LocalObstacles,
    pose: Pose2,
    twist: Twist2,
    speed_cap: f64,
    half: f64,
    least: f64,
    /// A robot that announces its course and has right of way, but stands.
    robot: Option<(Point2<f64>, Course)>,
}

impl Hall {
    fn new(robot: &str, half: f64) -> Self {
        let model = zenav_fixtures::robot(robot);
        Self {
            avoidance: Avoidance::new(&model, &AvoidanceSettings::default()),
            obstacles: LocalObstacles::new(&model),
            pose: Pose2::IDENTITY,
            twist: Twist2::ZERO,
            speed_cap: f64::INFINITY,
            half,
            least: f64::INFINITY,
            robot: None,
            model,
        }
    }

    fn scan(&mut self, now: f64, walkers: &[Point2<f64>]) {
        let discs: Vec<_> = walkers.iter().map(|walker| (*walker, 0.25)).collect();
        let lidar = self.model.first_lidar().unwrap();
        let sweep = sweep_in_room(lidar, now, self.pose, (f64::INFINITY, self.half), &discs);
        self.obstacles.insert(&sweep, self.pose);
    }

    /// Drives along y = 0 to x = 12 at `pace`; the time it takes, s.
    fn drive(&mut self, pace: f64, walkers: impl Fn(f64, Pose2) -> Vec<Point2<f64>>) -> Option<f64> {
        for step in 0..(60.0 * RATE) as u32 {
            let now = f64::from(step) / RATE;
            let walkers = walkers(now, self.pose);
            self.scan(now, &walkers);
            let robot = self.robot.clone().map(|(place, course)| {
                let mut track = Track::of_robot(1 << 48, 0.25, Vector2::zeros(), Stamp::from_secs(now), course);
                track.position = place;
                track
            });
            self.obstacles.set_robots(robot.into_iter());
            let ahead: Vec<Ahead> = (0..=120)
                .map(|nth| 0.1 * f64::from(nth))
                .map(|secs| Ahead {
                    secs,
                    pose: Pose2::new((self.pose.x + pace * secs).min(12.0), 0.0, 0.0),
                })
                .collect();
            let control = self.avoidance.step(&AvoidanceInput {
                dt: 1.0 / RATE,
                now: Stamp::from_secs(now),
                monitor: &CollisionMonitor::new(&self.model, 1.0 / RATE),
                bump: &Bump::none(Stamp::from_secs(now)),
                odom_from_base: self.pose,
                command: self.twist,
                speed_cap: self.speed_cap,
                ahead: &ahead,
                obstacles: &self.obstacles,
            });
            let wanted = match control {
                Control::Evade(twist) => {
                    let speed = self.model.drive.surface_speed(twist);
                    assert!(
                        speed <= self.speed_cap + 1e-6,
                        "{twist:?} is faster than the plan's end allows"
                    );
                    twist
                }
                _ => Twist2::new(pace, -2.0 * self.pose.y - 2.0 * self.pose.yaw),
            };
            let change = self.model.drive.acceleration() / RATE;
            let v = self.twist.v + (wanted.v - self.twist.v).clamp(-change, change);
            self.twist = Twist2::new(v, wanted.w);
            self.pose = self.pose.advance(self.twist, 1.0 / RATE);
            for walker in &walkers {
                let off = self.pose.inverse().transform_point(*walker);
                self.least = self.least.min(self.model.footprint.distance(off) - 0.25);
            }
            if self.pose.x > 11.5 {
                return Some(now);
            }
        }
        None
    }
}

#[test]
fn with_nobody_near_the_tracker_drives() {
    let mut hall = Hall::new("tiago", 2.0);
    let secs = hall.drive(0.6, |_, _| Vec::new()).unwrap();
    assert!(
        !hall.avoidance.is_evading() && (secs - 11.5 / 0.6).abs() < 1.5,
        "{secs}"
    );
}

#[test]
fn it_steps_aside_for_somebody_who_comes_along_the_middle() {
    for robot in ["tiago", "jackal"] {
        let mut hall = Hall::new(robot, 1.6);
        let secs = hall
            .drive(0.6, |now, _| vec![Point2::new(11.0 - 1.0 * now, 0.0)])
            .unwrap();
        assert!(hall.least > 0.05, "{robot}: {}", hall.least);
        assert!(secs < 32.0, "{robot}: {secs} s");
    }
}

#[test]
fn it_lets_somebody_cross() {
    for robot in ["tiago", "jackal"] {
        // Without avoidance they would meet at x = 5.
        let mut hall = Hall::new(robot, 6.0);
        let secs = hall
            .drive(0.6, |now, _| vec![Point2::new(5.0, -5.0 + 0.6 * now)])
            .unwrap();
        assert!(hall.least > 0.1, "{robot}: {}", hall.least);
        assert!(secs < 27.0, "{robot}: {secs} s");
    }
}

#[test]
fn it_gets_away_from_who_runs_into_it_and_leans_on_it() {
    for (robot, speed_cap) in [("tiago", f64::INFINITY), ("jackal", f64::INFINITY), ("tiago", 0.15)] {
        let mut hall = Hall::new(robot, 6.0);
        hall.speed_cap = speed_cap;
        let footprint = hall.model.footprint.clone();
        let (walker, leans) = (Cell::new(Point2::new(4.0, 4.0)), Cell::new(false));
        let follows = |_: f64, robot: Pose2| {
            let away = |at: Point2<f64>| footprint.distance(robot.inverse().transform_point(at)) - 0.25;
            let toward = (robot.position() - walker.get()).normalize() * (1.4 / RATE);
            leans.set(leans.get() || away(walker.get() + toward) < 0.005);
            if !leans.get() {
                walker.set(walker.get() + toward);
            }
            vec![walker.get()]
        };
        let secs = hall.drive(0.6, follows);
        assert!(leans.get(), "{robot} has not been touched");
        assert!(hall.least > -0.06, "{robot} drives into it: {}", hall.least);
        assert!(secs.is_some_and(|secs| secs < 45.0), "{robot}: {secs:?}");
    }
}

#[test]
fn it_gets_out_of_the_course_of_a_robot_that_waits_for_it_to_do_so() {
    // The other robot stands beside this one, as near as the covering discs allow, and plans through its place.
    let mut hall = Hall::new("jackal", 4.0);
    let (place, step) = (Point2::new(0.1, 0.5), 0.4);
    let places = (0..16).map(|nth| Point2::new(0.1, 0.5 - 0.6 * f64::from(nth)));
    let course = Course {
        places: places.collect(),
        step,
        begun: 0.0,
        makes_way: false,
        ..Course::default()
    };
    hall.robot = Some((place, course));
    let secs = hall.drive(0.6, |_, _| vec![place]);
    assert!(secs.is_some_and(|secs| secs < 25.0), "{secs:?}");
    assert!(hall.least > 0.0, "{}", hall.least);
}

#[test]
fn the_discs_cover_the_footprint() {
    for robot in ["tiago", "jackal", "turtlebot3_waffle"] {
        let footprint = zenav_fixtures::robot(robot).footprint;
        let discs = covering_discs(&footprint);
        let corners = match &footprint {
            Footprint::Radius(radius) => vec![Point2::new(*radius, 0.0)],
            Footprint::Polygon(corners) => corners.clone(),
        };
        for corner in corners {
            let covered = discs
                .iter()
                .any(|(x, radius)| (corner - Point2::new(*x, 0.0)).norm() <= radius + 1e-9);
            assert!(covered, "{robot}: {corner}");
        }
    }
}
