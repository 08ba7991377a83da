//! `zenav bench drive`: how well does it drive? Every run is judged by truth, beside anchors in the same worlds with the same body.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use clap::ValueEnum as _;
use serde::Serialize;
use tracing::subscriber::{NoSubscriber, with_default};

use super::anchors::{self, Anchor, Field};
use super::suites::{Case, Suite};
use crate::batch::{median, progress};
use crate::config::Layers;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::lockstep::{ContactKind, ContactReport, RunOutcome, Scenario};
use crate::output::{Format, line, table, value};

/// Mean delay from scan to plan, ms.
const DELAY_MS: f64 = 100.0;

/// Arguments of `zenav bench drive`.
#[derive(Debug, clap::Args)]
pub struct DriveArgs {
    /// Suite; without it, all
    #[arg(long, value_enum, value_name = "S", ignore_case = true)]
    suite: Option<Suite>,
    /// Seeds of each scenario and robot [default: 20 worlds a level in S2, else 3]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: Option<u64>,
    /// The run of this name only, as the table names it
    #[arg(long, value_name = "NAME")]
    only: Option<String>,
    /// Write each world here, with the `zenav run` command that drives in it, and drive nothing
    #[arg(long, value_name = "DIR")]
    world_out: Option<PathBuf>,
    /// Runs at once [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Who drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
enum Driver {
    Zenav,
    #[serde(untagged)]
    Anchor(Anchor),
}

impl Driver {
    fn name(self) -> &'static str {
        match self {
            Self::Zenav => "zenav",
            Self::Anchor(Anchor::Standing) => "window, standing",
            Self::Anchor(Anchor::ConstantVelocity) => "window, velocities",
            Self::Anchor(Anchor::AllKnowing) => "all-knowing A*",
        }
    }
}

/// One run.
#[derive(Clone, Debug, Serialize)]
struct Run {
    scenario: String,
    name: String,
    driver: Driver,
    outcome: RunOutcome,
    reason: Option<String>,
    time_s: f64,
    /// Length of the shortest way of the inscribed disc over the top speed, s.
    ideal_s: f64,
    length_m: f64,
    min_clearance_m: f64,
    contacts: Vec<ContactReport>,
    /// Of zenav: the estimate against the truth at the end.
    pose_error_m: Option<f64>,
    recoveries: Option<u64>,
    /// Of zenav: processor time of robot, mapper, mission and motion, s.
    cpu_s: Option<f64>,
}

impl Run {
    fn reached(&self) -> bool {
        self.outcome == RunOutcome::Reached
    }

    fn contacts(&self, kind: ContactKind) -> usize {
        self.contacts.iter().filter(|contact| contact.kind == kind).count()
    }

    fn ratio(&self) -> f64 {
        self.time_s / self.ideal_s
    }
}

/// A row of the table: all runs of a scenario with one driver.
#[derive(Clone, Debug, Serialize)]
struct Row {
    scenario: String,
    driver: Driver,
    runs: usize,
    /// At rest at the goal, and nothing touched by the robot's own motion.
    reached: usize,
    /// The same, and nothing touched the robot.
    untouched: usize,
    contacts_own: usize,
    contacts_after_own_motion: usize,
    contacts_at_rest: usize,
    /// Median of the reached runs.
    time_over_ideal: Option<f64>,
    /// Own contacts count most, then goals not reached, then contacts, then time.
    worst: String,
}

impl Row {
    fn of(runs: &[&Run]) -> Option<Self> {
        let first = runs.first()?;
        let worst = runs.iter().max_by(|a, b| {
            let rank = |run: &Run| (run.contacts(ContactKind::Own), !run.reached(), run.contacts.len());
            rank(a).cmp(&rank(b)).then(a.ratio().total_cmp(&b.ratio()))
        })?;
        let contacts = |kind| runs.iter().map(|run| run.contacts(kind)).sum();
        let reached: Vec<f64> = runs.iter().filter(|run| run.reached()).map(|run| run.ratio()).collect();
        Some(Self {
            scenario: first.scenario.clone(),
            driver: first.driver,
            runs: runs.len(),
            reached: reached.len(),
            untouched: runs
                .iter()
                .filter(|run| run.reached() && run.contacts.is_empty())
                .count(),
            contacts_own: contacts(ContactKind::Own),
            contacts_after_own_motion: contacts(ContactKind::AfterOwnMotion),
            contacts_at_rest: contacts(ContactKind::AtRest),
            time_over_ideal: (!reached.is_empty()).then(|| median(reached)),
            worst: worst.name.clone(),
        })
    }

    fn cells(&self) -> Vec<String> {
        vec![
            self.scenario.clone(),
            self.driver.name().to_owned(),
            self.runs.to_string(),
            self.reached.to_string(),
            self.untouched.to_string(),
            self.contacts_own.to_string(),
            self.contacts_after_own_motion.to_string(),
            self.contacts_at_rest.to_string(),
            self.time_over_ideal
                .map_or_else(|| "-".to_owned(), |ratio| format!("{ratio:.2}")),
            self.worst.clone(),
        ]
    }
}

/// What `-o json` prints.
#[derive(Serialize)]
struct Report {
    rows: Vec<Row>,
    runs: Vec<Run>,
}

