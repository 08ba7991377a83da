//! A robot in a square room, for tests of the pilot: perfect sensors, motors with lag, and a mission that behaves.

#![allow(clippy::unwrap_used, reason = "tests")]

use nalgebra::Point2;
use zenav_fixtures::sweep_in_room;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    BasedOn, Battery, Bump, EdgeState, EventKind, Heartbeat, Imu, LeaseAction, LeaseRequest, LeaseRole, Marker, Plan,
    Refusal, Revision,
};
use zenav_protocol::readings::{Readings, Sweep};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{EdgeReply, EdgeRequest};
use zenav_protocol::trajectory::TrajectoryPoint;

use crate::config::EdgeConfig;
use crate::control_io::{Inbox, Outbox, Persisted, Publication, Ticket};
use crate::pilot::Pilot;

const TICK: f64 = 0.02;
/// Half the side of the room, m.
pub const ROOM: f64 = 5.0;

pub struct Rig {
    pub pilot: Pilot,
    pub model: RobotModel,
    pub now: Stamp,
    pub pose: Pose2,
    pub velocity: Twist2,
    pub wheels: [f64; 2],
    pub commanded: [f64; 2],
    pub events: Vec<EventKind>,
    pub charge: f64,
    pub state: Option<EdgeState>,
    pub stored: Persisted,
    pub inbox: Inbox,
    pub heartbeat: Option<u64>,
    pub scanning: bool,
    /// Bearing of the bumper contact, base frame, rad; not a number for a bumper that does not tell it.
    pub bump: Option<f64>,
    pub markers: Vec<Marker>,
    counter: u64,
    ticks: u64,
}

impl Rig {
    pub fn new(stored: Persisted) -> Self {
        let mut model = zenav_fixtures::robot("tiago");
        // It also sees behind itself: it may back up.
        model.lidar.as_mut().unwrap().field_of_view = std::f64::consts::TAU;
        Self::of(model, stored)
    }

    pub fn of(model: RobotModel, stored: Persisted) -> Self {
        let config = EdgeConfig::new(Id::robot("tiago").unwrap(), model.clone(), Pose2::IDENTITY);
        let mut rig = Self {
            pilot: Pilot::new(config, "boot-1".into(), stored.clone()),
            model,
            now: Stamp::from_secs(100.0),
            pose: Pose2::IDENTITY,
            velocity: Twist2::ZERO,
            wheels: [0.0; 2],
            commanded: [0.0; 2],
            events: Vec::new(),
            charge: 1.0,
            state: None,
            stored,
            inbox: Inbox::default(),
            heartbeat: None,
            scanning: true,
            bump: None,
            markers: Vec::new(),
            counter: 0,
            ticks: 0,
        };
        rig.run(0.2);
        rig
    }

    /// One tick of world and pilot.
    pub fn tick(&mut self) -> Outbox {
        let share = TICK / (self.model.drive.motor_lag + TICK);
        let wanted = self.model.drive.twist(self.commanded);
        self.velocity = Twist2::new(
            self.velocity.v + share * (wanted.v - self.velocity.v),
            self.velocity.w + share * (wanted.w - self.velocity.w),
        );
        self.pose = self.pose.advance(self.velocity, TICK);
        let turned = self.model.drive.wheels(self.velocity);
        self.wheels = [self.wheels[0] + turned[0] * TICK, self.wheels[1] + turned[1] * TICK];
        self.now = self.now.plus_secs(TICK);
        self.ticks += 1;
        if let Some(epoch) = self.heartbeat.filter(|_| self.ticks.is_multiple_of(5)) {
            self.counter += 1;
            self.inbox.heartbeats.push(Heartbeat {
                holder: "m".into(),
                epoch,
                counter: self.counter,
                echo: None,
            });
        }
        let readings = self.readings();
        let out = self.pilot.step(self.now, &readings, std::mem::take(&mut self.inbox));
        self.commanded = out.wheels;
        if let Some(stored) = &out.persist {
            self.stored.clone_from(stored);
        }
        for publication in &out.publications {
            match publication {
                Publication::Event(event) => self.events.push(event.kind.clone()),
                Publication::State(state) => self.state = Some((**state).clone()),
                Publication::Marker(marker) => self.markers.push(marker.clone()),
                _ => {}
            }
        }
        out
    }

