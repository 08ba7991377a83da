//! Run. Runs one row: goals one after the other, and the fault injected and healed while the robot drives.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use tokio::time::{Instant, sleep, timeout};
use zenav_protocol::bus::{Bus, Latest};
use zenav_protocol::messages::{GoalPhase, GoalRequest, GoalState, GoalsRequest};
use zenav_protocol::topics;

use super::copies::{self, Copies};
use super::flood::Flood;
use super::result::{Memory, Result};
use super::rig::Rig;
use super::rows::{Fault, PartKind, Place, Row};
use super::watch::Watch;
use crate::deployment::ROBOT;

/// Longest wait until a goal is acknowledged, wall time.
const ACKNOWLEDGED: Duration = Duration::from_secs(60);
/// Longest mission, without the faults in it, wall time.
const ENDS: Duration = Duration::from_secs(150);
/// Longest wait for a robot to drive on.
const RESUMES: Duration = Duration::from_secs(30);
/// Longest wait for a copy to take over.
const TAKES_OVER: Duration = Duration::from_secs(10);
/// A fault is injected only while more than this is left of the plan, s, so that the robot does not arrive before the fault acts.
const LEFT: f64 = 6.0;
/// Longest time of driving before a fault, s.
const LONGEST_DRIVE: f64 = 2.0;
/// Most missions, however few faults were injected.
const MOST_MISSIONS: usize = 12;

/// State of a running row.
struct Running<'a> {
    row: &'a Row,
    rig: Rig,
    watch: Watch,
    /// In rows with two mapping services.
    copies: Option<Copies>,
    random: Pcg64Mcg,
    found: Result,
    faults: usize,
    observed: (u32, u32),
}

/// Runs a row.
///
/// # Errors
/// When its parts cannot be started or joined.
pub async fn run(binary: PathBuf, row: &Row, seed: u64) -> std::result::Result<Result, String> {
    let mut found = Result {
        name: row.name.clone(),
        ..Result::default()
    };
    for order in &row.orders {
        let mut once = run_in(*order, binary.clone(), row, seed).await?;
        if row.orders.len() > 1 {
            for failure in &mut once.failures {
                *failure = format!("started as {order:?}: {failure}");
            }
        }
        found.add(once);
    }
    Ok(found)
}

/// Runs a row once, with its parts started in this order.
async fn run_in(order: [PartKind; 5], binary: PathBuf, row: &Row, seed: u64) -> std::result::Result<Result, String> {
    let rig = Rig::start(binary, row, order)?;
    let (client, robot) = rig.join().await?;
    let watch = Watch::new(&robot, ROBOT, row.policy).map_err(|error| error.to_string())?;
    let copies = row.has_copy.then(|| Copies::new(&client)).transpose();
    let copies = copies.map_err(|error| error.to_string())?;
    let mut running = Running {
        row,
        rig,
        watch,
        copies,
        random: Pcg64Mcg::seed_from_u64(seed),
        found: Result {
            name: row.name.clone(),
            ..Result::default()
        },
        faults: 0,
        observed: (0, 0),
    };
    let mut settled = BTreeMap::new();
    while running.found.missions.0 < row.missions || running.faults < row.times {
        if running.found.missions.0 == 1 {
            settled = running.rig.memory();
        }
        if running.found.missions.0 == MOST_MISSIONS {
            let text = format!("only {} of {} faults were injected", running.faults, row.times);
            running.found.failures.push(text);
            break;
        }
        let number = running.found.missions.0;
        if let Err(why) = running.mission(&client, number).await {
            running.found.failures.push(why);
            break;
        }
    }
    running.check_goals(&client).await;
    let mut found = running.found;
    found.failures.extend(running.rig.ended());
    found.memory = running
        .rig
        .memory()
        .into_iter()
        .map(|(process, end)| Memory {
            part: process.0.name().to_owned(),
            settled: settled.get(&process).copied(),
            end,
        })
        .collect();
    found.collisions = running.watch.collisions;
    found.invalid = running.watch.invalid;
    let (at_rest, all) = running.observed;
    found.rest = f64::from(at_rest) / f64::from(all.max(1));
    Ok(found)
}

