//! Pairwise consistency. Finds loop closures that agree with another one around a short cycle.
//!
//! Two closures whose ends lie a few odometry steps apart form a cycle: there, along odometry, back, along odometry. If both are true, the
//! cycle ends where it began, up to noise: chi squared with three degrees of freedom (Mangelson et al., "Pairwise consistent measurement
//! set maximization", ICRA 2018). A false closure seldom has such support.

use std::collections::BTreeMap;

use crate::graph::{Edge, EdgeKind, PoseGraph};
use crate::settings::RobustSettings;
use crate::uncertain::Uncertain;

/// A closure is compared with at most this many of those that follow it in the graph, so that closures by the thousand between the same few
/// nodes take neither hours nor gigabytes.
const MAX_OTHERS: usize = 100;

/// Whether each edge has support: odometry always; a closure if it agrees with odometry alone within the window, or with another closure
/// around a cycle of at most twice the window's odometry steps. Closures that are equal in all numbers are one measurement written twice, and
/// do not support each other.
///
/// Cost: closures x (window + closures in the window). Each closure is compared with at most a hundred of those that follow it.
///
/// ```
/// # use zenav_pose_graph::{RobustSettings, g2o, supported};
/// # let step = |i: u32| format!("EDGE_SE2 {i} {} 1 0 0 100 0 0 100 0 400\n", i + 1);
/// # let closures = "EDGE_SE2 0 3 3.2 0 0 100 0 0 100 0 400\nEDGE_SE2 0 3 0 0 0 100 0 0 100 0 400\n";
/// # let graph = g2o::read(&((0..3).map(step).collect::<String>() + closures))?.graph;
/// // Three steps of 1 m each with a standard deviation of 0.1 m, then two closures from the first node to the last: 3.2 m and 0 m.
/// let support = supported(&graph, &RobustSettings::default());
/// assert_eq!(support, [true, true, true, true, false]);
/// # Ok::<(), zenav_pose_graph::g2o::G2oError>(())
/// ```
#[must_use]
pub fn supported(graph: &PoseGraph, settings: &RobustSettings) -> Vec<bool> {
    let mut is_supported: Vec<bool> = graph
        .edges()
        .iter()
        .map(|edge| edge.kind == EdgeKind::Odometry)
        .collect();
    for_each_cycle(graph, settings.window, |Cycle { closures, end }| {
        if end.chi_squared() <= settings.max_chi_squared {
            for index in closures {
                is_supported[index] = true;
            }
        }
    });
    is_supported
}

/// A short cycle through one closure, named twice, or through two.
pub(crate) struct Cycle {
    pub(crate) closures: [usize; 2],
    /// Where it ends, relative to where it began.
    pub(crate) end: Uncertain,
}

/// Visits the cycles through a closure and odometry within the window, and those through two closures whose ends are within the window of
/// each other ([`MAX_OTHERS`]).
pub(crate) fn for_each_cycle(graph: &PoseGraph, window: u32, mut visit: impl FnMut(Cycle)) {
    let edges = graph.edges();
    let mut odometry: Vec<Vec<usize>> = vec![Vec::new(); graph.poses().len()];
    let mut closures: Vec<Vec<usize>> = vec![Vec::new(); graph.poses().len()];
    for (index, edge) in edges.iter().enumerate() {
        let at = if edge.kind == EdgeKind::Odometry {
            &mut odometry
        } else {
            &mut closures
        };
        at[edge.from].push(index);
        at[edge.to].push(index);
    }
    for (index, edge) in edges
        .iter()
        .enumerate()
        .filter(|(_, edge)| edge.kind == EdgeKind::Closure)
    {
        let own = Uncertain::of(edge);
        let near_from = around(edge.from, edges, &odometry, window);
        if let Some(along) = near_from.get(&edge.to) {
            visit(Cycle {
                closures: [index; 2],
                end: own.then(&along.inverse()),
            });
        }
        let near_to = around(edge.to, edges, &odometry, window);
        let mut others: Vec<usize> = near_from.keys().flat_map(|node| &closures[*node]).copied().collect();
        others.sort_unstable();
        others.dedup();
        let later = others
            .into_iter()
            .filter(|other| *other > index && edges[*other] != *edge);
        let near = later.filter_map(|other| {
            let Edge { from, to, .. } = edges[other];
            let along = |from, to| Some((near_from.get(&from)?, near_to.get(&to)?));
            let (is_turned, (here, there)) = match along(from, to) {
                Some(ends) => (false, ends),
                None => (true, along(to, from)?),
            };
            Some((other, is_turned, here, there))
        });
        for (other, is_turned, here, there) in near.take(MAX_OTHERS) {
            let mut back = Uncertain::of(&edges[other]).inverse();
            if is_turned {
                back = back.inverse();
            }
            visit(Cycle {
                closures: [index, other],
                end: own.then(there).then(&back).then(&here.inverse()),
            });
        }
    }
}

/// The nodes within `window` odometry steps of a node, and their poses relative to it.
fn around(node: usize, edges: &[Edge], odometry: &[Vec<usize>], window: u32) -> BTreeMap<usize, Uncertain> {
    let mut reached = BTreeMap::from([(node, Uncertain::CERTAIN)]);
    let mut front = vec![node];
    for _ in 0..window {
        let mut next = Vec::new();
        for node in front {
            let here = reached[&node];
            for edge in odometry[node].iter().map(|index| &edges[*index]) {
                let (other, step) = if edge.from == node {
                    (edge.to, Uncertain::of(edge))
                } else {
                    (edge.from, Uncertain::of(edge).inverse())
                };
                if let std::collections::btree_map::Entry::Vacant(free) = reached.entry(other) {
                    free.insert(here.then(&step));
                    next.push(other);
                }
            }
        }
        front = next;
    }
    reached
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use nalgebra::Matrix3;
    use zenav_protocol::geometry::Pose2;

    use super::*;

    #[test]
    fn many_closures_between_the_same_nodes_make_a_bounded_number_of_cycles() {
        let mut graph = PoseGraph::new();
        graph.add_node(Pose2::IDENTITY).unwrap();
        graph.add_node(Pose2::new(1.0, 0.0, 0.0)).unwrap();
        let mut add = |kind, x| {
            let edge = Edge {
                from: 0,
                to: 1,
                measurement: Pose2::new(x, 0.0, 0.0),
                information: Matrix3::identity(),
                kind,
            };
            graph.add_edge(edge).unwrap();
        };
        add(EdgeKind::Odometry, 1.0);
        for closure in 0..400 {
            add(EdgeKind::Closure, 1.0 + 1e-4 * f64::from(closure));
        }
        let mut with_others = vec![0; graph.edges().len()];
        for_each_cycle(&graph, 10, |Cycle { closures: [a, b], .. }| {
            if a != b {
                with_others[a] += 1;
            }
        });
        assert_eq!(with_others[1], MAX_OTHERS);
        assert_eq!(with_others[300], MAX_OTHERS);
        assert_eq!(with_others[399], 1);
        assert!(supported(&graph, &RobustSettings::default()).into_iter().all(|is| is));
    }
}
