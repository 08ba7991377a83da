//! Simulation. Everything advances in fixed steps from a seed: the same commands give the same bytes.
//!
//! A step moves the movers, then the robots in their order, each against the present positions of the others; after all have moved,
//! clearances are computed and sensors measure. Robots see and hit one another.

mod spec;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Point2, Vector2};
use parry2d_f64::query::PointQuery as _;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_protocol::time::Stamp;

use crate::body::Body;
use crate::bridge;
use crate::chassis::{CONTACT, Surroundings, Truth};
use crate::clearance::Placed;
use crate::crowd::Crowd;
use crate::faults::FaultModel;
use crate::manners::{Neighbour, SIGHT};
use crate::movers::Mover;
use crate::scene::Scene;
use crate::sensors::random::mover_stream;
use crate::shape::Solid;
use crate::world::World;
pub use spec::{MAX_ROBOTS, RobotSpec, SimError};

/// The default step: a control loop of 50 Hz.
pub const TICK: Duration = Duration::from_millis(20);

/// A running world.
#[derive(Clone)]
pub struct Simulation {
    scene: Arc<Scene>,
    faults: Vec<FaultModel>,
    movers: Vec<Mover>,
    /// Velocities of the movers, m/s.
    velocities: Vec<Vector2<f64>>,
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
    /// ```
    /// # let tiago = zenav_fixtures::robot("tiago");
    /// use zenav_protocol::{geometry::Pose2, id::Id};
    /// use zenav_sim::{RobotSpec, Simulation, World};
    ///
    /// let kitchen = World::shipped("kitchen")?;
    /// let at = |x, y| RobotSpec { id: Id::robot("tiago").unwrap(), model: tiago.clone(), start: Pose2::new(x, y, 0.0) };
    /// let simulation = Simulation::new(&kitchen, vec![at(-1.0, -0.5)], 1)?;
    /// assert_eq!(simulation.robots(), 1);
    /// let error = Simulation::new(&kitchen, vec![at(0.0, -1.8)], 1).err().unwrap();
    /// assert_eq!(error.to_string(), "robot `tiago` cannot stand at (0, -1.8): something stands there");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`SimError`]: invalid names, models or starts.
    pub fn new(world: &World, robots: Vec<RobotSpec>, seed: u64) -> Result<Self, SimError> {
        Self::with_tick(world, robots, seed, TICK)
    }

