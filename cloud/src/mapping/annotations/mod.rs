//! Annotations. Places and zones of a robot's map, and how they change.
//!
//! The base comes from the world and the deployment. Operators' changes are kept in a file as an overlay, so later edits of the base still
//! take effect. A change is on disk before it is published or acknowledged.
//!
//! Coordinates belong to a frame of the map. The file names its frame; the base's coordinates are as configured. [`Carried`] is kept with
//! SLAM's session and holds both in the session's frame: a resumed session has its places and zones where the last run had moved them.
//!
//! | file | subject |
//! |---|---|
//! | `overlay` | operators' changes, laid over the base, and their file |
//! | `changes` | which changes are admitted |
//! | `carrying` | places and zones that move with the map |
//! | `succession` | lists of other mapping services |

mod carrying;
mod changes;
mod overlay;
mod succession;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use zenav_protocol::messages::{AnnotateAction, Annotations, GoalPoint, Refusal};
use zenav_space::Zones;

use super::MappingError;

pub(super) use carrying::Carried;
use overlay::{Overlay, UNREADABLE, laid_over, with_own_names};

/// Name of the file in a robot's folder.
const FILE: &str = "annotations.json";

/// The annotations of one robot's map.
#[derive(Debug)]
pub(super) struct AnnotationBook {
    base: Annotations,
    overlay: Overlay,
    /// Base and overlay as given: by world and deployment, and in the file.
    given: (Annotations, Overlay),
    file: Option<PathBuf>,
    now: Annotations,
}

impl AnnotationBook {
    /// The base, overlaid with the changes of earlier runs.
    ///
    /// # Errors
    /// [`MappingError::Annotations`] for an unreadable file: a keep-out zone must not vanish silently.
    pub(super) fn open(
        places: BTreeMap<String, GoalPoint>,
        zones: &Zones,
        folder: Option<&Path>,
    ) -> Result<Self, MappingError> {
        let file = folder.map(|folder| folder.join(FILE));
        let overlay = match &file {
            Some(file) => Overlay::read(file).map_err(|problem| MappingError::Annotations {
                file: file.clone(),
                problem,
            })?,
            None => Overlay::default(),
        };
        let base = annotations_of(places, zones);
        let now = laid_over(&base, &overlay);
        Ok(Self {
            given: (base.clone(), overlay.clone()),
            base,
            overlay,
            file,
            now,
        })
    }

    /// As [`Self::open`] for a service that takes over: a file that cannot be read is set aside, and what was followed is in force.
    pub(super) fn open_or_set_aside(
        robot: &str,
        places: BTreeMap<String, GoalPoint>,
        zones: &Zones,
        folder: Option<&Path>,
    ) -> Result<Self, MappingError> {
        match Self::open(places.clone(), zones, folder) {
            Err(MappingError::Annotations { file, problem }) => {
                let aside = file.with_extension(format!("json.{UNREADABLE}"));
                let is_aside = std::fs::rename(&file, &aside).is_ok();
                tracing::error!(
                    robot,
                    file = %file.display(),
                    aside = %aside.display(),
                    is_aside,
                    problem,
                    "the stored places and zones cannot be read: those that were followed are in force"
                );
                Self::open(places, zones, folder.filter(|_| is_aside))
            }
            opened => opened,
        }
    }

    /// Sets the frame of all coordinates.
    pub(super) fn are_in(&mut self, frame: u64) {
        self.base.frame = frame;
        self.overlay.frame = frame;
        self.now = laid_over(&self.base, &self.overlay);
    }

    /// The annotations in force.
    pub(super) fn now(&self) -> &Annotations {
        &self.now
    }

    /// Carries out a change and stores it; returns whether anything changed.
    pub(super) async fn change(&mut self, action: AnnotateAction) -> Result<bool, Refusal> {
        let Some(overlay) = self.changed(action)? else {
            return Ok(false);
        };
        self.store(&overlay).await?;
        self.given.1.clone_from(&overlay);
        self.overlay = overlay;
        self.now = laid_over(&self.base, &self.overlay);
        Ok(true)
    }

    /// Writes the overlay to its file, if there is one.
    async fn store(&self, overlay: &Overlay) -> Result<(), Refusal> {
        match &self.file {
            Some(file) => overlay.write(file.clone()).await,
            None => Ok(()),
        }
    }

    /// Sets an overlay that is stored.
    fn adopt(&mut self, overlay: Overlay) {
        let frame = overlay.frame;
        self.given.1.clone_from(&overlay);
        self.overlay = overlay;
        self.are_in(frame);
    }
}

/// The annotations of a map with these places and zones that nobody has changed. A zone whose name is taken gets a number.
#[must_use]
pub fn annotations_of(places: BTreeMap<String, GoalPoint>, zones: &Zones) -> Annotations {
    let given = Annotations {
        places,
        zones: with_own_names(zones.to_messages()),
        ..Annotations::default()
    };
    laid_over(&given, &Overlay::default())
}
