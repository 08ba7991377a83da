//! Does another orchestrator go on when the leader dies or freezes? Two of them with real processes, each with a store of its own; the leader is
//! killed (`kill -9`) and started again, or held (`SIGSTOP`) and let go on, at random instants of missions.

use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use tokio::time::{Instant, sleep};
use zenav_protocol::bus::{Bus, Latest, Subscription};
use zenav_protocol::messages::*;
use zenav_protocol::topics;

use super::invariants::{Client, Findings, Invariants};
use crate::deployment::{CORRIDOR, Deployment, ROBOT};
use crate::process::Process;

/// Simulated seconds a second: the life of a lease is as long as on a real robot.
const SPEED: f64 = 1.0;
/// Longest time from both being ready until the leader is struck, s.
const LONGEST_PEACE: f64 = 5.0;
/// Wall time in which another mission leads, s.
pub const TAKEOVER: f64 = 2.0;
/// Wall time in which a leader whose standby is held says that it works alone.
const ALONE: Duration = Duration::from_secs(3);
/// Wall time for two missions to be ready: one leads, the other has caught up.
const READY: Duration = Duration::from_secs(30);
/// For how long a leader that goes on is watched before the next blow.
const AFTERMATH: Duration = Duration::from_secs(3);

/// What becomes of a leader.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Killed, and started again once another leads.
    Death,
    /// LeaseSession for so many seconds of wall time.
    Pause(f64),
    /// Not it but its standby is held for so many seconds.
    Alone(f64),
}

/// Two orchestrators, by their holders' names.
struct Pair<'d> {
    deployment: &'d Deployment,
    missions: Vec<(&'static str, Process)>,
}

impl<'d> Pair<'d> {
    fn start(deployment: &'d Deployment) -> Self {
        let missions = ["anna", "bert"].map(|name| (name, deployment.start_mission(name)));
        Self {
            deployment,
            missions: missions.into(),
        }
    }

    fn named(&mut self, holder: &str) -> Result<&mut Process, String> {
        let found = self.missions.iter_mut().find(|(name, _)| *name == holder);
        found
            .map(|(_, process)| process)
            .ok_or_else(|| format!("{holder} leads, whom nobody started"))
    }

    /// The one that does not lead.
    fn other(&mut self, holder: &str) -> Option<&mut Process> {
        let found = self.missions.iter_mut().find(|(name, _)| *name != holder);
        found.map(|(_, process)| process)
    }

    fn restart(&mut self, holder: &str) {
        for (name, process) in &mut self.missions {
            if *name == holder {
                *process = self.deployment.start_mission(name);
            }
        }
    }
}

/// What is seen of who leads.
struct Scene {
    bus: Bus,
    witness: Invariants,
    client: Client,
    random: Pcg64Mcg,
    status: Latest<MissionStatus>,
    plans: Subscription<Plan>,
}

impl Scene {
    async fn step(&mut self) -> Result<(), String> {
        self.witness.listen();
        self.client
            .keep_going(&self.bus, &self.witness, &mut self.random)
            .await?;
        sleep(Duration::from_millis(10)).await;
        Ok(())
    }

    async fn run_for(&mut self, time: Duration) -> Result<(), String> {
        let end = Instant::now() + time;
        while Instant::now() < end {
            self.step().await?;
        }
        Ok(())
    }

    /// The first status of which `fits` holds; `None` when none comes within `limit`.
    async fn until(
        &mut self,
        limit: Duration,
        fits: impl Fn(&MissionStatus) -> bool,
    ) -> Result<Option<MissionStatus>, String> {
        let end = Instant::now() + limit;
        while Instant::now() < end {
            if let Some(status) = self.status.take().filter(|status| fits(status)) {
                return Ok(Some(status));
            }
            self.step().await?;
        }
        Ok(None)
    }

    /// That nothing was written under an epoch that is over.
    fn no_plan_before(&mut self, epoch: u64) {
        while let Some(plan) = self.plans.try_next() {
            if plan.message.epoch < epoch {
                let fault = format!("a plan of epoch {} was written in epoch {epoch}", plan.message.epoch);
                self.witness.findings.faults.push(fault);
            }
        }
    }
}

