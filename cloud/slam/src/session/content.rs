//! Content of a session. What of a map is stored; the rest is recomputed.

use std::sync::Arc;

use nalgebra::{Matrix3, Point2};
use serde::{Deserialize, Serialize};
use zenav_pose_graph::{Edge, EdgeKind, GraphError};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::settings::Settings as _;
use zenav_scan_matching::{OdometryFilter, Refinable};

use super::grid::{packed, unpacked};
use super::{Session, SessionError, laser_of};
use crate::back_end::BackEnd;
use crate::doubt::Doubt;
use crate::fixes::Factor;
use crate::settings::SlamSettings;
use crate::slam::{Slam, Stand};
use crate::step::Counts;
use crate::submap::Submap;

/// x, y (m), yaw (rad).
type Row = [f64; 3];

/// Everything of a map that cannot be recomputed.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Content {
    settings: SlamSettings,
    sessions: Vec<Session>,
    nodes: Vec<Row>,
    edges: Vec<Measured>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    factors: Vec<Fixed>,
    /// Points of each node's scan.
    scans: Vec<Vec<i32>>,
    submaps: Vec<Drawn>,
    stands: Vec<Stood>,
    last: Option<(f64, Row)>,
    last_node_odometry: Row,
    odometry: OdometryFilter,
    is_interrupted: bool,
    is_doubted: bool,
    is_apart: bool,
    unseen: u32,
    keeps_all: bool,
    start: Row,
    usual: f64,
    #[serde(default)]
    doubt: Doubt,
    is_dirty: bool,
    counts: Counts,
}

/// An edge: its ends, the measurement, the upper triangle of the information, its weight, whether it is trusted, and whether it is a match
/// of a finish.
#[derive(Debug, Serialize, Deserialize)]
struct Measured(usize, usize, Row, [f64; 6], f64, bool, bool);

/// A measurement of a node in the world: the node, its pose as measured, information of position and heading, and the weight.
#[derive(Debug, Serialize, Deserialize)]
struct Fixed(usize, Row, [f64; 2], f64);

/// A submap: its anchor, and where the scans from there on were inserted.
#[derive(Debug, Serialize, Deserialize)]
struct Drawn(usize, Vec<Row>);

/// A scan: its time, a node, the pose in that node's frame, its points if it is not a node.
#[derive(Debug, Serialize, Deserialize)]
struct Stood(f64, usize, Row, Vec<i32>);

/// The upper triangle, row by row.
const UPPER: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

fn row(pose: Pose2) -> Row {
    [pose.x, pose.y, pose.yaw]
}

fn expected(what: &str) -> SessionError {
    SessionError::Content(what.to_owned())
}

/// A pose, restored bit for bit.
fn pose([x, y, yaw]: Row) -> Result<Pose2, SessionError> {
    let pose = Pose2 { x, y, yaw };
    pose.is_finite()
        .then_some(pose)
        .ok_or_else(|| expected("poses of finite numbers"))
}

fn finite(numbers: &[f64]) -> Result<(), SessionError> {
    let is_finite = numbers.iter().all(|number| number.is_finite());
    is_finite.then_some(()).ok_or_else(|| expected("finite numbers"))
}

impl Content {
    /// Everything but the points of the nodes' scans. These are the bulk and can be [packed](Self::with_scans) later, off the critical
    /// path.
    pub(super) fn of(slam: &Slam) -> Self {
        let edge = |(edge, weight, is_final): (&Edge, f64, bool)| {
            let information = UPPER.map(|at| edge.information[at]);
            let is_trusted = edge.kind == EdgeKind::Odometry;
            let measurement = row(edge.measurement);
            Measured(
                edge.from,
                edge.to,
                measurement,
                information,
                weight,
                is_trusted,
                is_final,
            )
        };
        let fixed = |factor: &Factor| {
            let pose = row(factor.world_from_node);
            Fixed(factor.node, pose, factor.information, factor.weight)
        };
        let submap = |submap: &Submap| Drawn(submap.anchor, submap.inserted.iter().copied().map(row).collect());
        let stand = |stand: &Stand| {
            Stood(
                stand.stamp,
                stand.node,
                row(stand.node_from_base),
                packed(&stand.points),
            )
        };
        Self {
            settings: slam.settings,
            sessions: slam.sessions.clone(),
            nodes: slam.back_end.poses().iter().copied().map(row).collect(),
            edges: slam.back_end.edges().map(edge).collect(),
            factors: slam.back_end.factors().iter().map(fixed).collect(),
            scans: Vec::new(),
            submaps: slam.submaps.iter().map(submap).collect(),
            stands: slam.stands.iter().map(stand).collect(),
            last: slam.last.map(|(stamp, odometry)| (stamp, row(odometry))),
            last_node_odometry: row(slam.last_node_odometry),
            odometry: slam.odometry,
            is_interrupted: slam.is_interrupted,
            is_doubted: slam.is_doubted,
            is_apart: slam.is_apart,
            unseen: slam.unseen,
            keeps_all: slam.keeps_all,
            start: row(slam.start),
            usual: slam.usual,
            doubt: slam.doubt,
            // A solve whose poses were not adopted yet begins anew.
            is_dirty: slam.is_dirty || slam.adopts_at.is_some(),
            counts: slam.counts,
        }
    }

