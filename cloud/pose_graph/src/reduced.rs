//! Reduced graph. Replaces dropped nodes by composed edges between the remaining ones.
//!
//! Connected dropped nodes form a patch. The connections through a patch are replaced by edges from its best-connected kept neighbour to
//! one node of each other group. The measurement of such an edge is the present relative pose; its covariance is summed along the most
//! certain path through the patch. All edges composed here were held to be true, so the result is trusted. Two of them that share a part of
//! their path are treated as independent, and a patch's information on two nodes of one group is lost: the result is less certain than
//! before, in no direction more.

use std::collections::{BTreeMap, BinaryHeap};

use crate::graph::{Edge, EdgeKind, GraphError, PoseGraph};
use crate::uncertain::Uncertain;

/// Edges that replace dropped nodes, between the remaining ones.
///
/// `groups`: for each node `None` if it is dropped, otherwise its group, whose nodes are held together by trusted edges without the dropped
/// ones; `weights`: one for each edge; edges of weight 0 are ignored. Indices are those of `graph`.
///
/// Cost: for each patch, its edges times the logarithm of its nodes.
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
        let (mut patch, mut around) = (vec![first], BTreeMap::<usize, usize>::new());
        while let Some(node) = patch.pop() {
            for index in &edges_of[node] {
                let next = other(node, *index);
                if groups[next].is_some() {
                    *around.entry(next).or_default() += 1;
                } else if !std::mem::replace(&mut is_done[next], true) {
                    patch.push(next);
                }
            }
        }
        let best = around.iter().max_by_key(|(node, count)| (**count, usize::MAX - **node));
        let Some((hub, _)) = best else { continue };
        let ways = ways_through(*hub, graph, &edges_of, groups);
        let mut nearest: BTreeMap<usize, (f64, usize)> = BTreeMap::new();
        for node in around.keys().filter(|node| groups[**node] != groups[*hub]) {
            if let (Some(group), Some(way)) = (groups[*node], ways.get(node)) {
                let length = way.covariance.trace();
                let known = nearest.entry(group).or_insert((length, *node));
                if length < known.0 {
                    *known = (length, *node);
                }
            }
        }
        for (_, node) in nearest.into_values() {
            let information = ways[&node].covariance.try_inverse().ok_or(GraphError::Information)?;
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

/// A reached node; the most certain first.
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

/// The most certain paths from a kept node through dropped ones (Dijkstra, by the trace of the covariance), at the present poses.
fn ways_through(
    hub: usize,
    graph: &PoseGraph,
    edges_of: &[Vec<usize>],
    groups: &[Option<usize>],
) -> BTreeMap<usize, Uncertain> {
    let poses = graph.poses();
    let mut ways = BTreeMap::from([(hub, Uncertain::CERTAIN)]);
    let mut heap = BinaryHeap::from([Reached(0.0, hub)]);
    while let Some(Reached(length, node)) = heap.pop() {
        let here = ways[&node];
        // Paths end at kept nodes.
        if length > here.covariance.trace() || (groups[node].is_some() && node != hub) {
            continue;
        }
        for edge in edges_of[node].iter().map(|index| &graph.edges()[*index]) {
            let (next, mut step) = if edge.from == node {
                (edge.to, Uncertain::of(edge))
            } else {
                (edge.from, Uncertain::of(edge).inverse())
            };
            step.pose = poses[node].inverse() * poses[next];
            let there = here.then(&step);
            let length = there.covariance.trace();
            let is_known = length == 0.0 || ways.get(&next).is_some_and(|known| known.covariance.trace() <= length);
            if !is_known {
                ways.insert(next, there);
                heap.push(Reached(length, next));
            }
        }
    }
    ways
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
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
}
