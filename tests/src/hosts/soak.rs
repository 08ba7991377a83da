//! Soak. Whether the parts of a deployment keep their size while three robots drive from goal to goal under faults for a long time.

use std::time::{Duration, Instant};

use rand::seq::IndexedRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::trial::{Fault, Findings, Weight};
use crate::usage::Held;

/// Bytes of a MiB.
const MIB: f64 = 1024.0 * 1024.0;
/// Seconds of an hour.
const HOUR: f64 = 3600.0;
/// Fewest faults in a third of a run: fewer do not show growth.
const FEWEST: usize = 5;

/// Parts that run from beginning to end, so that growth shows in their resources.
const LASTING: [&str; 5] = [
    "fleet-a-router",
    "fleet-a-motion",
    "fleet-a-mission",
    "fleet-a-mapping",
    "robot-a-edge-anna",
];
/// Parts that are killed and replaced.
const REPLACED: [&str; 7] = [
    "fleet-b-router",
    "fleet-b-motion",
    "fleet-b-mission",
    "fleet-b-mapping",
    "fleet-b-gateway",
    "robot-b-edge-bert",
    "robot-c-edge-carl",
];
/// Parts whose host is cut off, each with its robot.
const CUT: [(&str, &str); 3] = [
    ("robot-a-edge-anna", "anna"),
    ("robot-b-edge-bert", "bert"),
    ("robot-c-edge-carl", "carl"),
];
/// Longest freeze, s of the world's time.
const FREEZE: u32 = 4;

/// Faults in a random order, for a duration of `time`.
pub fn faults(time: Duration, seed: u64) -> impl Iterator<Item = Fault> + Send {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let end = Instant::now() + time;
    std::iter::from_fn(move || {
        let fault = match random.random_range(0..4) {
            0 => Fault::Kill(REPLACED.choose(&mut random)?),
            1 => Fault::Update(REPLACED.choose(&mut random)?),
            2 => {
                let (part, robot) = CUT.choose(&mut random)?;
                Fault::Cut(part, robot)
            }
            _ => {
                let part = if random.random() {
                    LASTING.choose(&mut random)?
                } else {
                    REPLACED.choose(&mut random)?
                };
                Fault::Pause(part, random.random_range(1..=FREEZE))
            }
        };
        (Instant::now() < end).then_some(fault)
    })
}

/// Resources of a lasting part in the second third of a run and in the last; in the first it settles.
#[derive(Clone, Debug)]
pub struct Growth {
    /// The part.
    pub part: &'static str,
    /// Medians of the second third and of the last.
    pub held: [Held; 2],
    /// Messages and requests that wait to be read: the same medians.
    pub waiting: [u64; 2],
    /// Slope of the line that fits the resident memory of both thirds best (least squares), MiB an hour.
    pub hourly: f64,
    /// Processor time per second of wall time.
    pub cores: f64,
}

impl Growth {
    /// Resident memory in the second third and in the last, MiB.
    #[must_use]
    pub fn memory(&self) -> [f64; 2] {
        self.held.map(|held| held.memory as f64 / MIB)
    }

    /// Whether it has not grown by more than a tenth and 2 MiB, from the second third to the last and in an hour, nor by more than 4 handles,
    /// 2 threads and 4 waiting messages.
    #[must_use]
    pub fn is_flat(&self) -> bool {
        let ([then, now], [before, after]) = (self.memory(), self.held);
        let most = 0.1 * then + 2.0;
        now - then <= most
            && self.hourly <= most
            && after.handles <= before.handles + 4
            && after.threads <= before.threads + 2
            && self.waiting[1] <= self.waiting[0] + 4
    }
}

/// Growth of all lasting parts.
///
/// # Errors
/// A lasting part that was restarted or does not tell how many messages wait, or a run that is too short.
pub fn growth(findings: &Findings) -> Result<Vec<Growth>, String> {
    let third = findings.rows.len() / 3;
    if third < FEWEST {
        return Err(format!(
            "{} faults: at least {} are expected",
            findings.rows.len(),
            3 * FEWEST
        ));
    }
    let of = |part: &'static str| {
        let all = findings.held.get(part).map_or(&[][..], |(_, all)| all);
        if all.len() < findings.rows.len() {
            return Err(format!("{part} was started anew"));
        }
        let thirds = [1, 2].map(|nth| &all[nth * third..(nth + 1) * third]);
        let waiting: Vec<u64> = all
            .iter()
            .map(|weight| weight.waiting.clone())
            .collect::<Result<_, _>>()
            .map_err(|error| format!("{part}: {error}"))?;
        let cores = match all {
            [first, .., last] => (last.held.cpu_secs - first.held.cpu_secs) / (last.secs - first.secs),
            _ => 0.0,
        };
        Ok(Growth {
            part,
            held: thirds.map(medians),
            waiting: [1, 2].map(|nth| median(waiting[nth * third..(nth + 1) * third].to_vec())),
            hourly: hourly(&all[third..]),
            cores,
        })
    };
    LASTING.into_iter().map(of).collect()
}

