//! `zenav bench drive`: how well does it drive? Every run is judged by truth, beside anchors in the same worlds with the same body.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use clap::ValueEnum as _;
use serde::Serialize;
use tracing::subscriber::{NoSubscriber, with_default};
use zenav_protocol::time::Stamp;
use zenav_sim::Truth;
use zenav_sim::manners::Manners;

use super::anchors::{self, Anchor, Field};
use super::suites::{Case, Suite, score};
use crate::batch::{median, progress};
use crate::config::Layers;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::lockstep::{ContactKind, ContactReport, Entrant, RunOutcome, RunReport, Scenario, worst};
use crate::output::{Format, line, table, value};

/// Mean delay from scan to plan, ms.
const DELAY_MS: f64 = 100.0;
/// Nobody likes a robot nearer than this: the intimate distance (Hall, "The Hidden Dimension", 1966), m.
const PERSONAL_SPACE: f64 = 0.45;
/// Slower than this a robot is at rest, m/s and rad/s.
const AT_REST: f64 = 0.01;

/// Arguments of `zenav bench drive`.
#[derive(Debug, clap::Args)]
pub struct DriveArgs {
    /// Suite; without it, all
    #[arg(long, value_enum, value_name = "S", ignore_case = true)]
    suite: Option<Suite>,
    /// Seeds of each scenario and robot [default: 20 worlds a level in S2, else 3]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: Option<u64>,
    /// Folder of BARN's worlds, `world_N.world` or `world_N.toml`, for S1
    #[arg(long, value_name = "DIR")]
    worlds: Option<PathBuf>,
    /// Standard deviation of the lidar's ranges in S1, cm; its own is the least
    #[arg(long, value_name = "CM", default_value_t = 1.0, requires = "worlds")]
    noise: f64,
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
    /// The robot whose way takes longest, with no other robot in the world.
    Alone,
    #[serde(untagged)]
    Anchor(Anchor),
}

impl Driver {
    fn name(self) -> &'static str {
        match self {
            Self::Zenav => "zenav",
            Self::Alone => "zenav, alone",
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
    /// Length of the shortest way of the inscribed disc over the top speed, s; of several robots, the time of the one with the longest
    /// way when it is alone.
    ideal_s: f64,
    length_m: f64,
    min_clearance_m: f64,
    contacts: Vec<ContactReport>,
    /// Of zenav: the estimate against the truth at the end.
    pose_error_m: Option<f64>,
    recoveries: Option<u64>,
    /// Of zenav: processor time of robot, mapper, mission and motion, s.
    cpu_s: Option<f64>,
    /// Share of the time with somebody nearer to the outline than 0.45 m, where people make way.
    close_share: Option<f64>,
    /// Where a sensor is broken: the run without the fault, and how many times longer this one took, if both arrived.
    faultless: Option<String>,
    over_faultless: Option<f64>,
    /// Where a lidar dies: time from then until the robot is at rest, s.
    rest_after_s: Option<f64>,
    /// Of zenav where it is what counts: processor time for each second driven, s/s.
    cpu_share: Option<f64>,
    /// As BARN scores, 0 to 0.5.
    score: Option<f64>,
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
    /// Mean.
    close_share: Option<f64>,
    /// Median of the runs that were reached with the fault and without it.
    over_faultless: Option<f64>,
    /// The longest.
    rest_after_s: Option<f64>,
    /// Median.
    cpu_share: Option<f64>,
    /// Mean.
    score: Option<f64>,
    /// Own contacts count most, then goals not reached, then contacts, then time.
    worst: String,
}

/// A column that only some suites have.
type Extra = (&'static str, fn(&Row) -> Option<f64>);

const EXTRAS: [Extra; 5] = [
    ("< 0.45 M", |row| row.close_share),
    ("/ NO FAULT", |row| row.over_faultless),
    ("REST S", |row| row.rest_after_s),
    ("CPU S/S", |row| row.cpu_share),
    ("SCORE", |row| row.score),
];

impl Row {
    fn of(runs: &[&Run]) -> Option<Self> {
        let first = runs.first()?;
        let worst = runs.iter().max_by(|a, b| {
            let rank = |run: &Run| (run.contacts(ContactKind::Own), !run.reached(), run.contacts.len());
            rank(a).cmp(&rank(b)).then(a.ratio().total_cmp(&b.ratio()))
        })?;
        let contacts = |kind| runs.iter().map(|run| run.contacts(kind)).sum();
        let some = |value: fn(&Run) -> Option<f64>| {
            let all: Vec<f64> = runs.iter().filter_map(|run| value(run)).collect();
            (!all.is_empty()).then_some(all)
        };
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
            close_share: some(|run| run.close_share).map(mean),
            over_faultless: some(|run| run.over_faultless).map(median),
            rest_after_s: some(|run| run.rest_after_s).map(|all| all.into_iter().fold(0.0, f64::max)),
            cpu_share: some(|run| run.cpu_share).map(median),
            score: some(|run| run.score).map(mean),
            worst: worst.name.clone(),
        })
    }

