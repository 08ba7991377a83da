//! Collision monitor bench. What does one decision on a scan of 667 beams cost, what does it cost to take in such a scan, and what does
//! the geometry beneath it cost beside parry's? `cargo bench -p zenav-edge --bench collision_monitor`
//!
//! A room of 5 m by 4 m with furniture at arm's length, seen by the shipped robots' own lidars with 667 beams each; one person walks
//! through it, another has left the field of view.
//!
//! parry gets the same points in shapes and trees of its own, built beforehand, and must give the same answers. Its tree over points can
//! only give the first contact of all; the monitor needs that of each point. Times are the thread's own, independent of other load.

#![allow(missing_docs, reason = "criterion's macros")]
#![allow(clippy::unwrap_used, reason = "a bench")]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Point2;
use parry2d_f64::bounding_volume::Aabb;
use parry2d_f64::math::{Pose, Vector};
use parry2d_f64::partitioning::{Bvh, BvhBuildStrategy};
use parry2d_f64::query::{NonlinearRigidMotion, PointProjection, PointQuery as _, cast_shapes_nonlinear};
use parry2d_f64::shape::{Ball, Compound, ConvexPolygon, Shape, SharedShape};
use parry2d_f64::utils::segments_intersection2d;
use zenav_edge::avoidance::clearance_grid::{CELL, ClearanceGrid};
use zenav_edge::collision_monitor::CollisionMonitor;
use zenav_edge::local_obstacles::LocalObstacles;
use zenav_edge::time_to_contact::SweptFootprint;
use zenav_fixtures::{Pair, ThreadTime, on_thread_time};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::Bump;
use zenav_protocol::polygon::{Edge, contains, edges, touch};
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::{Footprint, RobotModel};
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
/// The arc on which contacts are looked for: its length, m, and curvature, 1/m.
const WAY: f64 = 1.25;
const CURVATURE: f64 = 0.5;
/// An outline with its base off its middle, m. For a rectangle parry has a shorter way, for others it has not.
const OUTLINE: [(f64, f64); 5] = [(-0.4, -0.15), (0.1, -0.18), (0.2, 0.0), (0.1, 0.18), (-0.4, 0.15)];
/// parry's distances and times are iterated: they equal ours to within this, m and s.
const TOLERANCE: f64 = 1e-6;

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

