//! Corridor. A chain of overlapping convex polygons around a path, each free for the robot's centre.
//!
//! Around a straight piece of the path every nearby obstacle is cut off by a line at right angles to the shortest connection between the
//! two, the nearest obstacle first; obstacles that are already cut off need no line of their own. A line keeps the extent of the robot
//! towards it (a disc: its radius; a polygon: its extent with headings near the piece's) plus a clearance, but no more than half of the
//! room that the piece itself has: the other half is for the curve. A polygon is convex, so a curve whose control points lie inside does
//! not leave it, also between samples.
//!
//! Source: Liu, Watterson, Mohta, Sun, Bhattacharya, Taylor and Kumar, "Planning Dynamically Feasible Trajectories for Quadrotors Using
//! Safe Flight Corridors in 3-D Complex Environments", RA-L 2017; with squares in place of points, and without the ellipsoid.

use std::f64::consts::{FRAC_PI_2, SQRT_2};

use nalgebra::{Point2, Rotation2, Vector2};
use zenav_protocol::polygon::Edge;
use zenav_protocol::robot::Footprint;

use super::settings::CorridorSettings;
use super::shortcut::HAIR;
use zenav_space::{ConfigurationSpace, UnknownPolicy};

/// `normal · p <= offset`, with a normal of length one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfPlane {
    /// Outward normal.
    pub normal: Vector2<f64>,
    /// Offset, m.
    pub offset: f64,
}

impl HalfPlane {
    /// How far inside a point is, m; negative outside.
    ///
    /// ```
    /// use nalgebra::{Point2, Vector2};
    /// use zenav_smoothing::HalfPlane;
    ///
    /// let left_of_two = HalfPlane { normal: Vector2::x(), offset: 2.0 };
    /// assert_eq!(left_of_two.depth(Point2::new(1.5, 7.0)), 0.5);
    /// assert_eq!(left_of_two.depth(Point2::new(2.5, 7.0)), -0.5);
    /// ```
    #[must_use]
    pub fn depth(&self, point: Point2<f64>) -> f64 {
        self.offset - self.normal.dot(&point.coords)
    }

    fn through(point: Point2<f64>, normal: Vector2<f64>) -> Self {
        let offset = normal.dot(&point.coords);
        Self { normal, offset }
    }
}

/// A convex free polygon, and the piece of the path that runs through it.
#[derive(Clone, Debug, PartialEq)]
pub struct FreePolygon {
    /// Half planes whose intersection it is.
    pub sides: Vec<HalfPlane>,
    /// Where the path enters, m.
    pub from: Point2<f64>,
    /// Where it leaves, m.
    pub to: Point2<f64>,
    /// Length of the path between, m.
    pub length: f64,
}

impl FreePolygon {
    /// Whether a point lies inside, to within `tolerance` metres.
    ///
    /// ```
    /// use nalgebra::{Point2, Vector2};
    /// use zenav_smoothing::{FreePolygon, HalfPlane};
    ///
    /// // A square of 2 m around the origin.
    /// let side = |x, y| HalfPlane { normal: Vector2::new(x, y), offset: 1.0 };
    /// let square = FreePolygon {
    ///     sides: vec![side(1.0, 0.0), side(-1.0, 0.0), side(0.0, 1.0), side(0.0, -1.0)],
    ///     from: Point2::new(-1.0, 0.0),
    ///     to: Point2::new(1.0, 0.0),
    ///     length: 2.0,
    /// };
    /// assert!(square.holds(Point2::new(0.9, -0.9), 0.0) && !square.holds(Point2::new(1.1, 0.0), 0.0));
    /// assert!(square.holds(Point2::new(1.1, 0.0), 0.2));
    /// ```
    #[must_use]
    pub fn holds(&self, point: Point2<f64>, tolerance: f64) -> bool {
        self.sides.iter().all(|side| side.depth(point) >= -tolerance)
    }

