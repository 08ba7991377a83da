//! How long does a tick take? Trees of 30 and 1,000 nodes in which every node is ticked in every tick, with leaves that read ports; and
//! Nav2's default tree while the robot drives, against scripted leaves.
//!
//! `cargo bench -p zenav-behaviour-tree --bench tick`; measures thread CPU time, so that other load on the machine does not matter.
#![allow(missing_docs, clippy::unwrap_used, reason = "a bench")]

use std::hint::black_box;
use std::time::Duration;

use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rustix::time::{ClockId, clock_gettime};
use zenav_behaviour_tree::simulate::{Script, Simulation, registry};
use zenav_behaviour_tree::{Status, build};

mod trees;

use trees::reactive_tree;

/// CPU time of this thread.
struct ThreadTime;

impl Measurement for ThreadTime {
    type Intermediate = Duration;
    type Value = Duration;

    fn start(&self) -> Duration {
        let now = clock_gettime(ClockId::ThreadCPUTime);
        Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
    }
    fn end(&self, since: Duration) -> Duration {
        self.start().saturating_sub(since)
    }
    fn add(&self, one: &Duration, two: &Duration) -> Duration {
        *one + *two
    }
    fn zero(&self) -> Duration {
        Duration::ZERO
    }
    fn to_f64(&self, time: &Duration) -> f64 {
        time.as_nanos() as f64
    }
    fn formatter(&self) -> &dyn ValueFormatter {
        WallTime.formatter()
    }
}

fn ticks(c: &mut Criterion<ThreadTime>) {
    let mut group = c.benchmark_group("tick");
    for nodes in [30_usize, 1000] {
        let mut tree = reactive_tree(nodes).unwrap();
        group.throughput(Throughput::Elements(tree.len() as u64));
        group.bench_function(BenchmarkId::new("nodes", nodes), |b| {
            let mut total = 0;
            b.iter(|| {
                let status = tree.tick(Duration::ZERO, &mut total);
                assert_eq!(black_box(status), Ok(Status::Running));
            });
        });
    }
    let text = include_bytes!("../src/tests/navigate.xml");
    let none = &mut |_: &str, _: &str| Err("none".to_owned());
    let mut tree = build("navigate.xml", text, &registry(), None, none).unwrap();
    let script: Script = serde_json::from_str(r#"{"leaves": {"FollowPath": {"status": "RUNNING"}}}"#).unwrap();
    let mut simulation = Simulation::new(script);
    let mut now = Duration::ZERO;
    group.throughput(Throughput::Elements(tree.len() as u64));
    group.bench_function("nav2_default_driving", |b| {
        b.iter(|| {
            now += Duration::from_millis(10);
            assert_eq!(black_box(tree.tick(now, &mut simulation)), Ok(Status::Running));
        });
    });
    group.finish();
}

fn loads(c: &mut Criterion<ThreadTime>) {
    let text = include_bytes!("../src/tests/navigate.xml");
    let registry = registry();
    c.bench_function("load_nav2_default", |b| {
        b.iter(|| {
            let none = &mut |_: &str, _: &str| Err("none".to_owned());
            build("navigate.xml", black_box(text), &registry, None, none).unwrap()
        });
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().with_measurement(ThreadTime).measurement_time(Duration::from_secs(2)).warm_up_time(Duration::from_millis(500));
    targets = ticks, loads
}
criterion_main!(benches);
