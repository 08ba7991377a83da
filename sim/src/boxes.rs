//! Which things are near, the nearest first? A tree of boxes over short runs of neighbours.
//!
//! Split at the median along the longer side (Bentley 1975), so that a box holds what is close together; both children of a node lie
//! side by side in memory. A walk goes front to back, so that whoever walks can leave out what is hidden or too far.

use nalgebra::Point2;

/// Things in one leaf, at most.
const RUN: usize = 8;

/// Something that has an extent.
pub trait Bounded {
    /// Lower-left and upper-right corner, m.
    fn bounds(&self) -> [Point2<f64>; 2];
}

#[derive(Clone, Copy, Debug)]
struct Node {
    low: Point2<f64>,
    high: Point2<f64>,
    /// First thing of a leaf; the nearer in memory of two children.
    first: u32,
    /// Things in a leaf; zero for a node with children.
    count: u32,
}

/// Things, indexed.
#[derive(Clone, Debug)]
pub struct BoxTree<T> {
    nodes: Vec<Node>,
    things: Vec<T>,
}

/// What a walk comes to.
#[derive(Clone, Copy, Debug)]
pub enum Met<'a, T> {
    /// A box: is it to be entered?
    Box {
        /// Lower-left corner, m.
        low: Point2<f64>,
        /// Upper-right corner, m.
        high: Point2<f64>,
        /// Squared distance, m²; zero inside.
        squared: f64,
        /// Whether it holds things, not boxes.
        leaf: bool,
    },
    /// Things in a box that was entered.
    Things(&'a [T]),
}

impl<T: Bounded> BoxTree<T> {
    /// Sorts and indexes. Cost: O(n log n).
    #[must_use]
    pub fn new(mut things: Vec<T>) -> Self {
        let mut nodes = Vec::with_capacity(things.len() / 2 + 2);
        if !things.is_empty() {
            nodes.push(bounds(&things));
            split(&mut nodes, 0, &mut things, 0);
        }
        Self { nodes, things }
    }

    /// Everything, in the tree's order.
    #[must_use]
    pub fn things(&self) -> &[T] {
        &self.things
    }

