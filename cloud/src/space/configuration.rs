//! Which cells admit the robot, and how far is any point from an obstacle?

use nalgebra::Point2;
use thiserror::Error;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::robot::Footprint;

use super::bits::BitGrid;
use super::distance::{DistanceField, MAX_REACH, squared_distances};

/// What cells that nobody has seen mean for a robot. Everything outside the grid counts as unknown too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnknownPolicy {
    /// They are driven through like free ones.
    Free,
    /// The robot's centre stays off them; its body may reach over their border (as Nav2 with `allow_unknown: false`).
    #[default]
    Blocked,
    /// They are obstacles like occupied ones, and no part of the robot touches them.
    Obstacle,
}

/// The map has grown or moved: a space of it is to be built anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the map's grid is not the space's any more")]
pub struct GridChanged;

/// Distances are known at least this far, m, as far as the field's reach in cells allows.
const USUAL_REACH: f64 = 1.0;

/// The cells whose centre admits a robot, the distances that say so, and the obstacles themselves.
///
/// A cell is free here when a disc of the footprint's inscribed radius plus the margin fits at its centre with so much to
/// spare that it also fits everywhere on the straight step to each free neighbour, diagonals included: a path from centre
/// to centre is exactly collision-free for the disc. (The least distance to a convex obstacle on a step of length `l`
/// between two points at distance `d` is at least `sqrt(d^2 - l^2/4)`.) A point robot asks only for cells that are not occupied.
#[derive(Clone, Debug)]
pub struct ConfigurationSpace {
    pub(super) spec: GridSpec,
    pub(super) footprint: Footprint,
    pub(super) unknown_policy: UnknownPolicy,
    margin: f64,
    /// Occupied cells; under [`UnknownPolicy::Obstacle`] unknown ones as well.
    pub(super) obstacles: BitGrid,
    /// Under [`UnknownPolicy::Blocked`] the unknown cells, else empty.
    pub(super) forbidden: BitGrid,
    field: DistanceField,
    free: BitGrid,
    /// Squared half cells that a free cell's distance exceeds.
    threshold: i64,
}

impl ConfigurationSpace {
    /// Builds the space of a robot on a map.
    ///
    /// `margin` (m) is kept clear around the footprint's inscribed disc, on top of it; negative or non-finite counts as none.
    #[must_use]
    pub fn new(grid: &OccupancyGrid, footprint: &Footprint, unknown: UnknownPolicy, margin: f64) -> Self {
        let spec = *grid.spec();
        let margin = if margin.is_finite() { margin.max(0.0) } else { 0.0 };
        let radius = footprint.inscribed_radius() + margin;
        let reach =
            (radius.max(USUAL_REACH).max(footprint.circumscribed_radius() + margin) / spec.resolution).ceil() + 1.0;
        let (obstacles, forbidden) = (
            BitGrid::new(spec.width, spec.height),
            BitGrid::new(spec.width, spec.height),
        );
        let mut space = Self {
            spec,
            footprint: footprint.clone(),
            unknown_policy: unknown,
            margin,
            field: DistanceField::new(spec, &obstacles, (reach as u32).clamp(1, MAX_REACH)),
            free: obstacles.clone(),
            obstacles,
            forbidden,
            threshold: threshold(radius / spec.resolution),
        };
        space.read(grid, 0..spec.height, 0..space.obstacles.stride());
        space.field = DistanceField::new(spec, &space.obstacles, space.field.reach_cells());
        space.admit(0..space.obstacles.stride(), 0..spec.height);
        space
    }

    /// Reads occupancy values of a window of rows and words into the bitmaps; says whether anything changed.
    fn read(&mut self, grid: &OccupancyGrid, rows: std::ops::Range<u32>, words: std::ops::Range<usize>) -> bool {
        let width = self.spec.width as usize;
        let mut changed = false;
        for y in rows {
            let values = &grid.values()[y as usize * width..][..width];
            for word in words.clone() {
                let cells = &values[word * 64..width.min(word * 64 + 64)];
                let (mut occupied, mut unknown) = (0_u64, 0_u64);
                for (bit, value) in cells.iter().enumerate() {
                    let occupancy = Occupancy::of(*value);
                    occupied |= u64::from(occupancy == Occupancy::Occupied) << bit;
                    unknown |= u64::from(occupancy == Occupancy::Unknown) << bit;
                }
                let (obstacles, forbidden) = match self.unknown_policy {
                    UnknownPolicy::Free => (occupied, 0),
                    UnknownPolicy::Blocked => (occupied, unknown),
                    UnknownPolicy::Obstacle => (occupied | unknown, 0),
                };
                let old_obstacles = std::mem::replace(&mut self.obstacles.row_mut(y)[word], obstacles);
                let old_forbidden = std::mem::replace(&mut self.forbidden.row_mut(y)[word], forbidden);
                changed |= old_obstacles != obstacles || old_forbidden != forbidden;
            }
        }
        changed
    }

