//! Frames of the map. In which frame does the mission work, and where are its places after the map has moved?
//!
//! A loop closure starts the next frame of the map. The mission switches to it once its replica of the map has: goals and places then move
//! with the part of the map they belong to, and the driven path moves with the robot's surroundings, as it does on the robot. Until both
//! the map and its parts are known in one frame, nothing is planned or renewed.

use std::collections::VecDeque;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{GoalPoint, MOST_MOVES, MapFrame, MapRef, may_follow, moved_between};

/// Anchors of a goal's places in parts of the map, so that they keep their spot in the building.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GoalAnchors {
    /// The map that the parts belong to.
    pub map: String,
    /// For each place, its part and its position in that part; without a part, its position in the map.
    pub places: Vec<(Option<usize>, GoalPoint)>,
}

/// The present frame, and the known earlier ones.
#[derive(Clone, Debug, Default)]
pub struct MapFrames {
    at: u64,
    is_settled: bool,
    newest: Option<MapFrame>,
    before: VecDeque<MapFrame>,
}

impl MapFrames {
    /// Observes a frame and its parts, as published by mapping.
    pub fn observe(&mut self, frame: MapFrame) {
        let known = self.newest.as_ref().filter(|known| known.map.id == frame.map.id);
        if !frame.is_sane() || !may_follow(frame.map.frame, known.map_or(0, |known| known.map.frame)) {
            tracing::warn!(map = frame.map.id, "a frame of the map is malformed: left out");
            return;
        }
        match self.newest.take() {
            Some(known) if known.map.id != frame.map.id => self.before.clear(),
            Some(known) if known.map.frame < frame.map.frame => {
                if self.before.len() == MOST_MOVES {
                    self.before.pop_front();
                }
                self.before.push_back(known);
            }
            _ => {}
        }
        self.newest = Some(frame);
    }

    /// Switches to the frame of the map's replica if it is known. Returns the previous frame if it changed.
    pub fn settle(&mut self, replica: Option<&MapRef>) -> Option<u64> {
        let Some(map) = replica else {
            self.is_settled = true;
            return None;
        };
        let known = self.newest.as_ref().filter(|newest| newest.map.id == map.id);
        self.is_settled = known.is_none_or(|newest| newest.map.frame == map.frame);
        if !self.is_settled || self.at == map.frame {
            return None;
        }
        Some(std::mem::replace(&mut self.at, map.frame))
    }

    /// The present frame, used for the map, goals and plans.
    #[must_use]
    pub fn at(&self) -> u64 {
        self.at
    }

