//! Map frame. How did loop closures move the map, and where are its parts now?
//!
//! A loop closure moves parts of a SLAM map, each as a rigid body. Such a change starts the next **frame**: frames are numbered, and a
//! coordinate is valid in exactly one of them. Stored coordinates must be carried over to the new frame: the robot uses
//! [`Correction::moves`](super::Correction) for this, everything else uses [`MapFrame`].

use serde::{Deserialize, Serialize};

use super::{GoalPoint, MapRef};
use crate::geometry::Pose2;
use crate::time::Stamp;

/// Most moves in a message: a receiver that missed more frames than this starts over.
pub const MOST_MOVES: usize = 16;

/// Most frames that a receiver may have missed: anything later is not of mapping, and would make everything that follows count as old.
pub const MOST_MISSED_FRAMES: u64 = 1 << 20;

/// Whether a frame can come after the one that is known; before the first one, 0.
#[must_use]
pub const fn may_follow(frame: u64, known: u64) -> bool {
    frame <= known.saturating_add(MOST_MISSED_FRAMES)
}

/// A place farther than this from the origins of all parts belongs to no part, m: it was never seen from close by.
const PART_REACH: f64 = 10.0;

/// Frame of a map, and where its parts are in it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MapFrame {
    /// Stamp of the newest scan in the map, on the robot's clock.
    pub stamp: Stamp,
    /// The map and its frame. The first map revision drawn in this frame is published later.
    pub map: MapRef,
    /// How the map around the robot moved at the start of each of the last frames, `new_from_old`; the move into this frame is last.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub moves: Vec<Pose2>,
    /// Pose of each part of the map, `map_from_part`, in the order in which the parts were started. A part keeps its number.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<Pose2>,
}

impl MapFrame {
    /// The part of the map that a place belongs to: the nearest one, or the newest of several equally near; none where all are too far.
    #[must_use]
    pub fn part_at(&self, x: f64, y: f64) -> Option<usize> {
        let distance = |part: &Pose2| (part.x - x).hypot(part.y - y);
        let parts = self.parts.iter().enumerate().rev();
        parts
            .map(|(number, part)| (number, distance(part)))
            .min_by(|(_, a), (_, b)| a.total_cmp(b))
            .filter(|(_, distance)| *distance <= PART_REACH)
            .map(|(number, _)| number)
    }

    /// How the surroundings of a place moved up to a later frame of the map, `new_from_old`; `None` where the place belongs to no part.
    #[must_use]
    pub fn moved_at(&self, x: f64, y: f64, later: &Self) -> Option<Pose2> {
        let part = self.part_at(x, y)?;
        Some(*later.parts.get(part)? * self.parts.get(part)?.inverse())
    }

    /// Whether the message is usable: all moves and poses are finite, and there are no more moves than frames.
    #[must_use]
    pub fn is_sane(&self) -> bool {
        self.moves.len() <= MOST_MOVES
            && self.moves.len() as u64 <= self.map.frame
            && self.moves.iter().chain(&self.parts).all(Pose2::is_finite)
    }
}

/// How the map around the robot moved from frame `from` to frame `to`, `new_from_old`, composed from the `moves` that led to `to`; `None`
/// where the moves do not reach back to `from`, and when `from` is later than `to`.
///
/// ```
/// use zenav_protocol::geometry::Pose2;
/// use zenav_protocol::messages::moved_between;
///
/// let moves = [Pose2::new(1.0, 0.0, 0.0), Pose2::new(0.0, 2.0, 0.0)];
/// assert_eq!(moved_between(5, 7, &moves), Some(Pose2::new(1.0, 2.0, 0.0)));
/// assert_eq!(moved_between(7, 7, &moves), Some(Pose2::IDENTITY));
/// assert_eq!(moved_between(4, 7, &moves), None, "too long ago");
/// ```
#[must_use]
pub fn moved_between(from: u64, to: u64, moves: &[Pose2]) -> Option<Pose2> {
    let count = usize::try_from(to.checked_sub(from)?).ok()?;
    let since = moves.get(moves.len().checked_sub(count)?..)?;
    let moved = since.iter().fold(Pose2::IDENTITY, |moved, next| *next * moved);
    moved.is_finite().then_some(moved)
}

impl GoalPoint {
    /// The place, carried along by a move of the map part it belongs to.
    #[must_use]
    pub fn moved(&self, new_from_old: Pose2) -> Self {
        let place = new_from_old * self.pose();
        Self {
            x: place.x,
            y: place.y,
            yaw: self.yaw.map(|_| place.yaw),
        }
    }
}

/// For `skip_serializing_if`: the first frame is left out.
pub(crate) const fn is_first(frame: &u64) -> bool {
    *frame == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_belongs_to_the_part_beside_it() {
        let frame = MapFrame {
            parts: vec![Pose2::IDENTITY, Pose2::new(5.0, 0.0, 1.0), Pose2::new(5.0, 0.0, 0.5)],
            ..MapFrame::default()
        };
        assert_eq!(frame.part_at(1.0, 1.0), Some(0));
        assert_eq!(frame.part_at(4.0, 1.0), Some(2), "the newest of those that lie there");
        assert_eq!(MapFrame::default().part_at(0.0, 0.0), None);
    }
}