    /// Decides which cells of a window are free, from their distances.
    fn admit(&mut self, words: std::ops::Range<usize>, rows: std::ops::Range<u32>) {
        let width = self.spec.width as usize;
        // Beyond its reach the field tells nothing apart: a robot that is larger than that needs the whole transform.
        let reach = i64::from(self.field.reach_cells());
        let exact = (self.threshold >= 4 * reach * reach).then(|| squared_distances(&self.obstacles));
        let threshold = i16::try_from(self.threshold).unwrap_or(i16::MAX);
        let exact_threshold = u32::try_from(self.threshold).unwrap_or(u32::MAX - 1);
        for y in rows {
            for word in words.clone() {
                let columns = word * 64..width.min(word * 64 + 64);
                let mut bits = 0_u64;
                match &exact {
                    None => {
                        for (bit, squared) in self.field.row(y)[word * 64..][..64].iter().enumerate() {
                            bits |= u64::from(*squared > threshold) << bit;
                        }
                    }
                    Some(exact) => {
                        for (bit, squared) in exact[y as usize * width..][columns.clone()].iter().enumerate() {
                            bits |= u64::from(*squared > exact_threshold) << bit;
                        }
                    }
                }
                self.free.row_mut(y)[word] = bits & !self.forbidden.row(y)[word] & (u64::MAX >> (64 - columns.len()));
            }
        }
    }

    /// Takes over a rectangle of a map that has changed there (columns and rows of cells); the map's grid is still the same.
    /// The result equals a space that is built anew. Returns whether any obstacle changed.
    ///
    /// # Errors
    /// [`GridChanged`] when the map's grid is another one: build the space anew.
    pub fn update(
        &mut self,
        grid: &OccupancyGrid,
        columns: std::ops::Range<u32>,
        rows: std::ops::Range<u32>,
    ) -> Result<bool, GridChanged> {
        if *grid.spec() != self.spec {
            return Err(GridChanged);
        }
        let rows = rows.start.min(self.spec.height)..rows.end.min(self.spec.height);
        let words = columns.start as usize / 64..(columns.end as usize).div_ceil(64).min(self.obstacles.stride());
        if rows.is_empty() || words.is_empty() || !self.read(grid, rows.clone(), words.clone()) {
            return Ok(false);
        }
        // Whatever lies within reach of a change is told anew; the reach is less than a word.
        let reach = self.field.reach_cells();
        let rows = rows.start.saturating_sub(reach)..(rows.end + reach).min(self.spec.height);
        let words = words.start.saturating_sub(1)..(words.end + 1).min(self.obstacles.stride());
        self.field
            .refresh(&self.obstacles, words.clone(), rows.start as usize..rows.end as usize);
        if self.threshold >= i64::from(4 * reach * reach) {
            self.admit(0..self.obstacles.stride(), 0..self.spec.height);
        } else {
            self.admit(words, rows);
        }
        Ok(true)
    }

    /// The map's grid.
    #[must_use]
    pub fn spec(&self) -> &GridSpec {
        &self.spec
    }

    /// The footprint that the space is made for.
    #[must_use]
    pub fn footprint(&self) -> &Footprint {
        &self.footprint
    }

    /// What unknown cells mean here.
    #[must_use]
    pub fn unknown_policy(&self) -> UnknownPolicy {
        self.unknown_policy
    }

    /// Kept clear around the inscribed disc, m.
    #[must_use]
    pub fn margin(&self) -> f64 {
        self.margin
    }

    /// Radius that free cells are made for, m: the footprint's inscribed radius and the margin.
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.footprint.inscribed_radius() + self.margin
    }

    /// Free cells, one bit each.
    #[must_use]
    pub fn free(&self) -> &BitGrid {
        &self.free
    }

    /// Obstacles as they stand in the map, not inflated.
    #[must_use]
    pub fn obstacles(&self) -> &BitGrid {
        &self.obstacles
    }

    /// Cells that the robot's centre stays off under [`UnknownPolicy::Blocked`].
    #[must_use]
    pub fn forbidden(&self) -> &BitGrid {
        &self.forbidden
    }

    /// Distances of cell centres to the nearest obstacle.
    #[must_use]
    pub fn field(&self) -> &DistanceField {
        &self.field
    }

    /// Whether the robot fits at a cell's centre; `false` outside the grid.
    #[must_use]
    pub fn is_free(&self, cell: Cell) -> bool {
        self.free.get(cell)
    }

    /// Farthest distance that [`clearance`](Self::clearance) tells apart, m.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.field.reach()
    }

    /// Exact distance from any point, inside the grid or not, to the nearest obstacle's closed square, m; at most
    /// [`reach`](Self::reach), zero on an obstacle and for a non-finite point.
    ///
    /// Cost: two bit scans a row within that distance, some hundred nanoseconds.
    #[must_use]
    pub fn clearance(&self, point: Point2<f64>) -> f64 {
        let mut limit = self.reach();
        if let Some(cell) = self.spec.cell_at(point) {
            // Distances change at most as fast as one moves: the centre's bounds the point's.
            let bound = self.field.distance(cell) + (point - self.spec.center(cell)).norm();
            limit = limit.min(bound);
        }
        super::shapes::disc_clearance(&self.obstacles, &self.spec, point, limit)
    }

    /// The free cell centre nearest to a point, m; `None` when no cell is free or the point is not finite.
    #[must_use]
    pub fn nearest_free(&self, point: Point2<f64>) -> Option<Point2<f64>> {
        let p = self.spec.to_cells(point);
        let home = self
            .spec
            .clamped_cell(point)
            .filter(|_| p.x.is_finite() && p.y.is_finite())?;
        let mut nearest: Option<(f64, Cell)> = None;
        let height = i64::from(self.spec.height);
        for ring in 0..height {
            for y in [i64::from(home.y) - ring, i64::from(home.y) + ring] {
                let dy = (y as f64 + 0.5 - p.y).abs();
                if y < 0 || y >= height || nearest.is_some_and(|(least, _)| dy >= least) {
                    continue;
                }
                let (left, right) = (
                    self.free.previous_set(y as u32, 0, i64::from(home.x)),
                    self.free.next_set(y as u32, i64::from(home.x), i64::MAX),
                );
                for x in [left, right].into_iter().flatten() {
                    let distance = (f64::from(x) + 0.5 - p.x).hypot(dy);
                    if nearest.is_none_or(|(least, _)| distance < least) {
                        nearest = Some((distance, Cell::new(x, y as u32)));
                    }
                }
            }
            if nearest.is_some_and(|(least, _)| (ring as f64) - 1.0 > least + (i64::from(home.y) as f64 - p.y).abs()) {
                break;
            }
        }
        nearest.map(|(_, cell)| self.spec.center(cell))
    }
}

