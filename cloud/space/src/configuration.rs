//! Configuration space. The cells that admit the robot, and the distance of any point to the nearest obstacle.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::grid::{Cell, GridSpec, OccupancyGrid};
use zenav_protocol::robot::Footprint;

use super::bits::BitGrid;
use super::distance::exact::for_each_row;
use super::distance::{DistanceField, MAX_REACH};
use super::raster::CellMask;
use super::sweep::Banded;
use super::update::Marks;
use super::zones::Zones;

/// Meaning of unknown cells for a robot. Everything outside the grid counts as unknown too, but is no obstacle: under the last two
/// policies the robot's centre stays on the grid, and its body may reach over the border.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::geometry::Pose2;
/// use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
/// use zenav_protocol::robot::Footprint;
/// use zenav_space::{ConfigurationSpace, UnknownPolicy};
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
/// let mut map = Grid::filled(spec, Occupancy::FREE);
/// map[Cell::new(20, 20)] = Occupancy::UNKNOWN; // from (2.0, 2.0) to (2.1, 2.1)
/// let fits = |unknown, x| {
///     let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), unknown, 0.0);
///     space.is_valid(Pose2::new(x, 2.05, 0.0))
/// };
/// assert!(fits(UnknownPolicy::Free, 2.05));
/// assert!(fits(UnknownPolicy::Blocked, 1.9) && !fits(UnknownPolicy::Blocked, 2.05));
/// assert!(fits(UnknownPolicy::Obstacle, 1.7) && !fits(UnknownPolicy::Obstacle, 1.9));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnknownPolicy {
    /// Driven through like free cells.
    Free,
    /// The robot's centre stays off them; its body may reach over their border (like Nav2 with `allow_unknown: false`).
    #[default]
    Blocked,
    /// Obstacles like occupied cells: no part of the robot touches them.
    Obstacle,
}

impl UnknownPolicy {
    /// The policy of a robot that may, or may not, drive through unknown cells.
    #[must_use]
    pub const fn of(unknown_is_free: bool) -> Self {
        if unknown_is_free { Self::Free } else { Self::Blocked }
    }
}

/// Least reach of the distance field, m, as far as its limit in cells allows.
const USUAL_REACH: f64 = 1.0;

/// The free cells of a robot, the distances that decide them, and the obstacles themselves.
///
/// A cell is free if a disc of the footprint's inscribed radius plus the margin fits at its centre with enough room to also fit
/// everywhere on the straight step to each free neighbour, diagonals included: a path from centre to centre is exactly collision-free for
/// the disc. (The least distance to a convex obstacle on a step of length `l` between two points at distance `d` is at least
/// `sqrt(d^2 - l^2/4)`.) For a point robot every unoccupied cell is free.
///
/// A copy shares all unchanged parts with its original.
#[derive(Clone, Debug)]
pub struct ConfigurationSpace {
    pub(super) spec: GridSpec,
    pub(super) footprint: Footprint,
    pub(super) unknown_policy: UnknownPolicy,
    margin: f64,
    zones: Arc<Zones>,
    /// Cells of the keep-out zones.
    pub(super) keep_out: Option<Arc<CellMask>>,
    /// Occupied cells and those of keep-out zones; under [`UnknownPolicy::Obstacle`] unknown ones as well.
    pub(super) obstacles: Arc<Banded>,
    /// Under [`UnknownPolicy::Blocked`] the unknown cells, else empty.
    pub(super) forbidden: Arc<Banded>,
    pub(super) field: DistanceField,
    pub(super) free: Arc<BitGrid>,
    /// Squared half cells that the distance of a free cell exceeds.
    threshold: i64,
}

impl ConfigurationSpace {
    /// Builds the space of a robot on a map.
    ///
    /// `margin` (m) is kept clear around the footprint's inscribed disc; negative or non-finite counts as none.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
    /// assert!(!space.is_free(Cell::new(21, 20)) && space.is_free(Cell::new(23, 20)));
    /// ```
    #[must_use]
    pub fn new(grid: &OccupancyGrid, footprint: &Footprint, unknown: UnknownPolicy, margin: f64) -> Self {
        Self::with_zones(grid, footprint, unknown, margin, &Arc::default())
    }

