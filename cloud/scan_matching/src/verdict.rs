//! Verdict. Decides whether a scan fits at its pose.
//!
//! Two numbers that a covariance does not have: the share of the points explained by a known surface, and the share of the beams that go
//! through a wall (as emcl2 does). A pose in the wrong room can score well on the first; seldom on both. Beams that pass what moved say
//! nothing ([`standing()`]).

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;

use crate::field::{LikelihoodField, placed};
use crate::settings::VerdictSettings;

/// A beam that meets a surface, but not this far to its left or to its right, passes its edge, m.
const ASIDE: f64 = 0.08;

/// The verdict on a scan at a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// Share of the points that lie on a known surface, 0 to 1.
    pub explained: f64,
    /// Share of the beams that pass a known surface well before their end, or its edge, 0 to 1.
    pub through_walls: f64,
    /// Share of the beams that pass one not at its edge: in a narrow door, many beams pass a jamb.
    pub surely_through_walls: f64,
}

/// Judges a pose `field_from_scan`. `origin`: where the beams begin, `points`: where they end, both in the frame of the scan, m.
///
/// Cost: one lookup per cell along each beam, three for a beam that meets a surface.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_protocol::geometry::Pose2;
/// # use zenav_scan_matching::{FieldSettings, LikelihoodField, VerdictSettings, judge};
/// let wall: Vec<_> = (-50..=50).map(|i| Point2::new(2.0, 0.02 * f64::from(i))).collect();
/// let mut field = LikelihoodField::new(&FieldSettings::default());
/// field.insert(Pose2::IDENTITY, &wall);
/// let settings = VerdictSettings::default();
/// let here = judge(&field, Point2::origin(), &wall, Pose2::IDENTITY, &settings);
/// assert_eq!((here.explained, here.through_walls), (1.0, 0.0));
/// // 1 m farther ahead every beam would end behind the wall.
/// let ahead = judge(&field, Point2::origin(), &wall, Pose2::new(1.0, 0.0, 0.0), &settings);
/// assert_eq!((ahead.explained, ahead.through_walls), (0.0, 1.0));
/// ```
#[must_use]
pub fn judge(
    field: &LikelihoodField,
    origin: Point2<f64>,
    points: &[Point2<f64>],
    field_from_scan: Pose2,
    settings: &VerdictSettings,
) -> Verdict {
    if points.is_empty() {
        return Verdict {
            explained: 0.0,
            through_walls: 0.0,
            surely_through_walls: 0.0,
        };
    }
    let from = field_from_scan.transform_point(origin);
    let (mut explained, mut through, mut surely_through) = (0_usize, 0_usize, 0_usize);
    for end in placed(field_from_scan, points) {
        explained += usize::from(field.at(end) >= settings.explained);
        let beam = end - from;
        let length = beam.norm();
        let (steps, step) = cells(beam, field.spec().resolution, settings);
        let meets = |start: Point2<f64>| (0..steps).any(|count| field.at(start + step * count as f64) >= settings.wall);
        let aside = Vector2::new(-beam.y, beam.x) * (ASIDE / length.max(f64::MIN_POSITIVE));
        if meets(from) {
            through += 1;
            surely_through += usize::from(meets(from + aside) && meets(from - aside));
        }
    }
    Verdict {
        explained: explained as f64 / points.len() as f64,
        through_walls: through as f64 / points.len() as f64,
        surely_through_walls: surely_through as f64 / points.len() as f64,
    }
}

/// Number of cells along a beam up to its own end, and the step from one to the next, m.
fn cells(beam: Vector2<f64>, resolution: f64, settings: &VerdictSettings) -> (usize, Vector2<f64>) {
    let length = beam.norm();
    let count = ((length - settings.own_end) / resolution).floor().max(0.0) as usize;
    (count, beam * (resolution / length.max(f64::MIN_POSITIVE)))
}

/// The surfaces of a field that stood still: those that more of its scans pass than see are left out, such as the trail of a person who
/// walked along. The result is for [`judge()`]; elsewhere the original field counts. `scans`: those that the field was drawn from, each
/// with its pose, `field_from_scan`, and with the origin and the ends of its beams in its own frame, m.
///
/// Cost: that of judging each scan, and some bytes per cell.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_protocol::geometry::Pose2;
/// # use zenav_scan_matching::{FieldSettings, LikelihoodField, VerdictSettings, judge, standing};
/// // Somebody walks 1.5 m ahead of the laser towards a wall, covers a third of it, and goes away.
/// let scan = |x: f64| -> Vec<Point2<f64>> {
///     let end = |i: i32| if x < 3.0 && i.abs() < 17 { Point2::new(1.5, 0.02 * f64::from(i)) } else { Point2::new(6.0 - x, 0.02 * f64::from(i)) };
///     (-50..=50).map(end).collect()
/// };
/// let scans: Vec<_> = (0..12).map(|i| (Pose2::new(0.4 * f64::from(i), 0.0, 0.0), scan(0.4 * f64::from(i)))).collect();
/// let mut field = LikelihoodField::new(&FieldSettings::default());
/// for (pose, points) in &scans {
///     field.insert(*pose, points);
/// }
/// let settings = VerdictSettings::default();
/// let still = standing(&field, scans.iter().map(|(pose, points)| (*pose, Point2::origin(), points.as_slice())), &settings);
/// // When nobody is there, all beams pass the trail; in what stood still, few pass anything.
/// let alone: Vec<_> = (-50..=50).map(|i| Point2::new(6.0, 0.02 * f64::from(i))).collect();
/// let through = |field| judge(field, Point2::origin(), &alone, Pose2::IDENTITY, &settings).through_walls;
/// assert!(through(&field) > 0.9 && through(&still) < 0.3, "{} {}", through(&field), through(&still));
/// let behind: Vec<_> = alone.iter().map(|end| end + nalgebra::Vector2::x()).collect();
/// assert_eq!(judge(&still, Point2::origin(), &behind, Pose2::IDENTITY, &settings).through_walls, 1.0);
/// ```
#[must_use]
pub fn standing<'s>(
    field: &LikelihoodField,
    scans: impl Iterator<Item = (Pose2, Point2<f64>, &'s [Point2<f64>])>,
    settings: &VerdictSettings,
) -> LikelihoodField {
    let resolution = field.spec().resolution;
    let mut values = field.values().to_vec();
    // For each cell: the scans that see it less those that pass it, and the last scan that did either, from 1.
    let mut balance = vec![0_i32; values.len()];
    let mut last = vec![[0_u32; 2]; values.len()];
    for ((field_from_scan, origin, points), number) in scans.zip(1..) {
        let from = field_from_scan.transform_point(origin);
        let mut count = |point: Point2<f64>, which: usize| {
            if let Some(cell) = field.index(point)
                && std::mem::replace(&mut last[cell][which], number) != number
            {
                balance[cell] += if which == 0 { 1 } else { -1 };
            }
        };
        for end in placed(field_from_scan, points) {
            for (x, y) in (-1..=1).flat_map(|x| (-1..=1).map(move |y| (x, y))) {
                // A surface fills the cells beside its points, too.
                count(end + Vector2::new(f64::from(x), f64::from(y)) * resolution, 0);
            }
            let (steps, step) = cells(end - from, resolution, settings);
            (0..steps).for_each(|index| count(from + step * index as f64, 1));
        }
    }
    for (value, balance) in values.iter_mut().zip(balance) {
        if balance < 0 {
            *value = 0;
        }
    }
    LikelihoodField::from_values(*field.spec(), values).unwrap_or_else(|| field.clone())
}