    /// Heading of the path through it, rad.
    #[must_use]
    pub fn heading(&self) -> f64 {
        let along = self.to - self.from;
        along.y.atan2(along.x)
    }

    /// Its corners, counter-clockwise, m; none without an area.
    ///
    /// ```
    /// use nalgebra::{Point2, Vector2};
    /// use zenav_smoothing::{FreePolygon, HalfPlane};
    ///
    /// // A square of 2 m around the origin.
    /// let side = |x, y| HalfPlane { normal: Vector2::new(x, y), offset: 1.0 };
    /// let square = FreePolygon {
    ///     sides: vec![side(1.0, 0.0), side(-1.0, 0.0), side(0.0, 1.0), side(0.0, -1.0)],
    ///     from: Point2::new(-1.0, 0.0),
    ///     to: Point2::new(1.0, 0.0),
    ///     length: 2.0,
    /// };
    /// let corners = square.corners();
    /// assert_eq!(corners.len(), 4);
    /// assert!(corners.iter().all(|corner| (corner.x.abs() - 1.0).abs() < 1e-9 && (corner.y.abs() - 1.0).abs() < 1e-9));
    /// ```
    #[must_use]
    pub fn corners(&self) -> Vec<Point2<f64>> {
        let around = frame_corners(self.from, self.to, FAR);
        let mut corners: Vec<_> = around.into_iter().map(|corner| (corner, 0)).collect();
        for side in &self.sides {
            corners = clipped(&corners, side, 0);
        }
        if corners.len() < 3 {
            return Vec::new();
        }
        corners.into_iter().map(|(corner, _)| corner).collect()
    }
}

/// No polygon reaches this far beyond its piece, m.
const FAR: f64 = 1000.0;

/// Share of the room beyond the robot's own extent that is kept clear.
const SHARE: f64 = 0.5;

/// How far a polygonal robot's heading may differ from the piece's, rad, before the curve is known.
pub const SPREAD: f64 = 0.1;

/// The polygons along a path (corner points, map frame), in order; neighbours share the point where the path passes from one to the next.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_smoothing::{CorridorSettings, corridor};
/// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
/// # use zenav_protocol::robot::Footprint;
/// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 100, height: 100 };
/// # let mut map = Grid::filled(spec, Occupancy::FREE);
/// map[Cell::new(50, 62)] = Occupancy::OCCUPIED; // 0.6 m beside the path
/// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.25), UnknownPolicy::Blocked, 0.0);
/// let path = [Point2::new(1.0, 2.5), Point2::new(4.0, 2.5)];
/// let polygons = corridor(&space, &path, &CorridorSettings::default());
/// assert!(polygons.iter().all(|polygon| polygon.holds(polygon.from, 0.0) && polygon.holds(polygon.to, 0.0)));
/// assert!(polygons.windows(2).all(|pair| pair[0].to == pair[1].from));
/// assert!(!polygons.iter().any(|polygon| polygon.holds(Point2::new(2.525, 3.0), 0.0)), "the robot would collide there");
/// ```
#[must_use]
pub fn corridor(space: &ConfigurationSpace, path: &[Point2<f64>], size: &CorridorSettings) -> Vec<FreePolygon> {
    let points = split(path, size.length);
    let is_round = matches!(space.footprint(), Footprint::Radius(_));
    let mut polygons = Vec::new();
    let mut at = 0;
    while at + 1 < points.len() {
        let mut polygon = free_polygon(space, points[at], points[at + 1], size, SPREAD);
        let along = points[at + 1] - points[at];
        at += 1;
        // Short pieces that fit into the same polygon are merged; a polygonal robot must keep its direction in all of them.
        while let Some(next) = points.get(at + 1) {
            let leg = next - points[at];
            let longer = polygon.length + leg.norm();
            if longer > size.length || !polygon.holds(*next, 0.0) || !(is_round || along.angle(&leg) < 0.5 * SPREAD) {
                break;
            }
            (polygon.to, polygon.length) = (*next, longer);
            at += 1;
        }
        polygons.push(polygon);
    }
    polygons
}

