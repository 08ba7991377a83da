//! Every driver in small worlds, judged by the simulator's ground truth.

#![allow(clippy::unwrap_used, reason = "tests")]

use nalgebra::Point2;
use zenav_fixtures::robot;
use zenav_protocol::id::Id;
use zenav_protocol::robot::RobotModel;
use zenav_sim::{RobotSpec, Simulation, Truth, World};

use crate::cost_to_go::CostToGo;
use crate::{DrivingTask, Field, Method, ReferenceDriver, TICKS_PER_DECISION};

/// Below this a robot is at rest, and a contact is not its own, m/s.
const AT_REST: f64 = 0.01;

/// A robot at the start of a world, and its goal.
struct Scene {
    world: World,
    model: RobotModel,
    goal: Point2<f64>,
}

/// A world of 8 m by 4 m without outer walls, with `things` in it.
fn scene(name: &str, things: &str, [x, y, yaw]: [f64; 3], goal: [f64; 2]) -> Scene {
    let text = format!("size = [8, 4]\n[start]\nx = {x}\ny = {y}\nyaw = {yaw}\n{things}");
    Scene {
        world: World::from_toml(&text, "w", &|_| Err(String::new())).unwrap(),
        model: robot(name),
        goal: goal.into(),
    }
}

impl Scene {
    fn task(&self) -> DrivingTask<'_> {
        DrivingTask {
            world: &self.world,
            model: &self.model,
            start: self.world.start(),
            goal: self.goal,
            tolerance: 0.15,
            timeout: 60.0,
        }
    }

    fn field(&self) -> Field {
        Field::new(&self.world, self.model.footprint.inscribed_radius(), self.goal)
    }

    /// The end of a drive: at rest at the goal, or out of time.
    fn driven(&self, method: Method) -> Driven {
        let (task, field) = (self.task(), self.field());
        let spec = RobotSpec {
            id: Id::robot("robot").unwrap(),
            model: self.model.clone(),
            start: task.start,
        };
        let mut simulation = Simulation::new(&self.world, vec![spec], 0).unwrap();
        let mut driver = ReferenceDriver::new(method, task, &field, &simulation);
        let mut tick = 0_u64;
        loop {
            if tick.is_multiple_of(TICKS_PER_DECISION) {
                let wheels = driver.decide(&simulation);
                simulation.drive(0, wheels);
            }
            simulation.step();
            tick += 1;
            let (truth, time_s) = (simulation.truth(0), simulation.now().as_secs());
            let error = (truth.map_from_base.position() - task.goal).norm();
            let speed = truth.twist.v.abs() + truth.twist.w.abs() * self.model.footprint.circumscribed_radius();
            let is_reached = error <= task.tolerance && speed <= AT_REST;
            if is_reached || time_s >= task.timeout {
                return Driven {
                    truth,
                    time_s,
                    error,
                    is_reached,
                };
            }
        }
    }
}

#[derive(Debug)]
struct Driven {
    truth: Truth,
    time_s: f64,
    error: f64,
    is_reached: bool,
}

impl Driven {
    /// Whether the robot never moved into anything.
    fn is_innocent(&self) -> bool {
        self.truth.hardest_contact <= AT_REST
    }
}

/// A wall across the world at 4 m with a gap of this width.
fn door(width: f64) -> String {
    let (low, high) = (2.03 - 0.5 * width, 2.03 + 0.5 * width);
    format!(
        "[[wall]]\nfrom = [4, 0]\nto = [4, {low}]\nthickness = 0.1\n[[wall]]\nfrom = [4, {high}]\nto = [4, 4]\nthickness = 0.1\n"
    )
}

/// A person on a path with rests, s.
fn person(speed: f64, path: &[[f64; 2]], rests: &[f64]) -> String {
    format!("[[mover]]\nradius = 0.25\nspeed = {speed}\npath = {path:?}\nrest_secs = {rests:?}\n")
}

