//! Simulated rig. A world, a robot and its pilot in lockstep, with a small mission or operator that holds the lease.

use std::time::Duration;

use zenav_edge::{EdgeConfig, Inbox, Persisted, Pilot, Publication, Ticket};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::id::{Id, InvalidId};
use zenav_protocol::messages::{
    BasedOn, EdgeState, EventKind, GuardZone, Heartbeat, LeaseAction, LeaseRequest, LeaseRole, Plan, PoseEstimate,
    Revision, Teleop, Trajectory,
};
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::topics::EdgeRequest;
use zenav_sim::{RobotSpec, SimError, Simulation, Truth, World, WorldError};

/// Why a rig cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum SimRigError {
    /// The world.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The robot's name.
    #[error(transparent)]
    Id(#[from] InvalidId),
    /// The robot in the world.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The world has no start pose, or no free path.
    #[error("no start or no free path in the worlds of seed {0}")]
    NoPath(u64),
}

/// A robot in a simulated world, and the holder of its lease.
pub struct SimRig {
    /// The robot's control core.
    pub pilot: Pilot,
    /// The simulated world.
    pub sim: Simulation,
    /// The model that the pilot was given.
    pub model: RobotModel,
    /// The newest published state.
    pub state: Option<EdgeState>,
    /// The newest published pose.
    pub pose: Option<PoseEstimate>,
    /// All events so far.
    pub events: Vec<EventKind>,
    /// Whether the holder of the lease sends heartbeats.
    pub sends_heartbeats: bool,
    /// The plan in force; it is renewed every second.
    pub plan: Option<Plan>,
    counter: u64,
    ticks: u64,
}

impl SimRig {
    /// A robot at `start`, its pilot's initial pose; `role` holds the lease with epoch 1.
    ///
    /// # Errors
    /// [`SimRigError`] when the robot does not fit there.
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
        let mut rig = Self {
            pilot: Pilot::new(config, "boot".to_owned(), Persisted::default()),
            sim,
            model: model.clone(),
            state: None,
            pose: None,
            events: Vec::new(),
            sends_heartbeats: true,
            plan: None,
            counter: 0,
            ticks: 0,
        };
        let request = LeaseRequest::new("holder".to_owned(), role, LeaseAction::Acquire, "1".to_owned());
        rig.tick(
            Inbox {
                requests: vec![(Ticket(1), EdgeRequest::Lease(request))],
                ..Inbox::default()
            },
            |_| {},
        );
        Ok(rig)
    }

    /// One tick of the world, then of the pilot. `corrupt` may change the readings in between.
    pub fn tick(&mut self, mut inbox: Inbox, corrupt: impl FnOnce(&mut Readings)) {
        self.sim.step();
        self.ticks += 1;
        let mut readings = self.sim.readings(0);
        corrupt(&mut readings);
        if self.sends_heartbeats && self.ticks.is_multiple_of(5) {
            self.counter += 1;
            inbox.heartbeats.push(Heartbeat {
                holder: "holder".to_owned(),
                epoch: 1,
                counter: self.counter,
                echo: None,
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

    /// Ticks for `secs` without messages.
    pub fn run(&mut self, secs: f64) {
        for _ in 0..(secs / self.sim.tick().as_secs_f64()) as u64 {
            self.tick(Inbox::default(), |_| {});
        }
    }

    /// The true state of the robot.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.sim.truth(0)
    }

    /// A teleop command that echoes the newest pose.
    #[must_use]
    pub fn teleop(&self, twist: Twist2) -> Option<Teleop> {
        let pose = self.pose.as_ref()?;
        Some(Teleop {
            epoch: 1,
            twist,
            echo: pose.stamp,
        })
    }

    /// A plan that starts here and now.
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
            frame: "map".to_owned(),
            based_on: BasedOn {
                stamp: self.sim.now(),
                boot_id: "boot".to_owned(),
            },
            valid_for: 5.0,
            waypoints,
            trajectory,
            ..Plan::default()
        }
    }

    /// Whether a plan was driven to its end.
    #[must_use]
    pub fn finished(&self) -> bool {
        self.events
            .iter()
            .any(|event| matches!(event, EventKind::PlanFinished { .. }))
    }

    /// Reasons of the collision monitor's interventions.
    pub fn interventions(&self) -> impl Iterator<Item = &str> {
        self.events.iter().filter_map(|event| match event {
            EventKind::Guard { zone, reason } if *zone != GuardZone::Clear => Some(reason.as_str()),
            _ => None,
        })
    }
}
