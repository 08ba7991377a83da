//! Runs: every case driven by zenav and by the anchors, and the results kept.

use serde::Serialize;
use tracing::subscriber::{NoSubscriber, with_default};
use zenav_protocol::time::Stamp;
use zenav_reference_drivers::{Field, Method};
use zenav_sim::Truth;
use zenav_sim::manners::Manners;

use super::super::anchors;
use super::super::suites::{Case, score};
use crate::batch::progress;
use crate::config::Layers;
use crate::failure::Failure;
use crate::lockstep::{ContactKind, ContactReport, Entrant, RunOutcome, RunReport, Scenario, worst};
use crate::parallel;

/// Mean delay from scan to plan, ms.
const DELAY_MS: f64 = 100.0;
/// Intimate distance, in which people do not like a robot (Hall, "The Hidden Dimension", 1966), m.
const INTIMATE_DISTANCE: f64 = 0.45;
/// Below this a robot is at rest, m/s and rad/s.
const AT_REST: f64 = 0.01;
/// Above this a robot has set out, m/s and rad/s.
const SETS_OUT: f64 = 0.05;

/// Driver of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Driver {
    Zenav,
    /// The robot with the longest way to its goal, without other robots in the world.
    Alone,
    #[serde(untagged)]
    Anchor(Method),
}

impl Driver {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Zenav => "zenav",
            Self::Alone => "zenav, alone",
            Self::Anchor(Method::Standing) => "window, standing",
            Self::Anchor(Method::ConstantVelocity) => "window, velocities",
            Self::Anchor(Method::Orca) => "orca",
            Self::Anchor(Method::AllKnowing) => "all-knowing A*",
        }
    }
}

/// One run.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Run {
    pub(super) scenario: String,
    pub(super) name: String,
    pub(super) driver: Driver,
    pub(super) outcome: RunOutcome,
    pub(super) reason: Option<String>,
    pub(super) time_s: f64,
    /// Length of the shortest path of the inscribed disc over the top speed, s; for several robots, the time that the robot with the
    /// longest way to its goal takes alone.
    pub(super) ideal_s: f64,
    pub(super) length_m: f64,
    pub(super) min_clearance_m: f64,
    pub(super) contacts: Vec<ContactReport>,
    /// Final distance from the goal.
    pub(super) final_error_m: Option<f64>,
    /// zenav only: final error of the pose estimate.
    pub(super) pose_error_m: Option<f64>,
    pub(super) recoveries: Option<u64>,
    /// zenav only: processor time of robot, mapper, mission and motion, s.
    pub(super) cpu_s: Option<f64>,
    /// Share of the time with a person within 0.45 m of the outline, if people make way.
    pub(super) close_share: Option<f64>,
    /// With a broken sensor: the run without the fault, and the ratio of this run's time to that one's, if both arrived.
    pub(super) faultless: Option<String>,
    pub(super) over_faultless: Option<f64>,
    /// If the lidar dies: time from then until the robot is at rest, s.
    pub(super) rest_after_s: Option<f64>,
    /// If the robot waits at rest for an obstacle: time from the start of the obstacle's departure until the robot sets out, s.
    pub(super) sets_out_after_s: Option<f64>,
    /// zenav only, in suites that measure cost: processor time per second driven, s/s.
    pub(super) cpu_share: Option<f64>,
    /// BARN score, 0 to 0.5.
    pub(super) score: Option<f64>,
}

impl Run {
    pub(super) fn reached(&self) -> bool {
        self.outcome == RunOutcome::Reached
    }

    pub(super) fn contacts(&self, kind: ContactKind) -> usize {
        self.contacts.iter().filter(|contact| contact.kind == kind).count()
    }

    pub(super) fn ratio(&self) -> f64 {
        self.time_s / self.ideal_s
    }
}

