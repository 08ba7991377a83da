//! How long does each stage from scan to plan take, and one tick of an edge and of a tree? `cargo bench -p zenav-tests --bench pipeline`
//!
//! The cores alone, without a network, in processor time of the thread: what the bus adds is in the bench `bus`, the whole way over Zenoh
//! in the report of `zenav demo`.

#![allow(missing_docs, reason = "criterion's macros")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a bench stops at the first thing that is not as it should be"
)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use nalgebra::Point2;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use zenav_cloud::motion::worker::{Cancel, MotionWorker};
use zenav_edge::{EdgeConfig, Inbox, Persisted, Pilot, Publication};
use zenav_fixtures::{ThreadTime, on_thread_time, robot};
use zenav_mapping::{Mapper, MappingSettings};
use zenav_planning::{Budget, PlanOptions, Planner, Query, Searcher, plan};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::Cell;
use zenav_protocol::id::Id;
use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::messages::{
    BasedOn, DrivingProfile, Heartbeat, LeaseAction, LeaseRequest, LeaseRole, MapRef, MotionReply, MotionRequest, Plan,
    PlanOutcome, PlanRequest, PlanStatistics, Revision, Scan, TrajectoryReply, TrajectoryRequest,
};
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;
use zenav_sim::{RobotSpec, Simulation, World};
use zenav_smoothing::{SmoothQuery, SmoothingSettings, smooth};
use zenav_space::{BitGrid, ConfigurationSpace, PointLineOfSight, UnknownPolicy};

#[path = "../../cloud/behaviour_tree/benches/trees/mod.rs"]
mod trees;

use trees::reactive_tree;

const ROBOT: &str = "tiago";
/// From the upper left of the kitchen to its lower left corner, around the table's side.
const START: Pose2 = Pose2 {
    x: -1.0,
    y: -0.5,
    yaw: 0.0,
};
const GOAL: Pose2 = Pose2 {
    x: 0.9,
    y: -2.9,
    yaw: 0.0,
};

fn model() -> RobotModel {
    robot(ROBOT)
}

/// Scans and readings from all around the kitchen's table, as a robot there has them.
fn recorded() -> (Vec<Scan>, Vec<Readings>) {
    let (mut scans, mut readings) = (Vec::new(), Vec::new());
    for (x, y, yaw) in [
        (-1.0, -0.5, 0.0),
        (-1.3, -2.0, -1.6),
        (-1.2, -3.1, 0.5),
        (0.9, -3.0, 1.6),
        (1.1, -0.6, 2.5),
        (0.0, -0.3, 3.1),
    ] {
        let world = World::shipped("kitchen").unwrap();
        let start = Pose2::new(x, y, yaw);
        let spec = RobotSpec {
            id: Id::robot(ROBOT).unwrap(),
            model: model(),
            start,
        };
        let mut simulation = Simulation::new(&world, vec![spec], 1).unwrap();
        let mut pilot = Pilot::new(
            EdgeConfig::new(Id::robot(ROBOT).unwrap(), model(), start),
            "bench".into(),
            Persisted::default(),
        );
        for _ in 0..60 {
            simulation.step();
            let reading = simulation.readings(0);
            let out = pilot.step(simulation.now(), &reading, Inbox::default());
            scans.extend(
                out.publications
                    .into_iter()
                    .filter_map(|publication| match publication {
                        Publication::Scan(_, scan) => Some(scan),
                        _ => None,
                    }),
            );
            readings.push(reading);
        }
    }
    // One clock for all of them.
    for (number, scan) in scans.iter_mut().enumerate() {
        scan.stamp = Stamp::from_secs(0.1 * (number + 1) as f64);
    }
    assert!(
        scans.len() > 6 && scans.iter().all(|scan| scan.ranges.len() == 667),
        "the bench is about scans of 667 beams"
    );
    (scans, readings)
}

fn mapper() -> Mapper {
    Mapper::new(MappingSettings::default(), "bench").with_footprint(model().footprint)
}

/// The kitchen as mapped from the recorded scans.
fn kitchen(scans: &[Scan]) -> (Mapper, MapReplica) {
    let (mut mapper, mut mirror) = (mapper(), MapReplica::new());
    for scan in scans {
        mapper.insert(scan);
    }
    while let Some(patch) = mapper.take_patch() {
        assert_eq!(mirror.apply(&patch), PatchResult::Applied);
    }
    (mapper, mirror)
}

