//! String pulling between cell centres. Removes corners that a line of sight bypasses, and moves the others to where the path is shortest
//! while it stays in sight.
//!
//! A local descent: it adds no corners and looks for no other way around an obstacle.

use nalgebra::{Point2, Vector2};

use zenav_space::LineOfSight;

/// Longest step by which a corner is moved, cells; it is halved from there.
const LONGEST: f64 = 8.0;
/// Number of corners ahead that are tested for sight.
const AHEAD: usize = 16;
/// Rounds over all corners: most paths are taut after a few.
const ROUNDS: usize = 40;

/// Shortens a path whose legs are all in sight; they stay in sight, and the ends stay fixed. Corners move by at least `finest` cells; a
/// `finest` of 1 keeps them at cell centres. The path never gets longer; deterministic. Ends soon after `stops` returns true.
pub fn pull_string(sight: &impl LineOfSight, corners: &mut Vec<Point2<f64>>, finest: f64, stops: impl Fn() -> bool) {
    if stops() {
        return;
    }
    cut(sight, corners);
    let mut step = LONGEST.max(finest);
    for _ in 0..ROUNDS {
        let mut moved = false;
        for i in 1..corners.len().saturating_sub(1) {
            if stops() {
                return;
            }
            if let Some(better) = better(sight, [corners[i - 1], corners[i], corners[i + 1]], step) {
                corners[i] = better;
                moved = true;
            }
        }
        if moved {
            cut(sight, corners);
        } else if 0.5 * step >= finest {
            step *= 0.5;
        } else {
            return;
        }
    }
}

/// Removes the corners that a line of sight bypasses.
fn cut(sight: &impl LineOfSight, corners: &mut Vec<Point2<f64>>) {
    let (mut at, mut kept) = (0, Vec::with_capacity(corners.len()));
    while let Some(from) = corners.get(at) {
        kept.push(*from);
        let near = &corners[at + 1..corners.len().min(at + 1 + AHEAD)];
        at += 1 + near.iter().rposition(|to| sight.sees(*from, *to)).unwrap_or(0);
    }
    *corners = kept;
}

/// The position one step from a corner, in any of eight directions, that makes the path between its neighbours shortest; `None` if none
/// is shorter than the present one.
fn better(sight: &impl LineOfSight, [before, corner, after]: [Point2<f64>; 3], step: f64) -> Option<Point2<f64>> {
    let length = |p: Point2<f64>| (p - before).norm() + (after - p).norm();
    // Rounding between equal lengths is no gain.
    let mut best = (length(corner) - 1e-9, None);
    for (x, y) in [
        (1.0, 0.0),
        (-1.0, 0.0),
        (0.0, 1.0),
        (0.0, -1.0),
        (1.0, 1.0),
        (-1.0, -1.0),
        (1.0, -1.0),
        (-1.0, 1.0),
    ] {
        let place = corner + Vector2::new(x, y) * step;
        let length = length(place);
        if length < best.0 && sight.sees(before, place) && sight.sees(place, after) {
            best = (length, Some(place));
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use zenav_protocol::grid::Cell;

    use super::*;
    use crate::Budget;
    use crate::cell_cost::Uniform;
    use crate::grid_graph::GridGraph;
    use crate::path::{Path, length};
    use crate::planners::astar::{Memory, search};
    use zenav_space::{BitGrid, PointLineOfSight};

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn a_path_in_sight_stays_in_sight_and_never_gets_longer(size in (2_u32..40, 2_u32..40), dots in prop::collection::vec((0_u32..40, 0_u32..40), 0..200), ends in any::<(u32, u32, u32, u32)>(), finest in prop::sample::select(vec![0.125, 1.0])) {
            let mut free = BitGrid::from_fn(size.0, size.1, |_| true);
            dots.iter().for_each(|(x, y)| free.set(Cell::new(*x, *y), false));
            let (start, goal) = (Cell::new(ends.0 % size.0, ends.1 % size.1), Cell::new(ends.2 % size.0, ends.3 % size.1));
            let found = search(&GridGraph::new(&free).unwrap(), &Uniform, start, goal, &mut Memory::default(), Budget::UNLIMITED).result;
            prop_assume!(found.is_ok());
            let before = Path::from(found.unwrap());
            let (sight, mut corners) = (PointLineOfSight::new(&free), before.corners.clone());
            pull_string(&sight, &mut corners, finest, || false);
            prop_assert!(corners.windows(2).all(|leg| sight.sees(leg[0], leg[1])));
            prop_assert!(length(&corners) <= before.length + 1e-9);
            prop_assert_eq!((corners.first(), corners.last()), (before.corners.first(), before.corners.last()));
            prop_assert!(finest < 1.0 || corners.iter().all(|p| p.x.fract() == 0.5 && p.y.fract() == 0.5));
            prop_assert!(corners.windows(3).all(|three| !sight.sees(three[0], three[2])), "no corner that one sees past");
        }
    }

    #[test]
    fn a_path_around_a_wall_is_pulled_to_its_end() {
        let mut free = BitGrid::from_fn(41, 41, |_| true);
        (0..30).for_each(|y| free.set(Cell::new(20, y), false));
        let at = |x: f64, y: f64| Point2::new(x, y);
        let mut corners = vec![at(2.5, 2.5), at(5.0, 38.0), at(30.0, 40.0), at(38.5, 2.5)];
        let bent = corners.clone();
        pull_string(&PointLineOfSight::new(&free), &mut corners, 1.0 / 64.0, || true);
        assert_eq!(corners, bent, "it stops when it is told to");
        pull_string(&PointLineOfSight::new(&free), &mut corners, 1.0 / 64.0, || false);
        // Close around the wall's end at (20, 30) and (21, 30), with one corner instead of two.
        let shortest = length(&[at(2.5, 2.5), at(20.0, 30.0), at(21.0, 30.0), at(38.5, 2.5)]);
        assert!(
            corners.len() == 3 && length(&corners) < shortest * 1.015,
            "{} against {shortest}: {corners:?}",
            length(&corners)
        );
    }

    #[test]
    fn nothing_much_stays_nothing_much() {
        let sight = PointLineOfSight::new(&BitGrid::from_fn(9, 9, |_| true));
        for mut corners in [vec![], vec![Point2::new(1.5, 1.5)]] {
            let before = corners.clone();
            pull_string(&sight, &mut corners, 1.0, || false);
            assert_eq!(corners, before);
        }
    }
}