/// Strikes the leader of two orchestrators again and again while goals come in; then lets them finish.
///
/// # Errors
/// When the parts cannot be started or joined.
pub async fn run(binary: &str, blows: &[Fault], seed: u64) -> Result<Findings, String> {
    let deployment = Deployment::new(binary, CORRIDOR, SPEED);
    let _router = deployment.start_router();
    let _edge = deployment.start_edge();
    let _others = [
        deployment.start_service("mapping"),
        deployment.start_service("planning"),
    ];
    let mut pair = Pair::start(&deployment);
    let bus = deployment.bus().await;
    let failed = |error: zenav_protocol::bus::BusError| error.to_string();
    let mut scene = Scene {
        witness: Invariants::new(&bus)?,
        client: Client::default(),
        random: Pcg64Mcg::seed_from_u64(seed),
        status: bus.latest(&topics::MISSION, &[ROBOT]).map_err(failed)?,
        plans: bus.subscribe(&topics::PLAN, &[ROBOT], 65536).map_err(failed)?,
        bus: bus.clone(),
    };
    for blow in blows {
        let ready = |status: &MissionStatus| status.leads && !status.standbys.is_empty();
        let Some(leader) = scene.until(READY, ready).await? else {
            return Err(format!("before {blow:?}: no leader with a standby within {READY:?}"));
        };
        let peace = scene.random.random_range(0.0..LONGEST_PEACE);
        scene.run_for(Duration::from_secs_f64(peace)).await?;
        if let Fault::Alone(secs) = blow {
            let Some(standby) = pair.other(&leader.holder) else {
                continue;
            };
            standby.pause()?;
            let alone = |status: &MissionStatus| status.leads && status.standbys.is_empty();
            if scene
                .until(ALONE, alone)
                .await?
                .is_none_or(|status| status.holder != leader.holder)
            {
                let fault = format!("{} does not go on alone within {ALONE:?}", leader.holder);
                scene.witness.findings.faults.push(fault);
            }
            scene.run_for(Duration::from_secs_f64(*secs)).await?;
            standby.resume()?;
            scene.witness.findings.pauses += 1;
            continue;
        }
        let struck = pair.named(&leader.holder)?;
        match blow {
            Fault::Death => struck.kill(),
            Fault::Pause(_) | Fault::Alone(_) => struck.pause()?,
        }
        let since = Instant::now();
        let next = |status: &MissionStatus| status.leads && status.holder != leader.holder;
        let Some(heir) = scene.until(READY, next).await? else {
            return Err(format!(
                "{blow:?} of {}: nobody else leads within {READY:?}",
                leader.holder
            ));
        };
        let took = since.elapsed().as_secs_f64();
        scene.witness.findings.takeovers.push(took);
        if took > TAKEOVER {
            let fault = format!("{} took over from {} after {took:.2} s", heir.holder, leader.holder);
            scene.witness.findings.faults.push(fault);
        }
        match blow {
            Fault::Death => {
                scene.witness.findings.kills += 1;
                pair.restart(&leader.holder);
            }
            Fault::Pause(secs) | Fault::Alone(secs) => {
                scene.witness.findings.pauses += 1;
                let rest = Duration::from_secs_f64(*secs).saturating_sub(since.elapsed());
                scene.run_for(rest).await?;
                while scene.plans.try_next().is_some() {}
                pair.named(&leader.holder)?.resume()?;
                scene.run_for(AFTERMATH).await?;
                scene.no_plan_before(heir.epoch);
            }
        }
    }
    scene.client.rest().await?;
    let findings = scene.witness.finish(&bus, &scene.client.acknowledged).await?;
    for (name, process) in &mut pair.missions {
        if !process.is_running() {
            return Err(format!("{name} has ended: {}", process.log()));
        }
    }
    bus.close().await;
    Ok(findings)
}