/// Slope of the least-squares line through the resident memory over time, MiB an hour.
fn hourly(all: &[Weight]) -> f64 {
    let points = || all.iter().map(|weight| (weight.secs, weight.held.memory as f64 / MIB));
    let count = all.len() as f64;
    let (secs, memory) = points().fold((0.0, 0.0), |sums, point| (sums.0 + point.0, sums.1 + point.1));
    let from_mean = || points().map(move |point| (point.0 - secs / count, point.1 - memory / count));
    let covariance: f64 = from_mean().map(|(secs, memory)| secs * memory).sum();
    let variance: f64 = from_mean().map(|(secs, _)| secs * secs).sum();
    HOUR * covariance / variance
}

fn medians(all: &[Weight]) -> Held {
    let of = |field: fn(&Held) -> u64| median(all.iter().map(|weight| field(&weight.held)).collect());
    Held {
        memory: of(|held| held.memory),
        handles: of(|held| held.handles),
        threads: of(|held| held.threads),
        cpu_secs: all.last().map_or(0.0, |weight| weight.held.cpu_secs),
    }
}

fn median(mut values: Vec<u64>) -> u64 {
    values.sort_unstable();
    values[values.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half an hour, a minute a fault, in which every part grows by so much a minute.
    fn growing(bytes: u64, messages: u64) -> Findings {
        let mut findings = Findings::default();
        for nth in 0..30 {
            let now = Held {
                memory: 40 * 1024 * 1024 + nth * bytes,
                handles: 20,
                threads: 8,
                cpu_secs: nth as f64,
            };
            for part in LASTING {
                findings
                    .held
                    .entry(part.to_owned())
                    .or_insert((1, Vec::new()))
                    .1
                    .push(Weight {
                        secs: 60.0 * nth as f64,
                        held: now,
                        waiting: Ok(nth * messages),
                    });
            }
            findings.rows.push(super::super::trial::Row {
                fault: Fault::Kill(REPLACED[0]),
                rest: 0.0,
                robot: String::new(),
                took: 1.0,
            });
        }
        findings
    }

    #[test]
    fn what_grows_by_more_than_a_tenth_in_an_hour_is_seen_in_half_of_it() {
        let mib = |parts: &[Growth]| parts[0].memory()[1] - parts[0].memory()[0];
        let [flat, slow, fast] = [80_000, 300_000, 1_000_000].map(|bytes| growth(&growing(bytes, 0)).unwrap());
        assert!(flat.iter().all(Growth::is_flat), "{flat:?}");
        assert!(mib(&slow) < 3.0 && !slow.iter().any(Growth::is_flat), "{slow:?}");
        assert!(mib(&fast) > 9.0 && !fast.iter().any(Growth::is_flat), "{fast:?}");
        assert!((slow[0].hourly - 300_000.0 * 60.0 / MIB).abs() < 1e-6, "{slow:?}");
    }

    #[test]
    fn what_flickers_does_not_grow() {
        let mut findings = growing(0, 0);
        for (_, all) in findings.held.values_mut() {
            for (nth, weight) in all.iter_mut().enumerate() {
                weight.held.memory += (nth as u64 % 3) * 1024 * 1024;
                weight.waiting = Ok(nth as u64 % 3);
            }
        }
        let flickers = growth(&findings).unwrap();
        assert!(flickers.iter().all(Growth::is_flat), "{flickers:?}");
    }

    #[test]
    fn a_queue_that_grows_is_seen_and_one_that_nobody_tells_is_an_error() {
        let mut findings = growing(0, 1);
        assert!(!growth(&findings).unwrap().iter().any(Growth::is_flat));
        for (_, all) in findings.held.values_mut() {
            all[20].waiting = Err("no metrics".to_owned());
        }
        assert!(growth(&findings).unwrap_err().contains("no metrics"));
    }

    #[test]
    fn the_same_seed_gives_the_same_faults() {
        let hour = Duration::from_secs(3600);
        let some = |seed| faults(hour, seed).take(50).collect::<Vec<_>>();
        assert_eq!(some(1), some(1));
        assert_ne!(some(1), some(2));
    }
}
