//! Three made-up robots that drive in circles and obey a stop. Prints the first frame for a browser; with `--serve` it serves the page
//! until Ctrl-C. `cargo run -p zenav-gateway --example fleet -- --serve`

#![allow(clippy::print_stdout, reason = "an example prints")]

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde_json::json;
use tokio::sync::watch;
use zenav_gateway::{
    Access, Answer, AskFailure, Client, Drive, FleetView, GatewaySettings, Hub, Operator, Update, listen, router, serve,
};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    AnnotateAction, Annotations, CancelRequest, EdgeState, GoalPoint, GoalReply, GoalRequest, GoalsReply, GoalsRequest,
    LocaliseReply, MapReply, MoveGoalRequest, PauseRequest, PoseEstimate, Refusal, ResumeRequest, StopReply,
};

const ROBOTS: [&str; 3] = ["anna", "bert", "carl"];

/// The set of stopped robots: these robots know no other command.
#[derive(Debug, Default)]
struct Stops(Mutex<BTreeSet<String>>);

impl Stops {
    fn set(&self, robot: &str, stopped: bool) -> Answer<StopReply> {
        let mut stops = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if stopped {
            stops.insert(robot.to_owned());
        } else {
            stops.remove(robot);
        }
        Box::pin(std::future::ready(Ok(StopReply { stopped })))
    }

    fn has(&self, robot: &str) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).contains(robot)
    }
}

fn refused<T: Send + 'static>() -> Answer<T> {
    let refusal = Refusal::rejected("a robot that is made up can only be stopped");
    Box::pin(std::future::ready(Err(AskFailure::Refused(refusal))))
}

impl Operator for Stops {
    fn submit(&self, _: &str, _: GoalRequest) -> Answer<GoalReply> {
        refused()
    }
    fn cancel(&self, _: &str, _: CancelRequest) -> Answer<GoalReply> {
        refused()
    }
    fn pause(&self, _: &str, _: PauseRequest) -> Answer<GoalReply> {
        refused()
    }
    fn goals(&self, _: &str, _: GoalsRequest) -> Answer<GoalsReply> {
        Box::pin(std::future::ready(Ok(GoalsReply::default())))
    }
    fn move_goal(&self, _: &str, _: MoveGoalRequest) -> Answer<GoalReply> {
        refused()
    }
    fn annotate(&self, _: &str, _: AnnotateAction) -> Answer<Annotations> {
        refused()
    }
    fn set_pose(&self, _: &str, _: Pose2, _: &str) -> Answer<LocaliseReply> {
        refused()
    }
    fn stop(&self, robot: &str, _: &str) -> Answer<StopReply> {
        self.set(robot, true)
    }
    fn resume(&self, robot: &str, _: ResumeRequest) -> Answer<StopReply> {
        self.set(robot, false)
    }
    fn map(&self, _: &str) -> Answer<MapReply> {
        refused()
    }
    fn drive(&self, _: &str, _: &str) -> Answer<Drive> {
        let (commands, ended) = (
            watch::channel(None).0,
            watch::channel(Some("it cannot be driven".to_owned())).1,
        );
        Box::pin(std::future::ready(Ok(Drive { commands, ended })))
    }
}

/// State and pose of a robot after `secs` of driving.
fn updates(number: usize, secs: f64, stopped: bool) -> Result<[Update; 2], serde_json::Error> {
    let (radius, speed) = (1.0 + number as f64, if stopped { 0.0 } else { 0.4 });
    let angle = 0.4 * secs / radius;
    let pose: PoseEstimate = serde_json::from_value(json!({
        "stamp": (secs * 1e9) as u64, "covariance": [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4],
        "map_from_base": { "x": radius * angle.cos(), "y": radius * angle.sin(), "yaw": (angle + std::f64::consts::FRAC_PI_2).rem_euclid(std::f64::consts::TAU) },
        "velocity": { "v": speed, "w": speed / radius },
    }))?;
    let state: EdgeState = serde_json::from_value(json!({
        "stamp": (secs * 1e9) as u64, "boot_id": "made up", "mode": if stopped { "stopped" } else { "follow" }, "link": "Connected",
        "lease": { "holder": "nobody", "role": "mission", "epoch": 1, "live": true },
        "velocity": { "v": speed, "w": 0.0 }, "guard": "clear", "battery": 0.8,
    }))?;
    Ok([Update::Pose(pose), Update::State(state)])
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    if std::env::args().all(|argument| argument != "--serve") {
        let (mut view, mut client) = (FleetView::new(), Client::new());
        for (number, robot) in ROBOTS.into_iter().enumerate() {
            for update in updates(number, 0.0, false)? {
                view.take(robot, update, 0.0);
            }
        }
        println!("{}", client.frame(&view, 0.0, true).text.unwrap_or_default());
        return Ok(());
    }
    let home = GoalPoint::at(0.0, 0.0);
    let hub = Hub::new(GatewaySettings::default(), BTreeMap::from([("home".to_owned(), home)]));
    let stops = Arc::new(Stops::default());
    let (listener, address) = listen("127.0.0.1:0").await?;
    println!("http://{address}/");
    let app = router(
        Arc::clone(&hub),
        Arc::clone(&stops) as Arc<dyn Operator>,
        Access::new(address, None, Vec::new())?,
    );
    tokio::spawn(serve(listener, app, std::future::pending()));
    let mut driven = [0.0; ROBOTS.len()];
    let mut pace = tokio::time::interval(Duration::from_millis(100));
    loop {
        pace.tick().await;
        for (number, robot) in ROBOTS.into_iter().enumerate() {
            let stopped = stops.has(robot);
            if !stopped {
                driven[number] += 0.1;
            }
            for update in updates(number, driven[number], stopped)? {
                hub.take(robot, update);
            }
        }
        hub.announce(true);
    }
}
