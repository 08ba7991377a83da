//! Waypoints and trajectories are driven to their end, near the course and far from the furniture.

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{EventKind, LeaseRole, TrajectoryPoint};

use crate::rig::Rig;

const ROUND: [(f64, f64); 10] = [
    (-1.3, -1.1),
    (-1.3, -2.4),
    (-0.9, -3.1),
    (0.0, -3.2),
    (0.95, -3.0),
    (1.3, -2.3),
    (1.3, -1.3),
    (1.0, -0.5),
    (0.0, -0.25),
    (-1.0, -0.45),
];

#[test]
fn two_rounds_of_the_kitchen_table_take_a_minute_and_touch_nothing() {
    for seed in 1..=5 {
        let mut rig = Rig::new("kitchen", "tiago", seed, LeaseRole::Mission);
        rig.run(0.5);
        let rounds: Vec<_> = ROUND.iter().chain(&ROUND).copied().collect();
        let plan = rig.plan(&rounds, Vec::new());
        let secs = rig.drive(plan, 75.0, |_| {});
        let truth = rig.truth();
        let guard = rig
            .events
            .iter()
            .filter(|event| matches!(event, EventKind::Guard { .. }))
            .count();
        eprintln!(
            "seed {seed}: {secs:.1} s, {:.1} m, clearance {:.3} m, guard events {guard}",
            truth.length, truth.min_clearance
        );
        assert_eq!(truth.collisions, 0);
        assert!(truth.min_clearance > 0.08, "{}", truth.min_clearance);
        assert!(truth.map_from_base.distance(&Pose2::new(-1.0, -0.45, 0.0)) < 0.15);
    }
}

/// A slalom from rest to rest: speed up to 0.48 m/s, curvature up to 1/m.
fn slalom(start: Pose2) -> Vec<TrajectoryPoint> {
    let (top, acceleration, duration) = (0.48, 0.4, 6.0);
    let mut pose = start;
    let mut points = Vec::new();
    for i in 0..=600 {
        let t = f64::from(i) * 0.01;
        let v = (acceleration * t).min(top).min(acceleration * (duration - t)).max(0.0);
        let w = v * 1.0 * (1.3 * t).sin();
        points.push(TrajectoryPoint {
            t,
            x: pose.x,
            y: pose.y,
            yaw: pose.yaw,
            v,
            w,
        });
        pose = pose.advance(Twist2::new(v, w), 0.01);
    }
    points
}

#[test]
fn a_trajectory_is_followed_to_within_three_centimetres_of_the_truth() {
    for seed in 1..=5 {
        let mut rig = Rig::new("empty", "tiago", seed, LeaseRole::Mission);
        rig.run(1.0);
        let trajectory = slalom(rig.truth().map_from_base);
        let mut errors = Vec::new();
        let course = trajectory.clone();
        let plan = rig.plan(&[], trajectory);
        let secs = rig.drive(plan, 12.0, |rig| {
            let here = rig.truth().map_from_base;
            errors.push(
                course
                    .iter()
                    .map(|point| point.pose().distance(&here))
                    .fold(f64::INFINITY, f64::min),
            );
        });
        errors.sort_by(f64::total_cmp);
        let p95 = errors[errors.len() * 95 / 100];
        let end = course.last().unwrap().pose();
        eprintln!(
            "seed {seed}: {secs:.1} s of 6.0, cross-track p95 {p95:.4} m, end {:.3} m off",
            end.distance(&rig.truth().map_from_base)
        );
        assert!(
            p95 < 0.03 && end.distance(&rig.truth().map_from_base) < 0.05,
            "{p95} {end:?} {:?}",
            rig.truth()
        );
        assert!(secs < 8.0);
    }
}
