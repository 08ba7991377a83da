//! x
use zenav_cloud::smoothing::timing::*;
use zenav_cloud::smoothing::timing::{jerk, sweep::fastest};
fn cpu() -> f64 {
    std::thread::yield_now();
    std::fs::read_to_string("/proc/thread-self/schedstat")
        .unwrap()
        .split(' ')
        .next()
        .unwrap()
        .parse::<f64>()
        .unwrap()
        * 1e-3
}
fn main() {
    {
        let limits = Limits {
            wheel_speed: 0.6,
            wheel_acceleration: 0.75,
            half_separation: 0.2,
            speed: 0.6,
            lateral_acceleration: 0.5,
            yaw_rate: 2.5,
            jerk: None,
        };
        let mut links = vec![(0.02, 0.0); 60];
        links.extend((1..=5).map(|i| (0.001, 34.0 * i as f64 / 5.0)));
        let path = GeometricPath::chain(PathPoint::default(), &links).unwrap();
        let mut l2 = links.clone();
        l2.extend((1..=5).map(|i| (0.001, 34.0 - 34.0 * i as f64 / 5.0)));
        l2.extend([(0.02, 0.0); 60]);
        let path2 = GeometricPath::chain(PathPoint::default(), &l2).unwrap();
        for path in [path, path2] {
            for j in [0.3, 1.0, 3.0, 10.0] {
                let sq = fastest(&path, &limits, 0.0).unwrap();
                let l = jerk::limited(&path, &limits, j, &sq);
                match l {
                    Ok(l) => println!(
                        "  sharp J {j}: {:.3} of {:.3} s passes {} {} {} gap {:.1e}",
                        l.law.duration(),
                        TimeLaw::steady(&path, &sq).duration(),
                        l.passes,
                        l.status,
                        l.iterations,
                        l.gap
                    ),
                    Err(x) => println!(" J {j} {x}"),
                }
            }
        }
    }
    let limits = Limits {
        wheel_speed: 0.6,
        wheel_acceleration: 0.75,
        half_separation: 0.2,
        speed: 0.6,
        lateral_acceleration: 0.5,
        yaw_rate: 2.5,
        jerk: None,
    };
    for (n, step) in [(200usize, 0.1), (200, 0.05), (1000, 0.02)] {
        let mut links = vec![];
        for i in 1..n {
            let s = i as f64 * step;
            links.push((step, 1.2 * (s * 0.9).sin() * (0.3 * s).cos()));
        }
        let path = GeometricPath::chain(PathPoint::default(), &links).unwrap();
        let t = cpu();
        let mut sq = vec![];
        for _ in 0..1000 {
            sq = fastest(&path, &limits, 0.0).unwrap();
        }
        let sweep = TimeLaw::steady(&path, &sq);
        println!("{n} sweep {:?} {:.3}s", (cpu() - t) / 1000.0, sweep.duration());
        for j in [0.3, 1.0, 3.0, 10.0] {
            let t = cpu();
            let mut l = jerk::limited(&path, &limits, j, &sq);
            for _ in 0..9 {
                l = jerk::limited(&path, &limits, j, &sq);
            }
            let e = (cpu() - t) / 10.0;
            match l {
                Ok(l) => println!(
                    "  J {j}: {e:.0} us {:.3} s passes {} {} {} gap {:.1e}",
                    l.law.duration(),
                    l.passes,
                    l.status,
                    l.iterations,
                    l.gap
                ),
                Err(x) => println!(" J {j} {e:.0} us {x}"),
            }
        }
    }
}