    /// Like [`new`](Self::new), on a map with zones: keep-out zones are obstacles.
    ///
    /// ```
    /// # use std::sync::Arc;
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy, Zones};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let map = Grid::filled(spec, Occupancy::FREE);
    /// let stairs = "[[keep_out]]\npoints = [[3.05, 0], [4, 0], [4, 4], [3.05, 4]]";
    /// let zones = Arc::new(Zones::from_toml(stairs, "zones.toml")?);
    /// let space = ConfigurationSpace::with_zones(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0, &zones);
    /// // A cell that the zone touches is an obstacle as a whole: the zone begins at x = 3.0 m.
    /// assert!((space.clearance(Point2::new(2.5, 2.0)) - 0.5).abs() < 1e-9);
    /// # Ok::<(), zenav_space::ZonesError>(())
    /// ```
    #[must_use]
    pub fn with_zones(
        grid: &OccupancyGrid,
        footprint: &Footprint,
        unknown: UnknownPolicy,
        margin: f64,
        zones: &Arc<Zones>,
    ) -> Self {
        let spec = *grid.spec();
        let keep_out = zones.keep_out_cells(&spec).map(Arc::new);
        let margin = if margin.is_finite() { margin.max(0.0) } else { 0.0 };
        let radius = footprint.inscribed_radius() + margin;
        let reach =
            (radius.max(USUAL_REACH).max(footprint.circumscribed_radius() + margin) / spec.resolution).ceil() + 1.0;
        let mut obstacles = BitGrid::new(spec.width, spec.height);
        let mut forbidden = if unknown == UnknownPolicy::Blocked {
            obstacles.clone()
        } else {
            BitGrid::new(0, 0)
        };
        for y in 0..spec.height {
            for word in 0..obstacles.stride() {
                let marks = Marks::read(grid, unknown, keep_out.as_deref(), y, word);
                obstacles.row_mut(y)[word] = marks.obstacles;
                if unknown == UnknownPolicy::Blocked {
                    forbidden.row_mut(y)[word] = marks.forbidden;
                }
            }
        }
        let mut space = Self {
            spec,
            footprint: footprint.clone(),
            unknown_policy: unknown,
            margin,
            zones: Arc::clone(zones),
            keep_out,
            field: DistanceField::new(spec, &obstacles, (reach as u32).clamp(1, MAX_REACH)),
            free: Arc::new(BitGrid::new(spec.width, spec.height)),
            obstacles: Arc::new(Banded::new(obstacles)),
            forbidden: Arc::new(Banded::new(forbidden)),
            threshold: threshold(radius / spec.resolution),
        };
        space.admit(0..space.obstacles().stride(), 0..spec.height);
        space
    }

    /// The same map for a disc of `radius` (m), with the same margin and policy: obstacles and distances are shared, only the free cells
    /// are recomputed (one pass over the distances, or a full distance transform if they do not reach that far).
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
    /// let larger = space.for_disc(0.5);
    /// assert!(space.is_free(Cell::new(23, 20)) && !larger.is_free(Cell::new(23, 20)));
    /// ```
    #[must_use]
    pub fn for_disc(&self, radius: f64) -> Self {
        let mut space = Self {
            footprint: Footprint::Radius(radius),
            free: Arc::new(BitGrid::new(self.spec.width, self.spec.height)),
            threshold: threshold((radius + self.margin) / self.spec.resolution),
            ..self.clone()
        };
        space.admit(0..space.obstacles().stride(), 0..space.spec.height);
        space
    }

    /// The same map for the same robot with its rear as its front; everything is shared.
    #[must_use]
    pub fn turned(&self) -> Self {
        Self {
            footprint: self.footprint.turned(),
            ..self.clone()
        }
    }

    /// Whether the robot is larger than the field's reach: the free cells then come from a full distance transform.
    pub(super) fn is_beyond_the_field(&self) -> bool {
        self.threshold >= 4 * i64::from(self.field.reach_cells()).pow(2)
    }

    /// Decides from the distances which cells of a window are free.
    pub(super) fn admit(&mut self, words: Range<usize>, rows: Range<u32>) {
        let (obstacles, forbidden, field) = (self.obstacles.bits(), self.forbidden.bits(), &self.field);
        let free = Arc::make_mut(&mut self.free);
        let in_grid = |word: usize| u64::MAX >> (64 - (self.spec.width as usize - 64 * word).min(64));
        let permitted = |y: u32, word: usize| {
            in_grid(word)
                & match self.unknown_policy {
                    UnknownPolicy::Blocked => !forbidden.row(y)[word],
                    _ => u64::MAX,
                }
        };
        if self.threshold >= 4 * i64::from(field.reach_cells()).pow(2) {
            let threshold = u32::try_from(self.threshold).unwrap_or(u32::MAX - 1);
            for_each_row(obstacles, |y, squared| {
                let row = squared.chunks(64).zip(free.row_mut(y)).enumerate();
                for (word, (squared, free)) in row {
                    let bits = squared
                        .iter()
                        .enumerate()
                        .fold(0, |bits, (bit, squared)| bits | u64::from(*squared > threshold) << bit);
                    *free = bits & permitted(y, word);
                }
            });
            return;
        }
        let threshold = u16::try_from(self.threshold).unwrap_or(u16::MAX);
        field.farther(threshold, words, rows, |y, word, clear| {
            free.row_mut(y)[word] = clear & permitted(y, word);
        });
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

    /// Policy for unknown cells.
    #[must_use]
    pub fn unknown_policy(&self) -> UnknownPolicy {
        self.unknown_policy
    }

    /// The zones of the map.
    #[must_use]
    pub fn zones(&self) -> &Arc<Zones> {
        &self.zones
    }

    /// Margin kept clear around the inscribed disc, m.
    #[must_use]
    pub fn margin(&self) -> f64 {
        self.margin
    }

    /// Radius used for the free cells, m: the footprint's inscribed radius plus the margin.
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.footprint.inscribed_radius() + self.margin
    }

    /// Free cells, one bit each.
    #[must_use]
    pub fn free(&self) -> &BitGrid {
        &self.free
    }

    /// Obstacles as they stand in the map, and keep-out zones; not inflated.
    #[must_use]
    pub fn obstacles(&self) -> &BitGrid {
        self.obstacles.bits()
    }

    /// Cells that the robot's centre stays off under [`UnknownPolicy::Blocked`]; empty under the other policies.
    #[must_use]
    pub fn forbidden(&self) -> &BitGrid {
        self.forbidden.bits()
    }

    /// Distances of cell centres to the nearest obstacle.
    #[must_use]
    pub fn field(&self) -> &DistanceField {
        &self.field
    }

    /// Memory of the bitmaps and distances, bytes, including those shared with copies of the space.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.obstacles.bytes() + self.forbidden.bytes() + size_of_val(self.free.words()) + self.field.bytes()
    }

    /// Whether the robot fits at a cell's centre; `false` outside the grid.
    #[must_use]
    pub fn is_free(&self, cell: Cell) -> bool {
        self.free.get(cell)
    }

    /// Largest distance that [`clearance`](Self::clearance) resolves, m.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.field.reach()
    }

    /// Exact distance from any point, inside the grid or not, to the nearest obstacle's closed square, m; at most
    /// [`reach`](Self::reach), zero on an obstacle and for a non-finite point.
    ///
    /// Cost: two bit scans per row within that distance, some hundred nanoseconds.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
    /// assert!((space.clearance(Point2::new(1.5, 2.05)) - 0.5).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn clearance(&self, point: Point2<f64>) -> f64 {
        let mut limit = self.reach();
        if let Some(cell) = self.spec.cell_at(point) {
            // Distance changes by at most the distance moved: the centre's value bounds the point's.
            let bound = self.field.distance(cell) + (point - self.spec.center(cell)).norm();
            limit = limit.min(bound);
        }
        super::shapes::disc_clearance(self.obstacles.bits(), &self.spec, point, limit)
    }

    /// The free cell centre nearest to a point, m; `None` if no cell is free or the point is not finite.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
    /// # use zenav_protocol::robot::Footprint;
    /// # use zenav_space::{ConfigurationSpace, UnknownPolicy};
    /// # let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// # let mut map = Grid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 20)] = Occupancy::OCCUPIED; // from (2.0, 2.0) to (2.1, 2.1)
    /// let space = ConfigurationSpace::new(&map, &Footprint::Radius(0.2), UnknownPolicy::Free, 0.0);
    /// let near = space.nearest_free(Point2::new(2.05, 2.05)).unwrap();
    /// assert!(space.clearance(near) > 0.2 && space.clearance(near) < 0.4);
    /// ```
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
pub(super) fn threshold(radius: f64) -> i64 {
    if radius <= 0.0 {
        return 0;
    }
    // `l` is a diagonal step: l^2/4 is half a cell squared. Rounding goes to the safe side.
    (4.0 * (radius * radius + 0.5) + 1e-9).floor() as i64
}