    /// Puts robots into a world, with a given step between 1 ms and 1 s.
    ///
    /// # Errors
    /// [`SimError`]: an invalid step, or invalid names, models or starts.
    pub fn with_tick(world: &World, robots: Vec<RobotSpec>, seed: u64, tick: Duration) -> Result<Self, SimError> {
        if !(Duration::from_millis(1)..=Duration::from_secs(1)).contains(&tick) {
            return Err(SimError::Tick(tick));
        }
        let (movers, solids): (Vec<Mover>, Vec<Solid>) = world
            .movers()
            .iter()
            .enumerate()
            .map(|(index, model)| Mover::new(model, mover_stream(seed, index)))
            .unzip();
        let mut simulation = Self {
            scene: world.shared_scene(),
            faults: world.faults().to_vec(),
            velocities: vec![Vector2::zeros(); movers.len()],
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
        simulation.check_faults()?;
        simulation.sense();
        Ok(simulation)
    }

    /// Adds a robot to the world, which must be the one that the simulation was made with; its sensors report from the next step on.
    /// Returns its index for all calls that take one.
    ///
    /// # Errors
    /// [`SimError`]: an invalid name, model or start.
    pub fn add(&mut self, world: &World, robot: RobotSpec) -> Result<usize, SimError> {
        let index = self.place(world, robot)?;
        self.crowd.refresh();
        for body in &mut self.bodies {
            body.chassis.look_again();
        }
        Ok(index)
    }

    /// Removes a robot; the indices of the robots after it drop by one.
    ///
    /// ```
    /// # use zenav_protocol::{geometry::Pose2, id::Id};
    /// # use zenav_sim::{RobotSpec, Simulation, World};
    /// # let world = World::shipped("empty")?;
    /// # let tiago = zenav_fixtures::robot("tiago");
    /// # let spec = |id: &Id, x| RobotSpec { id: id.clone(), model: tiago.clone(), start: Pose2::new(x, 0.0, 0.0) };
    /// let (ada, bob) = (Id::robot("ada")?, Id::robot("bob")?);
    /// let mut simulation = Simulation::new(&world, vec![spec(&ada, 0.0), spec(&bob, 2.0)], 1)?;
    /// simulation.remove(0);
    /// assert_eq!((simulation.find(&ada), simulation.find(&bob)), (None, Some(0)));
    /// assert_eq!(simulation.add(&world, spec(&ada, -2.0))?, 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Panics
    /// See [`Self::drive`].
    pub fn remove(&mut self, robot: usize) {
        self.bodies.remove(robot);
        self.crowd.remove(self.movers.len() + robot);
        self.ids.retain(|_, place| *place != robot);
        for place in self.ids.values_mut().filter(|place| **place > robot) {
            *place -= 1;
        }
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
        let start = Pose2::new(start.x, start.y, start.yaw);
        self.check_room(world, &id, usize::MAX, &model.footprint, start)?;
        self.crowd.push(Solid::new(model.footprint.clone(), start));
        let body = Body::new(&id, model, start, self.seed, &self.faults);
        for fault in self.faults.iter().filter(|fault| fault.robot.as_ref() == Some(&id)) {
            faulty(fault, [&body])?;
        }
        self.bodies.push(body);
        self.ids.insert(id, index);
        Ok(index)
    }

    /// Checks that a robot fits at a pose. `own` is its index in the crowd.
    fn check_room(&self, world: &World, id: &Id, own: usize, footprint: &Footprint, at: Pose2) -> Result<(), SimError> {
        if !at.is_finite() {
            return Err(SimError::NotFinite(id.clone()));
        }
        if !world.holds(at.position()) {
            let (low, high) = world.bounds();
            return Err(SimError::Outside {
                robot: id.clone(),
                at: at.position(),
                low,
                high,
            });
        }
        // Clearances are to the edges of solids, which are far from a robot well inside one.
        if world.is_solid(at.position()) || self.clearance_but(own, footprint, at) <= CONTACT {
            return Err(SimError::Occupied {
                robot: id.clone(),
                x: at.x,
                y: at.y,
            });
        }
        Ok(())
    }

    /// Checks that each fault belongs to a robot; without robots there is nothing to check.
    fn check_faults(&self) -> Result<(), SimError> {
        let mut named = self
            .faults
            .iter()
            .filter_map(|fault| Some((fault, fault.robot.as_ref()?)));
        if let Some((fault, robot)) = named.find(|(_, robot)| !self.bodies.is_empty() && !self.ids.contains_key(*robot))
        {
            let known: Vec<&str> = self.ids.keys().map(Id::as_str).collect();
            return Err(SimError::FaultOfNobody {
                at: fault.at.clone(),
                robot: robot.clone(),
                known: known.join(", "),
            });
        }
        let mut common = self.faults.iter().filter(|fault| fault.robot.is_none());
        match self.bodies.len() {
            0 => Ok(()),
            _ => common.try_for_each(|fault| faulty(fault, &self.bodies)),
        }
    }

    /// Simulated time since the beginning.
    #[must_use]
    pub fn now(&self) -> Stamp {
        self.now
    }

    /// Length of a step.
    #[must_use]
    pub fn tick(&self) -> Duration {
        self.tick
    }

    /// Number of robots.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.bodies.len()
    }

    /// Index of a robot for all calls that take one.
    #[must_use]
    pub fn find(&self, id: &Id) -> Option<usize> {
        self.ids.get(id).copied()
    }

