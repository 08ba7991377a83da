//! Host of a served world. Assigns robots to edges, and removes robots without an edge. Pure: wall time is passed in.
//!
//! A robot obeys the edge that attached it last. While that edge sends commands, no other edge gets the robot; after a second of silence,
//! the next edge that asks gets it: a restarted edge finds its robot where it left it. A robot without commands for a minute is removed.

use std::time::Duration;

use serde::Serialize;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{AttachRequest, Refusal, WheelSpeeds};
use zenav_protocol::time::Stamp;
use zenav_sim::{RobotSpec, SimError, Simulation, World};

/// Dead-man's switch: time without a command after which a robot's wheels stop, s of the world's time.
const DEAD_MAN: f64 = 0.1;
/// Wall time without a command after which another edge may take over the robot.
const HOLD: Duration = Duration::from_secs(1);
/// Wall time without a command after which the robot is removed from the world.
const LEAVE: Duration = Duration::from_secs(60);

/// Result of a robot's stay in the world.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotReport {
    /// Its id.
    pub robot: String,
    /// Path driven, m.
    pub length_m: f64,
    /// Least true clearance, m.
    pub min_clearance_m: f64,
    /// Number of contacts.
    pub collisions: u32,
}

/// The world and its robots.
pub struct Host {
    world: World,
    simulation: Simulation,
    /// In the order of the simulation.
    robots: Vec<Driven>,
    /// Reports of removed robots.
    left: Vec<RobotReport>,
}

struct Driven {
    id: Id,
    /// Number of the edge that drives the robot.
    edge: u64,
    /// Last attachment or command of that edge, wall time.
    heard: Duration,
    /// Last command of the wheels, the world's time.
    commanded: Stamp,
    collisions: u32,
}

impl Host {
    /// A world without robots.
    #[must_use]
    pub fn new(world: World, simulation: Simulation) -> Self {
        Self {
            world,
            simulation,
            robots: Vec::new(),
            left: Vec::new(),
        }
    }

    /// The served world.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The simulation, and the ids of its robots in order.
    pub fn robots(&self) -> (&Simulation, impl Iterator<Item = &Id>) {
        (&self.simulation, self.robots.iter().map(|robot| &robot.id))
    }

    /// Adds a robot to the world, or hands an existing one over to another edge. `now` is wall time. Returns the robot's pose.
    ///
    /// # Errors
    /// [`Refusal::Busy`] while another edge drives it, [`Refusal::BadRequest`] for an invalid request.
    pub fn attach(&mut self, now: Duration, request: &AttachRequest) -> Result<Pose2, Refusal> {
        let id = Id::robot(request.robot.clone()).map_err(Refusal::bad_request)?;
        let Some(index) = self.simulation.find(&id) else {
            return self.admit(now, id, request);
        };
        let here = self.simulation.truth(index).map_from_base;
        let same_model = *self.simulation.model(index) == request.model;
        let Some(robot) = self.robots.get_mut(index) else {
            return Err(Refusal::bad_request(format!("robot `{id}` is driven by no edge")));
        };
        if robot.edge != request.edge && now.saturating_sub(robot.heard) < HOLD {
            return Err(Refusal::Busy {
                reason: format!("another edge drives robot `{id}`: stop that one, or give this one another name"),
            });
        }
        if !same_model {
            let left = LEAVE.saturating_sub(now.saturating_sub(robot.heard)).as_secs();
            return Err(Refusal::bad_request(format!(
                "robot `{id}` is in this world with another model; if no edge drives it, it leaves in {left} s"
            )));
        }
        (robot.edge, robot.heard) = (request.edge, now);
        if request.start.is_some_and(|start| start.distance(&here) > 1e-3) {
            tracing::warn!(robot = %id, x = here.x, y = here.y, "is in the world already and stays where it is: its start is left out");
        }
        tracing::info!(robot = %id, "has an edge again");
        Ok(here)
    }

