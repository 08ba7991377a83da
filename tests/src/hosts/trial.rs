//! Trials. Missions of three robots while parts of a deployment are killed, frozen, cut off and replaced. No goal may be lost, nothing
//! touched, no robot may move without a valid horizon, nor rest longer than a plan's horizon if another part can take over.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::task::block_in_place;
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{GoalPhase, GoalRequest, GoalsRequest, LostPolicy, Refusal};
use zenav_protocol::topics::{self, Ask};

use super::Site;
use super::queues::waiting;
use super::truth::Truth;
use crate::acceptance::faults::Watch;
use crate::usage::{Held, held};

/// Each robot with the y of its lane, m.
const LANES: [(&str, f64); 3] = [("anna", 3.0), ("bert", 0.0), ("carl", -3.0)];
/// The ends of a lane, m.
const ENDS: [f64; 2] = [0.0, 10.5];
/// The first goal of each robot, near its start, m.
const FIRST: f64 = 3.0;
/// Validity of a plan without a slow link, s: for this long a robot drives on without its cloud.
pub const HORIZON: f64 = 5.0;
/// Longest wait for any event, wall time: ample even on a busy machine.
const LONG: Duration = Duration::from_secs(90);
/// Wall time to wait for an answer before the request is repeated.
const ANSWERED: Duration = Duration::from_secs(2);
/// Missions of a robot: one on each host of the cloud.
const MISSIONS: usize = 2;
/// Unfinished goals of a robot at a time.
const OUTSTANDING: usize = 3;
/// Goals that each robot must reach in a minute of faults, beside those that it is given at once: one takes some 20 s without faults.
const LEAST_GOALS: f64 = 0.5;
/// A robot that has rested for less than this is driving, s.
const DRIVES: f64 = 0.5;
/// Time between two looks at the robots' states, and without a state after which some were lost, wall time: a robot sends ten a second.
const LOOKS: Duration = Duration::from_millis(100);
const LOST: Duration = Duration::from_secs(1);
/// Time for which hosts of the cloud are cut off, s: both mapping services lead by then.
const APART: u32 = 15;

/// A fault of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Killed, and started again once the robots drive.
    Kill(&'static str),
    /// Frozen for a number of seconds.
    Pause(&'static str, u32),
    /// Its host is cut off until its robot rests, then reconnected.
    Cut(&'static str, &'static str),
    /// Its host, one of the cloud, is cut off from the other one and from the robots for a number of seconds.
    CutCloud(&'static str, u32),
    /// The two routers are cut off from one another for a number of seconds.
    Split(u32),
    /// Replaced by a new one.
    Update(&'static str),
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kill(part) => write!(f, "{part} killed, for {} s", HORIZON + 1.0),
            Self::Pause(part, secs) => write!(f, "{part} frozen for {secs} s"),
            Self::Cut(part, robot) => write!(f, "{part} cut off until {robot} rests"),
            Self::CutCloud(part, secs) => write!(
                f,
                "{part} and all parts on its host cut off for {secs} s; rest from then on"
            ),
            Self::Split(secs) => write!(
                f,
                "the routers cut off from one another for {secs} s; rest from then on"
            ),
            Self::Update(part) => write!(f, "{part} replaced"),
        }
    }
}

/// The effect of a fault.
#[derive(Clone, Debug)]
pub struct Row {
    /// The fault.
    pub fault: Fault,
    /// Longest rest of a robot until all drove again, s of the world's time; of a cut in the cloud, from its end.
    pub rest: f64,
    /// The robot with that rest.
    pub robot: String,
    /// Duration of the fault and the recovery, wall time, s.
    pub took: f64,
}

/// The resources of a part after a fault.
#[derive(Clone, Debug)]
pub struct Weight {
    /// Wall time since the trial began, s.
    pub secs: f64,
    /// Resources of the process.
    pub held: Held,
    /// Messages and requests that wait to be read, if the part tells.
    pub waiting: Result<u64, String>,
}

/// The results of a trial.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Wall time from the first part's start until three robots had finished a goal each, s.
    pub first_mission: f64,
    /// One row per fault.
    pub rows: Vec<Row>,
    /// Goals acknowledged.
    pub goals: usize,
    /// Number of ended goals by phase.
    pub ends: BTreeMap<String, usize>,
    /// For each part its process id, and its resources after each fault since its start.
    pub held: BTreeMap<String, (u32, Vec<Weight>)>,
    /// Violated expectations.
    pub failures: Vec<String>,
}

