//! Submap. What does a short stretch of the way look like, as seen from its first scan?

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{FieldSettings, LikelihoodField, Pyramid};

/// Levels of the pyramid: blocks of 32 cells.
const LEVELS: u32 = 5;

/// The scans of a stretch of the way in one field, in the frame of the first of them.
#[derive(Clone, Debug)]
pub(crate) struct Submap {
    /// Node of the first scan, whose frame this is.
    pub(crate) anchor: usize,
    /// Nodes whose scans are in it: from the anchor on, so many.
    pub(crate) count: usize,
    pub(crate) field: LikelihoodField,
    /// Made when a place is searched for in it.
    pyramid: Option<Pyramid>,
}

impl Submap {
    pub(crate) fn new(anchor: usize, settings: &FieldSettings) -> Self {
        Self {
            anchor,
            count: 0,
            field: LikelihoodField::new(settings),
            pyramid: None,
        }
    }

    pub(crate) fn insert(&mut self, anchor_from_scan: Pose2, points: &[Point2<f64>]) {
        self.field.insert(anchor_from_scan, points);
        self.count += 1;
        self.pyramid = None;
    }

    /// The node in the middle of it.
    pub(crate) fn middle(&self) -> usize {
        self.anchor + self.count / 2
    }

    /// The node after its last.
    pub(crate) fn end(&self) -> usize {
        self.anchor + self.count
    }

    pub(crate) fn contains(&self, node: usize) -> bool {
        (self.anchor..self.end()).contains(&node)
    }

    pub(crate) fn pyramid(&mut self) -> &Pyramid {
        let field = &self.field;
        self.pyramid.get_or_insert_with(|| Pyramid::new(field.clone(), LEVELS))
    }
}

/// Points that a search uses, at most: more take longer and find the same.
const SEARCH_POINTS: usize = 120;

/// At most [`SEARCH_POINTS`], evenly out of all.
pub(crate) fn thinned(points: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let step = points.len().div_ceil(SEARCH_POINTS).max(1);
    points.iter().copied().step_by(step).collect()
}
