//! How much room is there around a way? A chain of overlapping convex polygons, each free for the robot's centre.
//!
//! Around a straight piece of the way every obstacle nearby is cut off by a line at right angles to the shortest connection between the
//! two, the nearest obstacle first; obstacles that a line has cut off already need none of their own. A line keeps the robot's radius, and
//! on top of it a comfortable distance, but no more than half of what the piece itself has: the other half is for the curve. A polygon is convex, so that a curve whose control points lie
//! inside does not leave it: free between samples too.
//!
//! Source: Liu, Watterson, Mohta, Sun, Bhattacharya, Taylor and Kumar, "Planning Dynamically Feasible Trajectories for Quadrotors Using
//! Safe Flight Corridors in 3-D Complex Environments", RA-L 2017; with squares in place of points, and without the ellipsoid.

use nalgebra::{Point2, Vector2};
use zenav_protocol::grid::Cell;

use super::shortcut::HAIR;
use crate::space::{BitGrid, ConfigurationSpace, UnknownPolicy};

/// `normal · p <= offset`, with a normal of length one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfPlane {
    /// Outwards.
    pub normal: Vector2<f64>,
    /// m.
    pub offset: f64,
}

impl HalfPlane {
    /// How far inside a point is, m; negative outside.
    #[must_use]
    pub fn depth(&self, point: Point2<f64>) -> f64 {
        self.offset - self.normal.dot(&point.coords)
    }
}

/// A convex free polygon, and the piece of the way that runs through it.
#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// Its sides.
    pub sides: Vec<HalfPlane>,
    /// Where the way enters, m.
    pub from: Point2<f64>,
    /// Where it leaves, m.
    pub to: Point2<f64>,
    /// Length of the way between, m.
    pub length: f64,
}

impl Room {
    /// Whether a point lies inside, to within `tolerance` metres.
    #[must_use]
    pub fn holds(&self, point: Point2<f64>, tolerance: f64) -> bool {
        self.sides.iter().all(|side| side.depth(point) >= -tolerance)
    }
}

/// Share of what a piece has beyond the radius that is kept clear.
const SHARE: f64 = 0.5;

/// How large a room may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoomSize {
    /// Longest piece of the way in one room, m.
    pub length: f64,
    /// How far a room may reach beyond its piece, m.
    pub reach: f64,
    /// Distance to obstacles beyond the robot's radius, m, where the way has it.
    pub comfort: f64,
}

/// The rooms along a way (corner points, map frame), in order; neighbours share the point where the way goes from one to the next.
#[must_use]
pub fn corridor(space: &ConfigurationSpace, way: &[Point2<f64>], size: &RoomSize) -> Vec<Room> {
    let points = split(way, size.length);
    let mut rooms = Vec::new();
    let mut at = 0;
    while at + 1 < points.len() {
        let mut room = room_around(space, points[at], points[at + 1], size);
        at += 1;
        // Short pieces that fit into the same room make one piece.
        while let Some(next) = points.get(at + 1) {
            let longer = room.length + (next - points[at]).norm();
            if longer > size.length || !room.holds(*next, 0.0) {
                break;
            }
            (room.to, room.length) = (*next, longer);
            at += 1;
        }
        rooms.push(room);
    }
    rooms
}

/// The way with points between its corners, so that no leg is longer than `length`.
fn split(way: &[Point2<f64>], length: f64) -> Vec<Point2<f64>> {
    let mut points: Vec<Point2<f64>> = way.first().copied().into_iter().collect();
    for pair in way.windows(2) {
        let leg = pair[1] - pair[0];
        let pieces = (leg.norm() / length).ceil().clamp(1.0, 1e5) as usize;
        points.extend((1..pieces).map(|i| pair[0] + leg * (i as f64 / pieces as f64)));
        points.push(pair[1]);
    }
    points
}

