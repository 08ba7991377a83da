//! A robot for tests: what a mission hears of one that drives along the x axis, and made-up answers of motion workers. No part of the
//! mission runs by itself.

use std::time::Duration;

use nalgebra::Point2;
use zenav_behaviour_tree::{Status, Tree};
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::{GridSpec, Occupancy};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    EdgeState, GoalPoint, InfoReply, LeaseReply, Link, MapFrame, MapPatch, MapRef, Mode, MotionReply, MotionRequest,
    PlanOutcome, PlanProgress, PlanReply, PlanStatistics, PoseEstimate, SmoothReply, SmoothRequest, TILE, Tile,
    TrajectoryReply,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::trajectory::{Trajectory, TrajectoryPoint};

use crate::context::Context;
use crate::io::{Answer, Ask};
use crate::leaves::{parse_path, path};
use crate::route::RouteData;
use crate::trees::build;
use crate::{MissionConfig, Restored};

const SPEC: GridSpec = GridSpec {
    origin: Point2::new(-3.2, -6.4),
    resolution: 0.05,
    width: 6 * TILE,
    height: 4 * TILE,
};
/// Where it drives to.
pub const GOAL: GoalPoint = GoalPoint::at(12.0, 0.0);
/// Its speed, m/s.
const SPEED: f64 = 0.5;

pub struct Rig {
    pub ctx: Context,
    /// Its place on the x axis, m.
    pub x: f64,
    pub speed: f64,
    pub progress: Option<PlanProgress>,
    revision: u64,
    /// Frame of the map.
    frame: u64,
}

impl Rig {
    /// At rest at the origin of a map that is free; the mission holds its lease.
    pub fn new() -> Self {
        let config = MissionConfig::new(Id::robot("tiago").unwrap(), "m", "unused".into());
        let mut ctx = Context::new(config, &Restored::fresh());
        let info = InfoReply {
            schema: SCHEMA_VERSION,
            model: Some(zenav_fixtures::robot("tiago")),
            ..InfoReply::default()
        };
        let lease = LeaseReply {
            epoch: 7,
            ttl_secs: 1.0,
            boot_id: "b".to_owned(),
            round_trip_secs: None,
        };
        for _ in 0..2 {
            ctx.robot.step(Stamp(1), &mut ctx.asks);
            ctx.lease.step(Stamp(1), Some(Stamp(1)), &mut ctx.asks);
            for (ticket, ask) in ctx.asks.take_new() {
                let answer = match ask {
                    Ask::EdgeInfo(_) => Answer::EdgeInfo(Box::new(info.clone())),
                    _ => Answer::Lease(lease.clone()),
                };
                ctx.asks.answer(ticket, Ok(answer));
            }
        }
        ctx.goal.tolerance = 0.25;
        let mut rig = Self {
            ctx,
            x: 0.0,
            speed: 0.0,
            progress: None,
            revision: 0,
            frame: 0,
        };
        rig.at(1.0);
        rig.show(None);
        rig
    }

    /// What the mission hears at this time.
    pub fn at(&mut self, secs: f64) {
        let now = Stamp::from_secs(secs);
        let velocity = Twist2::new(self.speed, 0.0);
        let state = EdgeState {
            stamp: now,
            boot_id: "b".to_owned(),
            mode: Mode::Follow,
            link: Link::Connected,
            plan: self.progress.clone(),
            velocity,
            battery: 1.0,
            frame: self.frame,
            ..EdgeState::default()
        };
        let pose = PoseEstimate {
            stamp: now,
            map_from_base: Pose2::new(self.x, 0.0, 0.0),
            covariance: [0.0; 9],
            velocity,
            frame: self.frame,
        };
        self.ctx.now = now;
        self.ctx.motion.observe(now, Some(&state), &[]);
        self.ctx.robot.observe(now, Some(state), Some(pose));
        self.ctx.settle();
    }

