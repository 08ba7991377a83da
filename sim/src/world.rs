//! World. Walls, furniture, a map, movers, the start and named places; the world frame is the map frame.

use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::config_text::Number;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::id::Id;
use zenav_protocol::robot::Footprint;

use crate::clearance::Placed;
use crate::faults::FaultModel;
use crate::movers::MoverModel;
use crate::outline::outline;
use crate::scene::Scene;
use crate::shape::{self, Disc, Edge};
use crate::world_check::WorldError;
use crate::world_file;

/// A named goal.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Name by which a goal refers to it.
    pub name: Id,
    /// Map x, m.
    pub x: f64,
    /// Map y, m.
    pub y: f64,
    /// Heading, rad, if it matters.
    pub yaw: Option<f64>,
}

/// A world before anything moves.
#[derive(Clone)]
pub struct World {
    pub(crate) name: String,
    pub(crate) low: Point2<f64>,
    pub(crate) high: Point2<f64>,
    pub(crate) start: Pose2,
    pub(crate) solids: Solids,
    pub(crate) map: Option<OccupancyGrid>,
    pub(crate) movers: Vec<MoverModel>,
    pub(crate) faults: Vec<FaultModel>,
    pub(crate) places: Vec<Place>,
    pub(crate) scene: Arc<Scene>,
}

/// Names and texts of the shipped worlds.
pub const SHIPPED: &[(&str, &str)] = &[
    ("kitchen", include_str!("../worlds/kitchen.toml")),
    ("wall_follow", include_str!("../worlds/wall_follow.toml")),
    ("house", include_str!("../worlds/house.toml")),
    ("empty", include_str!("../worlds/empty.toml")),
];

/// The text of a shipped world.
#[must_use]
pub fn shipped(name: &str) -> Option<&'static str> {
    SHIPPED.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Whether a point lies in a box, its border included.
pub(crate) fn within(low: Point2<f64>, high: Point2<f64>, point: Point2<f64>) -> bool {
    (low.x..=high.x).contains(&point.x) && (low.y..=high.y).contains(&point.y)
}

/// Static solids, of glass too.
#[derive(Clone, Default)]
pub(crate) struct Solids {
    pub polygons: Vec<Vec<Point2<f64>>>,
    pub discs: Vec<Disc>,
}

/// Indexes a map, solids and glass.
pub(crate) fn scene(map: Option<&OccupancyGrid>, seen: &Solids, glass: &Solids) -> Arc<Scene> {
    let sides = |solids: &Solids| -> Vec<Edge> {
        solids
            .polygons
            .iter()
            .flat_map(|polygon| shape::edges(polygon))
            .collect()
    };
    let mut edges = map.map(outline).unwrap_or_default();
    edges.extend(sides(seen));
    Arc::new(Scene::new(edges, seen.discs.clone()).with_glass(sides(glass), &glass.discs))
}

impl World {
    /// Reads a world file's text.
    ///
    /// `file` is named in errors. `load_map` opens the path in `[map] yaml`, exactly as written there: the caller knows what the path is
    /// relative to, and reads images.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_sim::World;
    ///
    /// let text = "size = [4.0, 3.0]\n[[circle]]\nx = 1.0\ny = 1.0\nradius = 0.2\n";
    /// let no_map = |path: &str| Err(format!("{path}: no map here"));
    /// let world = World::from_toml(text, "my.toml", &no_map)?;
    /// assert!(world.is_solid(Point2::new(1.1, 1.0)) && !world.is_solid(Point2::new(1.3, 1.0)));
    /// let error = World::from_toml(&text.replace("0.2", "-0.2"), "my.toml", &no_map).err().unwrap();
    /// assert_eq!(error.to_string(), "my.toml:5: `circle.radius`: -0.2: expected a positive number up to 100000");
    /// # Ok::<(), zenav_sim::WorldError>(())
    /// ```
    ///
    /// # Errors
    /// [`WorldError`] names the file, the line and the key.
    pub fn from_toml(
        text: &str,
        file: &str,
        load_map: &dyn Fn(&str) -> Result<OccupancyGrid, String>,
    ) -> Result<Self, WorldError> {
        world_file::read(text, file, load_map)
    }

