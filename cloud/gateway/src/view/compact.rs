//! Compact messages. Which parts of a robot's messages does the page draw?
//!
//! Positions in metres of the map frame, rounded to millimetres; angles in radians; long trajectories thinned out. Messages that people
//! read (state, events, goals, the behaviour tree) are passed on unchanged.

use nalgebra::Point2;
use serde::Serialize;
use zenav_protocol::messages::{
    GraphCertificate, GraphEdgeKind, InfoReply, Obstacles, Plan, PoseEstimate, PoseGraph, Scan, SearchTree,
};
use zenav_protocol::robot::Footprint;

/// Most points drawn of a plan.
const MAX_PLAN_POINTS: usize = 400;
/// Most edges drawn of a search tree.
const MAX_EDGES: usize = 4000;
/// Most beams drawn of a scan.
const MAX_BEAMS: usize = 1440;
/// Sides of the polygon that represents a round footprint.
const ROUND: u32 = 32;

/// A number rounded to three decimals; zero if it is not finite.
pub(super) fn milli(value: f64) -> f64 {
    if value.is_finite() {
        (value * 1e3).round() / 1e3
    } else {
        0.0
    }
}

/// Step with which at most `most` of `count` items are kept.
fn stride(count: usize, most: usize) -> usize {
    count.div_ceil(most).max(1)
}

/// Pose and velocity of a robot: `x`, `y` (m), `yaw` (rad), `v` (m/s), `w` (rad/s), and the standard deviation of the position, m.
#[derive(Debug, Serialize)]
pub(super) struct CompactPose {
    x: f64,
    y: f64,
    yaw: f64,
    v: f64,
    w: f64,
    sd: f64,
}

impl From<&PoseEstimate> for CompactPose {
    fn from(pose: &PoseEstimate) -> Self {
        let at = pose.map_from_base;
        Self {
            x: milli(at.x),
            y: milli(at.y),
            yaw: milli(at.yaw),
            v: milli(pose.velocity.v),
            w: milli(pose.velocity.w),
            sd: milli((pose.covariance[0].max(0.0) + pose.covariance[4].max(0.0)).sqrt()),
        }
    }
}

/// A sweep: the laser's pose in the map, the first beam's direction and the step (rad), and ranges in mm; 0 is no return.
#[derive(Debug, Serialize)]
pub(super) struct CompactScan {
    at: [f64; 3],
    first: f64,
    step: f64,
    mm: Vec<u32>,
}

impl From<&Scan> for CompactScan {
    fn from(scan: &Scan) -> Self {
        let at = scan.map_from_laser();
        let every = stride(scan.ranges.len(), MAX_BEAMS);
        // A float to integer cast saturates, and NaN becomes zero.
        let mm = |range: &f32| {
            if scan.is_return(*range) {
                (range * 1e3).round() as u32
            } else {
                0
            }
        };
        Self {
            at: [milli(at.x), milli(at.y), (at.yaw * 1e5).round() / 1e5],
            first: scan.angle_min,
            step: scan.angle_increment * every as f64,
            mm: scan.ranges.iter().step_by(every).map(mm).collect(),
        }
    }
}

/// A plan: its path as a flat list of `x`, `y`, `v`, and figures for display.
#[derive(Debug, Serialize)]
pub(super) struct CompactPlan<'a> {
    goal_id: &'a str,
    trajectory_id: u64,
    planner: &'a str,
    status: &'a str,
    length: f64,
    duration: f64,
    min_clearance: Option<f64>,
    /// Least width of the corridor across the path available to the robot's centre, m.
    corridor_width: Option<f64>,
    /// x, y (m), speed (m/s) of each point.
    points: Vec<f64>,
    /// Heading at each point, rad; none for a plain list of waypoints.
    yaws: Vec<f64>,
}

