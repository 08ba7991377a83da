//! Reduced graph. Replaces dropped nodes by composed edges between the remaining ones.
//!
//! Connected dropped nodes form a patch. The connections through a patch are replaced by edges from its best-connected kept neighbour to
//! one node of each other group. The measurement of such an edge is the present relative pose; its covariance is summed along the most
//! certain path through the patch. All edges composed here were held to be true, so the result is trusted. Where paths share a measurement,
//! each gets its covariance times their number: together they then say no more than it does (`k I` is no less than the matrix of ones of k
//! rows). A patch's information on two nodes of one group is lost. So the result is less certain than before, and up to the present poses
//! as measurements in no direction more.

use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use crate::graph::{Edge, EdgeKind, GraphError, PoseGraph};
use crate::uncertain::Uncertain;

/// Most times that a better path to a node replaces the last one: bounds the cost.
const MAX_REVISIONS: u32 = 8;

/// Edges that replace dropped nodes, between the remaining ones.
///
/// `groups`: for each node `None` if it is dropped, otherwise its group, whose nodes are held together by trusted edges without the dropped
/// ones; `weights`: one for each edge; edges of weight 0 are ignored. Indices are those of `graph`.
///
/// Cost: for each patch, its edges times the logarithm of its nodes.
///
/// ```
/// # use zenav_pose_graph::{composed_edges, g2o};
/// # let text = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 400\n";
/// # let graph = g2o::read(text)?.graph;
/// // Two steps of 1 m, each with a variance of 0.01 m²; the node in the middle is dropped.
/// let edges = composed_edges(&graph, &[1.0; 2], &[Some(0), None, Some(1)])?;
/// assert_eq!((edges.len(), edges[0].from, edges[0].to, edges[0].measurement.x), (1, 0, 2, 2.0));
/// let covariance = edges[0].information.try_inverse().unwrap();
/// assert!((covariance[(0, 0)] - 0.02).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`GraphError::Information`] if a covariance along a path cannot be inverted, [`GraphError::NoSuchNode`] if `groups` or `weights` have
/// the wrong length.
pub fn composed_edges(graph: &PoseGraph, weights: &[f64], groups: &[Option<usize>]) -> Result<Vec<Edge>, GraphError> {
    let (poses, edges) = (graph.poses(), graph.edges());
    if groups.len() != poses.len() || weights.len() != edges.len() {
        return Err(GraphError::NoSuchNode {
            node: groups.len(),
            nodes: poses.len(),
        });
    }
    let mut edges_of: Vec<Vec<usize>> = vec![Vec::new(); poses.len()];
    for (index, edge) in edges.iter().enumerate() {
        let is_dropped = groups[edge.from].is_none() || groups[edge.to].is_none();
        if weights[index] > 0.0 && is_dropped {
            edges_of[edge.from].push(index);
            edges_of[edge.to].push(index);
        }
    }
    let other = |node: usize, index: usize| edges[index].from + edges[index].to - node;
    let mut is_done: Vec<bool> = groups.iter().map(Option::is_some).collect();
    let mut composed = Vec::new();
    for first in 0..poses.len() {
        if std::mem::replace(&mut is_done[first], true) {
            continue;
        }
        // The kept nodes around the patch, with the number of edges that lead into it.
        let (mut patch, mut around) = (BTreeSet::from([first]), BTreeMap::<usize, usize>::new());
        let mut front = vec![first];
        while let Some(node) = front.pop() {
            for index in &edges_of[node] {
                let next = other(node, *index);
                if groups[next].is_some() {
                    *around.entry(next).or_default() += 1;
                } else if !std::mem::replace(&mut is_done[next], true) {
                    patch.insert(next);
                    front.push(next);
                }
            }
        }
        let best = around.iter().max_by_key(|(node, count)| (**count, usize::MAX - **node));
        let Some((hub, _)) = best else { continue };
        let ways = Ways::through(*hub, &patch, graph, &edges_of);
        let mut nearest: BTreeMap<usize, (f64, usize)> = BTreeMap::new();
        for node in around.keys().filter(|node| groups[**node] != groups[*hub]) {
            if let (Some(group), Some(way)) = (groups[*node], ways.label(*node)) {
                let length = way.end.covariance.trace();
                let known = nearest.entry(group).or_insert((length, *node));
                if length < known.0 {
                    *known = (length, *node);
                }
            }
        }
        let nodes: Vec<usize> = nearest.into_values().map(|(_, node)| node).collect();
        let mut uses: BTreeMap<usize, f64> = BTreeMap::new();
        for (_, index) in nodes.iter().flat_map(|node| ways.path(*node)) {
            *uses.entry(index).or_default() += 1.0;
        }
        for node in nodes {
            let mut way = Uncertain::CERTAIN;
            for (from, index) in ways.path(node) {
                let (_, mut step) = step_from(from, index, graph);
                step.covariance *= uses[&index];
                way = way.then(&step);
            }
            let information = way.covariance.try_inverse().ok_or(GraphError::Information)?;
            composed.push(Edge {
                from: *hub,
                to: node,
                measurement: poses[*hub].inverse() * poses[node],
                information: (information + information.transpose()) * 0.5,
                kind: EdgeKind::Odometry,
            });
        }
    }
    Ok(composed)
}

