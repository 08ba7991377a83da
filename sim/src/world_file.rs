//! How is a world written down? TOML in metres and radians; whatever is wrong is named with file, line and key.

use nalgebra::Point2;
use serde::Deserialize;
use toml::Spanned;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::id::Id;

use crate::movers::{MoverModel, Route};
use crate::shape::{Disc, Shape};
use crate::world::{Parts, Place};
use crate::world_check::{MAX_ALL_CORNERS, MAX_MOVER_SPEED, MAX_MOVERS, MAX_REST, MAX_SHAPES, Source, WorldError};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WorldFile {
    name: Option<Spanned<String>>,
    size: Option<Spanned<[f64; 2]>>,
    origin: Option<Spanned<[f64; 2]>>,
    start: Option<Spanned<StartTable>>,
    map: Option<MapTable>,
    #[serde(default)]
    polygon: Vec<PolygonTable>,
    #[serde(default)]
    circle: Vec<Spanned<CircleTable>>,
    #[serde(default)]
    wall: Vec<Spanned<WallTable>>,
    #[serde(default)]
    mover: Vec<Spanned<MoverTable>>,
    #[serde(default)]
    door: Vec<Spanned<DoorTable>>,
    #[serde(default)]
    place: Vec<Spanned<PlaceTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StartTable {
    x: f64,
    y: f64,
    #[serde(default)]
    yaw: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MapTable {
    yaml: Spanned<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PolygonTable {
    points: Spanned<Vec<[f64; 2]>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CircleTable {
    x: f64,
    y: f64,
    radius: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WallTable {
    from: [f64; 2],
    to: Spanned<[f64; 2]>,
    thickness: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MoverTable {
    radius: Option<Spanned<f64>>,
    polygon: Option<Spanned<Vec<[f64; 2]>>>,
    path: Option<Spanned<Vec<[f64; 2]>>>,
    rest_secs: Option<Spanned<Vec<f64>>>,
    walk: Option<Spanned<[[f64; 2]; 2]>>,
    start: Option<Spanned<[f64; 2]>>,
    speed: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DoorTable {
    from: [f64; 2],
    to: Spanned<[f64; 2]>,
    thickness: Spanned<f64>,
    closed_secs: Spanned<f64>,
    open_secs: Spanned<f64>,
    #[serde(default = "slide_secs")]
    slide_secs: Spanned<f64>,
    #[serde(default)]
    starts_open: bool,
}

/// Time that a door takes to slide where its table does not say, s.
fn slide_secs() -> Spanned<f64> {
    Spanned::new(0..0, 2.0)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlaceTable {
    name: Spanned<String>,
    x: f64,
    y: f64,
    yaw: Option<f64>,
}

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
            Pose2::new(x, y, yaw)
        }
    };
    let mut polygons = Vec::with_capacity(world.polygon.len() + world.wall.len());
    for polygon in &world.polygon {
        polygons.push(source.polygon(&polygon.points, "polygon.points")?);
    }
    for wall in &world.wall {
        polygons.push(self::wall(source, wall)?);
    }
    let mut discs = Vec::with_capacity(world.circle.len());
    for circle in &world.circle {
        let CircleTable { x, y, radius } = circle.get_ref();
        source.coordinates(circle.span(), "circle", &[*x, *y])?;
        discs.push(Disc {
            center: Point2::new(*x, *y),
            radius: source.positive(radius, "circle.radius")?,
        });
    }
    let movers = world
        .mover
        .iter()
        .map(|mover| self::mover(source, mover))
        .chain(world.door.iter().map(|door| self::door(source, door)))
        .collect::<Result<_, _>>()?;
    let places = places(source, &world.place)?;
    Ok(Parts {
        name,
        low,
        high,
        start,
        polygons,
        discs,
        map,
        movers,
        places,
    })
}

/// The part to be driven in: as written, or the map's.
fn bounds(
    source: Source<'_>,
    world: &WorldFile,
    map: Option<&OccupancyGrid>,
) -> Result<(Point2<f64>, Point2<f64>), WorldError> {
    let from_map = map.map(|map| (map.spec().origin, map.spec().upper()));
    let low = match (&world.origin, from_map) {
        (Some(origin), _) => {
            source.coordinates(origin.span(), "origin", origin.get_ref())?;
            Point2::from(*origin.get_ref())
        }
        (None, Some((low, _))) => low,
        (None, None) => Point2::origin(),
    };
    let high = match (&world.size, from_map) {
        (Some(size), _) => {
            let [width, height] = *size.get_ref();
            source.coordinates(size.span(), "size", size.get_ref())?;
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
    let WallTable { from, to, thickness } = wall.get_ref();
    source.coordinates(wall.span(), "wall.from", from)?;
    source.coordinates(to.span(), "wall.to", to.get_ref())?;
    let half = 0.5 * source.positive(thickness, "wall.thickness")?;
    let (from, to) = (Point2::from(*from), Point2::from(*to.get_ref()));
    let along = to - from;
    if along.norm() <= 1e-6 {
        return source.fail(wall.get_ref().to.span(), "wall.to", "the same point as `from`");
    }
    let aside = nalgebra::Vector2::new(-along.y, along.x) * (half / along.norm());
    Ok(vec![from - aside, to - aside, to + aside, from + aside])
}

fn mover(source: Source<'_>, mover: &Spanned<MoverTable>) -> Result<MoverModel, WorldError> {
    let MoverTable {
        radius,
        polygon,
        path,
        rest_secs,
        walk,
        start,
        speed,
    } = mover.get_ref();
    let shape = match (radius, polygon) {
        (Some(radius), None) => Shape::Disc(source.positive(radius, "mover.radius")?),
        (None, Some(polygon)) => Shape::Polygon(source.polygon(polygon, "mover.polygon")?),
        _ => return source.fail(mover.span(), "mover", "expected either `radius` or `polygon`"),
    };
    let route = match (path, walk) {
        (Some(path), None) => {
            if let Some(start) = start {
                return source.fail(start.span(), "mover.start", "a path starts at its first point");
            }
            let corners = source.points(path, "mover.path", 1)?;
            let rests = match rest_secs {
                None => vec![0.0; corners.len()],
                Some(rests) => self::rests(source, rests, corners.len())?,
            };
            Route::Path(corners.into_iter().zip(rests).collect())
        }
        (None, Some(walk)) => self::walk(source, walk, start.as_ref())?,
        _ => return source.fail(mover.span(), "mover", "expected either `path` or `walk`"),
    };
    let metres_per_second = *speed.get_ref();
    if !(0.0..=MAX_MOVER_SPEED).contains(&metres_per_second) {
        return source.fail(
            speed.span(),
            "mover.speed",
            format!("{metres_per_second}: expected 0 to {MAX_MOVER_SPEED}"),
        );
    }
    Ok(MoverModel {
        shape,
        route,
        speed: metres_per_second,
    })
}

/// How long a mover rests at each corner.
fn rests(source: Source<'_>, rests: &Spanned<Vec<f64>>, corners: usize) -> Result<Vec<f64>, WorldError> {
    let values = rests.get_ref();
    if values.len() != corners || !values.iter().all(|secs| (0.0..=MAX_REST).contains(secs)) {
        return source.fail(
            rests.span(),
            "mover.rest_secs",
            format!("expected {corners} numbers, one for each point of `path`, 0 to {MAX_REST}"),
        );
    }
    Ok(values.clone())
}

/// A box to walk in; the walker starts in its middle, or where it is told to.
fn walk(
    source: Source<'_>,
    walk: &Spanned<[[f64; 2]; 2]>,
    start: Option<&Spanned<[f64; 2]>>,
) -> Result<Route, WorldError> {
    let [low, high] = *walk.get_ref();
    source.coordinates(walk.span(), "mover.walk", &[low[0], low[1], high[0], high[1]])?;
    if low[0] > high[0] || low[1] > high[1] {
        return source.fail(
            walk.span(),
            "mover.walk",
            "expected the lower-left corner before the upper-right one",
        );
    }
    let (low, high) = (Point2::from(low), Point2::from(high));
    let start = match start {
        None => nalgebra::center(&low, &high),
        Some(start) => {
            source.coordinates(start.span(), "mover.start", start.get_ref())?;
            Point2::from(*start.get_ref())
        }
    };
    Ok(Route::Walk { start, low, high })
}

/// A door shuts the way between two points, and slides aside by its own length.
fn door(source: Source<'_>, door: &Spanned<DoorTable>) -> Result<MoverModel, WorldError> {
    let DoorTable {
        from,
        to,
        thickness,
        closed_secs,
        open_secs,
        slide_secs,
        starts_open,
    } = door.get_ref();
    source.coordinates(door.span(), "door.from", from)?;
    source.coordinates(to.span(), "door.to", to.get_ref())?;
    let half = 0.5 * source.positive(thickness, "door.thickness")?;
    for (secs, key) in [(closed_secs, "door.closed_secs"), (open_secs, "door.open_secs")] {
        if !(0.0..=MAX_REST).contains(secs.get_ref()) {
            return source.fail(
                secs.span(),
                key,
                format!("{}: expected 0 to {MAX_REST}", secs.get_ref()),
            );
        }
    }
    let slide = source.positive(slide_secs, "door.slide_secs")?;
    let (from, to_point) = (Point2::from(*from), Point2::from(*to.get_ref()));
    let along = to_point - from;
    let speed = along.norm() / slide;
    if along.norm() <= 1e-6 || speed > MAX_MOVER_SPEED {
        return source.fail(
            to.span(),
            "door.to",
            format!("expected another point than `from`, and to slide at {MAX_MOVER_SPEED} m/s at most"),
        );
    }
    let aside = nalgebra::Vector2::new(-along.y, along.x) * (half / along.norm());
    let middle = nalgebra::center(&from, &to_point);
    let corners = [from - aside, to_point - aside, to_point + aside, from + aside];
    let mut path = vec![(middle, *closed_secs.get_ref()), (middle + along, *open_secs.get_ref())];
    if *starts_open {
        path.reverse();
    }
    Ok(MoverModel {
        shape: Shape::Polygon(corners.map(|corner| Point2::from(corner - middle)).to_vec()),
        route: Route::Path(path),
        speed,
    })
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
        places.push(Place {
            name,
            x: *x,
            y: *y,
            yaw: *yaw,
        });
    }
    Ok(places)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::shape;
    use crate::world::World;
    use proptest::prelude::*;
    use zenav_protocol::grid::{GridSpec, Occupancy};

    const HEAD: &str = "name = \"w\"\nsize = [5, 6.0]\norigin = [-1.0, 0]\n";

    fn error(body: &str) -> String {
        World::from_toml(&format!("{HEAD}{body}"), "w.toml", &|path| {
            Err(format!("no file {path}"))
        })
        .err()
        .unwrap()
        .to_string()
    }

    #[test]
    fn everything_a_world_may_hold_is_read() {
        let text = format!(
            "{HEAD}[start]\nx = 1\ny = 2\n[[polygon]]\npoints = [[0,0],[0,1],[1,0]]\n[[circle]]\nx = 3\ny = 3\nradius = 0.5\n[[wall]]\nfrom = [0,5]\nto = [4,5]\nthickness = 0.1\n\
             [[mover]]\nradius = 0.25\npath = [[0,3],[1,3]]\nspeed = 0.5\n[[mover]]\npolygon = [[0,0],[0.3,0],[0,0.3]]\npath = [[0,3]]\nspeed = 0\n\
             [[mover]]\nradius = 0.2\nwalk = [[0,0],[1,1]]\nspeed = 1\n[[door]]\nfrom = [0,4]\nto = [1,4]\nthickness = 0.05\nclosed_secs = 5\nopen_secs = 3\n[[place]]\nname = \"sink\"\nx = 0.88\ny = 0.09\nyaw = 1\n"
        );
        let world = World::from_toml(&text, "w.toml", &|_| Err(String::new())).unwrap();
        assert_eq!(world.bounds(), (Point2::new(-1.0, 0.0), Point2::new(4.0, 6.0)));
        assert_eq!(
            (world.polygons().len(), world.discs().len(), world.movers().len()),
            (2, 1, 4)
        );
        assert!(
            world
                .polygons()
                .iter()
                .all(|polygon| shape::doubled_area(polygon) > 0.0)
        );
        assert_eq!(world.place("sink").unwrap().yaw, Some(1.0));
    }

    #[test]
    fn a_wrong_key_or_value_is_named_with_file_line_and_key() {
        for (body, expected) in [
            ("colour = 1\n", ["w.toml:4:", "colour"]),
            ("[start]\nx = 1\ny = 2\nz = 3\n", ["w.toml:7:", "`z`"]),
            (
                "[[circle]]\nx = 1\ny = 2\nradius = -1\n",
                ["w.toml:7:", "circle.radius"],
            ),
            ("[[circle]]\nx = nan\ny = 2\nradius = 1\n", ["w.toml:4:", "circle"]),
            ("[[polygon]]\npoints = [[0,0],[1,1]]\n", ["w.toml:5:", "polygon.points"]),
            (
                "[[polygon]]\npoints = [[0,0],[1,1],[1,0],[0,1]]\n",
                ["w.toml:5:", "meets itself"],
            ),
            (
                "[[polygon]]\npoints = [[0,0],[1,0],[2,0]]\n",
                ["w.toml:5:", "polygon.points"],
            ),
            (
                "[[polygon]]\npoints = [[0,0],[1,0],[1,0],[0,1]]\n",
                ["w.toml:5:", "twice in a row"],
            ),
            (
                "[[wall]]\nfrom = [0,0]\nto = [0,0]\nthickness = 1\n",
                ["w.toml:6:", "wall.to"],
            ),
            (
                "[[mover]]\npath = [[0,0]]\nspeed = 1\n",
                ["w.toml:4:", "either `radius` or `polygon`"],
            ),
            (
                "[[mover]]\nradius = 1\nspeed = 1\n",
                ["w.toml:4:", "either `path` or `walk`"],
            ),
            (
                "[[mover]]\nradius = 1\nspeed = 1\nwalk = [[1, 0], [0, 1]]\n",
                ["w.toml:7:", "mover.walk"],
            ),
            (
                "[[mover]]\nradius = 1\nspeed = 1\npath = [[1, 0], [0, 1]]\nrest_secs = [1]\n",
                ["w.toml:8:", "mover.rest_secs"],
            ),
            (
                "[[door]]\nfrom = [0, 0]\nto = [1, 0]\nthickness = 0.1\nclosed_secs = -1\nopen_secs = 1\n",
                ["w.toml:8:", "door.closed_secs"],
            ),
            (
                "[[door]]\nfrom = [0, 0]\nto = [0, 0]\nthickness = 0.1\nclosed_secs = 1\nopen_secs = 1\n",
                ["w.toml:6:", "door.to"],
            ),
            (
                "[[mover]]\nradius = 1\npath = []\nspeed = 1\n",
                ["w.toml:6:", "mover.path"],
            ),
            (
                "[[mover]]\nradius = 1\npath = [[0,0]]\nspeed = inf\n",
                ["w.toml:7:", "mover.speed"],
            ),
            ("[[place]]\nname = \"a/b\"\nx = 0\ny = 0\n", ["w.toml:5:", "place.name"]),
            (
                "[[place]]\nname = \"a\"\nx = 0\ny = 0\n[[place]]\nname = \"a\"\nx = 0\ny = 0\n",
                ["w.toml:9:", "taken"],
            ),
            ("[map]\nyaml = \"m.yaml\"\n", ["w.toml:5:", "m.yaml: no file m.yaml"]),
            ("size = 3\n", ["w.toml:4:", "size"]),
        ] {
            let error = error(body);
            assert!(expected.iter().all(|part| error.contains(part)), "{body}: {error}");
        }
        let bare = World::from_toml("", "w.toml", &|_| Err(String::new()))
            .err()
            .unwrap()
            .to_string();
        assert!(bare.contains("`size`"), "{bare}");
    }

    #[test]
    fn a_map_world_takes_its_bounds_from_the_map() {
        let spec = GridSpec {
            origin: Point2::new(-3.0, 1.0),
            resolution: 0.5,
            width: 4,
            height: 6,
        };
        let world = World::from_toml("[map]\nyaml = \"m.yaml\"\n", "dir/block.toml", &|path| {
            assert_eq!(path, "m.yaml");
            Ok(OccupancyGrid::filled(spec, Occupancy::OCCUPIED))
        });
        let world = world.unwrap();
        assert_eq!(world.name(), "block");
        assert_eq!(world.bounds(), (Point2::new(-3.0, 1.0), Point2::new(-1.0, 4.0)));
        assert!(world.is_solid(Point2::new(-2.0, 2.0)));
    }

    proptest! {
        #[test]
        fn no_text_panics_the_reader(body in "[a-z\\[\\]= 0-9.,\"\n]{0,120}") {
            let _ = World::from_toml(&format!("{HEAD}{body}"), "w.toml", &|_| Err(String::new()));
        }

        #[test]
        fn no_polygon_panics_the_reader(points in prop::collection::vec((-1.0..1.0, -1.0..1.0), 0..8)) {
            let points: Vec<[f64; 2]> = points.into_iter().map(|(x, y)| [x, y]).collect();
            let _ = World::from_toml(&format!("{HEAD}[[polygon]]\npoints = {points:?}\n"), "w.toml", &|_| Err(String::new()));
        }
    }
}