fn room_around(space: &ConfigurationSpace, from: Point2<f64>, to: Point2<f64>, size: &RoomSize) -> Room {
    let spec = space.spec();
    let (mut low, mut high) = (
        from.inf(&to) - Vector2::repeat(size.reach),
        from.sup(&to) + Vector2::repeat(size.reach),
    );
    if space.unknown_policy() != UnknownPolicy::Free {
        (low, high) = (low.sup(&spec.origin), high.inf(&spec.upper()));
    }
    let side = |x: f64, y: f64, offset: f64| HalfPlane {
        normal: Vector2::new(x, y),
        offset,
    };
    let mut sides = vec![
        side(1.0, 0.0, high.x),
        side(0.0, 1.0, high.y),
        side(-1.0, 0.0, -low.x),
        side(0.0, -1.0, -low.y),
    ];
    let radius = space.radius() + HAIR;
    let mut squares = Vec::new();
    gather(
        space,
        space.obstacles(),
        (from, to),
        (low, high),
        [radius, radius + size.comfort.max(0.0)],
        &mut squares,
    );
    if space.unknown_policy() == UnknownPolicy::Blocked {
        // The centre alone stays off these.
        gather(
            space,
            space.forbidden(),
            (from, to),
            (low, high),
            [HAIR, HAIR],
            &mut squares,
        );
    }
    let half = 0.5 * spec.resolution;
    while let Some(closest) = (0..squares.len()).min_by(|a, b| squares[*a].slack().total_cmp(&squares[*b].slack())) {
        let Square {
            nearest,
            outwards,
            distance,
            least,
            wanted,
            ..
        } = squares.swap_remove(closest);
        // The piece itself stays inside, however close it is.
        let kept = wanted.min(least + (distance - least) * SHARE).min(distance);
        let side = HalfPlane {
            normal: outwards,
            offset: outwards.dot(&nearest.coords) - kept,
        };
        squares.retain(|other| {
            let nearest_corner = outwards.dot(&other.center.coords) - half * (outwards.x.abs() + outwards.y.abs());
            nearest_corner < side.offset + other.least - 1e-9
        });
        sides.push(side);
    }
    Room {
        sides: needed(&sides),
        from,
        to,
        length: (to - from).norm(),
    }
}

/// An obstacle's square near a piece of the way, m.
struct Square {
    center: Point2<f64>,
    /// What is to be kept clear around it: at least, and better.
    least: f64,
    wanted: f64,
    /// Its point nearest to the piece, the direction from the piece to it, and their distance.
    nearest: Point2<f64>,
    outwards: Vector2<f64>,
    distance: f64,
}

impl Square {
    fn slack(&self) -> f64 {
        self.distance - self.wanted
    }
}

/// Collects the squares of set cells that a room from `low` to `high` may come nearer to than `wanted`; only those with an unset
/// neighbour, since whatever would come near another one comes near these first.
fn gather(
    space: &ConfigurationSpace,
    bits: &BitGrid,
    piece: (Point2<f64>, Point2<f64>),
    (low, high): (Point2<f64>, Point2<f64>),
    [least, wanted]: [f64; 2],
    squares: &mut Vec<Square>,
) {
    let spec = space.spec();
    let margin = Vector2::repeat(wanted);
    let (Some(first), Some(last)) = (spec.clamped_cell(low - margin), spec.clamped_cell(high + margin)) else {
        return;
    };
    let half = 0.5 * spec.resolution;
    for y in first.y..=last.y {
        let row = bits.row(y);
        let other = |y: Option<u32>, word: usize| y.filter(|y| *y < spec.height).map_or(0, |y| bits.row(y)[word]);
        for (word, here) in row
            .iter()
            .copied()
            .enumerate()
            .take(last.x as usize / 64 + 1)
            .skip(first.x as usize / 64)
        {
            // At a word's ends neighbours count as unset: a few squares too many.
            let mut border = here & !(here << 1 & here >> 1 & other(y.checked_sub(1), word) & other(Some(y + 1), word));
            while border != 0 {
                let x = word as u32 * 64 + border.trailing_zeros();
                border &= border - 1;
                if x < first.x || x > last.x {
                    continue;
                }
                let center = spec.center(Cell::new(x, y));
                let (on_piece, nearest) = closest(piece, center, half);
                let apart = nearest - on_piece;
                let distance = apart.norm();
                // No line parts the piece from a square that it touches: a robot that leaves a place where it should not be does that.
                if distance > 1e-9 {
                    squares.push(Square {
                        center,
                        least,
                        wanted,
                        nearest,
                        outwards: apart / distance,
                        distance,
                    });
                }
            }
        }
    }
}