    /// A shipped world by name: `kitchen`, `wall_follow`, `house`, `empty`.
    ///
    /// ```
    /// use zenav_sim::World;
    ///
    /// let kitchen = World::shipped("kitchen")?;
    /// assert_eq!(kitchen.place("sink").map(|sink| (sink.x, sink.y)), Some((0.88, 0.09)));
    /// let error = World::shipped("attic").err().unwrap();
    /// assert_eq!(error.to_string(), "no shipped world is named `attic`: there are kitchen, wall_follow, house, empty");
    /// # Ok::<(), zenav_sim::WorldError>(())
    /// ```
    ///
    /// # Errors
    /// [`WorldError::Unknown`] for another name.
    pub fn shipped(name: &str) -> Result<Self, WorldError> {
        let text = shipped(name).ok_or_else(|| WorldError::Unknown {
            name: name.to_owned(),
            known: SHIPPED.iter().map(|(known, _)| *known).collect::<Vec<_>>().join(", "),
        })?;
        Self::from_toml(text, name, &|_| Err("a shipped world has no map file".to_owned()))
    }

    /// A world that consists of a map only: occupied cells are solid, all others open.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::{geometry::Pose2, grid::{Cell, GridSpec, Occupancy, OccupancyGrid}};
    /// use zenav_sim::World;
    ///
    /// let spec = GridSpec { origin: Point2::new(-2.0, 0.0), resolution: 1.0, width: 4, height: 3 };
    /// let mut map = OccupancyGrid::filled(spec, Occupancy::UNKNOWN);
    /// map[Cell::new(2, 1)] = Occupancy::OCCUPIED;
    /// let world = World::from_map("drawn", map, Pose2::new(-1.5, 0.5, 0.0));
    /// assert_eq!(world.bounds(), (Point2::new(-2.0, 0.0), Point2::new(2.0, 3.0)));
    /// assert!(world.is_solid(Point2::new(0.5, 1.5)) && !world.is_solid(Point2::new(-0.5, 1.5)));
    /// ```
    #[must_use]
    pub fn from_map(name: &str, map: OccupancyGrid, start: Pose2) -> Self {
        let spec = *map.spec();
        let nothing = Solids::default();
        Self {
            name: name.to_owned(),
            low: spec.origin,
            high: spec.upper(),
            start,
            scene: scene(Some(&map), &nothing, &nothing),
            solids: nothing,
            map: Some(map),
            movers: Vec::new(),
            faults: Vec::new(),
            places: Vec::new(),
        }
    }

    /// Name of the world, as its file gives it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Lower-left and upper-right corner of the part intended for driving, m.
    #[must_use]
    pub fn bounds(&self) -> (Point2<f64>, Point2<f64>) {
        (self.low, self.high)
    }

    /// Default pose of the first robot.
    #[must_use]
    pub fn start(&self) -> Pose2 {
        self.start
    }

    /// Whether a point lies in the part intended for driving, its border included.
    #[must_use]
    pub fn holds(&self, point: Point2<f64>) -> bool {
        within(self.low, self.high, point)
    }

