//! Slow movers. Which objects move too slowly for the scans of the last second to show it?
//!
//! An isolated round object is watched for some seconds. It has moved once it is seen elsewhere and a beam passes through the former place
//! of its center: no beam passes through a static object, wherever the robot looks from. A wall has no visible center, and the ends of its
//! visible part move with the robot: only segments that bulge towards the lidar count.

use std::collections::VecDeque;

use nalgebra::{Point2, Vector2};
use zenav_protocol::time::Stamp;

use crate::field_of_view::ProjectedScan;

/// Most objects watched.
const MOST: usize = 64;
/// Period at which centers are stored, and for how long they are kept, s.
const EVERY: f64 = 0.25;
const MEMORY: f64 = 5.0;
/// Minimum age of a stored center that is tested for beams through it, s.
const LEAST_AGE: f64 = 0.8;
/// An object seen farther than this from its last place, m, or later than this, s, is another one.
const FARTHEST: f64 = 0.25;
const UNSEEN: f64 = 0.6;
/// Minimum distance moved, m, unless the object's radius is larger; plus this share of the distance by which the robot's turn swings it
/// around.
const LEAST_WAY: f64 = 0.2;
const TURN_ERROR: f64 = 0.06;
/// A beam passes through a place if it ends this far behind it, m.
const BEHIND: f64 = 0.1;
/// Number of scans in a row that must show it moved.
const EVIDENCE: u32 = 3;

/// An isolated round object as seen in a scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Round {
    /// Odometry frame, m.
    pub(crate) center: Point2<f64>,
    /// m.
    pub(crate) radius: f64,
}

/// An object that was seen to move slowly.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SlowMover {
    /// Its index among the objects seen.
    pub(crate) index: usize,
    /// m/s.
    pub(crate) velocity: Vector2<f64>,
    /// Time over which the velocity was measured, s.
    pub(crate) secs: f64,
}

/// A watched object.
#[derive(Clone, Debug)]
struct Watched {
    /// Its centers, odometry frame, and the robot's heading, rad, then; oldest first.
    places: VecDeque<(Stamp, Point2<f64>, f64)>,
    /// Where it was last seen.
    last: (Stamp, Point2<f64>),
    evidence: u32,
}

/// All watched objects.
#[derive(Clone, Debug, Default)]
pub(crate) struct SlowMovers {
    watched: Vec<Watched>,
}

impl SlowMovers {
    /// Takes the round objects of a scan that are not known to move, each with its index; returns those that do.
    pub(crate) fn insert(
        &mut self,
        scan: &ProjectedScan<'_>,
        seen: impl Iterator<Item = (usize, Round)>,
    ) -> Vec<SlowMover> {
        let (now, yaw) = (scan.stamp, scan.odom_from_base.rotation.angle());
        self.watched.retain(|watched| now.secs_since(watched.last.0) <= UNSEEN);
        let mut moving = Vec::new();
        for (index, round) in seen {
            let off = |watched: &Watched| (watched.last.1 - round.center).norm();
            let known = self.watched.iter_mut().filter(|watched| watched.last.0 < now);
            let nearest = known.min_by(|a, b| off(a).total_cmp(&off(b)));
            let Some(watched) = nearest.filter(|watched| off(watched) <= FARTHEST) else {
                if self.watched.len() < MOST {
                    self.watched.push(Watched {
                        places: VecDeque::from([(now, round.center, yaw)]),
                        last: (now, round.center),
                        evidence: 0,
                    });
                }
                continue;
            };
            watched.last = (now, round.center);
            match watched.velocity(scan, round, yaw) {
                Some((velocity, secs)) => {
                    watched.evidence += 1;
                    if watched.evidence >= EVIDENCE {
                        moving.push(SlowMover { index, velocity, secs });
                    }
                }
                None => watched.evidence = 0,
            }
            watched.keep(now, round.center, yaw);
        }
        moving
    }
}

impl Watched {
    fn keep(&mut self, now: Stamp, center: Point2<f64>, yaw: f64) {
        if self
            .places
            .back()
            .is_none_or(|(stamp, ..)| now.secs_since(*stamp) >= EVERY)
        {
            self.places.push_back((now, center, yaw));
        }
        while self
            .places
            .front()
            .is_some_and(|(stamp, ..)| now.secs_since(*stamp) > MEMORY)
        {
            self.places.pop_front();
        }
    }

    /// Its velocity, m/s, and the time, s, since the newest stored place from which it has evidently moved.
    fn velocity(&self, scan: &ProjectedScan<'_>, round: Round, yaw: f64) -> Option<(Vector2<f64>, f64)> {
        let range = (round.center - scan.laser()).norm();
        self.places.iter().rev().find_map(|(stamp, place, heading)| {
            let age = scan.stamp.secs_since(*stamp);
            let way = round.center - place;
            let swung = 2.0 * (0.5 * (yaw - heading)).sin().abs() * range;
            let least = round.radius.max(LEAST_WAY) + TURN_ERROR * swung;
            (age >= LEAST_AGE && way.norm() >= least && is_seen_through(scan, *place)).then(|| (way / age, age))
        })
    }
}

/// Whether the beams through a place, odometry frame, continue behind it.
fn is_seen_through(scan: &ProjectedScan<'_>, place: Point2<f64>) -> bool {
    scan.beam_to(place)
        .is_some_and(|(beam, range)| scan.reaches(beam, 1, range + BEHIND))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::obstacle_tracks::tests::watch;

    #[test]
    fn who_sets_out_after_standing_is_found_with_their_speed() {
        let robot = zenav_fixtures::robot("tiago");
        let moving = watch(&robot, 7.0, |now| {
            vec![Point2::new(2.0, 0.8 + 0.2 * (now - 4.0).max(0.0))]
        });
        let found: Vec<_> = moving.tracks().iter().map(|track| track.velocity).collect();
        assert!(
            matches!(found[..], [velocity] if (velocity - Vector2::new(0.0, 0.2)).norm() < 0.06),
            "{found:?}"
        );
    }

    #[test]
    fn what_creeps_ahead_of_the_robot_or_beside_it_is_found_and_what_stands_is_not() {
        let robot = zenav_fixtures::robot("tiago");
        for (walks, is_found) in [
            (Vector2::new(0.12, 0.0), true),
            (Vector2::new(0.0, 0.12), true),
            (Vector2::zeros(), false),
        ] {
            let moving = watch(&robot, 6.0, |now| vec![Point2::new(2.0, 0.8) + walks * now]);
            let found: Vec<_> = moving.tracks().iter().map(|track| track.velocity).collect();
            assert_eq!(!found.is_empty(), is_found, "{walks}: {found:?}");
            assert!(
                found.iter().all(|velocity| (velocity - walks).norm() < 0.04),
                "{walks}: {found:?}"
            );
        }
    }
}
