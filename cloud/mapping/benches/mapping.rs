//! Insertion rate. Scans inserted per second, in both modes, and the agreement of the two maps.
//!
//! `cargo bench -p zenav-mapping --bench mapping`
//!
//! A furnished flat seen by two lidars, generated here by ray casting; with `ZENAV_BENCH_LOGS=FOLDER` also every CARMEN log (`.log`,
//! `.log.gz`) of a folder. Times are this thread's own processor time, so other load on the machine does not count.

#![allow(missing_docs, reason = "criterion's macros")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a bench stops at the first thing that is not as it should be, and tells what it found"
)]

use std::f64::consts::{PI, TAU};
use std::path::Path;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Point2, Vector2};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use zenav_fixtures::{Pair, ThreadTime, on_thread_time};
use zenav_mapping::carmen::{self, LOG_BEAMS};
use zenav_mapping::{BeamSettings, InsertMode, agreement, build_map};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;

/// Side of a cell, m.
const RESOLUTION: f64 = 0.05;
/// Scans of one drive through the flat.
const SCANS: usize = 600;

/// Input of a benchmark.
struct Input {
    name: String,
    scans: Vec<Scan>,
    beams: BeamSettings,
}

/// Rectangles (lower left, upper right) and circles (centre, radius), m.
struct Flat {
    walls: Vec<(Point2<f64>, Point2<f64>)>,
    legs: Vec<(Point2<f64>, f64)>,
}

impl Flat {
    fn furnished() -> Self {
        let rectangles = [
            // Outer walls, and one between two rooms with a door.
            [0.0, 0.0, 12.0, 7.0],
            [5.9, 0.0, 6.1, 2.8],
            [5.9, 3.8, 6.1, 7.0],
            // A kitchen along a wall, a bed, a cupboard, a sofa, a box.
            [0.0, 6.4, 4.2, 7.0],
            [9.6, 4.6, 12.0, 6.6],
            [6.1, 0.0, 7.6, 0.5],
            [0.3, 0.2, 2.3, 1.1],
            [11.2, 0.3, 11.7, 0.8],
        ];
        let walls = rectangles
            .iter()
            .flat_map(|[left, low, right, high]| {
                let corners =
                    [[left, low], [right, low], [right, high], [left, high]].map(|[x, y]| Point2::new(*x, *y));
                (0..4).map(move |i| (corners[i], corners[(i + 1) % 4]))
            })
            .collect();
        // A table with chairs, another one, and a plant.
        let table = |x: f64, y: f64| [[x, y], [x + 1.4, y], [x, y + 0.8], [x + 1.4, y + 0.8]];
        let legs = table(2.2, 3.1)
            .into_iter()
            .chain(table(8.3, 2.0))
            .map(|[x, y]| (Point2::new(x, y), 0.03))
            .chain([(Point2::new(5.2, 6.2), 0.2)])
            .collect();
        Self { walls, legs }
    }

    /// Distance to the first obstacle in a direction, m.
    fn range(&self, from: Point2<f64>, along: Vector2<f64>) -> f64 {
        let walls = self.walls.iter().filter_map(|(a, b)| {
            let (wall, to) = (b - a, a - from);
            let cross = along.perp(&wall);
            let (distance, share) = (to.perp(&wall) / cross, to.perp(&along) / cross);
            (distance > 0.0 && (0.0..=1.0).contains(&share)).then_some(distance)
        });
        let legs = self.legs.iter().filter_map(|(center, radius)| {
            let to = center - from;
            let (nearest, aside) = (to.dot(&along), to.perp(&along));
            let inside = radius * radius - aside * aside;
            (nearest > 0.0 && inside >= 0.0).then(|| nearest - inside.sqrt())
        });
        walls.chain(legs).fold(f64::INFINITY, f64::min)
    }

    /// A drive around the flat with a lidar of this geometry and 1 cm of noise, repeatable.
    fn scans(&self, beams: usize, field_of_view: f64, range_max: f64) -> Vec<Scan> {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let angle_increment = field_of_view / (beams - 1) as f64;
        (0..SCANS)
            .map(|number| {
                let turn = TAU * number as f64 / SCANS as f64;
                let at = Point2::new(6.0 + 4.8 * turn.cos(), 2.9 + 0.9 * (2.0 * turn).sin());
                let mut scan = Scan {
                    stamp: Stamp(number as u64 + 1),
                    angle_min: -0.5 * field_of_view,
                    angle_increment,
                    range_min: 0.02,
                    range_max,
                    ranges: Vec::new(),
                    odom_from_base: Pose2::new(at.x, at.y, turn + 0.5 * PI),
                    ..Scan::default()
                };
                scan.ranges = (0..beams)
                    .map(|beam| {
                        let angle = scan.angle(beam) + scan.odom_from_base.yaw;
                        let range = self.range(at, Vector2::new(angle.cos(), angle.sin()));
                        // The sum of twelve uniform numbers is nearly normal.
                        let noise: f64 = (0..12).map(|_| random.random::<f64>() - 0.5).sum();
                        if range < range_max {
                            (range + 0.01 * noise) as f32
                        } else {
                            f32::INFINITY
                        }
                    })
                    .collect();
                scan
            })
            .collect()
    }
}

fn inputs() -> Vec<Input> {
    let flat = Flat::furnished();
    let drive = |beams, field_of_view, range_max| Input {
        name: format!("flat, {beams} beams, {range_max} m"),
        scans: flat.scans(beams, field_of_view, range_max),
        beams: BeamSettings::default(),
    };
    let mut inputs = vec![drive(360, PI, 30.0), drive(667, 4.19, 5.6)];
    if let Some(folder) = std::env::var_os("ZENAV_BENCH_LOGS") {
        let mut logs: Vec<_> = Path::new(&folder)
            .read_dir()
            .expect("ZENAV_BENCH_LOGS: a folder")
            .map(|entry| entry.unwrap().path())
            .filter(|path| {
                [".log", ".log.gz"]
                    .iter()
                    .any(|ending| path.to_string_lossy().ends_with(ending))
            })
            .collect();
        logs.sort();
        inputs.extend(logs.iter().map(|path| Input {
            name: path.file_name().unwrap().to_string_lossy().into_owned(),
            scans: carmen::open(path).unwrap().map(Result::unwrap).collect(),
            beams: LOG_BEAMS,
        }));
    }
    inputs
}

fn insertion(criterion: &mut Criterion<ThreadTime>) {
    for input in inputs() {
        let build = |mode| build_map(&input.scans, RESOLUTION, mode, &input.beams).unwrap();
        let [reference, fast] = [InsertMode::Reference, InsertMode::Fast].map(|mode| build(mode).map.to_occupancy());
        let agreement = agreement(&reference, &fast);
        println!(
            "{}: {} scans; agreement {:.4} on occupied and {:.4} on free cells",
            input.name,
            input.scans.len(),
            agreement.occupied,
            agreement.free
        );
        let title = format!("insert {}", input.name);
        Pair::new(format!("{title}/fast"), "beam by beam", format!("{title}/reference")).print();
        let mut group = criterion.benchmark_group(&title);
        group
            .throughput(Throughput::Elements(input.scans.len() as u64))
            .sample_size(20);
        for (name, mode) in [("reference", InsertMode::Reference), ("fast", InsertMode::Fast)] {
            group.bench_function(BenchmarkId::from_parameter(name), |bencher| {
                bencher.iter(|| build(mode));
            });
        }
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = on_thread_time();
    targets = insertion
}
criterion_main!(benches);