    fn admit(&mut self, now: Duration, id: Id, request: &AttachRequest) -> Result<Pose2, Refusal> {
        let start = request.start.unwrap_or_else(|| self.world.start());
        let spec = RobotSpec {
            id: id.clone(),
            model: request.model.clone(),
            start,
        };
        let added = self.simulation.add(&self.world, spec);
        added.map_err(|error| match error {
            SimError::Outside { .. } | SimError::Occupied { .. } => {
                Refusal::bad_request(format!("{error}; choose another `start`"))
            }
            _ => Refusal::bad_request(error),
        })?;
        tracing::info!(robot = %id, x = start.x, y = start.y, "a robot came into the world");
        self.robots.push(Driven {
            id,
            edge: request.edge,
            heard: now,
            commanded: self.simulation.now(),
            collisions: 0,
        });
        Ok(start)
    }

    /// Commands a robot's wheels, if the command is from the edge that has the robot.
    pub fn command(&mut self, now: Duration, robot: &str, speeds: &WheelSpeeds) {
        let found = self.robots.iter_mut().enumerate();
        let has = |(_, driven): &(usize, &mut Driven)| driven.id.as_str() == robot && driven.edge == speeds.edge;
        if let Some((index, driven)) = found.into_iter().find(has) {
            (driven.heard, driven.commanded) = (now, self.simulation.now());
            self.simulation.drive(index, speeds.wheels);
        }
    }

    /// Advances the world by one step.
    pub fn step(&mut self, now: Duration) {
        self.dismiss(now);
        let time = self.simulation.now();
        for (index, robot) in self.robots.iter().enumerate() {
            if time.secs_since(robot.commanded) > DEAD_MAN {
                self.simulation.drive(index, [0.0; 2]);
            }
        }
        self.simulation.step();
        for (index, robot) in self.robots.iter_mut().enumerate() {
            let collisions = self.simulation.truth(index).collisions;
            if collisions > robot.collisions {
                robot.collisions = collisions;
                tracing::warn!(robot = %robot.id, collisions, "touched something");
            }
        }
    }

    /// Removes robots that no edge drives any more.
    fn dismiss(&mut self, now: Duration) {
        let gone = |robot: &Driven| now.saturating_sub(robot.heard) > LEAVE;
        while let Some(index) = self.robots.iter().position(gone) {
            let report = self.report_of(index);
            self.simulation.remove(index);
            let robot = self.robots.remove(index);
            tracing::info!(robot = %robot.id, "left the world: no edge drove it for {} s", LEAVE.as_secs());
            self.left.push(report);
        }
    }

    fn report_of(&self, index: usize) -> RobotReport {
        let truth = self.simulation.truth(index);
        RobotReport {
            robot: self
                .robots
                .get(index)
                .map_or_else(String::new, |robot| robot.id.to_string()),
            length_m: truth.length,
            min_clearance_m: truth.min_clearance,
            collisions: truth.collisions,
        }
    }

