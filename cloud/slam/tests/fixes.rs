//! Tests of GPS and compass in SLAM: they bound its error where scans do not, and a false reading does no harm.

#![allow(clippy::unwrap_used, reason = "tests")]

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::GraphCertificate;
use zenav_protocol::sensors::{Absolute, Fix};
use zenav_slam::{Slam, SlamSettings};

mod house;

/// Standard deviation of GPS, m.
const SIGMA: f64 = 0.1;
/// Range of the lidar, m: the ends of the corridor are never in sight.
const RANGE: f32 = 3.5;
/// A reflection moves GPS by this much along the corridor, m, for some scans.
const REFLECTED: (f64, std::ops::Range<usize>) = (20.0, 130..155);

/// Drives 40 m along a corridor without features, with wheels 3 % off; `gps`: what GPS adds to its noise at a scan, m, if there is one.
/// Returns the map, and the error of the pose with each scan, m.
fn drive(gps: impl Fn(usize) -> Option<f64>) -> (Slam, Vec<f64>) {
    let mut random = Pcg64Mcg::seed_from_u64(11);
    let mut noise = || -> f64 {
        let drawn: f64 = StandardNormal.sample(&mut random);
        SIGMA * drawn
    };
    let truth: Vec<Pose2> = (0..267)
        .map(|step| Pose2::new(10.0 + 0.15 * f64::from(step), 0.0, 0.0))
        .collect();
    let mut slam = Slam::beside_a_robot(SlamSettings::default(), truth[0]);
    let mut errors = Vec::new();
    let scans = house::House::corridor().log(&truth, 3);
    for (index, (mut scan, pose)) in scans.into_iter().zip(&truth).enumerate() {
        scan.range_max = f64::from(RANGE);
        for range in scan.ranges.iter_mut().filter(|range| **range > RANGE) {
            *range = f32::INFINITY;
        }
        let position = gps(index).map(|off| Absolute::Position {
            x: pose.x + off + noise(),
            y: pose.y + noise(),
            std_dev: SIGMA,
        });
        let fix = position.map(|measured| Fix {
            odom_from_base: scan.odom_from_base,
            measured,
        });
        scan.fixes.extend(fix);
        errors.push(slam.step(&scan).unwrap().pose.distance(pose));
    }
    (slam, errors)
}

fn largest(errors: &[f64]) -> f64 {
    errors.iter().copied().fold(0.0, f64::max)
}

#[test]
fn along_a_corridor_without_features_gps_bounds_the_error() {
    let (slam, errors) = drive(|_| None);
    let without = largest(&errors);
    assert!(without > 0.9, "{without} m off is no trial");
    assert_eq!(slam.fix_weights().count(), 0);
    let (slam, errors) = drive(|_| Some(0.0));
    let with = largest(&errors);
    assert!(with < 0.6, "{with} m off, {without} m without GPS");
    let weights: Vec<f64> = slam.fix_weights().collect();
    assert!(
        weights.len() > 8 && weights.len() < 20,
        "one for each submap: {weights:?}"
    );
    // With the world in it, the graph still has a certificate.
    slam.last_solve().unwrap().run();
    assert_eq!(slam.certificate(), GraphCertificate::Certified);
    let loaded = Slam::load(&slam.save().unwrap()).unwrap();
    assert_eq!(loaded.fix_weights().collect::<Vec<f64>>(), weights);
}

#[test]
fn a_reflected_reading_of_gps_is_held_to_be_false_and_moves_nothing() {
    let (off, when) = REFLECTED;
    let (slam, errors) = drive(|index| Some(if when.contains(&index) { off } else { 0.0 }));
    let error = largest(&errors);
    assert!(error < 0.6, "{error} m off");
    let rejected = slam.fix_weights().filter(|weight| *weight == 0.0).count();
    let all = slam.fix_weights().count();
    assert!((1..3).contains(&rejected) && all > 8, "{rejected} of {all}");
}

/// Drives around the house of the tests, which has no closures here; `fix`: what is measured with a scan at a true pose. The map is begun at
/// `start`. Returns it, the error of the pose with each scan, m and rad, and the number of solves.
fn around(
    corners: usize,
    start: impl Fn(Pose2) -> Pose2,
    mut fix: impl FnMut(usize, &Pose2) -> Absolute,
) -> (Slam, Vec<(f64, f64)>, usize) {
    let truth = house::lap(0, corners);
    let mut settings = SlamSettings::default();
    settings.closure.gap = 100_000;
    let mut slam = Slam::beside_a_robot(settings, start(truth[0]));
    let (mut errors, mut solves) = (Vec::new(), 0);
    let scans = house::House::usual().log(&truth, 5);
    for (index, (mut scan, pose)) in scans.into_iter().zip(&truth).enumerate() {
        scan.fixes.push(Fix {
            odom_from_base: scan.odom_from_base,
            measured: fix(index, pose),
        });
        let effects = slam.step(&scan).unwrap();
        errors.push((
            effects.pose.distance(pose),
            wrap_angle(effects.pose.yaw - pose.yaw).abs(),
        ));
        solves += usize::from(effects.begins_solve);
    }
    assert_eq!(slam.counts().found, 0);
    (slam, errors, solves)
}

