//! Outline. The edges that bound the occupied cells of a map.
//!
//! An occupied cell is a closed square. Sides between two occupied cells are inside the solid and left out; collinear sides with the
//! solid on the same side are merged into one edge. The result is exact and much smaller than the cells.

use nalgebra::Point2;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};

use crate::shape::Edge;

/// The boundary of all occupied cells; unknown cells are open. Edges that meet share bit-identical corners.
///
/// Cost: one visit per cell and direction.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
/// use zenav_sim::outline::outline;
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 0.5, width: 4, height: 3 };
/// let mut map = OccupancyGrid::filled(spec, Occupancy::FREE);
/// (map[Cell::new(1, 1)], map[Cell::new(2, 1)]) = (Occupancy::OCCUPIED, Occupancy::OCCUPIED);
/// let edges = outline(&map);
/// let circumference: f64 = edges.iter().map(|edge| (edge.b - edge.a).norm()).sum();
/// assert_eq!((edges.len(), circumference), (4, 3.0), "one rectangle of 1 m by 0.5 m");
/// ```
#[must_use]
pub fn outline(map: &OccupancyGrid) -> Vec<Edge> {
    let spec = *map.spec();
    let (width, height) = (spec.width as usize, spec.height as usize);
    let occupied = |x: usize, y: usize| {
        x < width
            && y < height
            && map
                .values()
                .get(y * width + x)
                .is_some_and(|value| Occupancy::of(*value) == Occupancy::Occupied)
    };
    let corner = |x: usize, y: usize| {
        Point2::new(
            spec.origin.x + x as f64 * spec.resolution,
            spec.origin.y + y as f64 * spec.resolution,
        )
    };
    let mut edges = Vec::new();
    for y in 0..=height {
        // Solid above the line: the edge runs to +x; below: to -x.
        let side = |x: usize| (occupied(x, y), y > 0 && occupied(x, y - 1));
        runs(width, side, |from, to, above| {
            let (low, high) = (corner(from, y), corner(to, y));
            edges.push(if above {
                Edge { a: low, b: high }
            } else {
                Edge { a: high, b: low }
            });
        });
    }
    for x in 0..=width {
        // Solid right of the line: the edge runs to -y; left of it: to +y.
        let side = |y: usize| (occupied(x, y), x > 0 && occupied(x - 1, y));
        runs(height, side, |from, to, right| {
            let (low, high) = (corner(x, from), corner(x, to));
            edges.push(if right {
                Edge { a: high, b: low }
            } else {
                Edge { a: low, b: high }
            });
        });
    }
    edges
}

/// Runs of positions where only one side of a line is solid: `found(from, to, whether the far side is solid)`.
fn runs(length: usize, side: impl Fn(usize) -> (bool, bool), mut found: impl FnMut(usize, usize, bool)) {
    let mut open: Option<(usize, bool)> = None;
    for at in 0..=length {
        let now = if at < length {
            let (far, near) = side(at);
            (far != near).then_some(far)
        } else {
            None
        };
        if let Some((from, far)) = open
            && now != Some(far)
        {
            found(from, at, far);
            open = None;
        }
        if let (None, Some(far)) = (open, now) {
            open = Some((at, far));
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::shape::{cross, doubled_area};
    use proptest::prelude::*;
    use zenav_protocol::grid::GridSpec;

    fn map(width: u32, height: u32, occupied: &[bool]) -> OccupancyGrid {
        let spec = GridSpec {
            origin: Point2::new(-1.0, 2.0),
            resolution: 0.5,
            width,
            height,
        };
        OccupancyGrid::from_values(
            spec,
            occupied
                .iter()
                .map(|full| if *full { Occupancy::OCCUPIED } else { Occupancy::FREE })
                .collect(),
        )
        .unwrap()
    }

    #[test]
    fn a_block_of_cells_is_four_edges() {
        let edges = outline(&map(4, 3, &[true; 12]));
        assert_eq!(edges.len(), 4);
        let area: f64 = edges.iter().map(|edge| cross(edge.a.coords, edge.b.coords)).sum();
        assert!((area - 2.0 * 2.0 * 1.5).abs() < 1e-12);
        assert_eq!(doubled_area(&[]), 0.0);
    }

    proptest! {
        #[test]
        fn the_outline_encloses_the_area_of_its_cells(occupied in prop::collection::vec(any::<bool>(), 63)) {
            let edges = outline(&map(9, 7, &occupied));
            // Green's theorem: the sum over directed edges is the area with the solid on the left.
            let area: f64 = edges.iter().map(|edge| 0.5 * cross(edge.a.coords, edge.b.coords)).sum();
            let cells = occupied.iter().filter(|full| **full).count();
            prop_assert!((area - cells as f64 * 0.25).abs() < 1e-9);
        }
    }
}
