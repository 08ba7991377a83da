//! Scan reprojection. Which beams of one scan pass through the returns of another? For all of its points at once.
//!
//! In single precision and without branches, so that the compiler vectorises it: an error of 1e-5 rad or of a micrometre is far below the
//! spacing of beams and the noise of ranges.

use std::f32::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry2, Point2};
use zenav_protocol::robot::LidarModel;

use crate::settings::ScanReprojectionSettings;

/// The beams of a lidar, and the points of a scan reprojected among them.
#[derive(Clone, Debug)]
pub(crate) struct ScanReprojection {
    /// Directions of the beams in the frame of the lidar.
    along: (Vec<f32>, Vec<f32>),
    /// Bearing of the first beam, rad.
    first: f32,
    beams_per_radian: f32,
    /// Whether the beams cover a full circle.
    closed: bool,
    /// A beam without a return saw free space up to here, m.
    range_max: f32,
    /// The reprojected points, m.
    points: (Vec<f32>, Vec<f32>),
    /// Their bearings, in beams from half a beam before the first.
    bearings: Vec<f32>,
    /// Their distances, m.
    distances: Vec<f32>,
    /// How much longer than a return's range a beam is that passes through it, m.
    pub(crate) depth: f64,
    /// How much farther away than measured a return may be, m.
    pub(crate) beyond: f64,
    settings: ScanReprojectionSettings,
}

impl ScanReprojection {
    pub(crate) fn new(lidar: &LidarModel, settings: ScanReprojectionSettings) -> Self {
        let angles = (0..lidar.beams).map(|beam| lidar.angle_min() + beam as f64 * lidar.angle_increment());
        Self {
            along: angles.map(|angle| (angle.cos() as f32, angle.sin() as f32)).unzip(),
            first: lidar.angle_min() as f32,
            beams_per_radian: (1.0 / lidar.angle_increment()) as f32,
            closed: lidar.gap() == 0.0,
            range_max: lidar.range_max as f32,
            points: (vec![0.0; lidar.beams], vec![0.0; lidar.beams]),
            bearings: vec![0.0; lidar.beams],
            distances: vec![0.0; lidar.beams],
            depth: settings.depth,
            beyond: 0.0,
            settings,
        }
    }

    /// Sets the standard deviation of a range, m.
    pub(crate) fn set_noise(&mut self, std_dev: f64) {
        self.depth = self.settings.depth + self.settings.depth_sigmas * std_dev;
        self.beyond = self.settings.point_sigmas * std_dev;
    }

    /// Up to which range each beam of a scan saw free space, m.
    pub(crate) fn free_ranges(&self, ranges: &[f32], free: &mut Vec<f32>) {
        let neighbours = self.settings.neighbours;
        let (depth, scale) = (self.depth as f32, (1.0 / (1.0 + self.settings.depth_per_metre)) as f32);
        free.clear();
        free.extend((0..ranges.len()).map(|beam| {
            let beams = beam.saturating_sub(neighbours)..(beam + neighbours + 1).min(ranges.len());
            let least = ranges.get(beams).unwrap_or_default().iter();
            // NaN counts as no range.
            let went = |range: &f32| if *range > 0.0 { range.min(self.range_max) } else { 0.0 };
            (least.map(went).fold(f32::INFINITY, f32::min) - depth) * scale
        }));
    }

    /// Reprojects the points of a scan, each `farther` (m) along its beam, into the lidar frame of another one.
    pub(crate) fn reproject(&mut self, there_from_here: &Isometry2<f64>, ranges: &[f32], farther: f64) {
        let (rotation, shift) = (there_from_here.rotation, there_from_here.translation.vector);
        let (cos, sin) = (rotation.re as f32, rotation.im as f32);
        let (east, north) = (shift.x as f32, shift.y as f32);
        let (first, scale, farther) = (self.first, self.beams_per_radian, farther as f32);
        let beams = self.along.0.iter().zip(&self.along.1).zip(ranges);
        let points = self.points.0.iter_mut().zip(&mut self.points.1);
        let laid = self.bearings.iter_mut().zip(&mut self.distances).zip(points);
        for (((x, y), range), ((bearing, distance), point)) in beams.zip(laid) {
            let range = range + farther;
            let (x, y) = ((cos * x - sin * y) * range + east, (sin * x + cos * y) * range + north);
            *bearing = (angle(x, y) - first) * scale + 0.5;
            *distance = (x * x + y * y).sqrt();
            (*point.0, *point.1) = (x, y);
        }
    }

