//! The table: one row for all runs of a scenario with one driver.

use serde::Serialize;

use super::runs::{Driver, Run};
use crate::batch::median;
use crate::lockstep::ContactKind;

/// A row of the table: all runs of a scenario with one driver.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Row {
    pub(super) scenario: String,
    pub(super) driver: Driver,
    runs: usize,
    /// Runs at rest at the goal, without contact by the robot's own motion.
    reached: usize,
    /// Runs also without contact by anything else.
    untouched: usize,
    contacts_own: usize,
    contacts_after_own_motion: usize,
    contacts_at_rest: usize,
    /// Median of the reached runs.
    time_over_ideal: Option<f64>,
    /// Median of the final distance from the goal, for all runs, m.
    final_error_m: Option<f64>,
    /// Mean.
    close_share: Option<f64>,
    /// Median over runs that reached the goal both with and without the fault.
    over_faultless: Option<f64>,
    /// Longest.
    rest_after_s: Option<f64>,
    /// Longest.
    sets_out_after_s: Option<f64>,
    /// Median.
    cpu_share: Option<f64>,
    /// Mean.
    score: Option<f64>,
    /// The worst run: ranked by own contacts, then goal not reached, then contacts, then time.
    worst: String,
}

/// A column that only some suites have.
pub(super) type Extra = (&'static str, fn(&Row) -> Option<f64>);

pub(super) const EXTRAS: [Extra; 7] = [
    ("OFF M", |row| row.final_error_m),
    ("< 0.45 M", |row| row.close_share),
    ("/ NO FAULT", |row| row.over_faultless),
    ("REST S", |row| row.rest_after_s),
    ("SETS OUT S", |row| row.sets_out_after_s),
    ("CPU S/S", |row| row.cpu_share),
    ("SCORE", |row| row.score),
];

impl Row {
    pub(super) fn of(runs: &[&Run]) -> Option<Self> {
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
            final_error_m: some(|run| run.final_error_m).map(median),
            close_share: some(|run| run.close_share).map(mean),
            over_faultless: some(|run| run.over_faultless).map(median),
            rest_after_s: some(|run| run.rest_after_s).map(longest),
            sets_out_after_s: some(|run| run.sets_out_after_s).map(longest),
            cpu_share: some(|run| run.cpu_share).map(median),
            score: some(|run| run.score).map(mean),
            worst: worst.name.clone(),
        })
    }

    pub(super) fn cells(&self, extras: &[&Extra]) -> Vec<String> {
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

fn longest(values: Vec<f64>) -> f64 {
    values.into_iter().fold(0.0, f64::max)
}

fn mean(values: Vec<f64>) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
