//! Tests of motion: a robot goes where its wheels take it.

use zenav_protocol::geometry::wrap_angle;

use super::*;

#[test]
fn a_robot_drives_as_its_wheels_turn() {
    let mut simulation = simulate(&world(""), vec![robot("a", "tiago", Pose2::new(0.0, 0.0, FRAC_PI_2))]);
    steps(&mut simulation, 0, [4.0, 4.0], 500);
    let truth = simulation.truth(0);
    assert!(truth.map_from_base.x.abs() < 1e-9 && (truth.map_from_base.y - truth.length).abs() < 1e-9);
    assert!((truth.twist.v - 4.0 * 0.0985).abs() < 1e-6);
    // The distance of ten seconds, minus the loss by acceleration and lag.
    assert!((3.7..3.94).contains(&truth.length), "{}", truth.length);
    assert_eq!((truth.collisions, truth.clearance), (0, f64::INFINITY));
    let readings = simulation.readings(0);
    assert!((readings.wheels[0] * 0.0985 - truth.length).abs() < 0.01);
    assert!(readings.battery.drawn_j > 10.0 * 30.0 && readings.battery.charge < 1.0);
}

#[test]
fn a_tiago_drives_twice_around_the_kitchen_table_by_the_proportional_wheel_law() {
    let world = World::shipped("kitchen").unwrap();
    let mut simulation = simulate(&world, vec![robot("a", "tiago", world.start())]);
    let gains = model("tiago").controller;
    let places: Vec<_> = (1..=10).map(|i| world.place(&format!("table_{i}")).unwrap()).collect();
    for place in places.iter().chain(&places) {
        let mut steps_left = 1000;
        loop {
            let here = simulation.truth(0).map_from_base;
            let (dx, dy) = (place.x - here.x, place.y - here.y);
            if dx.hypot(dy) < gains.waypoint_threshold {
                break;
            }
            let turn = gains.heading_gain * wrap_angle(dy.atan2(dx) - here.yaw);
            let on = gains.distance_gain * dx.hypot(dy);
            steps(&mut simulation, 0, [on - turn, on + turn], 1);
            steps_left -= 1;
            assert!(steps_left > 0, "never reached {}", place.name);
        }
    }
    let truth = simulation.truth(0);
    assert_eq!(truth.collisions, 0);
    assert!(truth.min_clearance > 0.15, "{truth:?}");
    assert!((16.0..19.0).contains(&truth.length), "{truth:?}");
}

#[test]
fn wheels_that_are_not_what_they_seem_lead_astray_and_encoders_do_not_see_it() {
    let mut crooked = robot("a", "tiago", Pose2::IDENTITY);
    crooked.model.drive.errors.wheel_radius = [0.0, 0.02];
    let mut simulation = simulate(&world(""), vec![crooked]);
    steps(&mut simulation, 0, [4.0, 4.0], 500);
    let (truth, [left, right]) = (simulation.truth(0), simulation.readings(0).wheels);
    let separation = simulation.model(0).drive.wheel_separation;
    let expected = truth.length / 1.01 * 0.02 / separation;
    assert!((truth.map_from_base.yaw - expected).abs() < 1e-6 && expected > 0.1);
    assert!((left - right).abs() < 0.2, "{left} {right}");
}

#[test]
fn slip_spreads_with_the_root_of_the_way() {
    let spread = |secs: usize| {
        let offsets = (0..60).map(|seed| {
            let mut spec = robot("a", "tiago", Pose2::IDENTITY);
            spec.model.drive.errors.slip = 0.01;
            let mut simulation = Simulation::new(&world(""), vec![spec], seed).unwrap();
            steps(&mut simulation, 0, [4.0, 4.0], secs * 50);
            simulation.truth(0).map_from_base.yaw
        });
        (offsets.map(|yaw| yaw * yaw).sum::<f64>() / 60.0).sqrt()
    };
    let (short, long) = (spread(4), spread(16));
    assert!((1.4..2.8).contains(&(long / short)), "{short} {long}");
    // Two wheels, each off by a centimetre after a metre.
    let drive = model("tiago").drive;
    let metres = 4.0 * drive.wheel_radius * 16.0;
    let expected = 0.01 * (2.0 * metres).sqrt() / drive.wheel_separation;
    assert!((long / expected - 1.0).abs() < 0.3, "{long} {expected}");
}

#[test]
fn wheels_farther_apart_than_stated_turn_the_robot_less() {
    let turned = |error: f64| {
        let mut wide = robot("a", "tiago", Pose2::IDENTITY);
        wide.model.drive.errors.wheel_separation = error;
        let mut simulation = simulate(&world(""), vec![wide]);
        steps(&mut simulation, 0, [-0.5, 0.5], 200);
        simulation.truth(0).map_from_base.yaw
    };
    let (stated, wider) = (turned(0.0), turned(0.05));
    assert!(stated > 0.5 && (stated / wider - 1.05).abs() < 1e-9, "{stated} {wider}");
}
