//! Tests of contacts.

use proptest::prelude::*;

use super::*;

#[test]
fn a_wall_stops_a_robot_and_one_touch_is_one_collision() {
    let mut simulation = simulate(&world(WALL), vec![robot("a", "tiago", Pose2::IDENTITY)]);
    steps(&mut simulation, 0, [6.0, 6.0], 250);
    let truth = simulation.truth(0);
    assert!(
        (truth.map_from_base.x - (0.95 - 0.265)).abs() < 1e-4,
        "{}",
        truth.map_from_base.x
    );
    assert_eq!(truth.collisions, 1);
    let contact = truth.last_contact.unwrap();
    assert!(contact.bearing.abs() < 1e-6 && contact.own_speed > 0.4, "{contact:?}");
    let bump = simulation.readings(0).bump;
    assert!(bump.pressed && bump.bearing.unwrap().abs() < 1e-6);
    // It may turn away, back off and touch again.
    steps(&mut simulation, 0, [-2.0, 2.0], 50);
    assert!(simulation.truth(0).map_from_base.yaw > 0.5);
    steps(&mut simulation, 0, [2.0, -2.0], 50);
    steps(&mut simulation, 0, [-3.0, -3.0], 50);
    assert!(!simulation.readings(0).bump.pressed && simulation.truth(0).collisions == 1);
    steps(&mut simulation, 0, [3.0, 3.0], 100);
    assert_eq!(simulation.truth(0).collisions, 2);
}

#[test]
fn a_robot_that_grazes_a_wall_slides_along_it() {
    let toward = |angle: f64| {
        let half = 0.165 * angle.cos() + 0.21 * angle.sin();
        let at = Pose2::new(0.95 - half - 0.012, -1.0, FRAC_PI_2 - angle);
        let mut simulation = simulate(&world(WALL), vec![robot("a", "jackal", at)]);
        steps(&mut simulation, 0, [3.0, 3.0], 100);
        simulation.truth(0)
    };
    let (grazing, pressing) = (toward(0.03), toward(0.3));
    assert!(grazing.map_from_base.y > -0.6 && grazing.collisions == 1, "{grazing:?}");
    assert!(
        pressing.map_from_base.y < -0.9 && pressing.collisions == 1,
        "{pressing:?}"
    );
}

#[test]
fn robots_see_and_hit_one_another() {
    let mut simulation = simulate(
        &world(""),
        vec![
            robot("a", "tiago", Pose2::IDENTITY),
            robot("b", "jackal", Pose2::new(2.0, 0.0, PI)),
        ],
    );
    let sweep = simulation.readings(0).sweeps.remove(0);
    let ahead = sweep.ranges[333];
    assert!((ahead - (2.0 - 0.21 - 0.2)).abs() < 0.03, "{ahead}");
    assert!((simulation.truth(0).clearance - (2.0 - 0.265 - 0.21)).abs() < 1e-9);
    simulation.drive(1, [3.0, 3.0]);
    steps(&mut simulation, 0, [3.0, 3.0], 300);
    for robot in 0..2 {
        assert_eq!(simulation.truth(robot).collisions, 1);
        assert!(simulation.truth(robot).min_clearance >= 0.0 && simulation.truth(robot).clearance < 1e-4);
    }
}

#[test]
fn a_robot_that_left_is_in_nobodys_way_and_the_others_keep_their_names() {
    let world = world("");
    let at = |id, x| robot(id, "tiago", Pose2::new(x, 0.0, 0.0));
    let mut simulation = simulate(&world, vec![at("a", 0.0), at("b", 1.0), at("c", 2.0)]);
    let before = simulation.truth(2);
    simulation.remove(1);
    let place = |id| simulation.find(&Id::robot(id).unwrap());
    assert_eq!((place("a"), place("b"), place("c")), (Some(0), None, Some(1)));
    assert_eq!(simulation.truth(1).map_from_base, before.map_from_base);
    steps(&mut simulation, 0, [5.0; 2], 100);
    let (here, there) = (simulation.truth(0), simulation.truth(1));
    assert!(here.map_from_base.x > 0.6 && here.collisions == 0, "{here:?}");
    assert_eq!(there.map_from_base, before.map_from_base);
    simulation.add(&world, at("b", -2.0)).unwrap();
    assert_eq!(simulation.find(&Id::robot("b").unwrap()), Some(2));
}

#[test]
fn nobody_starts_outside_of_the_world() {
    let error = Simulation::new(&world(""), vec![robot("a", "tiago", Pose2::new(11.0, 1e300, 0.0))], 7)
        .err()
        .unwrap();
    assert!(
        error
            .to_string()
            .contains("(11, 1e300): the world reaches from (-10, -10)"),
        "{error}"
    );
}

#[test]
fn nobody_is_carried_into_a_solid_or_outside_of_the_world() {
    let world =
        world("[[polygon]]\npoints = [[2, -4], [8, -4], [8, 4], [2, 4]]\n[[circle]]\nx = -5\ny = 0\nradius = 3\n");
    let mut simulation = simulate(&world, vec![robot("a", "tiago", Pose2::IDENTITY)]);
    for (x, y, why) in [
        (2.1, 0.0, "something stands there"),
        (5.0, 0.0, "something stands there"),
        (-5.0, 0.0, "something stands there"),
        (0.0, 11.0, "the world reaches"),
        (f64::NAN, 0.0, "not finite"),
    ] {
        let error = simulation
            .carry(&world, 0, Pose2::new(x, y, 0.0))
            .unwrap_err()
            .to_string();
        assert!(error.contains("`a`") && error.contains(why), "{x} {y}: {error}");
        assert_eq!(simulation.truth(0).map_from_base, Pose2::IDENTITY);
    }
    simulation.carry(&world, 0, Pose2::new(0.0, 3.0, 0.0)).unwrap();
}