/// The nearest pair of points of a segment and a square.
fn closest((a, b): (Point2<f64>, Point2<f64>), center: Point2<f64>, half: f64) -> (Point2<f64>, Point2<f64>) {
    let clamp = |p: Point2<f64>| {
        Point2::new(
            p.x.clamp(center.x - half, center.x + half),
            p.y.clamp(center.y - half, center.y + half),
        )
    };
    let along = b - a;
    let squared = along.norm_squared();
    let on_segment = |q: Point2<f64>| {
        if squared > 0.0 {
            a + along * ((q - a).dot(&along) / squared).clamp(0.0, 1.0)
        } else {
            a
        }
    };
    let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|(x, y)| center + Vector2::new(x, y) * half);
    let ends = [a, b].map(|p| (p, clamp(p)));
    let pairs = corners.map(|q| (on_segment(q), q));
    let distance = |pair: &(Point2<f64>, Point2<f64>)| (pair.1 - pair.0).norm_squared();
    let mut best = ends[0];
    for pair in ends[1..].iter().chain(&pairs) {
        if distance(pair) < distance(&best) {
            best = *pair;
        }
    }
    best
}

/// The half planes that make an edge of their common polygon.
fn needed(sides: &[HalfPlane]) -> Vec<HalfPlane> {
    // The first four are a rectangle.
    let mut corners: Vec<(Point2<f64>, usize)> = match sides {
        [right, top, left, bottom, ..] => vec![
            (Point2::new(right.offset, -bottom.offset), 0),
            (Point2::new(right.offset, top.offset), 1),
            (Point2::new(-left.offset, top.offset), 2),
            (Point2::new(-left.offset, -bottom.offset), 3),
        ],
        _ => return sides.to_vec(),
    };
    // Each corner carries the side of the edge that leaves it, counter-clockwise.
    for (index, side) in sides.iter().enumerate().skip(4) {
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
        corners = clipped;
    }
    if corners.len() < 3 {
        // No area, as where the way itself touches on both sides: nothing can be left out.
        return sides.to_vec();
    }
    let mut kept: Vec<usize> = corners.into_iter().map(|(_, edge)| edge).collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|index| sides[index]).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
    use zenav_protocol::robot::Footprint;

    const SIZE: RoomSize = RoomSize {
        length: 2.0,
        reach: 1.0,
        comfort: 0.2,
    };
    const RADIUS: f64 = 0.25;

    fn space(occupied: &[(u32, u32)], unknown: &[(u32, u32)]) -> ConfigurationSpace {
        let spec = GridSpec {
            origin: Point2::new(-1.0, 0.5),
            resolution: 0.1,
            width: 70,
            height: 60,
        };
        let mut grid = Grid::filled(spec, Occupancy::FREE);
        for (cells, value) in [(occupied, Occupancy::OCCUPIED), (unknown, Occupancy::UNKNOWN)] {
            for (x, y) in cells {
                grid[Cell::new(*x, *y)] = value;
            }
        }
        ConfigurationSpace::new(&grid, &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0)
    }

    #[test]
    fn without_obstacles_a_room_is_a_rectangle_inside_the_map() {
        let rooms = corridor(&space(&[], &[]), &[Point2::new(0.0, 1.0), Point2::new(1.0, 1.0)], &SIZE);
        assert_eq!(rooms.len(), 1);
        assert_eq!(rooms[0].sides.len(), 4);
        assert!(rooms[0].holds(Point2::new(1.9, 0.6), 0.0) && !rooms[0].holds(Point2::new(0.5, 0.4), 0.0));
    }

    #[test]
    fn a_long_leg_becomes_several_rooms_and_short_ones_share_one() {
        let long = corridor(&space(&[], &[]), &[Point2::new(0.0, 1.0), Point2::new(5.0, 1.0)], &SIZE);
        assert_eq!(long.len(), 3);
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
            a in (-1.0..6.0_f64, 0.5..6.5_f64), way in (-2.0..2.0_f64, -2.0..2.0_f64), inside in prop::collection::vec((0.0..1.0_f64, 0.0..1.0_f64), 200),
        ) {
            let space = space(&occupied, &unknown);
            let (a, b) = (Point2::new(a.0, a.1), Point2::new(a.0 + way.0, a.1 + way.1));
            prop_assume!(super::super::shortcut::is_clear(&space, a, b, RADIUS + HAIR));
            for room in corridor(&space, &[a, b], &SIZE) {
                prop_assert!(room.holds(room.from, 1e-9) && room.holds(room.to, 1e-9));
                for (x, y) in &inside {
                    let point = Point2::new(a.x.min(b.x) - 1.2 + x * (way.0.abs() + 2.4), a.y.min(b.y) - 1.2 + y * (way.1.abs() + 2.4));
                    if room.holds(point, 0.0) {
                        prop_assert!(space.clearance(point) > RADIUS && space.is_permitted(point), "{point}");
                    }
                }
            }
        }
    }
}