    /// Commands a robot's wheels (left, right; rad/s), until the next command. Bounded by its limits; NaN stops it.
    ///
    /// ```
    /// # use zenav_protocol::id::Id;
    /// # use zenav_sim::{RobotSpec, Simulation, World};
    /// # let world = World::shipped("empty")?;
    /// # let tiago = RobotSpec { id: Id::robot("tiago")?, model: zenav_fixtures::robot("tiago"), start: world.start() };
    /// let mut simulation = Simulation::new(&world, vec![tiago], 1)?;
    /// simulation.drive(0, [99.0, 99.0]);
    /// for _ in 0..100 {
    ///     simulation.step();
    /// }
    /// let top_speed = simulation.model(0).drive.top_speed();
    /// assert!((simulation.truth(0).twist.v - top_speed).abs() < 1e-3, "bounded to {top_speed} m/s");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Panics
    /// Unless `robot` is less than [`Self::robots`]; so do all calls that take a robot.
    pub fn drive(&mut self, robot: usize, wheels: [f64; 2]) {
        self.bodies[robot].command(wheels);
    }

    /// Moves a robot to another place at once: its sensors do not notice the move, and its wheels keep turning. The world must be the one
    /// that the simulation was made with.
    ///
    /// ```
    /// # use zenav_protocol::{geometry::Pose2, id::Id};
    /// # use zenav_sim::{RobotSpec, Simulation, World};
    /// # let kitchen = World::shipped("kitchen")?;
    /// # let tiago = RobotSpec { id: Id::robot("tiago")?, model: zenav_fixtures::robot("tiago"), start: kitchen.start() };
    /// let mut simulation = Simulation::new(&kitchen, vec![tiago], 1)?;
    /// let beside_the_table = Pose2::new(-1.3, -1.8, 1.0);
    /// simulation.carry(&kitchen, 0, beside_the_table)?;
    /// simulation.step();
    /// assert_eq!(simulation.truth(0).map_from_base, beside_the_table);
    /// assert_eq!(simulation.readings(0).wheels, [0.0, 0.0], "its encoders noticed nothing");
    /// assert!(simulation.carry(&kitchen, 0, Pose2::new(-0.7, -1.8, 1.0)).is_err(), "half of the robot would be in the table");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`SimError`] if it does not fit there; then it stays where it is.
    ///
    /// # Panics
    /// See [`Self::drive`].
    pub fn carry(&mut self, world: &World, robot: usize, to: Pose2) -> Result<(), SimError> {
        let own = self.movers.len() + robot;
        let body = &self.bodies[robot];
        let named = self.ids.iter().find(|(_, place)| **place == robot);
        let id = named.map_or_else(Id::unique, |(id, _)| id.clone());
        self.check_room(world, &id, own, &body.model().footprint, to)?;
        let Self {
            scene, bodies, crowd, ..
        } = self;
        bodies[robot].chassis.carry(to);
        crowd.place(own, to);
        crowd.refresh();
        for other in bodies.iter_mut() {
            other.chassis.look_again();
        }
        let body = &mut bodies[robot];
        body.chassis.settle(Surroundings { scene, crowd, own }, self.now);
        Ok(())
    }

    /// Advances by one step.
    ///
    /// ```
    /// # use zenav_protocol::id::Id;
    /// # use zenav_sim::{RobotSpec, SimError, Simulation, World};
    /// # let kitchen = World::shipped("kitchen")?;
    /// # let tiago = RobotSpec { id: Id::robot("tiago")?, model: zenav_fixtures::robot("tiago"), start: kitchen.start() };
    /// let run = |seed| {
    ///     let mut simulation = Simulation::new(&kitchen, vec![tiago.clone()], seed)?;
    ///     simulation.drive(0, [2.0, 3.0]);
    ///     for _ in 0..10 {
    ///         simulation.step();
    ///     }
    ///     Ok::<_, SimError>(simulation.readings(0))
    /// };
    /// assert_eq!(run(1)?, run(1)?);
    /// assert_ne!(run(1)?, run(2)?, "another seed, other noise");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
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