    /// Values that can be simulated but are hardly intended, each in words: a start or places where no robot can stand, a map without an
    /// occupied cell.
    ///
    /// ```
    /// use zenav_sim::World;
    ///
    /// let text = "size = [4.0, 3.0]\n[start]\nx = 1.0\ny = 1.0\n[[circle]]\nx = 1.2\ny = 1.0\nradius = 0.5\n";
    /// let world = World::from_toml(text, "my.toml", &|_| Err(String::new()))?;
    /// assert_eq!(world.doubts(), ["the start at (1, 1) lies inside something solid"]);
    /// # Ok::<(), zenav_sim::WorldError>(())
    /// ```
    #[must_use]
    pub fn doubts(&self) -> Vec<String> {
        let start = ("the start".to_owned(), self.start.position());
        let named = |place: &Place| (format!("place `{}`", place.name), Point2::new(place.x, place.y));
        let doubt = |(what, at): (String, Point2<f64>)| {
            let why = match () {
                () if !self.holds(at) => "lies outside of the world",
                () if self.is_solid(at) => "lies inside something solid",
                () => return None,
            };
            Some(format!("{what} at ({}, {}) {why}", Number(at.x), Number(at.y)))
        };
        let all = [start].into_iter().chain(self.places.iter().map(named));
        let is_solid = |value: &i8| Occupancy::of(*value) == Occupancy::Occupied;
        let bare = self.map.as_ref().filter(|map| !map.values().iter().any(is_solid));
        let bare = bare.map(|_| "the map has no occupied cell: there is no wall in it".to_owned());
        all.filter_map(doubt).chain(bare).collect()
    }

    /// Named goals, in the order of the file.
    #[must_use]
    pub fn places(&self) -> &[Place] {
        &self.places
    }

    /// A named goal.
    #[must_use]
    pub fn place(&self, name: &str) -> Option<&Place> {
        self.places.iter().find(|place| place.name.as_str() == name)
    }

    /// Moving obstacles.
    #[must_use]
    pub fn movers(&self) -> &[MoverModel] {
        &self.movers
    }

    /// Sensor faults, in the order of the file.
    #[must_use]
    pub fn faults(&self) -> &[FaultModel] {
        &self.faults
    }

    /// Solid polygons (walls and glass too), counter-clockwise, m.
    #[must_use]
    pub fn polygons(&self) -> &[Vec<Point2<f64>>] {
        &self.solids.polygons
    }

    /// Solid discs (of glass too), m.
    #[must_use]
    pub fn discs(&self) -> &[Disc] {
        &self.solids.discs
    }

    /// The map, if the world has one.
    #[must_use]
    pub fn map(&self) -> Option<&OccupancyGrid> {
        self.map.as_ref()
    }

