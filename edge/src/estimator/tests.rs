#![allow(clippy::unwrap_used, reason = "tests")]

use proptest::prelude::*;
use proptest::strategy::ValueTree as _;

use super::measurement_buffer::WINDOW;
use super::*;

/// Ticks of a drive: longer than the window.
const TICKS: usize = 200;
/// The most ticks within the window.
const WINDOW_TICKS: usize = (WINDOW * 50.0) as usize;

fn model() -> RobotModel {
    zenav_fixtures::robot("tiago")
}

/// An estimator that knows its start to `std`, m and rad.
fn estimator(start: Pose2, std: f64) -> Estimator {
    let settings = EstimatorSettings {
        start_std: std,
        start_yaw_std: std,
        ..EstimatorSettings::default()
    };
    Estimator::new(&model(), start, &settings)
}

fn stamp(tick: usize) -> Stamp {
    Stamp(tick as u64 * 20_000_000)
}

fn readings(tick: usize, wheels: [f64; 2]) -> Readings {
    let stamp = stamp(tick);
    Readings {
        wheels,
        ..Readings::new(stamp)
    }
}

/// An input that arrives.
#[derive(Clone, Debug)]
enum Item {
    Wheels(Readings),
    Imu(Imu),
    Gps(Gps),
    Correction(Correction),
}

/// The sensor data of a winding drive, in the order of stamps, each with the tick it was made in. Some measurements lie far off.
fn drive(speeds: &[(f64, f64)], noise: &[f64]) -> Vec<(usize, Item)> {
    let drive = model().drive;
    let mut noise = noise.iter().copied().cycle();
    let mut wobble = move || noise.next().unwrap_or(0.0);
    let (mut pose, mut wheels) = (Pose2::new(1.0, 2.0, 0.3), [0.0; 2]);
    let mut items = Vec::new();
    for tick in 0..TICKS {
        let (left, right) = speeds[tick / 10 % speeds.len()];
        let twist = drive.twist([left, right]);
        if tick > 0 {
            pose = pose.advance(twist, 0.02);
            wheels = [wheels[0] + 0.02 * left, wheels[1] + 0.02 * right];
        }
        items.push((tick, Item::Wheels(readings(tick, wheels))));
        let imu = Imu {
            stamp: stamp(tick),
            yaw_rate: twist.w + 0.01 * wobble(),
            yaw: (tick % 2 == 0).then(|| pose.yaw + 0.02 * wobble()),
        };
        items.push((tick, Item::Imu(imu)));
        if tick % 5 == 3 {
            // Between two ticks.
            let gps = Gps {
                stamp: stamp(tick) - std::time::Duration::from_millis(7),
                x: pose.x + 0.1 * wobble(),
                y: pose.y + 0.1 * wobble(),
                std_dev: 0.02,
            };
            items.push((tick, Item::Gps(gps)));
        }
        if tick % 20 == 7 {
            let correction = Correction {
                stamp: stamp(tick),
                boot_id: String::new(),
                map_from_base: Pose2::new(pose.x + 0.1 * wobble(), pose.y + 0.1 * wobble(), pose.yaw),
                covariance: [0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01],
                is_found_anew: false,
                frame: 0,
                moves: Vec::new(),
            };
            items.push((tick, Item::Correction(correction)));
        }
    }
    items
}

fn take(estimator: &mut Estimator, item: &Item) {
    match item {
        Item::Wheels(readings) => estimator.wheels(readings),
        Item::Imu(imu) => estimator.imu(imu),
        Item::Gps(gps) => estimator.gps(gps),
        Item::Correction(correction) => estimator.correction(correction),
    }
}

/// Applies each item with its delay, in ticks; several in one tick in the order in which they were made.
fn estimate(items: &[(usize, Item)], delay: impl Fn(usize) -> usize) -> Estimator {
    let mut arrivals: Vec<(usize, &Item)> = items
        .iter()
        .enumerate()
        .map(|(index, (made, item))| (made + delay(index), item))
        .collect();
    arrivals.sort_by_key(|(arrival, _)| *arrival);
    let mut estimator = self::estimator(Pose2::new(1.0, 2.0, 0.3), 0.05);
    for tick in arrivals.chunk_by(|a, b| a.0 == b.0) {
        tick.iter().for_each(|(_, item)| take(&mut estimator, item));
        estimator.settle();
    }
    estimator
}