    /// Reports of all robots, the removed ones first.
    #[must_use]
    pub fn report(&self) -> Vec<RobotReport> {
        let there = (0..self.robots.len()).map(|index| self.report_of(index));
        self.left.iter().cloned().chain(there).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn host() -> Host {
        let text = "size = [10, 10]\n[start]\nx = 1\ny = 1\n";
        let world = World::from_toml(text, "w.toml", &|_| Err(String::new())).unwrap();
        let simulation = Simulation::new(&world, Vec::new(), 1).unwrap();
        Host::new(world, simulation)
    }

    fn request(robot: &str, edge: u64) -> AttachRequest {
        AttachRequest {
            robot: robot.to_owned(),
            model: zenav_fixtures::robot("neato"),
            start: None,
            edge,
        }
    }

    fn speeds(edge: u64) -> WheelSpeeds {
        WheelSpeeds {
            stamp: Stamp::ZERO,
            wheels: [5.0; 2],
            edge,
        }
    }

    /// Steps the world for a second of wall time, with a command of each edge in every step; returns how far the first robot drove.
    fn driven(host: &mut Host, from: Duration, edges: &[u64]) -> f64 {
        let before = host.simulation.truth(0).length;
        for step in 0..50 {
            let now = from + Duration::from_millis(20 * step);
            for edge in edges {
                host.command(now, "a", &speeds(*edge));
            }
            host.step(now);
        }
        host.simulation.truth(0).length - before
    }

    const SEC: Duration = Duration::from_secs(1);

    #[test]
    fn of_two_edges_of_one_name_only_the_first_drives() {
        let mut host = host();
        let start = host.attach(Duration::ZERO, &request("a", 1)).unwrap();
        // An edge whose first answer was lost asks again.
        assert_eq!(host.attach(Duration::ZERO, &request("a", 1)), Ok(start));
        assert!(driven(&mut host, Duration::ZERO, &[1]) > 0.05);
        let second = host.attach(SEC, &request("a", 2));
        assert!(
            matches!(&second, Err(Refusal::Busy { reason }) if reason.contains("`a`")),
            "{second:?}"
        );
        driven(&mut host, SEC, &[]);
        assert!(
            driven(&mut host, 2 * SEC, &[2]) < 1e-6,
            "nobody drives it who does not have it"
        );
    }

    #[test]
    fn an_edge_that_was_started_anew_gets_its_robot_where_it_stands_and_the_old_one_is_not_obeyed() {
        let mut host = host();
        host.attach(Duration::ZERO, &request("a", 1)).unwrap();
        driven(&mut host, Duration::ZERO, &[1]);
        driven(&mut host, SEC, &[]);
        let here = host.simulation.truth(0).map_from_base;
        let start = Some(Pose2::new(5.0, 5.0, 0.0));
        let again = AttachRequest {
            start,
            ..request("a", 2)
        };
        assert_eq!(host.attach(2 * SEC, &again), Ok(here));
        assert!(driven(&mut host, 2 * SEC, &[1]) < 1e-6);
        assert!(driven(&mut host, 3 * SEC, &[2]) > 0.05);
        let mut other = request("a", 3);
        other.model.lidar.as_mut().unwrap().beams = 10;
        let refused = host.attach(10 * SEC, &other);
        assert!(matches!(&refused, Err(Refusal::BadRequest { .. })), "{refused:?}");
    }

    #[test]
    fn a_robot_that_nobody_drives_leaves_and_the_others_stay() {
        let mut host = host();
        host.attach(Duration::ZERO, &request("a", 1)).unwrap();
        let start = Some(Pose2::new(5.0, 5.0, 0.0));
        let b = AttachRequest {
            start,
            ..request("b", 2)
        };
        host.attach(30 * SEC, &b).unwrap();
        host.step(59 * SEC);
        assert_eq!(host.robots().1.count(), 2);
        host.step(61 * SEC);
        assert_eq!(host.robots().1.map(Id::as_str).collect::<Vec<_>>(), ["b"]);
        host.command(61 * SEC, "b", &speeds(2));
        host.step(61 * SEC);
        assert_eq!(host.report().len(), 2);
        // Its place is free again.
        assert!(host.attach(62 * SEC, &request("a", 3)).is_ok());
    }

    #[test]
    fn nobody_comes_into_the_world_where_nobody_can_stand() {
        let mut host = host();
        for start in [Pose2::new(50.0, 5.0, 0.0), Pose2::new(f64::NAN, 0.0, 0.0)] {
            let start = Some(start);
            let refused = host.attach(
                SEC,
                &AttachRequest {
                    start,
                    ..request("a", 1)
                },
            );
            assert!(matches!(refused, Err(Refusal::BadRequest { .. })), "{refused:?}");
        }
        let far = AttachRequest {
            start: Some(Pose2::new(50.0, 5.0, 0.0)),
            ..request("a", 1)
        };
        let told = host.attach(SEC, &far).unwrap_err().to_string();
        assert!(told.ends_with("choose another `start`"), "{told}");
    }
}