#[cfg(test)]
mod tests {
    use zenav_protocol::grid::Occupancy;

    use super::*;

    fn grid(width: u32, height: u32, marks: &[(u32, u32, i8)]) -> OccupancyGrid {
        zenav_fixtures::map_with(zenav_fixtures::spec(width, height, 0.1), marks)
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

    #[test]
    fn a_space_for_another_disc_is_the_one_built_for_it() {
        let grid = grid(90, 40, &[(3, 4, 100), (40, 20, 100), (60, 30, -1)]);
        let footprint = zenav_fixtures::footprint(&[(-0.5, -0.15), (0.3, -0.15), (0.3, 0.15), (-0.5, 0.15)]);
        for policy in [UnknownPolicy::Free, UnknownPolicy::Blocked, UnknownPolicy::Obstacle] {
            let space = ConfigurationSpace::new(&grid, &footprint, policy, 0.02);
            // Within the reach of the distances, and beyond.
            for radius in [0.0, 0.3, footprint.circumscribed_radius(), 2.5] {
                let built = ConfigurationSpace::new(&grid, &Footprint::Radius(radius), policy, 0.02);
                let derived = space.for_disc(radius);
                assert_eq!(
                    (derived.free(), derived.radius()),
                    (built.free(), built.radius()),
                    "{radius}"
                );
            }
        }
    }
}