/// Compares each run that has a fault with the run without it.
pub(super) fn compare(runs: &mut [Run]) {
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

/// Observations during a run.
#[derive(Default)]
struct Watch {
    ticks: u32,
    close: u32,
    rest: Option<f64>,
    /// Whether the robot was at rest when the obstacle started to leave.
    waited: Option<bool>,
    set_out: Option<f64>,
}

impl Watch {
    /// Call after every tick of zenav.
    fn see(&mut self, now: Stamp, truth: &Truth, case: &Case) {
        self.see_people(truth);
        let since = |from: Option<f64>| from.map(|from| now.as_secs() - from).filter(|secs| *secs >= 0.0);
        let speed = truth.twist.v.abs() + truth.twist.w.abs();
        self.rest = self.rest.or(since(case.blind_from).filter(|_| speed < AT_REST));
        if let Some(secs) = since(case.leaves_at) {
            let waited = *self.waited.get_or_insert(speed < AT_REST);
            self.set_out = self.set_out.or((waited && speed > SETS_OUT).then_some(secs));
        }
    }

    /// Call after every tick of any driver.
    fn see_people(&mut self, truth: &Truth) {
        self.ticks += 1;
        self.close += u32::from(truth.to_person < INTIMATE_DISTANCE);
    }

    fn close_share(&self, case: &Case) -> Option<f64> {
        let people_make_way = case.world.movers().iter().any(|mover| mover.manners != Manners::Blind);
        people_make_way.then(|| f64::from(self.close) / f64::from(self.ticks.max(1)))
    }
}

/// Runs all cases, one per thread; the results are in the order of the cases.
pub(super) fn all(cases: &[Case], threads: usize) -> Result<Vec<Run>, Failure> {
    let layers = Layers::load(None)?;
    let bar = progress(cases.len());
    let done = parallel::in_order(cases.len(), threads, |index| {
        // The logs of hundreds of missions are of no use here.
        let runs = with_default(NoSubscriber::default(), || one(&layers, &cases[index]));
        bar.inc(1);
        runs
    });
    bar.finish_and_clear();
    let runs: Vec<Vec<Run>> = done.into_iter().collect::<Result<_, Failure>>()?;
    Ok(runs.into_iter().flatten().collect())
}

/// A case driven by zenav; for several robots, the worst outcome, the time of the last one, and the contacts of all.
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
        poses: case.poses,
        zones: None,
        cloud_delay_ms: DELAY_MS,
        tolerance: case.tolerance,
        profile: None,
        timeout: case.timeout,
    };
    let mut watch = Watch::default();
    let reports = scenario.prepare(layers)?.run(None, |robot, now, truth| {
        if robot == 0 {
            watch.see(now, truth, case);
        }
    });
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
        final_error_m: Some(most(|report| report.final_error_m)),
        pose_error_m: Some(most(|report| report.pose_error_m)),
        recoveries: Some(reports.iter().map(|report| report.recoveries).sum()),
        cpu_s,
        close_share: watch.close_share(case),
        faultless: case.faultless.clone(),
        over_faultless: None,
        rest_after_s: watch.rest,
        sets_out_after_s: watch.set_out,
        cpu_share: cpu_s.filter(|_| case.is_costed).map(|cpu| cpu / time_s),
        score: case
            .is_scored
            .then(|| entered.map_or(0.0, |secs| score(optimal_s, secs))),
        contacts: reports.into_iter().flat_map(|report| report.contacts).collect(),
    })
}

/// A case driven by zenav and by the anchors.
fn one(layers: &Layers, case: &Case) -> Result<Vec<Run>, Failure> {
    let field = Field::new(&case.world, case.model.footprint.inscribed_radius(), case.goal);
    let ideal_s = field.shortest(case.world.start().position()) / case.model.drive.top_speed();
    let others = case.others.iter().map(|other| (other.start, other.goal));
    let all = [(case.world.start(), case.goal)].into_iter().chain(others);
    let entrants: Vec<Entrant<'_>> = all
        .map(|(start, goal)| Entrant {
            robot: Some(&case.robot),
            start: Some(start),
            goal,
        })
        .collect();
    let several = entrants.len() > 1;
    // The robot with the longest way.
    let ways = entrants.iter().filter(|_| several).map(|one| {
        let field = Field::new(&case.world, case.model.footprint.inscribed_radius(), one.goal);
        let way = one.start.map_or(0.0, |start| field.shortest(start.position()));
        (way, *one)
    });
    let farthest = ways.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, one)| one);
    let mut runs = vec![zenav(layers, case, Driver::Zenav, entrants, ideal_s)?];
    if let Some(one) = farthest {
        let alone = zenav(layers, case, Driver::Alone, vec![one], ideal_s)?;
        // The ratio then shows the cost of the other robots.
        runs.iter_mut().for_each(|together| together.ideal_s = alone.time_s);
        runs.push(alone);
    }
    for method in case.anchors {
        let mut watch = Watch::default();
        let driven = anchors::drive(*method, case, &field, |_, truth| watch.see_people(truth))?;
        let outcome = match () {
            () if driven.referee.own_contact().is_some() => RunOutcome::Collision,
            () if driven.referee.is_reached() => RunOutcome::Reached,
            () => RunOutcome::Timeout,
        };
        runs.push(Run {
            scenario: case.scenario.clone(),
            name: case.name.clone(),
            driver: Driver::Anchor(*method),
            outcome,
            reason: None,
            time_s: driven.time_s,
            ideal_s,
            length_m: driven.truth.length,
            min_clearance_m: driven.truth.min_clearance,
            contacts: driven.referee.contacts().to_vec(),
            final_error_m: Some(driven.referee.error()),
            pose_error_m: None,
            recoveries: None,
            cpu_s: None,
            close_share: watch.close_share(case),
            faultless: None,
            over_faultless: None,
            rest_after_s: None,
            sets_out_after_s: None,
            cpu_share: None,
            score: None,
        });
    }
    Ok(runs)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::super::super::suites::Suite;
    use super::*;

    #[test]
    fn a_case_goes_alike_twice_and_anchors_that_know_more_reach_the_goal() {
        let cases = Suite::S3.cases(&[], 0, Some(1), None).unwrap();
        let case = cases.iter().find(|case| case.name == "crossing-1-jackal-0").unwrap();
        let field = Field::new(&case.world, case.model.footprint.inscribed_radius(), case.goal);
        let drive = |method| anchors::drive(method, case, &field, |_, _| {}).unwrap();
        let (first, second) = (drive(Method::AllKnowing), drive(Method::AllKnowing));
        assert_eq!(first.truth, second.truth);
        assert!(first.referee.is_reached() && first.referee.contacts().is_empty());
    }
}