/// Squared half cells that the distance of a free cell's centre must exceed, for a radius in cells.
fn threshold(radius: f64) -> i64 {
    if radius <= 0.0 {
        return 0;
    }
    // `l` is a diagonal step: l^2/4 is half a cell squared. Rounding goes to the safe side.
    (4.0 * (radius * radius + 0.5) + 1e-9).floor() as i64
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn grid(width: u32, height: u32, marks: &[(u32, u32, i8)]) -> OccupancyGrid {
        let spec = GridSpec {
            origin: Point2::origin(),
            resolution: 0.1,
            width,
            height,
        };
        let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
        for (x, y, value) in marks {
            grid[Cell::new(x % width, y % height)] = *value;
        }
        grid
    }

    fn marks() -> impl Strategy<Value = Vec<(u32, u32, i8)>> {
        proptest::collection::vec(
            (0_u32..300, 0_u32..150, prop::sample::select(vec![-1_i8, 0, 100])),
            0..30,
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn an_updated_space_equals_one_that_is_built_anew(width in 1_u32..300, height in 1_u32..150, before in marks(), changes in marks(), radius in prop::sample::select(vec![0.2, 1.5, 9.0])) {
            for policy in [UnknownPolicy::Free, UnknownPolicy::Blocked, UnknownPolicy::Obstacle] {
                let footprint = Footprint::Radius(radius);
                let mut map = grid(width, height, &before);
                let mut space = ConfigurationSpace::new(&map, &footprint, policy, 0.0);
                for (x, y, value) in &changes {
                    let cell = Cell::new(x % width, y % height);
                    map[cell] = *value;
                    space.update(&map, cell.x..cell.x + 1, cell.y..cell.y + 1).unwrap();
                }
                let anew = ConfigurationSpace::new(&map, &footprint, policy, 0.0);
                prop_assert_eq!(space.free(), anew.free());
                prop_assert_eq!(space.field(), anew.field());
                prop_assert_eq!(space.obstacles(), anew.obstacles());
            }
        }
    }

    #[test]
    fn a_map_that_has_grown_is_not_updated() {
        let mut space = ConfigurationSpace::new(&grid(10, 10, &[]), &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
        assert_eq!(space.update(&grid(11, 10, &[]), 0..1, 0..1), Err(GridChanged));
        assert_eq!(
            space.update(&grid(10, 10, &[(5, 5, 100)]), 0..u32::MAX, 0..u32::MAX),
            Ok(true)
        );
    }

    #[test]
    fn maps_without_cells_and_robots_without_measure_are_told_so() {
        let nothing = grid(1, 1, &[]);
        let empty = OccupancyGrid::filled(
            GridSpec {
                width: 0,
                height: 0,
                ..*nothing.spec()
            },
            Occupancy::FREE,
        );
        let space = ConfigurationSpace::new(&empty, &Footprint::Radius(0.2), UnknownPolicy::Blocked, f64::NAN);
        assert_eq!((space.nearest_free(Point2::origin()), space.free().count()), (None, 0));
        let huge = ConfigurationSpace::new(
            &grid(50, 50, &[(0, 0, 100)]),
            &Footprint::Radius(1e300),
            UnknownPolicy::Free,
            0.0,
        );
        assert_eq!(huge.free().count(), 0);
        let point = ConfigurationSpace::new(
            &grid(3, 1, &[(1, 0, 100)]),
            &Footprint::Radius(0.0),
            UnknownPolicy::Free,
            0.0,
        );
        assert_eq!(point.free().row(0), [0b101]);
    }
}
