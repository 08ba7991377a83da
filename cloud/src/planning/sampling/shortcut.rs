//! How does a way with needless corners become a short one? Corners that are not needed are left out.

use nalgebra::Point2;

use crate::space::Sight;

/// Leaves out corners, from the front and from the back: from each corner that is kept the way goes to the farthest one that is seen, as far as
/// a search in doubling steps finds it.
pub fn prune(sight: &impl Sight, way: &mut Vec<Point2<f64>>) {
    for _ in 0..2 {
        let mut kept = 1;
        let mut at = 0;
        while at + 1 < way.len() {
            let sees = |to: usize| to < way.len() && sight.sees(way[at], way[to]);
            let (mut to, mut step) = (at + 1, 1);
            while sees(to + step) {
                to += step;
                step *= 2;
            }
            while step > 0 {
                if sees(to + step) {
                    to += step;
                }
                step /= 2;
            }
            way[kept] = way[to];
            kept += 1;
            at = to;
        }
        way.truncate(kept);
        way.reverse();
    }
}
