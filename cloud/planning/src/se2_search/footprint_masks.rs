//! Footprint masks. Whether the footprint fits at a place, and can step and turn there.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::Cell;
use zenav_protocol::robot::Footprint;

use zenav_space::{ConfigurationSpace, convex_hull, swept_corners};

/// Steps along the headings, in places, counter-clockwise.
pub(super) const STEPS: [(i64, i64); 16] = [
    (1, 0),
    (2, 1),
    (1, 1),
    (1, 2),
    (0, 1),
    (-1, 2),
    (-1, 1),
    (-2, 1),
    (-1, 0),
    (-2, -1),
    (-1, -1),
    (-1, -2),
    (0, -1),
    (1, -2),
    (1, -1),
    (2, -1),
];
/// Places are at most about this far apart, m, and at most this many to a cell's side (an odd number, so that one lies at its centre).
pub(super) const SPACING: f64 = 0.06;
pub(super) const MOST_PLACES: u32 = 9;
/// Number of convex outlines that cover the turn to the next heading.
pub(super) const PARTS_OF_TURN: u32 = 3;
/// Margin around the footprint, m: later rounding causes no contact.
pub(super) const MARGIN: f64 = 5e-4;
/// Corners of an outline that are moved without an allocation.
const FEW: usize = 64;
/// Heading of a step, rad.
pub(super) fn yaw_of(heading: usize) -> f64 {
    let (x, y) = STEPS[heading];
    (y as f64).atan2(x as f64)
}

/// The footprint at every heading, and its sweeps by steps and turns. Lengths in cells.
pub(super) struct FootprintMasks<'a> {
    pub(super) space: &'a ConfigurationSpace,
    /// Places per side of a cell, and their spacing.
    places: i64,
    pub(super) spacing: f64,
    pub(super) width: i64,
    height: i64,
    /// Areas swept by a step along each heading, and by a turn to the next one, relative to the place.
    steps: Vec<Vec<Point2<f64>>>,
    turns: Vec<[Vec<Point2<f64>>; PARTS_OF_TURN as usize]>,
    /// The footprint at each heading, relative to the place.
    standing: Vec<Vec<Point2<f64>>>,
    /// With this distance between the cell's centre and the nearest obstacle, m, no step or turn from the cell collides.
    room_to_turn: f64,
}

