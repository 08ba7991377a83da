//! How does everything advance together? In fixed steps from a seed: the same commands give the same bytes.
//!
//! A step moves the movers, then the robots in their order, each against what stands where it stands by then; when all
//! have moved, clearances are computed and sensors measure. Robots see and hit one another.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::Point2;
use thiserror::Error;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::{Footprint, RobotError, RobotModel};
use zenav_protocol::time::Stamp;

use crate::body::Body;
use crate::chassis::{CONTACT, Surroundings, Truth};
use crate::clearance::Placed;
use crate::crowd::Crowd;
use crate::movers::Mover;
use crate::scene::Scene;
use crate::sensors::walker_stream;
use crate::shape::{Shape, Solid};
use crate::world::World;

/// The default step: a control loop of 50 Hz.
pub const TICK: Duration = Duration::from_millis(20);

/// Most robots in one world.
pub const MAX_ROBOTS: usize = 10_000;

/// A robot to put into a world.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotSpec {
    /// Its name: its noise depends on it and on the seed, not on other robots.
    pub id: Id,
    /// Footprint, limits, sensors.
    pub model: RobotModel,
    /// Where it starts, map frame.
    pub start: Pose2,
}

/// Why a simulation cannot begin.
#[derive(Debug, Error)]
pub enum SimError {
    /// Two robots have one name.
    #[error("two robots are named `{0}`")]
    Duplicate(Id),
    /// Values that no robot has.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The start is not a pose.
    #[error("robot `{0}`: its start is not finite")]
    NotFinite(Id),
    /// Something stands where the robot should start: choose another start.
    #[error("robot `{robot}` cannot start at ({x}, {y}): something stands there")]
    Occupied {
        /// The robot.
        robot: Id,
        /// m.
        x: f64,
        /// m.
        y: f64,
    },
    /// More robots than a world holds.
    #[error("{0} robots: expected at most {MAX_ROBOTS}")]
    TooMany(usize),
    /// The step is not usable.
    #[error("a step of {0:?}: expected 1 ms to 1 s")]
    Tick(Duration),
}

/// A world at work.
#[derive(Clone)]
pub struct Simulation {
    scene: Arc<Scene>,
    movers: Vec<Mover>,
    bodies: Vec<Body>,
    /// Movers first, then robots.
    crowd: Crowd,
    ids: BTreeMap<Id, usize>,
    tick: Duration,
    now: Stamp,
    seed: u64,
}

impl Simulation {
    /// Puts robots into a world, with the default step.
    ///
    /// # Errors
    /// [`SimError`]: names, models or starts that cannot be.
    pub fn new(world: &World, robots: Vec<RobotSpec>, seed: u64) -> Result<Self, SimError> {
        Self::with_tick(world, robots, seed, TICK)
    }

    /// Puts robots into a world, with a step of one's own between 1 ms and 1 s.
    ///
    /// # Errors
    /// [`SimError`]: a step, names, models or starts that cannot be.
    pub fn with_tick(world: &World, robots: Vec<RobotSpec>, seed: u64, tick: Duration) -> Result<Self, SimError> {
        if !(Duration::from_millis(1)..=Duration::from_secs(1)).contains(&tick) {
            return Err(SimError::Tick(tick));
        }
        let (movers, solids): (Vec<Mover>, Vec<Solid>) = world
            .movers()
            .iter()
            .enumerate()
            .map(|(index, model)| Mover::new(model, walker_stream(seed, index)))
            .unzip();
        let mut simulation = Self {
            scene: world.shared_scene(),
            movers,
            bodies: Vec::with_capacity(robots.len()),
            crowd: Crowd::new(solids),
            ids: BTreeMap::new(),
            tick,
            now: Stamp::ZERO,
            seed,
        };
        if robots.len() > MAX_ROBOTS {
            return Err(SimError::TooMany(robots.len()));
        }
        for robot in robots {
            simulation.place(world, robot)?;
        }
        simulation.sense();
        Ok(simulation)
    }

    /// Puts a further robot into the world, which is the one that the simulation began with; its sensors say something from the next step
    /// on. Returns its place in all calls that take one.
    ///
    /// # Errors
    /// [`SimError`]: a name, a model or a start that cannot be.
    pub fn add(&mut self, world: &World, robot: RobotSpec) -> Result<usize, SimError> {
        let index = self.place(world, robot)?;
        self.crowd.refresh();
        Ok(index)
    }

