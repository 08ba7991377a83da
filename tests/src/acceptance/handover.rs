//! Handover. Whether a standby takes over when the leader dies or freezes. Two missions run as real processes, each with its own store; the
//! leader is killed (`kill -9`) and restarted, or paused (`SIGSTOP`) and resumed, at random instants of drives.

use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use tokio::time::{Instant, sleep};
use zenav_protocol::bus::{Bus, Latest, Subscription};
use zenav_protocol::messages::{MissionStatus, Plan};
use zenav_protocol::topics;

use super::invariants::{Client, Findings, Monitor};
use crate::deployment::{CORRIDOR, Deployment, ROBOT};
use crate::process::Process;

/// Simulated seconds per second: leases live as long as on a real robot.
const SPEED: f64 = 1.0;
/// Longest time from both missions being ready until a fault, s.
const LONGEST_QUIET: f64 = 5.0;
/// Time limit until another mission leads, s, wall time.
pub const TAKEOVER: f64 = 2.0;
/// Time limit until a leader whose standby is paused publishes that it has none, wall time.
const ALONE: Duration = Duration::from_secs(3);
/// Time limit until two missions are ready (one leads, the other has caught up), wall time.
const READY: Duration = Duration::from_secs(30);
/// Time for which a resumed leader is watched before the next fault.
const AFTERMATH: Duration = Duration::from_secs(3);

/// A fault that is injected into a pair of missions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// The leader is killed, and restarted once the other leads.
    LeaderKilled,
    /// The leader is paused for a time, s of wall time.
    LeaderPaused(f64),
    /// The standby is paused for a time, s of wall time.
    StandbyPaused(f64),
}

/// Two missions, by their holders' names.
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
            .ok_or_else(|| format!("{holder} leads, which this run did not start"))
    }

    /// The standby.
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

/// Observations of the pair, and the client that keeps it busy.
struct Observed {
    bus: Bus,
    monitor: Monitor,
    client: Client,
    random: Pcg64Mcg,
    status: Latest<MissionStatus>,
    plans: Subscription<Plan>,
}

impl Observed {
    async fn step(&mut self) -> Result<(), String> {
        self.monitor.listen();
        self.client
            .keep_going(&self.bus, &self.monitor.invariants, &mut self.random)
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

    /// The first status for which `fits` holds; `None` if none comes within `limit`.
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

    /// Checks that no plan is published under an old epoch.
    fn no_plan_before(&mut self, epoch: u64) {
        while let Some(plan) = self.plans.try_next() {
            if plan.message.epoch < epoch {
                let violation = format!("a plan of epoch {} was written in epoch {epoch}", plan.message.epoch);
                self.monitor.invariants.findings.violations.push(violation);
            }
        }
    }
}

/// Injects faults into two missions, one after the other, while goals are submitted; then lets them finish.
///
/// # Errors
/// When the parts cannot be started or joined.
pub async fn run(binary: &str, faults: &[Fault], seed: u64) -> Result<Findings, String> {
    let deployment = Deployment::new(binary, CORRIDOR, SPEED);
    let _router = deployment.start_router();
    let _edge = deployment.start_edge();
    let _others = ["mapping", "motion"].map(|service| deployment.start_service(service));
    let mut pair = Pair::start(&deployment);
    let bus = deployment.bus().await;
    let failed = |error: zenav_protocol::bus::BusError| error.to_string();
    let mut observed = Observed {
        monitor: Monitor::new(&bus).map_err(failed)?,
        client: Client::default(),
        random: Pcg64Mcg::seed_from_u64(seed),
        status: bus.latest(&topics::MISSION, &[ROBOT]).map_err(failed)?,
        plans: bus.subscribe(&topics::PLAN, &[ROBOT], 65536).map_err(failed)?,
        bus: bus.clone(),
    };
    for fault in faults {
        let quiet = observed.random.random_range(0.0..LONGEST_QUIET);
        observed.run_for(Duration::from_secs_f64(quiet)).await?;
        // On a busy machine a standby may be dropped, and joins again: without one nobody takes over.
        let ready = |status: &MissionStatus| status.leads && !status.standbys.is_empty();
        let Some(leader) = observed.until(READY, ready).await? else {
            return Err(format!("before {fault:?}: no leader with a standby within {READY:?}"));
        };
        if let Fault::StandbyPaused(secs) = fault {
            let Some(standby) = pair.other(&leader.holder) else {
                continue;
            };
            standby.pause()?;
            let alone = |status: &MissionStatus| status.leads && status.standbys.is_empty();
            if observed
                .until(ALONE, alone)
                .await?
                .is_none_or(|status| status.holder != leader.holder)
            {
                let violation = format!("{} does not go on alone within {ALONE:?}", leader.holder);
                observed.monitor.invariants.findings.violations.push(violation);
            }
            observed.run_for(Duration::from_secs_f64(*secs)).await?;
            standby.resume()?;
            observed.monitor.invariants.findings.pauses += 1;
            continue;
        }
        let leading = pair.named(&leader.holder)?;
        match fault {
            Fault::LeaderKilled => leading.kill(),
            Fault::LeaderPaused(_) | Fault::StandbyPaused(_) => leading.pause()?,
        }
        let since = Instant::now();
        let next = |status: &MissionStatus| status.leads && status.holder != leader.holder;
        let Some(successor) = observed.until(READY, next).await? else {
            return Err(format!(
                "{fault:?} of {}: the other does not lead within {READY:?}",
                leader.holder
            ));
        };
        let took = since.elapsed().as_secs_f64();
        observed.monitor.invariants.findings.takeovers.push(took);
        if took > TAKEOVER {
            let violation = format!(
                "{} took over from {} after {took:.2} s",
                successor.holder, leader.holder
            );
            observed.monitor.invariants.findings.violations.push(violation);
        }
        match fault {
            Fault::LeaderKilled => {
                observed.monitor.invariants.findings.kills += 1;
                pair.restart(&leader.holder);
            }
            Fault::LeaderPaused(secs) | Fault::StandbyPaused(secs) => {
                observed.monitor.invariants.findings.pauses += 1;
                let rest = Duration::from_secs_f64(*secs).saturating_sub(since.elapsed());
                observed.run_for(rest).await?;
                while observed.plans.try_next().is_some() {}
                pair.named(&leader.holder)?.resume()?;
                observed.run_for(AFTERMATH).await?;
                observed.no_plan_before(successor.epoch);
            }
        }
    }
    observed.client.rest().await?;
    let findings = observed.monitor.finish(&bus, &observed.client.acknowledged).await?;
    for (name, process) in &mut pair.missions {
        if !process.is_running() {
            return Err(format!("{name} has ended: {}", process.log()));
        }
    }
    bus.close().await;
    Ok(findings)
}
