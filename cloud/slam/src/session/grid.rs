//! Grid of points. Stores the points of a scan compactly.
//!
//! Points are snapped to a grid of 1 mm when they are taken in, a tenth of a lidar's accuracy, so storing them loses nothing. Each point is
//! written as its offset from the previous one: neighbours are close, and small numbers are short.

use nalgebra::Point2;

/// Grid steps per metre.
const PER_METRE: f64 = 1000.0;
/// Farthest coordinate, steps: 1 km.
const FARTHEST: i32 = 1_000_000;

/// Snaps points to the grid; those beyond its end are left out.
pub(crate) fn on_grid(points: Vec<Point2<f64>>) -> Vec<Point2<f64>> {
    let steps = |value: f64| (value * PER_METRE).round();
    let is_inside = |point: &Point2<f64>| point.iter().all(|value| steps(*value).abs() <= f64::from(FARTHEST));
    points
        .into_iter()
        .filter(is_inside)
        .map(|point| point.map(|value| at(steps(value) as i32)))
        .collect()
}

fn at(steps: i32) -> f64 {
    f64::from(steps) / PER_METRE
}

/// Points of the grid as offsets from one to the next, x and y in turn.
pub(crate) fn packed(points: &[Point2<f64>]) -> Vec<i32> {
    let mut before = [0; 2];
    let mut steps = Vec::with_capacity(2 * points.len());
    for point in points {
        let now = [point.x, point.y].map(|value| (value * PER_METRE).round() as i32);
        steps.extend([now[0] - before[0], now[1] - before[1]]);
        before = now;
    }
    steps
}

/// Inverse of [`packed`]; `None` if the numbers are not in pairs or leave the grid.
pub(super) fn unpacked(steps: &[i32]) -> Option<Vec<Point2<f64>>> {
    let (pairs, rest) = steps.as_chunks::<2>();
    let mut now = [0_i32; 2];
    let points = pairs.iter().map(|[x, y]| {
        now = [now[0].checked_add(*x)?, now[1].checked_add(*y)?];
        let is_inside = now.iter().all(|value| value.unsigned_abs() <= FARTHEST.unsigned_abs());
        is_inside.then(|| Point2::new(at(now[0]), at(now[1])))
    });
    let points: Option<Vec<_>> = points.collect();
    points.filter(|_| rest.is_empty())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_point_moves_by_half_a_millimetre_at_most_and_is_written_without_loss(
            values in prop::collection::vec((-200.0..200.0, -200.0..200.0), 0..50),
        ) {
            let points: Vec<Point2<f64>> = values.iter().map(|(x, y)| Point2::new(*x, *y)).collect();
            let moved = on_grid(points.clone());
            for (point, moved) in points.iter().zip(&moved) {
                prop_assert!((point - moved).amax() <= 0.0005 + 1e-9);
            }
            prop_assert_eq!(unpacked(&packed(&moved)).unwrap(), moved);
        }
    }

    #[test]
    fn steps_that_leave_the_grid_or_come_single_are_no_points() {
        assert_eq!(unpacked(&[1]), None);
        assert_eq!(unpacked(&[i32::MAX, 0, i32::MAX, 0]), None);
        assert_eq!(unpacked(&[FARTHEST + 1, 0]), None);
    }
}
