//! Known map. Closeness of a point to a wall, and whether its cell is known.

use nalgebra::Point2;
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};
use zenav_scan_matching::{LikelihoodField, Pyramid};

/// Levels of the pyramid: blocks of 256 cells.
const LEVELS: u32 = 8;

/// A map that does not change, prepared for matching.
#[derive(Clone, Debug)]
pub struct KnownMap {
    pyramid: Pyramid,
    /// Above zero where a robot may be.
    places: Pyramid,
    known: Grid<bool>,
}

impl KnownMap {
    /// Prepares a map; `sigma`: standard deviation of a point around its wall, m. Walls are the occupied cells with a neighbour that is not
    /// occupied: the inside of a block is never seen. Cost: a few operations per cell.
    #[must_use]
    pub fn new(map: &OccupancyGrid, sigma: f64) -> Self {
        let spec = *map.spec();
        let is_occupied = |x: i64, y: i64| {
            let inside = x >= 0 && y >= 0 && x < i64::from(spec.width) && y < i64::from(spec.height);
            inside && map[Cell::new(x as u32, y as u32)] >= Occupancy::OCCUPIED_FROM
        };
        let mut walls = map.clone();
        let mut known = Grid::filled(spec, false);
        let mut places = vec![0; spec.len()];
        for (index, place) in places.iter_mut().enumerate() {
            let cell = spec.cell(index);
            let (x, y) = (i64::from(cell.x), i64::from(cell.y));
            known[cell] = Occupancy::of(map[cell]) != Occupancy::Unknown;
            if Occupancy::of(map[cell]) == Occupancy::Free {
                *place = u8::MAX;
            }
            let is_inside = [(1, 0), (-1, 0), (0, 1), (0, -1)]
                .iter()
                .all(|(dx, dy)| is_occupied(x + dx, y + dy));
            if is_inside {
                walls[cell] = Occupancy::UNKNOWN;
            }
        }
        let field = LikelihoodField::from_grid(&walls, sigma);
        // Cannot fail: there is one value for each cell.
        let places = LikelihoodField::from_values(spec, places).unwrap_or_else(|| field.clone());
        Self {
            pyramid: Pyramid::new(field, LEVELS),
            places: Pyramid::new(places, LEVELS),
            known,
        }
    }

    /// The likelihood field of its walls.
    #[must_use]
    pub fn field(&self) -> &LikelihoodField {
        self.pyramid.field()
    }

    /// The field with bounds over blocks.
    #[must_use]
    pub fn pyramid(&self) -> &Pyramid {
        &self.pyramid
    }

    /// Where a robot may be: above zero in free cells.
    #[must_use]
    pub fn places(&self) -> &Pyramid {
        &self.places
    }

    /// Geometry.
    #[must_use]
    pub fn spec(&self) -> &GridSpec {
        self.known.spec()
    }

    /// Whether the cell of a point is known: free or occupied.
    #[must_use]
    pub fn knows(&self, point: Point2<f64>) -> bool {
        self.known.at(point).copied().unwrap_or(false)
    }
}
