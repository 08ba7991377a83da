//! Collision monitor bench. What does one decision on a scan of 667 beams cost, and what does it cost to take in such a scan?
//! `cargo bench -p zenav-edge --bench collision_monitor`
//!
//! A room of 5 m by 4 m with furniture at arm's length, seen by the shipped robots' own lidars with 667 beams each; one person walks
//! through it, another has left the field of view.

#![allow(missing_docs, reason = "criterion's macros")]
#![allow(clippy::unwrap_used, reason = "a bench")]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Point2;
use zenav_edge::collision_monitor::CollisionMonitor;
use zenav_edge::local_obstacles::LocalObstacles;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::Bump;
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

const BEAMS: usize = 667;
/// Half the room, m.
const ROOM: (f64, f64) = (2.5, 2.0);
/// Furniture: positions and radii, m.
const FURNITURE: [(f64, f64, f64); 6] = [
    (1.1, 0.5, 0.2),
    (0.9, -0.6, 0.05),
    (-0.8, 0.9, 0.3),
    (-1.0, -0.7, 0.1),
    (0.2, 1.0, 0.1),
    (1.9, -1.2, 0.4),
];

fn model(name: &str) -> RobotModel {
    let mut model = zenav_fixtures::robot(name);
    model.lidar.as_mut().unwrap().beams = BEAMS;
    model
}

fn sweep(model: &RobotModel, secs: f64, base: Pose2, people: &[(f64, f64, f64)]) -> Sweep {
    let discs: Vec<_> = FURNITURE
        .iter()
        .chain(people)
        .map(|(x, y, radius)| (Point2::new(*x, *y), *radius))
        .collect();
    zenav_fixtures::sweep_in_room(model.first_lidar().unwrap(), secs, base, ROOM, &discs)
}

/// Three seconds of a robot that turns around and ends up facing along x.
fn history(model: &RobotModel, people: bool) -> Vec<(Sweep, Pose2)> {
    (0..60)
        .map(|step| {
            let secs = 0.05 * f64::from(step);
            let base = Pose2::new(0.0, 0.0, 2.0 * (secs - 2.95));
            // One person comes from ahead, one has walked behind the robot.
            let walkers = [(2.2 - 0.4 * secs, 0.1, 0.2), (0.6 - 0.5 * secs, 0.85, 0.15)];
            let seen = if people { &walkers[..] } else { &[] };
            (sweep(model, secs, base, seen), base)
        })
        .collect()
}

fn decision(criterion: &mut Criterion) {
    let bump = Bump {
        stamp: Stamp::ZERO,
        pressed: false,
        bearing: None,
    };
    for name in ["tiago", "jackal"] {
        let model = model(name);
        let (v, w) = (model.drive.top_speed(), model.drive.top_yaw_rate());
        for people in [false, true] {
            let mut obstacles = LocalObstacles::new(&model);
            let history = history(&model, people);
            for (sweep, base) in &history {
                assert!(obstacles.insert(sweep, *base));
            }
            let with = if people { "people" } else { "furniture" };
            for (motion, twist) in [
                ("ahead", Twist2::new(v, 0.0)),
                ("arc", Twist2::new(0.7 * v, 0.3 * w)),
                ("turn", Twist2::new(0.0, w)),
                ("back", Twist2::new(-v, 0.1 * w)),
            ] {
                let mut monitor = CollisionMonitor::new(&model, 0.02);
                monitor.blind_speed = v;
                criterion.bench_function(&format!("guard/decision/{name}/{with}/{motion}"), |bencher| {
                    bencher.iter(|| {
                        monitor.judge(
                            Stamp::from_secs(3.0),
                            black_box(twist),
                            black_box(&obstacles),
                            Pose2::IDENTITY,
                            &bump,
                        )
                    });
                });
            }
            let mut step = 0;
            criterion.bench_function(&format!("monitor/sweep/{name}/{with}"), |bencher| {
                let mut obstacles = LocalObstacles::new(&model);
                bencher.iter_batched_ref(
                    || {
                        // Replays the same seconds over and over, on a clock that goes on.
                        let (sweep, base) = &history[step % history.len()];
                        step += 1;
                        let sweep = Sweep::new(Stamp::from_secs(0.05 * step as f64), sweep.ranges.clone());
                        (sweep, *base)
                    },
                    |(sweep, base)| assert!(obstacles.insert(sweep, *base)),
                    criterion::BatchSize::PerIteration,
                );
            });
        }
    }
}

criterion_group!(benches, decision);
criterion_main!(benches);
