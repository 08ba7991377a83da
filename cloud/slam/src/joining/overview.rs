//! Overview. Searches the whole of a map for a submap of another one.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::GridSpec;
use zenav_scan_matching::{LikelihoodField, Pyramid, Verdict, Window, judge, refine, search_among};

use super::vote::Vote;
use crate::settings::SlamSettings;
use crate::slam::Slam;
use crate::submap::{Submap, thinned};

/// Levels of the pyramid: blocks of 512 cells. Distant points are looked up some levels higher than the rest.
const LEVELS: u32 = 9;
/// Points of a submap used for the search.
const POINTS: usize = 100;
/// Points closer than this, m, are merged: places looked at for long count no more than the rest.
const SPACING: f64 = 0.15;
/// A robot that sees the same as an earlier one stands within this distance of the earlier trajectory, m.
const FROM_THE_WAY: f64 = 2.5;
/// Points farther from the submap's middle than this, m, are not used: a small turn moves them far.
const REACH: f64 = 10.0;
/// Step of the headings: a point this far out, m, moves by one cell.
const LEVER: f64 = 4.0;
/// Places within this much of the best score are checked too: moved furniture may cost the right place that much.
const WITHIN: f64 = 0.08;
/// Most places checked.
const PLACES: usize = 12;
/// Places closer than this, m and rad, count as one.
const APART: (f64, f64) = (0.5, 0.3);
/// Least score of a place: the whole map has seen most of what is there.
const MIN_SCORE: f64 = 0.8;
/// Largest share of a submap's beams through walls: doors open and close between two days.
const THROUGH_WALLS: f64 = 0.25;
/// Blocks that one search may score.
const BUDGET: usize = 12_000_000;
/// One scan of a submap in this many is judged.
const JUDGED: usize = 4;

/// The whole of a map in one field.
#[derive(Clone, Debug)]
pub(crate) struct Overview {
    pyramid: Pyramid,
    /// Above zero where a robot may have stood.
    places: Pyramid,
    settings: SlamSettings,
}

impl Overview {
    /// The overview of all nodes of a map, at their present poses.
    pub(crate) fn new(slam: &Slam) -> Self {
        let mut field = LikelihoodField::new(&slam.settings.field);
        for (pose, scan) in slam.nodes().iter().zip(&slam.scans) {
            field.insert(*pose, scan);
        }
        let places = near(slam.nodes(), field.spec());
        // Cannot fail: there is one value for each cell.
        let places = LikelihoodField::from_values(*field.spec(), places).unwrap_or_else(|| field.clone());
        Self {
            pyramid: Pyramid::new(field, LEVELS),
            places: Pyramid::new(places, LEVELS),
            settings: slam.settings,
        }
    }

