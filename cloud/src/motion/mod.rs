//! Motion service. A motion worker on the network: requests in; paths, trajectories and search trees out.
//!
//! | file | answers |
//! |---|---|
//! | [`worker`] | which path can the robot drive, and what is its trajectory? Pure |
//! | `shown` | which results are published for others? |
//! | `host` | how is one request run, away from the async threads and within its budget? |

mod host;
mod shown;
pub mod worker;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::Instant;
use zenav_observability::Histogram;
use zenav_observability::metrics::{MOTION_REQUESTS, PATH_SEARCH, SMOOTHING};
use zenav_protocol::bus::{Bus, BusError, Clock, Latest, Request, Server, Shutdown};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{Annotations, MotionReply, MotionRequest, PlanOutcome, Refusal, TrajectoryRequest};
use zenav_protocol::padding::Extent;
use zenav_protocol::topics::{ALIVE_WORKER, ANNOTATIONS, MOTION_SERVICE, alive_key};
use zenav_space::Zones;

use self::shown::{Shown, Work};
use self::worker::MotionWorker;

pub use self::worker::MotionSettings;
use crate::map_subscriber::MapSubscriber;

/// Name of the service, as in its workers' alive tokens.
pub const SERVICE: &str = "motion";
/// Longest wait for the whole map.
const MAP_DEADLINE: Duration = Duration::from_millis(1500);
/// A request queued for longer than this is refused: its client has given up or asks again, and other requests wait.
const STALE: Duration = Duration::from_secs(2);
/// Most queued requests; further ones are refused.
const MAX_WAITING: usize = 256;
/// Most robots whose zones are kept; zones of further robots are ignored.
const MAX_ROBOTS: usize = 16_384;

/// How far beyond the map its copy must reach for a request; `None` if unknown cells may not be driven through.
#[must_use]
pub fn padding(request: &MotionRequest) -> Option<Extent> {
    match request {
        MotionRequest::Trajectory(TrajectoryRequest { plan, .. }) | MotionRequest::Plan(plan) => {
            let ends = [plan.start, plan.goal];
            let positions = ends.iter().chain(&plan.via).map(|pose| pose.position()).collect();
            plan.unknown_is_free
                .then(|| Extent::of(&plan.model.footprint, positions))
        }
        MotionRequest::Smooth(smooth) => smooth
            .unknown_is_free
            .then(|| Extent::of(&smooth.model.footprint, smooth.path.clone())),
    }
}

/// Answers motion requests under a worker's name until shutdown, or until the bus is closed. `zones` apply to robots whose own zones are
/// not known.
///
/// # Errors
/// [`BusError`] when a key cannot be declared.
pub async fn run(
    bus: Bus,
    clock: Clock,
    name: Id,
    zones: Arc<Zones>,
    settings: MotionSettings,
    shutdown: Shutdown,
) -> Result<(), BusError> {
    let mut maps = MapSubscriber::new(&bus)?;
    let mut all_zones = RobotZones {
        annotations: bus.latest(&ANNOTATIONS, &["*"])?,
        robots: BTreeMap::new(),
        others: zones,
    };
    let mut arrivals = Arrivals::new(bus.serve(&MOTION_SERVICE, &[name.as_str()])?);
    let _alive = bus.declare_alive(alive_key(ALIVE_WORKER, &[SERVICE, name.as_str()]))?;
    let told = serde_json::to_value(&settings).map(|told| (SERVICE.to_owned(), told));
    bus.serve_info(SERVICE, "", told.into_iter().collect())?;
    bus.started();
    let metrics = MotionMetrics::new();
    let mut shown = Shown::new(&bus, clock, name);
    let mut worker = MotionWorker::new(Arc::clone(&all_zones.others), settings.clone());
    loop {
        let request = tokio::select! {
            () = shutdown.wait() => return Ok(()),
            open = maps.follow() => { debug_assert!(!open); return Ok(()) }
            request = arrivals.next() => match request {
                Some(request) => request,
                None => return Ok(()),
            },
        };
        let (robot, wanted) = request.body.map();
        let map = maps.map(robot, wanted, MAP_DEADLINE).await.map(|replica| {
            if let Some(extent) = padding(&request.body) {
                replica.reach(&extent);
            }
            replica.clone()
        });
        let zones = all_zones.of(robot);
        worker.set_zones(Arc::clone(&zones));
        let (asked, used) = (request.body.clone(), map.as_ref().map(|map| map.map().clone()));
        let budgets = [asked.search_budget(), asked.budget()];
        let done = host::within(budgets, &shutdown, move |clock, cancel| {
            let answer = worker.answer(map.as_ref(), &asked, clock, cancel);
            let work = Work {
                map: used,
                zones,
                cut_short: cancel.has_cut_short(&asked),
                request: asked,
                answer,
            };
            (worker, work)
        });
        let done = done.await;
        metrics.answered(done.as_ref().ok().and_then(|(_, work)| work.answer.as_ref().ok()));
        shown.begin();
        match done {
            Ok((back, work)) => {
                worker = back;
                match &work.answer {
                    Ok(answer) => request.reply(answer),
                    Err(refusal) => request.refuse(refusal),
                }
                shown.show(&worker, work);
            }
            Err(refusal) => {
                worker = MotionWorker::new(Arc::clone(&all_zones.others), settings.clone());
                request.refuse(&refusal);
            }
        }
    }
}

