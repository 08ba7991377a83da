//! A fake robot and cloud, with the interfaces that the commands use.

use std::collections::BTreeMap;
use std::time::Duration;

use nalgebra::Point2;
use tokio::task::JoinHandle;
use zenav_protocol::bus::{AliveToken, Bus, BusConfig, Clock, Publisher, Router, RouterConfig};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::{GridSpec, Occupancy};
use zenav_protocol::lease::LeaseArbiter;
use zenav_protocol::messages::{
    CancelRequest, EdgeState, GoalFeedback, GoalPhase, GoalPoint, GoalReply, GoalRequest, GoalState, GoalsReply,
    LeaseReply, Link, MapInfo, MapPatch, MapRef, MapReply, PoseEstimate, Refusal, StopReply, Tile,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

/// A router on a free port, and its endpoint.
pub async fn router() -> (Router, String) {
    let config = RouterConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        ..RouterConfig::default()
    };
    let router = Router::open(&config).await.unwrap();
    let endpoint = router.endpoints().await.remove(0);
    (router, endpoint)
}

/// A fake robot, until it is dropped.
pub struct Fake {
    _alive: Vec<AliveToken>,
    task: JoinHandle<()>,
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// State of the fake.
struct Memory {
    bus: Bus,
    name: String,
    goals: BTreeMap<String, (GoalState, Publisher<GoalState>)>,
    lease: LeaseArbiter,
    clock: Clock,
}

impl Fake {
    /// Its edge and mission have liveliness tokens; mapping answers, but has none.
    pub async fn start(endpoint: &str, name: &str) -> Self {
        let bus = Bus::open(BusConfig::service("fake", endpoint)).await.unwrap();
        let alive = ["edge", "mission"].map(|component| {
            bus.declare_alive(topics::alive_key(topics::ALIVE_COMPONENT, &[name, component]))
                .unwrap()
        });
        let memory = Memory {
            bus: bus.clone(),
            name: name.to_owned(),
            goals: BTreeMap::new(),
            lease: LeaseArbiter::new(Duration::from_secs(1), 0, None),
            clock: Clock::wall(),
        };
        let (ready, began) = tokio::sync::oneshot::channel();
        let task = tokio::spawn(memory.run(ready));
        began.await.unwrap();
        Self {
            _alive: alive.into(),
            task,
        }
    }
}

impl Memory {
    async fn run(mut self, ready: tokio::sync::oneshot::Sender<()>) {
        let (bus, name) = (self.bus.clone(), self.name.clone());
        let chunks = [name.as_str()];
        let states = bus.publisher(&topics::STATE, &chunks).unwrap();
        let poses = bus.publisher(&topics::POSE, &chunks).unwrap();
        let map_infos = bus.publisher(&topics::MAP_INFO, &chunks).unwrap();
        let patches = bus.publisher(&topics::MAP_PATCH, &chunks).unwrap();
        let mut stops = bus.serve(&topics::STOP, &chunks).unwrap();
        let mut leases = bus.serve(&topics::LEASE, &chunks).unwrap();
        let mut goals = bus.serve(&topics::GOAL, &chunks).unwrap();
        let mut lists = bus.serve(&topics::GOALS, &chunks).unwrap();
        let mut cancels = bus.serve(&topics::CANCEL, &chunks).unwrap();
        let mut maps = bus.serve(&topics::MAP, &chunks).unwrap();
        let mut heartbeats = bus.latest(&topics::HEARTBEAT, &chunks).unwrap();
        let map = map();
        map_infos.put(&map.info);
        patches.put(&MapPatch {
            stamp: Stamp(1),
            map: map.info.map.clone(),
            base_revision: 0,
            spec: map.info.spec,
            tiles: vec![Tile {
                x: 0,
                y: 0,
                values: vec![-1, 0, 100],
            }],
        });
        let mut pace = tokio::time::interval(Duration::from_millis(50));
        let _ = ready.send(());
        loop {
            tokio::select! {
                _ = pace.tick() => {
                    let now = self.clock.now();
                    if let Some(beat) = heartbeats.take() {
                        self.lease.renew(now, &beat);
                    }
                    states.put(&self.state(now));
                    poses.put(&PoseEstimate { stamp: now, map_from_base: Pose2::new(0.25, 0.125, 0.0), covariance: [0.0; 9], velocity: Twist2::ZERO, frame: 0 });
                    self.drive();
                }
                Some(request) = stops.next() => request.reply(&StopReply { stopped: true }),
                Some(request) = leases.next() => match self.lease.request(self.clock.now(), &request.body) {
                    Ok(granted) => request.reply(&LeaseReply { epoch: granted.epoch, ttl_secs: 1.0, boot_id: "b".into() , round_trip_secs: None}),
                    Err(refusal) => request.refuse(&refusal),
                },
                Some(request) = goals.next() => match self.accept(&request.body) {
                    Ok(reply) => request.reply(&reply),
                    Err(refusal) => request.refuse(&refusal),
                },
                Some(request) = lists.next() => {
                    let wanted = |goal: &&GoalState| request.body.id.as_ref().is_none_or(|id| *id == goal.id);
                    let goals = self.goals.values().map(|(goal, _)| goal).filter(wanted).cloned().collect();
                    request.reply(&GoalsReply { goals, now: Some(self.clock.now()) });
                }
                Some(request) = cancels.next() => match self.cancel(&request.body) {
                    Ok(reply) => request.reply(&reply),
                    Err(refusal) => request.refuse(&refusal),
                },
                Some(request) = maps.next() => request.reply(&map),
            }
        }
    }

