//! Rays per second. Whole sweeps by the angular buffer, compared with parry's ray cast on the same worlds from the same poses: the same
//! ranges, in processor time of the thread. Both get the beams' directions in the laser frame beforehand.
//!
//! For maps of real buildings, many robots and a peer: `cargo bench -p zenav-tests --bench simulator`, or `zenav sim bench --world W`.

#![allow(missing_docs, reason = "criterion's macros")]
#![allow(clippy::unwrap_used, reason = "a bench")]

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Point2, Rotation2, Vector2};
use parry2d_f64::math::Vector;
use parry2d_f64::query::{Ray, RayCast};
use parry2d_f64::shape::Polyline;
use zenav_fixtures::{Pair, ThreadTime, on_thread_time};
use zenav_protocol::geometry::Pose2;
use zenav_sim::lidar::AngularBuffer;
use zenav_sim::made_worlds::{office, polygons};
use zenav_sim::scatter::scatter;
use zenav_sim::world::World;

const BEAMS: usize = 667;
/// Ranges are equal to within this, m: the buffer holds inverse ranges.
const TOLERANCE: f64 = 1e-6;
/// Most beams of a million that may pass a corner on different sides.
const GRAZING: usize = 100;

/// A world from its text.
fn world(text: &str) -> World {
    World::from_toml(text, "bench.toml", &|_| Err(String::new())).unwrap()
}

fn sweeps(criterion: &mut Criterion<ThreadTime>) {
    let model = zenav_fixtures::robot("tiago");
    let mut lidar = model.first_lidar().unwrap().clone();
    (lidar.beams, lidar.range_max) = (BEAMS, 25.0);
    for (name, world) in [
        ("50 polygons", world(&polygons(50, 4, 20.0))),
        ("2000 segments", world(&polygons(50, 40, 20.0))),
        ("grid of 1200 x 1200 cells", office()),
    ] {
        let poses: Vec<Pose2> = scatter(&world, &model, 64, 0.0, 2)
            .into_iter()
            .map(|pose| pose * lidar.mount)
            .collect();
        let edges = world.scene().edges().things();
        let vector = |p: Point2<f64>| Vector::new(p.x, p.y);
        let points = edges.iter().flat_map(|edge| [vector(edge.a), vector(edge.b)]).collect();
        let pairs = (0..edges.len() as u32).map(|i| [2 * i, 2 * i + 1]).collect();
        let polyline = Polyline::new(points, Some(pairs));
        let beams: Vec<Vector2<f64>> = (0..BEAMS)
            .map(|beam| lidar.angle_min() + beam as f64 * lidar.angle_increment())
            .map(|angle| Vector2::new(angle.cos(), angle.sin()))
            .collect();
        let cast = |pose: &Pose2, sweep: &mut dyn FnMut(f64)| {
            let turn = Rotation2::new(pose.yaw);
            for beam in &beams {
                let along = turn * beam;
                let ray = Ray::new(vector(pose.position()), Vector::new(along.x, along.y));
                let range = polyline.cast_local_ray(&ray, lidar.range_max, true);
                sweep(range.unwrap_or(f64::INFINITY));
            }
        };

        let mut buffer = AngularBuffer::new(&lidar);
        let mut different = 0;
        for pose in &poses {
            buffer.begin(*pose);
            buffer.scene(world.scene());
            let mut ranges = buffer
                .ranges()
                .map(|range| if range > lidar.range_max { f64::INFINITY } else { range });
            cast(pose, &mut |theirs| {
                let ours = ranges.next().unwrap();
                different += usize::from(ours != theirs && (ours - theirs).abs() > TOLERANCE);
            });
        }
        let beams = poses.len() * BEAMS;
        assert!(
            different * 1_000_000 <= GRAZING * beams,
            "{name}: {different} of {beams} ranges differ"
        );

        let mut group = criterion.benchmark_group(name);
        group.throughput(Throughput::Elements(beams as u64));
        group.sample_size(20);
        Pair::new(
            format!("{name}/angular buffer"),
            "parry, beam by beam",
            format!("{name}/parry, beam by beam"),
        )
        .print();
        group.bench_function("angular buffer", |bencher| {
            bencher.iter(|| {
                for pose in &poses {
                    buffer.begin(*pose);
                    buffer.scene(world.scene());
                    black_box(buffer.ranges().sum::<f64>());
                }
            });
        });
        group.bench_function("parry, beam by beam", |bencher| {
            bencher.iter(|| {
                for pose in &poses {
                    let mut sum = 0.0;
                    cast(pose, &mut |range| sum += range);
                    black_box(sum);
                }
            });
        });
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = on_thread_time();
    targets = sweeps
}
criterion_main!(benches);