/// A fault of each kind, and a rolling update of all parts: short enough for the tests.
#[must_use]
pub fn short() -> Vec<Fault> {
    vec![
        Fault::Kill("fleet-a-router"),
        Fault::Pause("fleet-b-motion", 4),
        Fault::Cut("robot-b-edge-bert", "bert"),
        Fault::Kill("fleet-b-mission"),
        Fault::Update("fleet-a-motion"),
        Fault::Update("fleet-b-motion"),
        Fault::Update("fleet-a-mission"),
        Fault::Update("fleet-b-mission"),
        Fault::Kill("fleet-a-mapping"),
        Fault::Update("fleet-b-mapping"),
        Fault::Update("fleet-b-gateway"),
        Fault::Update("fleet-a-router"),
        Fault::Update("fleet-b-router"),
        Fault::Update("robot-a-edge-anna"),
    ]
}

/// Every part killed, frozen, cut off and replaced, `rounds` times.
#[must_use]
pub fn long(rounds: usize) -> Vec<Fault> {
    let parts = [
        "fleet-a-router",
        "fleet-b-router",
        "fleet-a-motion",
        "fleet-b-motion",
        "fleet-a-mission",
        "fleet-b-mission",
        "fleet-a-mapping",
        "fleet-b-mapping",
        "fleet-b-gateway",
    ];
    let robots = [
        ("robot-a-edge-anna", "anna"),
        ("robot-b-edge-bert", "bert"),
        ("robot-c-edge-carl", "carl"),
    ];
    let mut faults = Vec::new();
    for _ in 0..rounds {
        faults.extend(parts.map(Fault::Kill));
        faults.extend(parts.map(|part| Fault::Pause(part, 4)));
        faults.extend(robots.map(|(part, robot)| Fault::Cut(part, robot)));
        faults.extend(["fleet-a-router", "fleet-b-router"].map(|part| Fault::CutCloud(part, APART)));
        faults.push(Fault::Split(APART));
        faults.extend(parts.map(Fault::Update));
        faults.extend(robots.map(|(part, _)| Fault::Kill(part)));
        faults.extend(robots.map(|(part, _)| Fault::Update(part)));
    }
    faults
}

/// Runs the missions, and the faults one after the other. Unless all expectations are met, the parts' logs are printed.
///
/// # Errors
/// An error that prevents the trial from running, or a robot from driving on.
pub async fn run(
    site: &mut dyn Site,
    faults: impl IntoIterator<Item = Fault, IntoIter: Send>,
    begun: Instant,
) -> Result<Findings, String> {
    let found = carry_out(site, faults, begun).await;
    if !matches!(&found, Ok(findings) if findings.failures.is_empty()) {
        for part in site.parts() {
            eprintln!("--- {part} ---\n{}", site.log(&part));
        }
    }
    found
}

async fn carry_out(
    site: &mut dyn Site,
    faults: impl IntoIterator<Item = Fault, IntoIter: Send>,
    begun: Instant,
) -> Result<Findings, String> {
    let mut truth = Truth::listen(&site.world(), &site.identity()).await?;
    let client = Client::join(&site.routers(), &site.identity()).await?;
    let mut findings = Findings::default();
    for (robot, _) in LANES {
        client.submit(robot, 0).await?;
    }
    client.all_end(LONG).await?;
    findings.first_mission = begun.elapsed().as_secs_f64();

    // Before the first fault: a robot that has no goals yet would rest for that reason.
    let mut next = [1; LANES.len()];
    client.top_up(&mut next).await?;
    let client = Arc::new(client);
    let ending = Arc::new(AtomicBool::new(false));
    let feeding = tokio::spawn({
        let (client, ending) = (Arc::clone(&client), Arc::clone(&ending));
        async move { client.feed(&ending, next).await }
    });
    let mut watching = Vec::new();
    for router in site.routers().split(',') {
        let bus = super::join("watch", router, &site.identity()).await?;
        watching.push(tokio::spawn(watch(bus, Arc::clone(&ending))));
    }
    let happened = happen(site, faults, begun, (&client, &mut truth), &mut findings).await;
    ending.store(true, Ordering::Relaxed);
    // Robots without goals rest, so an error in submitting goals is reported first.
    let fed = feeding.await.map_err(|error| error.to_string())?;
    if let Err(error) = fed.and(happened) {
        return Err(format!("{error}; {}", client.under_way().await));
    }
    client.all_end(2 * LONG).await?;
    for watching in watching {
        findings
            .failures
            .extend(watching.await.map_err(|error| error.to_string())??);
    }
    findings.count(&client).await?;
    findings.judge(&truth);
    Ok(findings)
}

