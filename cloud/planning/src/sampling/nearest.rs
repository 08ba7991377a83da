//! k-d tree. The nearest point of a growing set, and all points within a radius; a leaf holds sixteen points side by side.
//!
//! A full leaf is split in the middle of its region, so the depth does not depend on the order of insertion. Coordinates are in single
//! precision, which is enough to choose among points: every choice is checked exactly afterwards. Source: Bentley, "K-d Trees for
//! Semidynamic Point Sets", 1990.

use nalgebra::Point2;

/// Points that a leaf holds.
const LEAF: usize = 16;
/// Bit that marks a leaf among the numbers of nodes.
const IS_LEAF: u32 = 1 << 31;
/// Regions are not split below this side, cells: of points that lie so close together, some are dropped.
const LEAST_SIDE: f32 = 1.0 / 64.0;
/// More than twice the halvings from the largest map to [`LEAST_SIDE`].
const DEPTH: usize = 64;

#[derive(Clone, Debug)]
struct Leaf {
    x: [f32; LEAF],
    y: [f32; LEAF],
    id: [u32; LEAF],
    len: usize,
    low: [f32; 2],
    high: [f32; 2],
}

impl Leaf {
    fn new(low: [f32; 2], high: [f32; 2]) -> Self {
        // Empty slots are infinitely far away, so that scans have a fixed length.
        Self {
            x: [f32::INFINITY; LEAF],
            y: [f32::INFINITY; LEAF],
            id: [0; LEAF],
            len: 0,
            low,
            high,
        }
    }

    fn push(&mut self, x: f32, y: f32, id: u32) {
        (self.x[self.len], self.y[self.len], self.id[self.len]) = (x, y, id);
        self.len += 1;
    }

    fn squared_distances(&self, x: f32, y: f32) -> [f32; LEAF] {
        let mut squared = [0.0; LEAF];
        for ((squared, own_x), own_y) in squared.iter_mut().zip(&self.x).zip(&self.y) {
            let (dx, dy) = (own_x - x, own_y - y);
            *squared = dx * dx + dy * dy;
        }
        squared
    }
}

#[derive(Clone, Copy, Debug)]
struct Cut {
    at: f32,
    vertical: bool,
    below: u32,
    above: u32,
}

/// A set of numbered points on a map.
#[derive(Clone, Debug, Default)]
pub struct Nearest {
    cuts: Vec<Cut>,
    leaves: Vec<Leaf>,
    root: u32,
}

impl Nearest {
    /// Removes all points; the next ones lie on a map of this size, cells.
    pub fn clear(&mut self, size: [u32; 2]) {
        self.cuts.clear();
        self.leaves.clear();
        self.leaves.push(Leaf::new([0.0; 2], [size[0] as f32, size[1] as f32]));
        self.root = IS_LEAF;
    }

    /// Adds a point with an id.
    pub fn insert(&mut self, p: Point2<f64>, id: u32) {
        let (x, y) = (p.x as f32, p.y as f32);
        let mut at = self.root;
        // The cut that led here, and the side taken.
        let mut from: Option<(usize, bool)> = None;
        loop {
            if at & IS_LEAF == 0 {
                let cut = self.cuts[at as usize];
                let above = if cut.vertical { x >= cut.at } else { y >= cut.at };
                from = Some((at as usize, above));
                at = if above { cut.above } else { cut.below };
                continue;
            }
            let leaf = (at & !IS_LEAF) as usize;
            if self.leaves[leaf].len < LEAF {
                self.leaves[leaf].push(x, y, id);
                return;
            }
            let Some(cut) = self.split(leaf) else { return };
            match from {
                None => self.root = cut,
                Some((parent, true)) => self.cuts[parent].above = cut,
                Some((parent, false)) => self.cuts[parent].below = cut,
            }
            at = cut;
        }
    }

    /// Splits a full leaf in the middle of its longer side; `None` if that is too short.
    fn split(&mut self, leaf: usize) -> Option<u32> {
        let full = self.leaves[leaf].clone();
        let side = [full.high[0] - full.low[0], full.high[1] - full.low[1]];
        let axis = usize::from(side[1] > side[0]);
        if side[axis] < LEAST_SIDE {
            return None;
        }
        let middle = full.low[axis] + 0.5 * side[axis];
        let (mut low, mut high) = (full.low, full.high);
        low[axis] = middle;
        high[axis] = middle;
        let (mut below, mut above) = (Leaf::new(full.low, high), Leaf::new(low, full.high));
        let values = if axis == 0 { &full.x } else { &full.y };
        for (i, value) in values.iter().enumerate() {
            let to = if *value >= middle { &mut above } else { &mut below };
            to.push(full.x[i], full.y[i], full.id[i]);
        }
        self.leaves[leaf] = below;
        self.leaves.push(above);
        self.cuts.push(Cut {
            at: middle,
            vertical: axis == 0,
            below: leaf as u32 | IS_LEAF,
            above: (self.leaves.len() - 1) as u32 | IS_LEAF,
        });
        Some((self.cuts.len() - 1) as u32)
    }