    /// Places in this map from which a submap of another map may have been seen, as `map_from_other`; empty if the search was cut short.
    /// `around`: the expected place and its possible error, m and rad.
    pub(crate) fn places(
        &self,
        map: &Slam,
        other: &Slam,
        submap: &Submap,
        around: Option<(Pose2, f64, f64)>,
    ) -> Vec<Vote> {
        let other_from_middle = other.nodes()[submap.middle()];
        let points = gathered(other, submap);
        if points.len() < POINTS / 8 {
            return Vec::new();
        }
        let spec = self.pyramid.field().spec();
        let half = |cells: u32| 0.5 * f64::from(cells) * spec.resolution;
        let (across, up) = (half(spec.width), half(spec.height));
        let middle = Pose2::new(spec.origin.x + across, spec.origin.y + up, 0.0);
        let window = match around {
            Some((map_from_other, reach, turn)) => Window::around(map_from_other * other_from_middle, reach, turn),
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
        let searched = search_among(&self.pyramid, Some(&self.places), &thinned(&points, POINTS), &window);
        if !searched.is_exact {
            return Vec::new();
        }
        let mut places: Vec<Vote> = Vec::new();
        for candidate in searched.found {
            let pose = refine(
                self.pyramid.field(),
                &points,
                candidate.pose,
                None,
                &self.settings.refine,
            )
            .pose;
            let map_from_other = pose * other_from_middle.inverse();
            let is_known = places.iter().any(|known| {
                let turn = wrap_angle(known.map_from_other.yaw - map_from_other.yaw);
                known.seen_from.distance(&pose) < APART.0 && turn.abs() < APART.1
            });
            let judged = submap.nodes().step_by(JUDGED);
            let (explained, through_walls) = self.judged(map, other, judged, map_from_other);
            let fits = explained >= self.settings.closure.explained && through_walls <= THROUGH_WALLS;
            if !is_known && fits {
                places.push(Vote {
                    map_from_other,
                    seen_from: pose,
                    explained,
                });
            }
        }
        places
    }

    /// The mean shares of points that are explained and of beams through walls, for nodes of another map.
    fn judged(
        &self,
        map: &Slam,
        other: &Slam,
        nodes: impl Iterator<Item = usize>,
        map_from_other: Pose2,
    ) -> (f64, f64) {
        let (mut explained, mut through_walls, mut count) = (0.0, 0.0, 0.0);
        for node in nodes {
            let pose = map_from_other * other.nodes()[node];
            let (laser, scan) = (other.laser_of(node), &other.scans[node]);
            explained += judge(self.pyramid.field(), laser, scan, pose, &self.settings.verdict).explained;
            // The whole map contains everything that ever stood or moved somewhere, so walls are taken from a submap.
            let around = verdict(map, other, node, map_from_other);
            through_walls += around.map_or(1.0, |verdict| verdict.through_walls);
            count += 1.0;
        }
        let count = f64::max(count, 1.0);
        (explained / count, through_walls / count)
    }
}

/// The verdict of a map's nearest submap on a node of another map; `None` if there is none near.
pub(crate) fn verdict(map: &Slam, other: &Slam, node: usize, map_from_other: Pose2) -> Option<Verdict> {
    let map_from_node = map_from_other * other.nodes()[node];
    let submap = &map.submaps[map.nearest_submap(map_from_node)?];
    Some(judge(
        &submap.field,
        other.laser_of(node),
        &other.scans[node],
        map.nodes()[submap.anchor].inverse() * map_from_node,
        &map.settings.verdict,
    ))
}

/// The points of a submap around its middle node, in that node's frame, no two close together.
fn gathered(slam: &Slam, submap: &Submap) -> Vec<Point2<f64>> {
    let cell = |point: &Point2<f64>| ((point.x / SPACING).floor() as i64, (point.y / SPACING).floor() as i64);
    let middle_from_map = slam.nodes()[submap.middle()].inverse();
    let placed = submap.nodes().flat_map(|node| {
        let middle_from_scan = middle_from_map * slam.nodes()[node];
        let points = slam.scans[node].iter();
        points.map(move |point| middle_from_scan.transform_point(*point))
    });
    let near = placed.filter(|point| point.coords.norm() <= REACH);
    let mut points: Vec<((i64, i64), Point2<f64>)> = near.map(|point| (cell(&point), point)).collect();
    // The first point of each cell; sorting makes the order of cells deterministic.
    points.sort_by_key(|(cell, _)| *cell);
    points.dedup_by_key(|(cell, _)| *cell);
    points.into_iter().map(|(_, point)| point).collect()
}

/// Marks the cells near any of these poses.
fn near(poses: &[Pose2], spec: &GridSpec) -> Vec<u8> {
    let mut values = vec![0; spec.len()];
    let reach = (FROM_THE_WAY / spec.resolution) as i64;
    let mut before: Option<Pose2> = None;
    for pose in poses {
        // Skips poses close to the last one.
        if before.is_some_and(|before| before.distance(pose) < 0.1 * FROM_THE_WAY) {
            continue;
        }
        before = Some(*pose);
        let at = (pose.position() - spec.origin) / spec.resolution;
        let (x, y) = (at.x.floor() as i64, at.y.floor() as i64);
        for row in (y - reach).max(0)..(y + reach + 1).min(i64::from(spec.height)) {
            let half = ((reach * reach - (row - y).pow(2)) as f64).sqrt() as i64;
            let columns = (x - half).clamp(0, spec.width.into())..(x + half + 1).clamp(0, spec.width.into());
            let start = row * i64::from(spec.width);
            values[(start + columns.start) as usize..(start + columns.end) as usize].fill(u8::MAX);
        }
    }
    values
}
