//! World file. TOML in metres and radians; errors name file, line and key.

mod faults;
mod moving;
mod tables;
#[cfg(test)]
mod tests;

use nalgebra::Point2;
use toml::Spanned;
use zenav_protocol::config_text::{self, Pair};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::id::Id;

use crate::shape::Disc;
use crate::world::{Place, Solids, World, scene, within};
use crate::world_check::{MAX_ALL_CORNERS, MAX_MOVERS, MAX_SHAPES, Source, WorldError};
use tables::{CircleTable, MapTable, PlaceTable, StartTable, WallTable, WorldFile};

/// Reads and checks a world file's text.
pub(crate) fn read(
    text: &str,
    file: &str,
    load_map: &dyn Fn(&str) -> Result<OccupancyGrid, String>,
) -> Result<World, WorldError> {
    let source = Source(config_text::Source { text, file });
    let world: WorldFile = source.0.toml()?;
    for (count, limit, key) in [
        (world.polygon.len(), MAX_SHAPES, "polygon"),
        (world.circle.len(), MAX_SHAPES, "circle"),
        (world.wall.len(), MAX_SHAPES, "wall"),
        (world.mover.len(), MAX_MOVERS, "mover"),
        (world.door.len(), MAX_MOVERS, "door"),
        (world.place.len(), MAX_MOVERS, "place"),
        (world.fault.len(), MAX_MOVERS, "fault"),
        (
            world.polygon.iter().map(|polygon| polygon.points.get_ref().len()).sum(),
            MAX_ALL_CORNERS,
            "polygon.points",
        ),
    ] {
        source.count(count, limit, key)?;
    }
    let name = name(source, &world)?;
    let map = map(source, &world, load_map)?;
    let (low, high) = bounds(source, &world, map.as_ref())?;
    let start = start(source, &world, low, high)?;
    let [mut seen, glass] = solids(source, &world)?;
    let movers = world
        .mover
        .iter()
        .map(|mover| moving::mover(source, mover))
        .chain(world.door.iter().map(|door| moving::door(source, door)))
        .collect::<Result<_, _>>()?;
    let faults = world.fault.iter().map(|fault| faults::fault(source, fault));
    let scene = scene(map.as_ref(), &seen, &glass);
    seen.polygons.extend(glass.polygons);
    seen.discs.extend(glass.discs);
    Ok(World {
        name,
        low,
        high,
        start,
        solids: seen,
        map,
        movers,
        faults: faults.collect::<Result<_, _>>()?,
        places: places(source, &world.place)?,
        scene,
    })
}

/// As written, or the file's name.
fn name(source: Source<'_>, world: &WorldFile) -> Result<String, WorldError> {
    match &world.name {
        Some(name) if name.get_ref().is_empty() || name.get_ref().len() > 100 => {
            source.fail(name.span(), "name", "expected 1 to 100 characters")
        }
        Some(name) => Ok(name.get_ref().clone()),
        None => {
            let file = source.0.file.rsplit(['/', '\\']).next().unwrap_or(source.0.file);
            Ok(file.trim_end_matches(".toml").to_owned())
        }
    }
}

fn map(
    source: Source<'_>,
    world: &WorldFile,
    load_map: &dyn Fn(&str) -> Result<OccupancyGrid, String>,
) -> Result<Option<OccupancyGrid>, WorldError> {
    let Some(MapTable { yaml }) = &world.map else {
        return Ok(None);
    };
    match load_map(yaml.get_ref()) {
        Ok(map) => Ok(Some(map)),
        Err(reason) => source.fail(yaml.span(), "map.yaml", format!("{}: {reason}", yaml.get_ref())),
    }
}

/// The first robot's pose, inside the part intended for driving.
fn start(source: Source<'_>, world: &WorldFile, low: Point2<f64>, high: Point2<f64>) -> Result<Pose2, WorldError> {
    let Some(start) = &world.start else {
        return Ok(Pose2::IDENTITY);
    };
    let StartTable { x, y, yaw } = *start.get_ref();
    source.coordinates(start.span(), "start", &[x, y, yaw])?;
    source.heading(start.span(), "start.yaw", yaw)?;
    if within(low, high, Point2::new(x, y)) {
        return Ok(Pose2::new(x, y, yaw));
    }
    // To the millimetre: sums of sizes and origins have more digits than anybody wrote.
    let [left, right, bottom, top] = [low.x, high.x, low.y, high.y].map(|metres| (metres * 1e3).round() / 1e3);
    let problem = format!("({x}, {y}) lies outside of the world: expected {left} to {right} by {bottom} to {top}");
    source.fail(start.span(), "start", problem)
}