fn decision(criterion: &mut Criterion<ThreadTime>) {
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
                criterion.bench_function(&format!("monitor/decision/{name}/{with}/{motion}"), |bencher| {
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

fn vector(point: Point2<f64>) -> Vector {
    Vector::new(point.x, point.y)
}

/// What the robot sees of the room without people, base frame.
fn seen(model: &RobotModel) -> Vec<Point2<f64>> {
    let lidar = model.first_lidar().unwrap();
    let sweep = sweep(model, 0.0, Pose2::IDENTITY, &[]);
    let points = sweep.ranges.iter().enumerate().map(|(beam, range)| {
        let angle = lidar.angle_min() + beam as f64 * lidar.angle_increment();
        let (along, across) = (f64::from(*range) * angle.cos(), f64::from(*range) * angle.sin());
        lidar.mount.transform_point(Point2::new(along, across))
    });
    // Beams without return are infinite.
    points.filter(|point| point.coords.norm().is_finite()).collect()
}

/// A lattice of as many points as a scan has beams.
fn lattice(first: (f64, f64), step: (f64, f64)) -> Vec<Point2<f64>> {
    let at = |nth: usize| ((nth % 26) as f64, (nth / 26) as f64);
    (0..BEAMS)
        .map(at)
        .map(|(column, row)| Point2::new(first.0 + step.0 * column, first.1 + step.1 * row))
        .collect()
}

/// Time to contact on an arc.
fn contact(criterion: &mut Criterion<ThreadTime>) {
    for name in ["tiago", "jackal"] {
        let model = model(name);
        let v = model.drive.top_speed();
        let (twist, horizon) = (Twist2::new(v, CURVATURE * v), WAY / v);
        let points = seen(&model);
        let swept = SweptFootprint::new(&model.footprint, 0.0, twist);
        let body = match &model.footprint {
            Footprint::Radius(radius) => SharedShape::ball(*radius),
            Footprint::Polygon(corners) => {
                // Jackal's is a rectangle around its base, for which parry has a shorter way than for other polygons.
                let sizes = || corners.iter().map(|corner| vector(*corner).abs());
                let half = sizes().fold(Vector::ZERO, Vector::max);
                assert!(sizes().all(|size| size == half), "{name}: {corners:?}");
                SharedShape::cuboid(half.x, half.y)
            }
        };
        let center = Vector::new(0.0, 1.0 / CURVATURE);
        let motion = NonlinearRigidMotion::new(Pose::IDENTITY, center, Vector::ZERO, twist.w);
        let cast = |at: &NonlinearRigidMotion, shape: &dyn Shape| {
            let hit = cast_shapes_nonlinear(&motion, &*body, at, shape, 0.0, horizon, true);
            hit.unwrap().map(|hit| hit.time_of_impact)
        };
        let placed: Vec<Pose> = points
            .iter()
            .map(|point| Pose::from_translation(vector(*point)))
            .collect();
        let resting: Vec<_> = placed
            .iter()
            .map(|pose| NonlinearRigidMotion::constant_position(*pose))
            .collect();
        let dot = Ball::new(0.0);
        let tree = Compound::new(placed.iter().map(|pose| (*pose, SharedShape::ball(0.0))).collect());
        let in_place = NonlinearRigidMotion::identity();

        let closed_form = || {
            let times = points.iter().filter_map(|point| swept.time_to_contact(*point));
            times.fold(f64::INFINITY, f64::min)
        };
        let one_by_one = || {
            let times = resting.iter().filter_map(|at| cast(at, &dot));
            times.fold(f64::INFINITY, f64::min)
        };
        for (point, at) in points.iter().zip(&resting) {
            let ours = swept.time_to_contact(*point).filter(|time| *time <= horizon);
            let theirs = cast(at, &dot);
            let off = ours.unwrap_or(0.0) - theirs.unwrap_or(0.0);
            assert!(
                ours.is_some() == theirs.is_some() && off.abs() < TOLERANCE,
                "{name}, {point}: {ours:?} s, parry's {theirs:?} s"
            );
        }
        let first = cast(&in_place, &tree).unwrap();
        assert!((closed_form() - first).abs() < TOLERANCE, "{name}: {first} s");

        let title = format!("contact on an arc, {name}");
        let mut group = criterion.benchmark_group(&title);
        group.sample_size(20);
        pair(&title, "closed form", "parry, point by point");
        pair(&title, "closed form", "parry, a tree of the points");
        group.bench_function("closed form", |bencher| bencher.iter(closed_form));
        group.bench_function("parry, point by point", |bencher| bencher.iter(one_by_one));
        group.bench_function("parry, a tree of the points", |bencher| {
            bencher.iter(|| cast(&in_place, &tree))
        });
        group.finish();
    }
}

/// Distances of an outline from points, points in it, and edges that meet it.
fn outline(criterion: &mut Criterion<ThreadTime>) {
    let corners = OUTLINE.map(|(x, y)| Point2::new(x, y)).to_vec();
    let polygon =
        ConvexPolygon::from_convex_polyline_unmodified(corners.iter().map(|corner| vector(*corner)).collect());
    let polygon = polygon.unwrap();
    let footprint = Footprint::Polygon(corners.clone());
    // None of them lies on the outline.
    let points = lattice((-0.61, -0.41), (0.047, 0.031));
    let theirs: Vec<Vector> = points.iter().map(|point| vector(*point)).collect();
    for (point, same) in points.iter().zip(&theirs) {
        let off = footprint.distance(*point) - polygon.distance_to_local_point(*same, true);
        assert!(off.abs() < TOLERANCE, "{point}: {off} m");
        let inside = contains(&corners, *point);
        assert_eq!(inside, polygon.contains_local_point(*same), "{point}");
    }
    let pairs: Vec<(Edge, Edge)> = edges(&corners)
        .flat_map(|side| {
            points
                .windows(2)
                .map(move |ends| (side, Edge { a: ends[0], b: ends[1] }))
        })
        .collect();
    let same_pairs: Vec<[Vector; 4]> = pairs.iter().map(|(p, q)| [p.a, p.b, q.a, q.b].map(vector)).collect();
    let meet = |[a, b, c, d]: &[Vector; 4]| segments_intersection2d(*a, *b, *c, *d, 0.0).is_some();
    for ((p, q), same) in pairs.iter().zip(&same_pairs) {
        assert_eq!(touch(*p, *q), meet(same), "{p:?}, {q:?}");
    }

    let mut group = criterion.benchmark_group("outline");
    pair("outline", "distance, edge by edge", "distance, parry");
    pair("outline", "contains, crossings", "contains, parry");
    pair("outline", "edges that touch, sides", "edges that touch, parry");
    group.bench_function("distance, edge by edge", |bencher| {
        bencher.iter(|| points.iter().map(|point| footprint.distance(*point)).sum::<f64>());
    });
    group.bench_function("distance, parry", |bencher| {
        bencher.iter(|| {
            let distances = theirs.iter().map(|point| polygon.distance_to_local_point(*point, true));
            distances.sum::<f64>()
        });
    });
    group.bench_function("contains, crossings", |bencher| {
        bencher.iter(|| points.iter().filter(|point| contains(&corners, **point)).count());
    });
    group.bench_function("contains, parry", |bencher| {
        bencher.iter(|| {
            theirs
                .iter()
                .filter(|point| polygon.contains_local_point(**point))
                .count()
        });
    });
    group.bench_function("edges that touch, sides", |bencher| {
        bencher.iter(|| pairs.iter().filter(|(p, q)| touch(*p, *q)).count());
    });
    group.bench_function("edges that touch, parry", |bencher| {
        bencher.iter(|| same_pairs.iter().filter(|pair| meet(pair)).count());
    });
    group.finish();
}

/// Clearances of many places from the points of a scan.
fn clearances(criterion: &mut Criterion<ThreadTime>) {
    let points = seen(&model("jackal"));
    let dots: Vec<Vector> = points.iter().map(|point| vector(*point)).collect();
    let boxes: Vec<Aabb> = dots.iter().map(|dot| Aabb::new(*dot, *dot)).collect();
    let places = lattice((-2.4, -1.9), (0.19, 0.15));
    let build = || Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
    let tree = build();
    let nearest = |place: Point2<f64>| {
        let dot = |leaf: u32, _: f64| Some(PointProjection::new(false, dots[leaf as usize]));
        let found = tree.project_point(vector(place), f64::MAX, dot);
        found.map_or(f64::INFINITY, |(_, (distance, _))| distance)
    };
    let mut grid = ClearanceGrid::default();
    grid.fill(Point2::origin(), &points);
    for place in &places {
        let (ours, theirs) = (grid.distance(*place), nearest(*place));
        // The grid's own error.
        assert!(
            (ours - theirs).abs() < 1.5 * CELL + 0.05 * theirs,
            "{place}: {ours} m, parry's {theirs} m"
        );
    }

    let mut group = criterion.benchmark_group("clearances");
    pair("clearances", "chamfer grid, filled", "tree of parry, built");
    pair("clearances", "chamfer grid, look-ups", "tree of parry, look-ups");
    group.bench_function("chamfer grid, filled", |bencher| {
        bencher.iter(|| grid.fill(Point2::origin(), black_box(&points)));
    });
    group.bench_function("tree of parry, built", |bencher| bencher.iter_with_large_drop(build));
    group.bench_function("chamfer grid, look-ups", |bencher| {
        bencher.iter(|| places.iter().map(|place| grid.distance(*place)).sum::<f64>());
    });
    group.bench_function("tree of parry, look-ups", |bencher| {
        bencher.iter(|| places.iter().map(|place| nearest(*place)).sum::<f64>());
    });
    group.finish();
}

/// Names a function of parry's as the peer of ours in its group.
fn pair(group: &str, ours: &str, theirs: &str) {
    Pair::new(format!("{group}/{ours}"), theirs, format!("{group}/{theirs}")).print();
}

criterion_group! {
    name = benches;
    config = on_thread_time();
    targets = decision, contact, outline, clearances
}
criterion_main!(benches);
