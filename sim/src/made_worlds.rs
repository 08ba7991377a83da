//! Made worlds. Worlds without a file, for benches, examples and tests: polygons on a lattice, a floor for many robots, an office.

use std::fmt::Write as _;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::robot::RobotModel;

use crate::world::World;
use crate::world_check::WorldError;

/// A world file of `shapes` regular polygons of `sides` sides on a lattice in a walled square of `size` m.
///
/// ```
/// use zenav_sim::{World, made_worlds::polygons};
///
/// let world = World::from_toml(&polygons(9, 5, 10.0), "made.toml", &|_| Err(String::new()))?;
/// let corners = world.polygons().iter().map(Vec::len);
/// assert_eq!(corners.filter(|count| *count == 5).count(), 9, "pentagons; the walls have four corners");
/// # Ok::<(), zenav_sim::WorldError>(())
/// ```
#[must_use]
pub fn polygons(shapes: usize, sides: usize, size: f64) -> String {
    let mut text = format!("size = [{size:?}, {size:?}]\n");
    for (from, to) in [
        ([0.0, 0.0], [size, 0.0]),
        ([size, 0.0], [size, size]),
        ([size, size], [0.0, size]),
        ([0.0, size], [0.0, 0.0]),
    ] {
        let _ = writeln!(text, "[[wall]]\nfrom = {from:?}\nto = {to:?}\nthickness = 0.1");
    }
    let a_row = (shapes as f64).sqrt().ceil() as usize;
    let pitch = size / a_row as f64;
    for shape in 0..shapes {
        let (x, y) = ((shape % a_row) as f64 + 0.5, (shape / a_row) as f64 + 0.5);
        // Sizes and angles vary without a random generator.
        let radius = pitch * (0.1 + 0.15 * ((shape * 7) % 10) as f64 / 10.0);
        let corners: Vec<[f64; 2]> = (0..sides)
            .map(|side| std::f64::consts::TAU * (side as f64 / sides as f64 + shape as f64 * 0.13))
            .map(|angle| [x * pitch + radius * angle.cos(), y * pitch + radius * angle.sin()])
            .collect();
        let _ = writeln!(text, "[[polygon]]\npoints = {corners:?}");
    }
    text
}

/// A walled floor with room for `count` robots of a model and with quadrilaterals to see, one for every ten robots, at least twenty.
///
/// ```
/// # let neato = zenav_fixtures::robot("neato");
/// use zenav_sim::{made_worlds::floor, scatter::scatter};
///
/// let world = floor(&neato, 30)?;
/// assert_eq!(scatter(&world, &neato, 30, 0.2, 1).len(), 30);
/// # Ok::<(), zenav_sim::WorldError>(())
/// ```
///
/// # Errors
/// [`WorldError`] for more things than a world may hold.
pub fn floor(model: &RobotModel, count: usize) -> Result<World, WorldError> {
    let apart = 2.0 * model.footprint.circumscribed_radius() + model.drive.wheel_separation;
    // Four times the square that each robot needs: random placement leaves half of that empty.
    let size = (2.0 * apart * (count as f64).sqrt()).max(20.0).ceil();
    World::from_toml(&polygons((count / 10).max(20), 4, size), "floor", &|_| {
        Err(String::new())
    })
}

/// An office of rooms with doors and furniture, as a map of 5 cm cells.
#[must_use]
pub fn office() -> World {
    const SIDE: u32 = 1200;
    let spec = GridSpec {
        origin: Point2::origin(),
        resolution: 0.05,
        width: SIDE,
        height: SIDE,
    };
    let mut map = OccupancyGrid::filled(spec, Occupancy::FREE);
    for y in 0..SIDE {
        for x in 0..SIDE {
            let (in_x, in_y) = (x % 120, y % 120);
            let wall = (in_x < 3 && !(50..70).contains(&in_y)) || (in_y < 3 && !(50..70).contains(&in_x));
            let (room_x, room_y) = (x / 120, y / 120);
            let corner = 20 + (room_x * 13 + room_y * 29) % 60;
            let furniture = (corner..corner + 14).contains(&in_x) && (80..88).contains(&in_y);
            // Clutter, as in a scanned map.
            let speck = (x * 7919 + y * 104_729) % 1013 == 0;
            if wall || furniture || speck || x == SIDE - 1 || y == SIDE - 1 {
                map[Cell::new(x, y)] = Occupancy::OCCUPIED;
            }
        }
    }
    World::from_map("office", map, Pose2::new(3.0, 3.0, 0.0))
}
