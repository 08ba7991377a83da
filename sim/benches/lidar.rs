//! Rays per second. Whole sweeps by the angular buffer, compared with parry's ray cast on the same worlds from the same poses.
//!
//! For maps of real buildings, many robots and a peer: `cargo bench -p zenav-tests --bench simulator`, or `zenav sim bench --world W`.

#![allow(missing_docs, reason = "criterion's macros")]
#![allow(clippy::unwrap_used, reason = "a bench")]

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::Point2;
use parry2d_f64::math::{Pose, Vector};
use parry2d_f64::query::{Ray, RayCast};
use parry2d_f64::shape::Polyline;
use zenav_protocol::geometry::Pose2;
use zenav_sim::lidar::AngularBuffer;
use zenav_sim::made_worlds::{office, polygons};
use zenav_sim::scatter::scatter;
use zenav_sim::world::World;

const BEAMS: usize = 667;

/// A world from its text.
fn world(text: &str) -> World {
    World::from_toml(text, "bench.toml", &|_| Err(String::new())).unwrap()
}

fn sweeps(criterion: &mut Criterion) {
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
        let mut group = criterion.benchmark_group(name);
        group.throughput(Throughput::Elements((poses.len() * BEAMS) as u64));
        group.sample_size(20);
        let mut buffer = AngularBuffer::new(&lidar);
        group.bench_function("angular buffer", |bencher| {
            bencher.iter(|| {
                for pose in &poses {
                    buffer.begin(*pose);
                    buffer.scene(world.scene());
                    black_box(buffer.ranges().sum::<f64>());
                }
            });
        });
        let edges = world.scene().edges().things();
        let vector = |p: Point2<f64>| Vector::new(p.x, p.y);
        let points = edges.iter().flat_map(|edge| [vector(edge.a), vector(edge.b)]).collect();
        let pairs = (0..edges.len() as u32).map(|i| [2 * i, 2 * i + 1]).collect();
        let polyline = Polyline::new(points, Some(pairs));
        group.bench_function("parry, beam by beam", |bencher| {
            bencher.iter(|| {
                for pose in &poses {
                    for beam in 0..BEAMS {
                        let angle = pose.yaw + lidar.angle_min() + beam as f64 * lidar.angle_increment();
                        let ray = Ray::new(vector(pose.position()), Vector::new(angle.cos(), angle.sin()));
                        black_box(polyline.cast_ray(&Pose::IDENTITY, &ray, lidar.range_max, true));
                    }
                }
            });
        });
        group.finish();
    }
}

criterion_group!(benches, sweeps);
criterion_main!(benches);
