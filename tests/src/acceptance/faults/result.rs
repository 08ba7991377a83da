//! Result. The findings of one row, and the promises and limits that it missed.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::rows::Row;
use crate::acceptance::tracking::percentile;

/// Limit of the 95th percentile of the times from healing until the robot drives again, s.
const MOST_RESUME: f64 = 1.5;

/// Memory of a part, MiB.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Memory {
    /// Name of the part.
    pub part: String,
    /// After the first mission, if the same process ran until the end and further missions followed.
    pub settled: Option<f64>,
    /// At the end.
    pub end: f64,
}

impl Memory {
    /// Whether it has grown by more than a tenth and 2 MiB since the first mission.
    fn has_grown(&self) -> bool {
        self.settled.is_some_and(|settled| self.end > 1.1 * settled + 2.0)
    }
}

/// Mean time of a row's missions, as a multiple of that without a fault.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Slowdown {
    /// The multiple.
    pub times: f64,
    /// Its limit.
    pub most: f64,
}

/// The results of a row.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Result {
    /// Its name.
    pub name: String,
    /// Numbers of acknowledged and of succeeded missions.
    pub missions: (usize, usize),
    /// Acknowledged goals that the mission no longer knows.
    pub lost: usize,
    /// Contacts.
    pub collisions: usize,
    /// Motion without a valid horizon.
    pub invalid: Vec<String>,
    /// Times from healing until the robot drove again, s; zero if it had not come to rest.
    pub resumes: Vec<f64>,
    /// Wall time of each mission, s.
    pub secs: Vec<f64>,
    /// Share of this time in which the robot did not drive.
    pub rest: f64,
    /// Its missions compared with those without a fault, if that is limited.
    pub slowdown: Option<Slowdown>,
    /// Memory of each part.
    pub memory: Vec<Memory>,
    /// Number of flood messages.
    pub flooded: usize,
    /// Other failures.
    pub failures: Vec<String>,
}

impl Result {
    /// Whether the contract and all limits held.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.missed().is_empty()
    }

    /// Adds what was found in another run of the row; its memory counts.
    pub fn add(&mut self, other: Self) {
        let secs = |result: &Self| result.secs.iter().fold(0.0, |sum, secs| sum + secs);
        let (before, more) = (secs(self), secs(&other));
        if before + more > 0.0 {
            self.rest = (before * self.rest + more * other.rest) / (before + more);
        }
        let (asked, succeeded) = other.missions;
        self.missions = (self.missions.0 + asked, self.missions.1 + succeeded);
        self.lost += other.lost;
        self.collisions += other.collisions;
        self.flooded += other.flooded;
        self.invalid.extend(other.invalid);
        self.resumes.extend(other.resumes);
        self.secs.extend(other.secs);
        self.failures.extend(other.failures);
        self.memory = other.memory;
    }

    /// Median and 95th percentile of the resume times, s.
    #[must_use]
    pub fn resume(&self) -> Option<(f64, f64)> {
        let mut resumes = self.resumes.clone();
        let found = (percentile(&mut resumes, 0.5), percentile(&mut resumes, 0.95));
        (!resumes.is_empty()).then_some(found)
    }

    /// Mean time of a mission, s.
    #[must_use]
    pub fn mean_secs(&self) -> f64 {
        let sum = self.secs.iter().fold(0.0, |sum, secs| sum + secs);
        sum / (self.secs.len().max(1) as f64)
    }

    /// What the row missed: promises of the contract, and limits.
    #[must_use]
    pub fn missed(&self) -> Vec<String> {
        let mut missed = self.failures.clone();
        let (asked, succeeded) = self.missions;
        if asked == 0 || succeeded < asked {
            missed.push(format!("{succeeded} of {asked} missions succeeded"));
        }
        if self.lost > 0 {
            missed.push(format!("{} goals lost", self.lost));
        }
        if self.collisions > 0 {
            missed.push(format!("{} collisions", self.collisions));
        }
        missed.extend(self.invalid.first().cloned());
        if let Some((_, p95)) = self.resume().filter(|(_, p95)| *p95 >= MOST_RESUME) {
            missed.push(format!(
                "it drives again after {p95:.2} s (p95), expected less than {MOST_RESUME} s"
            ));
        }
        if let Some(Slowdown { times, most }) = self.slowdown.filter(|slowdown| slowdown.times > slowdown.most) {
            missed.push(format!(
                "missions take {times:.2} times as long as without a fault, expected at most {most}"
            ));
        }
        for Memory { part, settled, end } in self.memory.iter().filter(|memory| memory.has_grown()) {
            let settled = settled.unwrap_or_default();
            missed.push(format!(
                "{part} grows from {settled:.0} to {end:.0} MiB, expected at most a tenth and 2 MiB more"
            ));
        }
        missed
    }
}

