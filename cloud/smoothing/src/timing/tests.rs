//! Tests of trajectories in time, by sampling them at a millisecond and by integrating them.

use nalgebra::Point2;
use proptest::prelude::*;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};

use super::stop_turn_go::stop_turn_go;
use super::{GeometricPath, Limits, PathPoint, PiecewiseTrajectory, UNRESTRICTED};

const LIMITS: Limits = Limits {
    wheel_speed: 0.6,
    wheel_acceleration: 0.75,
    half_separation: 0.2,
    speed: 0.55,
    lateral_acceleration: 0.5,
    yaw_rate: 2.5,
    jerk: None,
};

/// Slack of every limit, in its own unit.
const SLACK: f64 = 1e-6;

/// Turns one after the other: the curvature (1/m) that each reaches, and its length (m).
fn curve(turns: &[(f64, f64)]) -> GeometricPath {
    let mut links = Vec::new();
    let mut k = 0.0;
    for &(target, length) in turns {
        let pieces = (length / 0.02)
            .max(0.5 * (f64::abs(k) + f64::abs(target)) * length / 0.04)
            .ceil();
        let begin = k;
        for i in 1..=pieces as usize {
            k = begin + (target - begin) * i as f64 / pieces;
            links.push((length / pieces, k));
        }
        k = target;
    }
    let start = PathPoint {
        x: 3.0,
        y: -2.0,
        yaw: 0.7,
        ..PathPoint::default()
    };
    GeometricPath::chain(start, &links).unwrap()
}

/// Halls, corners, and places where the curve almost turns on the spot.
fn turns() -> impl Strategy<Value = Vec<(f64, f64)>> {
    let gentle = (-3.0..3.0_f64, 0.1..1.5_f64);
    let straight = (0.0..1.0_f64).prop_map(|length| (0.0, 0.1 + length));
    let sharp = (prop_oneof![5.0..120.0_f64, -120.0..-5.0_f64], 0.005..0.05_f64);
    prop::collection::vec(prop_oneof![4 => gentle, 2 => straight, 1 => sharp], 1..9)
}

fn assert_within_limits(trajectory: &PiecewiseTrajectory, limits: &Limits) {
    let h = limits.half_separation;
    let states = trajectory.states(0.001);
    for state in &states {
        let (v, w) = (state.point.v, state.point.w);
        assert!(v <= limits.speed + SLACK, "speed {v} at {}", state.point.t);
        for wheel in [h, -h] {
            assert!(
                (v + wheel * w).abs() <= limits.wheel_speed + SLACK,
                "wheel speed at {state:?}"
            );
            let acceleration = state.a + wheel * state.alpha;
            assert!(
                acceleration.abs() <= limits.wheel_acceleration + SLACK,
                "wheel acceleration {acceleration} at {state:?}"
            );
        }
        assert!(
            (v * w).abs() <= limits.lateral_acceleration + SLACK,
            "lateral acceleration at {state:?}"
        );
        assert!(w.abs() <= limits.yaw_rate + SLACK, "yaw rate at {state:?}");
    }
    if let Some(jerk) = limits.jerk {
        for pair in states.windows(2) {
            let dt = pair[1].point.t - pair[0].point.t;
            let change = |of: fn(&super::State) -> f64| (of(&pair[1]) - of(&pair[0])).abs();
            assert!(
                change(|s| s.a) <= (jerk + SLACK) * dt,
                "jerk {} at {:?}",
                change(|s| s.a) / dt,
                pair[0]
            );
            let spins = pair.iter().all(|state| state.point.v == 0.0 && state.a == 0.0);
            assert!(
                !spins || h * change(|s| s.alpha) <= (jerk + SLACK) * dt,
                "jerk of a spin at {:?}",
                pair[0]
            );
        }
    }
}

/// Integrates velocities and accelerations from the first state on: everything stays where the trajectory says.
fn assert_consistent(trajectory: &PiecewiseTrajectory) {
    let steps = (trajectory.duration() / 2e-4).ceil();
    let dt = trajectory.duration() / steps;
    let mut at = trajectory.at(0.0).point;
    for i in 0..steps as usize {
        let middle = trajectory.at(dt * (i as f64 + 0.5));
        let yaw = at.yaw + 0.5 * dt * middle.point.w;
        (at.x, at.y) = (
            at.x + dt * middle.point.v * yaw.cos(),
            at.y + dt * middle.point.v * yaw.sin(),
        );
        at.yaw += dt * middle.point.w;
        at.v += dt * middle.a;
        at.w += dt * middle.alpha;
        let there = trajectory.at(dt * (i as f64 + 1.0)).point;
        assert!(
            (there.x - at.x).hypot(there.y - at.y) < 1e-6,
            "{} m off at {}",
            (there.x - at.x).hypot(there.y - at.y),
            there.t
        );
        assert!(
            wrap_angle(there.yaw - at.yaw).abs() < 1e-6,
            "{} rad off at {}",
            wrap_angle(there.yaw - at.yaw),
            there.t
        );
        // The acceleration may jump within a step, which is then off by that much.
        assert!(
            (there.v - at.v).abs() < 4e-4 && (there.w - at.w).abs() < 1e-2,
            "{there:?} against {at:?}"
        );
        (at.v, at.w) = (there.v, there.w);
    }
}

