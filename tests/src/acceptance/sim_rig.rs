//! How do a world, a robot and its pilot step together? In lockstep, with a small mission or operator that keeps its lease.

use std::time::Duration;

use zenav_edge::{EdgeConfig, Inbox, Persisted, Pilot, Publication, Ticket};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::id::{Id, InvalidId};
use zenav_protocol::messages::*;
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::{RobotError, RobotModel, shipped};
use zenav_protocol::topics::EdgeRequest;
use zenav_sim::{RobotSpec, SimError, Simulation, Truth, World, WorldError};

/// Why a proving ground cannot be laid out.
#[derive(Debug, thiserror::Error)]
pub enum SimRigError {
    /// The world.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The robot.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The robot's name.
    #[error(transparent)]
    Id(#[from] InvalidId),
    /// Both together.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// There is no such robot.
    #[error("no shipped robot `{0}`")]
    NoRobot(String),
    /// No way through the world was found.
    #[error("no way was found in the world of seed {0}")]
    NoWay(u64),
}

/// A shipped robot.
///
/// # Errors
/// [`SimRigError`] for an unknown name.
pub fn robot(name: &str) -> Result<RobotModel, SimRigError> {
    let text = shipped(name).ok_or_else(|| SimRigError::NoRobot(name.to_owned()))?;
    Ok(RobotModel::from_toml(text, name)?)
}

/// A robot in a world, and who commands it.
pub struct SimRig {
    /// The robot's side.
    pub pilot: Pilot,
    /// Its world.
    pub sim: Simulation,
    /// What the robot believes of itself.
    pub model: RobotModel,
    /// The newest state.
    pub state: Option<EdgeState>,
    /// The newest estimate.
    pub pose: Option<PoseEstimate>,
    /// Everything that happened.
    pub events: Vec<EventKind>,
    /// Whether the holder of the lease renews it.
    pub beating: bool,
    /// The plan that the mission renews every second.
    pub plan: Option<Plan>,
    counter: u64,
    ticks: u64,
}

impl SimRig {
    /// The robot at `start`, which it knows; `role` holds the lease, under epoch 1.
    ///
    /// # Errors
    /// [`SimRigError`] when the robot cannot stand there.
    pub fn new(
        world: &World,
        model: &RobotModel,
        start: Pose2,
        seed: u64,
        role: LeaseRole,
    ) -> Result<Self, SimRigError> {
        let id = Id::robot("robot")?;
        let spec = RobotSpec {
            id: id.clone(),
            model: model.clone(),
            start,
        };
        let sim = Simulation::new(world, vec![spec], seed)?;
        let config = EdgeConfig::new(id, model.clone(), start);
        let mut ground = Self {
            pilot: Pilot::new(config, "boot".to_owned(), Persisted::default()),
            sim,
            model: model.clone(),
            state: None,
            pose: None,
            events: Vec::new(),
            beating: true,
            plan: None,
            counter: 0,
            ticks: 0,
        };
        let request = LeaseRequest::new("holder".to_owned(), role, LeaseAction::Acquire, "1".to_owned());
        ground.tick(
            Inbox {
                requests: vec![(Ticket(1), EdgeRequest::Lease(request))],
                ..Inbox::default()
            },
            |_| {},
        );
        Ok(ground)
    }

    /// One tick of the world, then of the pilot. `spoil` may change what the sensors say.
    pub fn tick(&mut self, mut inbox: Inbox, spoil: impl FnOnce(&mut Readings)) {
        self.sim.step();
        self.ticks += 1;
        let mut readings = self.sim.readings(0);
        spoil(&mut readings);
        if self.beating && self.ticks.is_multiple_of(5) {
            self.counter += 1;
            inbox.heartbeats.push(Heartbeat {
                holder: "holder".to_owned(),
                epoch: 1,
                counter: self.counter,
            });
        }
        if self.ticks.is_multiple_of(50)
            && let Some(plan) = &mut self.plan
        {
            plan.revision.counter += 1;
            plan.based_on.stamp = self.sim.now() - Duration::from_millis(100);
            inbox.plans.push(plan.clone());
        }
        let out = self.pilot.step(readings.stamp, &readings, inbox);
        self.sim.drive(0, out.wheels);
        for publication in out.publications {
            match publication {
                Publication::Event(event) => self.events.push(event.kind),
                Publication::State(state) => self.state = Some(*state),
                Publication::Pose(pose) => self.pose = Some(pose),
                _ => {}
            }
        }
    }

    /// Ticks with nothing new.
    pub fn run(&mut self, secs: f64) {
        for _ in 0..(secs / self.sim.tick().as_secs_f64()) as u64 {
            self.tick(Inbox::default(), |_| {});
        }
    }

    /// What nobody on the robot knows for sure.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.sim.truth(0)
    }

    /// A twist by hand that echoes the newest pose, one a tick.
    #[must_use]
    pub fn by_hand(&self, twist: Twist2) -> Option<Teleop> {
        let pose = self.pose.as_ref()?;
        Some(Teleop {
            epoch: 1,
            twist,
            echo: pose.stamp,
        })
    }

    /// A plan from here and now: motion number one.
    #[must_use]
    pub fn plan(&self, waypoints: Vec<nalgebra::Point2<f64>>, trajectory: Trajectory) -> Plan {
        Plan {
            goal_id: "goal".to_owned(),
            epoch: 1,
            revision: Revision {
                incarnation: 1,
                counter: 1,
            },
            trajectory_id: 1,
            map: MapRef::default(),
            frame: "map".to_owned(),
            based_on: BasedOn {
                stamp: self.sim.now(),
                boot_id: "boot".to_owned(),
            },
            valid_for: 5.0,
            waypoints,
            trajectory,
            splice: None,
            statistics: PlanStatistics::default(),
        }
    }

    /// Whether the end of a plan was reached.
    #[must_use]
    pub fn finished(&self) -> bool {
        self.events
            .iter()
            .any(|event| matches!(event, EventKind::PlanFinished { .. }))
    }

    /// Reasons of the guard's interventions.
    pub fn interventions(&self) -> impl Iterator<Item = &str> {
        self.events.iter().filter_map(|event| match event {
            EventKind::Guard { zone, reason } if *zone != GuardZone::Clear => Some(reason.as_str()),
            _ => None,
        })
    }
}