    /// Walks from a point outwards: `meet` says of each box whether to enter it (its answer to things does not matter).
    pub fn walk(&self, from: Point2<f64>, mut meet: impl FnMut(Met<'_, T>) -> bool) {
        // Deeper than any tree of u32 things: one child waits on every level.
        let mut waiting = [(0_u32, 0.0_f64); 64];
        let mut depth = 0;
        let mut next = self.nodes.first().map(|root| (0, squared_distance(from, root)));
        while let Some((index, squared)) = next {
            next = None;
            let node = &self.nodes[index as usize];
            let Node { low, high, count, .. } = *node;
            if meet(Met::Box {
                low,
                high,
                squared,
                leaf: count > 0,
            }) {
                let first = node.first as usize;
                if node.count > 0 {
                    meet(Met::Things(&self.things[first..first + node.count as usize]));
                } else {
                    let child = |index: u32| (index, squared_distance(from, &self.nodes[index as usize]));
                    let (left, right) = (child(node.first), child(node.first + 1));
                    let (near, far) = if right.1 < left.1 { (right, left) } else { (left, right) };
                    if depth < waiting.len() {
                        waiting[depth] = far;
                        depth += 1;
                    }
                    next = Some(near);
                }
            }
            if next.is_none() && depth > 0 {
                depth -= 1;
                next = Some(waiting[depth]);
            }
        }
    }

    /// The thing with the least `distance`, where it is less than `limit`: `(distance, thing)`. Boxes farther than the best so far
    /// are left out; `reach` is by how much `distance` may be less than that from `from`.
    pub fn nearest<N>(
        &self,
        from: Point2<f64>,
        reach: f64,
        limit: f64,
        distance: impl Fn(&T) -> (f64, N),
    ) -> Option<(f64, N)> {
        let mut best: Option<(f64, N)> = None;
        self.walk(from, |met| match met {
            Met::Box { squared, .. } => squared.sqrt() - reach < best.as_ref().map_or(limit, |(least, _)| *least),
            Met::Things(things) => {
                for thing in things {
                    let found = distance(thing);
                    if found.0 < best.as_ref().map_or(limit, |(least, _)| *least) {
                        best = Some(found);
                    }
                }
                false
            }
        });
        best
    }
}

/// Squared distance from a point to a node's box; zero inside.
fn squared_distance(point: Point2<f64>, node: &Node) -> f64 {
    let x = (node.low.x - point.x).max(point.x - node.high.x).max(0.0);
    let y = (node.low.y - point.y).max(point.y - node.high.y).max(0.0);
    x * x + y * y
}

/// A leaf around things.
fn bounds<T: Bounded>(things: &[T]) -> Node {
    let mut node = Node {
        low: Point2::new(f64::INFINITY, f64::INFINITY),
        high: Point2::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
        first: 0,
        count: things.len() as u32,
    };
    for thing in things {
        let [low, high] = thing.bounds();
        node.low = node.low.inf(&low);
        node.high = node.high.sup(&high);
    }
    node
}

/// Splits a leaf that holds too much. `offset` is the place of its first thing among all.
fn split<T: Bounded>(nodes: &mut Vec<Node>, at: usize, things: &mut [T], offset: usize) {
    if things.len() <= RUN {
        nodes[at].first = offset as u32;
        return;
    }
    let extent = nodes[at].high - nodes[at].low;
    let axis = usize::from(extent.y > extent.x);
    let middle = things.len() / 2;
    let twice_center = |thing: &T| {
        let [low, high] = thing.bounds();
        low[axis] + high[axis]
    };
    things.select_nth_unstable_by(middle, |a, b| twice_center(a).total_cmp(&twice_center(b)));
    let (left, right) = things.split_at_mut(middle);
    let first = nodes.len();
    nodes[at].first = first as u32;
    nodes[at].count = 0;
    nodes.push(bounds(left));
    nodes.push(bounds(right));
    split(nodes, first, left, offset);
    split(nodes, first + 1, right, offset + middle);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Clone, Debug)]
    struct Dot(Point2<f64>);

    impl Bounded for Dot {
        fn bounds(&self) -> [Point2<f64>; 2] {
            [self.0; 2]
        }
    }

    fn dots() -> impl Strategy<Value = Vec<Dot>> {
        let coordinate = prop_oneof![-5.0..5.0, Just(1.0)];
        prop::collection::vec((coordinate.clone(), coordinate), 0..200)
            .prop_map(|dots| dots.into_iter().map(|(x, y)| Dot(Point2::new(x, y))).collect())
    }

    proptest! {
        #[test]
        fn a_walk_comes_to_everything_within_reach_and_boxes_hold_what_is_in_them(dots in dots(), x in -6.0..6.0, y in -6.0..6.0, radius in 0.0..8.0) {
            let from = Point2::new(x, y);
            let tree = BoxTree::new(dots.clone());
            let mut within: Option<[Point2<f64>; 2]> = None;
            let mut met = 0;
            tree.walk(from, |what| match what {
                Met::Box { low, high, squared, .. } => {
                    within = Some([low, high]);
                    squared <= radius * radius
                }
                Met::Things(things) => {
                    let [low, high] = within.unwrap_or([from; 2]);
                    assert!(things.iter().all(|dot| dot.0 >= low && dot.0 <= high));
                    met += things.iter().filter(|dot| (dot.0 - from).norm() <= radius).count();
                    true
                }
            });
            prop_assert_eq!(met, dots.iter().filter(|dot| (dot.0 - from).norm() <= radius).count());
        }

        #[test]
        fn the_nearest_is_the_nearest_of_all(dots in dots(), x in -6.0..6.0, y in -6.0..6.0, limit in 0.0..12.0) {
            let from = Point2::new(x, y);
            let distance = |dot: &Dot| ((dot.0 - from).norm(), ());
            let expected = dots.iter().map(|dot| distance(dot).0).fold(f64::INFINITY, f64::min);
            let found = BoxTree::new(dots).nearest(from, 0.0, limit, distance).map(|(distance, ())| distance);
            prop_assert_eq!(found, (expected < limit).then_some(expected));
        }
    }
}
