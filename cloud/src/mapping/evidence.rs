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

/// Eight bits as eight bytes, 255 for a set bit.
const BYTES_OF_BITS: [[u8; 8]; 256] = {
    let mut table = [[0; 8]; 256];
    let mut at = 0;
    while at < 256 * 8 {
        if (at / 8) >> (at % 8) & 1 == 1 {
            table[at / 8][at % 8] = 255;
        }
        at += 1;
    }
    table
};

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

    /// Takes notice of a miss in every cell of 64 whose bit is set; says whether anything changed.
    pub(super) fn miss(&self, cells: &mut [u8; 64], missed: u64) -> bool {
        // Most of what is seen has been seen to be empty before.
        if cells.iter().fold(0, |differs, cell| differs | (cell ^ self.least)) == 0 {
            return false;
        }
        let mut changed = 0;
        for (eight, bits) in cells.as_chunks_mut::<8>().0.iter_mut().zip(missed.to_le_bytes()) {
            for (cell, mask) in eight.iter_mut().zip(&BYTES_OF_BITS[usize::from(bits)]) {
                let before = if *cell == UNSEEN { self.prior } else { *cell };
                let after = before.saturating_sub(self.miss).max(self.least);
                let change = (after ^ *cell) & mask;
                changed |= change;
                *cell ^= change;
            }
        }
        changed != 0
    }

    /// Takes notice of a hit; says whether anything changed.
    pub(super) fn hit(&self, cell: &mut u8) -> bool {
        let before = if *cell == UNSEEN { self.prior } else { *cell };
        let after = before.saturating_add(self.hit).min(self.most);
        after != std::mem::replace(cell, after)
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

    #[test]
    fn one_look_decides_about_an_unknown_cell() {
        let evidence = Evidence::new(&SensorModel::default());
        let mut cells = [UNSEEN; 64];
        evidence.miss(&mut cells, 1);
        evidence.hit(&mut cells[1]);
        assert_eq!(cells[2], UNSEEN);
        assert_eq!(Occupancy::of(evidence.percent[usize::from(cells[0])]), Occupancy::Free);
        assert_eq!(
            Occupancy::of(evidence.percent[usize::from(cells[1])]),
            Occupancy::Occupied
        );
    }

    #[test]
    fn a_wall_that_a_third_of_the_scans_hit_stays_and_a_passer_by_goes() {
        let evidence = Evidence::new(&SensorModel::default());
        let mut wall = [UNSEEN; 64];
        for scan in 0..300 {
            if scan % 3 == 0 {
                evidence.hit(&mut wall[0])
            } else {
                evidence.miss(&mut wall, 1)
            };
        }
        assert_eq!(
            Occupancy::of(evidence.percent[usize::from(wall[0])]),
            Occupancy::Occupied
        );
        for _ in 0..12 {
            evidence.miss(&mut wall, 1);
        }
        assert_eq!(Occupancy::of(evidence.percent[usize::from(wall[0])]), Occupancy::Free);
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
        let mut cells = [UNSEEN];
        for _ in 0..300 {
            evidence.hit(&mut cells[0]);
        }
        assert!(evidence.percent[usize::from(cells[0])] >= 50);
    }
}