/// The length and the index of a label; the most certain first.
#[derive(PartialEq)]
struct Reached(f64, usize);

impl Eq for Reached {}

impl Ord for Reached {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.0.total_cmp(&self.0).then(other.1.cmp(&self.1))
    }
}

impl PartialOrd for Reached {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// An edge from one of its nodes to the other, at the present poses.
fn step_from(node: usize, index: usize, graph: &PoseGraph) -> (usize, Uncertain) {
    let edge = &graph.edges()[index];
    let (next, mut step) = if edge.from == node {
        (edge.to, Uncertain::of(edge))
    } else {
        (edge.from, Uncertain::of(edge).inverse())
    };
    step.pose = graph.poses()[node].inverse() * graph.poses()[next];
    (next, step)
}

/// A path to a node.
struct Label {
    node: usize,
    /// The node relative to the first one.
    end: Uncertain,
    /// The label of the path without its last edge, and that edge; `None` at the first node.
    before: Option<(usize, usize)>,
    /// Number of worse labels that the node had before.
    revision: u32,
}

/// Paths from one node.
struct Ways {
    /// As they were found. None changes, so each comes after the one that it leads on from, and agrees with it.
    labels: Vec<Label>,
    /// The last and most certain label of each node.
    best: BTreeMap<usize, usize>,
}

impl Ways {
    /// The most certain paths from a kept node through the dropped ones of a patch (Dijkstra, by the trace of the covariance), at the present
    /// poses. Paths through another patch belong to that one: its measurements would count twice.
    ///
    /// A covariance is that at the end of its path, whose trace may fall along the way: a turn swings what is far more than what is near. So a
    /// better path may replace one that others lead on from, [`MAX_REVISIONS`] times for each node at most.
    fn through(hub: usize, patch: &BTreeSet<usize>, graph: &PoseGraph, edges_of: &[Vec<usize>]) -> Self {
        let first = Label {
            node: hub,
            end: Uncertain::CERTAIN,
            before: None,
            revision: 0,
        };
        let mut ways = Self {
            labels: vec![first],
            best: BTreeMap::from([(hub, 0)]),
        };
        let mut heap = BinaryHeap::from([Reached(0.0, 0)]);
        while let Some(Reached(_, label)) = heap.pop() {
            let Label { node, end: here, .. } = ways.labels[label];
            // Paths end at kept nodes.
            if ways.best[&node] != label || (node != hub && !patch.contains(&node)) {
                continue;
            }
            for index in &edges_of[node] {
                let (next, step) = step_from(node, *index, graph);
                if node == hub && !patch.contains(&next) {
                    continue;
                }
                let end = here.then(&step);
                let length = end.covariance.trace();
                let revision = ways.label(next).map_or(Some(0), |known| {
                    let is_better = known.end.covariance.trace() > length && known.revision < MAX_REVISIONS;
                    is_better.then_some(known.revision + 1)
                });
                if let Some(revision) = revision.filter(|_| length > 0.0) {
                    let new = ways.labels.len();
                    ways.labels.push(Label {
                        node: next,
                        end,
                        before: Some((label, *index)),
                        revision,
                    });
                    ways.best.insert(next, new);
                    heap.push(Reached(length, new));
                }
            }
        }
        ways
    }

