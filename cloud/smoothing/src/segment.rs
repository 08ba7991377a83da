//! Segment. The curve from one stop to the next: the best one through the corridor, which is tightened where the true footprint does not
//! fit.
//!
//! For a disc the polygons are enough. The extent of a longer robot depends on its heading, which is unknown before there is a curve:
//! polygons are first built for headings near each piece's own; the footprint is then swept along the curve, and where it collides, the
//! polygon is rebuilt for the headings there.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Point2;
use zenav_protocol::geometry::wrap_angle;
use zenav_protocol::robot::Footprint;

use super::corridor::{FreePolygon, SPREAD, corridor, free_polygon};
use super::curve::{Curve, CurveError, Sampled};
use super::fit::{Ends, fit};
use super::phases::Phases;
use super::settings::SmoothingSettings;
use super::timing::GeometricPath;
use zenav_space::ConfigurationSpace;

/// A curve that is free throughout.
#[derive(Clone, Debug)]
pub(super) struct Segment {
    pub(super) geometry: GeometricPath,
    pub(super) polygons: Vec<FreePolygon>,
    /// The curve; `None` if the path is one straight line.
    pub(super) curve: Option<Curve>,
}

/// Why there is no such curve.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum NoSegment {
    /// No curve was found.
    Curve(CurveError),
    /// The footprint collides at these places, m.
    Collides(Vec<Point2<f64>>),
    /// Time was up.
    TimedOut,
}

/// Largest number of times that a corridor is tightened.
const TIGHTENED: usize = 5;
/// A polygon is rebuilt for headings this much farther off than those of the curve, rad, and at least this many times its last spread.
const MARGIN: f64 = 0.05;
const GROWTH: f64 = 1.5;

/// The curve along a path (corner points) between two ends.
pub(super) fn segment(
    space: &ConfigurationSpace,
    path: &[Point2<f64>],
    ends: &Ends,
    settings: &SmoothingSettings,
    phases: &mut Phases<'_>,
) -> Result<Segment, NoSegment> {
    if let Some(geometry) = straight(path, ends, settings.step) {
        let (polygons, curve) = (Vec::new(), None);
        return Ok(Segment {
            geometry,
            polygons,
            curve,
        });
    }
    let is_long = matches!(space.footprint(), Footprint::Polygon(_));
    let mut polygons = phases.measure(|p| &mut p.corridor, || corridor(space, path, &settings.corridor));
    let mut spreads = vec![SPREAD; polygons.len()];
    let mut places = Vec::new();
    for _ in 0..=TIGHTENED {
        if phases.is_over() {
            return Err(NoSegment::TimedOut);
        }
        let fitted = phases.measure(
            |p| &mut p.geometry,
            || {
                let curve = fit(&polygons, ends, settings.turning_length, settings.max_iterations)?;
                let sampled = curve.sampled(settings.step)?;
                let hits = if is_long {
                    collisions(space, &sampled.geometry)
                } else {
                    Vec::new()
                };
                Ok((curve, sampled, hits))
            },
        );
        let (curve, sampled, hits) = match fitted {
            Ok(fitted) => fitted,
            Err(error) if places.is_empty() => return Err(NoSegment::Curve(error)),
            Err(_) => break,
        };
        if hits.is_empty() {
            let (geometry, curve) = (sampled.geometry, Some(curve));
            return Ok(Segment {
                geometry,
                polygons,
                curve,
            });
        }
        let points = sampled.geometry.points();
        places = hits
            .iter()
            .map(|hit| Point2::new(points[*hit].x, points[*hit].y))
            .collect();
        let widened = widen(&mut spreads, &polygons, &sampled, &hits);
        let tightened = phases.measure(
            |p| &mut p.corridor,
            || {
                let mut tightened = false;
                for i in widened {
                    let (from, to) = (polygons[i].from, polygons[i].to);
                    let tight = free_polygon(space, from, to, &settings.corridor, spreads[i]);
                    if tight.holds(from, 1e-6) && tight.holds(to, 1e-6) {
                        tightened |= tight.sides != polygons[i].sides;
                        polygons[i].sides = tight.sides;
                    }
                }
                tightened
            },
        );
        if !tightened {
            break;
        }
    }
    Err(NoSegment::Collides(places))
}

/// One straight line, if the ends admit it.
fn straight(path: &[Point2<f64>], ends: &Ends, step: f64) -> Option<GeometricPath> {
    let [from, to] = path else { return None };
    let along = to - from;
    let admits = [ends.start, ends.end]
        .into_iter()
        .flatten()
        .all(|tangent| tangent.direction.angle(&along) < 1e-6 && tangent.curvature.is_none_or(|k| k.abs() < 1e-6));
    admits.then(|| GeometricPath::straight(*from, *to, step)).flatten()
}

/// Samples after which the footprint collides before the next one.
fn collisions(space: &ConfigurationSpace, geometry: &GeometricPath) -> Vec<usize> {
    let points = geometry.points();
    (0..points.len() - 1)
        .filter(|i| !space.motion_is_free(points[*i].pose(), points[i + 1].pose()))
        .collect()
}

/// Widens the headings of the polygons in which there are collisions; returns the polygons that change.
fn widen(spreads: &mut [f64], polygons: &[FreePolygon], sampled: &Sampled, hits: &[usize]) -> Vec<usize> {
    let before = spreads.to_vec();
    for hit in hits {
        let i = sampled.ends.partition_point(|end| *end <= *hit).min(polygons.len() - 1);
        let off = [*hit, hit + 1].map(|sample| {
            let yaw = sampled.geometry.points()[sample].yaw;
            wrap_angle(yaw - polygons[i].heading()).abs()
        });
        let wider = (off[0].max(off[1]) + MARGIN).max(before[i] * GROWTH);
        spreads[i] = spreads[i].max(wider.min(FRAC_PI_2));
    }
    (0..spreads.len()).filter(|i| spreads[*i] > before[*i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_space::UnknownPolicy;

    /// A left turn between two halls of 0.8 m, for a robot of 0.8 m by 0.3 m with its base in front.
    #[test]
    fn a_corridor_is_tightened_until_a_long_robot_fits_round_its_corner() {
        let grid = zenav_fixtures::map_where(zenav_fixtures::spec(80, 80, 0.05), |at| {
            let east = (1.0..1.8).contains(&at.y) && at.x < 2.8;
            let north = (2.0..2.8).contains(&at.x) && at.y > 1.0;
            !(east || north)
        });
        let footprint = zenav_fixtures::footprint(&[(-0.6, -0.15), (0.2, -0.15), (0.2, 0.15), (-0.6, 0.15)]);
        let space = ConfigurationSpace::new(&grid, &footprint, UnknownPolicy::Blocked, 0.0);
        let path = [Point2::new(0.8, 1.6), Point2::new(2.3, 1.6), Point2::new(2.3, 3.5)];
        let (settings, mut clock) = (SmoothingSettings::default(), || 0.0);
        let mut phases = Phases::new(&mut clock, None);
        let loose = fit(&corridor(&space, &path, &settings.corridor), &Ends::default(), 0.25, 50).unwrap();
        let loose = loose.sampled(settings.step).unwrap();
        let found = segment(&space, &path, &Ends::default(), &settings, &mut phases).unwrap();
        assert!(
            !collisions(&space, &loose.geometry).is_empty(),
            "it takes the true footprint to tell"
        );
        assert!(collisions(&space, &found.geometry).is_empty());
    }
}