/// Largest difference of pose and covariance.
fn difference(a: &Estimator, b: &Estimator) -> f64 {
    let (here, there) = (a.map_from_base(), b.map_from_base());
    let pose = [here.x - there.x, here.y - there.y, here.yaw - there.yaw];
    let covariance = a.covariance().into_iter().zip(b.covariance()).map(|(a, b)| a - b);
    pose.into_iter().chain(covariance).map(f64::abs).fold(0.0, f64::max)
}

fn speeds() -> impl Strategy<Value = Vec<(f64, f64)>> {
    prop::collection::vec((-2.0..5.0, -2.0..5.0), 20)
}

fn noise() -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(-1.0..1.0, 50)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_late_input_counts_as_if_it_had_come_in_order(
        speeds in speeds(),
        noise in noise(),
        late in prop::collection::vec((any::<prop::sample::Index>(), 1..=WINDOW_TICKS), 0..20),
    ) {
        let items = drive(&speeds, &noise);
        let mut delays = vec![0; items.len()];
        for (index, ticks) in late {
            // The drive's own first and last wheels say when it begins and ends.
            let index = index.index(items.len() - 4).max(1);
            delays[index] = ticks.min(TICKS - 1 - items[index].0);
        }
        let (in_order, delayed) = (estimate(&items, |_| 0), estimate(&items, |index| delays[index]));
        prop_assert!(difference(&in_order, &delayed) < 1e-9, "{}", difference(&in_order, &delayed));
        prop_assert_eq!(delayed.tally().too_late, 0);
    }

    #[test]
    fn what_is_later_than_the_window_is_left_out_and_counted(
        speeds in speeds(),
        noise in noise(),
        late in any::<prop::sample::Index>(),
        // One tick more is still within the window: the wheels of the tick come after it.
        more in 2..20_usize,
    ) {
        let items = drive(&speeds, &noise);
        let early: Vec<usize> = (0..items.len())
            .filter(|index| items[*index].0 + WINDOW_TICKS + 20 < TICKS && matches!(items[*index].1, Item::Gps(_) | Item::Correction(_)))
            .collect();
        let late = *late.get(&early);
        let mut without = items.clone();
        without.remove(late);
        let dropped = estimate(&items, |index| if index == late { WINDOW_TICKS + more } else { 0 });
        prop_assert_eq!(difference(&dropped, &estimate(&without, |_| 0)), 0.0);
        prop_assert_eq!(dropped.tally().too_late, 1);
    }

    #[test]
    fn what_comes_twice_or_is_no_number_changes_nothing(
        speeds in speeds(),
        noise in noise(),
        hit in prop::collection::vec(any::<prop::sample::Index>(), 1..20),
    ) {
        let items = drive(&speeds, &noise);
        let mut spoiled = items.clone();
        for hit in &hit {
            let (tick, item) = hit.get(&items).clone();
            spoiled.push((tick, item));
            let stamp = Stamp(stamp(tick).0 + 1);
            spoiled.push((tick, Item::Imu(Imu { stamp, yaw_rate: f64::NAN, yaw: Some(f64::INFINITY) })));
            spoiled.push((tick, Item::Gps(Gps { stamp, x: f64::NAN, y: 0.0, std_dev: 0.02 })));
            spoiled.push((tick, Item::Gps(Gps { stamp, x: 0.0, y: 0.0, std_dev: -1.0 })));
            let covariance = [1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0];
            spoiled.push((tick, Item::Correction(Correction { stamp, boot_id: String::new(), map_from_base: Pose2::IDENTITY, covariance, is_found_anew: false, frame: 0, moves: Vec::new() })));
        }
        let (clean, spoiled) = (estimate(&items, |_| 0), estimate(&spoiled, |_| 0));
        prop_assert_eq!(difference(&clean, &spoiled), 0.0);
        prop_assert!(spoiled.tally().repeated >= hit.len() as u64 && spoiled.tally().broken == 5 * hit.len() as u64, "{:?}", spoiled.tally());
    }

    #[test]
    fn no_correction_makes_odometry_jump(speeds in speeds(), noise in noise(), offsets in prop::collection::vec((-0.5..0.5, -0.5..0.5), 10)) {
        let mut estimator = self::estimator(Pose2::new(1.0, 2.0, 0.3), 0.5);
        let mut before = estimator.odom_from_base();
        let mut jumped = 0.0_f64;
        let mut offsets = offsets.into_iter().cycle();
        for tick in drive(&speeds, &noise).chunk_by(|a, b| a.0 == b.0) {
            let map_before = estimator.map_from_base();
            for (_, item) in tick {
                let mut item = item.clone();
                if let (Item::Correction(correction), Some((x, y))) = (&mut item, offsets.next()) {
                    (correction.map_from_base.x, correction.map_from_base.y) = (correction.map_from_base.x + x, correction.map_from_base.y + y);
                }
                take(&mut estimator, &item);
            }
            estimator.settle();
            let step = before.inverse() * estimator.odom_from_base();
            // No wheel turns faster than 5 rad/s here.
            prop_assert!(step.position().coords.norm() < 0.02 * 5.0 * 0.0985 + 1e-9 && step.yaw.abs() < 0.06, "{step:?}");
            before = estimator.odom_from_base();
            jumped = jumped.max(map_before.distance(&estimator.map_from_base()));
        }
        prop_assert!(jumped > 0.02, "nothing corrected the pose in the map: {jumped}");
    }
}

