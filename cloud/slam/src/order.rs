//! Order. In which order were the scans of a log driven, if their stamps go back in time?
//!
//! Recorders write late arrivals: a few scans whose stamps go back have no place in the drive, and the others still have. Clocks are set: then
//! half of a log goes back. Odometry tells which order was driven, that of the log or that of the stamps: it jumps in the other one. If it jumps
//! in both, it began anew with the clock, and the order is that of the log.

use thiserror::Error;
use zenav_protocol::geometry::wrap_angle;
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;

/// Scans that go back are late arrivals if there are at most this many, or at most one in [`ONE_IN`].
const FEW: usize = 5;
const ONE_IN: usize = 20;
/// Odometry jumps in the order of the log if its path is shorter by this factor in that of the stamps.
const SHORTER: f64 = 0.999;
/// A step by odometry is no jump up to this many times the largest one between scans of the log whose stamps do not go back.
const ORDINARY: f64 = 2.0;
/// A clock is set at most once for this many scans.
const RUN: usize = 20;

/// A log in the order in which it was driven; equal stamps are allowed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ordered {
    /// The scans in time order.
    pub scans: Vec<Scan>,
    /// Number of skipped scans.
    pub skipped: usize,
    /// Number, from 1, and stamp, s, of the first skipped scan.
    pub first_skipped: Option<(usize, f64)>,
    /// What was done about stamps that go back too often to be skipped.
    pub mended: Option<Mended>,
}

/// A log whose stamps go back, with all of its scans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mended {
    /// Number, from 1, of the first scan whose stamp is before that of the scan before it.
    pub number: usize,
    /// The stamps of these two scans, s: the earlier one in the log first.
    pub stamps: (f64, f64),
    /// How often a stamp is before the one before it.
    pub times: usize,
    /// Whether the scans were sorted by their stamps. Otherwise they follow each other as in the log, and after each time the clock was set
    /// back their stamps were moved ahead, to run on from there.
    pub is_sorted: bool,
}

/// Most scans of a log go back in time.
#[derive(Clone, Debug, PartialEq, Error)]
#[error(
    "{skipped} of {scans} scans go back in time, the first of them scan {number} at {stamp:.6} s: sort the log by its stamps"
)]
pub struct Disorder {
    /// Scans of the log.
    pub scans: usize,
    /// Scans that would have to be skipped.
    pub skipped: usize,
    /// Number, from 1, of the first of them.
    pub number: usize,
    /// Its stamp, s.
    pub stamp: f64,
}

/// Puts the scans of a log in order.
///
/// - If the stamps of a few go back, the fewest are skipped such that none does; of two candidates, the later one in the log. A single
///   stamp far ahead is itself skipped, not all that follow it.
/// - If many go back, all scans are kept: in the order of their stamps if odometry jumps in that of the log, and not in theirs; otherwise in
///   that of the log, if the clock was set back a few times. Stamps then run on from where it was set back.
///
/// Cost: n log n.
///
/// ```
/// # use zenav_fixtures::scan;
/// # use zenav_protocol::{geometry::Pose2, messages::Scan};
/// # use zenav_slam::{Disorder, in_order};
/// # let at = |stamps: &[u64]| stamps.iter().map(|ns| scan(*ns, Pose2::IDENTITY, vec![1.0])).collect::<Vec<_>>();
/// // The clock of the third scan was ahead.
/// let ordered = in_order(at(&[1, 2, 9, 3, 4]))?;
/// assert_eq!((ordered.scans.len(), ordered.skipped), (4, 1));
/// assert_eq!(ordered.first_skipped.map(|(number, _)| number), Some(3), "counted from 1");
/// let backwards = in_order(at(&[5, 4, 3, 2, 1])).unwrap_err();
/// assert_eq!((backwards.scans, backwards.skipped), (5, 4));
/// // The clock was set back in the middle of the log.
/// let stamps: Vec<u64> = (100..130).chain(0..30).collect();
/// let ordered = in_order(at(&stamps))?;
/// assert_eq!((ordered.scans.len(), ordered.scans[30].stamp.0, ordered.mended.unwrap().number), (60, 130, 31));
/// # Ok::<(), Disorder>(())
/// ```
///
/// # Errors
/// [`Disorder`] if fewer than half of the scans would be left, and nothing says how they were driven.
pub fn in_order(log: Vec<Scan>) -> Result<Ordered, Disorder> {
    let is_kept = longest_order(&log);
    let all = log.len();
    let skipped = is_kept.iter().filter(|is_kept| !**is_kept).count();
    let is_few = skipped <= FEW || ONE_IN * skipped <= all;
    if !is_few && let Some(ordered) = mended(&log) {
        return Ok(ordered);
    }
    let first = is_kept.iter().position(|is_kept| !is_kept);
    let first_skipped = first.map(|index| (index + 1, log[index].stamp.as_secs()));
    match first_skipped {
        Some((number, stamp)) if 2 * skipped > all => Err(Disorder {
            scans: all,
            skipped,
            number,
            stamp,
        }),
        _ => {
            let kept = log.into_iter().zip(is_kept).filter(|(_, is_kept)| *is_kept);
            Ok(Ordered {
                scans: kept.map(|(scan, _)| scan).collect(),
                skipped,
                first_skipped,
                mended: None,
            })
        }
    }
}

