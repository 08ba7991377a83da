//! Settings. The tunable numbers of mapping.
//!
//! The section `[mapping]` of a deployment file. Numerical epsilons and memory bounds are private constants beside their use.

use zenav_protocol::config_text::OutOfBounds;

use crate::log_odds::InsertMode;

zenav_protocol::settings! {
    /// How scans become a map.
    ///
    /// ```
    /// use zenav_mapping::MappingSettings;
    /// use zenav_protocol::settings::Settings;
    ///
    /// let coarse = MappingSettings::default().with_number("resolution", 0.05).unwrap()?;
    /// assert_eq!((coarse.resolution, coarse.decay_after), (0.05, 30.0));
    /// let refused = coarse.with_number("sensor_model.hit", 0.3).unwrap().unwrap_err();
    /// assert!(refused.to_string().starts_with("`sensor_model.hit` is 0.3"));
    /// # Ok::<(), zenav_protocol::config_text::OutOfBounds>(())
    /// ```
    pub struct MappingSettings {
        /// Side of a cell (half of Nav2's usual one: a door 5 cm wider than the robot is open, at four times the memory).
        pub resolution: f64 = 0.025, "m", 0.005..=10.0;
        /// How beams are drawn: `reference` (every beam, exactly) or `fast` (wedges between beams are filled).
        pub mode: InsertMode = InsertMode::Reference;
        /// Temporal decay: an obstacle that appeared where it had long been free is freed after this time without a hit; after as long with
        /// hits it is permanent. 0 turns decay off (30: longer than a robot usually looks away, shorter than people stand).
        pub decay_after: f64 = 30.0, "s", 0.0..=86_400.0;
        /// Distance between the stored positions of the robot.
        pub trajectory_step: f64 = 0.1, "m", 0.01..=100.0;
        /// Most tiles in a patch; the rest follow in the next (2048 tiles are 8 MiB).
        pub patch_tiles: usize = 2048, "tiles", 1..=15_000;
        /// Most patches a second; the first scan after a pause is published at once.
        pub publish_hz: f64 = 10.0, "Hz", 0.1..=100.0;
        /// Evidence of one observation on a cell.
        pub sensor_model: SensorModel;
        /// Which beams of a scan are used.
        pub beams: BeamSettings;
    }
}

zenav_protocol::settings! {
    /// Inverse sensor model: the probability that a cell is occupied, given one observation of it.
    ///
    /// With the defaults one observation makes an unknown cell free (19 %) or occupied (66 %), and a cell stays occupied as long as more
    /// than about a quarter of the scans that observe it hit it: range noise moves hits between neighbouring cells.
    ///
    /// ```
    /// # use zenav_mapping::carmen::{CarmenReader, LOG_BEAMS};
    /// use zenav_mapping::{InsertMode, LogOddsGrid, SensorModel};
    ///
    /// # let log = "FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 1.0 host 1.0\n";
    /// # let scan = CarmenReader::new(log.as_bytes()).next().unwrap().unwrap();
    /// // With so little evidence in a hit, one scan with three returns is not enough, and ten are.
    /// let mut map = LogOddsGrid::new(0.05, &SensorModel { hit: 0.55, ..SensorModel::default() });
    /// let mut occupied_after = |scans| {
    ///     for _ in 0..scans {
    ///         map.insert(&scan, &LOG_BEAMS, InsertMode::Reference, None);
    ///     }
    ///     map.counts().occupied
    /// };
    /// assert_eq!((occupied_after(1), occupied_after(9)), (0, 3));
    /// ```
    #[derive(Copy)]
    pub struct SensorModel {
        /// Prior probability of an unseen cell: most space is free.
        pub prior: f64 = 0.289, "", 0.002..=0.998;
        /// Probability after one hit, from even odds.
        pub hit: f64 = 0.825, "", 0.51..=0.998;
        /// Probability after one miss, from even odds.
        pub miss: f64 = 0.366, "", 0.002..=0.49;
        /// Lower clamp, so that a map can change its mind (OctoMap). From 0.2 on no cell would ever be free.
        pub least: f64 = 0.119, "", 0.002..=0.19;
        /// Upper clamp. Below 0.65 no cell would ever be occupied.
        pub most: f64 = 0.971, "", 0.65..=0.998;
    }
}

zenav_protocol::settings! {
    /// Which beams of a scan are used.
    ///
    /// ```
    /// # use zenav_mapping::carmen::CarmenReader;
    /// use zenav_mapping::{BeamSettings, InsertMode, LogOddsGrid, SensorModel};
    ///
    /// # let log = "FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 1.0 host 1.0\n";
    /// # let scan = CarmenReader::new(log.as_bytes()).next().unwrap().unwrap();
    /// // Returns at 1 m, 1.5 m and 1 m.
    /// let occupied = |max_range| {
    ///     let beams = BeamSettings { trim: 0, max_range, ..BeamSettings::default() };
    ///     let mut map = LogOddsGrid::new(0.05, &SensorModel::default());
    ///     map.insert(&scan, &beams, InsertMode::Reference, None);
    ///     map.counts().occupied
    /// };
    /// assert_eq!((occupied(None), occupied(Some(1.2))), (3, 2));
    /// ```
    #[derive(Copy)]
    pub struct BeamSettings {
        /// Beams dropped at each end of the sweep, where lidars see their own housing; a full circle has no ends.
        pub trim: usize = 2, "beams", 0..=1000;
        /// Returns beyond this distance are ignored: such a beam clears up to here and hits nothing. If not set: the scan's range.
        pub max_range: Option<f64> = None, "m";
        /// Whether a beam without a return clears its cells up to the range; some lidars also lose black and glass.
        pub clear_without_return: bool = true;
        /// A run of fewer beams than this without a return may have been lost: it clears no farther than the neighbouring returns.
        pub lost_run: usize = 8, "beams", 0..=1000;
    }
    check = |beams: &BeamSettings| match beams.max_range {
        Some(range) if !(range.is_finite() && range > 0.0) => {
            Err(OutOfBounds::unlike("max_range", range, "a positive number of metres"))
        }
        _ => Ok(()),
    };
}

#[cfg(test)]
mod tests {
    use zenav_protocol::settings::Settings;

    use super::*;

    #[test]
    fn a_number_out_of_bounds_is_refused_by_its_key() {
        assert_eq!(MappingSettings::default().check(), Ok(()));
        let refused = |change: fn(&mut MappingSettings)| {
            let mut settings = MappingSettings::default();
            change(&mut settings);
            settings.check().unwrap_err().to_string()
        };
        assert_eq!(
            refused(|settings| settings.resolution = f64::NAN),
            "`resolution` is NaN: expected 0.005 to 10 m"
        );
        assert_eq!(
            refused(|settings| settings.beams.max_range = Some(-1.0)),
            "`beams.max_range` is -1: expected a positive number of metres"
        );
        assert!(refused(|settings| settings.sensor_model.hit = 0.3).starts_with("`sensor_model.hit`"));
        assert!(refused(|settings| settings.sensor_model.least = 0.3).contains("expected 0.002 to 0.19"));
        assert!(refused(|settings| settings.patch_tiles = 0).starts_with("`patch_tiles`"));
    }
}
