//! Start. Initial poses of the descent.

use std::collections::VecDeque;

use nalgebra::{Matrix1, Matrix2, Point2};
use zenav_protocol::geometry::Pose2;

use crate::companion::Isotropic;
use crate::graph::{EdgeKind, PoseGraph};
use crate::linear::{BlockSystem, Pattern};

/// Poses along a tree of edges, odometry before closures, from the `known` nodes (and node 0), which stay. Nodes that no edge reaches stay,
/// too.
///
/// `known`: one for each node.
///
/// ```
/// # use zenav_pose_graph::{g2o, odometry_start};
/// # use zenav_protocol::geometry::Pose2;
/// # let text = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 400\n";
/// # let mut graph = g2o::read(text)?.graph;
/// // Two steps of 1 m; of the three nodes only the first is where it belongs.
/// graph.set_poses(&[Pose2::new(5.0, 0.0, 0.0); 3])?;
/// let start = odometry_start(&graph, &[true, false, false]);
/// assert_eq!((start[0].x, start[1].x, start[2].x), (5.0, 6.0, 7.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[must_use]
pub fn odometry_start(graph: &PoseGraph, known: &[bool]) -> Vec<Pose2> {
    let mut poses = graph.poses().to_vec();
    let mut reached: Vec<bool> = (0..poses.len())
        .map(|node| node == 0 || known.get(node).copied().unwrap_or(false))
        .collect();
    let mut edges_of: Vec<Vec<usize>> = vec![Vec::new(); poses.len()];
    for (index, edge) in graph.edges().iter().enumerate() {
        edges_of[edge.from].push(index);
        edges_of[edge.to].push(index);
    }
    let mut front: VecDeque<usize> = (0..poses.len()).filter(|node| reached[*node]).collect();
    // Closures are used only once odometry leads no further.
    let mut waiting: VecDeque<usize> = VecDeque::new();
    loop {
        let (node, kind) = match (front.pop_front(), waiting.front().copied()) {
            (Some(node), _) => {
                waiting.push_back(node);
                (node, EdgeKind::Odometry)
            }
            (None, Some(node)) => {
                waiting.pop_front();
                (node, EdgeKind::Closure)
            }
            (None, None) => return poses,
        };
        for index in &edges_of[node] {
            let edge = &graph.edges()[*index];
            let other = if edge.from == node { edge.to } else { edge.from };
            if edge.kind != kind || reached[other] {
                continue;
            }
            let step = if edge.from == node {
                edge.measurement
            } else {
                edge.measurement.inverse()
            };
            poses[other] = poses[node] * step;
            reached[other] = true;
            front.push_back(other);
        }
    }
}

/// Poses from two linear problems: rotations as free 2-vectors that are normalised afterwards, then positions with these rotations. The
/// anchor stays.
///
/// Needs no guess. Source: Carlone et al., "Initialization techniques for 3D SLAM", ICRA 2015. `None` if the graph is not connected.
/// `weights`: one for each edge, from 0 to 1.
///
/// ```
/// # use zenav_pose_graph::{chordal_start, g2o};
/// # use zenav_protocol::geometry::Pose2;
/// # let quarter = std::f64::consts::FRAC_PI_2;
/// # let corner = |i: u32| format!("VERTEX_SE2 {i} 0 0 0\nEDGE_SE2 {i} {} 1 0 {quarter} 100 0 0 100 0 400\n", (i + 1) % 4);
/// # let graph = g2o::read(&(0..4).map(corner).collect::<String>())?.graph;
/// // Around a square of 1 m, four measurements; the nodes themselves all lie at the origin.
/// let start = chordal_start(&graph, &[1.0; 4]).unwrap();
/// assert!(start[2].distance(&Pose2::new(1.0, 1.0, 0.0)) < 1e-6);
/// assert!(chordal_start(&graph, &[1.0, 0.0, 0.0, 1.0]).is_none(), "nothing holds node 2");
/// # Ok::<(), g2o::G2oError>(())
/// ```
#[must_use]
pub fn chordal_start(graph: &PoseGraph, weights: &[f64]) -> Option<Vec<Pose2>> {
    if graph.disconnected(weights).is_some() || graph.poses().is_empty() {
        return None;
    }
    let (edges, pattern) = (Isotropic::of(graph, weights), pattern(graph, weights)?);
    chordal(graph.poses(), &edges, &pattern, &Positions::new(&edges, &pattern)?)
}

