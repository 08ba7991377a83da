//! How does one tree find the goal? It grows from the start towards samples, now and then towards the goal itself.
//!
//! Source: LaValle, "Rapidly-Exploring Random Trees: A New Tool for Path Planning", 1998. Once the first samples have not been enough, every other
//! one leads the tree out of what it has covered ([`Tree::explore`]), and each new vertex looks whether it sees the goal.

use nalgebra::Point2;

use super::super::astar::NotFound;
use super::Search;
use super::tree::{Explored, Extended, Ground, Tree};
use zenav_space::LineOfSight;

/// Grows a tree that has been planted until it reaches the goal: the way from its root.
///
/// # Errors
/// [`NotFound::NoPath`] when the tree has covered all that can be reached, [`NotFound::TimedOut`].
pub fn grow<S: LineOfSight>(
    ground: &Ground<'_, S>,
    tree: &mut Tree,
    goal: Point2<f64>,
    search: &mut Search<'_>,
) -> Result<Vec<Point2<f64>>, NotFound> {
    let target = ground.free_at(goal);
    let mut found = None;
    while found.is_none() {
        let explores = search.next()?;
        let before = tree.vertices();
        let sample = if explores {
            None
        } else if search.sampler.unit() < search.options.goal_bias {
            Some(goal)
        } else {
            search.sampler.free(ground.lattice)
        };
        if let Some(sample) = sample {
            tree.extend(ground, sample);
        } else {
            let explored = tree.explore(ground, &mut search.sampler, search.options.exits, target);
            if explored == Explored::Everything && target.is_some() && tree.vertices() == before {
                return Err(NotFound::NoPath);
            }
        }
        found = (before..tree.vertices())
            .rev()
            .find_map(|vertex| match tree.extend_from(ground, vertex, goal) {
                Extended::Arrived(vertex) => Some(vertex),
                Extended::Stepped(_) | Extended::Trapped => None,
            });
    }
    let mut way: Vec<Point2<f64>> = found.into_iter().flat_map(|vertex| tree.back(vertex)).collect();
    way.reverse();
    Ok(way)
}