/// The path with points between its corners: pieces of at most `length` at the ends of a leg, where the path bends, and of twice that
/// between.
fn split(path: &[Point2<f64>], length: f64) -> Vec<Point2<f64>> {
    let mut points: Vec<Point2<f64>> = path.first().copied().into_iter().collect();
    for pair in path.windows(2) {
        let leg = pair[1] - pair[0];
        // In units of `length`.
        let total = leg.norm() / length;
        if total > 1.0 {
            let end = (total / 3.0).min(1.0);
            let middle = total - 2.0 * end;
            let pieces = if total <= 2.0 {
                0
            } else {
                (middle / 2.0).ceil().clamp(1.0, 1e5) as usize
            };
            if pieces == 0 {
                points.push(pair[0] + leg * 0.5);
            } else {
                let share = |i: usize| (end + middle * i as f64 / pieces as f64) / total;
                points.extend((0..=pieces).map(|i| pair[0] + leg * share(i)));
            }
        }
        points.push(pair[1]);
    }
    points
}

/// Extent of the robot from its base, m, with headings near a piece's.
enum Shape {
    Disc(f64),
    /// Each corner's distance, and its position at the lowest and at the highest heading.
    Polygon(Vec<(f64, Vector2<f64>, Vector2<f64>)>),
}

impl Shape {
    fn new(space: &ConfigurationSpace, along: Vector2<f64>, spread: f64) -> Self {
        match space.footprint() {
            Footprint::Polygon(corners) if spread < FRAC_PI_2 && along.norm_squared() > 0.0 => {
                let yaw = along.y.atan2(along.x);
                let [low, high] = [yaw - spread, yaw + spread].map(Rotation2::new);
                let fan = |corner: &Point2<f64>| (corner.coords.norm(), low * corner.coords, high * corner.coords);
                Self::Polygon(corners.iter().map(fan).collect())
            }
            Footprint::Polygon(_) if spread >= FRAC_PI_2 => Self::Disc(space.footprint().circumscribed_radius()),
            footprint => Self::Disc(footprint.inscribed_radius()),
        }
    }

    /// Extent in a direction (unit vector).
    fn towards(&self, direction: Vector2<f64>) -> f64 {
        match self {
            Self::Disc(radius) => *radius,
            Self::Polygon(corners) => {
                let reach = |(radius, low, high): &(f64, Vector2<f64>, Vector2<f64>)| {
                    // Between these headings the corner passes through the direction itself.
                    if low.perp(&direction) >= 0.0 && direction.perp(high) >= 0.0 {
                        *radius
                    } else {
                        low.dot(&direction).max(high.dot(&direction))
                    }
                };
                corners.iter().map(reach).fold(0.0, f64::max)
            }
        }
    }

    fn most(&self) -> f64 {
        match self {
            Self::Disc(radius) => *radius,
            Self::Polygon(corners) => corners.iter().map(|corner| corner.0).fold(0.0, f64::max),
        }
    }
}

/// An obstacle's square near a piece of the path, m.
struct Square {
    center: Point2<f64>,
    /// An unknown cell: only the robot's centre must stay off.
    is_unknown: bool,
    /// Sort key: a lower bound of its distance beyond what is to be kept clear.
    slack: f64,
    connection: Option<Connection>,
}

/// The shortest connection from a piece to a square.
#[derive(Clone, Copy)]
struct Connection {
    /// Its end on the square, its direction, its length.
    nearest: Point2<f64>,
    outwards: Vector2<f64>,
    distance: f64,
    /// Distance to be kept clear: at least, and wanted.
    least: f64,
    wanted: f64,
}