#[test]
fn a_gyro_that_comes_late_takes_the_place_of_the_wheels_turn() {
    let mut estimator = self::estimator(Pose2::IDENTITY, 0.01);
    // The base turns by 0.5 rad/s, and the wheels slip: they do not show it.
    for tick in 0..100 {
        let mut readings = readings(tick, [0.02 * tick as f64; 2]);
        readings.imu = tick.checked_sub(10).map(|then| Imu {
            stamp: stamp(then),
            yaw_rate: 0.5,
            yaw: None,
        });
        estimator.step(&readings, &[]);
    }
    // Known for all but the last ten ticks and the first reading's time.
    let expected = 0.5 * 0.02 * 89.0;
    assert!(
        (estimator.map_from_base().yaw - expected).abs() < 0.02,
        "{:?}",
        estimator.map_from_base()
    );
    assert!(
        (estimator.odom_from_base().yaw - expected).abs() < 0.02,
        "{:?}",
        estimator.odom_from_base()
    );
}

#[test]
fn wheels_that_fall_silent_are_made_up_for_and_without_end_nothing_is_sure() {
    let silent = |from: usize, to: usize| {
        let mut estimator = self::estimator(Pose2::IDENTITY, 0.01);
        for tick in 0..150 {
            let angle = 0.04 * tick as f64;
            let wheels = if (from..to).contains(&tick) { f64::NAN } else { angle };
            estimator.step(&readings(tick, [wheels; 2]), &[]);
        }
        estimator
    };
    let (sound, short, forever) = (silent(0, 0), silent(50, 60), silent(50, 150));
    assert!((sound.map_from_base().x - short.map_from_base().x).abs() < 1e-9);
    assert!(
        short.covariance()[0] < 1e-3 && forever.covariance()[0] > 0.1,
        "{:?}",
        forever.covariance()
    );
    assert_eq!(short.tally().broken, 10);
}

#[test]
fn encoders_that_count_anew_after_a_pause_do_not_move_the_robot() {
    let mut estimator = self::estimator(Pose2::IDENTITY, 0.01);
    for tick in 0..1000 {
        estimator.step(&readings(tick, [0.04 * tick as f64; 2]), &[]);
    }
    let before = estimator.odom_from_base();
    // Five seconds later its driver runs again.
    for tick in 0..100 {
        estimator.step(&readings(1250 + tick, [0.04 * tick as f64; 2]), &[]);
    }
    let way = (before.inverse() * estimator.odom_from_base()).x;
    let driven = 0.04 * 99.0 * model().drive.wheel_radius;
    assert!((way - driven).abs() < 0.01, "{way} of {driven} m");
    assert!(estimator.covariance()[0] > 0.1, "it may have been pushed meanwhile");
}