/// Outcomes of requests, and durations of their phases.
struct MotionMetrics {
    search: Histogram,
    smoothing: Histogram,
}

impl MotionMetrics {
    fn new() -> Self {
        for outcome in ["found", "no_path", "timed_out", "refused"] {
            // All outcomes show from the start.
            let _ = MOTION_REQUESTS.with_label_values(&[outcome]);
        }
        Self {
            search: PATH_SEARCH.with_label_values::<&str>(&[]),
            smoothing: SMOOTHING.with_label_values::<&str>(&[]),
        }
    }

    /// `None`: the request was refused.
    fn answered(&self, answer: Option<&MotionReply>) {
        let (plan, smooth) = match answer {
            Some(MotionReply::Trajectory(reply)) => (Some(&reply.plan), reply.smooth.as_ref()),
            Some(MotionReply::Plan(plan)) => (Some(plan), None),
            Some(MotionReply::Smooth(smooth)) => (None, Some(smooth)),
            None => (None, None),
        };
        if let Some(plan) = plan {
            self.search.observe(plan.search_ms / 1e3);
        }
        if let Some(smooth) = smooth {
            let took = &smooth.statistics;
            self.smoothing
                .observe((took.corridor_ms + took.geometry_ms + took.timing_ms) / 1e3);
        }
        let outcome = match (answer, plan.map(|plan| &plan.outcome)) {
            (None, _) => "refused",
            // A path that cannot be driven.
            (Some(_), None | Some(PlanOutcome::Found { .. })) if smooth.is_some_and(|it| it.trajectory.is_empty()) => {
                "no_path"
            }
            (Some(_), None | Some(PlanOutcome::Found { .. })) => "found",
            (Some(_), Some(PlanOutcome::TimedOut)) => "timed_out",
            (Some(_), Some(_)) => "no_path",
        };
        MOTION_REQUESTS.with_label_values(&[outcome]).inc();
    }
}

/// Queue of requests in order of arrival; those queued too long are refused.
struct Arrivals {
    waiting: mpsc::Receiver<(Instant, Request<MotionRequest, MotionReply>)>,
    /// Timestamps arrivals as long as this lives.
    _intake: JoinSet<()>,
}

impl Arrivals {
    fn new(mut server: Server<MotionRequest, MotionReply>) -> Self {
        let (sender, waiting) = mpsc::channel(MAX_WAITING);
        let mut intake = JoinSet::new();
        intake.spawn(async move {
            while let Some(request) = server.next().await {
                match sender.try_send((Instant::now(), request)) {
                    Ok(()) => {}
                    Err(mpsc::error::TrySendError::Full((_, request))) => request.refuse(&busy()),
                    Err(mpsc::error::TrySendError::Closed(_)) => return,
                }
            }
        });
        Self {
            waiting,
            _intake: intake,
        }
    }