/// Injects the faults one after the other, each once all robots drive and all missions have caught up: until then the last fault lasts.
async fn happen(
    site: &mut dyn Site,
    faults: impl IntoIterator<Item = Fault, IntoIter: Send>,
    begun: Instant,
    (client, truth): (&Client, &mut Truth),
    findings: &mut Findings,
) -> Result<(), String> {
    let drives = |_: &str, rest: f64| rest < DRIVES;
    for fault in faults {
        client
            .all_caught_up()
            .await
            .map_err(|error| format!("before {fault:?}: {error}"))?;
        truth
            .until(&format!("all robots drive before {fault:?}"), LONG, drives)
            .await?;
        truth.reset();
        let again = format!("all robots drive after {fault:?}");
        let since = Instant::now();
        match fault {
            Fault::Kill(part) => {
                block_in_place(|| site.kill(part))?;
                truth.during(HORIZON + 1.0).await?;
                block_in_place(|| site.start(part))?;
            }
            Fault::Pause(part, secs) => {
                block_in_place(|| site.pause(part))?;
                truth.during(f64::from(secs)).await?;
                block_in_place(|| site.resume(part))?;
            }
            Fault::Cut(part, robot) => {
                block_in_place(|| site.cut(part))?;
                let rests = |name: &str, rest: f64| name != robot || rest > 1.0;
                truth.until(&format!("{robot} rests when cut off"), LONG, rests).await?;
                block_in_place(|| site.heal(part))?;
            }
            Fault::CutCloud(part, secs) => {
                block_in_place(|| site.cut(part))?;
                truth.during(f64::from(secs)).await?;
                let without = format!("all robots drive without the host of {part}");
                truth.until(&without, LONG, drives).await?;
                block_in_place(|| site.heal(part))?;
                truth.reset();
                truth.during(HORIZON).await?;
            }
            Fault::Split(secs) => {
                block_in_place(|| site.split(true))?;
                truth.during(f64::from(secs)).await?;
                block_in_place(|| site.split(false))?;
                truth.reset();
                truth.during(HORIZON).await?;
            }
            Fault::Update(part) => {
                block_in_place(|| site.update(part))?;
                truth.during(2.0).await?;
            }
        }
        truth.until(&again, LONG, drives).await?;
        let (rest, robot) = truth.longest_rest();
        block_in_place(|| findings.weigh(site, begun));
        findings.rows.push(Row {
            fault,
            rest,
            robot,
            took: since.elapsed().as_secs_f64(),
        });
    }
    Ok(())
}

impl Fault {
    /// Longest rest that it may cause, s of the world's time; `None` if a robot must rest because its own side is down or cut off.
    fn most(self) -> Option<f64> {
        match self {
            Self::Cut(..) => None,
            Self::Kill(part) | Self::Pause(part, _) | Self::Update(part) if part.contains("-edge-") => None,
            Self::Kill(_) | Self::Pause(..) | Self::Update(_) | Self::CutCloud(..) | Self::Split(_) => Some(HORIZON),
        }
    }
}

impl Findings {
    /// Records the resources of each part; a restarted part begins a new record.
    fn weigh(&mut self, site: &dyn Site, begun: Instant) {
        for part in site.parts() {
            let Ok(process) = site.process_id(&part) else { continue };
            let Ok(held) = held(process) else { continue };
            let (known, all) = self.held.entry(part).or_insert((process, Vec::new()));
            if *known != process {
                (*known, *all) = (process, Vec::new());
            }
            all.push(Weight {
                secs: begun.elapsed().as_secs_f64(),
                held,
                waiting: waiting(process),
            });
        }
    }