    fn place(&mut self, world: &World, robot: RobotSpec) -> Result<usize, SimError> {
        let RobotSpec { id, model, start } = robot;
        let index = self.bodies.len();
        if index >= MAX_ROBOTS {
            return Err(SimError::TooMany(index + 1));
        }
        let model = model.checked(id.as_str())?;
        if self.ids.contains_key(&id) {
            return Err(SimError::Duplicate(id));
        }
        if !start.is_finite() {
            return Err(SimError::NotFinite(id));
        }
        let start = Pose2::new(start.x, start.y, start.yaw);
        let around = Surroundings {
            scene: &self.scene,
            crowd: &self.crowd,
            own: usize::MAX,
        };
        if world.is_solid(start.position()) || around.nearest(&Placed::new(&model.footprint, start)).distance <= CONTACT
        {
            return Err(SimError::Occupied {
                robot: id,
                x: start.x,
                y: start.y,
            });
        }
        self.crowd.push(Solid::new(Shape::from(&model.footprint), start));
        self.bodies.push(Body::new(&id, model, start, self.seed));
        self.ids.insert(id, index);
        Ok(index)
    }

    /// Simulated time since the beginning.
    #[must_use]
    pub fn now(&self) -> Stamp {
        self.now
    }

    /// Time that one step takes.
    #[must_use]
    pub fn tick(&self) -> Duration {
        self.tick
    }