    /// Moves all movers; returns an upper bound of their motion, m.
    fn move_movers(&mut self, secs: f64) -> f64 {
        let Self {
            scene,
            movers,
            velocities,
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
            let reach = stride + CONTACT + solid.reach();
            let center = bridge::vector(solid.center());
            let near: Vec<(f64, Placed)> = bodies
                .iter()
                .map(|body| body.chassis.outline())
                .filter(|placed| placed.bounds().distance_to_local_point(center, true) <= reach)
                .map(|placed| (solid.distance(&placed), placed))
                .collect();
            // Half of the contact distance, so that a robot that was run into registers the contact.
            let blocked = |solid: &Solid| {
                near.iter().any(|(before, placed)| {
                    let distance = solid.distance(placed);
                    distance <= 0.5 * CONTACT && distance < *before
                })
            };
            let before = solid.center();
            if mover.makes_way() {
                let others = neighbours(crowd, velocities, bodies, index);
                crowd.change(index, |solid| mover.make_way(secs, scene, solid, &others, blocked));
            } else {
                crowd.change(index, |solid| mover.step(secs, scene, solid, blocked));
            }
            if let (Some(velocity), Some(solid)) = (velocities.get_mut(index), crowd.solids().get(index)) {
                *velocity = (solid.center() - before) / secs;
            }
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
            body.chassis
                .meet(crowd, |index, solid| index < movers.len() && solid.disc().is_some());
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

    /// A robot's readings in the last step; before the first step, those at time zero.
    ///
    /// ```
    /// # use zenav_protocol::{geometry::Pose2, id::Id};
    /// # use zenav_sim::{RobotSpec, Simulation, World};
    /// # let tiago = RobotSpec { id: Id::robot("tiago")?, model: zenav_fixtures::robot("tiago"), start: Pose2::IDENTITY };
    /// let wall = "size = [4.0, 4.0]\norigin = [-2.0, -2.0]\n[[wall]]\nfrom = [1.0, -1.5]\nto = [1.0, 1.5]\nthickness = 0.1\n";
    /// let world = World::from_toml(wall, "wall.toml", &|_| Err(String::new()))?;
    /// let readings = Simulation::new(&world, vec![tiago], 1)?.readings(0);
    /// let ranges = &readings.sweeps[0].ranges;
    /// // The wall's face is 0.95 m ahead of the base, and the lidar 0.2 m; noise has a standard deviation of 5 mm.
    /// assert!((ranges[ranges.len() / 2] - 0.75).abs() < 0.03);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Panics
    /// See [`Self::drive`].
    #[must_use]
    pub fn readings(&self, robot: usize) -> Readings {
        self.bodies[robot].readings()
    }

    /// Ground truth, which no robot knows exactly.
    ///
    /// ```
    /// # use zenav_protocol::{geometry::Pose2, id::Id};
    /// # use zenav_sim::{RobotSpec, Simulation, World};
    /// # let tiago = RobotSpec { id: Id::robot("tiago")?, model: zenav_fixtures::robot("tiago"), start: Pose2::new(-1.3, -1.8, 0.0) };
    /// let mut simulation = Simulation::new(&World::shipped("kitchen")?, vec![tiago], 1)?;
    /// // The robot faces the table; its left side lies at x = -0.6, the robot's radius is 0.265 m.
    /// simulation.drive(0, [3.0, 3.0]);
    /// for _ in 0..150 {
    ///     simulation.step();
    /// }
    /// let truth = simulation.truth(0);
    /// assert!((truth.map_from_base.x - (-0.6 - 0.265)).abs() < 1e-3);
    /// assert_eq!(truth.collisions, 1);
    /// assert!(truth.last_contact.is_some_and(|contact| contact.bearing.abs() < 0.01 && contact.own_speed > 0.2));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Panics
    /// See [`Self::drive`].
    #[must_use]
    pub fn truth(&self, robot: usize) -> Truth {
        self.bodies[robot].chassis.truth()
    }

    /// A robot's model.
    ///
    /// # Panics
    /// See [`Self::drive`].
    #[must_use]
    pub fn model(&self, robot: usize) -> &RobotModel {
        self.bodies[robot].model()
    }

    /// Present positions of the movers, in the order of the world's file, m.
    ///
    /// ```
    /// use zenav_sim::{Simulation, World};
    ///
    /// let person = "size = [4.0, 4.0]\n[[mover]]\nradius = 0.25\npath = [[0.5, 2.0], [3.5, 2.0]]\nspeed = 1.0\n";
    /// let world = World::from_toml(person, "person.toml", &|_| Err(String::new()))?;
    /// let mut simulation = Simulation::new(&world, Vec::new(), 1)?;
    /// for _ in 0..50 {
    ///     simulation.step();
    /// }
    /// let at = simulation.movers().next().unwrap();
    /// assert!((at.x - 1.5).abs() < 1e-6 && at.y == 2.0, "1 m in 50 steps of 20 ms");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn movers(&self) -> impl Iterator<Item = Point2<f64>> + '_ {
        self.crowd.solids().iter().take(self.movers.len()).map(Solid::center)
    }

    /// True clearance that a footprint would have at a pose now, among solids, movers and robots, m.
    ///
    /// ```
    /// # use zenav_protocol::{geometry::Pose2, id::Id, robot::Footprint};
    /// # use zenav_sim::{RobotSpec, Simulation, World};
    /// # let world = World::shipped("empty")?;
    /// # let tiago = RobotSpec { id: Id::robot("tiago")?, model: zenav_fixtures::robot("tiago"), start: world.start() };
    /// let simulation = Simulation::new(&world, vec![tiago], 1)?;
    /// let (disc, beside) = (Footprint::Radius(0.2), Pose2::new(1.0, 0.0, 0.0));
    /// assert!((simulation.clearance(&disc, beside) - (1.0 - 0.2 - 0.265)).abs() < 1e-6, "from the robot at the origin");
    /// assert_eq!(simulation.clearance_beside(0, &disc, beside), f64::INFINITY);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn clearance(&self, footprint: &Footprint, map_from_base: Pose2) -> f64 {
        self.clearance_but(usize::MAX, footprint, map_from_base)
    }