    async fn count(&mut self, client: &Client) -> Result<(), String> {
        let acknowledged = client.acknowledged();
        self.goals = acknowledged.len();
        let mut listed = BTreeMap::new();
        for (robot, _) in LANES {
            listed.extend(client.goals(robot).await?);
        }
        for id in &acknowledged {
            match listed.get(id) {
                Some(phase) => *self.ends.entry(format!("{phase:?}")).or_default() += 1,
                None => self.failures.push(format!("{id} was acknowledged and is lost")),
            }
        }
        Ok(())
    }

    fn judge(&mut self, truth: &Truth) {
        for row in &self.rows {
            if let Some(most) = row.fault.most().filter(|most| row.rest > *most) {
                self.failures.push(format!(
                    "{:?}: {} rested for {:.1} s, longer than {most} s",
                    row.fault, row.robot, row.rest
                ));
            }
        }
        for (phase, count) in self.ends.iter().filter(|(phase, _)| phase.as_str() != "Succeeded") {
            self.failures.push(format!("{count} goals ended {phase}"));
        }
        let minutes = self.rows.iter().map(|row| row.took).sum::<f64>() / 60.0;
        let least = LANES.len() as f64 * (OUTSTANDING as f64 + LEAST_GOALS * minutes);
        if (self.goals as f64) < least {
            self.failures.push(format!(
                "{} goals in {minutes:.1} min of faults: expected at least {least:.0}",
                self.goals
            ));
        }
        self.failures.extend(
            truth
                .touched()
                .into_iter()
                .map(|robot| format!("{robot} touched something")),
        );
    }
}

/// Watches the robots' states at one router until the end; returns the motion without a valid horizon. A router that is cut off from a robot, or
/// replaced, passes on none of its states meanwhile.
async fn watch(bus: Bus, ending: Arc<AtomicBool>) -> Result<Vec<String>, String> {
    let mut watches = Vec::new();
    for (robot, _) in LANES {
        let watch = Watch::new(&bus, robot, LostPolicy::FinishHorizon).map_err(|error| error.to_string())?;
        watches.push((robot, watch));
    }
    while !ending.load(Ordering::Relaxed) {
        for (_, watch) in &mut watches {
            if watch.heard.elapsed() > LOST {
                watch.forget();
            }
            watch.listen();
        }
        tokio::time::sleep(LOOKS).await;
    }
    let mut found = Vec::new();
    for (robot, watch) in watches {
        found.extend(watch.invalid.into_iter().map(|what| format!("{robot}: {what}")));
    }
    Ok(found)
}

/// Submits the robots' goals, as a client of any router that is up.
struct Client {
    bus: Bus,
    acknowledged: std::sync::Mutex<Vec<String>>,
}

impl Client {
    async fn join(routers: &str, operator: &Path) -> Result<Self, String> {
        Ok(Self {
            bus: super::join("trial", routers, operator).await?,
            acknowledged: std::sync::Mutex::default(),
        })
    }

    fn acknowledged(&self) -> Vec<String> {
        self.acknowledged.lock().map(|ids| ids.clone()).unwrap_or_default()
    }

    /// Submits a robot's goal with this number, alternating between the ends of its lane, until it is acknowledged.
    async fn submit(&self, robot: &str, number: usize) -> Result<(), String> {
        let lane = LANES.iter().find(|(name, _)| *name == robot).map_or(0.0, |(_, y)| *y);
        let id = format!("{robot}-{number}");
        let request = GoalRequest {
            id: Some(id.clone()),
            x: Some(if number == 0 { FIRST } else { ENDS[number % 2] }),
            y: Some(lane),
            ..GoalRequest::default()
        };
        self.asked(&topics::GOAL, robot, &request)
            .await
            .map_err(|error| format!("{id}: {error}"))?;
        if let Ok(mut ids) = self.acknowledged.lock() {
            ids.push(id);
        }
        Ok(())
    }

