//! Optimality of the sweep. On any path it is as fast as the same law as a linear programme, and keeps every limit.
#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "../benches/timing/lp.rs"]
mod lp;

use proptest::prelude::*;
use zenav_smoothing::{GeometricPath, Limits, PathPoint, TimeLaw, fastest};

const LIMITS: Limits = Limits {
    wheel_speed: 0.6,
    wheel_acceleration: 0.75,
    half_separation: 0.2,
    speed: 0.6,
    lateral_acceleration: 0.5,
    yaw_rate: 2.5,
    jerk: None,
};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_sweep_is_never_slower_than_the_program(turns in prop::collection::vec((-12.0..12.0_f64, 4_usize..40), 1..9)) {
        let mut k = 0.0;
        let mut links = Vec::new();
        for (target, pieces) in turns {
            links.extend((1..=pieces).map(|i| (0.02, k + (target - k) * i as f64 / pieces as f64)));
            k = target;
        }
        let path = GeometricPath::chain(PathPoint::default(), &links).unwrap();
        let sweep = TimeLaw::steady(&path, &fastest(&path, &LIMITS, 0.0).unwrap()).duration();
        let squared = lp::fastest(&path, &LIMITS).unwrap();
        let program = TimeLaw::steady(&path, &squared).duration();
        // The solver's tolerance is on squared speeds, and near rest the time depends on their roots.
        prop_assert!(sweep <= program * (1.0 + 1e-5) + 1e-4, "{} s against {} s", sweep, program);
        prop_assert!(program <= sweep * (1.0 + 1e-3) + 1e-3, "{} s against {} s", sweep, program);
    }
}
