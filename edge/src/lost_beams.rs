//! Lost beams. Which beams without a return hit nothing, and which did the lidar lose? Both look alike, and a lost beam seems to see
//! through walls.
//!
//! The share of lost beams is estimated from the sweeps themselves: a beam without a return between two returns of about the same range was
//! lost. Above a small share, a run of beams without a return counts as lost unless it is too long for loss to explain it. A short run on
//! one surface is interpolated; the ranges of any other run are unknown and set to zero: they neither hit nor clear.

use std::borrow::Cow;
use std::collections::BTreeMap;

use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::LidarModel;

/// A smaller share is not treated as loss: edges of objects look alike.
const LEAST_LOSS: f64 = 0.02;
/// A run of lost beams this long or longer happens by chance this rarely.
const CHANCE: f64 = 1e-4;
/// Weight of one pair of returns in the estimate.
const MEMORY: f64 = 0.005;
/// Returns of one surface differ by at most this, m, and by this share of their range.
const SURFACE: (f32, f32) = (0.05, 0.05);
/// Longer runs are not interpolated: a thin leg may have been missed. Nor is anything where more than this share is lost.
const SHORT: usize = 2;
const SOUND: f64 = 0.5;

/// Watches the beams of all lidars of a robot.
#[derive(Clone, Debug, Default)]
pub(crate) struct LostBeams {
    /// Share of beams that are lost, by lidar.
    lost: BTreeMap<String, f64>,
}

impl LostBeams {
    /// A sweep with its lost beams repaired; unchanged if none are lost.
    pub fn mend<'a>(&mut self, sweep: &'a Sweep, lidar: &LidarModel) -> Cow<'a, Sweep> {
        let least = lidar.range_min as f32;
        let is_return = |range: f32| range >= least && range <= lidar.range_max as f32;
        if !self.lost.contains_key(&sweep.lidar) {
            self.lost.insert(sweep.lidar.clone(), 0.0);
        }
        let Some(lost) = self.lost.get_mut(&sweep.lidar) else {
            return Cow::Borrowed(sweep);
        };
        for triple in sweep.ranges.windows(3) {
            if let [before, beam, after] = *triple
                && is_return(before)
                && is_return(after)
                && is_one_surface(before, after)
            {
                *lost += MEMORY * (f64::from(u8::from(beam == f32::INFINITY)) - *lost);
            }
        }
        // Zero must be an invalid range.
        if *lost < LEAST_LOSS || least <= 0.0 {
            return Cow::Borrowed(sweep);
        }
        let longest = (CHANCE.ln() / lost.min(0.99).ln()).ceil() as usize;
        let mut mended = sweep.clone();
        let short = if *lost < SOUND { SHORT } else { 0 };
        let mut last: Option<f32> = None;
        let mut run = 0;
        for beam in 0..=mended.ranges.len() {
            let next = mended.ranges.get(beam).copied();
            if next == Some(f32::INFINITY) {
                run += 1;
                continue;
            }
            if (1..=longest).contains(&run)
                && let Some(gap) = mended.ranges.get_mut(beam - run..beam)
            {
                fill(gap, last, next.filter(|range| is_return(*range)), short);
            }
            run = 0;
            last = next.filter(|range| is_return(*range));
        }
        Cow::Owned(mended)
    }
}

pub(crate) fn is_one_surface(before: f32, after: f32) -> bool {
    (before - after).abs() <= SURFACE.0 + SURFACE.1 * before.min(after)
}

/// Fills a run of lost beams between what is seen on either side.
fn fill(gap: &mut [f32], before: Option<f32>, after: Option<f32>, short: usize) {
    let count = gap.len();
    match (before, after) {
        (Some(before), Some(after)) if count <= short && is_one_surface(before, after) => {
            for (index, range) in gap.iter_mut().enumerate() {
                *range = before + (after - before) * (index + 1) as f32 / (count + 1) as f32;
            }
        }
        _ => gap.fill(0.0),
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::time::Stamp;

    use super::*;

    #[test]
    fn what_is_lost_hits_and_clears_nothing_and_what_is_open_stays_open() {
        let lidar = LidarModel {
            range_min: 0.1,
            range_max: 10.0,
            ..zenav_fixtures::robot("jackal").lidar.unwrap_or_else(|| unreachable!())
        };
        let lost = f32::INFINITY;
        let sweep = |ranges: Vec<f32>| Sweep::new(Stamp::ZERO, ranges);
        // A wall at two metres, then open country: nothing is lost.
        let whole: Vec<f32> = (0..200).map(|beam| if beam < 100 { 2.0 } else { lost }).collect();
        let mut watch = LostBeams::default();
        assert!(matches!(watch.mend(&sweep(whole.clone()), &lidar), Cow::Borrowed(_)));
        // Each fifth beam is lost.
        let spoilt: Vec<f32> = (0..200)
            .map(|beam| if beam % 5 == 3 { lost } else { whole[beam] })
            .collect();
        for _ in 0..20 {
            watch.mend(&sweep(spoilt.clone()), &lidar);
        }
        let mended = watch.mend(&sweep(spoilt.clone()), &lidar).into_owned().ranges;
        assert!(mended[..100].iter().all(|range| *range == 2.0), "{mended:?}");
        assert!(mended[100..].iter().all(|range| *range == lost));
        // At the edge of a post the range is unknown.
        let mut post = spoilt;
        post[4..8].fill(1.0);
        let mended = watch.mend(&sweep(post), &lidar).into_owned().ranges;
        assert_eq!(mended[2..10], [2.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 2.0]);
    }
}