    /// Repeats a request until it is answered, because an answer may be lost with a router.
    async fn asked<Q: Serialize, R: DeserializeOwned>(
        &self,
        ask: &Ask<Q, R>,
        robot: &str,
        request: &Q,
    ) -> Result<R, AskError> {
        let end = Instant::now() + LONG;
        loop {
            match self.bus.ask(ask, &[robot], request, ANSWERED).await {
                Err(AskError::Timeout { .. } | AskError::Refused(Refusal::NotLeader)) if Instant::now() < end => {}
                answer => return answer,
            }
        }
    }

    async fn goals(&self, robot: &str) -> Result<BTreeMap<String, GoalPhase>, String> {
        // As many as a mission keeps: an answer without a limit has the newest only.
        let all = GoalsRequest {
            limit: Some(1000),
            ..GoalsRequest::default()
        };
        let reply = self.asked(&topics::GOALS, robot, &all).await;
        let reply = reply.map_err(|error| format!("goals of {robot}: {error}"))?;
        Ok(reply.goals.into_iter().map(|goal| (goal.id, goal.state)).collect())
    }

    /// Waits until each robot says that every mission may lead it next.
    async fn all_caught_up(&self) -> Result<(), String> {
        let end = Instant::now() + LONG;
        for (robot, _) in LANES {
            let states = self.bus.latest(&topics::STATE, &[robot]);
            let mut states = states.map_err(|error| error.to_string())?;
            loop {
                let state = tokio::time::timeout(end.saturating_duration_since(Instant::now()), states.next());
                let Ok(Some(state)) = state.await else {
                    return Err(format!("not all missions of {robot} have caught up within {LONG:?}"));
                };
                let leader = state.message.lease.leader;
                if leader.is_some_and(|leader| leader.caught_up.len() == MISSIONS) {
                    break;
                }
            }
        }
        Ok(())
    }

    /// What each robot's mission is doing, in its own words, and who leads in the robot's.
    async fn under_way(&self) -> String {
        let mut told = Vec::new();
        for (robot, _) in LANES {
            told.push(match self.bus.latest(&topics::STATE, &[robot]) {
                Ok(mut states) => match tokio::time::timeout(ANSWERED, states.next()).await {
                    Ok(Some(state)) => format!("{robot} says {:?}", state.message.lease),
                    _ => format!("{robot} says nothing"),
                },
                Err(error) => format!("{robot}: {error}"),
            });
            told.push(
                match self.asked(&topics::GOALS, robot, &GoalsRequest::default()).await {
                    Ok(reply) => match reply.goals.iter().find(|goal| goal.state == GoalPhase::Active) {
                        Some(goal) => format!("{} {:?}", goal.id, goal.feedback),
                        None => format!("{robot} has no active goal"),
                    },
                    Err(error) => format!("goals of {robot}: {error}"),
                },
            );
        }
        told.join(", ")
    }

    /// Keeps [`OUTSTANDING`] goals per robot until the end. `next` are the numbers of the robots' next goals.
    async fn feed(&self, ending: &AtomicBool, mut next: [usize; LANES.len()]) -> Result<(), String> {
        while !ending.load(Ordering::Relaxed) {
            self.top_up(&mut next).await?;
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
        Ok(())
    }

    /// Submits goals until each robot has [`OUTSTANDING`] unfinished ones; counts up the numbers of the next.
    async fn top_up(&self, next: &mut [usize; LANES.len()]) -> Result<(), String> {
        for ((robot, _), next) in LANES.into_iter().zip(next) {
            let goals = self.goals(robot).await?;
            let open = goals.values().filter(|phase| !phase.is_end()).count();
            for _ in open..OUTSTANDING {
                self.submit(robot, *next).await?;
                *next += 1;
            }
        }
        Ok(())
    }

    async fn all_end(&self, limit: Duration) -> Result<(), String> {
        let deadline = Instant::now() + limit;
        let acknowledged = self.acknowledged();
        loop {
            let mut open = Vec::new();
            for (robot, _) in LANES {
                let goals = self.goals(robot).await?;
                open.extend(
                    goals
                        .into_iter()
                        .filter(|(id, phase)| acknowledged.contains(id) && !phase.is_end()),
                );
            }
            if open.is_empty() {
                return Ok(());
            }
            if Instant::now() > deadline {
                return Err(format!("not ended within {limit:?}: {open:?}"));
            }
            tokio::time::sleep(Duration::from_millis(300)).await;
        }
    }
}