fn followed(turns: &[(f64, f64)], start_speed: f64, limits: &Limits) -> Option<PiecewiseTrajectory> {
    let mut trajectory = PiecewiseTrajectory::new();
    trajectory.follow(curve(turns), start_speed, limits).ok()?;
    Some(trajectory)
}

#[test]
fn a_straight_line_with_limited_jerk_is_nearly_the_double_s() {
    let limits = Limits {
        jerk: Some(1.0),
        ..LIMITS
    };
    let mut trajectory = PiecewiseTrajectory::new();
    trajectory
        .follow(
            GeometricPath::straight(Point2::origin(), Point2::new(6.0, 0.0), 0.02).unwrap(),
            0.0,
            &limits,
        )
        .unwrap();
    let (limited, figures) = trajectory.with_limited_jerk(&limits);
    assert_eq!(figures.unwrap().failed, None);
    // 6 m at 0.55 m/s, gained and lost with 0.74 m/s² at most (0.75 is not reached).
    let double_s = 6.0 / 0.55 + 2.0 * (0.55_f64 / 1.0).sqrt();
    assert!(
        (limited.duration() / double_s - 1.0).abs() < 0.01,
        "{} against {double_s}",
        limited.duration()
    );
    let sweep = followed(&[(0.0, 6.0)], 0.0, &LIMITS).unwrap().duration();
    assert!((limited.lower_bound() / sweep - 1.0).abs() < 1e-6);
    assert_within_limits(&limited, &limits);
    assert_consistent(&limited);
}

#[test]
fn a_way_too_short_for_a_program_keeps_the_sweep_and_says_so() {
    let limits = Limits {
        jerk: Some(1.0),
        ..LIMITS
    };
    let path = GeometricPath::chain(PathPoint::default(), &[(0.01, 0.0), (0.01, 0.0)]).unwrap();
    let mut trajectory = PiecewiseTrajectory::new();
    trajectory.follow(path, 0.0, &limits).unwrap();
    let duration = trajectory.duration();
    let (kept, figures) = trajectory.with_limited_jerk(&limits);
    assert_eq!(
        (kept.duration(), figures.unwrap().solver.status.as_str()),
        (duration, "too_short")
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20))]

    #[test]
    fn a_followed_curve_keeps_every_limit_and_is_where_its_velocity_leads(turns in turns(), start in prop_oneof![Just(0.0), 0.0..0.5_f64]) {
        let Some(trajectory) = followed(&turns, start, &LIMITS) else { return Ok(()) };
        assert_within_limits(&trajectory, &LIMITS);
        assert_consistent(&trajectory);
    }

    #[test]
    fn with_limited_jerk_too(turns in turns(), start in prop_oneof![2 => Just(0.0), 1 => 0.0..0.3_f64], jerk in 0.3..8.0_f64) {
        let limits = Limits { jerk: Some(jerk), ..LIMITS };
        let Some(sweep) = followed(&turns, start, &limits) else { return Ok(()) };
        let bound = sweep.duration();
        let (trajectory, figures) = sweep.with_limited_jerk(&limits);
        prop_assert!(trajectory.duration() >= bound * (1.0 - 1e-9) && trajectory.lower_bound() == bound);
        assert_consistent(&trajectory);
        match figures.unwrap().failed {
            None => assert_within_limits(&trajectory, &limits),
            Some(error) => {
                prop_assert!(start > 0.0 || sweep_is_short(&turns), "{} from rest on {:?}", error, turns);
                assert_within_limits(&trajectory, &limits.without_jerk());
            }
        }
    }

    #[test]
    fn stop_turn_go_keeps_every_limit_of_any_robot(
        raw in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64), 0..5), yaw in -3.0..3.0_f64, v in -0.3..0.5_f64, w in -1.0..1.0_f64,
        goal_yaw in prop::option::of(-3.0..3.0_f64), jerk in prop::option::of(0.3..8.0_f64),
    ) {
        let limits = Limits { jerk, ..LIMITS };
        prop_assume!(limits.surface_speed(Twist2::new(v, w)) <= limits.wheel_speed && (v * w).abs() <= limits.lateral_acceleration);
        let path: Vec<_> = raw.into_iter().map(|(x, y)| Point2::new(x, y)).collect();
        let start = Pose2::new(0.1, 0.2, yaw);
        let (trajectory, figures) = stop_turn_go(&path, start, Twist2::new(v, w), goal_yaw, &limits, UNRESTRICTED).with_limited_jerk(&limits);
        let kept = if figures.is_some_and(|figures| figures.failed.is_some()) { limits.without_jerk() } else { limits };
        assert_within_limits(&trajectory, &kept);
        assert_consistent(&trajectory);
        if let (Some(end), false) = (path.last(), trajectory.is_empty()) {
            let last = trajectory.at(trajectory.duration()).point;
            prop_assert!((last.x - end.x).hypot(last.y - end.y) < 2e-3 && last.v == 0.0 && last.w == 0.0);
            prop_assert!(goal_yaw.is_none_or(|yaw| wrap_angle(last.yaw - yaw).abs() < 1e-9));
        }
    }
}

/// Whether there are too few samples for a programme.
fn sweep_is_short(turns: &[(f64, f64)]) -> bool {
    curve(turns).points().len() < 5
}
