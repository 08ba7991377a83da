//! A publisher, a subscriber and a server that communicate over a router, all in this process.
//!
//! `cargo run -p zenav-protocol --features bus --example bus`

#![allow(clippy::print_stdout, reason = "an example prints")]

use std::error::Error;
use std::time::Duration;

use zenav_protocol::bus::{Bus, BusConfig, Router, RouterConfig};
use zenav_protocol::messages::{Event, EventKind, StopReply, StopRequest};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{EVENT, STOP};

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let router = Router::open(&RouterConfig {
        listen: vec!["tcp/127.0.0.1:0".to_owned()],
        ..RouterConfig::default()
    })
    .await?;
    let endpoint = router.endpoints().await.remove(0);
    println!("router at {endpoint}");
    let robot = Bus::open(BusConfig::service("robot", &endpoint)).await?;
    let cloud = Bus::open(BusConfig::service("cloud", &endpoint)).await?;

    // The robot publishes events before there is a subscriber: a late joiner gets the kept ones.
    let events = robot.publisher(&EVENT, &["tiago"])?;
    for (sequence, kind) in (1..).zip([EventKind::Started, EventKind::Bumped]) {
        events.put(&Event {
            stamp: Stamp::from_secs(sequence as f64),
            boot_id: "first".to_owned(),
            sequence,
            kind,
        });
    }
    let mut received = cloud.subscribe(&EVENT, &["*"], 16)?;
    for _ in 0..2 {
        if let Some(event) = received.next().await {
            let robot = event.chunks.join("/");
            println!("{robot}: event {} {:?}", event.message.sequence, event.message.kind);
        }
    }

    // The cloud stops the robot: an ask repeats until its deadline.
    let mut stops = robot.serve(&STOP, &["tiago"])?;
    let serving = tokio::spawn(async move {
        while let Some(request) = stops.next().await {
            println!("tiago: stopped by {}", request.body.by.as_deref().unwrap_or("somebody"));
            request.reply(&StopReply { stopped: true });
        }
    });
    let request = StopRequest::new("the example");
    let reply = cloud.ask(&STOP, &["tiago"], &request, Duration::from_secs(10)).await?;
    println!("cloud: stopped = {}", reply.stopped);

    robot.close().await;
    cloud.close().await;
    serving.await?;
    router.close().await;
    Ok(())
}