/// Compares the missions of rows with those without a fault, where their time is limited.
pub fn compare(rows: &[Row], found: &mut [Result]) {
    let means: BTreeMap<String, f64> = found
        .iter()
        .filter(|result| !result.secs.is_empty())
        .map(|result| (result.name.clone(), result.mean_secs()))
        .collect();
    for (row, result) in rows.iter().zip(found) {
        let unimpaired = row.compared_with().and_then(|name| means.get(&name));
        result.slowdown = unimpaired.zip(row.most_slowdown()).and_then(|(unimpaired, most)| {
            let times = means.get(&row.name)? / unimpaired;
            Some(Slowdown { times, most })
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acceptance::faults::all;

    fn good(name: &str) -> Result {
        Result {
            name: name.to_owned(),
            missions: (2, 2),
            secs: vec![10.0, 11.0],
            ..Result::default()
        }
    }

    #[track_caller]
    fn assert_missed(result: &Result, what: &str) {
        let missed = result.missed();
        assert!(missed.len() == 1 && missed[0].contains(what), "{what}: {missed:?}");
        assert!(!result.is_good());
    }

    #[test]
    fn every_promise_and_every_limit_is_judged_by_itself() {
        let row = good("depot: cuts of 5 s");
        assert!(row.is_good(), "{:?}", row.missed());
        let slow = Slowdown { times: 1.3, most: 1.2 };
        let part = |settled, end| Memory {
            part: "router".to_owned(),
            settled,
            end,
        };
        for (missing, what) in [
            (
                Result {
                    missions: (2, 1),
                    ..row.clone()
                },
                "1 of 2 missions",
            ),
            (
                Result {
                    missions: (0, 0),
                    ..row.clone()
                },
                "0 of 0 missions",
            ),
            (Result { lost: 1, ..row.clone() }, "1 goals lost"),
            (
                Result {
                    collisions: 1,
                    ..row.clone()
                },
                "1 collisions",
            ),
            (
                Result {
                    invalid: vec!["it moves".to_owned()],
                    ..row.clone()
                },
                "it moves",
            ),
            (
                Result {
                    failures: vec!["router has ended".to_owned()],
                    ..row.clone()
                },
                "router has ended",
            ),
            (
                Result {
                    resumes: vec![0.0, 0.3, 1.6],
                    ..row.clone()
                },
                "after 1.60 s (p95)",
            ),
            (
                Result {
                    slowdown: Some(slow),
                    ..row.clone()
                },
                "1.30 times",
            ),
            (
                Result {
                    memory: vec![part(Some(30.0), 36.0)],
                    ..row.clone()
                },
                "router grows from 30 to 36 MiB",
            ),
        ] {
            assert_missed(&missing, what);
        }
        let within = Result {
            resumes: vec![0.0, 1.4],
            slowdown: Some(Slowdown { times: 1.1, ..slow }),
            memory: vec![part(Some(30.0), 34.0), part(None, 90.0)],
            ..row
        };
        assert!(within.is_good(), "{:?}", within.missed());
    }

    #[test]
    fn the_runs_of_a_row_count_together() {
        let mut found = Result::default();
        for (rest, succeeded) in [(0.1, 2), (0.4, 1)] {
            let row = good("kitchen: started in each of 120 orders");
            found.add(Result {
                missions: (2, succeeded),
                rest,
                ..row
            });
        }
        assert_eq!((found.missions, found.secs.len()), ((4, 3), 4));
        assert!((found.rest - 0.25).abs() < 1e-9, "{}", found.rest);
        assert_missed(&found, "3 of 4 missions");
    }

    #[test]
    fn missions_over_a_second_and_over_two_are_compared_with_those_of_their_world() {
        let rows = all();
        let mut found: Vec<Result> = rows.iter().map(|row| good(&row.name)).collect();
        for result in found
            .iter_mut()
            .filter(|result| result.name.starts_with("kitchen: round trip"))
        {
            result.secs = vec![21.0];
        }
        compare(&rows, &mut found);
        let missed: Vec<&str> = found
            .iter()
            .filter(|result| !result.is_good())
            .map(|result| &*result.name)
            .collect();
        assert_eq!(
            missed,
            [
                "kitchen: round trip 1000 ms",
                "kitchen: round trip 1000 ms, policy `stop`",
                "kitchen: round trip 1000 ms, mTLS",
            ]
        );
        let limited = found.iter().filter(|result| result.slowdown.is_some()).count();
        assert_eq!(
            limited, 12,
            "two round trips, two worlds, two policies; and with identities"
        );
        assert!(limited < found.len());
    }
}