/// The polygon around a straight piece of a path. The heading of a polygonal robot may differ by `spread` (rad) from the piece's.
#[must_use]
pub fn free_polygon(
    space: &ConfigurationSpace,
    from: Point2<f64>,
    to: Point2<f64>,
    size: &CorridorSettings,
    spread: f64,
) -> FreePolygon {
    let piece = Edge { a: from, b: to };
    let shape = Shape::new(space, to - from, spread);
    let clearance = size.clearance.max(0.0);
    let mut sides = frame(space, from, to, size.reach);
    let half = 0.5 * space.spec().resolution;
    // Nothing beyond this affects the polygon.
    let wide = frame_corners(from, to, size.reach + shape.most() + HAIR + clearance);
    let mut squares = Vec::new();
    for is_unknown in [false, true] {
        if is_unknown && space.unknown_policy() != UnknownPolicy::Blocked {
            continue;
        }
        let kept = if is_unknown {
            HAIR
        } else {
            shape.most() + HAIR + clearance
        };
        space.outer_cells(&wide, is_unknown, |center| {
            squares.push(Square {
                center,
                is_unknown,
                slack: (center - piece.nearest(center)).norm() - half * SQRT_2 - kept,
                connection: None,
            });
        });
    }
    while let Some(first) = (0..squares.len()).min_by(|a, b| squares[*a].slack.total_cmp(&squares[*b].slack)) {
        let square = &mut squares[first];
        let Some(connection) = square.connection else {
            let connection = connect(piece, square, &shape, clearance, half);
            match connection {
                Some(found) => (square.slack, square.connection) = (found.distance - found.wanted, connection),
                // No line separates the piece from a square that it touches, as when a robot leaves a place where it should not be.
                None => drop(squares.swap_remove(first)),
            }
            continue;
        };
        squares.swap_remove(first);
        let Connection {
            nearest,
            outwards,
            distance,
            least,
            wanted,
        } = connection;
        // The piece itself stays inside, however close it is.
        let kept = wanted.min(least + (distance - least) * SHARE).min(distance);
        let side = HalfPlane {
            normal: outwards,
            offset: outwards.dot(&nearest.coords) - kept,
        };
        let reach = shape.towards(outwards) + HAIR;
        squares.retain(|other| {
            let nearest_corner = outwards.dot(&other.center.coords) - half * (outwards.x.abs() + outwards.y.abs());
            let least = if other.is_unknown { HAIR } else { reach };
            nearest_corner < side.offset + least - 1e-9
        });
        sides.push(side);
    }
    FreePolygon {
        sides: needed(&sides, &frame_corners(from, to, size.reach)),
        from,
        to,
        length: (to - from).norm(),
    }
}

/// Corners of the rectangle around a piece, counter-clockwise, `reach` beyond it on all sides.
fn frame_corners(from: Point2<f64>, to: Point2<f64>, reach: f64) -> [Point2<f64>; 4] {
    let along = (to - from).try_normalize(0.0).unwrap_or(Vector2::x()) * reach;
    let left = Vector2::new(-along.y, along.x);
    [
        to + along - left,
        to + along + left,
        from - along + left,
        from - along - left,
    ]
}

/// Its sides, each starting at a corner; then the map's borders, if the robot may not leave the map.
fn frame(space: &ConfigurationSpace, from: Point2<f64>, to: Point2<f64>, reach: f64) -> Vec<HalfPlane> {
    let along = (to - from).try_normalize(0.0).unwrap_or(Vector2::x());
    let left = Vector2::new(-along.y, along.x);
    let mut sides = vec![
        HalfPlane::through(to + along * reach, along),
        HalfPlane::through(from + left * reach, left),
        HalfPlane::through(from - along * reach, -along),
        HalfPlane::through(from - left * reach, -left),
    ];
    if space.unknown_policy() != UnknownPolicy::Free {
        let (low, high) = (space.spec().origin, space.spec().upper());
        sides.extend([
            HalfPlane::through(high, Vector2::x()),
            HalfPlane::through(high, Vector2::y()),
            HalfPlane::through(low, -Vector2::x()),
            HalfPlane::through(low, -Vector2::y()),
        ]);
    }
    sides
}

