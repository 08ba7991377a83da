//! Map store. The part of a map that outlives its service.
//!
//! A module of its own, because its functions are clear only with its name: `store::save`, `store::load`, `store::list`.
//!
//! A map is stored as `map_server` files, with a record of its revision and the robot's trajectory beside them (`map.json`).

use std::path::{Path, PathBuf};

use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::MapRef;
use zenav_protocol::time::Stamp;

use crate::atomic::write_atomically;
use crate::map_file::{MapFileError, read_bytes, read_stored, write_map};

/// Name of the files, without their extensions.
const STEM: &str = "map";
/// Largest record that is read, bytes.
const MAX_SIDECAR: u64 = 64 << 20;

/// The data of a map that `map_server` files cannot express.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MapRecord {
    /// The stored map and its revision.
    pub map: MapRef,
    /// Stamp of the newest scan in the map.
    pub stamp: Stamp,
    /// Number of scans inserted.
    pub scans: u64,
    /// Positions of the robot while the map was built, map frame, m.
    pub trajectory: Vec<Point2<f64>>,
    /// Cells that the robot has touched though no beam shows an obstacle there: column and row, from the map's lower-left cell.
    pub touched: Vec<[u32; 2]>,
}

/// A map and its record.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredMap {
    /// Occupancy of every cell.
    pub grid: OccupancyGrid,
    /// The map's record; empty if another tool wrote the files.
    pub record: MapRecord,
}

/// Stores a map as `map.pgm`, `map.yaml` and `map.json` in a folder; a half-written file never replaces a good one.
///
/// # Errors
/// [`MapFileError::Io`].
///
/// ```
/// use nalgebra::Point2;
/// use zenav_mapping::store::{MapRecord, StoredMap, load, save};
/// use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 20, height: 10 };
/// let record = MapRecord { scans: 40, trajectory: vec![Point2::new(0.5, 0.25)], ..MapRecord::default() };
/// let stored = StoredMap { grid: OccupancyGrid::filled(spec, Occupancy::FREE), record };
/// let folder = tempfile::tempdir().unwrap();
/// save(folder.path(), &stored)?;
/// assert_eq!(load(folder.path())?, Some(stored));
/// # Ok::<(), zenav_mapping::MapFileError>(())
/// ```
pub fn save(folder: &Path, stored: &StoredMap) -> Result<PathBuf, MapFileError> {
    let map = &stored.record.map;
    let path = write_map(folder, STEM, &stored.grid, &format!("{} {}", map.id, map.revision))?;
    let sidecar = sidecar(folder);
    let text = serde_json::to_vec(&stored.record).map_err(|error| MapFileError::Io {
        path: sidecar.clone(),
        source: error.into(),
    })?;
    write_atomically(&sidecar, &text)?;
    Ok(path)
}

/// The stored maps in a folder, by name, each with its map's record; empty if there is no such folder.
///
/// # Errors
/// [`MapFileError::Io`] for an unreadable folder.
pub fn list(folder: &Path) -> Result<Vec<(String, MapRecord)>, MapFileError> {
    let failed = |source| MapFileError::Io {
        path: folder.to_owned(),
        source,
    };
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(failed(error)),
    };
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        if let Some(name) = name.filter(|_| path.join(format!("{STEM}.yaml")).is_file()) {
            found.push((name.to_owned(), record(&path)));
        }
    }
    found.sort_by(|(a, _), (b, _)| a.cmp(b));
    Ok(found)
}

/// Loads the map of a folder; `None` if there is none. Without a readable record the map has an empty one.
///
/// # Errors
/// [`MapFileError`] for files that exist but are not a map, or whose description was changed after it was stored.
///
/// ```
/// use zenav_mapping::store::load;
///
/// let folder = tempfile::tempdir().unwrap();
/// assert_eq!(load(folder.path())?, None);
/// // A map that another tool wrote has an empty record.
/// std::fs::write(folder.path().join("map.pgm"), "P2 2 1 255 0 254").unwrap();
/// std::fs::write(folder.path().join("map.yaml"), "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n").unwrap();
/// let stored = load(folder.path())?.unwrap();
/// assert_eq!((stored.grid.values(), stored.record.scans), (&[100, 0][..], 0));
/// # Ok::<(), zenav_mapping::MapFileError>(())
/// ```
pub fn load(folder: &Path) -> Result<Option<StoredMap>, MapFileError> {
    let path = folder.join(format!("{STEM}.yaml"));
    if !path.exists() {
        return Ok(None);
    }
    let grid = read_stored(&path)?;
    Ok(Some(StoredMap {
        grid,
        record: record(folder),
    }))
}

