//! Drift. Uncertainty of a node relative to a submap of another time.
//!
//! What counts for a closure is the covariance between this node and that submap; closures elsewhere do not reduce it. It adds up along any
//! chain of measurements between the two, so the best chain is an upper bound. The chain is found as in Bosse et al., "Simultaneous
//! localization and map building in large-scale cyclic environments using the Atlas framework", IJRR 2004: Dijkstra's algorithm over
//! submaps, with the composed covariance as path length. Cost: submaps and closures times a logarithm, independent of the number of nodes.
//!
//! Everything follows from the graph's measurements and the submaps' anchors, so nothing needs to be saved.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use nalgebra::Matrix3;
use zenav_pose_graph::{Edge, EdgeKind, Uncertain};

use crate::settings::FrontSettings;

/// A growing submap drifts by a match's floor deviation per this length of drive, m: about how far a scan overlaps what earlier scans drew.
const STRETCH: f64 = 4.0;

/// A submap that was still growing when a node was inserted, `anchor_from_node`.
#[derive(Clone, Copy, Debug)]
struct Growing {
    submap: usize,
    /// By odometry and matches.
    matched: Uncertain,
    /// Drift of the submap itself.
    drawn: Uncertain,
}

impl Growing {
    fn from(submap: usize) -> Self {
        Self {
            submap,
            matched: Uncertain::CERTAIN,
            drawn: Uncertain::CERTAIN,
        }
    }

    /// Advances by a step of odometry.
    fn step(&mut self, step: &Edge, front: &FrontSettings) {
        let way = step.measurement.x.hypot(step.measurement.y);
        let [floor, turn] = [front.floor, front.floor_turn].map(|sigma| sigma * sigma * way / STRETCH);
        let drift = Uncertain {
            pose: step.measurement,
            covariance: Matrix3::from_diagonal(&[floor, floor, turn].into()),
        };
        self.matched = self.matched.then(&Uncertain::of(step));
        self.drawn = self.drawn.then(&drift);
    }

    /// Fuses a match with the submap.
    fn fuse(&mut self, edge: &Edge) {
        let by_odometry = self.matched.covariance.try_inverse().unwrap_or_else(Matrix3::zeros);
        self.matched = match (by_odometry + edge.information).try_inverse() {
            Some(covariance) => Uncertain {
                pose: edge.measurement,
                covariance,
            },
            None => Uncertain::of(edge),
        };
    }

    fn anchor_from_node(&self) -> Uncertain {
        Uncertain {
            pose: self.matched.pose,
            covariance: self.matched.covariance + self.drawn.covariance,
        }
    }
}

/// A relation between two submaps, `near_from_far`.
#[derive(Clone, Debug)]
struct Link {
    near: usize,
    far: usize,
    near_from_far: Uncertain,
    /// The edge it is based on, if that edge may turn out false.
    edge: Option<usize>,
}

/// The graph of submaps.
#[derive(Clone, Debug, Default)]
pub(crate) struct Drift {
    /// Number of edges taken in.
    edges: usize,
    /// The submap of each node, the older of two, and the node's pose in it.
    homes: Vec<Option<(usize, Uncertain)>>,
    /// Submaps that were growing when the last node was inserted, older first.
    growing: Vec<Growing>,
    links: Vec<Link>,
    /// Links of each submap.
    links_of: BTreeMap<usize, Vec<usize>>,
}

impl Drift {
    /// Takes in new nodes and edges. `anchors`: first node of each submap; `edges`: all edges of the graph, each with whether it is a match
    /// of a finish, which says nothing about drift; `nodes`: number of nodes.
    pub(crate) fn update<'e>(
        &mut self,
        edges: impl ExactSizeIterator<Item = (&'e Edge, bool)>,
        nodes: usize,
        anchors: &[usize],
        front: &FrontSettings,
    ) {
        let known = self.homes.len();
        let mut incoming: BTreeMap<usize, Vec<(usize, &Edge)>> = BTreeMap::new();
        let mut between = Vec::new();
        let count = edges.len();
        for (index, (edge, is_final)) in edges.enumerate().skip(self.edges) {
            if edge.kind == EdgeKind::Odometry && edge.to >= known && edge.from < edge.to {
                incoming.entry(edge.to).or_default().push((index, edge));
            } else if !is_final {
                between.push((index, edge));
            }
        }
        self.edges = count;
        for node in known..nodes {
            let edges = incoming.remove(&node).unwrap_or_default();
            let submap = anchors.binary_search(&node).ok();
            between.extend(self.add_node(node, &edges, anchors, submap, front));
        }
        for (index, edge) in between {
            let false_at = (edge.kind == EdgeKind::Closure).then_some(index);
            if let (Some((from, a)), Some((to, b))) = (self.homes[edge.from], self.homes[edge.to]) {
                self.link(from, to, a.then(&Uncertain::of(edge)).then(&b.inverse()), false_at);
            }
        }
    }