#[test]
fn a_rate_beyond_what_a_gyro_measures_is_left_out() {
    let mut estimator = self::estimator(Pose2::IDENTITY, 0.01);
    for tick in 0..100 {
        let mut readings = readings(tick, [0.02 * tick as f64; 2]);
        readings.imu = Some(Imu {
            stamp: stamp(tick),
            yaw_rate: if tick == 20 { 1e20 } else { 0.5 },
            yaw: None,
        });
        estimator.step(&readings, &[]);
    }
    let (expected, odom) = (0.5 * 0.02 * 99.0, estimator.odom_from_base());
    assert!((odom.yaw - expected).abs() < 0.03, "{odom:?}");
    assert!((estimator.map_from_base().yaw - expected).abs() < 0.03);
    assert_eq!(estimator.tally().broken, 1);
}

#[test]
fn a_place_known_to_no_measurable_distance_replaces_nothing() {
    let mut estimator = self::estimator(Pose2::IDENTITY, 0.01);
    let found = Correction {
        stamp: stamp(10),
        map_from_base: Pose2::new(7.0, -3.0, 2.0),
        covariance: [1e300, 0.0, 0.0, 0.0, 1e300, 0.0, 0.0, 0.0, 1e300],
        is_found_anew: true,
        ..Correction::default()
    };
    for tick in 0..20 {
        estimator.step(&readings(tick, [0.0; 2]), (tick == 15).then_some(&found));
    }
    assert!(estimator.map_from_base().distance(&Pose2::IDENTITY) < 1e-9);
    assert!(estimator.covariance()[0] < 0.01);
    assert_eq!(estimator.tally().broken, 1);
}

#[test]
fn a_body_whose_clock_begins_anew_is_followed_again() {
    let mut estimator = self::estimator(Pose2::IDENTITY, 0.01);
    for tick in 500..600 {
        estimator.step(&readings(tick, [0.04 * tick as f64; 2]), &[]);
    }
    let before = estimator.map_from_base();
    for tick in 0..100 {
        estimator.step(&readings(tick, [0.04 * tick as f64; 2]), &[]);
    }
    let way = estimator.map_from_base().x - before.x;
    assert!((0.2..0.4).contains(&way), "{way}");
    assert!(estimator.odom_from_base_at(stamp(90)).is_some());
}

#[test]
fn a_flood_of_inputs_is_bounded() {
    let mut estimator = self::estimator(Pose2::IDENTITY, 0.01);
    for tick in 0..20 {
        let corrections: Vec<_> = (0..500)
            .map(|i| Correction {
                stamp: Stamp(stamp(tick).0 + i * 1_000),
                boot_id: String::new(),
                map_from_base: Pose2::IDENTITY,
                covariance: [0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01],
                is_found_anew: false,
                frame: 0,
                moves: Vec::new(),
            })
            .collect();
        estimator.step(&readings(tick, [0.0; 2]), &corrections);
    }
    assert!(estimator.map_from_base().is_finite());
    assert!(estimator.buffer.as_ref().is_some_and(|buffer| buffer.len() <= 1024));
}

#[test]
fn a_gyro_that_turns_by_itself_is_learned_in_a_third_of_a_second_at_rest() {
    let settings = EstimatorSettings::default();
    let mut model = model();
    (model.gps, model.imu.compass_noise) = (None, None);
    let mut estimator = Estimator::new(&model, Pose2::IDENTITY, &settings);
    let speed = 4.0;
    for tick in 0..3_000_usize {
        let angle = 0.02 * speed * tick.saturating_sub(15) as f64;
        let mut readings = readings(tick, [angle; 2]);
        readings.imu = Some(Imu {
            stamp: stamp(tick),
            yaw_rate: 0.01,
            yaw: None,
        });
        estimator.step(&readings, []);
    }
    // The gyro alone would have turned by 0.6 rad in this minute.
    assert!(
        estimator.map_from_base().yaw.abs() < 0.15,
        "{:?}",
        estimator.map_from_base()
    );
    assert!(estimator.odom_from_base().yaw.abs() < 0.05);
}