/// What lidars see, and what is of glass.
fn solids(source: Source<'_>, world: &WorldFile) -> Result<[Solids; 2], WorldError> {
    let mut solids = [Solids::default(), Solids::default()];
    for polygon in &world.polygon {
        let corners = source.polygon(&polygon.points, "polygon.points")?;
        solids[usize::from(polygon.glass)].polygons.push(corners);
    }
    for wall in &world.wall {
        let corners = self::wall(source, wall)?;
        solids[usize::from(wall.get_ref().glass)].polygons.push(corners);
    }
    for circle in &world.circle {
        let CircleTable { x, y, radius, glass } = circle.get_ref();
        source.coordinates(circle.span(), "circle", &[*x, *y])?;
        solids[usize::from(*glass)].discs.push(Disc {
            center: Point2::new(*x, *y),
            radius: source.positive(radius, "circle.radius")?,
        });
    }
    Ok(solids)
}

/// The part intended for driving: as written, or the map's.
fn bounds(
    source: Source<'_>,
    world: &WorldFile,
    map: Option<&OccupancyGrid>,
) -> Result<(Point2<f64>, Point2<f64>), WorldError> {
    let from_map = map.map(|map| (map.spec().origin, map.spec().upper()));
    let low = match (&world.origin, from_map) {
        (Some(origin), _) => {
            source.coordinates(origin.span(), "origin", &origin.get_ref().0)?;
            Point2::from(*origin.get_ref())
        }
        (None, Some((low, _))) => low,
        (None, None) => Point2::origin(),
    };
    let high = match (&world.size, from_map) {
        (Some(size), _) => {
            let Pair([width, height]) = *size.get_ref();
            source.coordinates(size.span(), "size", &[width, height])?;
            if !(width > 0.0 && height > 0.0) {
                return source.fail(
                    size.span(),
                    "size",
                    format!("{width} x {height}: expected positive numbers"),
                );
            }
            Point2::new(low.x + width, low.y + height)
        }
        (None, Some((_, high))) => high,
        (None, None) => return source.fail(0..0, "size", "missing: a world without a map needs one"),
    };
    Ok((low, high))
}

/// A wall is a rectangle around the line between its ends.
fn wall(source: Source<'_>, wall: &Spanned<WallTable>) -> Result<Vec<Point2<f64>>, WorldError> {
    let WallTable {
        from, to, thickness, ..
    } = wall.get_ref();
    source.coordinates(wall.span(), "wall.from", &from.0)?;
    source.coordinates(to.span(), "wall.to", &to.get_ref().0)?;
    let half = 0.5 * source.positive(thickness, "wall.thickness")?;
    let (from, to) = (Point2::from(*from), Point2::from(*to.get_ref()));
    let along = to - from;
    if along.norm() <= 1e-6 {
        return source.fail(wall.get_ref().to.span(), "wall.to", "the same point as `from`");
    }
    let aside = nalgebra::Vector2::new(-along.y, along.x) * (half / along.norm());
    Ok(vec![from - aside, to - aside, to + aside, from + aside])
}

fn places(source: Source<'_>, tables: &[Spanned<PlaceTable>]) -> Result<Vec<Place>, WorldError> {
    let mut places: Vec<Place> = Vec::with_capacity(tables.len());
    for table in tables {
        let PlaceTable {
            name: written,
            x,
            y,
            yaw,
        } = table.get_ref();
        let name = match Id::new(written.get_ref().clone()) {
            Ok(name) => name,
            Err(error) => return source.fail(written.span(), "place.name", error.to_string()),
        };
        if places.iter().any(|place| place.name == name) {
            return source.fail(written.span(), "place.name", format!("`{name}` is taken"));
        }
        source.coordinates(table.span(), "place", &[*x, *y, yaw.unwrap_or(0.0)])?;
        source.heading(table.span(), "place.yaw", yaw.unwrap_or(0.0))?;
        places.push(Place {
            name,
            x: *x,
            y: *y,
            yaw: *yaw,
        });
    }
    Ok(places)
}