#[test]
fn a_mover_that_runs_into_a_robot_waits_and_the_robot_is_not_to_blame() {
    let mover = "[[mover]]\nradius = 0.25\npath = [[3, 0], [-3, 0]]\nspeed = 0.5\n";
    let mut simulation = simulate(&world(mover), vec![robot("a", "tiago", Pose2::IDENTITY)]);
    steps(&mut simulation, 0, [0.0, 0.0], 600);
    let truth = simulation.truth(0);
    assert_eq!(truth.collisions, 1);
    assert!(truth.last_contact.unwrap().own_speed.abs() < 1e-9 && truth.clearance > 0.0);
    assert!((simulation.movers().next().unwrap().x - 0.515).abs() < 1e-3);
    // Once the robot is gone the mover goes on.
    steps(&mut simulation, 0, [-3.0, -3.0], 100);
    assert!(simulation.movers().next().unwrap().x < 0.5);
}

#[test]
fn glass_is_felt_but_not_seen() {
    let mut simulation = simulate(
        &world(&WALL.replace("thickness", "glass = true\nthickness")),
        vec![robot("a", "tiago", Pose2::IDENTITY)],
    );
    steps(&mut simulation, 0, [3.0, 3.0], 200);
    let truth = simulation.truth(0);
    assert!(truth.collisions == 1 && simulation.readings(0).bump.pressed);
    assert!((truth.map_from_base.x - (0.95 - 0.265)).abs() < 1e-3, "{truth:?}");
    let mut seen = false;
    for _ in 0..10 {
        simulation.step();
        let sweeps = simulation.readings(0).sweeps;
        seen |= sweeps
            .iter()
            .any(|sweep| sweep.ranges.iter().any(|range| range.is_finite()));
    }
    assert!(!seen);
}

#[test]
fn people_with_manners_walk_round_a_robot_that_stands_and_keep_their_distance() {
    for manners in ["orca", "social_force"] {
        let walkers = format!(
            "[[mover]]\nradius = 0.25\npath = [[3, 0], [-3, 0]]\nspeed = 1\nmanners = \"{manners}\"\n{}{}",
            "[[wall]]\nfrom = [-5, 1.6]\nto = [5, 1.6]\nthickness = 0.1\n",
            "[[wall]]\nfrom = [-5, -1.6]\nto = [5, -1.6]\nthickness = 0.1\n",
        );
        let mut simulation = simulate(&world(&walkers), vec![robot("a", "tiago", Pose2::IDENTITY)]);
        let (mut least, mut farthest) = (f64::INFINITY, 3.0_f64);
        for _ in 0..500 {
            simulation.step();
            least = least.min(simulation.truth(0).to_person);
            farthest = farthest.min(simulation.movers().next().unwrap().x);
        }
        assert_eq!(simulation.truth(0).collisions, 0, "{manners}");
        assert!(
            least > 0.01 && least < 1.0 && farthest < -2.8,
            "{manners}: {least} {farthest}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn whatever_is_commanded_no_footprint_ever_overlaps_anything(
        name in prop_oneof![Just("tiago"), Just("jackal"), Just("turtlebot3_waffle"), Just("neato")],
        yaw in -PI..PI,
        commands in prop::collection::vec((-25.0..25.0, -25.0..25.0, 1..40_usize), 1..12),
    ) {
        let body = format!("{WALL}[[circle]]\nx = -1\ny = 0.3\nradius = 0.4\n[[polygon]]\npoints = [[-0.5, 1.0], [0.5, 0.6], [0.4, 1.5]]\n[[mover]]\nradius = 0.2\npath = [[0.3, -1], [-0.6, -1]]\nspeed = 0.7\n");
        let world = world(&body);
        let mut simulation = Simulation::new(&world, vec![robot("a", name, Pose2::new(0.0, 0.0, yaw))], 3).unwrap();
        for (left, right, count) in commands {
            for _ in 0..count {
                steps(&mut simulation, 0, [left, right], 1);
                let truth = simulation.truth(0);
                prop_assert!(truth.map_from_base.is_finite());
                prop_assert!(truth.clearance > 0.0 && truth.clearance >= truth.min_clearance, "{truth:?}");
                prop_assert_eq!(truth.clearance, simulation.clearance_without(0));
                prop_assert_eq!(truth.collisions > 0, truth.last_contact.is_some());
            }
        }
    }
}

impl Simulation {
    /// Clearance recomputed from everything else, one by one.
    fn clearance_without(&self, robot: usize) -> f64 {
        let placed = Placed::footprint(&self.model(robot).footprint, self.truth(robot).map_from_base);
        let solids = self
            .crowd
            .solids()
            .iter()
            .enumerate()
            .filter(|(index, _)| *index != self.movers.len() + robot)
            .map(|(_, solid)| solid.distance(&placed));
        solids.fold(self.scene.distance(&placed), f64::min)
    }
}
