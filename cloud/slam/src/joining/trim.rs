//! Trim. Drops submaps whose content newer ones show again.

use std::collections::BTreeSet;

use nalgebra::Vector2;
use zenav_pose_graph::{Edge, GraphError, composed_edges};

use crate::back_end::BackEnd;
use crate::slam::Slam;
use crate::submap::Submap;

/// Cell size for comparing what was seen, m.
const CELL: f64 = 0.5;
/// Parts of a beam beyond this distance, m, cover nothing.
const NEAR: f64 = 5.0;
/// Least share of a submap's cells that newer ones have seen too.
const COVERED: f64 = 0.95;

/// Cells that beams went through or ended in.
type Seen = BTreeSet<(i64, i64)>;

impl Slam {
    /// Drops what newer sessions have seen again: the map of a building does not grow with every session, and where furniture was moved the
    /// newest scans count.
    ///
    /// A submap of an earlier session is dropped if submaps that stay, all of them newer, have seen 95 % of the half-metre cells that its
    /// beams saw from within 5 m, from as near. With it go the nodes that are in no other submap, and their scans. Measurements between
    /// remaining nodes through dropped ones are composed ([`zenav_pose_graph::composed_edges`]); those by GPS and compass are dropped. The
    /// last session stays whole. Returns the number of dropped nodes.
    ///
    /// Call it when a session is finished.
    ///
    /// # Errors
    /// A graph that cannot be composed; the map is then unchanged.
    pub fn trim(&mut self) -> Result<usize, GraphError> {
        let session = self.session_start();
        let (mut seen, mut stays) = (Seen::new(), vec![false; self.submaps.len()]);
        for (index, submap) in self.submaps.iter().enumerate().rev() {
            let own = self.seen(submap);
            let again = own.intersection(&seen).count() as f64;
            if submap.anchor >= session || again < COVERED * own.len() as f64 {
                stays[index] = true;
                seen.extend(own);
            }
        }
        let mut groups = vec![None; self.scans.len()];
        for (index, submap) in self.submaps.iter().enumerate().filter(|(index, _)| stays[*index]) {
            groups[submap.nodes()].fill(Some(index));
        }
        let dropped = groups.iter().filter(|group| group.is_none()).count();
        if dropped > 0 {
            self.drop_solve();
            self.back_end = self.reduced(&groups)?;
            self.renumber(&groups, &stays);
        }
        Ok(dropped)
    }

    /// The cells that a submap saw from near.
    fn seen(&self, submap: &Submap) -> Seen {
        let mut seen = Seen::new();
        for node in submap.nodes() {
            let pose = self.nodes()[node];
            let from = pose.transform_point(self.laser_of(node));
            for point in self.scans[node].iter() {
                let beam: Vector2<f64> = pose.transform_point(*point) - from;
                let length = beam.norm();
                let steps = (length.min(NEAR) / CELL).floor() as u32;
                for step in 0..=steps {
                    let at = from + beam * (f64::from(step) * CELL / length.max(CELL));
                    seen.insert(((at.x / CELL).floor() as i64, (at.y / CELL).floor() as i64));
                }
            }
        }
        seen
    }

    /// The graph of the nodes that have a group.
    fn reduced(&self, groups: &[Option<usize>]) -> Result<BackEnd, GraphError> {
        let composed = composed_edges(self.graph(), self.weights(), groups)?;
        let numbers = numbers(groups);
        let renumbered = |edge: &Edge| {
            let (from, to) = (numbers[edge.from]?, numbers[edge.to]?);
            Some(Edge { from, to, ..*edge })
        };
        let mut back_end = BackEnd::default();
        for (pose, _) in self.nodes().iter().zip(groups).filter(|(_, group)| group.is_some()) {
            back_end.add_node(*pose)?;
        }
        for (edge, weight, is_final) in self.back_end.edges() {
            if let Some(edge) = renumbered(edge) {
                back_end.add_weighted(edge, weight, is_final)?;
            }
        }
        for edge in composed.iter().filter_map(renumbered) {
            back_end.add_edge(edge)?;
        }
        Ok(back_end)
    }

    /// Drops scans, submaps and stands of the nodes without a group.
    fn renumber(&mut self, groups: &[Option<usize>], stays: &[bool]) {
        let numbers = numbers(groups);
        let mut kept = groups.iter().map(Option::is_some);
        self.scans.retain(|_| kept.next().unwrap_or(false));
        let mut kept = stays.iter();
        self.submaps.retain(|_| kept.next().copied().unwrap_or(false));
        for submap in &mut self.submaps {
            submap.anchor = numbers[submap.anchor].unwrap_or_default();
        }
        self.stands.retain_mut(|stand| {
            let number = numbers[stand.node];
            stand.node = number.unwrap_or_default();
            number.is_some()
        });
        let mut end = 0;
        for session in &mut self.sessions {
            let nodes = end..end + session.nodes;
            end = nodes.end;
            session.nodes = groups[nodes].iter().filter(|group| group.is_some()).count();
        }
    }
}

/// The new index of each node.
fn numbers(groups: &[Option<usize>]) -> Vec<Option<usize>> {
    let mut next = 0;
    let number = |group: &Option<usize>| {
        group.map(|_| {
            next += 1;
            next - 1
        })
    };
    groups.iter().map(number).collect()
}
