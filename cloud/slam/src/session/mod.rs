//! Sessions. How does a map go on at another time?
//!
//! A session is a drive with one chain of odometry. [`Slam::save`] makes bytes of all sessions so far, [`Slam::load`] a map of these,
//! [`Slam::begin_session`] begins the next one in it.
//!
//! | file | answers |
//! |---|---|
//! | `file` | are these bytes a session, whole and of a known version? |
//! | `content` | what of a map is kept? |
//! | `grid` | how are points written down? |

mod content;
mod file;
mod grid;

use std::sync::Arc;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

pub use file::{MOST_BYTES, SessionError};
pub(crate) use grid::on_grid;

use self::content::Content;
use crate::settings::SlamSettings;
use crate::slam::Slam;

/// A drive with one chain of odometry.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Session {
    /// How many nodes come from it.
    pub(crate) nodes: usize,
    /// Where its beams begin, in the frame of the base, m.
    pub(crate) laser: Point2<f64>,
}

impl Default for Session {
    fn default() -> Self {
        Self {
            nodes: 0,
            laser: Point2::origin(),
        }
    }
}

/// Where the beams of a node's scan begin, in the frame of its base, m.
pub(crate) fn laser_of(sessions: &[Session], node: usize) -> Point2<f64> {
    let mut end = 0;
    let session = sessions.iter().find(|session| {
        end += session.nodes;
        node < end
    });
    session.copied().unwrap_or_default().laser
}

/// A map as it was at a moment, to be made bytes beside what goes on.
#[derive(Debug)]
pub struct Snapshot {
    content: Content,
    scans: Vec<Arc<Vec<Point2<f64>>>>,
}

impl Snapshot {
    /// What [`Slam::save`] would have made at that moment.
    ///
    /// # Errors
    /// [`SessionError::TooLarge`].
    pub fn into_bytes(self) -> Result<Vec<u8>, SessionError> {
        file::written(&self.content.with_scans(&self.scans))
    }
}

impl Slam {
    /// The map as it is now: poses and measurements are copied, points of scans are not.
    ///
    /// # Errors
    /// [`SessionError::Unlocated`], as [`Self::save`].
    pub fn snapshot(&self) -> Result<Snapshot, SessionError> {
        if !self.is_located() {
            return Err(SessionError::Unlocated);
        }
        Ok(Snapshot {
            content: Content::of(self),
            scans: self.scans.clone(),
        })
    }

    /// The map as bytes, and all that is needed to go on as if it had never been away: poses, measurements with their weights, points of
    /// scans on the grid of a millimetre that they were taken in on, submaps by what was inserted where, and what was learned of odometry.
    ///
    /// # Errors
    /// [`SessionError::Unlocated`] while the session was not found in the older map: save when [`Self::is_located`].
    /// [`SessionError::TooLarge`].
    pub fn save(&self) -> Result<Vec<u8>, SessionError> {
        self.snapshot()?.into_bytes()
    }

    /// The map that [`Self::save`] made these bytes of. Likelihood fields and surfels are made anew.
    ///
    /// # Errors
    /// See [`SessionError`]: never a part of a map.
    pub fn load(bytes: &[u8]) -> Result<Self, SessionError> {
        file::read(bytes)?.into_slam()
    }

    /// The map that goes on with other settings than it was begun with: they hold for the scans to come. Points and poses stay as they are;
    /// likelihood fields and surfels are made anew where that takes it.
    #[must_use]
    pub fn with_settings(mut self, settings: SlamSettings) -> Self {
        let was = std::mem::replace(&mut self.settings, settings);
        if was.field != settings.field {
            for submap in &mut self.submaps {
                *submap = submap.redrawn(&self.sessions, &self.scans, &settings.field);
            }
        }
        if (was.field, was.scan, was.refine) != (settings.field, settings.scan, settings.refine) {
            // Scores are others from now on.
            self.usual = 0.0;
        }
        self
    }

    /// The settings in force.
    #[must_use]
    pub fn settings(&self) -> &SlamSettings {
        &self.settings
    }
}
