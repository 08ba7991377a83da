//! What does one look at a cell say? Log-odds of being occupied, one byte a cell.
//!
//! Moravec and Elfes, "High Resolution Maps from Wide Angle Sonar", 1985, in the log-odds form of Thrun, Burgard and Fox,
//! "Probabilistic Robotics", chapter 9, clamped as in OctoMap so that a map can change its mind.

use serde::{Deserialize, Serialize};
use zenav_protocol::grid::Occupancy;

/// Log-odds of one step of a byte; byte 128 is even odds, byte 0 is "never seen".
const STEP: f64 = 0.05;
const EVEN: f64 = 128.0;

/// The inverse sensor model.
///
/// With the defaults one look makes an unknown cell free (19 %) or occupied (66 %), and a cell stays occupied as long as
/// more than about a quarter of the scans that look at it hit it: range noise moves hits between neighbouring cells.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorModel {
    /// Probability that a cell nobody has seen is occupied: most space is empty.
    pub prior: f64,
    /// Probability of being occupied that one hit alone speaks for, on even odds.
    pub hit: f64,
    /// Probability of being occupied that one beam through the cell speaks for, on even odds.
    pub miss: f64,
    /// Least probability that misses lead to.
    pub least: f64,
    /// Largest probability that hits lead to.
    pub most: f64,
}

impl Default for SensorModel {
    fn default() -> Self {
        Self {
            prior: 0.289,
            hit: 0.825,
            miss: 0.366,
            least: 0.119,
            most: 0.971,
        }
    }
}

/// The model in steps of a byte, with the percentages that bytes stand for.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Evidence {
    pub(super) prior: u8,
    pub(super) hit: u8,
    pub(super) miss: u8,
    pub(super) least: u8,
    pub(super) most: u8,
    pub(super) percent: [i8; 256],
}

/// The byte of a cell that nobody has seen: zero, as memory comes.
pub(super) const UNSEEN: u8 = 0;

impl Evidence {
    /// Probabilities outside (0, 1), and numbers that are not any, are brought inside.
    pub(super) fn new(model: &SensorModel) -> Self {
        let mut percent = [Occupancy::UNKNOWN; 256];
        for (byte, percent) in percent.iter_mut().enumerate().skip(1) {
            let odds = ((byte as f64 - EVEN) * STEP).exp();
            *percent = (100.0 * odds / (1.0 + odds)).round() as i8;
        }
        let steps = |probability: f64| log_odds_steps(probability).abs().clamp(1.0, 127.0) as u8;
        let least = level(model.least.min(0.5));
        let most = level(model.most.max(0.5));
        Self {
            prior: level(model.prior),
            hit: steps(model.hit.max(0.5)),
            miss: steps(model.miss.min(0.5)),
            least,
            most,
            percent,
        }
    }

    /// The byte of an occupancy value.
    pub(super) fn of_percent(&self, percent: i8) -> u8 {
        if percent < 0 {
            UNSEEN
        } else {
            level(f64::from(percent) / 100.0).clamp(self.least, self.most)
        }
    }

    /// What a miss makes of a byte.
    #[inline]
    pub(super) fn after_miss(&self, cell: u8) -> u8 {
        self.known(cell).saturating_sub(self.miss).max(self.least)
    }

    /// What a hit makes of a byte.
    #[inline]
    pub(super) fn after_hit(&self, cell: u8) -> u8 {
        self.known(cell).saturating_add(self.hit).min(self.most)
    }

    #[inline]
    fn known(&self, cell: u8) -> u8 {
        if cell == UNSEEN { self.prior } else { cell }
    }
}

fn log_odds_steps(probability: f64) -> f64 {
    let p = if probability.is_nan() {
        0.5
    } else {
        probability.clamp(0.002, 0.998)
    };
    ((p / (1.0 - p)).ln() / STEP).round()
}

fn level(probability: f64) -> u8 {
    (EVEN + log_odds_steps(probability)).clamp(1.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn class(evidence: &Evidence, cell: u8) -> Occupancy {
        Occupancy::of(evidence.percent[usize::from(cell)])
    }

    #[test]
    fn one_look_decides_about_an_unknown_cell() {
        let evidence = Evidence::new(&SensorModel::default());
        assert_eq!(class(&evidence, UNSEEN), Occupancy::Unknown);
        assert_eq!(class(&evidence, evidence.after_miss(UNSEEN)), Occupancy::Free);
        assert_eq!(class(&evidence, evidence.after_hit(UNSEEN)), Occupancy::Occupied);
    }

    #[test]
    fn a_wall_that_a_third_of_the_scans_hit_stays_and_a_passer_by_goes() {
        let evidence = Evidence::new(&SensorModel::default());
        let mut wall = UNSEEN;
        for scan in 0..300 {
            wall = if scan % 3 == 0 {
                evidence.after_hit(wall)
            } else {
                evidence.after_miss(wall)
            };
        }
        assert_eq!(class(&evidence, wall), Occupancy::Occupied);
        for _ in 0..12 {
            wall = evidence.after_miss(wall);
        }
        assert_eq!(class(&evidence, wall), Occupancy::Free);
    }

    #[test]
    fn a_model_of_nonsense_still_keeps_within_bytes() {
        let evidence = Evidence::new(&SensorModel {
            prior: f64::NAN,
            hit: 7.0,
            miss: -1.0,
            least: f64::INFINITY,
            most: f64::NAN,
        });
        let cell = (0..300).fold(UNSEEN, |cell, _| evidence.after_hit(cell));
        assert!(evidence.percent[usize::from(cell)] >= 50);
    }
}