/// The record of a folder's map; empty if there is no readable one.
fn record(folder: &Path) -> MapRecord {
    let sidecar = sidecar(folder);
    match read_bytes(&sidecar, MAX_SIDECAR) {
        Ok(bytes) => serde_json::from_slice(&bytes).unwrap_or_else(|error| {
            tracing::warn!(file = %sidecar.display(), %error, "the map's record cannot be read and is ignored");
            MapRecord::default()
        }),
        Err(_) => MapRecord::default(),
    }
}

fn sidecar(folder: &Path) -> PathBuf {
    folder.join(format!("{STEM}.json"))
}

#[cfg(test)]
mod tests {
    use zenav_protocol::grid::GridSpec;

    use super::*;

    fn stored() -> StoredMap {
        let spec = GridSpec {
            origin: Point2::new(-1.0, 2.0),
            resolution: 0.05,
            width: 3,
            height: 1,
        };
        let record = MapRecord {
            map: MapRef::new("kitchen", 12),
            stamp: Stamp(7),
            scans: 40,
            trajectory: vec![Point2::new(0.5, 0.25)],
            touched: vec![[1, 0]],
        };
        StoredMap {
            grid: OccupancyGrid::from_values(spec, vec![0, 100, -1]).unwrap(),
            record,
        }
    }

    #[test]
    fn what_is_stored_is_loaded() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(load(folder.path()).unwrap(), None);
        save(folder.path(), &stored()).unwrap();
        assert_eq!(load(folder.path()).unwrap(), Some(stored()));
    }

    #[test]
    fn the_record_of_an_older_version_has_no_touched_cells() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), &stored()).unwrap();
        let text = std::fs::read_to_string(sidecar(folder.path())).unwrap();
        let older = text.replace(r#","touched":[[1,0]]"#, "");
        assert_ne!(older, text);
        std::fs::write(sidecar(folder.path()), older).unwrap();
        let expected = MapRecord {
            touched: Vec::new(),
            ..stored().record
        };
        assert_eq!(load(folder.path()).unwrap().unwrap().record, expected);
    }

    #[test]
    fn stored_maps_are_listed_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let maps = folder.path().join("maps");
        assert_eq!(list(&maps).unwrap(), []);
        for name in ["house", "attic"] {
            save(&maps.join(name), &stored()).unwrap();
        }
        std::fs::create_dir(maps.join("empty")).unwrap();
        let names: Vec<String> = list(&maps).unwrap().into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["attic", "house"]);
    }

    #[test]
    fn a_description_that_was_changed_since_is_refused_and_another_tool_s_is_welcome() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), &stored()).unwrap();
        let path = folder.path().join("map.yaml");
        let text = std::fs::read_to_string(&path).unwrap();
        for (was, is) in [
            ("resolution: 0.05", "resolution: 0.5"),
            ("origin: [-1, 2, 0]", "origin: [-1, 20, 0]"),
            ("negate: 0", "negate: 1"),
            ("mode: trinary", "mode: scale"),
        ] {
            let changed = text.replace(was, is);
            assert_ne!(changed, text, "{was}");
            std::fs::write(&path, &changed).unwrap();
            let error = load(folder.path()).unwrap_err().to_string();
            assert!(
                error.contains("map.yaml") && error.contains("do not fit what was stored"),
                "{error}"
            );
            let others: String = changed
                .lines()
                .filter(|line| !line.starts_with('#'))
                .map(|line| format!("{line}\n"))
                .collect();
            std::fs::write(&path, others).unwrap();
            assert!(load(folder.path()).unwrap().is_some(), "{was}");
        }
        std::fs::write(&path, text).unwrap();
        assert_eq!(load(folder.path()).unwrap(), Some(stored()));
    }

    #[test]
    fn a_broken_record_costs_the_record_and_a_broken_map_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), &stored()).unwrap();
        std::fs::write(sidecar(folder.path()), "{").unwrap();
        assert_eq!(load(folder.path()).unwrap().unwrap().record, MapRecord::default());
        std::fs::write(folder.path().join("map.pgm"), "P5 3 1 255\n\0").unwrap();
        assert!(
            load(folder.path())
                .unwrap_err()
                .to_string()
                .contains("map.pgm: truncated")
        );
    }
}
