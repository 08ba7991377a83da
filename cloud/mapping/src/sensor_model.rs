//! Inverse sensor model. The change of a cell's log-odds by one observation.
//!
//! With `p` the probability that the cell is occupied, an observation `z` adds its own log-odds to the cell's,
//!
//! ```text
//! l(p) = ln(p / (1 - p))      l ← clamp(l + l(p(occupied | z)), l(least), l(most))
//! ```
//!
//! so an update is one addition. Log-odds are stored in one byte for each cell, in steps of 0.05.
//!
//! Moravec and Elfes, "High Resolution Maps from Wide Angle Sonar", 1985, in the log-odds form of Thrun, Burgard and Fox, "Probabilistic
//! Robotics", chapter 9; clamped as in OctoMap (Hornung et al., 2013), so that a map can change its mind.

use zenav_protocol::grid::Occupancy;

use crate::settings::SensorModel;

/// Log-odds of one step of a byte.
const STEP: f64 = 0.05;
/// The byte of even odds.
const EVEN: f64 = 128.0;
/// The byte of a cell that was never seen: zero, so that fresh memory is unseen.
pub(crate) const UNSEEN: u8 = 0;

/// The sensor model in steps of a byte.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct QuantizedModel {
    /// Byte of the prior.
    prior: u8,
    /// Steps that a hit adds.
    hit: u8,
    /// Steps that a miss takes away.
    miss: u8,
    /// Byte of the lower clamp.
    pub(crate) least: u8,
    /// Byte of the upper clamp.
    pub(crate) most: u8,
    /// Occupancy value of each byte.
    percent: [i8; 256],
}

impl QuantizedModel {
    /// Quantises the model. Probabilities outside (0, 1), and NaN, are brought inside.
    pub(crate) fn new(model: &SensorModel) -> Self {
        let mut percent = [Occupancy::UNKNOWN; 256];
        for (byte, percent) in percent.iter_mut().enumerate().skip(1) {
            let odds = ((byte as f64 - EVEN) * STEP).exp();
            *percent = (100.0 * odds / (1.0 + odds)).round() as i8;
        }
        let steps = |probability: f64| log_odds_steps(probability).abs().clamp(1.0, 127.0) as u8;
        Self {
            prior: byte_of(model.prior),
            hit: steps(model.hit.max(0.5)),
            miss: steps(model.miss.min(0.5)),
            least: byte_of(model.least.min(0.5)),
            most: byte_of(model.most.max(0.5)),
            percent,
        }
    }

    /// Occupancy value of a byte.
    #[inline]
    pub(crate) fn percent(&self, byte: u8) -> i8 {
        self.percent[usize::from(byte)]
    }

    /// Byte of an occupancy value.
    pub(crate) fn of_percent(&self, percent: i8) -> u8 {
        if percent < 0 {
            UNSEEN
        } else {
            byte_of(f64::from(percent) / 100.0).clamp(self.least, self.most)
        }
    }

    /// The byte after a miss.
    #[inline]
    pub(crate) fn after_miss(&self, cell: u8) -> u8 {
        self.seen(cell).saturating_sub(self.miss).max(self.least)
    }

    /// The byte after a hit.
    #[inline]
    pub(crate) fn after_hit(&self, cell: u8) -> u8 {
        self.seen(cell).saturating_add(self.hit).min(self.most)
    }

    /// Replaces an unseen cell by the prior before its first observation.
    #[inline]
    fn seen(&self, cell: u8) -> u8 {
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

fn byte_of(probability: f64) -> u8 {
    (EVEN + log_odds_steps(probability)).clamp(1.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn class(model: &QuantizedModel, cell: u8) -> Occupancy {
        Occupancy::of(model.percent(cell))
    }

    #[test]
    fn one_observation_decides_about_an_unknown_cell() {
        let model = QuantizedModel::new(&SensorModel::default());
        assert_eq!(class(&model, UNSEEN), Occupancy::Unknown);
        assert_eq!(class(&model, model.after_miss(UNSEEN)), Occupancy::Free);
        assert_eq!(class(&model, model.after_hit(UNSEEN)), Occupancy::Occupied);
    }

    #[test]
    fn a_wall_that_a_third_of_the_scans_hit_stays_and_a_passer_by_goes() {
        let model = QuantizedModel::new(&SensorModel::default());
        let mut wall = UNSEEN;
        for scan in 0..300 {
            wall = if scan % 3 == 0 {
                model.after_hit(wall)
            } else {
                model.after_miss(wall)
            };
        }
        assert_eq!(class(&model, wall), Occupancy::Occupied);
        for _ in 0..12 {
            wall = model.after_miss(wall);
        }
        assert_eq!(class(&model, wall), Occupancy::Free);
    }

    #[test]
    fn a_senseless_model_still_keeps_within_bytes() {
        let model = QuantizedModel::new(&SensorModel {
            prior: f64::NAN,
            hit: 7.0,
            miss: -1.0,
            least: f64::INFINITY,
            most: f64::NAN,
        });
        let cell = (0..300).fold(UNSEEN, |cell, _| model.after_hit(cell));
        assert!(model.percent(cell) >= 50);
    }
}
