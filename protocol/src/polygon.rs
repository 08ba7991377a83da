//! Polygons. What does an outline enclose, and is it a simple polygon?
//!
//! Used for obstacles, zones and footprints from user files. Not parry's: these outlines may be concave, edges are compared without a
//! tolerance, and the contract stays free of a collision library. For convex outlines, which parry can answer too, points inside are told
//! 11 times, and edges that touch 1.3 times as fast (`cargo bench -p zenav-edge --bench collision_monitor`).

use std::f64::consts::PI;

use nalgebra::{Point2, Vector2};
use thiserror::Error;

/// Cross product in the plane: positive when `b` points to the left of `a`.
#[must_use]
pub fn cross(a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    a.x * b.y - a.y * b.x
}

/// An edge of a polygon, m; the interior lies to the left of `a -> b`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Start of the edge.
    pub a: Point2<f64>,
    /// End of the edge.
    pub b: Point2<f64>,
}

impl Edge {
    /// The point of the edge that is nearest to a point; `a` of an edge without length.
    #[must_use]
    pub fn nearest(&self, point: Point2<f64>) -> Point2<f64> {
        let along = self.b - self.a;
        let share = (point - self.a).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE);
        self.a + along * share.clamp(0.0, 1.0)
    }
}

/// The edges of a polygon; the last joins the last corner to the first.
pub fn edges(corners: &[Point2<f64>]) -> impl Iterator<Item = Edge> + '_ {
    corners
        .iter()
        .zip(corners.iter().cycle().skip(1))
        .map(|(a, b)| Edge { a: *a, b: *b })
}

/// Twice the signed area of a polygon, m²: positive when its corners run counter-clockwise.
#[must_use]
pub fn doubled_area(corners: &[Point2<f64>]) -> f64 {
    edges(corners).map(|edge| cross(edge.a.coords, edge.b.coords)).sum()
}

/// Whether a polygon turns left at every corner and makes exactly one full turn, with its corners counter-clockwise.
#[must_use]
pub fn is_convex(corners: &[Point2<f64>]) -> bool {
    let following = corners.iter().cycle().skip(2);
    let mut turned = 0.0;
    let turns_left = edges(corners).zip(following).all(|(edge, next)| {
        let (along, on) = (edge.b - edge.a, next - edge.b);
        turned += cross(along, on).atan2(along.dot(&on));
        cross(along, on) > 0.0
    });
    // A pentagram turns twice.
    turns_left && turned < 3.0 * PI
}

/// A convex outline with every edge moved outwards by a distance, m; a negative distance moves inwards. Corners stay sharp, so the grown
/// outline contains the rounded one.
#[must_use]
pub fn offset(corners: &[Point2<f64>], by: f64) -> Vec<Point2<f64>> {
    let count = corners.len();
    let outward = |a: Point2<f64>, b: Point2<f64>| {
        let along = (b - a).normalize();
        Vector2::new(along.y, -along.x)
    };
    (0..count)
        .map(|i| {
            let (before, here, after) = (corners[(i + count - 1) % count], corners[i], corners[(i + 1) % count]);
            let (n, m) = (outward(before, here), outward(here, after));
            let sum = n + m;
            here + sum * (2.0 * by / sum.norm_squared())
        })
        .collect()
}

/// Whether a point lies inside a polygon (crossing number; points on the boundary may count as either).
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::polygon::contains;
///
/// // An L, 2 m by 2 m without its upper right quarter.
/// let corners = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)].map(|(x, y)| Point2::new(x, y));
/// assert!(contains(&corners, Point2::new(0.5, 1.5)) && !contains(&corners, Point2::new(1.5, 1.5)));
/// ```
#[must_use]
pub fn contains(corners: &[Point2<f64>], point: Point2<f64>) -> bool {
    crossings(edges(corners), point)
}

/// As [`contains`], for the edges of any number of polygons (even-odd rule).
pub fn crossings(edges: impl Iterator<Item = Edge>, point: Point2<f64>) -> bool {
    let crossed = edges.filter(|edge| {
        (edge.a.y > point.y) != (edge.b.y > point.y)
            && point.x < edge.a.x + (point.y - edge.a.y) / (edge.b.y - edge.a.y) * (edge.b.x - edge.a.x)
    });
    crossed.count() % 2 == 1
}

/// Whether two edges touch or cross.
#[must_use]
pub fn touch(p: Edge, q: Edge) -> bool {
    let side = |edge: Edge, point: Point2<f64>| cross(edge.b - edge.a, point - edge.a);
    let (pa, pb, qa, qb) = (side(q, p.a), side(q, p.b), side(p, q.a), side(p, q.b));
    if pa * pb < 0.0 && qa * qb < 0.0 {
        return true;
    }
    let within = |edge: Edge, point: Point2<f64>| (edge.a - point).dot(&(edge.b - point)) <= 0.0;
    (pa == 0.0 && within(q, p.a))
        || (pb == 0.0 && within(q, p.b))
        || (qa == 0.0 && within(p, q.a))
        || (qb == 0.0 && within(p, q.b))
}