    /// The map from now on: free, but for somebody 0.4 m wide at this place on the x axis, m.
    pub fn show(&mut self, somebody: Option<f64>) {
        let value = |(x, y): (u32, u32)| {
            let place = SPEC.from_cells(Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
            let is_there = somebody.is_some_and(|at| (place.x - at).abs() < 0.2 && place.y.abs() < 0.2);
            if is_there { Occupancy::OCCUPIED } else { Occupancy::FREE }
        };
        let places = (0..SPEC.height / TILE).flat_map(|y| (0..SPEC.width / TILE).map(move |x| (x, y)));
        let tiles = places.map(|(x, y)| Tile {
            x,
            y,
            values: (0..TILE * TILE)
                .map(|at| value((TILE * x + at % TILE, TILE * y + at / TILE)))
                .collect(),
        });
        let patch = MapPatch {
            stamp: self.ctx.now,
            map: MapRef {
                id: "m".to_owned(),
                revision: self.revision + 1,
                frame: self.frame,
            },
            base_revision: self.revision,
            spec: SPEC,
            tiles: tiles.collect(),
        };
        self.revision += 1;
        self.ctx.map.observe(self.ctx.now, None, &[patch]);
    }

    /// A loop closure moves the map as a whole: it begins its next frame.
    pub fn closes(&mut self, moved: Pose2) {
        self.frame += 1;
        let map = MapRef {
            id: "m".to_owned(),
            revision: self.revision,
            frame: self.frame,
        };
        self.ctx.frames.observe(MapFrame {
            map,
            moves: vec![moved],
            ..MapFrame::default()
        });
        self.show(None);
    }

    /// The robot follows the plan in force, which leads along the x axis; it is here, m.
    pub fn follows(&mut self, x: f64) {
        let plan = self.ctx.motion.plan().unwrap();
        (self.x, self.speed) = (x, SPEED);
        self.progress = Some(PlanProgress {
            epoch: plan.epoch,
            revision: plan.revision,
            trajectory_id: plan.trajectory_id,
            time: x / SPEED,
            time_left: (GOAL.x - x) / SPEED,
            valid_for: 5.0,
            ..PlanProgress::default()
        });
    }

    /// The motion workers answer the request that is pending.
    pub fn answer(&mut self, reply: MotionReply) {
        let mut asked = self.ctx.asks.take_new().into_iter();
        let (ticket, _) = asked.find(|(_, ask)| matches!(ask, Ask::Motion(_))).unwrap();
        self.ctx.asks.answer(ticket, Ok(Answer::Motion(Box::new(reply))));
    }

    /// A route from here past these places to the goal, in this time, s.
    pub fn route(&self, past: &[(f64, f64)], secs: f64) -> MotionReply {
        let path = self.path(past);
        let share = secs / path::length(&path);
        let ways = (1..=path.len()).map(|end| path::length(&path[..end]));
        let points = path.iter().zip(ways).map(|(place, way)| TrajectoryPoint {
            t: share * way,
            x: place.x,
            y: place.y,
            ..TrajectoryPoint::default()
        });
        MotionReply::Trajectory(TrajectoryReply {
            smooth: Some(self.smooth(points.collect())),
            plan: self.found(past),
            arrival_secs: None,
        })
    }

    /// There is no path.
    pub fn no_route(&self) -> MotionReply {
        let map = self.ctx.map.newest().unwrap();
        MotionReply::Trajectory(TrajectoryReply {
            plan: PlanReply::without_path(map, PlanOutcome::NoPath),
            smooth: None,
            arrival_secs: None,
        })
    }

    /// A path from here past these places to the goal.
    pub fn found(&self, past: &[(f64, f64)]) -> PlanReply {
        let path = self.path(past);
        PlanReply {
            outcome: PlanOutcome::Found {
                length: path::length(&path),
                path,
            },
            ..PlanReply::without_path(self.ctx.map.newest().unwrap(), PlanOutcome::NoPath)
        }
    }

    pub fn smooth(&self, trajectory: Trajectory) -> SmoothReply {
        SmoothReply {
            map: self.ctx.map.newest().unwrap(),
            trajectory,
            statistics: PlanStatistics::default(),
            corridor: Vec::new(),
        }
    }

    fn path(&self, past: &[(f64, f64)]) -> Vec<Point2<f64>> {
        let places = [(self.x, 0.0)]
            .into_iter()
            .chain(past.iter().copied())
            .chain([(GOAL.x, GOAL.y)]);
        places.map(|(x, y)| Point2::new(x, y)).collect()
    }

    /// Since when the obstacle that it waits for has been there, s.
    pub fn waits_since(&self) -> Option<f64> {
        let blockage = self.ctx.goal.feedback.blockage?;
        Some(blockage.since.as_secs())
    }
}

/// A tree, and the robot that it acts on.
pub struct Drive {
    pub rig: Rig,
    pub tree: Tree<Context>,
}

impl Drive {
    /// A robot at the origin that faces along x, and a tree of these nodes.
    pub fn new(nodes: &str) -> Self {
        let text = format!(r#"<root BTCPP_format="4"><BehaviorTree ID="Main">{nodes}</BehaviorTree></root>"#);
        Self {
            rig: Rig::new(),
            tree: build(&text).unwrap(),
        }
    }

    pub fn tick(&mut self, secs: f64) -> Status {
        self.rig.at(secs);
        let status = self.tree.tick(Duration::from_secs_f64(secs), &mut self.rig.ctx);
        status.unwrap()
    }

    /// Ticks; then a motion worker answers, in the next tick.
    pub fn told(&mut self, secs: f64, reply: impl FnOnce(&Rig) -> MotionReply) -> Status {
        assert_eq!(
            self.tick(secs),
            Status::Running,
            "{secs} s: {:?}",
            self.rig.ctx.goal.failure
        );
        let reply = reply(&self.rig);
        self.rig.answer(reply);
        self.tick(secs + 0.05)
    }

    /// A motion worker is asked to smooth a path, and answers.
    pub fn smooths(&mut self, reply: Trajectory) -> SmoothRequest {
        let asked = self.rig.ctx.asks.take_new().into_iter();
        let mut requests = asked.filter_map(|(ticket, ask)| match ask {
            Ask::Motion(request) => Some((ticket, *request)),
            _ => None,
        });
        let Some((ticket, MotionRequest::Smooth(request))) = requests.next() else {
            panic!("nothing is to be smoothed")
        };
        let reply = MotionReply::Smooth(self.rig.smooth(reply));
        self.rig.ctx.asks.answer(ticket, Ok(Answer::Motion(Box::new(reply))));
        request
    }

    /// A path on the blackboard.
    pub fn path(&self, key: &str) -> RouteData {
        parse_path(self.tree.blackboard().get(key).unwrap()).unwrap()
    }
}

/// Along the x axis from the origin to the goal.
pub fn straight() -> Trajectory {
    let point = |step: u32| TrajectoryPoint {
        t: 0.1 * f64::from(step),
        x: 0.1 * SPEED * f64::from(step),
        v: SPEED,
        ..TrajectoryPoint::default()
    };
    (0..=240).map(point).collect()
}