impl<'a> From<&'a Plan> for CompactPlan<'a> {
    fn from(plan: &'a Plan) -> Self {
        let driven = plan.trajectory.rest(f64::NEG_INFINITY);
        let (mut points, mut yaws) = (Vec::new(), Vec::new());
        if driven.is_empty() {
            points.extend(plan.waypoints.iter().flat_map(|p| [milli(p.x), milli(p.y), 0.0]));
        } else {
            let every = stride(driven.len(), MAX_PLAN_POINTS);
            let kept = driven.iter().step_by(every).chain(driven.last());
            yaws.extend(kept.clone().map(|p| milli(p.yaw)));
            points.extend(kept.flat_map(|p| [milli(p.x), milli(p.y), milli(p.v)]));
        }
        let statistics = &plan.statistics;
        Self {
            goal_id: &plan.goal_id,
            trajectory_id: plan.trajectory_id,
            planner: &statistics.planner,
            status: &statistics.status,
            length: milli(statistics.length),
            duration: milli(statistics.duration),
            min_clearance: statistics.min_clearance.map(milli),
            corridor_width: statistics
                .certificate
                .corridor
                .map(|corridor| milli(corridor.least_width)),
            points,
            yaws,
        }
    }
}

/// Moving obstacles: `x`, `y`, `vx`, `vy`, `radius` each.
pub(super) fn obstacles(obstacles: &Obstacles) -> Vec<[f64; 5]> {
    let each = obstacles.obstacles.iter();
    each.map(|o| [o.x, o.y, o.vx, o.vy, o.radius].map(milli)).collect()
}

/// A search tree: edges as a flat list of `x0, y0, x1, y1`, and the best path of `x, y`.
#[derive(Debug, Serialize)]
pub(super) struct CompactTree {
    edges: Vec<f64>,
    path: Vec<f64>,
}

impl From<&SearchTree> for CompactTree {
    fn from(tree: &SearchTree) -> Self {
        let every = stride(tree.edges.len(), MAX_EDGES);
        let flat = |p: &Point2<f64>| [milli(p.x), milli(p.y)];
        let edges = tree.edges.iter().step_by(every);
        Self {
            edges: edges.flat_map(|[a, b]| [flat(a), flat(b)].concat()).collect(),
            path: tree.path.iter().flat_map(flat).collect(),
        }
    }
}

/// A pose graph: nodes as a flat list of `x, y`, and edges as flat lists of pairs of nodes.
#[derive(Debug, Default, Serialize)]
pub(super) struct CompactGraph {
    nodes: Vec<f64>,
    odometry: Vec<u32>,
    closures: Vec<u32>,
    /// Closures that are held to be false.
    rejected: Vec<u32>,
    certificate: GraphCertificate,
}

impl From<&PoseGraph> for CompactGraph {
    fn from(graph: &PoseGraph) -> Self {
        let mut compact = Self {
            nodes: graph
                .nodes
                .iter()
                .flat_map(|node| [milli(node.x), milli(node.y)])
                .collect(),
            certificate: graph.certificate,
            ..Self::default()
        };
        for (edge, _) in graph.lines() {
            let list = match edge.kind {
                GraphEdgeKind::Odometry => &mut compact.odometry,
                GraphEdgeKind::Closure if edge.is_rejected() => &mut compact.rejected,
                GraphEdgeKind::Closure => &mut compact.closures,
            };
            list.extend([edge.from, edge.to]);
        }
        compact
    }
}

/// Model of a robot: its outline in the base frame, m, and its top speeds, m/s and rad/s.
#[derive(Debug, Serialize)]
pub(super) struct CompactModel {
    name: String,
    outline: Vec<[f64; 2]>,
    max_v: f64,
    max_w: f64,
}

impl CompactModel {
    /// From an edge's info reply; `None` if it contains no model.
    pub(super) fn of(info: &InfoReply) -> Option<Self> {
        let model = info.model.as_ref()?;
        let outline = match &model.footprint {
            Footprint::Radius(radius) => (0..ROUND)
                .map(|side| {
                    let angle = f64::from(side) / f64::from(ROUND) * std::f64::consts::TAU;
                    [milli(radius * angle.cos()), milli(radius * angle.sin())]
                })
                .collect(),
            Footprint::Polygon(corners) => corners.iter().map(|p| [milli(p.x), milli(p.y)]).collect(),
        };
        Some(Self {
            name: model.name.clone(),
            outline,
            max_v: milli(model.drive.top_speed()),
            max_w: milli(model.drive.top_yaw_rate()),
        })
    }
}