#[test]
fn each_parks_within_the_tolerance_without_delay() {
    for name in ["tiago", "turtlebot3_waffle"] {
        let scene = scene(name, "", [2.5, 2.0, 2.5], [5.0, 2.5]);
        let straight = 2.5_f64.hypot(0.5) / scene.model.drive.top_speed();
        for method in Method::ALL {
            let driven = scene.driven(method);
            assert!(driven.is_reached, "{method:?} {name} {}", driven.error);
            assert!(
                driven.time_s < 1.3 * straight + 4.0,
                "{method:?} {name} {}",
                driven.time_s
            );
        }
    }
}

#[test]
fn each_passes_a_door_20_cm_wider_than_the_robot() {
    for name in ["tiago", "jackal"] {
        let width = 2.0 * robot(name).footprint.half_width() + 0.2;
        let scene = scene(name, &door(width), [1.5, 1.2, 0.0], [6.5, 2.5]);
        // To ORCA a Jackal is a disc, wider than this door.
        let all = Method::ALL.into_iter();
        for method in all.filter(|method| name == "tiago" || *method != Method::Orca) {
            let driven = scene.driven(method);
            assert!(
                driven.is_reached && driven.truth.collisions == 0,
                "{method:?} {name} {driven:?}"
            );
        }
    }
}

#[test]
fn each_goes_on_when_somebody_has_left_the_door() {
    let stander = person(1.0, &[[4.0, 2.03], [5.5, 2.03], [5.5, 0.5]], &[6.0, 0.0, 1e4]);
    let scene = scene("tiago", &(door(0.9) + &stander), [1.5, 2.0, 0.0], [6.5, 2.5]);
    for method in Method::ALL {
        let driven = scene.driven(method);
        assert!(
            driven.is_reached && driven.time_s < 30.0,
            "{method:?} {}",
            driven.time_s
        );
        assert!(driven.is_innocent(), "{method:?} {driven:?}");
    }
}

#[test]
fn each_goes_on_after_a_contact() {
    // Between a wall and a person who touches it at once: there is no room to avoid him.
    let (x, reach) = (1.3152, 0.265 + 0.25);
    let wall = "[[wall]]\nfrom = [1, 0]\nto = [1, 4]\nthickness = 0.1\n";
    let toucher = person(
        1.0,
        &[[x + reach + 3e-4, 2.0], [x + reach + 8e-5, 2.0], [4.0, 3.5]],
        &[0.0, 5.0, 1e4],
    );
    let scene = scene("tiago", &format!("{wall}{toucher}"), [x, 2.0, 0.0], [5.0, 2.0]);
    for method in Method::ALL {
        let driven = scene.driven(method);
        assert!(
            driven.truth.collisions > 0 && driven.is_innocent(),
            "{method:?} {driven:?}"
        );
        assert!(
            driven.is_reached && driven.time_s < 30.0,
            "{method:?} {}",
            driven.time_s
        );
    }
}

#[test]
fn orca_passes_two_who_come_towards_it_and_make_way_too() {
    let oncoming = |y: f64| person(0.8, &[[7.0 + 0.5 * y, y], [0.6, y]], &[0.0, 1e4]) + "manners = \"orca\"\n";
    let scene = scene("tiago", &(oncoming(1.4) + &oncoming(2.2)), [1.0, 2.0, 0.0], [7.0, 2.2]);
    let driven = scene.driven(Method::Orca);
    assert!(driven.is_reached && driven.truth.collisions == 0, "{driven:?}");
}

#[test]
fn the_way_leads_round_somebody_who_stands_and_through_him_in_the_only_door() {
    let cost = |things: &str| {
        let scene = scene("tiago", things, [1.5, 2.0, 0.0], [6.5, 2.03]);
        let mut to_go = CostToGo::new(&scene.task(), &scene.field());
        to_go.update([(Point2::new(4.0, 2.03), 0.25)]);
        to_go.at(Point2::new(3.0, 2.03))
    };
    let (open, shut) = (cost(""), cost(&door(0.9)));
    assert!((3.5..5.0).contains(&open), "{open}");
    assert!((15.0..35.0).contains(&shut), "{shut}");
}