    pub fn readings(&self) -> Readings {
        let sweep = (self.scanning && self.ticks.is_multiple_of(5)).then(|| {
            let (name, lidar) = self.model.all_lidars().next().unwrap();
            let room = sweep_in_room(lidar, 0.0, self.pose, (ROOM, ROOM), &[]);
            Sweep {
                lidar: name.to_owned(),
                ..Sweep::new(self.now, room.ranges)
            }
        });
        Readings {
            wheels: self.wheels,
            imu: Some(Imu {
                stamp: self.now,
                yaw_rate: self.velocity.w,
                yaw: Some(self.pose.yaw),
            }),
            sweeps: sweep.into_iter().collect(),
            bump: Bump {
                stamp: self.now,
                pressed: self.bump.is_some(),
                bearing: self.bump.filter(|bearing| bearing.is_finite()),
            },
            battery: Battery {
                stamp: self.now,
                charge: self.charge,
                drawn_j: 0.0,
            },
            ..Readings::new(self.now)
        }
    }

    pub fn run(&mut self, secs: f64) {
        for _ in 0..(secs / TICK).round() as usize {
            self.tick();
        }
    }

    pub fn ask(&mut self, request: EdgeRequest) -> Result<EdgeReply, Refusal> {
        self.inbox.requests.push((Ticket(1), request));
        self.tick().replies.remove(0).1
    }

    pub fn lease(&mut self, holder: &str, role: LeaseRole, request_id: &str) -> Result<u64, Refusal> {
        let request = LeaseRequest::new(holder, role, LeaseAction::Acquire, request_id);
        match self.ask(EdgeRequest::Lease(request))? {
            EdgeReply::Lease(reply) => Ok(reply.epoch),
            other => panic!("{other:?}"),
        }
    }

    /// The mission `m` takes the lease and keeps it alive.
    pub fn mission(&mut self) -> u64 {
        let epoch = self
            .lease("m", LeaseRole::Mission, &format!("take-{}", self.ticks))
            .unwrap();
        self.heartbeat = Some(epoch);
        epoch
    }

    /// A plan straight ahead from where the robot is: a trapezoid of speed, 0.5 m/s at most.
    pub fn ahead(&self, epoch: u64, counter: u64, trajectory_id: u64, length: f64) -> Plan {
        let (top, acceleration) = (0.5, 0.5);
        let ramp = top / acceleration;
        let duration = length / top + ramp;
        let points = (0..=(duration / 0.05).ceil() as usize).map(|i| {
            let t = (i as f64 * 0.05).min(duration);
            let (v, s) = if t < ramp {
                (acceleration * t, 0.5 * acceleration * t * t)
            } else if t < duration - ramp {
                (top, 0.5 * top * ramp + top * (t - ramp))
            } else {
                (
                    acceleration * (duration - t),
                    length - 0.5 * acceleration * (duration - t).powi(2),
                )
            };
            let pose = self.pose * Pose2::new(s, 0.0, 0.0);
            TrajectoryPoint {
                t,
                x: pose.x,
                y: pose.y,
                yaw: pose.yaw,
                v,
                w: 0.0,
            }
        });
        let mut trajectory: Vec<_> = points.collect();
        trajectory.dedup_by(|a, b| a.t - b.t < 1e-6);
        Plan {
            trajectory: trajectory.into(),
            ..self.waypoints(epoch, counter, trajectory_id, &[])
        }
    }

    pub fn waypoints(&self, epoch: u64, counter: u64, trajectory_id: u64, points: &[(f64, f64)]) -> Plan {
        Plan {
            goal_id: "g".into(),
            epoch,
            revision: Revision {
                incarnation: 1,
                counter,
            },
            trajectory_id,
            frame: "map".into(),
            based_on: BasedOn {
                stamp: self.now,
                boot_id: "boot-1".into(),
            },
            valid_for: 5.0,
            waypoints: points.iter().map(|(x, y)| Point2::new(*x, *y)).collect(),
            ..Plan::default()
        }
    }

    pub fn send(&mut self, plan: Plan) {
        self.inbox.plans.push(plan);
        self.tick();
    }

    /// Why the last plan was refused.
    pub fn rejection(&self) -> Option<&str> {
        self.events.iter().rev().find_map(|event| match event {
            EventKind::PlanRejected { reason, .. } => Some(reason.as_str()),
            _ => None,
        })
    }

    pub fn at_rest(&self) -> bool {
        self.velocity.v.abs() < 0.005 && self.velocity.w.abs() < 0.02
    }
}
