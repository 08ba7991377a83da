//! Likelihood field. Closeness of a point to the nearest known surface.
//!
//! Each cell holds `exp(-d² / 2σ²)` of the distance `d` from its centre to the nearest known point, as a byte (Thrun et al., Probabilistic
//! Robotics, section 6.4). Points are added one by one; the cost of each is that of its surroundings.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{GridSpec, MAX_SIDE, Occupancy, OccupancyGrid};

use crate::settings::FieldSettings;

/// Standard deviations after which a likelihood is zero.
const REACH: f64 = 3.0;
/// Most cells that a point reaches across: with a larger sigma its reach is cut.
const MAX_WIDTH: usize = 256;
/// Margin by which a field grows beyond a point outside it, cells.
const MARGIN: i64 = 64;
/// A point further from the first one than this share of the largest grid is left out.
const LARGEST: i64 = (MAX_SIDE / 4) as i64;

/// Likelihood of seeing a surface in each cell, 0 to 255.
#[derive(Clone, Debug)]
pub struct LikelihoodField {
    spec: GridSpec,
    values: Vec<u8>,
    sigma: f64,
}

impl LikelihoodField {
    /// An empty field.
    #[must_use]
    pub fn new(settings: &FieldSettings) -> Self {
        let spec = GridSpec {
            origin: Point2::origin(),
            resolution: settings.resolution,
            width: 0,
            height: 0,
        };
        Self {
            spec,
            values: Vec::new(),
            sigma: settings.sigma,
        }
    }