    /// The next request; `None` after the bus was closed.
    async fn next(&mut self) -> Option<Request<MotionRequest, MotionReply>> {
        loop {
            let (came, request) = self.waiting.recv().await?;
            if came.elapsed() <= STALE {
                return Some(request);
            }
            request.refuse(&busy());
        }
    }
}

fn busy() -> Refusal {
    Refusal::Busy {
        reason: "more motions are asked for than this worker can compute".to_owned(),
    }
}

/// The zones of each robot's map.
struct RobotZones {
    annotations: Latest<Annotations>,
    robots: BTreeMap<String, Arc<Zones>>,
    /// For robots whose annotations have not arrived.
    others: Arc<Zones>,
}

impl RobotZones {
    /// The newest zones of a robot's map.
    fn of(&mut self, robot: &str) -> Arc<Zones> {
        while let Some(received) = self.annotations.take_received() {
            let Some(robot) = received.chunks.into_iter().next() else {
                continue;
            };
            match Zones::new(&received.message.zones) {
                // Keeping an equal value keeps the spaces that were built with it.
                Ok(zones) if self.robots.get(&robot).is_some_and(|known| **known == zones) => {}
                Ok(_) if self.robots.len() >= MAX_ROBOTS && !self.robots.contains_key(&robot) => {
                    tracing::error!(
                        robot,
                        "zones of more than {MAX_ROBOTS} robots: those of its map are not in force"
                    );
                }
                Ok(zones) => {
                    self.robots.insert(robot, Arc::new(zones));
                }
                Err(error) => tracing::error!(robot, %error, "zones are refused; those that were known stay in force"),
            }
        }
        Arc::clone(self.robots.get(robot).unwrap_or(&self.others))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::bus::{AskError, BusConfig};
    use zenav_protocol::geometry::{Pose2, Twist2};
    use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
    use zenav_protocol::messages::{DrivingProfile, MapInfo, MapRef, MapReply, PlanRequest, Refusal, SmoothRequest};
    use zenav_protocol::time::Stamp;
    use zenav_protocol::topics::{MAP, MOTION, TREE};

    use super::*;
    use crate::testing::router;

    const DEADLINE: Duration = Duration::from_secs(20);

    /// A hall of 6 m by 4 m with a wall across it and a door in the wall.
    fn map() -> MapReply {
        let spec = GridSpec {
            origin: Point2::origin(),
            resolution: 0.05,
            width: 120,
            height: 80,
        };
        let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
        for y in (0..80).filter(|y| !(50..75).contains(y)) {
            grid[Cell::new(60, y)] = Occupancy::OCCUPIED;
        }
        let map = MapRef {
            id: "hall".to_owned(),
            revision: 3,
            frame: 0,
        };
        let info = MapInfo {
            stamp: Stamp::ZERO,
            map,
            spec,
            free: 0,
            occupied: 0,
            unknown: 0,
            scans: 0,
            stored: true,
        };
        MapReply {
            info,
            values: grid.values().to_vec(),
            trajectory: Vec::new(),
            stored: Vec::new(),
        }
    }

    /// From one side of the wall to the other.
    fn question() -> PlanRequest {
        let (start, goal) = (Pose2::new(1.0, 1.0, 0.0), Pose2::new(5.0, 1.0, 0.0));
        zenav_fixtures::plan_request("tiago", map().info.map, start, goal)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_worker_answers_every_kind_of_request_and_shows_its_searches() {
        let (_router, endpoint) = router().await;
        let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
        let mapping = open("mapping").await.unwrap();
        let mut maps = mapping.serve(&MAP, &["tiago"]).unwrap();
        tokio::spawn(async move {
            while let Some(request) = maps.next().await {
                request.reply(&map());
            }
        });
        let (shutdown, worker) = (Shutdown::new(), Id::new("w1").unwrap());
        let service = tokio::spawn(run(
            open("motion").await.unwrap(),
            Clock::wall(),
            worker,
            Arc::default(),
            MotionSettings::default(),
            shutdown.clone(),
        ));
        let client = open("client").await.unwrap();
        let question = question();
        let mut trees = client.subscribe(&TREE, &["tiago"], 8).unwrap();
        let mut records = client.subscribe(&MOTION, &["tiago"], 64).unwrap();
        let ask = |request: MotionRequest| {
            let client = &client;
            async move { client.ask(&MOTION_SERVICE, &["*"], &request, DEADLINE).await }
        };
        let plan = |plan: &PlanRequest| ask(MotionRequest::Plan(plan.clone()));
        let Ok(MotionReply::Plan(found)) = plan(&question).await else {
            panic!("no path")
        };
        assert_eq!(found.map, map().info.map);
        let PlanOutcome::Found { path, .. } = found.outcome else {
            panic!("no path")
        };
        // A new publisher's first messages may be lost because it does not know its subscribers yet. Once a later record has arrived, none
        // is missed.
        let shown = tokio::time::timeout(DEADLINE, async {
            let (mut tree, mut first) = (None, None);
            while tree.is_none() || first.is_none() {
                tokio::select! {
                    next = trees.next() => tree = Some(next.unwrap().message),
                    next = records.next() => first = Some(next.unwrap().message.number).filter(|number| *number > 1),
                    again = plan(&question) => { again.unwrap(); }
                }
            }
            (tree.unwrap(), first.unwrap())
        });
        let (tree, first) = shown.await.unwrap();
        assert_eq!(tree.path, path);

        let wanted = SmoothRequest {
            robot: "tiago".to_owned(),
            model: question.model.clone(),
            map: found.map,
            path: path.clone(),
            via: Vec::new(),
            backwards: Vec::new(),
            start: question.start,
            start_velocity: Twist2::ZERO,
            goal_yaw: Some(0.0),
            unknown_is_free: false,
            profile: DrivingProfile::default(),
        };
        let Ok(MotionReply::Smooth(smoothed)) = ask(MotionRequest::Smooth(wanted)).await else {
            panic!("no trajectory")
        };
        assert_eq!(smoothed.statistics.status, "smoothed");
        assert!(smoothed.statistics.min_clearance.unwrap() > 0.05);
        let last = smoothed.trajectory.last().unwrap();
        assert!(last.pose().distance(&question.goal) < 1e-6 && last.v == 0.0);

        let both = TrajectoryRequest {
            plan: question.clone(),
            start_velocity: Twist2::ZERO,
            goal_yaw: Some(0.0),
            profile: DrivingProfile::default(),
        };
        let Ok(MotionReply::Trajectory(both)) = ask(MotionRequest::Trajectory(both)).await else {
            panic!("no path and trajectory")
        };
        assert!(matches!(both.plan.outcome, PlanOutcome::Found { path: again, .. } if again == path));
        assert_eq!(both.smooth.unwrap().trajectory, smoothed.trajectory);

        let strange = PlanRequest {
            planner: "crystal ball".to_owned(),
            ..question.clone()
        };
        let refused = plan(&strange).await;
        assert!(
            matches!(refused, Err(AskError::Refused(Refusal::BadRequest { .. }))),
            "{refused:?}"
        );
        let elsewhere = PlanRequest {
            goal: Pose2::new(50.0, 1.0, 0.0),
            ..question
        };
        assert!(matches!(
            plan(&elsewhere).await,
            Ok(MotionReply::Plan(reply)) if reply.outcome == PlanOutcome::OutOfMap
        ));

        // Subscribers get every request and answer in order, refusals included.
        let mut numbers = vec![first];
        let record = loop {
            let record = tokio::time::timeout(DEADLINE, records.next())
                .await
                .unwrap()
                .unwrap()
                .message;
            numbers.push(record.number);
            if matches!(&record.answer, Err(Refusal::BadRequest { .. })) {
                break record;
            }
        };
        assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "{numbers:?}");
        assert_eq!(record.request, MotionRequest::Plan(strange));
        assert_eq!((record.worker.as_str(), record.map), ("w1", Some(map().info.map)));
        assert!(!record.cut_short);

        shutdown.trigger();
        service.await.unwrap().unwrap();
    }
}
