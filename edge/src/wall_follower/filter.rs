//! Return filter. Which returns of a scan are walls, and which are noise? Runs of neighbouring returns close together are kept.

use nalgebra::Point2;

/// Most points used; more are thinned evenly.
const MOST: usize = 4096;

/// Runs of returns that stand together, neighbours at most `gap` m apart, at least `least` in each; `points` are those of a sweep in the
/// order of its beams.
/// A full circle has no first beam: a run may cross its seam.
#[must_use]
pub fn runs(points: impl Iterator<Item = Point2<f64>>, least: usize, gap: f64) -> Vec<Vec<Point2<f64>>> {
    let mut points: Vec<_> = points.collect();
    if points.len() > MOST {
        points = points.iter().step_by(points.len().div_ceil(MOST)).copied().collect();
    }
    let apart = |a: &Point2<f64>, b: &Point2<f64>| (a - b).norm_squared() > gap * gap;
    let before = points.last().into_iter().chain(&points);
    let seam = before.zip(&points).position(|(a, b)| apart(a, b)).unwrap_or(0);
    points.rotate_left(seam);
    points
        .chunk_by(|a, b| !apart(a, b))
        .filter(|run| run.len() >= least)
        .map(<[_]>::to_vec)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(from: f64, count: u32) -> Vec<Point2<f64>> {
        (0..count)
            .map(|i| Point2::new(from + 0.05 * f64::from(i), 1.0))
            .collect()
    }

    #[test]
    fn a_few_stray_returns_are_noise_and_a_row_of_them_is_a_wall() {
        let points = [row(0.0, 10), vec![Point2::new(0.5, 0.4)], row(2.0, 4), row(4.0, 5)].concat();
        let found: Vec<usize> = runs(points.into_iter(), 5, 0.15).iter().map(Vec::len).collect();
        assert_eq!(found, [10, 5]);
    }

    #[test]
    fn a_wall_across_the_seam_of_a_full_circle_is_one() {
        let wall = row(0.0, 8);
        let points = [&wall[3..], &row(3.0, 6)[..], &wall[..3]].concat();
        let found: Vec<usize> = runs(points.into_iter(), 5, 0.15).iter().map(Vec::len).collect();
        assert_eq!(found, [6, 8]);
        assert!(runs(std::iter::empty(), 1, 0.15).is_empty());
    }
}