#[test]
fn a_map_that_bends_on_the_way_teaches_the_gyro_no_bias() {
    let learned = |map_turn_walk: f64| {
        let settings = EstimatorSettings {
            map_turn_walk,
            ..EstimatorSettings::default()
        };
        let mut model = model();
        (model.gps, model.imu.compass_noise) = (None, None);
        let mut estimator = Estimator::new(&model, Pose2::IDENTITY, &settings);
        for tick in 0..10_000_usize {
            // Ten seconds at rest, then 0.3 m/s straight on, which the map says is a bend.
            let metres = 0.006 * tick.saturating_sub(500) as f64;
            let mut readings = readings(tick, [metres / model.drive.wheel_radius; 2]);
            readings.imu = Some(Imu {
                stamp: stamp(tick),
                yaw_rate: 0.0,
                yaw: None,
            });
            let bend = 3e-4 * metres;
            let correction = Correction {
                stamp: stamp(tick),
                boot_id: String::new(),
                map_from_base: Pose2::new(metres, 0.5 * bend * metres, bend),
                covariance: [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-5],
                is_found_anew: false,
                frame: 0,
                moves: Vec::new(),
            };
            estimator.step(&readings, (tick > 500 && tick % 33 == 0).then_some(&correction));
        }
        estimator.ekf().gyro_bias().abs()
    };
    let (bent, trusting) = (learned(EstimatorSettings::default().map_turn_walk), learned(0.0));
    assert!(bent < 0.7 * trusting, "{bent} {trusting}");
}

#[test]
fn where_it_was_found_replaces_what_was_believed_at_its_own_time() {
    let mut estimator = estimator(Pose2::IDENTITY, 0.01);
    let mut found = Correction {
        stamp: stamp(20),
        boot_id: String::new(),
        map_from_base: Pose2::new(7.0, -3.0, 2.0),
        covariance: [0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01],
        is_found_anew: false,
        frame: 0,
        moves: Vec::new(),
    };
    for tick in 0..40 {
        estimator.step(&readings(tick, [0.1 * tick as f64; 2]), []);
    }
    let believed = estimator.map_from_base();
    estimator.step(&readings(40, [4.0; 2]), [&found]);
    assert!(estimator.map_from_base().distance(&believed) < 0.1, "an outlier");
    (found.is_found_anew, found.stamp) = (true, stamp(21));
    estimator.step(&readings(41, [4.1; 2]), [&found]);
    let way = 2.0 * model().drive.wheel_radius;
    let expected = found.map_from_base.advance(Twist2::new(way, 0.0), 1.0);
    assert!(
        estimator.map_from_base().distance(&expected) < 0.02,
        "{:?}",
        estimator.map_from_base()
    );
}

#[test]
fn noise_of_wheels_and_gyro_does_not_look_like_wrong_wheels() {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut noise = |most: f64| (-most..most).new_tree(&mut runner).map_or(0.0, |value| value.current());
    let mut model = model();
    (model.gps, model.imu.compass_noise) = (None, None);
    let mut estimator = Estimator::new(&model, Pose2::IDENTITY, &EstimatorSettings::default());
    let mut wheels = [0.0; 2];
    for tick in 0..15_000_usize {
        // Ten seconds at rest, then 145 m straight on by wheels that slip a little.
        let turn = if tick < 500 {
            0.0
        } else {
            0.01 / model.drive.wheel_radius
        };
        wheels = wheels.map(|angle| angle + turn * (1.0 + noise(0.1)));
        let mut readings = readings(tick, wheels);
        readings.imu = Some(Imu {
            stamp: stamp(tick),
            yaw_rate: noise(0.0035),
            yaw: None,
        });
        estimator.step(&readings, []);
    }
    let error = estimator.map_from_base().x - 145.0;
    assert!(error.abs() < 0.5, "{error} m along 145 m");
}

