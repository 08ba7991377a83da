//! How many rays a second? Whole sweeps by the angular buffer beside parry's ray cast, on the same worlds from the same poses.
//!
//! For maps of real buildings: `zenav sim bench --world W`.

#![allow(missing_docs, reason = "criterion's macros")]
#![allow(clippy::unwrap_used, reason = "a bench")]

use std::fmt::Write as _;
use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::Point2;
use parry2d_f64::math::{Pose, Vector};
use parry2d_f64::query::{Ray, RayCast};
use parry2d_f64::shape::Polyline;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::robot::{RobotModel, shipped};
use zenav_sim::bench::scatter;
use zenav_sim::lidar::AngularBuffer;
use zenav_sim::world::World;

const BEAMS: usize = 667;

/// `shapes` regular polygons of `sides` sides on a lattice in a walled square.
fn polygons(shapes: usize, sides: usize, size: f64) -> World {
    let mut text = format!("size = [{size}, {size}]\n");
    for (from, to) in [
        ([0.0, 0.0], [size, 0.0]),
        ([size, 0.0], [size, size]),
        ([size, size], [0.0, size]),
        ([0.0, size], [0.0, 0.0]),
    ] {
        let _ = writeln!(text, "[[wall]]\nfrom = {from:?}\nto = {to:?}\nthickness = 0.1");
    }
    let a_row = (shapes as f64).sqrt().ceil() as usize;
    let pitch = size / a_row as f64;
    for shape in 0..shapes {
        let (x, y) = ((shape % a_row) as f64 + 0.5, (shape / a_row) as f64 + 0.5);
        // Sizes and angles that differ, without a generator.
        let radius = pitch * (0.1 + 0.15 * ((shape * 7) % 10) as f64 / 10.0);
        let corners: Vec<[f64; 2]> = (0..sides)
            .map(|side| std::f64::consts::TAU * (side as f64 / sides as f64 + shape as f64 * 0.13))
            .map(|angle| [x * pitch + radius * angle.cos(), y * pitch + radius * angle.sin()])
            .collect();
        let _ = writeln!(text, "[[polygon]]\npoints = {corners:?}");
    }
    World::from_toml(&text, "bench.toml", &|_| Err(String::new())).unwrap()
}

/// An office of rooms with doors and furniture, as a map of 5 cm cells.
fn office() -> World {
    const SIDE: u32 = 1200;
    let spec = GridSpec {
        origin: Point2::origin(),
        resolution: 0.05,
        width: SIDE,
        height: SIDE,
    };
    let mut map = OccupancyGrid::filled(spec, Occupancy::FREE);
    for y in 0..SIDE {
        for x in 0..SIDE {
            let (in_x, in_y) = (x % 120, y % 120);
            let wall = (in_x < 3 && !(50..70).contains(&in_y)) || (in_y < 3 && !(50..70).contains(&in_x));
            let (room_x, room_y) = (x / 120, y / 120);
            let corner = 20 + (room_x * 13 + room_y * 29) % 60;
            let furniture = (corner..corner + 14).contains(&in_x) && (80..88).contains(&in_y);
            // Clutter, as a scanner sees it.
            let speck = (x * 7919 + y * 104_729) % 1013 == 0;
            if wall || furniture || speck || x == SIDE - 1 || y == SIDE - 1 {
                map[Cell::new(x, y)] = Occupancy::OCCUPIED;
            }
        }
    }
    World::from_map("office", map, Pose2::new(3.0, 3.0, 0.0))
}

fn sweeps(criterion: &mut Criterion) {
    let mut model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
    model.lidar.beams = BEAMS;
    model.lidar.range_max = 25.0;
    for (name, world) in [
        ("50 polygons", polygons(50, 4, 20.0)),
        ("2000 segments", polygons(50, 40, 20.0)),
        ("grid of 1200 x 1200 cells", office()),
    ] {
        let poses: Vec<Pose2> = scatter(&world, &model, 64, 0.0, 2)
            .into_iter()
            .map(|pose| pose * model.lidar.mount)
            .collect();
        let mut group = criterion.benchmark_group(name);
        group.throughput(Throughput::Elements((poses.len() * BEAMS) as u64));
        group.sample_size(20);
        let mut buffer = AngularBuffer::new(&model.lidar);
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
                        let angle = pose.yaw + model.lidar.angle_min() + beam as f64 * model.lidar.angle_increment();
                        let ray = Ray::new(vector(pose.position()), Vector::new(angle.cos(), angle.sin()));
                        black_box(polyline.cast_ray(&Pose::IDENTITY, &ray, model.lidar.range_max, true));
                    }
                }
            });
        });
        group.finish();
    }
}

criterion_group!(benches, sweeps);
criterion_main!(benches);
