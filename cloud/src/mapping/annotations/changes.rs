//! Changes. Which changes of places and zones are admitted, and what do they lead to?

use zenav_protocol::messages::{AnnotateAction, Refusal};
use zenav_space::Zones;

use super::AnnotationBook;
use super::overlay::{Overlay, laid_over};

/// Longest name of a place or zone, bytes.
const MAX_NAME: usize = 64;
/// Most places.
const MAX_PLACES: usize = 1000;
/// Most corners of all zones: the published message stays within its key's limit.
const MAX_CORNERS: usize = 20_000;

impl AnnotationBook {
    /// The overlay after a change; `None` if nothing changes.
    ///
    /// # Errors
    /// Why the change is not admitted.
    pub(super) fn changed(&self, action: AnnotateAction) -> Result<Option<Overlay>, Refusal> {
        let mut overlay = self.overlay.clone();
        match action {
            AnnotateAction::Get => return Ok(None),
            AnnotateAction::AddPlace { name, at } => {
                check_name(&name)?;
                overlay
                    .places
                    .insert(name, Some(at.checked().map_err(Refusal::bad_request)?));
            }
            AnnotateAction::RemovePlace { name } => {
                if !self.now.places.contains_key(&name) {
                    return Err(unknown("place", &name, self.now.places.keys()));
                }
                overlay.places.insert(name, None);
            }
            AnnotateAction::AddZone { zone } => {
                check_name(&zone.name)?;
                Zones::new(std::slice::from_ref(&zone)).map_err(Refusal::bad_request)?;
                overlay.zones.insert(zone.name.clone(), Some(zone));
            }
            AnnotateAction::RemoveZone { name } => {
                if !self.now.zones.iter().any(|zone| zone.name == name) {
                    return Err(unknown("zone", &name, self.now.zones.iter().map(|zone| &zone.name)));
                }
                overlay.zones.insert(name, None);
            }
            AnnotateAction::ClearZones => {
                overlay.zones = self.base.zones.iter().map(|zone| (zone.name.clone(), None)).collect();
            }
        }
        // The removal of an item that the base does not have need not be recorded.
        let base = &self.base;
        overlay
            .places
            .retain(|name, place| place.is_some() || base.places.contains_key(name));
        overlay
            .zones
            .retain(|name, zone| zone.is_some() || base.zones.iter().any(|known| known.name == *name));
        let after = laid_over(base, &overlay);
        if (&after.places, &after.zones) == (&self.now.places, &self.now.zones) {
            return Ok(None);
        }
        if after.places.len() > MAX_PLACES {
            return Err(Refusal::rejected(format!("{MAX_PLACES} places: no more may be added")));
        }
        let corners: usize = after.zones.iter().map(|zone| zone.points.len()).sum();
        if corners > MAX_CORNERS {
            return Err(Refusal::rejected(format!(
                "the zones would have {corners} corners: expected at most {MAX_CORNERS}"
            )));
        }
        Zones::new(&after.zones).map_err(Refusal::rejected)?;
        overlay.revision += 1;
        Ok(Some(overlay))
    }
}

fn check_name(name: &str) -> Result<(), Refusal> {
    let is_plain = !name.trim().is_empty() && name.len() <= MAX_NAME && !name.chars().any(char::is_control);
    // `|` and `;` separate goals in the ports of a tree.
    if is_plain && !name.contains(['|', ';']) && name.trim() == name {
        return Ok(());
    }
    let found: String = name.chars().take(MAX_NAME).collect();
    Err(Refusal::bad_request(format!(
        "the name {found:?}: expected 1 to {MAX_NAME} bytes without `|`, `;`, line breaks or spaces at its ends"
    )))
}

fn unknown<'a>(kind: &str, name: &str, known: impl Iterator<Item = &'a String>) -> Refusal {
    let name: String = name.chars().take(MAX_NAME).collect();
    let known: Vec<&str> = known.take(20).map(String::as_str).collect();
    let known = if known.is_empty() {
        "there is none".to_owned()
    } else {
        format!("there are {}", known.join(", "))
    };
    Refusal::NotFound {
        what: format!("{kind} `{name}`; {known}"),
    }
}
