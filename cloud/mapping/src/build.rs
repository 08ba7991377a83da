//! Map building. Builds a map from recorded scans at known poses, and compares two maps.

use nalgebra::Point2;
use serde::Serialize;
use thiserror::Error;
use zenav_protocol::grid::{MAX_CELLS, MAX_SIDE, Occupancy, OccupancyGrid};
use zenav_protocol::messages::Scan;

use crate::beams::{BeamReader, CellFrame};
use crate::log_odds::{InsertMode, LogOddsGrid};
use crate::settings::{BeamSettings, SensorModel};

/// Why no map was built.
///
/// ```
/// use zenav_mapping::carmen::LOG_BEAMS;
/// use zenav_mapping::{InsertMode, build_map};
///
/// let refused = build_map(&[], -0.05, InsertMode::Reference, &LOG_BEAMS).unwrap_err();
/// assert_eq!(refused.to_string(), "resolution -0.05 m: expected a positive number");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum BuildError {
    /// The resolution is not positive.
    #[error("resolution {0} m: expected a positive number")]
    Resolution(f64),
    /// The map would be too large.
    #[error(
        "{:.3} m by {:.3} m in cells of {resolution} m: expected at most {MAX_SIDE} cells a side and {MAX_CELLS} in all ({} MiB); the finest resolution for these scans is {finest} m",
        size[0], size[1], MAX_CELLS >> 20
    )]
    TooLarge {
        /// Extent of the scans along x and y, m.
        size: [f64; 2],
        /// The resolution asked for, m.
        resolution: f64,
        /// The finest resolution that fits the largest map, m.
        finest: f64,
    },
}

/// A map built from scans.
#[derive(Clone, Debug)]
pub struct BuiltMap {
    /// The map, with the log-odds of every cell.
    pub map: LogOddsGrid,
    /// Number of beams inserted.
    pub beams: u64,
}

/// Builds a map from scans at known poses, in order, without decay.
///
/// # Errors
/// [`BuildError`] when the map would be too large: no beam is ever left out.
///
/// ```
/// use zenav_mapping::carmen::{CarmenReader, LOG_BEAMS};
/// use zenav_mapping::{InsertMode, build_map};
///
/// let log = "FLASER 3 1.0 1.5 1.0 0 0 0 0 0 0 1.0 host 1.0\n";
/// let scans: Vec<_> = CarmenReader::new(log.as_bytes()).collect::<Result<_, _>>().unwrap();
/// let built = build_map(&scans, 0.05, InsertMode::Reference, &LOG_BEAMS).unwrap();
/// assert_eq!(built.beams, 3);
/// assert_eq!(built.map.counts().occupied, 3);
/// ```
pub fn build_map(
    scans: &[Scan],
    resolution: f64,
    mode: InsertMode,
    beams: &BeamSettings,
) -> Result<BuiltMap, BuildError> {
    if !(resolution.is_finite() && resolution > 0.0) {
        return Err(BuildError::Resolution(resolution));
    }
    let mut map = LogOddsGrid::new(resolution, &SensorModel::default());
    let mut inserted = 0;
    for scan in scans {
        match map.insert(scan, beams, mode, None) {
            Some(count) if count.left_out == 0 => inserted += count.inserted as u64,
            _ => return Err(too_large(scans, resolution, beams)),
        }
    }
    Ok(BuiltMap { map, beams: inserted })
}

fn too_large(scans: &[Scan], resolution: f64, settings: &BeamSettings) -> BuildError {
    // In metres.
    let frame = CellFrame {
        anchor: Point2::origin(),
        resolution: 1.0,
    };
    let mut beams = Vec::new();
    let mut reader = BeamReader::default();
    for scan in scans {
        reader.read(scan, settings, &frame, &mut beams);
    }
    let ends = beams.iter().map(|beam| beam.end);
    let points = ends.chain(scans.iter().map(|scan| scan.map_from_laser().position()));
    let (mut low, mut high) = (Point2::from([f64::INFINITY; 2]), Point2::from([f64::NEG_INFINITY; 2]));
    for p in points {
        (low, high) = (low.inf(&p), high.sup(&p));
    }
    let size = [high.x - low.x, high.y - low.y];
    let finest = (size[0].max(size[1]) / f64::from(MAX_SIDE)).max((size[0] * size[1] / MAX_CELLS as f64).sqrt());
    // Room for whole tiles, and two digits, rounded up.
    let digit = 10.0_f64.powf((1.02 * finest).log10().floor() - 1.0);
    let rounded = (1.02 * finest / digit).ceil() * digit;
    BuildError::TooLarge {
        size,
        resolution,
        finest: format!("{rounded:.1e}").parse().unwrap_or(rounded),
    }
}

