//! Order. Sorts out the scans of a log whose stamps go back in time.
//!
//! Clocks are set, and recorders write late arrivals. A scan whose stamp goes back has no place in the drive; the others still have.

use thiserror::Error;
use zenav_protocol::messages::Scan;

/// A log in time order; equal stamps are allowed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ordered {
    /// The scans in time order.
    pub scans: Vec<Scan>,
    /// Number of skipped scans.
    pub skipped: usize,
    /// Number, from 1, and stamp, s, of the first skipped scan.
    pub first_skipped: Option<(usize, f64)>,
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

/// Skips the fewest scans such that no stamp goes back; of two candidates, the later one in the log.
///
/// A single stamp far ahead is itself skipped, not all that follow it. Cost: n log n.
///
/// # Errors
/// [`Disorder`] if fewer than half of the scans would be left.
pub fn in_order(log: Vec<Scan>) -> Result<Ordered, Disorder> {
    let is_kept = longest_order(&log);
    let all = log.len();
    let skipped = is_kept.iter().filter(|is_kept| !**is_kept).count();
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
            })
        }
    }
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
