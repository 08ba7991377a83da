//! No return. Which reading of a log means that a beam met nothing?
//!
//! A `FLASER` line does not state the laser's range, and a `ROBOTLASER1` line may state a wrong one. Most lasers report 81.9 m where
//! nothing is in range; set to a shorter range, they report 8.19 m or 32.7 m, and other makes report their maximum. Taken for walls, such
//! readings draw arcs that block every loop closure.
//!
//! A log's largest reading is a wall that was seen now and then by a few beams. If it is far more frequent than the readings just below it,
//! for beams all over the sweep, and from more than one place, it means no return.

use nalgebra::Point2;

/// Readings within this of the largest one are the same, m: some lasers tell the reasons of a missing return apart by millimetres.
const SAME: f64 = 0.02;
/// The readings just below are those of this many intervals of [`SAME`].
const BELOW: usize = 10;
/// Times more frequent than in each interval below.
const MORE: u64 = 10;
/// Least number of such readings.
const LEAST: u64 = 30;
/// Least share of the beams that gave one: a robot that stands in front of a distant wall sees it with a few neighbouring beams.
const BEAMS: usize = 8;
/// Places this far apart are two, m: a robot that turns on the spot sees the same wall with all beams.
const APART: f64 = 1.0;

/// Readings of one length.
#[derive(Clone, Copy, Debug, Default)]
struct Interval {
    count: u64,
    /// Where the first was taken.
    first: Point2<f64>,
    /// Whether another was taken elsewhere.
    is_elsewhere: bool,
}

/// Readings of a log, counted.
pub(crate) struct Readings {
    /// Readings from here on mean no return anyway, m.
    end: f64,
    /// Readings in each interval of [`SAME`].
    intervals: Vec<Interval>,
    /// Largest reading of each beam, m.
    largest: Vec<f64>,
}

impl Readings {
    /// Of no scan yet; `end`: readings from here on mean no return in any log, m.
    pub(crate) fn new(end: f64) -> Self {
        Self {
            end,
            intervals: vec![Interval::default(); (end / SAME).ceil() as usize],
            largest: Vec::new(),
        }
    }

    /// Counts a scan, taken by a laser at a place, m.
    pub(crate) fn add(&mut self, place: Point2<f64>, ranges: &[f32]) {
        self.largest.resize(self.largest.len().max(ranges.len()), 0.0);
        for (range, largest) in ranges.iter().zip(&mut self.largest) {
            let range = f64::from(*range);
            if range > 0.0 && range < self.end {
                *largest = largest.max(range);
                if let Some(interval) = self.intervals.get_mut((range / SAME) as usize) {
                    if interval.count == 0 {
                        interval.first = place;
                    }
                    interval.count += 1;
                    interval.is_elsewhere |= (place - interval.first).norm() > APART;
                }
            }
        }
    }

    /// Readings from here on mean no return, m; `None` if the largest one is a wall.
    pub(crate) fn no_return(&self) -> Option<f64> {
        let intervals = &self.intervals;
        let top = intervals.iter().rposition(|interval| interval.count > 0)?;
        // The largest readings may lie on both sides of an interval's border.
        let below = top.checked_sub(1)?;
        let largest = &intervals[below..=top];
        let most: u64 = largest.iter().map(|interval| interval.count).sum();
        let rest = &intervals[below.saturating_sub(BELOW)..below];
        let rest: u64 = rest.iter().map(|interval| interval.count).sum();
        let least = self.largest.iter().copied().fold(0.0, f64::max) - SAME;
        let beams = self.largest.iter().filter(|largest| **largest >= least).count();
        let is_frequent = most >= LEAST && most * BELOW as u64 > MORE * rest;
        let is_everywhere = beams * BEAMS >= self.largest.len() && largest.iter().any(|interval| interval.is_elsewhere);
        (is_frequent && is_everywhere).then_some(least)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No return of a log of 100 scans with 180 beams, 0.1 m apart, each of which reads what `read` says for scan and beam, m.
    fn no_return(read: impl Fn(usize, usize) -> f64) -> Option<f64> {
        no_return_from(|scan| Point2::new(0.1 * scan as f64, 0.0), read)
    }

    fn no_return_from(place: impl Fn(usize) -> Point2<f64>, read: impl Fn(usize, usize) -> f64) -> Option<f64> {
        let mut readings = Readings::new(80.0);
        for scan in 0..100 {
            let ranges: Vec<f32> = (0..180).map(|beam| read(scan, beam) as f32).collect();
            readings.add(place(scan), &ranges);
        }
        readings.no_return()
    }

    /// Walls up to 12 m away.
    fn wall(scan: usize, beam: usize) -> f64 {
        1.0 + 11.0 * ((scan * 180 + beam) as f64 * 0.618_034).fract()
    }

    #[test]
    fn a_reading_that_is_the_largest_and_frequent_means_no_return() {
        let clipped = |scan, beam| wall(scan, beam).min(8.0);
        assert!((no_return(clipped).unwrap_or_default() - 7.98).abs() < 1e-6);
        // Two reasons of a missing return.
        let reasons = |scan: usize, beam: usize| {
            if (scan + beam).is_multiple_of(7) {
                32.763 + 0.004 * (beam % 2) as f64
            } else {
                wall(scan, beam)
            }
        };
        assert!((no_return(reasons).unwrap_or_default() - 32.747).abs() < 1e-3);
    }

    #[test]
    fn the_farthest_wall_is_a_wall() {
        assert_eq!(no_return(wall), None);
        let ahead = |scan, beam: usize| if beam.abs_diff(90) < 6 { 25.0 } else { wall(scan, beam) };
        assert_eq!(no_return(ahead), None, "a robot that stands before a distant wall");
        let lost = |scan, beam: usize| {
            if beam.is_multiple_of(5) {
                81.91
            } else {
                wall(scan, beam)
            }
        };
        assert_eq!(no_return(lost), None, "what means no return in any log is not counted");
        assert_eq!(no_return(|_, _| 0.0), None);
        let turns = |scan: usize, beam: usize| {
            if (beam + 7 * scan) % 180 < 6 {
                25.0
            } else {
                wall(scan, beam)
            }
        };
        assert_eq!(
            no_return_from(|_| Point2::origin(), turns),
            None,
            "a robot that turns on the spot"
        );
        assert!(no_return(turns).is_some());
    }
}
