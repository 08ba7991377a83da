//! Avoidance bench. What does one decision among people cost?
//! `cargo bench -p zenav-edge --bench avoidance`
//!
//! A hall of 8 m by 8 m in which people walk, seen for two seconds by a robot at rest; its plan leads straight through. Aim: 2 ms at most,
//! at 20 Hz. In contact, where the bumper is pressed from behind, ways out are searched too.

#![allow(missing_docs, reason = "criterion's macros")]
#![allow(clippy::unwrap_used, reason = "a bench")]

use std::f64::consts::PI;
use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Point2, Vector2};
use zenav_edge::avoidance::{Ahead, Avoidance, AvoidanceInput, Control};
use zenav_edge::collision_monitor::CollisionMonitor;
use zenav_edge::local_obstacles::LocalObstacles;
use zenav_edge::settings::AvoidanceSettings;
use zenav_fixtures::{ThreadTime, on_thread_time};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::Bump;
use zenav_protocol::time::Stamp;

/// Half the hall, m.
const HALL: (f64, f64) = (4.0, 4.0);
/// Time for which the robot looks around, and from sweep to sweep, s.
const LOOKS: f64 = 2.0;
const SWEEP: f64 = 0.05;

/// People on circles around the robot, each on a path of its own: one third of them towards it, the others across.
fn people(count: u32, secs: f64) -> Vec<(Point2<f64>, f64)> {
    (0..count)
        .map(|nth| {
            let bearing = 2.4 * f64::from(nth);
            let away = 1.6 + 0.35 * f64::from(nth % 6);
            let heading = bearing + PI + 0.5 * (f64::from((nth + 1) % 3) - 1.0) * PI;
            let (at, along) = (
                Point2::new(away * bearing.cos(), away * bearing.sin()),
                Vector2::new(heading.cos(), heading.sin()),
            );
            (at + along * (0.8 * (secs - LOOKS)), 0.25)
        })
        .collect()
}

fn decision(criterion: &mut Criterion<ThreadTime>) {
    for name in ["tiago", "jackal", "turtlebot3_waffle"] {
        let model = zenav_fixtures::robot(name);
        let monitor = CollisionMonitor::new(&model, 0.02);
        let v = model.drive.top_speed();
        let ahead: Vec<Ahead> = (0..=120)
            .map(|nth| 0.1 * f64::from(nth))
            .map(|secs| Ahead {
                secs,
                pose: Pose2::new((v * secs).min(HALL.0 - 0.6), 0.0, 0.0),
            })
            .collect();
        for count in [5, 20] {
            let mut obstacles = LocalObstacles::new(&model);
            let lidar = model.first_lidar().unwrap();
            let sweeps = (LOOKS / SWEEP) as u32;
            for nth in 0..=sweeps {
                let secs = SWEEP * f64::from(nth);
                let sweep = zenav_fixtures::sweep_in_room(lidar, secs, Pose2::IDENTITY, HALL, &people(count, secs));
                assert!(obstacles.insert(&sweep, Pose2::IDENTITY));
            }
            let now = Stamp::from_secs(LOOKS);
            for (contact, bump) in [
                ("free", Bump::none(now)),
                (
                    "in contact",
                    Bump {
                        stamp: now,
                        pressed: true,
                        bearing: Some(PI),
                    },
                ),
            ] {
                let mut avoidance = Avoidance::new(&model, &AvoidanceSettings::default());
                let input = AvoidanceInput {
                    dt: SWEEP,
                    now,
                    odom_from_base: Pose2::IDENTITY,
                    command: Twist2::ZERO,
                    speed_cap: f64::INFINITY,
                    monitor: &monitor,
                    bump: &bump,
                    ahead: &ahead,
                    obstacles: &obstacles,
                };
                criterion.bench_function(&format!("avoidance/{name}/{count} people/{contact}"), |bencher| {
                    bencher.iter(|| {
                        let control = avoidance.step(black_box(&input));
                        assert!(matches!(control, Control::Evade(_)));
                    });
                });
            }
        }
    }
}

criterion_group! {
    name = benches;
    config = on_thread_time();
    targets = decision
}
criterion_main!(benches);