impl Running<'_> {
    /// The goal of this number: one of the ends of the route.
    fn goal(&self, number: usize) -> GoalRequest {
        let ends = match self.row.place {
            Place::Kitchen => [(-1.46, -3.12), (0.88, 0.09)],
            Place::Depot => [(17.2, 2.0), (0.6, -3.6)],
        };
        let (x, y) = if number.is_multiple_of(2) { ends[0] } else { ends[1] };
        GoalRequest {
            id: Some(format!("goal{number}")),
            x: Some(x),
            y: Some(y),
            ..GoalRequest::default()
        }
    }

    async fn pass(&mut self) {
        self.watch.listen();
        if let Some(copies) = &mut self.copies {
            copies.listen();
        }
        self.observed.1 += 1;
        self.observed.0 += u32::from(!self.watch.drives());
        sleep(Duration::from_millis(20)).await;
    }

    /// Submits a goal, and injects faults until it has ended.
    async fn mission(&mut self, client: &Bus, number: usize) -> std::result::Result<(), String> {
        let request = self.goal(number);
        let id = format!("goal{number}");
        let mut states = client
            .latest(&topics::GOAL_STATE, &[ROBOT, &id])
            .map_err(|error| error.to_string())?;
        let submitted = client.ask(&topics::GOAL, &[ROBOT], &request, ACKNOWLEDGED).await;
        submitted.map_err(|error| format!("{id} was not acknowledged: {error}"))?;
        self.found.missions.0 += 1;
        let begun = Instant::now();
        let mut deadline = begun + ENDS;
        let mut drive: Option<Instant> = None;
        loop {
            self.pass().await;
            if let Some(state) = states.borrow().filter(|state| state.state.is_end()).cloned() {
                self.ended(&state, begun);
                return Ok(());
            }
            if Instant::now() > deadline {
                return Err(format!(
                    "{id} has not ended after {:.0} s",
                    begun.elapsed().as_secs_f64()
                ));
            }
            // A copy that does not hold the map yet takes over without it.
            let is_followed = self.copies.as_ref().is_none_or(Copies::is_followed);
            let is_due = self.faults < self.row.times && self.watch.is_under_way(LEFT) && is_followed;
            if is_due && self.row.fault != Fault::None {
                let wait = self.random.random_range(0.0..LONGEST_DRIVE);
                let at = *drive.get_or_insert_with(|| Instant::now() + Duration::from_secs_f64(wait));
                if Instant::now() >= at {
                    drive = None;
                    let since = Instant::now();
                    self.inject(client, &mut states).await?;
                    deadline += since.elapsed();
                }
            } else {
                drive = None;
            }
        }
    }

    fn ended(&mut self, state: &GoalState, begun: Instant) {
        self.found.secs.push(begun.elapsed().as_secs_f64());
        if state.state == GoalPhase::Succeeded {
            self.found.missions.1 += 1;
        } else {
            let reason = state.reason.as_deref().unwrap_or_default();
            self.found
                .failures
                .push(format!("{} ended {:?}: {reason}", state.id, state.state));
        }
    }

    /// Injects the fault once, heals it, and waits until the robot drives on.
    async fn inject(&mut self, client: &Bus, goal: &mut Latest<GoalState>) -> std::result::Result<(), String> {
        self.faults += 1;
        let term = self.copies.as_ref().map(Copies::term);
        self.strike(client).await?;
        self.drives_on(goal).await;
        if let Some(term) = term {
            self.is_taken_over(term).await;
        }
        Ok(())
    }

    /// The part that a fault of this part hits: of two mapping services the one that leads.
    async fn hit(&self, client: &Bus, part: PartKind) -> std::result::Result<PartKind, String> {
        if self.copies.is_none() || part != PartKind::Mapping {
            return Ok(part);
        }
        let process = copies::leading(client).await?;
        let leading = self.rig.part_of(process);
        leading.ok_or_else(|| format!("the mapping service that leads is none of this row: process {process}"))
    }

    /// Injects the fault once, and heals it.
    async fn strike(&mut self, client: &Bus) -> std::result::Result<(), String> {
        let pause = |secs: u32| Duration::from_secs(secs.into());
        match self.row.fault {
            Fault::None => {}
            Fault::Cut(secs) => {
                self.rig.cut()?;
                self.pass_for(pause(secs)).await;
                self.rig.heal()?;
            }
            Fault::Kill(part) => {
                let part = self.hit(client, part).await?;
                self.rig.replace(part);
            }
            Fault::Restart(part) => self.rig.restart(part)?,
            Fault::Freeze(part, secs) => {
                let part = self.hit(client, part).await?;
                let frozen = self.rig.part(part).ok_or_else(|| format!("{part:?} does not run"))?;
                frozen.pause()?;
                self.pass_for(pause(secs)).await;
                let frozen = self.rig.part(part).ok_or_else(|| format!("{part:?} does not run"))?;
                frozen.resume()?;
            }
            Fault::Full(part, secs) => {
                self.rig.set_room(part, false)?;
                self.pass_for(pause(secs)).await;
                self.rig.set_room(part, true)?;
            }
            Fault::Clock(_, secs, hours) => {
                self.rig.set_clock(3600 * hours).map_err(|error| error.to_string())?;
                self.pass_for(pause(secs)).await;
                self.rig.set_clock(0).map_err(|error| error.to_string())?;
            }
            Fault::Flood(secs) => {
                let flood = Flood::listen(client).await.map_err(|error| error.to_string())?;
                let flooding = tokio::spawn(flood.pour(client.clone(), pause(secs)));
                self.pass_for(pause(secs)).await;
                self.found.flooded += flooding.await.map_err(|error| error.to_string())?;
            }
            Fault::Twin(secs) => {
                self.rig.set_twin(true);
                self.pass_for(pause(secs)).await;
                self.rig.set_twin(false);
            }
        }
        Ok(())
    }

    /// Waits until the robot drives on, or the goal has ended.
    async fn drives_on(&mut self, goal: &mut Latest<GoalState>) {
        let healed = Instant::now();
        self.watch.listen();
        // A robot that still drives when the fault is healed was not stopped by it, unless it was killed or stops afterwards.
        let mut stopped = None;
        while healed.elapsed() < RESUMES {
            self.pass().await;
            if goal.borrow().is_some_and(|state| state.state.is_end()) {
                return;
            }
            if !self.watch.drives() {
                stopped.get_or_insert_with(Instant::now);
            } else if stopped.is_some() || healed.elapsed() > Duration::from_secs(2) {
                let resumed = if stopped.is_some() {
                    healed.elapsed().as_secs_f64()
                } else {
                    0.0
                };
                self.found.resumes.push(resumed);
                return;
            }
        }
        self.found
            .failures
            .push(format!("it does not drive on within {RESUMES:?}"));
    }

    /// Waits until the copy has begun the next term.
    async fn is_taken_over(&mut self, before: u64) {
        let end = Instant::now() + TAKES_OVER;
        while Instant::now() < end {
            if self.copies.as_ref().is_none_or(|copies| copies.term() > before) {
                return;
            }
            self.pass().await;
        }
        self.found
            .failures
            .push(format!("no copy takes over within {TAKES_OVER:?}"));
    }

    async fn pass_for(&mut self, time: Duration) {
        let end = Instant::now() + time;
        while Instant::now() < end {
            self.pass().await;
        }
    }

    /// Counts the acknowledged goals that the mission does not know.
    async fn check_goals(&mut self, client: &Bus) {
        let request = GoalsRequest {
            limit: Some(100),
            ..GoalsRequest::default()
        };
        let listed = timeout(
            ACKNOWLEDGED,
            client.ask(&topics::GOALS, &[ROBOT], &request, ACKNOWLEDGED),
        )
        .await;
        match listed {
            Ok(Ok(listed)) => {
                let is_known = |number: &usize| listed.goals.iter().any(|goal| goal.id == format!("goal{number}"));
                self.found.lost = (0..self.found.missions.0).filter(|number| !is_known(number)).count();
            }
            _ => self.found.failures.push("nobody lists the goals".to_owned()),
        }
    }
}