#[test]
fn a_turn_too_slow_for_the_encoders_to_see_in_each_tick_teaches_the_gyro_no_bias() {
    let mut model = model();
    (model.gps, model.imu.compass_noise) = (None, None);
    let mut estimator = Estimator::new(&model, Pose2::IDENTITY, &EstimatorSettings::default());
    let (rate, step) = (0.005, model.encoders.resolution);
    for tick in 0..1_000_usize {
        // Ten seconds at rest, then ten of a turn in which a wheel takes five ticks for a step.
        let turned = rate * 0.02 * tick.saturating_sub(500) as f64;
        let angle = 0.5 * turned * model.drive.wheel_separation / model.drive.wheel_radius;
        let mut readings = readings(tick, [-angle, angle].map(|angle| (angle / step).floor() * step));
        readings.imu = Some(Imu {
            stamp: stamp(tick),
            yaw_rate: if tick > 500 { rate } else { 0.0 },
            yaw: None,
        });
        estimator.step(&readings, []);
    }
    let (yaw, bias) = (estimator.map_from_base().yaw, estimator.ekf().gyro_bias());
    assert!(
        (yaw - 0.05).abs() < 0.005 && bias.abs() < 5e-4,
        "{yaw} rad, {bias} rad/s"
    );
}

/// A correction of a robot at rest.
fn correction(tick: usize, map_from_base: Pose2) -> Correction {
    Correction {
        stamp: stamp(tick),
        map_from_base,
        covariance: [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-5],
        ..Correction::default()
    }
}

#[test]
fn corrections_that_agree_with_each_other_replace_an_estimate_and_others_do_not() {
    // The robot drives on by 0.2 m from one correction to the next, and its heading is off by a radian.
    let (place, step) = (Pose2::new(0.4, 0.0, 1.0), 0.2);
    let turn = step / model().drive.wheel_radius;
    // By how much each correction is off from the place, m; `None` confirms the estimate.
    let off = |corrections: &[Option<f64>]| {
        let mut estimator = estimator(Pose2::IDENTITY, 0.01);
        let mut was_replaced = false;
        for nth in 0..=10 * corrections.len() {
            let told = corrections.get((nth / 10).wrapping_sub(1)).filter(|_| nth % 10 == 0);
            let driven = Pose2::new(0.1 * step * nth as f64, 0.0, 0.0);
            let told = told.map(|off| match off {
                Some(off) => correction(nth, place * driven * Pose2::new(*off, 0.0, 0.0)),
                None => correction(nth, driven),
            });
            estimator.step(&readings(nth, [0.1 * turn * nth as f64; 2]), &told);
            was_replaced |= estimator.was_replaced();
        }
        let truth = place * Pose2::new(step * corrections.len() as f64, 0.0, 0.0);
        (estimator.map_from_base().distance(&truth), was_replaced)
    };
    let (near, was_replaced) = off(&[Some(0.0), Some(0.01), Some(-0.01)]);
    assert!(near < 0.03 && was_replaced, "{near} m off");
    for kept in [
        &[Some(0.0), Some(0.01)][..],
        &[Some(0.0), Some(0.3), Some(-0.6), Some(0.1), Some(0.7)],
        &[Some(0.0), Some(0.01), None, Some(0.0), Some(0.01)],
    ] {
        let (far, was_replaced) = off(kept);
        assert!(far > 0.3 && !was_replaced, "{kept:?}: {far} m off");
    }
}

#[test]
fn corrections_of_one_place_share_the_error_of_the_map_there() {
    let mut estimator = estimator(Pose2::IDENTITY, 0.01);
    for tick in 0..500 {
        estimator.step(&readings(tick, [0.0; 2]), [&correction(tick, Pose2::IDENTITY)]);
    }
    let shared = EstimatorSettings::default().map_std.powi(2);
    let covariance = estimator.covariance();
    assert!((shared..2.0 * shared).contains(&covariance[0]), "{covariance:?}");
}
