//! Space-time search. Time to find a path past robots whose courses are known: `cargo bench -p zenav-planning --bench space_time`
//!
//! A hall of 12 m by 12 m with cells of 2.5 cm, in which all robots cross the middle, and an empty floor of 100 m by 100 m with one crossing
//! robot. Processor time of the thread.

#![allow(missing_docs, clippy::unwrap_used, reason = "a bench")]

use std::f64::consts::TAU;
use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::Point2;
use zenav_fixtures::{ThreadTime, on_thread_time};
use zenav_planning::{Budget, SpaceTimeQuery, SpaceTimeSettings, search_space_time};
use zenav_protocol::messages::{CoursePlace, KnownCourse};
use zenav_protocol::robot::Footprint;
use zenav_space::{ConfigurationSpace, UnknownPolicy};

const RADIUS: f64 = 0.27;
const SPEED: f64 = 0.5;

/// An empty square floor, m, and the space of the robot's disc on it.
fn floor(side: f64, resolution: f64) -> ConfigurationSpace {
    let cells = (side / resolution) as u32;
    let map = zenav_fixtures::free_map(zenav_fixtures::spec(cells, cells, resolution));
    ConfigurationSpace::new(&map, &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0)
}

/// The course of a robot straight from place to place.
fn course(from: Point2<f64>, to: Point2<f64>) -> KnownCourse {
    let secs = (to - from).norm() / SPEED;
    let place = |nth: u32| {
        let share = f64::from(nth) / 40.0;
        let at = from + (to - from) * share;
        CoursePlace {
            secs: secs * share,
            x: at.x,
            y: at.y,
        }
    };
    KnownCourse {
        radius: RADIUS,
        places: (0..=40).map(place).collect(),
    }
}

fn space_time(criterion: &mut Criterion<ThreadTime>) {
    let mut group = criterion.benchmark_group("space_time");
    let settings = SpaceTimeSettings::default();
    let hall = floor(12.0, 0.025);
    for others in [1_u32, 7, 15] {
        let courses: Vec<KnownCourse> = (1..=others)
            .map(|nth| {
                let angle = TAU * f64::from(nth) / f64::from(others + 1);
                let off = [4.5 * angle.cos(), 4.5 * angle.sin()];
                course(
                    Point2::new(6.0 + off[0], 6.0 + off[1]),
                    Point2::new(6.0 - off[0], 6.0 - off[1]),
                )
            })
            .collect();
        let query = SpaceTimeQuery {
            start: Point2::new(10.5, 6.0),
            goal: Point2::new(1.5, 6.0),
            speed: SPEED,
            radius: RADIUS,
            courses: &courses,
        };
        group.bench_with_input(BenchmarkId::new("circle", others), &query, |bencher, query| {
            bencher.iter(|| search_space_time(&hall, black_box(query), &settings, Budget::UNLIMITED).unwrap());
        });
    }
    let large = floor(100.0, 0.1);
    let courses = [course(Point2::new(20.0, 1.0), Point2::new(1.0, 20.0))];
    let query = SpaceTimeQuery {
        start: Point2::new(1.0, 1.0),
        goal: Point2::new(99.0, 99.0),
        speed: SPEED,
        radius: RADIUS,
        courses: &courses,
    };
    group.bench_function("100 m", |bencher| {
        bencher.iter(|| search_space_time(&large, black_box(&query), &settings, Budget::UNLIMITED).unwrap());
    });
    group.finish();
}

criterion_group! {
    name = benches;
    config = on_thread_time();
    targets = space_time
}
criterion_main!(benches);