    /// Whether the map and its parts are known in the same frame.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.is_settled
    }

    /// How the robot's surroundings moved from a frame to the present one; `None` if unknown.
    #[must_use]
    pub fn robot(&self, from: u64) -> Option<Pose2> {
        if from == self.at {
            return Some(Pose2::IDENTITY);
        }
        let newest = self.newest.as_ref()?;
        let until = |frame| moved_between(frame, newest.map.frame, &newest.moves);
        Some(until(self.at)?.inverse() * until(from)?)
    }

    /// Where a place of a frame is in the present one. A place that belongs to no part keeps its coordinates.
    ///
    /// ```
    /// use zenav_mission::MapFrames;
    /// use zenav_protocol::geometry::Pose2;
    /// use zenav_protocol::messages::{GoalPoint, MapFrame, MapRef};
    ///
    /// let map = |frame| MapRef { id: "kitchen".into(), revision: 1, frame };
    /// let frame = |number, moves, part| MapFrame { map: map(number), moves, parts: vec![part], ..MapFrame::default() };
    /// let moved = Pose2::new(0.0, 1.0, 0.0);
    /// let mut frames = MapFrames::default();
    /// frames.observe(frame(0, Vec::new(), Pose2::IDENTITY));
    /// frames.settle(Some(&map(0)));
    /// // A loop closure moves the map by 1 m along y.
    /// frames.observe(frame(1, vec![moved], moved));
    /// frames.settle(Some(&map(1)));
    /// let goal = GoalPoint { x: 2.0, y: 0.5, yaw: None };
    /// assert_eq!(frames.place(0, goal), GoalPoint { y: 1.5, ..goal });
    /// ```
    #[must_use]
    pub fn place(&self, from: u64, place: GoalPoint) -> GoalPoint {
        let moved = || {
            let (before, now) = (self.version(from)?, self.version(self.at)?);
            before.moved_at(place.x, place.y, now)
        };
        match moved() {
            Some(moved) if from != self.at => place.moved(moved),
            _ => place,
        }
    }

    /// Whether the parts of the map are known in a frame.
    #[must_use]
    pub fn is_known(&self, frame: u64) -> bool {
        self.version(frame).is_some()
    }

    /// Anchors of places given in a frame; `None` if that frame is unknown.
    #[must_use]
    pub fn anchors(&self, from: u64, places: &[GoalPoint]) -> Option<GoalAnchors> {
        let version = self.version(from)?;
        let anchor = |place: &GoalPoint| {
            let part = version.part_at(place.x, place.y);
            let pose = part.and_then(|part| version.parts.get(part));
            (part, pose.map_or(*place, |pose| place.moved(pose.inverse())))
        };
        Some(GoalAnchors {
            map: version.map.id.clone(),
            places: places.iter().map(anchor).collect(),
        })
    }

    /// Where anchored places are in the present frame; `None` for anchors in another map.
    #[must_use]
    pub fn resolved(&self, anchors: &GoalAnchors) -> Option<Vec<GoalPoint>> {
        let version = self.version(self.at).filter(|version| version.map.id == anchors.map)?;
        let places = anchors.places.iter();
        places
            .map(|(part, place)| match part {
                Some(part) => version.parts.get(*part).map(|pose| place.moved(*pose)),
                None => Some(*place),
            })
            .collect()
    }

    fn version(&self, frame: u64) -> Option<&MapFrame> {
        let mut known = self.newest.iter().chain(&self.before);
        known.find(|version| version.map.frame == frame)
    }
}

/// Points moved as a rigid body.
#[must_use]
pub(crate) fn moved_points(points: &[Point2<f64>], new_from_old: Pose2) -> Vec<Point2<f64>> {
    points
        .iter()
        .map(|point| new_from_old.transform_point(*point))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(number: u64, moves: Vec<Pose2>, parts: Vec<Pose2>) -> MapFrame {
        MapFrame {
            map: map(number),
            moves,
            parts,
            ..MapFrame::default()
        }
    }

    fn map(number: u64) -> MapRef {
        MapRef {
            id: "m".into(),
            revision: 1,
            frame: number,
        }
    }

    #[test]
    fn a_place_moves_with_its_part_and_only_once_the_map_has() {
        let (near, far) = (Pose2::IDENTITY, Pose2::new(20.0, 0.0, 0.0));
        let moved = Pose2::new(0.0, 1.0, 0.0);
        let mut frames = MapFrames::default();
        frames.observe(frame(0, vec![], vec![near, far]));
        assert_eq!(frames.settle(Some(&map(0))), None);
        let places = [19.0, 1.0, 50.0].map(|x| GoalPoint::from(Pose2::new(x, 0.5, 0.0)));
        let anchors = frames.anchors(0, &places).unwrap();
        frames.observe(frame(1, vec![moved], vec![near, moved * far]));
        assert_eq!(frames.settle(Some(&map(0))), None);
        assert!(!frames.is_settled(), "the map is still as it was");
        assert_eq!(frames.settle(Some(&map(1))), Some(0));
        let here: Vec<f64> = frames.resolved(&anchors).unwrap().iter().map(|place| place.y).collect();
        assert_eq!(here, [1.5, 0.5, 0.5]);
        assert_eq!(frames.place(0, places[0]).y, 1.5);
        assert_eq!(frames.robot(0), Some(moved));
        assert_eq!(frames.robot(3), None);
        frames.observe(frame(u64::MAX, vec![], vec![near]));
        frames.settle(Some(&map(1)));
        assert!(
            frames.is_settled(),
            "a frame that mapping cannot have reached is ignored"
        );
    }
}
