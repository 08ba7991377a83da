//! Moving obstacles. The movers, walkers and doors of a world file.

use nalgebra::Point2;
use toml::Spanned;
use zenav_protocol::config_text::{Number, Pair};
use zenav_protocol::robot::Footprint;

use super::tables::{DoorTable, MoverTable};
use crate::manners::Manners;
use crate::movers::{MoverModel, Route};
use crate::world_check::{MAX_MOVER_SPEED, MAX_REST, Source, WorldError};

/// A moving obstacle on its path, or a walker in its box.
pub(super) fn mover(source: Source<'_>, mover: &Spanned<MoverTable>) -> Result<MoverModel, WorldError> {
    let MoverTable {
        radius,
        polygon,
        path,
        rest_secs,
        walk,
        start,
        speed,
        manners,
    } = mover.get_ref();
    let shape = match (radius, polygon) {
        (Some(radius), None) => Footprint::Radius(source.positive(radius, "mover.radius")?),
        (None, Some(polygon)) => Footprint::Polygon(source.polygon(polygon, "mover.polygon")?),
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
        (None, Some(walk)) => {
            if let Some(rests) = rest_secs {
                let problem = "a walker never rests: expected with `path` only";
                return source.fail(rests.span(), "mover.rest_secs", problem);
            }
            self::walk(source, walk, start.as_ref())?
        }
        _ => return source.fail(mover.span(), "mover", "expected either `path` or `walk`"),
    };
    let metres_per_second = *speed.get_ref();
    if !(0.0..=MAX_MOVER_SPEED).contains(&metres_per_second) {
        return source.fail(
            speed.span(),
            "mover.speed",
            format!("{}: expected 0 to {MAX_MOVER_SPEED}", Number(metres_per_second)),
        );
    }
    if let (Footprint::Polygon(_), Some(manners)) = (&shape, manners) {
        return source.fail(manners.span(), "mover.manners", "expected with `radius` only");
    }
    Ok(MoverModel {
        shape,
        route,
        speed: metres_per_second,
        manners: manners.as_ref().map_or(Manners::Blind, |manners| *manners.get_ref()),
    })
}

/// Rests of a mover at each corner.
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

/// A box to walk in; the walker starts at `start`, by default in the middle.
fn walk(source: Source<'_>, walk: &Spanned<Vec<Pair>>, start: Option<&Spanned<Pair>>) -> Result<Route, WorldError> {
    let [Pair(low), Pair(high)] = walk.get_ref()[..] else {
        let problem = format!("{} points: expected 2, opposite corners of a box", walk.get_ref().len());
        return source.fail(walk.span(), "mover.walk", problem);
    };
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
            source.coordinates(start.span(), "mover.start", &start.get_ref().0)?;
            Point2::from(*start.get_ref())
        }
    };
    Ok(Route::Walk { start, low, high })
}

/// A door shuts the gap between two points, and slides aside by its own length.
pub(super) fn door(source: Source<'_>, door: &Spanned<DoorTable>) -> Result<MoverModel, WorldError> {
    let DoorTable {
        from,
        to,
        thickness,
        closed_secs,
        open_secs,
        slide_secs,
        starts_open,
    } = door.get_ref();
    source.coordinates(door.span(), "door.from", &from.0)?;
    source.coordinates(to.span(), "door.to", &to.get_ref().0)?;
    let half = 0.5 * source.positive(thickness, "door.thickness")?;
    for (secs, key) in [(closed_secs, "door.closed_secs"), (open_secs, "door.open_secs")] {
        if !(0.0..=MAX_REST).contains(secs.get_ref()) {
            return source.fail(
                secs.span(),
                key,
                format!("{}: expected 0 to {MAX_REST}", Number(*secs.get_ref())),
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
        shape: Footprint::Polygon(corners.map(|corner| Point2::from(corner - middle)).to_vec()),
        route: Route::Path(path),
        speed,
        manners: Manners::Blind,
    })
}