    /// Everything static, indexed.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    pub(crate) fn shared_scene(&self) -> Arc<Scene> {
        Arc::clone(&self.scene)
    }

    /// Whether a point lies inside a static solid.
    #[must_use]
    pub fn is_solid(&self, point: Point2<f64>) -> bool {
        let in_map = self
            .map
            .as_ref()
            .and_then(|map| map.at(point))
            .is_some_and(|value| Occupancy::of(*value) == Occupancy::Occupied);
        let in_disc = || {
            self.solids
                .discs
                .iter()
                .any(|disc| (disc.center - point).norm_squared() <= disc.radius * disc.radius)
        };
        in_map
            || in_disc()
            || self
                .solids
                .polygons
                .iter()
                .any(|polygon| shape::contains(polygon, point))
    }

    /// Distance from a footprint at a pose to the nearest static solid, m; zero on and inside it, infinite if there is none.
    ///
    /// ```
    /// use zenav_protocol::{geometry::Pose2, robot::Footprint};
    /// use zenav_sim::World;
    ///
    /// // The left side of the table lies at x = -0.6.
    /// let kitchen = World::shipped("kitchen")?;
    /// let clearance = |x| kitchen.clearance(&Footprint::Radius(0.2), Pose2::new(x, -1.8, 0.0));
    /// assert!((clearance(-1.1) - 0.3).abs() < 1e-6);
    /// assert_eq!((clearance(-0.7), clearance(0.0)), (0.0, 0.0), "at its edge, and inside it");
    /// # Ok::<(), zenav_sim::WorldError>(())
    /// ```
    #[must_use]
    pub fn clearance(&self, footprint: &Footprint, map_from_base: Pose2) -> f64 {
        if self.is_solid(map_from_base.position()) {
            return 0.0;
        }
        self.scene.distance(&Placed::footprint(footprint, map_from_base))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use zenav_protocol::grid::{Cell, GridSpec};

    use super::*;

    const TIAGO: Footprint = Footprint::Radius(0.265);

    #[test]
    fn a_map_without_an_occupied_cell_is_told_of() {
        let spec = GridSpec {
            origin: Point2::new(-1.0, -1.0),
            resolution: 0.1,
            width: 20,
            height: 20,
        };
        let mut map = OccupancyGrid::filled(spec, Occupancy::FREE);
        let doubts = |map: &OccupancyGrid| World::from_map("drawn", map.clone(), Pose2::IDENTITY).doubts();
        let told = doubts(&map);
        assert!(
            matches!(&told[..], [told] if told.contains("no occupied cell")),
            "{told:?}"
        );
        map[Cell::new(3, 3)] = Occupancy::OCCUPIED;
        assert!(doubts(&map).is_empty());
    }

    fn clearance(world: &World, x: f64, y: f64) -> f64 {
        world.clearance(&TIAGO, Pose2::new(x, y, 0.0))
    }

    /// The least clearance on the straight way between two points.
    fn way(world: &World, from: (f64, f64), to: (f64, f64)) -> f64 {
        (0..=200)
            .map(|i| f64::from(i) / 200.0)
            .map(|s| clearance(world, from.0 + s * (to.0 - from.0), from.1 + s * (to.1 - from.1)))
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn every_shipped_world_can_be_read_and_its_places_reached_by_a_tiago() {
        for (name, _) in SHIPPED {
            let world = World::shipped(name).unwrap();
            assert_eq!(world.name(), *name);
            assert!(
                clearance(&world, world.start().x, world.start().y) > 0.1,
                "{name}: start"
            );
            for place in world.places() {
                assert!(clearance(&world, place.x, place.y) > 0.1, "{name}: {}", place.name);
            }
        }
        assert!(
            World::shipped("moon")
                .err()
                .unwrap()
                .to_string()
                .contains("kitchen, wall_follow")
        );
    }

    #[test]
    fn the_way_around_the_kitchen_table_has_room_for_a_tiago() {
        let kitchen = World::shipped("kitchen").unwrap();
        let around: Vec<(f64, f64)> = (1..=10)
            .map(|i| kitchen.place(&format!("table_{i}")).unwrap())
            .map(|place| (place.x, place.y))
            .collect();
        let start = (kitchen.start().x, kitchen.start().y);
        assert!(way(&kitchen, start, around[0]) > 0.24);
        for (from, to) in around.iter().zip(around.iter().cycle().skip(1)) {
            assert!(
                way(&kitchen, *from, *to) > 0.24,
                "{from:?} {to:?}: {}",
                way(&kitchen, *from, *to)
            );
        }
    }

    #[test]
    fn a_map_world_is_solid_where_its_cells_are_occupied() {
        let spec = zenav_protocol::grid::GridSpec {
            origin: Point2::new(0.0, 0.0),
            resolution: 1.0,
            width: 3,
            height: 3,
        };
        let mut map = OccupancyGrid::filled(spec, Occupancy::FREE);
        map[zenav_protocol::grid::Cell::new(1, 1)] = Occupancy::OCCUPIED;
        let world = World::from_map("block", map, Pose2::new(0.5, 0.5, 0.0));
        assert!(world.is_solid(Point2::new(1.5, 1.5)) && !world.is_solid(Point2::new(0.5, 1.5)));
        assert!((world.clearance(&Footprint::Radius(0.2), Pose2::new(0.5, 1.5, 0.0)) - 0.3).abs() < 1e-12);
        assert_eq!(world.scene().edges().things().len(), 4);
    }
}
