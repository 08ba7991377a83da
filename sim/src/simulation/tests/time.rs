//! Tests of schedules, of repeatability, and of what is refused.

use super::*;

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_robot_changes_nobodys_noise() {
    let world = World::shipped("kitchen").unwrap();
    let first = || robot("a", "tiago", world.start());
    let record = |robots: Vec<RobotSpec>, seed: u64| {
        let mut simulation = Simulation::new(&world, robots, seed).unwrap();
        let mut text = String::new();
        for tick in 0..300 {
            simulation.drive(0, [2.0 + f64::from(tick % 7), 3.0]);
            simulation.step();
            text += &format!("{:?} {:?}\n", simulation.truth(0).map_from_base, simulation.readings(0));
        }
        text
    };
    assert_eq!(record(vec![first()], 1), record(vec![first()], 1));
    assert_ne!(record(vec![first()], 1), record(vec![first()], 2));
    let wheels = |text: &str| {
        text.lines()
            .map(|line| line.split("sweep").next().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    let alone = record(vec![first()], 1);
    let together = record(vec![first(), robot("b", "neato", Pose2::new(-1.46, -3.12, 0.0))], 1);
    assert_eq!(wheels(&alone), wheels(&together));
}

#[test]
fn what_cannot_begin_is_refused() {
    let world = world(WALL);
    let refuse = |robots: Vec<RobotSpec>| Simulation::new(&world, robots, 1).err().unwrap().to_string();
    assert!(refuse(vec![robot("a", "tiago", Pose2::new(1.0, 0.0, 0.0))]).contains("something stands there"));
    assert!(
        refuse(vec![robot(
            "a",
            "tiago",
            Pose2 {
                x: f64::NAN,
                y: 0.0,
                yaw: 0.0
            }
        )])
        .contains("not finite")
    );
    assert!(
        refuse(vec![
            robot("a", "tiago", Pose2::IDENTITY),
            robot("b", "neato", Pose2::new(0.1, 0.0, 0.0))
        ])
        .contains("`b` cannot stand")
    );
    assert!(
        refuse(vec![
            robot("a", "tiago", Pose2::IDENTITY),
            robot("a", "tiago", Pose2::new(-3.0, 0.0, 0.0))
        ])
        .contains("two robots")
    );
    assert!(Simulation::with_tick(&world, Vec::new(), 1, Duration::ZERO).is_err());
}

#[test]
fn a_door_is_shut_and_open_by_its_schedule() {
    let door =
        "[[door]]\nfrom = [2, -1]\nto = [2, 1]\nthickness = 0.1\nclosed_secs = 3\nopen_secs = 2\nslide_secs = 1\n";
    let mut simulation = simulate(&world(door), vec![robot("a", "tiago", Pose2::IDENTITY)]);
    let mut shut = Vec::new();
    for _ in 0..14 {
        steps(&mut simulation, 0, [0.0, 0.0], 25);
        let nearest = simulation.clearance(&Footprint::Radius(0.2), Pose2::new(1.7, 0.0, 0.0));
        shut.push(nearest < 0.1);
    }
    // At every half second: three seconds shut, open once it has slid by half, two seconds open, one sliding back.
    let expected: Vec<bool> = (1..=14).map(|half| !(8..=12).contains(&half)).collect();
    assert_eq!(shut, expected);
}

#[test]
fn sensors_come_at_their_rates() {
    let mut simulation = simulate(&world(WALL), vec![robot("a", "tiago", Pose2::IDENTITY)]);
    let mut counts = [0; 3];
    for _ in 0..500 {
        simulation.step();
        let readings = simulation.readings(0);
        counts[0] += readings.sweeps.len();
        counts[1] += usize::from(readings.imu.is_some());
        counts[2] += usize::from(readings.gps.is_some());
        assert_eq!(readings.stamp, simulation.now());
    }
    assert_eq!(counts, [100, 500, 100]);
}
