//! How do two trees meet? One from the start and one from the goal take turns; whatever one gains, the other tries to connect to.
//!
//! Source: Kuffner and LaValle, "RRT-Connect: An Efficient Approach to Single-Query Path Planning", 2000. Once the first samples have not been
//! enough, every other one leads a tree out of what it has covered ([`Tree::explore`]).

use nalgebra::Point2;

use super::super::astar::NotFound;
use super::Search;
use super::tree::{Explored, Ground, Tree};
use zenav_space::LineOfSight;

/// Grows two trees that have been planted until they meet: the way from the first one's root to the other's.
///
/// # Errors
/// [`NotFound::NoPath`] when one tree has covered all that can be reached from it, [`NotFound::TimedOut`].
pub fn meet<S: LineOfSight>(
    ground: &Ground<'_, S>,
    trees: &mut [Tree; 2],
    search: &mut Search<'_>,
) -> Result<Vec<Point2<f64>>, NotFound> {
    let roots = [0, 1].map(|side: usize| ground.free_at(trees[side].point(0)));
    loop {
        let explores = search.next()?;
        let side = (search.samples & 1) as usize;
        let [first, second] = trees;
        let (tree, other) = if side == 0 { (first, second) } else { (second, first) };
        let before = tree.vertices();
        let sample = if explores {
            None
        } else {
            search.sampler.free(ground.lattice)
        };
        if let Some(sample) = sample {
            tree.extend(ground, sample);
        } else {
            let target = roots[1 - side];
            let explored = tree.explore(ground, &mut search.sampler, search.options.exits, target);
            if explored == Explored::Everything && target.is_some() && tree.vertices() == before {
                return Err(NotFound::NoPath);
            }
        }
        for vertex in (before..tree.vertices()).rev() {
            let p = tree.point(vertex);
            if let Some(met) = other.connect(ground, p) {
                return Ok(join(trees, side, vertex, met));
            }
        }
    }
}

/// The way from the first tree's root to the other's, by the vertices at which one tree and the other one met.
fn join(trees: &[Tree; 2], side: usize, vertex: u32, met: u32) -> Vec<Point2<f64>> {
    let [here, there] = if side == 0 { [vertex, met] } else { [met, vertex] };
    let mut way: Vec<Point2<f64>> = trees[0].back(here).collect();
    way.reverse();
    way.extend(trees[1].back(there).skip(1));
    way
}
