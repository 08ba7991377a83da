//! World file. TOML in metres and radians; errors name file, line and key.

mod faults;
mod moving;
mod tables;
#[cfg(test)]
mod tests;

use nalgebra::Point2;
use toml::Spanned;
use zenav_protocol::config_text::Pair;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::id::Id;

use crate::shape::Disc;
use crate::world::{Parts, Place, Solids, within};
use crate::world_check::{MAX_ALL_CORNERS, MAX_MOVERS, MAX_SHAPES, Source, WorldError};
use tables::{CircleTable, PlaceTable, StartTable, WallTable, WorldFile};

/// Reads and checks a world file's text.
pub(crate) fn read(
    text: &str,
    file: &str,
    load_map: &dyn Fn(&str) -> Result<OccupancyGrid, String>,
) -> Result<Parts, WorldError> {
    let source = Source { text, file };
    let world: WorldFile = toml::from_str(text).map_err(|error| {
        let line = source.line(error.span().unwrap_or(0..0));
        WorldError::Toml {
            file: file.to_owned(),
            line,
            source: Box::new(error),
        }
    })?;
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
    let name = match &world.name {
        Some(name) if name.get_ref().is_empty() || name.get_ref().len() > 100 => {
            return source.fail(name.span(), "name", "expected 1 to 100 characters");
        }
        Some(name) => name.get_ref().clone(),
        None => file
            .rsplit(['/', '\\'])
            .next()
            .unwrap_or(file)
            .trim_end_matches(".toml")
            .to_owned(),
    };
    let map = match &world.map {
        None => None,
        Some(table) => match load_map(table.yaml.get_ref()) {
            Ok(map) => Some(map),
            Err(reason) => {
                return source.fail(
                    table.yaml.span(),
                    "map.yaml",
                    format!("{}: {reason}", table.yaml.get_ref()),
                );
            }
        },
    };
    let (low, high) = bounds(source, &world, map.as_ref())?;
    let start = match &world.start {
        None => Pose2::IDENTITY,
        Some(start) => {
            let StartTable { x, y, yaw } = *start.get_ref();
            source.coordinates(start.span(), "start", &[x, y, yaw])?;
            source.heading(start.span(), "start.yaw", yaw)?;
            if !within(low, high, Point2::new(x, y)) {
                let problem = format!(
                    "({x}, {y}) lies outside of the world: expected {} to {} by {} to {}",
                    low.x, high.x, low.y, high.y
                );
                return source.fail(start.span(), "start", problem);
            }
            Pose2::new(x, y, yaw)
        }
    };
    let (mut seen, mut glass) = (Solids::default(), Solids::default());
    for polygon in &world.polygon {
        let solids = if polygon.glass { &mut glass } else { &mut seen };
        solids.polygons.push(source.polygon(&polygon.points, "polygon.points")?);
    }
    for wall in &world.wall {
        let solids = if wall.get_ref().glass { &mut glass } else { &mut seen };
        solids.polygons.push(self::wall(source, wall)?);
    }
    for circle in &world.circle {
        let CircleTable {
            x,
            y,
            radius,
            glass: is_glass,
        } = circle.get_ref();
        source.coordinates(circle.span(), "circle", &[*x, *y])?;
        let solids = if *is_glass { &mut glass } else { &mut seen };
        solids.discs.push(Disc {
            center: Point2::new(*x, *y),
            radius: source.positive(radius, "circle.radius")?,
        });
    }
    let movers = world
        .mover
        .iter()
        .map(|mover| moving::mover(source, mover))
        .chain(world.door.iter().map(|door| moving::door(source, door)))
        .collect::<Result<_, _>>()?;
    let faults = world.fault.iter().map(|fault| faults::fault(source, fault));
    Ok(Parts {
        name,
        low,
        high,
        start,
        seen,
        glass,
        map,
        movers,
        faults: faults.collect::<Result<_, _>>()?,
        places: places(source, &world.place)?,
    })
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