    fn cells(&self, extras: &[&Extra]) -> Vec<String> {
        let ratio = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |ratio| format!("{ratio:.2}"));
        let mut cells = vec![
            self.scenario.clone(),
            self.driver.name().to_owned(),
            self.runs.to_string(),
            self.reached.to_string(),
            self.untouched.to_string(),
            self.contacts_own.to_string(),
            self.contacts_after_own_motion.to_string(),
            self.contacts_at_rest.to_string(),
            ratio(self.time_over_ideal),
        ];
        cells.extend(extras.iter().map(|(_, value)| ratio(value(self))));
        cells.push(self.worst.clone());
        cells
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
    if !(0.0..=100.0).contains(&args.noise) {
        return Err(Failure::usage(format!("--noise {}: expected 0 to 100 cm", args.noise)));
    }
    if args.suite == Some(Suite::S1) && args.worlds.is_none() {
        return Err(Failure::usage(
            "--suite s1: expected --worlds DIR, a folder of BARN's worlds",
        ));
    }
    let barn = args.worlds.as_deref().map(|folder| (folder, 0.01 * args.noise));
    let mut cases = Vec::new();
    for suite in suites {
        cases.extend(suite.cases(args.seeds, barn)?);
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
    let mut runs = all(&cases, threads)?;
    compare(&mut runs);
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
        let has = |extra: &&Extra| report.rows.iter().any(|row| extra.1(row).is_some());
        let extras: Vec<&Extra> = EXTRAS.iter().filter(has).collect();
        let mut header = vec![
            "SCENARIO",
            "DRIVER",
            "RUNS",
            "REACHED",
            "UNTOUCHED",
            "OWN",
            "AFTER OWN",
            "AT REST",
            "TIME/IDEAL",
        ];
        header.extend(extras.iter().map(|extra| extra.0));
        header.push("WORST");
        let rows: Vec<Vec<String>> = report.rows.iter().map(|row| row.cells(&extras)).collect();
        table(&header, &rows)
    })?;
    Ok(exit_code::OK)
}

fn mean(values: Vec<f64>) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Compares each run that has a fault with the one without it.
fn compare(runs: &mut [Run]) {
    let times: Vec<(String, f64)> = runs
        .iter()
        .filter(|run| run.driver == Driver::Zenav && run.reached())
        .map(|run| (run.name.clone(), run.time_s))
        .collect();
    for run in runs.iter_mut().filter(|run| run.reached()) {
        let faultless = times.iter().find(|(name, _)| Some(name) == run.faultless.as_ref());
        run.over_faultless = faultless.map(|(_, secs)| run.time_s / secs);
    }
}

/// What is seen of a run beside its end.
#[derive(Default)]
struct Watch {
    ticks: u32,
    close: u32,
    rest: Option<f64>,
}

impl Watch {
    /// After every tick; `blind_from` is when the lidar dies, s.
    fn see(&mut self, now: Stamp, truth: &Truth, blind_from: Option<f64>) {
        self.ticks += 1;
        self.close += u32::from(truth.to_person < PERSONAL_SPACE);
        let at_rest = truth.twist.v.abs() + truth.twist.w.abs() < AT_REST;
        let blind_for = blind_from.map(|from| now.as_secs() - from).filter(|secs| *secs >= 0.0);
        self.rest = self.rest.or(blind_for.filter(|_| at_rest));
    }