/// The pairs connected by edges with a weight above zero.
pub(crate) fn pattern(graph: &PoseGraph, weights: &[f64]) -> Option<Pattern> {
    let used = graph.edges().iter().zip(weights).filter(|(_, weight)| **weight > 0.0);
    let pairs: Vec<(usize, usize)> = used.map(|(edge, _)| (edge.from, edge.to)).collect();
    Pattern::new(graph.poses().len(), &pairs)
}

/// [`chordal_start`] from prepared data.
pub(crate) fn chordal(
    poses: &[Pose2],
    edges: &[Isotropic],
    pattern: &Pattern,
    positions: &Positions<'_>,
) -> Option<Vec<Pose2>> {
    let anchor = poses[0];
    let mut rotations = BlockSystem::<2>::new(pattern);
    let mut headings = vec![[0.0; 2]; poses.len()];
    for (pair, edge) in edges.iter().enumerate() {
        let own = Matrix2::identity() * edge.rotation;
        rotations.add_node(edge.from, &own);
        rotations.add_node(edge.to, &own);
        // Rows of `from`, columns of `to`: the transposed turn of the measurement.
        let turned = Matrix2::new(edge.cos, edge.sin, -edge.sin, edge.cos) * -edge.rotation;
        rotations.add_pair(pair, &turned);
        let (sin, cos) = anchor.yaw.sin_cos();
        if edge.from == 0 {
            headings[edge.to][0] += edge.rotation * (edge.cos * cos - edge.sin * sin);
            headings[edge.to][1] += edge.rotation * (edge.sin * cos + edge.cos * sin);
        } else if edge.to == 0 {
            headings[edge.from][0] += edge.rotation * (edge.cos * cos + edge.sin * sin);
            headings[edge.from][1] += edge.rotation * (edge.cos * sin - edge.sin * cos);
        }
    }
    if rotations.factorise()? > 0 {
        return None;
    }
    rotations.solve(&mut headings);
    headings[0] = [anchor.yaw.cos(), anchor.yaw.sin()];
    for [cos, sin] in &mut headings {
        let length = cos.hypot(*sin).max(f64::MIN_POSITIVE);
        (*cos, *sin) = (*cos / length, *sin / length);
    }
    let positions = positions.of(anchor, edges, &headings);
    let nodes = headings.iter().zip(&positions);
    let mut start: Vec<Pose2> = nodes
        .map(|([cos, sin], position)| Pose2::new(position.x, position.y, sin.atan2(*cos)))
        .collect();
    start[0] = anchor;
    Some(start)
}

/// The optimal positions for given rotations: a linear problem whose matrix is always the same.
pub(crate) struct Positions<'p>(BlockSystem<'p, 1>);

impl<'p> Positions<'p> {
    /// `None` if the graph is not connected.
    pub(crate) fn new(edges: &[Isotropic], pattern: &'p Pattern) -> Option<Self> {
        let mut system = BlockSystem::new(pattern);
        for (pair, edge) in edges.iter().enumerate() {
            let own = Matrix1::new(edge.translation);
            system.add_node(edge.from, &own);
            system.add_node(edge.to, &own);
            system.add_pair(pair, &-own);
        }
        (system.factorise()? == 0).then_some(Self(system))
    }

    /// The positions with these cosines and sines of yaws, by node; the anchor stays.
    pub(crate) fn of(&self, anchor: Pose2, edges: &[Isotropic], headings: &[[f64; 2]]) -> Vec<Point2<f64>> {
        let (mut xs, mut ys) = (vec![[0.0]; headings.len()], vec![[0.0]; headings.len()]);
        for edge in edges {
            let [cos, sin] = headings[edge.from];
            let step = Point2::new(
                edge.translation * (cos * edge.x - sin * edge.y),
                edge.translation * (sin * edge.x + cos * edge.y),
            );
            for (all, step) in [(&mut xs, step.x), (&mut ys, step.y)] {
                all[edge.to][0] += step;
                all[edge.from][0] -= step;
            }
        }
        self.0.solve(&mut xs);
        self.0.solve(&mut ys);
        let both = xs.iter().zip(&ys);
        both.map(|([x], [y])| Point2::new(anchor.x + x, anchor.y + y)).collect()
    }
}
