//! Is any goal lost when the orchestrator is killed, whenever that is? `kill -9` at random instants of missions, with real processes.

use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use tokio::time::{Instant, sleep};

use super::invariants::{Client, Findings, Invariants};
use crate::deployment::{CORRIDOR, Deployment};

/// Simulated seconds a second.
const SPEED: f64 = 4.0;
/// Longest life of an orchestrator, s of wall time. A drive takes about three.
const LONGEST_LIFE: f64 = 2.5;

/// Kills the orchestrator of a robot so many times, at instants drawn from the seed, while goals come in; then lets it finish.
///
/// # Errors
/// When the parts cannot be started or joined.
pub async fn run(binary: &str, kills: usize, seed: u64) -> Result<Findings, String> {
    let deployment = Deployment::new(binary, CORRIDOR, SPEED);
    let _router = deployment.start_router();
    let _edge = deployment.start_edge();
    let _others = [
        deployment.start_service("mapping"),
        deployment.start_service("planning"),
    ];
    let bus = deployment.bus().await;
    let mut witness = Invariants::new(&bus)?;
    let mut client = Client::default();
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut mission = deployment.start_service("mission");
    while witness.findings.kills < kills {
        let end = Instant::now() + Duration::from_secs_f64(random.random_range(0.0..LONGEST_LIFE));
        while Instant::now() < end {
            witness.listen();
            client.keep_going(&bus, &witness, &mut random).await?;
            sleep(Duration::from_millis(20)).await;
        }
        mission.kill();
        witness.findings.kills += 1;
        mission = deployment.start_service("mission");
    }
    client.rest().await?;
    let findings = witness.finish(&bus, &client.acknowledged).await?;
    bus.close().await;
    Ok(findings)
}
