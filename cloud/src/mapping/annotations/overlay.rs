//! Overlay. What operators have changed of a map's places and zones, as it is stored.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use zenav_mapping::write_atomically;
use zenav_protocol::messages::{Annotations, GoalPoint, Refusal, Zone};
use zenav_space::Zones;

/// Suffix of a file that cannot be read.
pub(super) const UNREADABLE: &str = "unreadable";
/// Largest file that is read, bytes.
const MAX_FILE: u64 = 4 << 20;

/// Changes by operators; `None` marks a place or zone of the base as removed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Overlay {
    #[serde(default)]
    pub(super) revision: u64,
    /// Map frame of its coordinates.
    #[serde(default)]
    pub(super) frame: u64,
    #[serde(default)]
    pub(super) places: BTreeMap<String, Option<GoalPoint>>,
    #[serde(default)]
    pub(super) zones: BTreeMap<String, Option<Zone>>,
}

impl Overlay {
    /// Reads the changes of earlier runs; none without a file.
    ///
    /// # Errors
    /// What is wrong with a file that cannot be read.
    pub(super) fn read(file: &Path) -> Result<Self, String> {
        let size = match std::fs::metadata(file) {
            Ok(found) => found.len(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(error) => return Err(error.to_string()),
        };
        if size > MAX_FILE {
            return Err(format!("{size} bytes: expected at most {MAX_FILE}"));
        }
        let text = std::fs::read(file).map_err(|error| error.to_string())?;
        let overlay: Self = serde_json::from_slice(&text).map_err(|error| error.to_string())?;
        for place in overlay.places.values().flatten() {
            place.checked()?;
        }
        let zones: Vec<Zone> = overlay.zones.values().flatten().cloned().collect();
        Zones::new(&zones).map_err(|error| error.to_string())?;
        Ok(overlay)
    }

    /// Writes the changes to a file. They are on disk when this returns.
    ///
    /// # Errors
    /// [`Refusal::Internal`] if they are not.
    pub(super) async fn write(&self, file: PathBuf) -> Result<(), Refusal> {
        let text = serde_json::to_vec_pretty(self).map_err(Refusal::internal)?;
        let store = move || {
            if let Some(folder) = file.parent() {
                std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
            }
            write_atomically(&file, &text).map_err(|error| error.to_string())
        };
        let stored = tokio::task::spawn_blocking(store).await;
        stored.map_err(Refusal::internal)?.map_err(Refusal::internal)
    }

    /// The places that it adds or moves.
    pub(super) fn places(&self) -> impl Iterator<Item = (&String, &GoalPoint)> {
        self.places
            .iter()
            .filter_map(|(name, place)| Some((name, place.as_ref()?)))
    }

    /// The zones that it adds or changes.
    pub(super) fn zones(&self) -> impl Iterator<Item = (&String, &Zone)> {
        self.zones
            .iter()
            .filter_map(|(name, zone)| Some((name, zone.as_ref()?)))
    }
}

/// Places and zones in force: the base, and the changes over it.
pub(super) fn laid_over(base: &Annotations, overlay: &Overlay) -> Annotations {
    let mut places: BTreeMap<_, _> = base.places.clone();
    for (name, place) in &overlay.places {
        match place {
            Some(place) => places.insert(name.clone(), *place),
            None => places.remove(name),
        };
    }
    let mut zones: BTreeMap<String, Zone> = base
        .zones
        .iter()
        .map(|zone| (zone.name.clone(), zone.clone()))
        .collect();
    for (name, zone) in &overlay.zones {
        match zone {
            Some(zone) => zones.insert(name.clone(), zone.clone()),
            None => zones.remove(name),
        };
    }
    Annotations {
        revision: overlay.revision,
        places,
        zones: zones.into_values().collect(),
        frame: base.frame,
    }
}

/// Zones of a file may share a name; here each gets its own.
pub(super) fn with_own_names(zones: Vec<Zone>) -> Vec<Zone> {
    let mut named: Vec<Zone> = Vec::with_capacity(zones.len());
    for mut zone in zones {
        let name = zone.name.clone();
        let mut count = 1;
        while named.iter().any(|known| known.name == zone.name) {
            count += 1;
            zone.name = format!("{name}_{count}");
        }
        named.push(zone);
    }
    named
}