    /// The point nearest to another; `None` if the set is empty.
    #[must_use]
    pub fn nearest(&self, p: Point2<f64>) -> Option<u32> {
        let mut best = (f32::INFINITY, None);
        self.visit(p, f32::INFINITY, |leaf, x, y| {
            let squared = leaf.squared_distances(x, y);
            for (squared, id) in squared.into_iter().zip(leaf.id) {
                if squared < best.0 {
                    best = (squared, Some(id));
                }
            }
            best.0
        });
        best.1
    }

    /// All points within a radius of another, with their squared distances, cells.
    pub fn within(&self, p: Point2<f64>, radius: f64, found: &mut Vec<(f32, u32)>) {
        found.clear();
        let limit = (radius * radius) as f32;
        self.visit(p, limit, |leaf, x, y| {
            let squared = leaf.squared_distances(x, y);
            for (squared, id) in squared.into_iter().zip(leaf.id) {
                if squared <= limit {
                    found.push((squared, id));
                }
            }
            limit
        });
    }

    /// Visits all leaves whose region lies within a squared distance of a point; `look` returns the new squared distance.
    fn visit(&self, p: Point2<f64>, mut limit: f32, mut look: impl FnMut(&Leaf, f32, f32) -> f32) {
        let q = [p.x as f32, p.y as f32];
        // Subtrees still to be visited, and their offsets from the point along each axis.
        let mut open = [(0_u32, [0.0_f32; 2]); DEPTH];
        let mut len = 0;
        let (mut at, mut off) = (self.root, [0.0_f32; 2]);
        if self.leaves.is_empty() {
            return;
        }
        loop {
            while at & IS_LEAF == 0 {
                let cut = self.cuts[at as usize];
                let axis = usize::from(!cut.vertical);
                let beyond = q[axis] - cut.at;
                let (near, far) = if beyond >= 0.0 {
                    (cut.above, cut.below)
                } else {
                    (cut.below, cut.above)
                };
                let mut far_off = off;
                far_off[axis] = beyond;
                if len < DEPTH && far_off[0] * far_off[0] + far_off[1] * far_off[1] <= limit {
                    open[len] = (far, far_off);
                    len += 1;
                }
                at = near;
            }
            limit = look(&self.leaves[(at & !IS_LEAF) as usize], q[0], q[1]);
            loop {
                if len == 0 {
                    return;
                }
                len -= 1;
                (at, off) = open[len];
                if off[0] * off[0] + off[1] * off[1] <= limit {
                    break;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Scattered, on a line, and in clusters.
    fn points() -> impl Strategy<Value = Vec<Point2<f64>>> {
        prop::collection::vec((0.0..300.0, 0.0..200.0, 0..3), 1..400).prop_map(|points| {
            let place = |(x, y, kind): (f64, f64, i32)| match kind {
                0 => Point2::new(x, y),
                1 => Point2::new(x, 7.5),
                _ => Point2::new(100.0 + 0.01 * x, 50.0 + 0.01 * y),
            };
            points.into_iter().map(place).collect()
        })
    }

    fn set(points: &[Point2<f64>]) -> Nearest {
        let mut set = Nearest::default();
        set.clear([300, 200]);
        for (i, p) in points.iter().enumerate() {
            set.insert(*p, i as u32);
        }
        set
    }

    proptest! {
        #[test]
        fn no_other_point_is_nearer(points in points(), q in (-10.0..310.0, -10.0..210.0)) {
            let q = Point2::new(q.0, q.1);
            let found = set(&points).nearest(q).unwrap();
            let least = points.iter().map(|p| (p - q).norm()).fold(f64::INFINITY, f64::min);
            prop_assert!((points[found as usize] - q).norm() <= least + 0.05);
        }

        #[test]
        fn all_within_a_radius_are_found(points in prop::collection::vec((0.0..300.0, 0.0..200.0), 1..400), q in (0.0..300.0, 0.0..200.0), radius in 0.0..150.0) {
            let points: Vec<_> = points.into_iter().map(|(x, y)| Point2::new(x, y)).collect();
            let q = Point2::new(q.0, q.1);
            let mut found = Vec::new();
            set(&points).within(q, radius, &mut found);
            let within = |slack: f64| points.iter().filter(|p| (*p - q).norm() <= radius + slack).count();
            prop_assert!(within(-1e-3) <= found.len() && found.len() <= within(1e-3));
        }
    }

    #[test]
    fn points_that_coincide_do_no_harm() {
        let set = set(&vec![Point2::new(5.0, 5.0); 1000]);
        assert!(set.nearest(Point2::new(0.0, 0.0)).is_some());
        assert!(Nearest::default().nearest(Point2::origin()).is_none());
    }
}
