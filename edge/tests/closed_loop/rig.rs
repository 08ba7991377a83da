//! A world, a robot and its pilot in lockstep, and a small mission that keeps its lease.

use nalgebra::Point2;
use zenav_edge::{EdgeConfig, Inbox, Outbox, Persisted, Pilot, Publication, Ticket};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    BasedOn, BehaviourAction, BehaviourRequest, BehaviourState, EdgeState, EventKind, Heartbeat, LeaseAction,
    LeaseRequest, LeaseRole, Plan, PoseEstimate, Revision, Teleop,
};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::topics::EdgeRequest;
use zenav_protocol::trajectory::Trajectory;
use zenav_sim::{RobotSpec, Simulation, Truth, World};

pub struct Rig {
    pub pilot: Pilot,
    pub sim: Simulation,
    pub model: RobotModel,
    pub epoch: u64,
    pub teleop: Option<Twist2>,
    pub plan: Option<Plan>,
    pub state: Option<EdgeState>,
    pub pose: Option<PoseEstimate>,
    pub events: Vec<EventKind>,
    counter: u64,
    ticks: u64,
}

impl Rig {
    pub fn new(world: &str, robot: &str, seed: u64, role: LeaseRole) -> Self {
        Self::within(&World::shipped(world).unwrap(), robot, seed, role)
    }

    pub fn within(world: &World, robot: &str, seed: u64, role: LeaseRole) -> Self {
        let model = RobotModel::with_options(robot, |name| Err(name.to_owned())).unwrap();
        Self::of(world, model, seed, role)
    }

    pub fn of(world: &World, model: RobotModel, seed: u64, role: LeaseRole) -> Self {
        let id = Id::robot(model.name.clone()).unwrap();
        let sim = Simulation::new(
            world,
            vec![RobotSpec {
                id: id.clone(),
                model: model.clone(),
                start: world.start(),
            }],
            seed,
        )
        .unwrap();
        let pilot = Pilot::new(
            EdgeConfig::new(id, model.clone(), world.start()),
            "boot".into(),
            Persisted::default(),
        );
        let mut rig = Self {
            pilot,
            sim,
            model,
            epoch: 0,
            teleop: None,
            plan: None,
            state: None,
            pose: None,
            events: Vec::new(),
            counter: 0,
            ticks: 0,
        };
        let request = LeaseRequest::new("m", role, LeaseAction::Acquire, "1");
        let out = rig.tick(Inbox {
            requests: vec![(Ticket(1), EdgeRequest::Lease(request))],
            ..Inbox::default()
        });
        assert_eq!(
            out.persist,
            Some(Persisted {
                epoch: 1,
                stopped: false,
                leader: None,
            })
        );
        rig.epoch = 1;
        rig
    }

    pub fn tick(&mut self, mut inbox: Inbox) -> Outbox {
        self.sim.step();
        self.ticks += 1;
        let readings = self.sim.readings(0);
        if self.ticks.is_multiple_of(5) && self.epoch > 0 {
            self.counter += 1;
            inbox.heartbeats.push(Heartbeat {
                holder: "m".into(),
                epoch: self.epoch,
                counter: self.counter,
                echo: None,
            });
            if let (Some(twist), Some(state)) = (self.teleop, &self.state) {
                inbox.teleops.push(Teleop {
                    epoch: self.epoch,
                    twist,
                    echo: state.stamp,
                });
            }
        }
        if self.ticks.is_multiple_of(50)
            && let Some(plan) = &mut self.plan
        {
            plan.revision.counter += 1;
            plan.based_on.stamp = self.sim.now() - std::time::Duration::from_millis(100);
            inbox.plans.push(plan.clone());
        }
        let out = self.pilot.step(readings.stamp, &readings, inbox);
        self.sim.drive(0, out.wheels);
        for publication in &out.publications {
            match publication {
                Publication::Event(event) => self.events.push(event.kind.clone()),
                Publication::State(state) => self.state = Some((**state).clone()),
                Publication::Pose(pose) => self.pose = Some(pose.clone()),
                _ => {}
            }
        }
        out
    }

    pub fn run(&mut self, secs: f64) {
        for _ in 0..(secs * 50.0) as usize {
            self.tick(Inbox::default());
        }
    }

    pub fn truth(&self) -> Truth {
        self.sim.truth(0)
    }

    pub fn plan(&self, waypoints: &[(f64, f64)], trajectory: impl Into<Trajectory>) -> Plan {
        Plan {
            goal_id: "g".into(),
            epoch: self.epoch,
            revision: Revision {
                incarnation: 1,
                counter: 1,
            },
            trajectory_id: 1,
            frame: "map".into(),
            based_on: BasedOn {
                stamp: self.sim.now(),
                boot_id: "boot".into(),
            },
            valid_for: 5.0,
            waypoints: waypoints.iter().map(|(x, y)| Point2::new(*x, *y)).collect(),
            trajectory: trajectory.into(),
            ..Plan::default()
        }
    }

    /// Drives the plan until it is finished; the time it took, s.
    pub fn drive(&mut self, plan: Plan, limit: f64, mut each_tick: impl FnMut(&Self)) -> f64 {
        let begun = self.sim.now();
        let id = plan.trajectory_id;
        self.plan = Some(plan);
        loop {
            self.tick(Inbox::default());
            each_tick(self);
            let secs = self.sim.now().secs_since(begun);
            let finished = self
                .state
                .as_ref()
                .and_then(|state| state.plan.as_ref())
                .is_some_and(|plan| plan.finished && plan.trajectory_id == id);
            if finished {
                return secs;
            }
            assert!(
                secs < limit,
                "not finished after {secs} s at {:?}: {:?} {:?}",
                self.truth(),
                self.state,
                self.events
            );
        }
    }

    /// Drives straight as a maneuver of that id, until it has ended; the greatest speed on the way, m/s.
    pub fn drive_straight(&mut self, id: &str, distance: f64, speed: f64) -> f64 {
        let request = BehaviourRequest {
            id: id.into(),
            action: BehaviourAction::Drive { distance, speed },
            epoch: Some(self.epoch),
        };
        self.tick(Inbox {
            requests: vec![(Ticket(2), EdgeRequest::Behaviour(request))],
            ..Inbox::default()
        });
        let mut fastest = 0.0_f64;
        for _ in 0..1500 {
            self.tick(Inbox::default());
            fastest = fastest.max(self.truth().twist.v.abs());
            let report = self.state.as_ref().and_then(|state| state.behaviour.as_ref());
            if let Some(report) = report.filter(|report| report.id == id && report.state != BehaviourState::Running) {
                assert_eq!(report.state, BehaviourState::Succeeded, "{report:?} {:?}", self.events);
                return fastest;
            }
        }
        panic!("{id} has not ended: {:?} {:?}", self.state, self.events);
    }
}