    /// The field of an occupancy grid, at the grid's own resolution: the centres of occupied cells are the points.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
    /// use zenav_scan_matching::LikelihoodField;
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 40, height: 40 };
    /// let mut map = OccupancyGrid::filled(spec, Occupancy::FREE);
    /// map[Cell::new(20, 10)] = Occupancy::OCCUPIED;
    /// let field = LikelihoodField::from_grid(&map, 0.1);
    /// assert_eq!(field.at(spec.center(Cell::new(20, 10))), 1.0);
    /// // Two cells are 0.1 m, one standard deviation.
    /// assert!((field.at(spec.center(Cell::new(22, 10))) - (-0.5_f64).exp()).abs() < 0.01);
    /// ```
    #[must_use]
    pub fn from_grid(grid: &OccupancyGrid, sigma: f64) -> Self {
        let spec = *grid.spec();
        let mut field = Self {
            values: vec![0; spec.len()],
            spec,
            sigma,
        };
        for index in 0..spec.len() {
            let cell = spec.cell(index);
            if grid[cell] >= Occupancy::OCCUPIED_FROM {
                field.add(spec.center(cell));
            }
        }
        field
    }

    /// A field with given values, row by row from the lower left; `None` if their number differs from that of the cells.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::GridSpec;
    /// use zenav_scan_matching::LikelihoodField;
    ///
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 1.0, width: 2, height: 2 };
    /// let field = LikelihoodField::from_values(spec, vec![0, 51, 0, 0]).unwrap();
    /// assert_eq!((field.at(Point2::new(1.5, 0.5)), field.at(Point2::new(0.5, 1.5))), (0.2, 0.0));
    /// assert!(LikelihoodField::from_values(spec, vec![0; 3]).is_none());
    /// ```
    #[must_use]
    pub fn from_values(spec: GridSpec, values: Vec<u8>) -> Option<Self> {
        (values.len() == spec.len()).then_some(Self {
            sigma: spec.resolution,
            spec,
            values,
        })
    }

    /// Adds the points of a scan seen from a pose: `field_from_scan`, points in the scan's frame, m.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::geometry::Pose2;
    /// use zenav_scan_matching::{FieldSettings, LikelihoodField};
    ///
    /// // A wall 2 m ahead, seen from x = 1.
    /// let wall: Vec<_> = (-50..=50).map(|i| Point2::new(2.0, 0.02 * f64::from(i))).collect();
    /// let mut field = LikelihoodField::new(&FieldSettings::default());
    /// field.insert(Pose2::new(1.0, 0.0, 0.0), &wall);
    /// assert!(field.at(Point2::new(3.0, 0.5)) > 0.9);
    /// assert_eq!(field.at(Point2::new(2.5, 0.5)), 0.0, "0.5 m is more than three standard deviations");
    /// ```
    pub fn insert(&mut self, field_from_scan: Pose2, points: &[Point2<f64>]) {
        let placed = placed(field_from_scan, points);
        let mut bounds: Option<(Point2<f64>, Point2<f64>)> = None;
        for point in placed
            .iter()
            .filter(|point| point.coords.iter().all(|value| value.is_finite()))
        {
            let (low, high) = bounds.unwrap_or((*point, *point));
            bounds = Some((low.inf(point), high.sup(point)));
        }
        if let Some((low, high)) = bounds {
            self.make_room(low, high);
        }
        for point in placed {
            self.add(point);
        }
    }

    /// Position, size and resolution of the field.
    #[must_use]
    pub fn spec(&self) -> &GridSpec {
        &self.spec
    }

    /// The likelihoods, row by row from the lower left, 0 to 255.
    #[must_use]
    pub fn values(&self) -> &[u8] {
        &self.values
    }

    /// Standard deviation of the likelihood, m.
    #[must_use]
    pub fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Likelihood, 0 to 1, at a point, and its slope, 1/m: a quadratic spline over nine cells, so that the slope has neither steps nor
    /// flats between cells. On a surface it is a little below 1. Zero outside.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_scan_matching::{FieldSettings, LikelihoodField};
    /// # let wall: Vec<_> = (-50..=50).map(|i| Point2::new(3.0, 0.02 * f64::from(i))).collect();
    /// # let mut field = LikelihoodField::new(&FieldSettings::default());
    /// # field.insert(Pose2::IDENTITY, &wall);
    /// // `field` shows a wall at x = 3.
    /// let (likelihood, slope) = field.likelihood(Point2::new(2.95, 0.0));
    /// assert!((0.5..0.95).contains(&likelihood));
    /// assert!(slope.x > 1.0 && slope.y.abs() < 0.1, "it rises towards the wall, and not along it");
    /// assert_eq!(field.likelihood(Point2::new(99.0, 0.0)).0, 0.0);
    /// ```
    #[must_use]
    pub fn likelihood(&self, point: Point2<f64>) -> (f64, Vector2<f64>) {
        let per_metre = self.spec.resolution.recip();
        let at = (point - self.spec.origin) * per_metre;
        let (x, y) = (at.x.floor(), at.y.floor());
        let (width, height) = (self.spec.width as usize, self.spec.height as usize);
        if !(x >= 1.0 && y >= 1.0 && x + 1.0 < width as f64 && y + 1.0 < height as f64) {
            return (0.0, Vector2::zeros());
        }
        // From the centre of the cell, half a cell to each side.
        let weights = |u: f64| [0.5 * (0.5 - u) * (0.5 - u), 0.75 - u * u, 0.5 * (0.5 + u) * (0.5 + u)];
        let slopes = |u: f64| [u - 0.5, -2.0 * u, u + 0.5];
        let (u, v) = (at.x - x - 0.5, at.y - y - 0.5);
        let (across, up, along) = (weights(u), weights(v), slopes(u));
        let rises = slopes(v);
        let corner = (y as usize - 1) * width + x as usize - 1;
        let (mut value, mut slope) = (0.0, Vector2::zeros());
        for row in 0..3 {
            let cells = &self.values[corner + row * width..corner + row * width + 3];
            let (mut sum, mut rise) = (0.0, 0.0);
            for column in 0..3 {
                let cell = f64::from(cells[column]);
                sum += across[column] * cell;
                rise += along[column] * cell;
            }
            value += up[row] * sum;
            slope += Vector2::new(up[row] * rise, rises[row] * sum);
        }
        (value / 255.0, slope * (per_metre / 255.0))
    }

    /// Likelihood, 0 to 1, of the cell that a point lies in. Zero outside.
    #[inline]
    #[must_use]
    pub fn at(&self, point: Point2<f64>) -> f64 {
        self.index(point)
            .map_or(0.0, |index| f64::from(self.values[index]) / 255.0)
    }

    /// Index of the cell that a point lies in, if that is inside.
    #[inline]
    pub(crate) fn index(&self, point: Point2<f64>) -> Option<usize> {
        let at = (point - self.spec.origin) / self.spec.resolution;
        let is_inside =
            at.x >= 0.0 && at.y >= 0.0 && at.x < f64::from(self.spec.width) && at.y < f64::from(self.spec.height);
        is_inside.then_some(at.y as usize * self.spec.width as usize + at.x as usize)
    }

    fn add(&mut self, point: Point2<f64>) {
        let at = (point - self.spec.origin) / self.spec.resolution;
        if !at.iter().all(|value| value.is_finite()) {
            return;
        }
        let reach = (REACH * self.sigma / self.spec.resolution).min(0.5 * MAX_WIDTH as f64 - 1.0);
        let scale = -0.5 * (self.spec.resolution / self.sigma).powi(2);
        let range = |middle: f64, side: u32| {
            let low = (middle - reach - 0.5).ceil().max(0.0) as usize;
            let high = (middle + reach - 0.5).floor().min(f64::from(side) - 1.0);
            low..if high < 0.0 { low } else { high as usize + 1 }
        };
        // The two-dimensional bell is the product of the bells over each axis.
        let bell = |cell: usize, middle: f64| (scale * (cell as f64 + 0.5 - middle).powi(2)).exp();
        let mut across = [0.0_f32; MAX_WIDTH];
        let columns = range(at.x, self.spec.width);
        for (weight, x) in across.iter_mut().zip(columns.clone()) {
            *weight = (255.0 * bell(x, at.x)) as f32;
        }
        for y in range(at.y, self.spec.height) {
            let up = bell(y, at.y) as f32;
            let row = y * self.spec.width as usize;
            let cells = &mut self.values[row + columns.start..row + columns.end];
            for (value, weight) in cells.iter_mut().zip(&across) {
                *value = (*value).max((up * weight + 0.5) as u8);
            }
        }
    }

    /// Grows so that points between two corners and their surroundings lie inside, up to the largest grid.
    fn make_room(&mut self, low: Point2<f64>, high: Point2<f64>) {
        let resolution = self.spec.resolution;
        let reach = (REACH * self.sigma / resolution).ceil() as i64 + 1;
        if self.values.is_empty() {
            // Near the first points, on whole cells, so that all fields of a resolution share their cell corners.
            self.spec.origin = Point2::from((low.coords / resolution).map(f64::floor) * resolution);
        }
        let cells = |point: Point2<f64>, away: i64| {
            let at = (point - self.spec.origin) / resolution;
            let clamp = |value: f64| (value.floor() as i64 + away).clamp(-LARGEST, LARGEST);
            (clamp(at.x), clamp(at.y))
        };
        let (low, high) = (cells(low, -reach), cells(high, reach + 1));
        let (width, height) = (i64::from(self.spec.width), i64::from(self.spec.height));
        if low.0 >= 0 && low.1 >= 0 && high.0 <= width && high.1 <= height {
            return;
        }
        let grown = |low: i64, high: i64, side: i64| {
            let below = if low < 0 { MARGIN - low } else { 0 };
            let above = if high > side { high - side + MARGIN } else { 0 };
            (below, below + side + above)
        };
        let ((left, new_width), (down, new_height)) = (grown(low.0, high.0, width), grown(low.1, high.1, height));
        let mut values = vec![0; (new_width * new_height) as usize];
        for (y, row) in self.values.chunks_exact(width.max(1) as usize).enumerate() {
            let start = (y as i64 + down) * new_width + left;
            values[start as usize..start as usize + row.len()].copy_from_slice(row);
        }
        self.spec.origin -= Vector2::new(left as f64, down as f64) * resolution;
        (self.spec.width, self.spec.height) = (new_width as u32, new_height as u32);
        self.values = values;
    }
}

/// Points of a scan in the frame of the field.
pub(crate) fn placed(field_from_scan: Pose2, points: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let (sin, cos) = field_from_scan.yaw.sin_cos();
    let place = |point: &Point2<f64>| {
        Point2::new(
            field_from_scan.x + cos * point.x - sin * point.y,
            field_from_scan.y + sin * point.x + cos * point.y,
        )
    };
    points.iter().map(place).collect()
}