impl<'a> FootprintMasks<'a> {
    pub(super) fn new(space: &'a ConfigurationSpace) -> Option<Self> {
        let Footprint::Polygon(corners) = space.footprint() else {
            return None;
        };
        let spec = space.spec();
        let places = (spec.resolution / SPACING).ceil().clamp(1.0, f64::from(MOST_PLACES)) as u32 | 1;
        let spacing = 1.0 / f64::from(places);
        // Slightly larger on all sides than later checks require.
        let grown = 1.0 + 2.0 * MARGIN / space.footprint().inscribed_radius();
        let corners: Vec<_> = corners
            .iter()
            .map(|corner| *corner * (grown / spec.resolution))
            .collect();
        let at_rest = |yaw: f64| Pose2 { x: 0.0, y: 0.0, yaw };
        let step = |(i, (x, y)): (usize, &(i64, i64))| {
            let to = Point2::new(*x as f64, *y as f64) * spacing;
            convex_hull(&swept_corners(&corners, at_rest(yaw_of(i)), to))
        };
        let turn = |i: usize| {
            let (from, turn) = (yaw_of(i), wrap_angle(yaw_of((i + 1) % STEPS.len()) - yaw_of(i)));
            let part = turn / f64::from(PARTS_OF_TURN);
            // Between two outlines a corner moves on an arc, which stays inside the tangents at both ends.
            let bulge = 1.0 / (0.125 * part).cos();
            std::array::from_fn(|j| {
                let yaws = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| from + part * (j as f64 + share));
                let outlines = yaws.iter().flat_map(|yaw| {
                    let pose = at_rest(*yaw);
                    corners.iter().map(move |corner| pose.transform_point(*corner * bulge))
                });
                convex_hull(&outlines.collect::<Vec<_>>())
            })
        };
        let around = space.footprint().circumscribed_radius();
        Some(Self {
            space,
            places: i64::from(places),
            spacing,
            width: i64::from(spec.width) * i64::from(places),
            height: i64::from(spec.height) * i64::from(places),
            steps: STEPS.iter().enumerate().map(step).collect(),
            turns: (0..STEPS.len()).map(turn).collect(),
            standing: (0..STEPS.len())
                .map(|i| {
                    let pose = at_rest(yaw_of(i));
                    corners.iter().map(|corner| pose.transform_point(*corner)).collect()
                })
                .collect(),
            room_to_turn: around + (0.75 + 2.3 * spacing) * spec.resolution + MARGIN,
        })
    }

    /// The place of a point, cells.
    pub(super) fn nearest(&self, p: Point2<f64>) -> (i64, i64) {
        let place = |at: f64| (at * self.places as f64).floor() as i64;
        (place(p.x), place(p.y))
    }

    pub(super) fn point(&self, (x, y): (i64, i64)) -> Point2<f64> {
        Point2::new(x as f64 + 0.5, y as f64 + 0.5) * self.spacing
    }

    pub(super) fn cell(&self, (x, y): (i64, i64)) -> Cell {
        Cell::new((x / self.places) as u32, (y / self.places) as u32)
    }

    pub(super) fn contains(&self, (x, y): (i64, i64)) -> bool {
        (0..self.width).contains(&x) && (0..self.height).contains(&y)
    }

    pub(super) fn has_room_to_turn(&self, place: (i64, i64)) -> bool {
        self.space.field().distance(self.cell(place)) > self.room_to_turn
    }

    /// Whether an outline around a place touches no obstacle.
    pub(super) fn admits(&self, outline: &[Point2<f64>], p: Point2<f64>) -> bool {
        // Most outlines have few corners, and need no memory of their own.
        let (mut few, mut many) = ([Point2::origin(); FEW], Vec::new());
        let moved = match few.get_mut(..outline.len()) {
            Some(few) => few,
            None => {
                many.resize(outline.len(), Point2::origin());
                &mut many[..]
            }
        };
        for (to, corner) in moved.iter_mut().zip(outline) {
            *to = corner + p.coords;
        }
        self.space.is_clear_of(moved)
    }

    /// Whether the footprint fits somewhere in a cell, with any heading.
    pub(super) fn admits_cell(&self, cell: Cell) -> bool {
        let distance = self.space.field().distance(cell);
        let beside = 0.5 * std::f64::consts::SQRT_2 * self.space.spec().resolution;
        let footprint = self.space.footprint();
        if self.space.forbidden().get(cell) || distance + beside <= footprint.inscribed_radius() {
            return false;
        }
        let (x, y) = (i64::from(cell.x) * self.places, i64::from(cell.y) * self.places);
        let mut places = (0..self.places).flat_map(|dy| (0..self.places).map(move |dx| (x + dx, y + dy)));
        distance > footprint.circumscribed_radius() + MARGIN
            || places.any(|place| {
                self.standing
                    .iter()
                    .any(|outline| self.admits(outline, self.point(place)))
            })
    }

    pub(super) fn can_step(&self, place: (i64, i64), to: (i64, i64), heading: usize) -> bool {
        let spec = self.space.spec();
        let [a, b] = [place, to].map(|place| spec.from_cells(self.point(place)));
        self.space.is_permitted_between(a, b)
            && (self.has_room_to_turn(place) || self.admits(&self.steps[heading], self.point(place)))
    }

    /// Whether there is room to turn all the way round.
    pub(super) fn can_turn_round(&self, place: (i64, i64)) -> bool {
        (0..STEPS.len()).all(|heading| self.can_turn(place, heading))
    }

    /// Whether the footprint can turn from `heading` to the next one, or back.
    pub(super) fn can_turn(&self, place: (i64, i64), heading: usize) -> bool {
        self.has_room_to_turn(place)
            || self.turns[heading]
                .iter()
                .all(|part| self.admits(part, self.point(place)))
    }
}
