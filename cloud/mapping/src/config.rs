//! What does a mapper need to know, and which numbers make sense?

use std::time::Duration;

use serde::{Deserialize, Serialize};
use thiserror::Error;
use zenav_protocol::grid::Occupancy;
use zenav_protocol::robot::Footprint;

use super::beams::BeamOptions;
use super::occupancy::{InsertMode, LogOddsGrid};
use super::sensor_model::SensorModel;

/// What a mapper needs to know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MapperConfig {
    /// Side of a cell, m.
    pub resolution: f64,
    /// Cells under the robot's own outline are free. `None`: nothing is known of it.
    pub footprint: Option<Footprint>,
    /// How beams are read.
    pub beams: BeamOptions,
    /// What a look says.
    pub model: SensorModel,
    /// How scans are drawn.
    pub mode: InsertMode,
    /// What was hit for a short while where it had long been free, and is not seen any more, is free again after so many
    /// seconds of the scans' time; what is hit for longer stays. `None`: only beams clear.
    pub fade_after: Option<f64>,
    /// The robot's way is kept about each so many metres.
    pub trajectory_step: f64,
    /// Most tiles in a patch; the others follow in the next.
    pub patch_tiles: usize,
}

impl Default for MapperConfig {
    fn default() -> Self {
        Self {
            resolution: 0.05,
            footprint: None,
            beams: BeamOptions::default(),
            model: SensorModel::default(),
            mode: InsertMode::Reference,
            fade_after: Some(30.0),
            trajectory_step: 0.1,
            patch_tiles: 2048,
        }
    }
}

/// A number of a [`MapperConfig`] that makes no sense.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("mapper.{key}: expected {expected}, found {found}")]
pub struct MapperConfigError {
    /// The field.
    pub key: &'static str,
    /// What it should be.
    pub expected: &'static str,
    /// What it is.
    pub found: f64,
}

impl MapperConfig {
    /// Whether a map can come of it.
    ///
    /// # Errors
    /// The first number that makes no sense.
    pub fn check(&self) -> Result<(), MapperConfigError> {
        let is_positive = |value: f64| value.is_finite() && value > 0.0;
        let length = "a positive number of metres";
        let SensorModel {
            prior,
            hit,
            miss,
            least,
            most,
        } = self.model;
        let (free, occupied) = (
            f64::from(Occupancy::FREE_BELOW) / 100.0,
            f64::from(Occupancy::OCCUPIED_FROM) / 100.0,
        );
        let checks = [
            ("resolution", is_positive(self.resolution), length, self.resolution),
            (
                "trajectory_step",
                is_positive(self.trajectory_step),
                length,
                self.trajectory_step,
            ),
            (
                "beams.max_range",
                self.beams.max_range.is_none_or(is_positive),
                length,
                self.beams.max_range.unwrap_or_default(),
            ),
            (
                "fade_after",
                self.fade_after.is_none_or(is_positive),
                "a positive number of seconds",
                self.fade_after.unwrap_or_default(),
            ),
            (
                "patch_tiles",
                self.patch_tiles > 0,
                "at least one tile",
                self.patch_tiles as f64,
            ),
            (
                "model.prior",
                prior > 0.0 && prior < 1.0,
                "a probability between 0 and 1",
                prior,
            ),
            (
                "model.hit",
                hit > 0.5 && hit < 1.0,
                "a probability between 0.5 and 1",
                hit,
            ),
            (
                "model.miss",
                miss > 0.0 && miss < 0.5,
                "a probability between 0 and 0.5",
                miss,
            ),
            (
                "model.least",
                least > 0.0 && least < free,
                "a probability below 0.2, or no cell would ever be free",
                least,
            ),
            (
                "model.most",
                most >= occupied && most < 1.0,
                "a probability from 0.65 to below 1, or no cell would ever be occupied",
                most,
            ),
        ];
        match checks.into_iter().find(|(_, is_good, ..)| !is_good) {
            Some((key, _, expected, found)) => Err(MapperConfigError { key, expected, found }),
            None => Ok(()),
        }
    }

    /// The grid with fading as configured.
    pub(super) fn fading(&self, grid: LogOddsGrid) -> LogOddsGrid {
        let after = self.fade_after.and_then(|secs| Duration::try_from_secs_f64(secs).ok());
        match after.filter(|after| !after.is_zero()) {
            Some(after) => grid.with_fading(after),
            None => grid,
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_number_that_makes_no_sense_is_refused_by_name() {
        assert_eq!(MapperConfig::default().check(), Ok(()));
        let refused = |change: fn(&mut MapperConfig)| {
            let mut config = MapperConfig::default();
            change(&mut config);
            config.check().unwrap_err().to_string()
        };
        assert_eq!(
            refused(|config| config.resolution = f64::NAN),
            "mapper.resolution: expected a positive number of metres, found NaN"
        );
        assert!(refused(|config| config.beams.max_range = Some(-1.0)).starts_with("mapper.beams.max_range:"));
        assert!(refused(|config| config.fade_after = Some(0.0)).starts_with("mapper.fade_after:"));
        assert!(refused(|config| config.model.hit = 0.3).starts_with("mapper.model.hit:"));
        assert!(refused(|config| config.model.least = 0.3).contains("no cell would ever be free"));
        assert!(refused(|config| config.patch_tiles = 0).starts_with("mapper.patch_tiles:"));
    }
}