/// Why corners do not form a simple polygon.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum OutlineError {
    /// A corner is repeated.
    #[error("the corner ({}, {}) stands twice in a row", .0.x, .0.y)]
    Repeated(Point2<f64>),
    /// An edge runs straight back along the one before.
    #[error("the outline turns straight back at ({}, {})", .0.x, .0.y)]
    TurnsBack(Point2<f64>),
    /// Two edges that are not neighbours touch or cross.
    #[error("the outline meets itself between ({}, {}) and ({}, {})", .0.a.x, .0.a.y, .0.b.x, .0.b.y)]
    MeetsItself(Edge),
    /// All corners lie on a line, or there are fewer than three.
    #[error("the outline encloses no area")]
    NoArea,
}

/// Checks that corners form a simple polygon, and orders them counter-clockwise. Cost: quadratic in the number of corners.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::polygon::{OutlineError, doubled_area, simple};
///
/// let outline = |corners: [(f64, f64); 4]| simple(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
/// let square = outline([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)])?;
/// assert_eq!(doubled_area(&square), 2.0, "now counter-clockwise");
/// let bow_tie = outline([(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]);
/// assert!(matches!(bow_tie, Err(OutlineError::MeetsItself(_))));
/// # Ok::<(), OutlineError>(())
/// ```
///
/// # Errors
/// [`OutlineError`].
pub fn simple(mut corners: Vec<Point2<f64>>) -> Result<Vec<Point2<f64>>, OutlineError> {
    let edges: Vec<Edge> = edges(&corners).collect();
    if let Some(edge) = edges.iter().find(|edge| edge.a == edge.b) {
        return Err(OutlineError::Repeated(edge.a));
    }
    for (i, edge) in edges.iter().enumerate() {
        // Neighbouring edges share a corner; only turning straight back is an error.
        let next = edges[(i + 1) % edges.len()];
        let (along, on) = (edge.b - edge.a, next.b - next.a);
        if cross(along, on) == 0.0 && along.dot(&on) < 0.0 {
            return Err(OutlineError::TurnsBack(edge.b));
        }
        let others = edges
            .iter()
            .enumerate()
            .skip(i + 2)
            .filter(|(j, _)| i != 0 || j + 1 != edges.len());
        for (_, other) in others {
            if touch(*edge, *other) {
                return Err(OutlineError::MeetsItself(*edge));
            }
        }
    }
    let area = doubled_area(&corners);
    if area.is_nan() || area.abs() <= 1e-12 {
        return Err(OutlineError::NoArea);
    }
    if area < 0.0 {
        corners.reverse();
    }
    Ok(corners)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(corners: &[(f64, f64)]) -> Vec<Point2<f64>> {
        corners.iter().map(|(x, y)| Point2::new(*x, *y)).collect()
    }

    #[test]
    fn edges_that_cross_or_meet_touch() {
        let edge = |ax, ay, bx, by| Edge {
            a: Point2::new(ax, ay),
            b: Point2::new(bx, by),
        };
        assert!(touch(edge(0.0, 0.0, 2.0, 2.0), edge(0.0, 2.0, 2.0, 0.0)));
        assert!(touch(edge(0.0, 0.0, 2.0, 0.0), edge(1.0, 0.0, 1.0, 1.0)));
        assert!(!touch(edge(0.0, 0.0, 1.0, 0.0), edge(2.0, 0.0, 3.0, 0.0)));
        assert!(!touch(edge(0.0, 0.0, 1.0, 0.0), edge(0.0, 0.1, 1.0, 0.1)));
    }

    #[test]
    fn only_an_outline_that_does_not_meet_itself_is_simple() {
        let square = points(&[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]);
        let clockwise: Vec<_> = square.iter().rev().copied().collect();
        assert!(doubled_area(&simple(clockwise).unwrap_or_default()) > 0.0);
        assert_eq!(simple(square.clone()), Ok(square));
        let bow = simple(points(&[(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]));
        assert!(matches!(bow, Err(OutlineError::MeetsItself(_))));
        let pinched = simple(points(&[
            (0.0, 0.0),
            (2.0, 0.0),
            (1.0, 1.0),
            (2.0, 2.0),
            (0.0, 2.0),
            (1.0, 1.0),
        ]));
        assert!(matches!(pinched, Err(OutlineError::MeetsItself(_))));
        assert!(matches!(
            simple(points(&[(0.0, 0.0), (1.0, 0.0)])),
            Err(OutlineError::TurnsBack(_))
        ));
        assert!(matches!(
            simple(points(&[(0.0, 0.0), (0.0, 0.0), (1.0, 1.0)])),
            Err(OutlineError::Repeated(_))
        ));
        assert_eq!(simple(Vec::new()), Err(OutlineError::NoArea));
        assert!(simple(points(&[(0.0, 0.0), (f64::NAN, 0.0), (1.0, 1.0)])).is_err());
    }
}
