//! Map frame. Which map frame is in force, and what is carried over when the map moves?
//!
//! A loop closure moves the map: it begins the next frame, and corrections state how the robot's surroundings moved. Before such a
//! correction is fused, the estimate, the plan in force and the trail home move with the surroundings: nothing moves relative to the walls,
//! so the robot neither twitches nor stops. A correction is ignored if its frame is older, or if the moves that it states do not lead from
//! the robot's frame to its own.

use std::collections::VecDeque;

use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{Correction, MOST_MOVES, may_follow, moved_between};

use super::Pilot;

/// The present frame, and how the map moved of late.
#[derive(Clone, Debug, Default)]
pub(super) struct Frame {
    /// `None` before the first correction: the estimate is then tied to no frame.
    number: Option<u64>,
    /// `new_from_old`; the move into the present frame comes last.
    moves: VecDeque<Pose2>,
}

impl Frame {
    /// Number of the present frame; 0 before the first.
    pub(super) fn number(&self) -> u64 {
        self.number.unwrap_or(0)
    }

    /// How the map has moved since another frame; `None` if that is not known, and for a later frame.
    pub(super) fn moved_since(&self, frame: u64) -> Option<Pose2> {
        let moves: Vec<Pose2> = self.moves.iter().copied().collect();
        moved_between(frame, self.number(), &moves)
    }

    /// Advances to the frame of a correction. Returns how the map moved, or `None` if the correction is ignored.
    fn advance(&mut self, correction: &Correction) -> Option<Pose2> {
        let frame = correction.frame;
        if !may_follow(frame, self.number()) {
            return None;
        }
        let moved = match self.number {
            Some(present) if frame < present => return None,
            Some(present) => moved_between(present, frame, &correction.moves),
            None => Some(Pose2::IDENTITY),
        };
        match moved {
            Some(moved) => {
                let told = self.number.map_or(0, |present| (frame - present) as usize);
                let first = correction.moves.len() - told.min(correction.moves.len());
                self.moves.extend(&correction.moves[first..]);
                let over = self.moves.len().saturating_sub(MOST_MOVES);
                self.moves.drain(..over);
                self.number = Some(frame);
                Some(moved)
            }
            // When the robot is found anew, its earlier estimate does not count.
            None if correction.is_found_anew => {
                self.moves.clear();
                self.number = Some(frame);
                Some(Pose2::IDENTITY)
            }
            None => None,
        }
    }
}

impl Pilot {
    /// The corrections for this boot that count, in the present frame: if one is of a later frame, everything that the robot keeps in map
    /// coordinates is carried over to it.
    pub(super) fn in_present_frame(&mut self, mut corrections: Vec<Correction>) -> Vec<Correction> {
        let boot_id = self.events.boot_id();
        corrections.retain(|correction| correction.boot_id == boot_id);
        // Of a burst only those of the newest frame that can be reached count.
        corrections.sort_by_key(|correction| correction.frame);
        for correction in &corrections {
            let before = self.frame.number();
            let Some(moved) = self.frame.advance(correction) else {
                continue;
            };
            if self.frame.number() == before {
                continue;
            }
            // Other robots know its course in the former frame only.
            self.telemetry.hasten_intent();
            if moved == Pose2::IDENTITY {
                continue;
            }
            self.estimator.moved(moved);
            self.return_home.moved(moved);
            if let Some(active) = &mut self.active_plan {
                active.moved(moved);
            }
        }
        let present = self.frame.number();
        corrections.retain(|correction| correction.frame == present);
        corrections
    }
}