    fn state(&self, now: Stamp) -> EdgeState {
        EdgeState {
            stamp: now,
            boot_id: "b".into(),
            link: Link::Connected,
            lease: self.lease.state(now),
            battery: 1.0,
            uplink: 1.0,
            ..EdgeState::default()
        }
    }

    fn accept(&mut self, request: &GoalRequest) -> Result<GoalReply, Refusal> {
        if request.x.is_some_and(|x| x > 50.0) {
            return Err(Refusal::Rejected {
                reason: "outside the map".into(),
                nearest_free: Some(GoalPoint {
                    x: 2.0,
                    y: 1.0,
                    yaw: None,
                }),
            });
        }
        let id = request.id.clone().expect("the command makes the id");
        let goal = GoalState {
            queue: None,
            id: id.clone(),
            robot: self.name.clone(),
            state: GoalPhase::Accepted,
            reason: None,
            accepted: self.clock.now(),
            started: None,
            ended: None,
            feedback: GoalFeedback::default(),
            legs: Vec::new(),
            request: request.clone(),
            resolved: Vec::new(),
        };
        let (goal, _) = self.goals.entry(id.clone()).or_insert_with(|| {
            (
                goal,
                self.bus.publisher(&topics::GOAL_STATE, &[&self.name, &id]).unwrap(),
            )
        });
        Ok(GoalReply {
            robot: None,
            id,
            state: goal.state,
            reason: goal.reason.clone(),
        })
    }

    fn cancel(&mut self, request: &CancelRequest) -> Result<GoalReply, Refusal> {
        let wanted = |goal: &GoalState| request.id.as_ref().map_or(!goal.state.is_end(), |id| *id == goal.id);
        let (goal, publisher) = self
            .goals
            .values_mut()
            .find(|(goal, _)| wanted(goal))
            .ok_or(Refusal::NotFound {
                what: "such a goal".into(),
            })?;
        (goal.state, goal.reason) = (GoalPhase::Canceled, Some("by hand".into()));
        publisher.put(goal);
        Ok(GoalReply {
            robot: None,
            id: goal.id.clone(),
            state: goal.state,
            reason: goal.reason.clone(),
        })
    }

    /// Moves every goal from accepted to active to the end that its place names.
    fn drive(&mut self) {
        for (goal, publisher) in self.goals.values_mut().filter(|(goal, _)| !goal.state.is_end()) {
            let end = match goal.request.place.as_deref() {
                Some("blocked") => (GoalPhase::Aborted, Some("blocked".to_owned())),
                Some("canceled") => (GoalPhase::Canceled, Some("by another".to_owned())),
                Some("forever") => (GoalPhase::Active, None),
                _ => (GoalPhase::Succeeded, None),
            };
            (goal.state, goal.reason) = if goal.state == GoalPhase::Active {
                end
            } else {
                (GoalPhase::Active, None)
            };
            goal.feedback.step = "drives".into();
            publisher.put(goal);
        }
    }
}

/// Ten columns of free cells below a row of occupied ones.
fn map() -> MapReply {
    let spec = GridSpec {
        origin: Point2::origin(),
        resolution: 0.05,
        width: 10,
        height: 6,
    };
    let values = (0..spec.len())
        .map(|index| {
            if spec.cell(index).y == 5 {
                Occupancy::OCCUPIED
            } else {
                Occupancy::FREE
            }
        })
        .collect();
    let info = MapInfo {
        stamp: Stamp(1),
        map: MapRef {
            id: "m".into(),
            revision: 1,
            frame: 0,
        },
        spec,
        free: 50,
        occupied: 10,
        unknown: 0,
        scans: 1,
        stored: false,
    };
    MapReply {
        info,
        values,
        trajectory: Vec::new(),
        stored: Vec::new(),
    }
}