    /// Adds a node with the trusted edges that lead to it; `submap`: the submap that begins there. Returns the edges from elsewhere than
    /// the previous node and the growing submaps.
    fn add_node<'e>(
        &mut self,
        node: usize,
        edges: &[(usize, &'e Edge)],
        anchors: &[usize],
        submap: Option<usize>,
        front: &FrontSettings,
    ) -> Vec<(usize, &'e Edge)> {
        let mut elsewhere = Vec::new();
        let step = edges.iter().position(|(_, edge)| edge.from + 1 == node);
        match step {
            Some(step) => self
                .growing
                .iter_mut()
                .for_each(|growing| growing.step(edges[step].1, front)),
            None => self.growing.clear(),
        }
        let rest = edges.iter().enumerate().filter(|(place, _)| Some(*place) != step);
        for (index, edge) in rest.map(|(_, edge)| edge) {
            match self
                .growing
                .iter_mut()
                .find(|growing| anchors[growing.submap] == edge.from)
            {
                Some(growing) => growing.fuse(edge),
                None => elsewhere.push((*index, *edge)),
            }
        }
        if let Some(submap) = submap {
            for growing in self.growing.clone() {
                self.link(growing.submap, submap, growing.anchor_from_node(), None);
            }
            if self.growing.len() > 1 {
                self.growing.remove(0);
            }
            self.growing.push(Growing::from(submap));
        }
        let home = self.growing.first();
        self.homes
            .push(home.map(|growing| (growing.submap, growing.anchor_from_node())));
        elsewhere
    }

    fn link(&mut self, near: usize, far: usize, near_from_far: Uncertain, edge: Option<usize>) {
        if near == far {
            return;
        }
        for submap in [near, far] {
            self.links_of.entry(submap).or_default().push(self.links.len());
        }
        self.links.push(Link {
            near,
            far,
            near_from_far,
            edge,
        });
    }

    /// The last node relative to the submaps, `anchor_from_node`, for those in which its position is known to within a standard deviation
    /// of `limit`, m. `weights`: of the edges, 0 for a closure held to be false.
    pub(crate) fn of_last_node(&self, weights: &[f64], limit: f64) -> BTreeMap<usize, Uncertain> {
        let mut reached = BTreeMap::new();
        let mut found: Vec<(usize, Uncertain)> = Vec::new();
        let mut frontier = BinaryHeap::new();
        let starts = self.growing.iter();
        let mut next: Vec<_> = starts
            .map(|growing| (growing.submap, growing.anchor_from_node().inverse()))
            .collect();
        loop {
            for (submap, node_from_anchor) in next.drain(..) {
                let spread = spread(&node_from_anchor);
                if spread <= limit && !reached.contains_key(&submap) {
                    // Bit patterns of non-negative floats sort like their values.
                    frontier.push(Reverse((spread.to_bits(), found.len())));
                    found.push((submap, node_from_anchor));
                }
            }
            let Some(Reverse((_, index))) = frontier.pop() else {
                return reached;
            };
            let (submap, node_from_anchor) = found[index];
            if reached.contains_key(&submap) {
                continue;
            }
            reached.insert(submap, node_from_anchor.inverse());
            for link in self
                .links_of
                .get(&submap)
                .into_iter()
                .flatten()
                .map(|index| &self.links[*index])
            {
                let is_false = link.edge.is_some_and(|edge| weights[edge] == 0.0);
                let (other, step) = if link.near == submap {
                    (link.far, link.near_from_far)
                } else {
                    (link.near, link.near_from_far.inverse())
                };
                if !is_false && !reached.contains_key(&other) {
                    next.push((other, node_from_anchor.then(&step)));
                }
            }
        }
    }
}

/// Standard deviation of a position along its least certain direction, m.
pub(crate) fn spread(uncertain: &Uncertain) -> f64 {
    let covariance = uncertain.covariance.fixed_view::<2, 2>(0, 0);
    let [a, b, d] = [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]];
    let largest = 0.5 * (a + d) + (0.5 * (a - d)).hypot(b);
    largest.max(0.0).sqrt()
}