fn mapping(criterion: &mut Criterion<ThreadTime>) {
    let (scans, _) = recorded();
    let (mapped, _) = kitchen(&scans);
    let last = scans.last().unwrap();
    let next = |number: u64| Scan {
        stamp: last.stamp.plus_secs(0.1 * number as f64),
        ..last.clone()
    };
    criterion.bench_function("map insertion of a scan of 667 beams", |bencher| {
        let mut mapper = mapped.clone();
        let mut number = 0;
        bencher.iter_batched(
            || {
                number += 1;
                next(number)
            },
            |scan| black_box(mapper.insert(&scan)),
            BatchSize::SmallInput,
        );
    });
}

fn search(criterion: &mut Criterion<ThreadTime>) {
    let (scans, _) = recorded();
    let (_, mirror) = kitchen(&scans);
    let space = ConfigurationSpace::new(mirror.grid(), &model().footprint, UnknownPolicy::Free, 0.0);
    let mut searcher = Searcher::new(space.free()).unwrap();
    criterion.bench_function("A* through the kitchen, clearance weighed", |bencher| {
        bencher.iter(|| {
            let planned = plan(
                &space,
                &mut searcher,
                START,
                GOAL,
                &PlanOptions::default(),
                Budget::UNLIMITED,
            );
            assert!(matches!(planned.outcome, PlanOutcome::Found { .. }), "{planned:?}");
        });
    });

    // A tenth of the cells occupied at random, from corner to corner.
    const SIDE: u32 = 1000;
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let (start, goal) = (Cell::new(1, 1), Cell::new(SIDE - 2, SIDE - 2));
    let free = BitGrid::from_fn(SIDE, SIDE, |cell| {
        cell == start || cell == goal || random.random::<f64>() > 0.1
    });
    let mut searcher = Searcher::new(&free).unwrap();
    let sight = PointLineOfSight::new(&free);
    let center = |cell: Cell| Point2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5);
    let query = Query {
        start: center(start),
        goal: center(goal),
        seed: 1,
    };
    let mut group = criterion.benchmark_group("1000 x 1000 cells, corner to corner");
    group.sample_size(20);
    for planner in [Planner::AStar, Planner::Jps] {
        group.bench_function(planner.name(), |bencher| {
            bencher.iter(|| {
                searcher
                    .search(planner, &sight, &query, Budget::UNLIMITED)
                    .result
                    .expect("a way")
            });
        });
    }
    group.finish();
}

fn smoothing(criterion: &mut Criterion<ThreadTime>) {
    let (scans, _) = recorded();
    let (_, mirror) = kitchen(&scans);
    let model = model();
    let space = ConfigurationSpace::new(mirror.grid(), &model.footprint, UnknownPolicy::Free, 0.0);
    let mut searcher = Searcher::new(space.free()).unwrap();
    let PlanOutcome::Found { path, .. } = plan(
        &space,
        &mut searcher,
        START,
        GOAL,
        &PlanOptions::default(),
        Budget::UNLIMITED,
    )
    .outcome
    else {
        panic!("no way");
    };
    let query = SmoothQuery {
        path: &path,
        start: START,
        start_velocity: Twist2::ZERO,
        goal_yaw: None,
        profile: DrivingProfile::Fastest,
    };
    criterion.bench_function("smoothing of a way through the kitchen", |bencher| {
        bencher.iter(|| {
            let smoothed = smooth(&space, &query, &model, &SmoothingSettings::default(), None, &mut || 0.0);
            assert!(smoothed.is_smooth(), "{}", smoothed.statistics.status);
            smoothed
        });
    });
}

/// From a scan in hand to a trajectory in hand: insert, patch, mirror, configuration space, search, smooth.
fn scan_to_plan(criterion: &mut Criterion<ThreadTime>) {
    let (scans, _) = recorded();
    let (mut mapper, mut mirror) = kitchen(&scans);
    let mut worker = MotionWorker::default();
    let model = model();
    let last = scans.last().unwrap();
    let begin = Instant::now();
    let mut number = 0;
    criterion.bench_function("scan to plan: map, space, search, smooth", |bencher| {
        bencher.iter_batched(
            || {
                number += 1;
                // Each one different, so that the map changes and its space is made anew.
                let mut scan = Scan {
                    stamp: last.stamp.plus_secs(0.1 * f64::from(number)),
                    ..last.clone()
                };
                scan.ranges.rotate_left(number as usize % 3);
                scan
            },
            |scan| {
                mapper.insert(&scan);
                while let Some(patch) = mapper.take_patch() {
                    assert_eq!(mirror.apply(&patch), PatchResult::Applied);
                }
                let plan = PlanRequest {
                    robot: ROBOT.into(),
                    model: model.clone(),
                    map: mirror.map().clone(),
                    start: START,
                    via: Vec::new(),
                    goal: GOAL,
                    planner: "astar".into(),
                    cleared: Vec::new(),
                    yield_to: Vec::new(),
                    unknown_is_free: true,
                    escape: 0.0,
                    goal_tolerance: 0.0,
                    budget_ms: 1000,
                    seed: 1,
                };
                let request = MotionRequest::Trajectory(TrajectoryRequest {
                    plan,
                    start_velocity: Twist2::ZERO,
                    goal_yaw: None,
                    profile: DrivingProfile::default(),
                });
                let mut clock = || begin.elapsed().as_secs_f64();
                let reply = worker.answer(Some(&mirror), &request, &mut clock, &Cancel::default());
                let Ok(MotionReply::Trajectory(TrajectoryReply {
                    smooth: Some(reply), ..
                })) = reply
                else {
                    panic!("{reply:?}")
                };
                assert!(!reply.trajectory.is_empty());
                reply
            },
            BatchSize::SmallInput,
        );
    });
}

