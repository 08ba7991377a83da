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
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// use zenav_localisation::KnownMap;
    ///
    /// let known = KnownMap::new(&map, 0.08);
    /// assert_eq!(known.field().at(Point2::new(3.02, 0.0)), 1.0, "in the wall");
    /// assert_eq!(known.field().at(Point2::new(2.0, 0.0)), 0.0, "1 m away from it");
    /// assert_eq!(known.field().at(Point2::new(1.4, 0.9)), 0.0, "inside a pillar of 0.5 m radius, which nobody sees");
    /// ```
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
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// # use zenav_localisation::KnownMap;
    /// let known = KnownMap::new(&map, 0.08);
    /// assert_eq!((known.field().sigma(), known.field().spec()), (0.08, known.spec()));
    /// ```
    #[must_use]
    pub fn field(&self) -> &LikelihoodField {
        self.pyramid.field()
    }

    /// The field with bounds over blocks.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// # use zenav_localisation::KnownMap;
    /// use zenav_scan_matching::{ScanSettings, Window, points, search};
    ///
    /// let (known, truth) = (KnownMap::new(&map, 0.08), Pose2::new(0.2, 0.1, 0.3));
    /// let seen = points(&look(0.1, truth), Pose2::IDENTITY, 0.0, &ScanSettings::default());
    /// let best = search(known.pyramid(), &seen, &Window::around(Pose2::new(0.35, 0.0, 0.2), 0.3, 0.2)).found[0];
    /// assert!(best.pose.distance(&truth) < 0.1, "{best:?}");
    /// ```
    #[must_use]
    pub fn pyramid(&self) -> &Pyramid {
        &self.pyramid
    }

    /// Where a robot may be: above zero in free cells.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// # use zenav_localisation::KnownMap;
    /// let known = KnownMap::new(&map, 0.08);
    /// let may_be = |x, y| known.places().field().at(Point2::new(x, y)) > 0.0;
    /// assert!(may_be(0.0, 0.0) && !may_be(1.4, 0.9) && !may_be(9.0, 0.0));
    /// ```
    #[must_use]
    pub fn places(&self) -> &Pyramid {
        &self.places
    }

    /// Geometry.
    ///
    /// ```
    /// use zenav_localisation::KnownMap;
    /// use zenav_protocol::grid::{GridSpec, OccupancyGrid};
    ///
    /// let spec = GridSpec { origin: nalgebra::Point2::new(-1.0, 0.0), resolution: 0.05, width: 40, height: 20 };
    /// assert_eq!(KnownMap::new(&OccupancyGrid::filled(spec, 0), 0.08).spec(), &spec, "that of the map");
    /// ```
    #[must_use]
    pub fn spec(&self) -> &GridSpec {
        self.known.spec()
    }

    /// Whether the cell of a point is known: free or occupied.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_localisation::KnownMap;
    /// use zenav_protocol::grid::{GridSpec, OccupancyGrid};
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 1.0, width: 3, height: 1 };
    /// // Free, occupied, and never seen.
    /// let known = KnownMap::new(&OccupancyGrid::from_values(spec, vec![0, 100, -1])?, 0.08);
    /// assert_eq!([0.5, 1.5, 2.5, 3.5].map(|x| known.knows(Point2::new(x, 0.5))), [true, true, false, false]);
    /// # Ok::<(), zenav_protocol::grid::GridError>(())
    /// ```
    #[must_use]
    pub fn knows(&self, point: Point2<f64>) -> bool {
        self.known.at(point).copied().unwrap_or(false)
    }
}