    /// A reprojected point.
    pub(crate) fn point(&self, nth: usize) -> Option<Point2<f64>> {
        let (x, y) = (self.points.0.get(nth)?, self.points.1.get(nth)?);
        Some(Point2::new(f64::from(*x), f64::from(*y)))
    }

    /// For each reprojected point the beam that passes through it.
    pub(crate) fn beams_through<'a>(&'a self, free: &'a [f32]) -> impl Iterator<Item = Option<usize>> + 'a {
        let last = if self.closed {
            free.len().saturating_sub(1)
        } else {
            usize::MAX
        };
        self.bearings
            .iter()
            .zip(&self.distances)
            .map(move |(bearing, distance)| {
                let beam = (*bearing as usize).min(last);
                let is_through = free.get(beam).is_some_and(|free| free > distance) && *bearing >= 0.0;
                is_through.then_some(beam)
            })
    }
}

/// The direction of a vector, rad, to 1e-5 (Abramowitz and Stegun, 4.4.49).
fn angle(x: f32, y: f32) -> f32 {
    let (wide, high) = (x.abs(), y.abs());
    let steep = high > wide;
    let (less, more) = if steep { (wide, high) } else { (high, wide) };
    let slope = less / (more + 1e-20);
    let s = slope * slope;
    let angle = slope * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    let angle = if steep { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    angle.copysign(y)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    #[test]
    fn bearings_are_accurate_to_2e_5_rad() {
        for step in -3141..=3141 {
            let at = step as f32 * 1e-3;
            assert!((angle(1.7 * at.cos(), 1.7 * at.sin()) - at).abs() < 2e-5, "{at}");
        }
    }

    proptest! {
        /// Compared with one point at a time in double precision, except on the edge between two beams or at the free depth itself.
        #[test]
        fn a_beam_passes_through_points_nearer_than_itself_and_its_neighbours(
            name in prop::sample::select(vec!["tiago", "neato"]),
            shift in (-1.0..1.0, -1.0..1.0, -3.0..3.0),
            ranges in prop::collection::vec((0.2_f32..6.0, 0.2_f32..6.0, 0_u8..20), 40),
        ) {
            let mut lidar = zenav_fixtures::robot(name).lidar.unwrap();
            lidar.beams = ranges.len();
            let (here, there): (Vec<f32>, Vec<f32>) = ranges
                .iter()
                .map(|(here, there, odd)| match odd {
                    0 => (*here, f32::NAN),
                    1 => (*here, f32::INFINITY),
                    _ => (*here, *there),
                })
                .unzip();
            let there_from_here = Isometry2::new(Vector2::new(shift.0, shift.1), shift.2);
            let settings = ScanReprojectionSettings::default();
            let mut reprojection = ScanReprojection::new(&lidar, settings);
            reprojection.set_noise(lidar.noise);
            let mut free = Vec::new();
            reprojection.free_ranges(&there, &mut free);
            reprojection.reproject(&there_from_here, &here, 0.0);
            for (nth, beam) in reprojection.beams_through(&free).enumerate() {
                let angle = lidar.angle_min() + nth as f64 * lidar.angle_increment();
                let point = Vector2::new(angle.cos(), angle.sin()) * f64::from(here[nth]);
                let point = there_from_here * Point2::from(point);
                prop_assert!((reprojection.point(nth).unwrap() - point).norm() < 1e-5);
                let bearing = (point.y.atan2(point.x) - lidar.angle_min()) / lidar.angle_increment() + 0.5;
                let distance = point.coords.norm();
                let free_depth = distance + settings.depth + settings.depth_sigmas * lidar.noise + settings.depth_per_metre * distance;
                let last = (lidar.beams - 1) as f64;
                let at = if name == "neato" { bearing.floor().min(last) } else { bearing.floor() };
                if (bearing - bearing.round()).abs() < 1e-3 {
                    continue;
                }
                let beams: Vec<f64> = (0..lidar.beams)
                    .filter(|beam| (*beam as f64 - at).abs() <= settings.neighbours as f64)
                    .map(|beam| f64::from(there[beam]))
                    // A beam without a return is free as far as the lidar reaches; NaN stays.
                    .map(|range| if range > lidar.range_max { lidar.range_max } else { range })
                    .collect();
                if beams.iter().any(|range| (range - free_depth).abs() < 1e-4) {
                    continue;
                }
                let expected = (at >= 0.0 && at <= last && beams.iter().all(|range| *range > free_depth)).then_some(at as usize);
                prop_assert_eq!(beam, expected);
            }
        }
    }
}