    /// The most certain path to a node, if there is one.
    fn label(&self, node: usize) -> Option<&Label> {
        self.best.get(&node).map(|label| &self.labels[*label])
    }

    /// The edges to a node in order, each with the node that it leads on from.
    fn path(&self, to: usize) -> Vec<(usize, usize)> {
        let before = self.label(to).and_then(|label| label.before);
        let edges = std::iter::successors(before, |(label, _)| self.labels[*label].before);
        let mut path: Vec<(usize, usize)> = edges.map(|(label, index)| (self.labels[label].node, index)).collect();
        path.reverse();
        path
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::covariance::marginal_covariance;
    use nalgebra::Matrix3;
    use zenav_protocol::geometry::Pose2;

    #[test]
    fn a_chain_without_its_middle_is_one_edge_of_summed_covariance() {
        let mut graph = PoseGraph::new();
        for x in 0..5 {
            graph.add_node(Pose2::new(f64::from(x), 0.0, 0.0)).unwrap();
        }
        for from in 0..4 {
            graph
                .add_edge(Edge {
                    from,
                    to: from + 1,
                    measurement: Pose2::new(1.0, 0.0, 0.0),
                    information: Matrix3::from_diagonal(&[100.0, 100.0, 400.0].into()),
                    kind: EdgeKind::Odometry,
                })
                .unwrap();
        }
        let groups = [Some(0), None, None, None, Some(1)];
        let edges = composed_edges(&graph, &[1.0; 4], &groups).unwrap();
        let [edge] = edges.as_slice() else { panic!("{edges:?}") };
        assert_eq!(
            (edge.from, edge.to, edge.measurement),
            (0, 4, Pose2::new(4.0, 0.0, 0.0))
        );
        let covariance = edge.information.try_inverse().unwrap();
        assert!((covariance[(0, 0)] - 0.04).abs() < 1e-9 && (covariance[(2, 2)] - 0.01).abs() < 1e-9);
        // Each heading on the way swings what follows: 1, 4 and 9 m² of lever.
        assert!((covariance[(1, 1)] - (0.04 + 14.0 / 400.0)).abs() < 1e-9);
        assert_eq!(composed_edges(&graph, &[1.0, 0.0, 1.0, 1.0], &groups).unwrap(), []);
    }
    #[test]
    fn paths_that_share_a_measurement_do_not_count_it_twice() {
        // From node 0 through the dropped node 1 to nodes 2, 3 and 4.
        let mut graph = PoseGraph::new();
        for _ in 0..5 {
            graph.add_node(Pose2::IDENTITY).unwrap();
        }
        for (from, to) in [(0, 1), (1, 2), (3, 1), (1, 4)] {
            let information = Matrix3::from_diagonal(&[100.0, 100.0, 400.0].into());
            let (measurement, kind) = (Pose2::IDENTITY, EdgeKind::Odometry);
            let edge = Edge {
                from,
                to,
                measurement,
                information,
                kind,
            };
            graph.add_edge(edge).unwrap();
        }
        let groups = [Some(0), None, Some(2), Some(3), Some(4)];
        let edges = composed_edges(&graph, &[1.0; 4], &groups).unwrap();
        let ends: Vec<(usize, usize)> = edges.iter().map(|edge| (edge.from, edge.to)).collect();
        assert_eq!(ends, [(0, 2), (0, 3), (0, 4)]);
        // Each of the three bears the first step's variance thrice, and its own.
        let (own, shared) = (0.01, 0.01);
        let mut lost = -marginal_covariance(&graph, graph.poses(), &[1.0; 4], &[2, 3, 4]).unwrap();
        for (number, edge) in edges.iter().enumerate() {
            let covariance = edge.information.try_inverse().unwrap();
            assert!((covariance[(0, 0)] - 3.0 * shared - own).abs() < 1e-9);
            let mut block = lost.fixed_view_mut::<3, 3>(3 * number, 3 * number);
            block += covariance;
        }
        // So they say no more than the graph about the three nodes jointly; in the direction of their sum they say as much.
        let least = lost.symmetric_eigenvalues().min();
        assert!(least.abs() < 1e-8, "{least}");
    }
    #[test]
    fn a_patch_is_not_crossed_for_another_one() {
        // Nodes 0 and 3 are joined through node 1 by coarse steps, and through nodes 2 and 4 by fine ones; node 5 hangs on node 1.
        let mut graph = PoseGraph::new();
        for _ in 0..6 {
            graph.add_node(Pose2::IDENTITY).unwrap();
        }
        for (from, to, information) in [
            (0, 1, 1.0),
            (1, 3, 1.0),
            (1, 5, 1.0),
            (0, 2, 1e4),
            (2, 4, 1e4),
            (4, 3, 1e4),
        ] {
            let edge = Edge {
                from,
                to,
                measurement: Pose2::IDENTITY,
                information: Matrix3::identity() * information,
                kind: EdgeKind::Odometry,
            };
            graph.add_edge(edge).unwrap();
        }
        let groups = [Some(0), None, None, Some(3), None, Some(5)];
        let edges = composed_edges(&graph, &[1.0; 6], &groups).unwrap();
        let told: Vec<(usize, usize, f64)> = edges
            .iter()
            .map(|edge| (edge.from, edge.to, (1.0 / edge.information[(0, 0)] * 1e4).round() / 1e4))
            .collect();
        // The coarse way bears its shared first step twice.
        assert_eq!(told, [(0, 3, 3.0), (0, 5, 3.0), (0, 3, 0.0003)]);
    }
    #[test]
    fn paths_whose_covariance_shrinks_on_the_way_end() {
        // The trace at the end of a path falls and rises along it here, so that better paths to nodes appear after others led on from them.
        let mut graph = PoseGraph::new();
        let places = [
            (3.0, 4.0),
            (3.0, 4.0),
            (-3.0, -3.0),
            (-2.0, -4.0),
            (-4.0, 3.0),
            (-6.0, -8.0),
        ];
        for (x, y) in places.into_iter().chain([(3.0, 4.0)]) {
            graph.add_node(Pose2::new(x, y, 0.0)).unwrap();
        }
        let variances = [
            (1, 0, [0.00877, 0.07726, 0.00055]),
            (2, 0, [0.00099, 0.0002, 0.00964]),
            (2, 1, [0.03524, 0.00025, 0.0233]),
            (3, 1, [0.00017, 0.00048, 0.04337]),
            (3, 2, [0.00016, 0.00335, 0.00363]),
            (4, 2, [0.00012, 0.00333, 0.08184]),
            (4, 3, [0.0008, 0.00022, 0.08962]),
            (5, 1, [0.00043, 0.00125, 0.00414]),
            (5, 3, [0.00499, 0.00167, 0.00016]),
            (1, 6, [0.01, 0.01, 0.01]),
        ];
        for (from, to, variance) in variances {
            let edge = Edge {
                from,
                to,
                measurement: graph.poses()[from].inverse() * graph.poses()[to],
                information: Matrix3::from_diagonal(&variance.map(f64::recip).into()),
                kind: EdgeKind::Odometry,
            };
            graph.add_edge(edge).unwrap();
        }
        let groups = [Some(0), None, None, None, None, None, Some(1)];
        let edges = composed_edges(&graph, &[1.0; 10], &groups).unwrap();
        let [edge] = edges.as_slice() else { panic!("{edges:?}") };
        assert_eq!((edge.from, edge.to), (0, 6));
        // The path over node 2, on whose way back its lever is gone. It says no more than the graph.
        let covariance = edge.information.try_inverse().unwrap();
        let all = marginal_covariance(&graph, graph.poses(), &[1.0; 10], &[6]).unwrap();
        let more = covariance - all.fixed_view::<3, 3>(0, 0).into_owned();
        assert!(more.symmetric_eigenvalues().min() > -1e-6, "{more}");
        let along_path = [
            0.00099 + 0.03524 + 0.01,
            0.0002 + 0.00025 + 0.01,
            0.00964 + 0.0233 + 0.01,
        ];
        assert!(
            (covariance - Matrix3::from_diagonal(&along_path.into())).amax() < 1e-6,
            "{covariance}"
        );
    }
}