    /// Number of robots.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.bodies.len()
    }

    /// The place of a robot in all calls that take one.
    #[must_use]
    pub fn find(&self, id: &Id) -> Option<usize> {
        self.ids.get(id).copied()
    }

    /// Commands a robot's wheels (left, right; rad/s), until the next command. Bounded by its limits; what is not a
    /// number stops it.
    ///
    /// # Panics
    /// Unless `robot` is less than [`Self::robots`]; so do all calls that take a robot.
    pub fn drive(&mut self, robot: usize, wheels: [f64; 2]) {
        self.bodies[robot].command(wheels);
    }

    /// Advances by one step.
    pub fn step(&mut self) {
        let secs = self.tick.as_secs_f64();
        self.now = self.now + self.tick;
        let mut farthest = self.move_movers(secs);
        let Self {
            scene,
            movers,
            bodies,
            crowd,
            ..
        } = self;
        for (index, body) in bodies.iter_mut().enumerate() {
            let own = movers.len() + index;
            let moved = body.advance(Surroundings { scene, crowd, own }, secs, farthest, self.now);
            farthest = farthest.max(moved.reach);
            crowd.place(own, body.chassis.truth().map_from_base);
        }
        self.sense();
    }

    /// Moves all movers; returns how far the fastest went at most, m.
    fn move_movers(&mut self, secs: f64) -> f64 {
        let Self {
            scene,
            movers,
            bodies,
            crowd,
            ..
        } = self;
        let mut farthest = 0.0_f64;
        for (index, mover) in movers.iter_mut().enumerate() {
            let stride = mover.stride(secs);
            farthest = farthest.max(stride);
            let Some(solid) = crowd.solids().get(index) else {
                continue;
            };
            let robots = bodies
                .iter()
                .map(|body| Placed::new(&body.model().footprint, body.chassis.truth().map_from_base));
            let near: Vec<(Placed<'_>, f64)> = robots
                .filter(|placed| placed.at_least_to(solid) <= stride + CONTACT)
                .map(|placed| (placed, placed.to_solid(solid).distance))
                .collect();
            // Half of what counts as contact: a robot that was run into knows it.
            let blocked = |solid: &Solid| {
                near.iter().any(|(placed, before)| {
                    let distance = placed.to_solid(solid).distance;
                    distance <= 0.5 * CONTACT && distance < *before
                })
            };
            crowd.change(index, |solid| mover.step(secs, scene, solid, blocked));
        }
        farthest
    }

    fn sense(&mut self) {
        let Self {
            scene,
            movers,
            bodies,
            crowd,
            ..
        } = self;
        crowd.refresh();
        for (index, body) in bodies.iter_mut().enumerate() {
            body.sense(
                Surroundings {
                    scene,
                    crowd,
                    own: movers.len() + index,
                },
                self.now,
            );
        }
    }

    /// What a robot's sensors said in the last step; before the first, at time zero.
    ///
    /// # Panics
    /// See [`Self::drive`].
    #[must_use]
    pub fn readings(&self, robot: usize) -> Readings {
        self.bodies[robot].readings()
    }

    /// What nobody on the robot knows for sure.
    ///
    /// # Panics
    /// See [`Self::drive`].
    #[must_use]
    pub fn truth(&self, robot: usize) -> Truth {
        self.bodies[robot].chassis.truth()
    }

    /// What a robot's file says.
    ///
    /// # Panics
    /// See [`Self::drive`].
    #[must_use]
    pub fn model(&self, robot: usize) -> &RobotModel {
        self.bodies[robot].model()
    }

    /// Where the movers are now, in the order of the world's file, m.
    pub fn movers(&self) -> impl Iterator<Item = Point2<f64>> + '_ {
        self.crowd.solids().iter().take(self.movers.len()).map(Solid::center)
    }

    /// True clearance that a footprint would have at a pose now, among solids, movers and robots, m.
    #[must_use]
    pub fn clearance(&self, footprint: &Footprint, map_from_base: Pose2) -> f64 {
        self.clearance_but(usize::MAX, footprint, map_from_base)
    }

    /// The same, were it not for this robot.
    ///
    /// # Panics
    /// See [`Self::drive`].
    #[must_use]
    pub fn clearance_beside(&self, robot: usize, footprint: &Footprint, map_from_base: Pose2) -> f64 {
        self.clearance_but(self.movers.len() + robot, footprint, map_from_base)
    }

    fn clearance_but(&self, own: usize, footprint: &Footprint, map_from_base: Pose2) -> f64 {
        let around = Surroundings {
            scene: &self.scene,
            crowd: &self.crowd,
            own,
        };
        around.nearest(&Placed::new(footprint, map_from_base)).distance
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    use proptest::prelude::*;
    use zenav_protocol::geometry::wrap_angle;
    use zenav_protocol::robot;

    fn world(body: &str) -> World {
        World::from_toml(
            &format!("size = [20, 20]\norigin = [-10, -10]\n{body}"),
            "test.toml",
            &|_| Err(String::new()),
        )
        .unwrap()
    }

    fn model(name: &str) -> RobotModel {
        RobotModel::from_toml(robot::shipped(name).unwrap(), name).unwrap()
    }

    fn robot(id: &str, model_name: &str, start: Pose2) -> RobotSpec {
        RobotSpec {
            id: Id::robot(id).unwrap(),
            model: model(model_name),
            start,
        }
    }

    fn simulate(world: &World, robots: Vec<RobotSpec>) -> Simulation {
        Simulation::new(world, robots, 7).unwrap()
    }

    fn steps(simulation: &mut Simulation, robot: usize, wheels: [f64; 2], count: usize) {
        simulation.drive(robot, wheels);
        for _ in 0..count {
            simulation.step();
        }
    }

    const WALL: &str = "[[wall]]\nfrom = [1, -5]\nto = [1, 5]\nthickness = 0.1\n";

    #[test]
    fn a_robot_drives_as_its_wheels_turn() {
        let mut simulation = simulate(&world(""), vec![robot("a", "tiago", Pose2::new(0.0, 0.0, FRAC_PI_2))]);
        steps(&mut simulation, 0, [4.0, 4.0], 500);
        let truth = simulation.truth(0);
        assert!(truth.map_from_base.x.abs() < 1e-9 && (truth.map_from_base.y - truth.length).abs() < 1e-9);
        assert!((truth.twist.v - 4.0 * 0.0985).abs() < 1e-6);
        // The way of ten seconds, less what acceleration and lag cost.
        assert!((3.7..3.94).contains(&truth.length), "{}", truth.length);
        assert_eq!((truth.collisions, truth.clearance), (0, f64::INFINITY));
        let readings = simulation.readings(0);
        assert!((readings.wheels[0] * 0.0985 - truth.length).abs() < 0.01);
        assert!(readings.battery.drawn_j > 10.0 * 30.0 && readings.battery.charge < 1.0);
    }

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
    fn robots_see_and_hit_one_another() {
        let mut simulation = simulate(
            &world(""),
            vec![
                robot("a", "tiago", Pose2::IDENTITY),
                robot("b", "jackal", Pose2::new(2.0, 0.0, PI)),
            ],
        );
        let sweep = simulation.readings(0).sweep.unwrap();
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
        // Two wheels, a centimetre each after a metre.
        let drive = model("tiago").drive;
        let metres = 4.0 * drive.wheel_radius * 16.0;
        let expected = 0.01 * (2.0 * metres).sqrt() / drive.wheel_separation;
        assert!((long / expected - 1.0).abs() < 0.3, "{long} {expected}");
    }

    #[test]
    fn sensors_come_at_their_rates() {
        let mut simulation = simulate(&world(WALL), vec![robot("a", "tiago", Pose2::IDENTITY)]);
        let mut counts = [0; 3];
        for _ in 0..500 {
            simulation.step();
            let readings = simulation.readings(0);
            counts[0] += usize::from(readings.sweep.is_some());
            counts[1] += usize::from(readings.imu.is_some());
            counts[2] += usize::from(readings.gps.is_some());
            assert_eq!(readings.stamp, simulation.now());
        }
        assert_eq!(counts, [100, 500, 100]);
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
            .contains("`b` cannot start")
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
        /// Clearance computed anew from everything else, one by one.
        fn clearance_without(&self, robot: usize) -> f64 {
            let placed = Placed::new(&self.model(robot).footprint, self.truth(robot).map_from_base);
            let solids = self
                .crowd
                .solids()
                .iter()
                .enumerate()
                .filter(|(index, _)| *index != self.movers.len() + robot)
                .map(|(_, solid)| placed.to_solid(solid).distance);
            let fixed = self
                .scene
                .nearest(&placed, f64::INFINITY)
                .map(|nearest| nearest.distance);
            solids.chain(fixed).fold(f64::INFINITY, f64::min)
        }
    }
}