/// All scans, in the order that odometry confirms; `None` if it confirms none.
fn mended(log: &[Scan]) -> Option<Ordered> {
    let back: Vec<usize> = (1..log.len())
        .filter(|index| log[*index].stamp < log[index - 1].stamp)
        .collect();
    let first = *back.first()?;
    let mut by_stamp: Vec<&Scan> = log.iter().collect();
    by_stamp.sort_by_key(|scan| scan.stamp);
    let logged: Vec<&Scan> = log.iter().collect();
    let unbroken = log.windows(2).filter(|pair| pair[0].stamp <= pair[1].stamp);
    let largest = unbroken.map(|pair| step(&pair[0], &pair[1])).fold(0.0, f64::max);
    let jumps = |pair: &[&Scan]| step(pair[0], pair[1]) > ORDINARY * largest;
    let is_sorted = path(&by_stamp) < SHORTER * path(&logged) && !by_stamp.windows(2).any(jumps);
    let scans = if is_sorted {
        by_stamp.into_iter().cloned().collect()
    } else if RUN * (back.len() + 1) <= log.len() {
        run_on(log)
    } else {
        return None;
    };
    Some(Ordered {
        scans,
        skipped: 0,
        first_skipped: None,
        mended: Some(Mended {
            number: first + 1,
            stamps: (log[first - 1].stamp.as_secs(), log[first].stamp.as_secs()),
            times: back.len(),
            is_sorted,
        }),
    })
}

/// Way and turn by odometry through all scans, m and rad together.
fn path(scans: &[&Scan]) -> f64 {
    scans.windows(2).map(|pair| step(pair[0], pair[1])).sum()
}

/// Way and turn by odometry between two scans, m and rad together.
fn step(before: &Scan, scan: &Scan) -> f64 {
    let (a, b) = (before.odom_from_base, scan.odom_from_base);
    a.distance(&b) + wrap_angle(b.yaw - a.yaw).abs()
}

/// The scans with stamps that run on where the clock was set back: as long after the scan before as that one came after its own.
fn run_on(log: &[Scan]) -> Vec<Scan> {
    let (mut ahead, mut pause) = (0_u64, 0_u64);
    let mut before: Option<Stamp> = None;
    let stamps = log.iter().map(|scan| {
        let now = scan.stamp.0;
        match before.replace(scan.stamp) {
            Some(Stamp(last)) if now < last => ahead = ahead.saturating_add(last - now).saturating_add(pause),
            Some(Stamp(last)) => pause = now - last,
            None => {}
        }
        Scan {
            stamp: Stamp(now.saturating_add(ahead)),
            ..scan.clone()
        }
    });
    stamps.collect()
}

/// Marks the longest sequence whose stamps do not go back: patience sorting, from the end of the log.
fn longest_order(log: &[Scan]) -> Vec<bool> {
    // For each length, the first scan of the sequence that starts latest; and the successor of each scan.
    let (mut heads, mut next) = (Vec::<usize>::new(), vec![None; log.len()]);
    for index in (0..log.len()).rev() {
        let length = heads.partition_point(|head| log[*head].stamp >= log[index].stamp);
        next[index] = length.checked_sub(1).map(|shorter| heads[shorter]);
        match heads.get_mut(length) {
            Some(head) => *head = index,
            None => heads.push(index),
        }
    }
    let mut is_kept = vec![false; log.len()];
    let mut at = heads.last().copied();
    while let Some(index) = at {
        is_kept[index] = true;
        at = next[index];
    }
    is_kept
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_fixtures::scan;
    use zenav_protocol::geometry::Pose2;

    use super::*;

    #[test]
    fn two_drives_between_which_clock_and_odometry_began_anew_stay_in_the_order_of_the_log() {
        let drive = |begin: u64, steps: u64| {
            (0..steps).map(move |step| {
                let pose = Pose2::new(0.1 * step as f64, 0.0, 0.0);
                scan(begin + 100_000_000 * step, pose, vec![1.0])
            })
        };
        // Odometry goes back by 20 m in this order, and by 8 m in that of the stamps.
        let log: Vec<Scan> = drive(1_000_000_000_000_000_000, 200).chain(drive(0, 80)).collect();
        let ordered = in_order(log.clone()).unwrap();
        let mended = ordered.mended.unwrap();
        assert_eq!((mended.number, mended.times, mended.is_sorted), (201, 1, false));
        let poses = |scans: &[Scan]| -> Vec<Pose2> { scans.iter().map(|scan| scan.odom_from_base).collect() };
        assert_eq!(poses(&ordered.scans), poses(&log));
        assert!(ordered.scans.is_sorted_by_key(|scan| scan.stamp));
        assert_eq!(ordered.scans[200].stamp.0 - ordered.scans[199].stamp.0, 100_000_000);
    }
}
