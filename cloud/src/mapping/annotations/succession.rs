//! Succession of lists. Which places and zones does a mapping service have after one that led?

use std::path::Path;

use zenav_protocol::messages::{Annotations, Zone, may_follow};
use zenav_space::Zones;

use super::super::storage;
use super::AnnotationBook;
use super::overlay::Overlay;

impl AnnotationBook {
    /// Takes over what was followed of another mapping service: whatever differs from the base counts as changed by operators. The revision
    /// goes up, so that a list without the takeover is older everywhere.
    pub(in crate::mapping) async fn take_over(&mut self, robot: &str, told: &Annotations) {
        let Some((mut overlay, _)) = self.merged(robot, told) else {
            return;
        };
        overlay.revision = overlay.revision.saturating_add(1);
        if let Err(error) = self.store(&overlay).await {
            tracing::error!(robot, %error, "the places and zones of the mapping service that led are not stored here");
        }
        self.adopt(overlay);
    }

    /// Whether a list succeeds the one known here: a newer one, or the same one in another frame of the map.
    pub(in crate::mapping) fn is_succeeded_by(&self, told: &Annotations) -> bool {
        let own = &self.now;
        let has_zone = |zone: &Zone| told.zones.iter().any(|other| other.name == zone.name);
        let has_all = own.places.keys().all(|name| told.places.contains_key(name)) && own.zones.iter().all(has_zone);
        told.revision > own.revision || told.revision == own.revision && has_all
    }

    /// Follows the list of the mapping service that leads, and stores it in this service's own folder, unless another service uses that.
    pub(in crate::mapping) async fn follow(&mut self, robot: &str, told: &Annotations) {
        let Some((overlay, is_changed)) = self.merged(robot, told) else {
            return;
        };
        if is_changed {
            let folder = self.file.as_deref().and_then(Path::parent);
            let stored = match folder.map(storage::guard).transpose() {
                Ok(_guard) => self.store(&overlay).await,
                // The leader's own folder: it stores them.
                Err(_) => Ok(()),
            };
            if let Err(error) = stored {
                tracing::error!(robot, %error, "the places and zones of the mapping service that leads are not stored here");
            }
        }
        self.adopt(overlay);
    }

    /// The overlay that a told list leads to, and whether it differs from the one in force. A list that [succeeds](Self::is_succeeded_by)
    /// this one replaces it. Any other does not know what is here: what it has is added, and nothing vanishes. `None` for a malformed list.
    fn merged(&self, robot: &str, told: &Annotations) -> Option<(Overlay, bool)> {
        let fits = told.places.values().try_for_each(|place| place.checked().map(drop));
        let fits = fits.and_then(|()| Zones::new(&told.zones).map(drop).map_err(|error| error.to_string()));
        let fits = fits.and_then(|()| match may_follow(told.revision, self.overlay.revision) {
            true => Ok(()),
            false => Err(format!(
                "revision {} cannot follow {}",
                told.revision, self.overlay.revision
            )),
        });
        if let Err(problem) = fits {
            tracing::error!(
                robot,
                problem,
                "the places and zones of the mapping service that leads are not taken over"
            );
            return None;
        }
        let base = &self.base;
        let changed_places = told
            .places
            .iter()
            .filter(|(name, place)| base.places.get(*name) != Some(*place))
            .map(|(name, place)| (name.clone(), Some(*place)));
        let changed_zones = told
            .zones
            .iter()
            .filter(|zone| !base.zones.contains(zone))
            .map(|zone| (zone.name.clone(), Some(zone.clone())));
        let mut overlay = Overlay {
            frame: told.frame,
            ..self.overlay.clone()
        };
        if self.is_succeeded_by(told) {
            overlay.revision = told.revision;
            let removed = base.places.keys().filter(|name| !told.places.contains_key(*name));
            overlay.places = removed.map(|name| (name.clone(), None)).chain(changed_places).collect();
            let removed = base
                .zones
                .iter()
                .filter(|zone| !told.zones.iter().any(|other| other.name == zone.name));
            overlay.zones = removed
                .map(|zone| (zone.name.clone(), None))
                .chain(changed_zones)
                .collect();
        } else {
            overlay.places.extend(changed_places);
            overlay.zones.extend(changed_zones);
            let is_more = (&overlay.places, &overlay.zones) != (&self.overlay.places, &self.overlay.zones);
            overlay.revision = overlay.revision.saturating_add(u64::from(is_more));
        }
        let is_changed = overlay != self.overlay;
        Some((overlay, is_changed))
    }
}
