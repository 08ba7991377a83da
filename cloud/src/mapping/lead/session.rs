//! Session. How does the leader keep SLAM's session in the robot's folder? It is stored beside the map as it grows, and the next start resumes
//! it.

use std::io;
use std::path::Path;

use tokio::task::JoinHandle;
use zenav_protocol::messages::Refusal;
use zenav_protocol::time::Stamp;

use super::super::slam_session::{self, KeepError, Written};
use super::super::{PoseSource, storage};
use super::Leadership;

/// Pause after a failed attempt to store the session, s.
const KEEP_AGAIN: f64 = 10.0;
/// Suffix of a session set aside for another one.
const BEFORE: &str = "before";

/// The session on disk, and the one being written.
pub(super) struct KeptSession {
    writing: Option<JoinHandle<Result<Written, KeepError>>>,
    /// Whether the session on disk belongs to this map, and not to an earlier run that was not resumed.
    is_own: bool,
    /// Frame of the session on disk.
    frame: u64,
    /// Number of the change that it leads a successor to.
    change: u64,
    /// When writing last failed.
    failed: Option<Stamp>,
}

impl KeptSession {
    /// `is_own`: the map goes on with the session on disk; `frame`: the map's frame.
    pub(super) fn new(is_own: bool, frame: u64) -> Self {
        Self {
            writing: None,
            is_own,
            frame,
            change: 0,
            failed: None,
        }
    }

    /// Frame of the session on disk.
    pub(super) fn frame(&self) -> u64 {
        self.frame
    }
}

impl Leadership {
    /// Stores the session of SLAM if due, in the background. When this returns, the session on disk leads a successor to the frame in force
    /// and, with `anyway`, is the newest.
    ///
    /// # Errors
    /// If a session requested by `anyway` is not on disk; other failures are retried after a while.
    pub(super) async fn keep(&mut self, now: Stamp, anyway: bool) -> Result<(), Refusal> {
        let Some(folder) = self.config.folder.clone() else {
            return Ok(());
        };
        if anyway || self.session.writing.as_ref().is_some_and(JoinHandle::is_finished) {
            // A failed write is due again.
            let _ = self.was_kept(now).await;
        }
        // Usually the session being written leads there.
        if self.session.change < self.core.in_force() {
            let _ = self.was_kept(now).await;
        }
        if self.rests(now) && !anyway || !self.core.is_keep_due(anyway) || self.session.writing.is_some() {
            return Ok(());
        }
        let kept = match self.core.kept() {
            Ok(Some(mut kept)) => {
                kept.head.annotations = self.annotations.carried();
                kept
            }
            Ok(None) => return Ok(()),
            Err(error) => return self.is_not_kept(now, &error.into()),
        };
        let is_missing = self.session.change < self.core.in_force();
        let (robot, is_own) = (self.config.robot.clone(), self.session.is_own);
        let term = self.pulse.leader().term;
        self.session.writing = Some(tokio::task::spawn_blocking(move || {
            if !is_own {
                make_room(&robot, &folder)?;
            }
            let (frame, change) = (kept.head.frame, kept.change);
            let on_disk = slam_session::write(&folder, kept)?;
            storage::note_leadership(&robot, Some(&folder), term);
            Ok(Written { frame, change, on_disk })
        }));
        if !is_missing && !anyway {
            return Ok(());
        }
        let kept = self.was_kept(now).await;
        if anyway { kept } else { Ok(()) }
    }

    /// Whether storing pauses because the last attempt failed.
    fn rests(&self, now: Stamp) -> bool {
        let since = |then: Stamp| now.secs_since(then) < KEEP_AGAIN && now >= then;
        self.session.failed.is_some_and(since)
    }

    /// Waits until the session being written is on disk.
    async fn was_kept(&mut self, now: Stamp) -> Result<(), Refusal> {
        let Some(writing) = self.session.writing.take() else {
            return Ok(());
        };
        match writing.await.unwrap_or_else(|error| Err(KeepError::Task(error))) {
            Ok(Written { frame, change, on_disk }) => {
                (self.session.frame, self.session.change) = (frame, change);
                self.session.is_own = true;
                self.session.failed = None;
                self.core.was_kept(on_disk);
                Ok(())
            }
            Err(error) => self.is_not_kept(now, &error),
        }
    }

    fn is_not_kept(&mut self, now: Stamp, error: &KeepError) -> Result<(), Refusal> {
        tracing::error!(
            robot = self.config.robot,
            %error,
            "the session of SLAM is not kept: after a restart its map is as it was before"
        );
        self.session.failed = Some(now);
        self.core.was_not_kept(matches!(error, KeepError::Changed { .. }));
        Err(Refusal::internal(format!("the session of SLAM is not kept: {error}")))
    }

    /// Makes the map that was stored in the robot's folder the one that the next start begins with. A session of SLAM that belongs to another
    /// map is set aside.
    pub(super) async fn leave_map(&mut self, now: Stamp) -> Result<(), Refusal> {
        let _ = self.was_kept(now).await;
        let Some(folder) = self.config.folder.clone() else {
            return Ok(());
        };
        let (robot, term) = (self.config.robot.clone(), self.pulse.leader().term);
        let is_slam = self.config.poses.source == PoseSource::Slam;
        let is_own = self.session.is_own;
        let left = tokio::task::spawn_blocking(move || {
            if is_slam && !is_own {
                make_room(&robot, &folder)?;
            }
            // This map's own session is resumed in preference to the map, and has noted its leadership.
            if !is_slam || !slam_session::is_in(&folder)? {
                storage::note_leadership(&robot, Some(&folder), term);
            }
            Ok(())
        });
        let left = left.await.map_err(Refusal::internal)?;
        left.map_err(|error| Refusal::internal(KeepError::Io(error)))
    }

    /// Deletes the session of SLAM because another map is to start. A session that this run did not resume is set aside; with other pose
    /// sources there is nothing to delete.
    pub(super) async fn forget_session(&mut self, now: Stamp) -> Result<(), Refusal> {
        let _ = self.was_kept(now).await;
        self.session.change = 0;
        let is_slam = self.config.poses.source == PoseSource::Slam;
        let Some(folder) = self.config.folder.clone().filter(|_| is_slam) else {
            return Ok(());
        };
        let (robot, is_own) = (self.config.robot.clone(), self.session.is_own);
        let removed = tokio::task::spawn_blocking(move || {
            if is_own {
                slam_session::remove(&folder)
            } else {
                make_room(&robot, &folder)
            }
        });
        let removed = removed.await.map_err(Refusal::internal)?;
        removed.map_err(|error| Refusal::internal(KeepError::from(error)))
    }
}

/// Sets aside a session of an earlier run that this run did not resume.
fn make_room(robot: &str, folder: &Path) -> io::Result<()> {
    if let Some(aside) = slam_session::set_aside(folder, BEFORE)? {
        tracing::warn!(
            robot,
            aside = %aside.display(),
            "SLAM did not begin with its session, but with another map: the session is set aside"
        );
    }
    Ok(())
}