/// The shortest connection to a square; `None` if the piece touches it.
fn connect(piece: Edge, square: &Square, shape: &Shape, clearance: f64, half: f64) -> Option<Connection> {
    let (on_piece, nearest) = closest(piece, square.center, half);
    let apart = nearest - on_piece;
    let distance = apart.norm();
    if distance <= 1e-9 {
        return None;
    }
    let outwards = apart / distance;
    let least = if square.is_unknown {
        HAIR
    } else {
        shape.towards(outwards) + HAIR
    };
    Some(Connection {
        nearest,
        outwards,
        distance,
        least,
        wanted: if square.is_unknown { least } else { least + clearance },
    })
}

/// The nearest pair of points of a segment and a square.
fn closest(piece: Edge, center: Point2<f64>, half: f64) -> (Point2<f64>, Point2<f64>) {
    let clamp = |p: Point2<f64>| {
        Point2::new(
            p.x.clamp(center.x - half, center.x + half),
            p.y.clamp(center.y - half, center.y + half),
        )
    };
    let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|(x, y)| center + Vector2::new(x, y) * half);
    let ends = [piece.a, piece.b].map(|p| (p, clamp(p)));
    let pairs = corners.map(|q| (piece.nearest(q), q));
    let distance = |pair: &(Point2<f64>, Point2<f64>)| (pair.1 - pair.0).norm_squared();
    let mut best = ends[0];
    for pair in ends[1..].iter().chain(&pairs) {
        if distance(pair) < distance(&best) {
            best = *pair;
        }
    }
    best
}

/// The half planes that contribute an edge to their intersection; the first four are those of the rectangle with the corners `frame`.
fn needed(sides: &[HalfPlane], frame: &[Point2<f64>; 4]) -> Vec<HalfPlane> {
    // Each corner carries the side of the edge that leaves it, counter-clockwise.
    let mut corners: Vec<(Point2<f64>, usize)> = frame.iter().copied().zip(0..4).collect();
    for (index, side) in sides.iter().enumerate().skip(4) {
        corners = clipped(&corners, side, index);
    }
    if corners.len() < 3 {
        // No area, for example where obstacles touch the path on both sides: nothing can be left out.
        return sides.to_vec();
    }
    let mut kept: Vec<usize> = corners.into_iter().map(|(_, edge)| edge).collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|index| sides[index]).collect()
}

