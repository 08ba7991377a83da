//! Submap. The scans of a short stretch of the drive, in the frame of the first.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{
    FieldSettings, LikelihoodField, Prior, Pyramid, Refinable, RefineSettings, Refined, Surfels, VerdictSettings,
    standing,
};

use crate::session::{Session, laser_of};

/// The match in the field ends at this multiple of the tolerance; polishing takes over from there.
const ROUGH: f64 = 20.0;

/// Levels of the pyramid: blocks of 32 cells.
const LEVELS: u32 = 5;

/// The scans of a stretch of the drive in one field, in the frame of the first of them.
#[derive(Clone, Debug)]
pub(crate) struct Submap {
    /// Node of the first scan; its frame is the submap's.
    pub(crate) anchor: usize,
    /// Poses at which its scans were inserted, `anchor_from_scan`: of the anchor and the nodes that follow it.
    pub(crate) inserted: Vec<Pose2>,
    pub(crate) field: LikelihoodField,
    pub(crate) surfels: Surfels,
    /// Built when a place is searched for in it.
    pyramid: Option<Pyramid>,
    /// Built when a scan that is explained seems to go through walls.
    standing: Option<LikelihoodField>,
}

/// The scans of a map's nodes, which its submaps were drawn from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scans<'s> {
    pub(crate) sessions: &'s [Session],
    pub(crate) points: &'s [Arc<Vec<Point2<f64>>>],
}

impl Submap {
    pub(crate) fn new(anchor: usize, settings: &FieldSettings) -> Self {
        Self {
            anchor,
            inserted: Vec::new(),
            field: LikelihoodField::new(settings),
            surfels: Surfels::default(),
            pyramid: None,
            standing: None,
        }
    }

    pub(crate) fn insert(&mut self, anchor_from_scan: Pose2, scan: &Refinable<'_>) {
        self.field.insert(anchor_from_scan, scan.points());
        self.surfels.insert(anchor_from_scan, scan.points(), scan.normals());
        self.inserted.push(anchor_from_scan);
        (self.pyramid, self.standing) = (None, None);
    }

    /// The same stretch in a field with other settings; `scans`: the points of all nodes.
    pub(crate) fn redrawn(
        &self,
        sessions: &[Session],
        scans: &[Arc<Vec<Point2<f64>>>],
        settings: &FieldSettings,
    ) -> Self {
        let mut redrawn = Self::new(self.anchor, settings);
        for (anchor_from_scan, node) in self.inserted.iter().zip(self.nodes()) {
            let scan = Refinable::seen_from(laser_of(sessions, node), &scans[node]);
            redrawn.insert(*anchor_from_scan, &scan);
        }
        redrawn
    }

    /// Its middle node.
    pub(crate) fn middle(&self) -> usize {
        self.anchor + self.inserted.len() / 2
    }

    /// The node after its last.
    pub(crate) fn end(&self) -> usize {
        self.anchor + self.inserted.len()
    }

    /// The nodes whose scans are in it.
    pub(crate) fn nodes(&self) -> Range<usize> {
        self.anchor..self.end()
    }

    /// Pose at which a node's scan was inserted, `anchor_from_node`.
    pub(crate) fn pose_of(&self, node: usize) -> Option<Pose2> {
        self.inserted.get(node.checked_sub(self.anchor)?).copied()
    }

    /// Matches a scan to this submap around a pose, `anchor_from_scan`.
    pub(crate) fn refine(
        &self,
        scan: &Refinable<'_>,
        start: Pose2,
        prior: Option<&Prior>,
        settings: &RefineSettings,
    ) -> Refined {
        let roughly = RefineSettings {
            tolerance: ROUGH * settings.tolerance,
            ..*settings
        };
        let rough = scan.refine(&self.field, start, prior, &roughly);
        scan.polish(&self.field, &self.surfels, &rough, prior, settings)
            .unwrap_or_else(|| scan.refine(&self.field, start, prior, settings))
    }

    pub(crate) fn pyramid(&mut self) -> &Pyramid {
        let field = &self.field;
        self.pyramid.get_or_insert_with(|| Pyramid::new(field.clone(), LEVELS))
    }

    /// Its surfaces without those that moved.
    pub(crate) fn standing(&mut self, scans: Scans<'_>, settings: &VerdictSettings) -> &LikelihoodField {
        let (field, inserted, nodes) = (&self.field, &self.inserted, self.nodes());
        self.standing.get_or_insert_with(|| {
            let own = inserted.iter().zip(nodes).filter_map(|(anchor_from_scan, node)| {
                let points = scans.points.get(node)?;
                Some((*anchor_from_scan, laser_of(scans.sessions, node), points.as_slice()))
            });
            standing(field, own, settings)
        })
    }
}

/// Most points of a search: more take longer and find the same.
pub(crate) const SEARCH_POINTS: usize = 120;

/// At most `count` points, picked evenly.
pub(crate) fn thinned(points: &[Point2<f64>], count: usize) -> Vec<Point2<f64>> {
    let step = points.len().div_ceil(count).max(1);
    points.iter().copied().step_by(step).collect()
}
