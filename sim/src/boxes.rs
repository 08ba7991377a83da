//! Box tree. The things that are near, the nearest first: a tree of boxes over short runs of neighbours.
//!
//! Split at the median along the longer side (Bentley 1975), so that a box holds things that are close together; both children of a node
//! are adjacent in memory. A walk goes front to back, so that a lidar can skip what is hidden or too far; clearances use parry's tree.

use nalgebra::Point2;

/// Largest number of things in a leaf.
const RUN: usize = 16;

/// Something that has an extent.
pub trait Bounded {
    /// Lower-left and upper-right corner, m.
    fn bounds(&self) -> [Point2<f64>; 2];
}

#[derive(Clone, Copy, Debug)]
struct Node {
    low: Point2<f64>,
    high: Point2<f64>,
    /// First thing of a leaf, or first of the two children.
    first: u32,
    /// Number of things in a leaf; zero for a node with children.
    count: u32,
}

/// Things, indexed by boxes.
#[derive(Clone, Debug)]
pub struct BoxTree<T> {
    nodes: Vec<Node>,
    things: Vec<T>,
}

/// A box and its distance.
#[derive(Clone, Copy, Debug)]
pub struct Apart {
    /// Lower-left corner, m.
    pub low: Point2<f64>,
    /// Upper-right corner, m.
    pub high: Point2<f64>,
    /// Squared distance, m²; zero inside.
    pub squared: f64,
}

/// Visitor of a walk through a tree.
pub trait Visitor<T> {
    /// The visitor's view of a box from the start of the walk.
    type View: Copy;

    /// Looks at two boxes that are siblings; the root is passed twice.
    fn look(&self, pair: [&Apart; 2]) -> [Self::View; 2];

    /// Whether to enter a box when the walk reaches it.
    fn enters(&self, view: &Self::View) -> bool;

    /// Receives the things of a leaf that was entered.
    fn meet(&mut self, things: &[T]);
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

    /// All things, in the tree's order.
    #[must_use]
    pub fn things(&self) -> &[T] {
        &self.things
    }

    /// Walks from a point outwards.
    pub fn walk<V: Visitor<T>>(&self, from: Point2<f64>, visitor: &mut V) {
        let Some(root) = self.nodes.first() else {
            return;
        };
        let root = apart(from, root);
        // Deeper than any tree of u32 things: one child waits on every level.
        let mut waiting = [(0_u32, visitor.look([&root; 2])[0]); 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (index, view) = waiting[depth];
            if !visitor.enters(&view) {
                continue;
            }
            let node = &self.nodes[index as usize];
            let first = node.first as usize;
            if node.count > 0 {
                visitor.meet(&self.things[first..first + node.count as usize]);
            } else if depth + 2 <= waiting.len() {
                let (left, right) = (apart(from, &self.nodes[first]), apart(from, &self.nodes[first + 1]));
                let views = visitor.look([&left, &right]);
                // The nearer one is pushed last, so that it is taken first.
                let nearer = usize::from(right.squared < left.squared);
                waiting[depth] = (node.first + 1 - nearer as u32, views[1 - nearer]);
                waiting[depth + 1] = (node.first + nearer as u32, views[nearer]);
                depth += 2;
            }
        }
    }
}

/// The distance of a node's box from a point.
fn apart(from: Point2<f64>, node: &Node) -> Apart {
    Apart {
        low: node.low,
        high: node.high,
        squared: squared_distance(from, node),
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

/// Splits a leaf that holds too much. `offset` is the index of its first thing among all.
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

    /// Counts what is within a radius.
    struct Within {
        from: Point2<f64>,
        radius: f64,
        met: usize,
    }

    impl Visitor<Dot> for Within {
        type View = f64;

        fn look(&self, pair: [&Apart; 2]) -> [f64; 2] {
            pair.map(|apart| apart.squared)
        }

        fn enters(&self, squared: &f64) -> bool {
            *squared <= self.radius * self.radius
        }

        fn meet(&mut self, dots: &[Dot]) {
            self.met += dots
                .iter()
                .filter(|dot| (dot.0 - self.from).norm() <= self.radius)
                .count();
        }
    }

    proptest! {
        #[test]
        fn a_walk_comes_to_everything_within_reach(dots in dots(), x in -6.0..6.0, y in -6.0..6.0, radius in 0.0..8.0) {
            let from = Point2::new(x, y);
            let tree = BoxTree::new(dots.clone());
            let mut within = Within { from, radius, met: 0 };
            tree.walk(from, &mut within);
            let met = within.met;
            prop_assert_eq!(met, dots.iter().filter(|dot| (dot.0 - from).norm() <= radius).count());
        }
    }
}