/// `zenav bench drive`.
///
/// # Errors
/// A name that no run has; a folder that cannot be written.
pub(super) fn drive(args: &DriveArgs) -> Outcome {
    let suites = args
        .suite
        .map_or_else(|| Suite::value_variants().to_vec(), |suite| vec![suite]);
    let mut cases = Vec::new();
    for suite in suites {
        cases.extend(suite.cases(args.seeds)?);
    }
    if let Some(only) = &args.only {
        cases.retain(|case| case.name == *only);
        if cases.is_empty() {
            return Err(Failure::not_found(format!(
                "--only {only}: no run of that name; `zenav bench drive --world-out DIR` writes all of them"
            )));
        }
    }
    if let Some(folder) = &args.world_out {
        std::fs::create_dir_all(folder).map_err(Failure::failed_at(folder))?;
        for case in &cases {
            files::write(&folder.join(format!("{}.toml", case.name)), case.file())?;
            line(&case.command());
        }
        return Ok(exit_code::OK);
    }
    let threads = args.threads.map(usize::from);
    let threads = threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    let runs = all(&cases, threads)?;
    let mut rows: Vec<Row> = Vec::new();
    for run in &runs {
        if !rows
            .iter()
            .any(|row| row.scenario == run.scenario && row.driver == run.driver)
        {
            let alike = |other: &&Run| other.scenario == run.scenario && other.driver == run.driver;
            rows.extend(Row::of(&runs.iter().filter(alike).collect::<Vec<_>>()));
        }
    }
    value(args.output, &Report { rows, runs }, |report| {
        let header = [
            "SCENARIO",
            "DRIVER",
            "RUNS",
            "REACHED",
            "UNTOUCHED",
            "OWN",
            "AFTER OWN",
            "AT REST",
            "TIME/IDEAL",
            "WORST",
        ];
        table(&header, &report.rows.iter().map(Row::cells).collect::<Vec<_>>())
    })?;
    Ok(exit_code::OK)
}

/// Runs all cases, one a thread; in their order, whoever is done first.
fn all(cases: &[Case], threads: usize) -> Result<Vec<Run>, Failure> {
    let layers = Layers::load(None)?;
    let bar = progress(cases.len());
    let next = AtomicUsize::new(0);
    let done = Mutex::new((0..cases.len()).map(|_| None).collect::<Vec<_>>());
    std::thread::scope(|scope| {
        for _ in 0..threads.min(cases.len()) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(case) = cases.get(index) else { return };
                    // What hundreds of missions say while they drive tells nobody anything.
                    let runs = with_default(NoSubscriber::default(), || one(&layers, case));
                    if let Some(place) = done.lock().unwrap_or_else(PoisonError::into_inner).get_mut(index) {
                        *place = Some(runs);
                    }
                    bar.inc(1);
                }
            });
        }
    });
    bar.finish_and_clear();
    let done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    let runs: Vec<Vec<Run>> = done.into_iter().flatten().collect::<Result<_, Failure>>()?;
    Ok(runs.into_iter().flatten().collect())
}

/// A case, driven by zenav and by the anchors.
fn one(layers: &Layers, case: &Case) -> Result<Vec<Run>, Failure> {
    let field = Field::new(&case.world, case.model.footprint.inscribed_radius(), case.goal);
    let ideal_s = field.shortest(case.world.start().position()) / case.model.drive.top_speed();
    let scenario = Scenario {
        world: &case.world,
        robot: Some(case.robot),
        seed: Some(case.seed),
        known_map: case.known_map,
        zones: None,
        cloud_delay_ms: DELAY_MS,
        goal: case.goal,
        tolerance: case.tolerance,
        profile: None,
        timeout: case.timeout,
    };
    let report = scenario.run(layers, |_, _| {})?;
    let mut runs = vec![Run {
        scenario: case.scenario.clone(),
        name: case.name.clone(),
        driver: Driver::Zenav,
        outcome: report.outcome,
        reason: report.reason,
        time_s: report.time_s,
        ideal_s,
        length_m: report.length_m,
        min_clearance_m: report.min_clearance_m,
        contacts: report.contacts,
        pose_error_m: Some(report.pose_error_m),
        recoveries: Some(report.recoveries),
        cpu_s: report.cpu_s,
    }];
    for anchor in Anchor::ALL.into_iter().filter(|_| case.anchored) {
        let driven = anchors::drive(anchor, case, &field)?;
        let outcome = match () {
            () if driven.referee.own_contact().is_some() => RunOutcome::Collision,
            () if driven.referee.is_reached() => RunOutcome::Reached,
            () => RunOutcome::Timeout,
        };
        runs.push(Run {
            scenario: case.scenario.clone(),
            name: case.name.clone(),
            driver: Driver::Anchor(anchor),
            outcome,
            reason: None,
            time_s: driven.time_s,
            ideal_s,
            length_m: driven.truth.length,
            min_clearance_m: driven.truth.min_clearance,
            contacts: driven.referee.contacts().to_vec(),
            pose_error_m: None,
            recoveries: None,
            cpu_s: None,
        });
    }
    Ok(runs)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn a_case_goes_alike_twice_and_anchors_that_know_more_reach_the_goal() {
        let cases = Suite::S3.cases(Some(1)).unwrap();
        let case = cases.iter().find(|case| case.name == "crossing-1-jackal-0").unwrap();
        let field = Field::new(&case.world, case.model.footprint.inscribed_radius(), case.goal);
        let drive = |anchor| anchors::drive(anchor, case, &field).unwrap();
        let (first, second) = (drive(Anchor::AllKnowing), drive(Anchor::AllKnowing));
        assert_eq!(first.truth, second.truth);
        assert!(first.referee.is_reached() && first.referee.contacts().is_empty());
    }
}