/// Agreement of a map with a reference: for each class the lesser of precision and recall; 1 where neither map has any such cell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Agreement {
    /// Agreement on occupied cells, 0 to 1.
    pub occupied: f64,
    /// Agreement on free cells, 0 to 1.
    pub free: f64,
}

/// Compares a map with a reference, cell by cell of the reference.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_mapping::agreement;
/// use zenav_protocol::grid::{GridSpec, OccupancyGrid};
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 4, height: 1 };
/// let maps = [[0, 0, 100, 100], [0, 0, 0, 100]];
/// let [reference, other] = maps.map(|values| OccupancyGrid::from_values(spec, values.to_vec()).unwrap());
/// let found = agreement(&reference, &other);
/// assert_eq!((found.occupied, found.free), (0.5, 2.0 / 3.0));
/// ```
#[must_use]
pub fn agreement(reference: &OccupancyGrid, other: &OccupancyGrid) -> Agreement {
    let share = |class: Occupancy| {
        let spec = reference.spec();
        let (mut both, mut in_reference) = (0_u64, 0_u64);
        for (index, value) in reference
            .values()
            .iter()
            .enumerate()
            .filter(|(_, value)| Occupancy::of(**value) == class)
        {
            in_reference += 1;
            let theirs = if other.spec() == spec {
                other.values().get(index)
            } else {
                other.at(spec.center(spec.cell(index)))
            };
            both += u64::from(theirs.is_some_and(|theirs| Occupancy::of(*theirs) == Occupancy::of(*value)));
        }
        let in_other = other
            .values()
            .iter()
            .filter(|value| Occupancy::of(**value) == class)
            .count() as u64;
        let most = in_reference.max(in_other);
        if most == 0 { 1.0 } else { both as f64 / most as f64 }
    };
    Agreement {
        occupied: share(Occupancy::Occupied),
        free: share(Occupancy::Free),
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::time::Stamp;

    use super::*;
    use crate::carmen::LOG_BEAMS;

    /// Two scans with two returns each.
    fn scans() -> Vec<Scan> {
        [0.1, 1.3]
            .map(|yaw| Scan {
                stamp: Stamp(1),
                angle_min: -0.5,
                angle_increment: 0.4,
                range_min: 0.02,
                range_max: 20.0,
                ranges: vec![1.0, 2.5, f32::INFINITY],
                odom_from_base: Pose2::new(0.5, -0.5, yaw),
                ..Scan::default()
            })
            .to_vec()
    }

    #[test]
    fn a_map_agrees_with_itself_and_not_with_an_empty_one() {
        let scans = scans();
        let build = |scans: &[Scan]| build_map(scans, 0.05, InsertMode::Reference, &LOG_BEAMS).unwrap();
        assert_eq!(build(&scans).beams, 4);
        let map = build(&scans).map.to_occupancy();
        assert_eq!(
            agreement(&map, &map),
            Agreement {
                occupied: 1.0,
                free: 1.0
            }
        );
        let empty = build(&[]).map.to_occupancy();
        assert!(empty.spec().is_empty());
        assert_eq!(
            agreement(&map, &empty),
            Agreement {
                occupied: 0.0,
                free: 0.0
            }
        );
    }

    #[test]
    fn a_map_that_would_be_too_large_is_refused_with_the_finest_resolution_there_is_room_for() {
        let scans = scans();
        let build = |resolution| build_map(&scans, resolution, InsertMode::Fast, &LOG_BEAMS).map(|built| built.beams);
        let refused = build(1e-5).unwrap_err();
        assert!(refused.to_string().contains("268435456 in all"), "{refused}");
        let BuildError::TooLarge { finest, .. } = refused else {
            panic!("{refused}");
        };
        assert!(finest > 1e-5 && finest < 1e-3 && refused.to_string().ends_with(&format!("is {finest} m")));
        assert_eq!(build(finest), Ok(4));
        for senseless in [0.0, -0.05, f64::NAN, f64::INFINITY] {
            assert!(matches!(build(senseless), Err(BuildError::Resolution(_))));
        }
    }
}
