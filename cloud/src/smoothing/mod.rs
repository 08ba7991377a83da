//! How does a smoothing worker live on the network? Ways in, trajectories out. Thin: [`SmoothWorker`] answers, [`host`] carries.

pub mod worker;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use zenav_protocol::bus::{Bus, BusError, Shutdown};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{MapRef, Refusal, SmoothReply, SmoothRequest};
use zenav_protocol::topics::{Ask, SMOOTH_SERVICE};

use self::worker::SmoothWorker;
use crate::worker_host::{Work, host};
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::padding::Extent;
use zenav_space::Zones;

/// Nobody waits longer for a trajectory: the unsmoothed way is driven then.
const BUDGET: Duration = Duration::from_secs(3);

impl Work for SmoothWorker {
    type Question = SmoothRequest;
    type Answer = SmoothReply;
    const ASK: Ask<SmoothRequest, SmoothReply> = SMOOTH_SERVICE;
    const SERVICE: &'static str = "smooth";

    fn map_of(question: &SmoothRequest) -> (&str, &MapRef) {
        (&question.robot, &question.map)
    }

    fn outlook(question: &SmoothRequest) -> Option<Extent> {
        question
            .unknown_is_free
            .then(|| Extent::of(&question.model.footprint, question.path.clone()))
    }

    fn budget(_question: &SmoothRequest) -> Duration {
        BUDGET
    }

    fn answer(
        &mut self,
        map: Option<&MapReplica>,
        question: &SmoothRequest,
        clock: &mut dyn FnMut() -> f64,
        _cancel: &AtomicBool,
    ) -> Result<SmoothReply, Refusal> {
        // The solver's iterations are bounded by themselves.
        Self::answer(self, map, question, clock)
    }
}

/// Answers smoothing requests, on maps with these zones, under a worker's name until shutdown, or until the bus is closed.
///
/// # Errors
/// [`BusError`] when a key cannot be declared.
pub async fn run(bus: Bus, worker: Id, zones: Arc<Zones>, shutdown: Shutdown) -> Result<(), BusError> {
    let begun = || SmoothWorker::new(Arc::clone(&zones));
    host(bus, worker, shutdown, begun, |_: &SmoothWorker, _, _| {}).await
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::bus::{AskError, BusConfig, Clock, Router, RouterConfig};
    use zenav_protocol::geometry::{Pose2, Twist2};
    use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
    use zenav_protocol::messages::{
        DrivingProfile, MapInfo, MapRef, MapReply, PlanOutcome, PlanRequest, SmoothRequest,
    };
    use zenav_protocol::time::Stamp;
    use zenav_protocol::topics::{MAP, PLAN_SERVICE, TREE};

    use super::*;
    use crate::planning;

    const DEADLINE: Duration = Duration::from_secs(20);

    /// A hall of 6 m by 4 m with a wall across that leaves a door.
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
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn what_one_worker_finds_another_one_smooths() {
        let router = Router::open(&RouterConfig {
            listen: vec!["tcp/127.0.0.1:0".into()],
            ..RouterConfig::default()
        })
        .await
        .unwrap();
        let endpoint = router.endpoints().await.remove(0);
        let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
        let mapping = open("mapping").await.unwrap();
        let mut maps = mapping.serve(&MAP, &["tiago"]).unwrap();
        tokio::spawn(async move {
            while let Some(request) = maps.next().await {
                request.reply(&map());
            }
        });
        let (shutdown, worker) = (Shutdown::new(), Id::new("w1").unwrap());
        let services = [
            tokio::spawn(planning::run(
                open("planning").await.unwrap(),
                Clock::wall(),
                worker.clone(),
                Arc::default(),
                Default::default(),
                shutdown.clone(),
            )),
            tokio::spawn(run(
                open("smoothing").await.unwrap(),
                worker,
                Arc::default(),
                shutdown.clone(),
            )),
        ];
        let client = open("client").await.unwrap();
        let model = zenav_fixtures::robot("tiago");
        let question = PlanRequest {
            robot: "tiago".to_owned(),
            model: model.clone(),
            map: map().info.map,
            start: Pose2::new(1.0, 1.0, 0.0),
            goal: Pose2::new(5.0, 1.0, 0.0),
            planner: "astar".to_owned(),
            unknown_is_free: false,
            budget_ms: 5000,
            seed: 1,
        };
        let mut trees = client.subscribe(&TREE, &["tiago"], 8).unwrap();
        let found = client.ask(&PLAN_SERVICE, &["*"], &question, DEADLINE).await.unwrap();
        assert_eq!(found.map, map().info.map);
        let PlanOutcome::Found { path, .. } = found.outcome else {
            panic!("no way")
        };
        // What is shown first may come before anybody listens; whoever listens sees the next one.
        let shown = tokio::time::timeout(DEADLINE, async {
            loop {
                tokio::select! {
                    tree = trees.next() => return tree.unwrap().message,
                    again = client.ask(&PLAN_SERVICE, &["w1"], &question, DEADLINE) => { again.unwrap(); }
                }
            }
        });
        assert_eq!(shown.await.unwrap().path, path);

        let way = SmoothRequest {
            robot: "tiago".to_owned(),
            model,
            map: found.map,
            path,
            start: question.start,
            start_velocity: Twist2::ZERO,
            goal_yaw: Some(0.0),
            unknown_is_free: false,
            profile: DrivingProfile::default(),
        };
        let smoothed = client.ask(&SMOOTH_SERVICE, &["w1"], &way, DEADLINE).await.unwrap();
        assert_eq!(smoothed.statistics.status, "smoothed");
        assert!(smoothed.statistics.min_clearance.unwrap() > 0.05);
        let last = smoothed.trajectory.last().unwrap();
        assert!(last.pose().distance(&question.goal) < 1e-6 && last.v == 0.0);

        let strange = PlanRequest {
            planner: "crystal ball".to_owned(),
            ..question.clone()
        };
        let refused = client.ask(&PLAN_SERVICE, &["w1"], &strange, DEADLINE).await;
        assert!(
            matches!(refused, Err(AskError::Refused(Refusal::BadRequest { .. }))),
            "{refused:?}"
        );
        let elsewhere = PlanRequest {
            goal: Pose2::new(50.0, 1.0, 0.0),
            ..question
        };
        assert_eq!(
            client
                .ask(&PLAN_SERVICE, &["w1"], &elsewhere, DEADLINE)
                .await
                .unwrap()
                .outcome,
            PlanOutcome::OutOfMap
        );

        shutdown.trigger();
        for service in services {
            service.await.unwrap().unwrap();
        }
    }
}