    pub(super) fn with_scans(self, scans: &[Arc<Vec<Point2<f64>>>]) -> Self {
        Self {
            scans: scans.iter().map(|scan| packed(scan)).collect(),
            ..self
        }
    }

    pub(super) fn into_slam(self) -> Result<Slam, SessionError> {
        self.settings
            .check()
            .map_err(|error| SessionError::Content(format!("settings within their bounds: {error}")))?;
        let count = self.nodes.len();
        let of_sessions = self
            .sessions
            .iter()
            .try_fold(0_usize, |sum, session| sum.checked_add(session.nodes));
        if self.sessions.is_empty() || of_sessions != Some(count) || self.scans.len() != count {
            return Err(expected("as many scans, and nodes of sessions, as nodes"));
        }
        for session in &self.sessions {
            finite(&[session.laser.x, session.laser.y])?;
        }
        finite(&[self.usual])?;
        let points = |steps: &[i32]| unpacked(steps).ok_or_else(|| expected("points within 1 km"));
        let scans: Vec<_> = self
            .scans
            .iter()
            .map(|steps| points(steps).map(Arc::new))
            .collect::<Result<_, _>>()?;
        let mut slam = Slam {
            submaps: self.submaps(&scans)?,
            back_end: self.back_end()?,
            scans,
            sessions: self.sessions,
            last_node_odometry: pose(self.last_node_odometry)?,
            odometry: self
                .odometry
                .checked()
                .ok_or_else(|| expected("odometry of finite numbers"))?,
            is_interrupted: self.is_interrupted,
            is_doubted: self.is_doubted,
            is_apart: self.is_apart,
            unseen: self.unseen,
            keeps_all: self.keeps_all,
            start: pose(self.start)?,
            usual: self.usual,
            doubt: self.doubt,
            is_dirty: self.is_dirty,
            counts: self.counts,
            ..Slam::new(self.settings)
        };
        if let Some((stamp, odometry)) = self.last {
            finite(&[stamp])?;
            slam.last = Some((stamp, pose(odometry)?));
        }
        for Stood(stamp, node, node_from_base, steps) in self.stands {
            finite(&[stamp])?;
            if node >= count {
                return Err(expected("scans that stand at a node"));
            }
            slam.stands.push(Stand {
                stamp,
                node,
                node_from_base: pose(node_from_base)?,
                points: points(&steps)?,
            });
        }
        Ok(slam)
    }

    fn back_end(&self) -> Result<BackEnd, SessionError> {
        let refused = |error: GraphError| SessionError::Content(format!("a pose graph: {error}"));
        let mut back_end = BackEnd::default();
        for node in &self.nodes {
            back_end.add_node(pose(*node)?).map_err(refused)?;
        }
        for Measured(from, to, measurement, upper, weight, is_trusted, is_final) in &self.edges {
            let mut information = Matrix3::zeros();
            for ((row, column), value) in UPPER.into_iter().zip(upper) {
                information[(row, column)] = *value;
                information[(column, row)] = *value;
            }
            if !(0.0..=1.0).contains(weight) {
                return Err(expected("weights from 0 to 1"));
            }
            let edge = Edge {
                from: *from,
                to: *to,
                measurement: pose(*measurement)?,
                information,
                kind: if *is_trusted {
                    EdgeKind::Odometry
                } else {
                    EdgeKind::Closure
                },
            };
            back_end.add_weighted(edge, *weight, *is_final).map_err(refused)?;
        }
        for Fixed(node, world_from_node, information, weight) in &self.factors {
            let is_known = information.iter().all(|entry| entry.is_finite() && *entry >= 0.0)
                && information.iter().any(|entry| *entry > 0.0);
            if *node >= self.nodes.len() || !is_known || !(0.0..=1.0).contains(weight) {
                return Err(expected(
                    "measurements in the world, of nodes, with information and weights from 0 to 1",
                ));
            }
            back_end.add_factor(Factor {
                node: *node,
                world_from_node: pose(*world_from_node)?,
                information: *information,
                weight: *weight,
            });
        }
        Ok(back_end)
    }

    /// The submaps, with their fields redrawn.
    fn submaps(&self, scans: &[Arc<Vec<Point2<f64>>>]) -> Result<Vec<Submap>, SessionError> {
        let mut submaps = Vec::with_capacity(self.submaps.len());
        let mut least = 0;
        for Drawn(anchor, inserted) in &self.submaps {
            let nodes = anchor
                .checked_add(inserted.len())
                .and_then(|end| scans.get(*anchor..end));
            let Some(own) = nodes.filter(|own| !own.is_empty() && *anchor >= least) else {
                return Err(expected("submaps of nodes, by ascending anchors"));
            };
            least = anchor + 1;
            let mut submap = Submap::new(*anchor, &self.settings.field);
            for ((anchor_from_scan, scan), node) in inserted.iter().zip(own).zip(*anchor..) {
                let scan = Refinable::seen_from(laser_of(&self.sessions, node), scan);
                submap.insert(pose(*anchor_from_scan)?, &scan);
            }
            submaps.push(submap);
        }
        if submaps.is_empty() && !scans.is_empty() {
            return Err(expected("a submap where there are nodes"));
        }
        Ok(submaps)
    }
}
