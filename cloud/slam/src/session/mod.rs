//! Sessions. Saves a map and continues it later.
//!
//! A session is a drive with one chain of odometry. [`Slam::save`] encodes all sessions so far, [`Slam::load`] restores the map,
//! [`Slam::begin_session`] begins the next session in it.
//!
//! | file | answers |
//! |---|---|
//! | `file` | are these bytes a session, complete and of a known version? |
//! | `content` | which data of a map is stored? |
//! | `grid` | how are points stored? |

mod content;
mod file;
mod grid;

use std::sync::Arc;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

pub use file::{MOST_BYTES, SessionError};
pub(crate) use grid::{on_grid, packed};

use self::content::Content;
use crate::settings::SlamSettings;
use crate::slam::Slam;

/// A drive with one chain of odometry.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Session {
    /// Number of its nodes.
    pub(crate) nodes: usize,
    /// Origin of its beams in the base frame, m.
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

/// Origin of the beams of a node's scan in the base frame, m.
pub(crate) fn laser_of(sessions: &[Session], node: usize) -> Point2<f64> {
    let mut end = 0;
    let session = sessions.iter().find(|session| {
        end += session.nodes;
        node < end
    });
    session.copied().unwrap_or_default().laser
}

/// A map at one moment, for encoding in the background.
#[derive(Debug)]
pub struct Snapshot {
    content: Content,
    scans: Vec<Arc<Vec<Point2<f64>>>>,
}

impl Snapshot {
    /// The bytes that [`Slam::save`] would have returned at that moment.
    ///
    /// # Errors
    /// [`SessionError::TooLarge`].
    pub fn into_bytes(self) -> Result<Vec<u8>, SessionError> {
        file::written(&self.content.with_scans(&self.scans))
    }
}

impl Slam {
    /// The map as it is now: poses and measurements are copied, points of scans are shared.
    ///
    /// ```
    #[doc = include_str!("../doc_setup/mapped_room.txt")]
    /// let (snapshot, saved) = (slam.snapshot()?, slam.save()?);
    /// slam.step(&look(9.0, Pose2::new(1.08, 0.0, 0.0)))?;
    /// assert_eq!(snapshot.into_bytes()?, saved, "the map as it was");
    /// assert_ne!(slam.save()?, saved);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
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

    /// The map as bytes, with everything needed to continue without a trace of the interruption: poses, measurements with their weights,
    /// points of scans on their millimetre grid, where each scan was inserted into its submaps, and the learned odometry. Not stored: the
    /// last readings of GPS and compass, if they are no measurements of a node yet, and what the last scan saw; the next scans bring newer ones.
    ///
    /// ```
    #[doc = include_str!("../doc_setup/mapped_room.txt")]
    /// # use zenav_slam::{Slam, SlamSettings};
    /// let again = Slam::load(&slam.save()?)?;
    /// assert_eq!(again.nodes(), slam.nodes());
    /// assert_eq!(again.scan(8), slam.scan(8));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`SessionError::Unlocated`] while the session has not been found in the older map: save when [`Self::is_located`].
    /// [`SessionError::TooLarge`].
    pub fn save(&self) -> Result<Vec<u8>, SessionError> {
        self.snapshot()?.into_bytes()
    }

    /// The map that [`Self::save`] encoded. Likelihood fields and surfels are recomputed.
    ///
    /// ```
    #[doc = include_str!("../doc_setup/mapped_room.txt")]
    /// # use zenav_slam::{SessionError, Slam, SlamSettings};
    /// let mut bytes = slam.save()?;
    /// assert!(Slam::load(&bytes).is_ok());
    /// assert!(matches!(Slam::load(&bytes[..bytes.len() - 1]), Err(SessionError::Length { .. })));
    /// bytes[100] ^= 1;
    /// assert_eq!(Slam::load(&bytes).unwrap_err(), SessionError::Checksum);
    /// assert_eq!(Slam::load(b"P5 640 480 255").unwrap_err(), SessionError::Foreign);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// See [`SessionError`]; a partial map is never returned.
    pub fn load(bytes: &[u8]) -> Result<Self, SessionError> {
        file::read(bytes)?.into_slam()
    }

    /// The map with other settings, which apply to further scans. Points and poses stay as they are; likelihood fields and surfels are
    /// recomputed if needed.
    ///
    /// ```
    #[doc = include_str!("../doc_setup/mapped_room.txt")]
    /// # use zenav_slam::{FrontSettings, Slam, SlamSettings};
    /// let front = FrontSettings { distance: 0.2, ..FrontSettings::default() };
    /// let mut slam = slam.with_settings(SlamSettings { front, ..SlamSettings::default() });
    /// let next = slam.step(&look(9.0, Pose2::new(1.08, 0.0, 0.0)))?;
    /// assert!(!next.is_inserted, "0.12 m was enough for a node before");
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn with_settings(mut self, settings: SlamSettings) -> Self {
        let was = std::mem::replace(&mut self.settings, settings);
        if was.field != settings.field {
            for submap in &mut self.submaps {
                *submap = submap.redrawn(&self.sessions, &self.scans, &settings.field);
            }
        }
        if (was.field, was.scan, was.refine) != (settings.field, settings.scan, settings.refine) {
            // Scores change with these settings.
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