    /// The same without this robot.
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
        around.clearance(&Placed::footprint(footprint, map_from_base))
    }
}

/// Refuses a fault of a sensor that none of these robots has.
fn faulty<'a>(fault: &FaultModel, bodies: impl IntoIterator<Item = &'a Body>) -> Result<(), SimError> {
    let mut known = Vec::new();
    for body in bodies {
        if body.sensors().any(|sensor| sensor == fault.sensor) {
            return Ok(());
        }
        known.extend(body.sensors());
    }
    known.sort_unstable();
    known.dedup();
    Err(SimError::Fault {
        at: fault.at.clone(),
        sensor: fault.sensor.clone(),
        known: known.join(", "),
    })
}

/// Everything near a mover, seen from it.
fn neighbours(crowd: &Crowd, velocities: &[Vector2<f64>], bodies: &[Body], own: usize) -> Vec<Neighbour> {
    let mut others = Vec::new();
    let Some(center) = crowd.solids().get(own).map(Solid::center) else {
        return others;
    };
    crowd.near(center, SIGHT, |index, solid| {
        let robot = || {
            let truth = bodies.get(index.checked_sub(velocities.len())?)?.chassis.truth();
            let (sin, cos) = truth.map_from_base.yaw.sin_cos();
            Some(Vector2::new(cos, sin) * truth.twist.v)
        };
        if let Some(velocity) = velocities.get(index).copied().or_else(robot).filter(|_| index != own) {
            others.push(Neighbour {
                offset: solid.center() - center,
                velocity,
                radius: solid.reach(),
            });
        }
    });
    others
}
