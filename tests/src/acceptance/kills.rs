//! Kills of the mission. Whether a goal is lost when the mission is killed at any instant: `kill -9` at random instants of drives, with
//! real processes.

use std::path::Path;
use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use tokio::time::{Instant, sleep};

use super::invariants::{Client, Findings, Monitor};
use crate::deployment::{CORRIDOR, Deployment, ROBOT};

/// Simulated seconds a second.
const SPEED: f64 = 4.0;
/// Longest life of a mission, s of wall time. A drive takes about three.
const LONGEST_LIFE: f64 = 2.5;
/// Kills after which a store is no longer tampered with.
const MOST_KILLS: usize = 100;

/// Kills the mission of a robot `kills` times, at instants drawn from the seed, while goals are submitted; then lets it finish.
///
/// # Errors
/// When the parts cannot be started or joined.
pub async fn run(binary: &str, kills: usize, seed: u64) -> Result<Findings, String> {
    run_tampered(binary, kills, seed, |_, _| true).await
}

/// Like [`run`], but after every kill until it returns true `tamper` may change the mission's store; it gets the store's file and the
/// acknowledged goals. This is the negative control of the invariants.
///
/// # Errors
/// When the parts cannot be started or joined, or the store could not be tampered with.
pub async fn run_tampered(
    binary: &str,
    kills: usize,
    seed: u64,
    mut tamper: impl FnMut(&Path, &[String]) -> bool,
) -> Result<Findings, String> {
    let deployment = Deployment::new(binary, CORRIDOR, SPEED);
    let store = deployment.folder().join("cloud").join(ROBOT).join("mission.redb");
    let _router = deployment.start_router();
    let _edge = deployment.start_edge();
    let _others = ["mapping", "motion"].map(|service| deployment.start_service(service));
    let bus = deployment.bus().await;
    let mut monitor = Monitor::new(&bus).map_err(|error| error.to_string())?;
    let mut client = Client::default();
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut mission = deployment.start_service("mission");
    let (mut killed, mut tampered) = (0, false);
    while killed < kills || !tampered {
        if killed > kills + MOST_KILLS {
            return Err("the store could not be tampered with".to_owned());
        }
        let end = Instant::now() + Duration::from_secs_f64(random.random_range(0.0..LONGEST_LIFE));
        while Instant::now() < end {
            monitor.listen();
            client.keep_going(&bus, &monitor.invariants, &mut random).await?;
            sleep(Duration::from_millis(20)).await;
        }
        mission.kill();
        killed += 1;
        tampered = tampered || tamper(&store, &client.acknowledged);
        mission = deployment.start_service("mission");
    }
    monitor.invariants.findings.kills = killed;
    client.rest().await?;
    let findings = monitor.finish(&bus, &client.acknowledged).await?;
    bus.close().await;
    Ok(findings)
}