fn ticks(criterion: &mut Criterion<ThreadTime>) {
    let mut tree = reactive_tree(1000).unwrap();
    let mut now = Duration::ZERO;
    criterion.bench_function("tick of a tree of 1000 nodes", |bencher| {
        bencher.iter(|| {
            now += Duration::from_millis(10);
            tree.tick(now, &mut 0).unwrap()
        });
    });

    let (_, readings) = recorded();
    let mut driven = Driven::new();
    let mut turn = readings.iter().cycle();
    criterion.bench_function("tick of the edge, guard included, on a waypoint", |bencher| {
        bencher.iter_batched(
            || turn.next().unwrap().clone(),
            |reading| driven.tick(reading),
            BatchSize::SmallInput,
        );
    });
}

/// A pilot under a live lease that follows a plan, and so uses every phase of its tick.
struct Driven {
    pilot: Pilot,
    now: Stamp,
    epoch: u64,
    counter: u64,
}

impl Driven {
    fn new() -> Self {
        let mut pilot = Pilot::new(
            EdgeConfig::new(Id::robot(ROBOT).unwrap(), model(), START),
            "bench".into(),
            Persisted::default(),
        );
        let now = Stamp::from_secs(1.0);
        let request = LeaseRequest::new("m", LeaseRole::Mission, LeaseAction::Acquire, "1");
        let world = World::shipped("kitchen").unwrap();
        let spec = RobotSpec {
            id: Id::robot(ROBOT).unwrap(),
            model: model(),
            start: START,
        };
        let simulation = Simulation::new(&world, vec![spec], 1).unwrap();
        let requests = vec![(
            zenav_edge::Ticket(1),
            zenav_protocol::topics::EdgeRequest::Lease(request),
        )];
        let out = pilot.step(
            now,
            &simulation.readings(0),
            Inbox {
                requests,
                ..Inbox::default()
            },
        );
        let Some((_, Ok(zenav_protocol::topics::EdgeReply::Lease(reply)))) = out.replies.first() else {
            panic!("no lease")
        };
        let epoch = reply.epoch;
        Self {
            pilot,
            now,
            epoch,
            counter: 0,
        }
    }

    fn tick(&mut self, mut readings: Readings) -> [f64; 2] {
        self.now = self.now.plus_secs(0.02);
        self.counter += 1;
        readings.stamp = self.now;
        for sweep in &mut readings.sweeps {
            sweep.stamp = self.now;
        }
        let mut inbox = Inbox {
            heartbeats: vec![Heartbeat {
                holder: "m".into(),
                epoch: self.epoch,
                counter: self.counter,
                echo: None,
            }],
            ..Inbox::default()
        };
        // Ten ticks a plan.
        if self.counter % 10 == 1 {
            let pose = self.pilot.map_from_base();
            inbox.plans.push(Plan {
                goal_id: "g".into(),
                epoch: self.epoch,
                revision: Revision {
                    incarnation: 1,
                    counter: self.counter,
                },
                trajectory_id: self.counter,
                map: MapRef::default(),
                frame: "map".into(),
                based_on: BasedOn {
                    stamp: self.now,
                    boot_id: "bench".into(),
                },
                valid_for: 5.0,
                waypoints: vec![Point2::new(pose.x + 0.3, pose.y)],
                trajectory: Default::default(),
                splice: None,
                statistics: PlanStatistics::default(),
            });
        }
        self.pilot.step(self.now, &readings, inbox).wheels
    }
}

criterion_group! {
    name = benches;
    config = on_thread_time();
    targets = mapping, search, smoothing, scan_to_plan, ticks
}
criterion_main!(benches);
