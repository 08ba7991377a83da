//! Overview. Where in the whole of a map does something fit?

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_scan_matching::{LikelihoodField, Pyramid, Verdict, Window, judge, refine, search};

use super::vote::Vote;
use crate::settings::SlamSettings;
use crate::slam::Slam;
use crate::submap::{Submap, thinned};

/// Levels of the pyramid: blocks of 128 cells.
const LEVELS: u32 = 7;
/// Points of a submap that are searched for.
const POINTS: usize = 200;
/// Points nearer to each other than this, m, are one: what was looked at for long counts no more than the rest.
const SPACING: f64 = 0.15;
/// Headings are tried on steps by which points so far out, m, move a cell.
const LEVER: f64 = 4.0;
/// Places that score this much less than the best one are asked too: moved furniture may cost the right one so much.
const WITHIN: f64 = 0.08;
/// Places that are asked, at most.
const PLACES: usize = 12;
/// Places nearer than this, m and rad, are one.
const APART: (f64, f64) = (0.5, 0.3);
/// Least score of a place: lower than that of a closure, for a submap may reach beyond the map.
const MIN_SCORE: f64 = 0.5;
/// Blocks that one search may score.
const BUDGET: usize = 6_000_000;
/// Scans of a submap that are judged, one of so many.
const JUDGED: usize = 4;

/// All of a map in one field.
#[derive(Clone, Debug)]
pub(crate) struct Overview {
    pyramid: Pyramid,
    settings: SlamSettings,
}

impl Overview {
    /// The overview of all nodes of a map, where they lie now.
    pub(crate) fn new(slam: &Slam) -> Self {
        let mut field = LikelihoodField::new(&slam.settings.field);
        for (pose, scan) in slam.nodes().iter().zip(&slam.scans) {
            field.insert(*pose, scan);
        }
        Self {
            pyramid: Pyramid::new(field, LEVELS),
            settings: slam.settings,
        }
    }

    /// The places in this map from which a submap of another one may have been seen, as `map_from_other`; nothing where the search was cut
    /// short. `around`: where it is expected, with how far it may be off, m and rad.
    pub(crate) fn places(&self, other: &Slam, submap: &Submap, around: Option<(Pose2, f64, f64)>) -> Vec<Vote> {
        let other_from_anchor = other.nodes()[submap.anchor];
        let points = gathered(other, submap);
        if points.len() < POINTS / 8 {
            return Vec::new();
        }
        let spec = self.pyramid.field().spec();
        let half = |cells: u32| 0.5 * f64::from(cells) * spec.resolution;
        let (across, up) = (half(spec.width), half(spec.height));
        let middle = Pose2::new(spec.origin.x + across, spec.origin.y + up, 0.0);
        let window = match around {
            Some((map_from_other, reach, turn)) => Window::around(map_from_other * other_from_anchor, reach, turn),
            None => Window {
                across: up,
                ..Window::around(middle, across, std::f64::consts::PI)
            },
        };
        let window = Window {
            min_score: MIN_SCORE,
            within: WITHIN,
            count: PLACES,
            apart: APART.0,
            apart_turn: APART.1,
            lever: LEVER,
            budget: BUDGET,
            ..window
        };
        let searched = search(&self.pyramid, &thinned(&points, POINTS), &window);
        if !searched.is_exact {
            return Vec::new();
        }
        let mut places: Vec<Vote> = Vec::new();
        for candidate in searched.found {
            let pose = refine(self.pyramid.field(), &points, candidate.pose, None, &self.settings.refine).pose;
            let map_from_other = pose * other_from_anchor.inverse();
            let is_known = places.iter().any(|known| {
                let turn = wrap_angle(known.map_from_other.yaw - map_from_other.yaw);
                known.seen_from.distance(&pose) < APART.0 && turn.abs() < APART.1
            });
            let verdict = self.judged(other, submap.nodes().step_by(JUDGED), map_from_other);
            let limits = &self.settings.closure;
            let fits = verdict.explained >= limits.explained && verdict.through_walls <= limits.through_walls;
            if !is_known && fits {
                places.push(Vote {
                    map_from_other,
                    seen_from: pose,
                    explained: verdict.explained,
                });
            }
        }
        places
    }

    /// The mean verdict on nodes of another map.
    fn judged(&self, other: &Slam, nodes: impl Iterator<Item = usize>, map_from_other: Pose2) -> Verdict {
        let (mut explained, mut through_walls, mut count) = (0.0, 0.0, 0.0);
        for node in nodes {
            let verdict = self.verdict(other, node, map_from_other);
            explained += verdict.explained;
            through_walls += verdict.through_walls;
            count += 1.0;
        }
        Verdict {
            explained: explained / f64::max(count, 1.0),
            through_walls: through_walls / f64::max(count, 1.0),
        }
    }

    /// The verdict on one node of another map.
    pub(crate) fn verdict(&self, other: &Slam, node: usize, map_from_other: Pose2) -> Verdict {
        judge(
            self.pyramid.field(),
            other.laser_of(node),
            &other.scans[node],
            map_from_other * other.nodes()[node],
            &self.settings.verdict,
        )
    }
}

/// The points of a submap in the frame of its anchor, no two close together.
fn gathered(slam: &Slam, submap: &Submap) -> Vec<Point2<f64>> {
    let cell = |point: &Point2<f64>| ((point.x / SPACING).floor() as i64, (point.y / SPACING).floor() as i64);
    let placed = submap.nodes().zip(&submap.inserted).flat_map(|(node, anchor_from_scan)| {
        slam.scans[node]
            .iter()
            .map(|point| anchor_from_scan.transform_point(*point))
    });
    let mut points: Vec<((i64, i64), Point2<f64>)> = placed.map(|point| (cell(&point), point)).collect();
    // The first of each cell, and the cells in an order of their own.
    points.sort_by_key(|(cell, _)| *cell);
    points.dedup_by_key(|(cell, _)| *cell);
    points.into_iter().map(|(_, point)| point).collect()
}