    fn close_share(&self, case: &Case) -> Option<f64> {
        let people_make_way = case.world.movers().iter().any(|mover| mover.manners != Manners::Blind);
        people_make_way.then(|| f64::from(self.close) / f64::from(self.ticks.max(1)))
    }
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

/// A case, driven by zenav: of several robots, the worst outcome, when the last was done, and everybody's contacts.
fn zenav(
    layers: &Layers,
    case: &Case,
    driver: Driver,
    entrants: Vec<Entrant<'_>>,
    ideal_s: f64,
) -> Result<Run, Failure> {
    let scenario = Scenario {
        world: &case.world,
        entrants,
        seed: Some(case.seed),
        known_map: case.known_map,
        zones: None,
        cloud_delay_ms: DELAY_MS,
        tolerance: case.tolerance,
        profile: None,
        timeout: case.timeout,
    };
    let mut watch = Watch::default();
    let reports = scenario.run(layers, |robot, now, truth| {
        if robot == 0 {
            watch.see(now, truth, case.blind_from);
        }
    })?;
    let outcome = worst(&reports);
    let most = |value: fn(&RunReport) -> f64| reports.iter().map(value).fold(0.0, f64::max);
    let blamed = reports.iter().position(|report| report.outcome == outcome);
    let reason = blamed.and_then(|index| Some((index, reports.get(index)?.reason.clone()?)));
    let time_s = most(|report| report.time_s);
    let cpu_s = reports.iter().map(|report| report.cpu_s).sum::<Option<f64>>();
    let entered = reports
        .iter()
        .map(|report| report.time_entered_s.filter(|_| report.collisions == 0));
    let entered = entered.reduce(|last, entered| Some(last?.max(entered?))).flatten();
    let optimal_s = case
        .optimal
        .map_or(ideal_s, |metres| metres / case.model.drive.top_speed());
    Ok(Run {
        scenario: case.scenario.clone(),
        name: case.name.clone(),
        driver,
        outcome,
        reason: reason.map(|(index, reason)| match reports.len() {
            1 => reason,
            _ => format!("robot {}: {reason}", index + 1),
        }),
        time_s,
        ideal_s,
        length_m: reports.iter().map(|report| report.length_m).sum(),
        min_clearance_m: reports
            .iter()
            .map(|report| report.min_clearance_m)
            .fold(f64::INFINITY, f64::min),
        pose_error_m: Some(most(|report| report.pose_error_m)),
        recoveries: Some(reports.iter().map(|report| report.recoveries).sum()),
        cpu_s,
        close_share: watch.close_share(case),
        faultless: case.faultless.clone(),
        over_faultless: None,
        rest_after_s: watch.rest,
        cpu_share: cpu_s.filter(|_| case.is_costed).map(|cpu| cpu / time_s),
        score: case
            .is_scored
            .then(|| entered.map_or(0.0, |secs| score(optimal_s, secs))),
        contacts: reports.into_iter().flat_map(|report| report.contacts).collect(),
    })
}

/// A case, driven by zenav and by the anchors.
fn one(layers: &Layers, case: &Case) -> Result<Vec<Run>, Failure> {
    let field = Field::new(&case.world, case.model.footprint.inscribed_radius(), case.goal);
    let ideal_s = field.shortest(case.world.start().position()) / case.model.drive.top_speed();
    let others = case.others.iter().map(|other| (other.start, other.goal));
    let all = [(case.world.start(), case.goal)].into_iter().chain(others);
    let entrants: Vec<Entrant<'_>> = all
        .map(|(start, goal)| Entrant {
            robot: Some(case.robot),
            start: Some(start),
            goal,
        })
        .collect();
    let way = |one: &&Entrant<'_>| one.start.map_or(0.0, |start| (start.position() - one.goal).norm());
    let farthest = entrants.iter().max_by(|a, b| way(a).total_cmp(&way(b))).copied();
    let several = entrants.len() > 1;
    let mut runs = vec![zenav(layers, case, Driver::Zenav, entrants, ideal_s)?];
    if let Some(one) = farthest.filter(|_| several) {
        let alone = zenav(layers, case, Driver::Alone, vec![one], ideal_s)?;
        // The price of the others.
        runs.iter_mut().for_each(|together| together.ideal_s = alone.time_s);
        runs.push(alone);
    }
    for anchor in case.anchors {
        let mut watch = Watch::default();
        let driven = anchors::drive(*anchor, case, &field, |now, truth| watch.see(now, truth, None))?;
        let outcome = match () {
            () if driven.referee.own_contact().is_some() => RunOutcome::Collision,
            () if driven.referee.is_reached() => RunOutcome::Reached,
            () => RunOutcome::Timeout,
        };
        runs.push(Run {
            scenario: case.scenario.clone(),
            name: case.name.clone(),
            driver: Driver::Anchor(*anchor),
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
            close_share: watch.close_share(case),
            faultless: None,
            over_faultless: None,
            rest_after_s: None,
            cpu_share: None,
            score: None,
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
        let cases = Suite::S3.cases(Some(1), None).unwrap();
        let case = cases.iter().find(|case| case.name == "crossing-1-jackal-0").unwrap();
        let field = Field::new(&case.world, case.model.footprint.inscribed_radius(), case.goal);
        let drive = |anchor| anchors::drive(anchor, case, &field, |_, _| {}).unwrap();
        let (first, second) = (drive(Anchor::AllKnowing), drive(Anchor::AllKnowing));
        assert_eq!(first.truth, second.truth);
        assert!(first.referee.is_reached() && first.referee.contacts().is_empty());
    }
}
