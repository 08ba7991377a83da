//! Feed. Passes the newest message of each topic of all robots to the view, decoded at most `live_hz` times a second.

use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval};
use zenav_gateway::{Hub, Update};
use zenav_protocol::bus::{Bus, BusError, Shutdown};
use zenav_protocol::topics::{ALIVE_COMPONENT, ANNOTATIONS, EVENT, LOCALISATION, POSE, STATE, alive_chunks, alive_key};

/// Most queued events.
const EVENTS: usize = 1024;
/// A robot without a live component is dropped after this much silence, s.
const FORGET: f64 = 600.0;
/// Interval of the check for a router.
const LOOK: Duration = Duration::from_secs(1);

/// Feeds the view until shutdown.
pub(super) async fn run(bus: Bus, hub: &Hub, shutdown: &Shutdown) -> Result<(), BusError> {
    let mut states = bus.latest(&STATE, &["*"])?;
    let mut poses = bus.latest(&POSE, &["*"])?;
    let mut annotations = bus.latest(&ANNOTATIONS, &["*"])?;
    let mut localisations = bus.latest(&LOCALISATION, &["*"])?;
    let mut events = bus.subscribe(&EVENT, &["*"], EVENTS)?;
    let mut alive = bus.watch_alive(alive_key(ALIVE_COMPONENT, &["*", "*"]))?;
    let mut pace = interval(Duration::from_secs_f64(1.0 / hub.settings().live_hz));
    pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut look = interval(LOOK);
    let mut connected = false;
    loop {
        tokio::select! {
            () = shutdown.wait() => return Ok(()),
            _ = look.tick() => {
                connected = bus.is_connected().await;
                hub.view().forget_silent(hub.now(), FORGET);
                continue;
            }
            _ = pace.tick() => {}
        }
        while let Some((key, is_up)) = alive.try_next() {
            // `svc` is not a robot.
            if let Some([robot, component]) = alive_chunks(ALIVE_COMPONENT, &key).as_deref()
                && *robot != "svc"
            {
                let component = (*component).to_owned();
                hub.take(
                    robot,
                    Update::Part {
                        component,
                        alive: is_up,
                    },
                );
            }
        }
        while let Some(received) = states.take_received() {
            take(hub, &received.chunks, Update::State(received.message));
        }
        while let Some(received) = poses.take_received() {
            take(hub, &received.chunks, Update::Pose(received.message));
        }
        while let Some(received) = annotations.take_received() {
            take(hub, &received.chunks, Update::Annotations(received.message));
        }
        while let Some(received) = localisations.take_received() {
            take(hub, &received.chunks, Update::Localisation(received.message));
        }
        while let Some(received) = events.try_next() {
            take(hub, &received.chunks, Update::Event(received.message));
        }
        hub.announce(connected);
    }
}

/// Passes on a message of the robot that the key's first chunk names.
fn take(hub: &Hub, chunks: &[String], update: Update) {
    if let Some(robot) = chunks.first() {
        hub.take(robot, update);
    }
}
