//! Time laws: computing time of the exact sweep, of the same law as a linear programme, and of the law with limited jerk.
//!
//! `cargo bench -p zenav-smoothing --bench timing`: thread CPU time; the durations of all laws are printed beside it. The paths are wavy
//! curves with straight pieces between, made from a seed, for a TIAGo.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a bench"
)]

mod lp;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use zenav_fixtures::{Pair, ThreadTime, on_thread_time};
use zenav_smoothing::{GeometricPath, Limits, PathPoint, TimeLaw, fastest, jerk_limited};

/// Jerk limit, m/s³.
const JERK: f64 = 2.0;

/// A path of `samples` points that lie `step` metres apart.
fn path(samples: usize, step: f64) -> GeometricPath {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let mut links = Vec::new();
    let mut k = 0.0;
    while links.len() + 1 < samples {
        let target = if random.random_bool(0.3) {
            0.0
        } else {
            random.random_range(-1.8..1.8)
        };
        let pieces = random.random_range(10..60).min(samples - 1 - links.len());
        let begin = k;
        for i in 1..=pieces {
            k = begin + (target - begin) * i as f64 / pieces as f64;
            links.push((step, k));
        }
    }
    GeometricPath::chain(PathPoint::default(), &links).unwrap()
}

fn laws(criterion: &mut Criterion<ThreadTime>) {
    let limits = Limits::of(&zenav_fixtures::robot("tiago"));
    for (samples, step) in [(200, 0.05), (1000, 0.02)] {
        let path = path(samples, step);
        let duration = |squared: &[f64]| TimeLaw::steady(&path, squared).duration();
        let sweep = fastest(&path, &limits, 0.0).unwrap();
        let program = lp::fastest(&path, &limits).unwrap();
        let smooth = jerk_limited(&path, &limits, JERK, &sweep).unwrap();
        println!(
            "{samples} points, {:.1} m: sweep {:.4} s, linear program {:.4} s, jerk at most {JERK} m/s³ {:.4} s ({} passes)",
            path.length(),
            duration(&sweep),
            duration(&program),
            smooth.law.duration(),
            smooth.passes
        );
        let mut group = criterion.benchmark_group("time law");
        group.sample_size(20);
        let mut bench = |name: &str, law: &dyn Fn()| {
            group.bench_function(BenchmarkId::new(name, samples), |bencher| {
                bencher.iter(law);
            });
        };
        Pair::new(
            format!("time law/sweep/{samples}"),
            "linear program by Clarabel",
            format!("time law/linear program/{samples}"),
        )
        .print();
        bench("sweep", &|| drop(black_box(fastest(&path, &limits, 0.0))));
        bench("linear program", &|| drop(black_box(lp::fastest(&path, &limits))));
        bench("limited jerk, all passes", &|| {
            drop(black_box(jerk_limited(&path, &limits, JERK, &sweep)))
        });
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = on_thread_time();
    targets = laws
}
criterion_main!(benches);
