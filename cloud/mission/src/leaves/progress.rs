//! Progress. Does the robot advance? A drive fails without enough distance or rotation in time (Nav2's PoseProgressChecker).

use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::time::Stamp;

use crate::context::Context;
use crate::settings::ProgressSettings;

/// Weight of time in which a robot makes way for another one, which may first have to come through a lane.
const MAKING_WAY: f64 = 0.25;

/// Time since the robot last made progress.
#[derive(Clone, Copy, Debug, Default)]
pub struct Progress {
    anchor: Option<Anchor>,
}

/// Where the robot last made progress.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    pose: Pose2,
    /// Time of the last check, and time without progress so far, s.
    looked: Stamp,
    stuck: f64,
}

/// Longest time counted between two ticks, s: more means that the goal was paused and the robot told to stand.
pub(super) const LONGEST_LOOK: f64 = 1.0;

impl Progress {
    /// Starts over: what holds the robot up now is not the drive's fault.
    pub fn reset(&mut self) {
        self.anchor = None;
    }

    /// Whether the robot has been without progress for too long.
    pub fn is_stuck(&mut self, ctx: &Context) -> bool {
        let Some(pose) = ctx.robot.pose() else { return false };
        let makes_way = ctx.robot.state().is_some_and(|state| state.makes_way);
        self.look(ctx.now, pose, makes_way, &ctx.config.settings.progress)
    }

    fn look(&mut self, now: Stamp, pose: Pose2, makes_way: bool, settings: &ProgressSettings) -> bool {
        let gets_on = |anchor: &Anchor| {
            anchor.pose.distance(&pose) >= settings.distance
                || wrap_angle(pose.yaw - anchor.pose.yaw).abs() >= settings.angle
        };
        let (looked, stuck) = (now, 0.0);
        let fresh = Anchor { pose, looked, stuck };
        let anchor = self.anchor.get_or_insert(fresh);
        if gets_on(anchor) {
            *anchor = fresh;
        }
        let since = now.secs_since(anchor.looked).min(LONGEST_LOOK);
        anchor.stuck += since * if makes_way { MAKING_WAY } else { 1.0 };
        anchor.looked = now;
        anchor.stuck > settings.timeout
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_is_no_want_of_progress() {
        let settings = ProgressSettings::default();
        let mut progress = Progress::default();
        let mut is_stuck = |secs| progress.look(Stamp::from_secs(secs), Pose2::IDENTITY, false, &settings);
        assert!(!is_stuck(0.0) && !is_stuck(1.0));
        assert!(!is_stuck(1.0 + 10.0 * settings.timeout), "nobody looked meanwhile");
    }

    #[test]
    fn a_robot_is_stuck_after_a_time_without_progress_and_later_where_it_makes_way() {
        let settings = ProgressSettings::default();
        let stuck_after = |makes_way: fn(f64) -> bool, pose: fn(f64) -> Pose2| {
            let mut progress = Progress::default();
            (0..1200).map(|nth| 0.1 * f64::from(nth)).find(|secs| {
                let now = Stamp::from_secs(*secs);
                progress.look(now, pose(*secs), makes_way(*secs), &settings)
            })
        };
        let stands = |_: f64| Pose2::IDENTITY;
        let is = |found: Option<f64>, secs: f64| found.is_some_and(|found| (found - secs).abs() < 0.3);
        assert!(is(stuck_after(|_| false, stands), settings.timeout));
        assert!(is(stuck_after(|_| true, stands), settings.timeout / MAKING_WAY));
        // A robot that waited for long is not stuck as soon as the way is free.
        assert!(is(
            stuck_after(|secs| secs < 16.0, stands),
            16.0 + settings.timeout - 16.0 * MAKING_WAY
        ));
        assert_eq!(stuck_after(|_| false, |secs| Pose2::new(0.1 * secs, 0.0, 0.0)), None);
    }
}