/// The part of a convex polygon inside a half plane. Each corner, counter-clockwise, carries the number of the edge that leaves it; the new
/// edge gets `index`.
fn clipped(corners: &[(Point2<f64>, usize)], side: &HalfPlane, index: usize) -> Vec<(Point2<f64>, usize)> {
    let mut clipped = Vec::with_capacity(corners.len() + 1);
    for (i, (corner, edge)) in corners.iter().enumerate() {
        let (next, _) = corners[(i + 1) % corners.len()];
        let (here, there) = (side.depth(*corner), side.depth(next));
        let crossing = || corner + (next - corner) * (here / (here - there));
        match (here >= 0.0, there >= 0.0) {
            (true, true) => clipped.push((*corner, *edge)),
            (true, false) => clipped.extend([(*corner, *edge), (crossing(), index)]),
            (false, true) => clipped.push((crossing(), *edge)),
            (false, false) => {}
        }
    }
    clipped
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use zenav_protocol::grid::{GridSpec, Occupancy};
    use zenav_protocol::robot::Footprint;

    const SIZE: CorridorSettings = CorridorSettings {
        length: 2.0,
        reach: 1.0,
        clearance: 0.2,
    };
    const RADIUS: f64 = 0.25;

    fn space(occupied: &[(u32, u32)], unknown: &[(u32, u32)]) -> ConfigurationSpace {
        let spec = GridSpec {
            origin: Point2::new(-1.0, 0.5),
            resolution: 0.1,
            width: 70,
            height: 60,
        };
        let marks = [(occupied, Occupancy::OCCUPIED), (unknown, Occupancy::UNKNOWN)];
        let marks = marks.map(|(cells, value)| cells.iter().map(move |(x, y)| (*x, *y, value)));
        let grid = zenav_fixtures::map_with(spec, &marks.into_iter().flatten().collect::<Vec<_>>());
        ConfigurationSpace::new(&grid, &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0)
    }

    #[test]
    fn without_obstacles_a_room_is_a_rectangle_inside_the_map() {
        let polygons = corridor(&space(&[], &[]), &[Point2::new(0.0, 1.0), Point2::new(1.0, 1.0)], &SIZE);
        assert_eq!(polygons.len(), 1);
        assert_eq!(polygons[0].sides.len(), 4);
        assert!(polygons[0].holds(Point2::new(1.9, 0.6), 0.0) && !polygons[0].holds(Point2::new(0.5, 0.4), 0.0));
    }

    #[test]
    fn a_long_leg_becomes_several_rooms_and_short_ones_share_one() {
        let long = corridor(&space(&[], &[]), &[Point2::new(0.0, 1.0), Point2::new(6.0, 1.0)], &SIZE);
        assert_eq!(long.len(), 3);
        let halved = corridor(&space(&[], &[]), &[Point2::new(0.0, 1.0), Point2::new(3.0, 1.0)], &SIZE);
        assert_eq!(halved.len(), 2);
        assert!(long.windows(2).all(|pair| pair[0].to == pair[1].from));
        let short: Vec<_> = (0..10)
            .map(|i| Point2::new(1.0 + 0.1 * f64::from(i), 2.0 + 0.02 * f64::from(i % 2)))
            .collect();
        assert_eq!(corridor(&space(&[], &[]), &short, &SIZE).len(), 1);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn a_room_holds_its_piece_and_no_place_where_the_robot_collides(
            occupied in prop::collection::vec((0_u32..70, 0_u32..60), 0..60), unknown in prop::collection::vec((0_u32..70, 0_u32..60), 0..20),
            a in (-1.0..6.0_f64, 0.5..6.5_f64), path in (-2.0..2.0_f64, -2.0..2.0_f64), inside in prop::collection::vec((0.0..1.0_f64, 0.0..1.0_f64), 200),
        ) {
            let space = space(&occupied, &unknown);
            let (a, b) = (Point2::new(a.0, a.1), Point2::new(a.0 + path.0, a.1 + path.1));
            prop_assume!(super::super::shortcut::is_clear(&space, a, b, RADIUS + HAIR));
            for polygon in corridor(&space, &[a, b], &SIZE) {
                prop_assert!(polygon.holds(polygon.from, 1e-9) && polygon.holds(polygon.to, 1e-9));
                let corners = polygon.corners();
                prop_assert!(corners.iter().all(|corner| polygon.holds(*corner, 1e-9)), "{corners:?}");
                let depth = |point: Point2<f64>| polygon.sides.iter().map(|side| side.depth(point)).fold(f64::INFINITY, f64::min);
                for (x, y) in &inside {
                    let point = Point2::new(a.x.min(b.x) - 1.2 + x * (path.0.abs() + 2.4), a.y.min(b.y) - 1.2 + y * (path.1.abs() + 2.4));
                    if depth(point).abs() > 1e-6 {
                        prop_assert_eq!(zenav_protocol::polygon::contains(&corners, point), depth(point) > 0.0, "{}", point);
                    }
                    if polygon.holds(point, 0.0) {
                        prop_assert!(space.clearance(point) > RADIUS && space.is_permitted(point), "{point}");
                    }
                }
            }
        }
    }
}
