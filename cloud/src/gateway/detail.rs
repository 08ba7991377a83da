//! Details. Topics of a robot that are subscribed to only while a browser watches it.
//!
//! Mission, goals, scans, plan and its corridor, markers, moving obstacles, search tree, pose graph and map: each subscription ends with
//! the last watcher. The model is asked for once, the round trip is measured every two seconds.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::task::AbortHandle;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep};
use zenav_gateway::{Hub, Update};
use zenav_protocol::bus::{AskError, Bus, BusError, Shutdown};
use zenav_protocol::messages::{InfoRequest, MapRequest, ModeRequest};
use zenav_protocol::topics::{
    EDGE_INFO, GOAL_STATE, GRAPH, LIDAR_SCAN, MAP, MAP_PATCH, MARKER, MISSION, MODE, MOTION, OBSTACLES, PLAN, SCAN,
    TREE,
};

/// Most queued map patches; when more arrive at once, the whole map is requested.
const PATCHES: usize = 128;
/// Longest wait for the map or the model.
const ASK_WITHIN: Duration = Duration::from_secs(5);
/// Pause between two requests for the map.
const AGAIN: Duration = Duration::from_millis(500);
/// Interval between two round-trip measurements.
const TRIP_EVERY: Duration = Duration::from_secs(2);
/// A slower round trip counts as lost.
const TRIP_WITHIN: Duration = Duration::from_secs(1);

/// Follows all watched robots until shutdown.
pub(super) async fn follow(bus: Bus, hub: Arc<Hub>, shutdown: Shutdown) {
    let mut watched = hub.watched();
    let mut tasks: BTreeMap<String, Vec<AbortHandle>> = BTreeMap::new();
    loop {
        let now = watched.borrow_and_update().clone();
        tasks.retain(|robot, handles| {
            let stays = now.contains(robot);
            if !stays {
                handles.iter().for_each(AbortHandle::abort);
                hub.view().forget_details(robot);
            }
            stays
        });
        for robot in now {
            tasks.entry(robot.clone()).or_insert_with(|| start(&bus, &hub, &robot));
        }
        tokio::select! {
            () = shutdown.wait() => break,
            changed = watched.changed() => if changed.is_err() { break },
        }
    }
    tasks.values().flatten().for_each(AbortHandle::abort);
}

fn start(bus: &Bus, hub: &Arc<Hub>, robot: &str) -> Vec<AbortHandle> {
    let listening = {
        let (bus, hub, robot) = (bus.clone(), Arc::clone(hub), robot.to_owned());
        tokio::spawn(async move {
            if let Err(error) = listen(bus, &hub, &robot).await {
                tracing::warn!(robot, %error, "a watched robot cannot be followed");
            }
        })
    };
    let (bus, hub, robot) = (bus.clone(), Arc::clone(hub), robot.to_owned());
    let asking = tokio::spawn(async move { ask(&bus, &hub, &robot).await });
    vec![listening.abort_handle(), asking.abort_handle()]
}

/// Takes the newest message of each topic, `live_hz` times a second.
async fn listen(bus: Bus, hub: &Hub, robot: &str) -> Result<(), BusError> {
    let chunks = [robot];
    // Patches first: changes made while the whole map is being requested are not missed.
    let mut patches = bus.subscribe(&MAP_PATCH, &chunks, PATCHES)?;
    let mut scans = bus.latest(&SCAN, &chunks)?;
    let mut further_scans = bus.latest(&LIDAR_SCAN, &[robot, "*"])?;
    let mut plans = bus.latest(&PLAN, &chunks)?;
    let mut missions = bus.latest(&MISSION, &chunks)?;
    let mut goals = bus.latest(&GOAL_STATE, &[robot, "*"])?;
    let mut markers = bus.subscribe(&MARKER, &chunks, 16)?;
    let mut obstacles = bus.latest(&OBSTACLES, &chunks)?;
    let mut trees = bus.latest(&TREE, &chunks)?;
    // All of them: which answer the mission drives is known only from its plan.
    let mut motions = bus.subscribe(&MOTION, &chunks, 64)?;
    let mut graphs = bus.latest(&GRAPH, &chunks)?;
    let mut pace = interval(Duration::from_secs_f64(1.0 / hub.settings().live_hz));
    pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        pace.tick().await;
        while let Some(patch) = patches.try_next() {
            hub.take(robot, Update::Patch(patch.message));
        }
        if let Some(scan) = scans.take() {
            hub.take(robot, Update::Scan(String::new(), scan));
        }
        while let Some(scan) = further_scans.take_received() {
            let lidar = scan.chunks.get(1).cloned().unwrap_or_default();
            hub.take(robot, Update::Scan(lidar, scan.message));
        }
        if let Some(plan) = plans.take() {
            hub.take(robot, Update::Plan(plan));
        }
        if let Some(mission) = missions.take() {
            hub.take(robot, Update::Mission(mission));
        }
        while let Some(goal) = goals.take() {
            hub.take(robot, Update::Goal(goal));
        }
        while let Some(marker) = markers.try_next() {
            hub.take(robot, Update::Marker(marker.message));
        }
        if let Some(obstacles) = obstacles.take() {
            hub.take(robot, Update::Obstacles(obstacles));
        }
        if let Some(tree) = trees.take() {
            hub.take(robot, Update::Tree(tree));
        }
        while let Some(record) = motions.try_next() {
            if let Ok(answer) = record.message.answer {
                hub.take(robot, Update::Motion(answer));
            }
        }
        if let Some(graph) = graphs.take() {
            hub.take(robot, Update::Graph(graph));
        }
    }
}

/// Requests the map whenever the view needs all of it, the model once, and measures the round trip.
async fn ask(bus: &Bus, hub: &Hub, robot: &str) {
    let model = async {
        while let Err(AskError::Timeout { .. }) = ask_model(bus, hub, robot).await {
            sleep(AGAIN).await;
        }
    };
    let map = async {
        loop {
            if hub.view().wants_map(robot)
                && let Ok(reply) = bus.ask(&MAP, &[robot], &MapRequest::default(), ASK_WITHIN).await
            {
                hub.take(robot, Update::Map(reply));
            }
            sleep(AGAIN).await;
        }
    };
    let trips = async {
        let mut pace = interval(TRIP_EVERY);
        pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            pace.tick().await;
            let start = Instant::now();
            let answer = bus.ask(&MODE, &[robot], &ModeRequest::default(), TRIP_WITHIN).await;
            let took = answer.is_ok().then(|| start.elapsed().as_secs_f64());
            hub.take(robot, Update::RoundTrip(took));
        }
    };
    tokio::join!(model, map, trips);
}

async fn ask_model(bus: &Bus, hub: &Hub, robot: &str) -> Result<(), AskError> {
    let info = bus.ask(&EDGE_INFO, &[robot], &InfoRequest {}, ASK_WITHIN).await?;
    hub.take(robot, Update::Info(info));
    Ok(())
}