/// GPS with noise of a standard deviation, m, that is off by `bias` at a scan, m.
fn gps(std_dev: f64, bias: impl Fn(usize) -> f64) -> impl FnMut(usize, &Pose2) -> Absolute {
    let mut random = Pcg64Mcg::seed_from_u64(12);
    move |index, pose| {
        let [x, y]: [f64; 2] = [0, 1].map(|_| StandardNormal.sample(&mut random));
        Absolute::Position {
            x: pose.x + bias(index) + std_dev * x,
            y: pose.y + std_dev * y,
            std_dev,
        }
    }
}

#[test]
fn wrong_first_readings_do_not_move_the_map() {
    // The first factors are of about the 30th scan.
    for std_dev in [0.02, SIGMA] {
        let off = |index: usize| if index < 40 { 20.0 } else { 0.0 };
        let (slam, errors, _) = around(4, |pose| pose, gps(std_dev, off));
        let error = errors.iter().map(|(way, _)| *way).fold(0.0, f64::max);
        assert!(error < 0.6, "{error} m off");
        let weights: Vec<f64> = slam.fix_weights().collect();
        assert_eq!(weights[0], 0.0, "{weights:?}");
        assert!(
            weights.iter().filter(|weight| **weight > 0.0).count() > 4,
            "{weights:?}"
        );
    }
}

#[test]
fn gps_leads_to_few_solves_where_the_map_agrees_with_it_and_where_it_is_always_rejected() {
    // Closures are off.
    let worst = |errors: &[(f64, f64)]| errors.iter().map(|(way, _)| *way).fold(0.0, f64::max);
    let alone = worst(&around(8, |pose| pose, gps(0.02, |_| 1000.0)).1);
    for (std_dev, bias) in [(0.02, 0.0), (1.0, 0.0), (0.02, 2.0)] {
        let (slam, errors, solves) = around(8, |pose| pose, gps(std_dev, |_| bias));
        let factors = slam.fix_weights().count();
        assert!(factors > 15, "{factors} factors are no trial");
        assert!(
            solves < 6,
            "{solves} solves for {factors} factors, {std_dev} m, {bias} m"
        );
        let error = worst(&errors);
        assert!(
            error < alone + 0.05,
            "{error} m off, {alone} m without, {std_dev} m, {bias} m"
        );
    }
}

#[test]
fn a_compass_turns_a_map_that_was_begun_askew_and_not_if_it_is_wrong() {
    let askew = |pose: Pose2| Pose2::new(pose.x, pose.y, pose.yaw + 0.15);
    let compass = |off: f64| {
        move |_: usize, pose: &Pose2| Absolute::Heading {
            yaw: wrap_angle(pose.yaw + off),
            std_dev: 0.01,
        }
    };
    let (_, errors, _) = around(3, askew, compass(0.0));
    let (way, turn) = errors[errors.len() - 1];
    assert!(way < 0.6 && turn < 0.1, "{way} m, {turn} rad off");
    let (slam, errors, solves) = around(3, |pose| pose, compass(std::f64::consts::PI));
    assert!(solves == 0 && slam.fix_weights().all(|weight| weight == 0.0));
    assert!(errors[errors.len() - 1].1 < 0.1, "{errors:?}");
}

#[test]
fn a_reading_with_an_absurd_deviation_is_left_out_and_the_map_can_be_stored() {
    let absurd = |_: usize, pose: &Pose2| Absolute::Position {
        x: pose.x,
        y: pose.y,
        std_dev: f64::MAX,
    };
    let (slam, _, _) = around(1, |pose| pose, absurd);
    assert_eq!(slam.fix_weights().count(), 0);
    let loaded = Slam::load(&slam.save().unwrap()).unwrap();
    assert_eq!(loaded.nodes(), slam.nodes());
}

#[test]
fn the_next_session_of_a_map_has_no_tie_to_the_world() {
    let (slam, _, _) = around(2, |pose| pose, gps(SIGMA, |_| 0.0));
    assert!(slam.fix_weights().count() > 2);
    let scans = house::House::usual().log(&house::lap(0, 2), 6);
    let mut next = slam.begin_session(Some(house::lap(0, 1)[0]));
    for scan in &scans {
        next.step(scan).unwrap();
    }
    assert!(next.is_located() && next.fix_weights().count() == 0);
}
