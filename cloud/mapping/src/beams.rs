//! Beams. Selects the usable beams of a scan and computes their ends.

use std::f64::consts::TAU;

use nalgebra::{Point2, Vector2};
use zenav_protocol::messages::Scan;

use crate::settings::BeamSettings;

/// Anchor and scale of a grid: converts points of the map frame to cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CellFrame {
    /// Lower-left corner of cell (0, 0), m.
    pub anchor: Point2<f64>,
    /// Side of a cell, m.
    pub resolution: f64,
}

impl CellFrame {
    /// A point of the map frame in cells from the anchor.
    #[inline]
    #[must_use]
    pub fn cells(&self, p: Point2<f64>) -> Point2<f64> {
        Point2::new(
            (p.x - self.anchor.x) / self.resolution,
            (p.y - self.anchor.y) / self.resolution,
        )
    }
}

/// One beam, in cells from the map's anchor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Beam {
    /// End of the beam.
    pub end: Point2<f64>,
    /// Direction of the beam, of length one.
    pub direction: Vector2<f64>,
    /// Length of the beam.
    pub length: f64,
    /// Number of the beam in the sweep: neighbours differ by one.
    pub number: usize,
    /// Whether the beam hit an obstacle at its end.
    pub hit: bool,
}

/// Converts scans to beams. Caches the directions of the sweep's geometry, which rarely changes.
#[derive(Clone, Debug, Default)]
pub(crate) struct BeamReader {
    geometry: (f64, f64),
    directions: Vec<[f64; 2]>,
}

impl BeamReader {
    /// Appends the usable beams of a sane scan.
    pub fn read(&mut self, scan: &Scan, settings: &BeamSettings, frame: &CellFrame, beams: &mut Vec<Beam>) {
        let count = scan.ranges.len();
        if self.directions.len() != count || self.geometry != (scan.angle_min, scan.angle_increment) {
            self.geometry = (scan.angle_min, scan.angle_increment);
            self.directions = (0..count).map(|beam| scan.angle(beam).sin_cos().into()).collect();
        }
        let full_circle = scan.angle_increment * (count as f64 + 0.5) > TAU;
        let trim = if full_circle { 0 } else { settings.trim.min(count) };
        let usable = settings
            .max_range
            .filter(|range| *range > 0.0)
            .map_or(scan.range_max, |range| range.min(scan.range_max));
        let mut moving = scan.moving.iter().peekable();
        let laser = scan.map_from_laser();
        let (origin, per_metre) = (frame.cells(laser.position()), frame.resolution.recip());
        let (yaw_sin, yaw_cos) = laser.yaw.sin_cos();
        let (mut gap_end, mut gap_least) = (0, f64::INFINITY);
        for (number, (range, [sin, cos])) in scan
            .ranges
            .iter()
            .zip(&self.directions)
            .enumerate()
            .take(count - trim)
            .skip(trim)
        {
            let measured = f64::from(*range);
            while moving.next_if(|[_, end]| *end as usize <= number).is_some() {}
            let on_moving = moving.peek().is_some_and(|[first, _]| *first as usize <= number);
            let hit = measured <= usable && !on_moving;
            if measured.is_nan()
                || measured < scan.range_min
                || (measured > scan.range_max && !settings.clear_without_return)
            {
                continue;
            }
            // A lost beam looks like a beam that hit nothing.
            let seen = if measured > scan.range_max {
                if number >= gap_end {
                    (gap_end, gap_least) = gap(scan, number, settings.lost_run);
                }
                gap_least
            } else {
                measured
            };
            let length = seen.min(usable) * per_metre;
            let direction = Vector2::new(yaw_cos * cos - yaw_sin * sin, yaw_sin * cos + yaw_cos * sin);
            beams.push(Beam {
                end: origin + direction * length,
                direction,
                length,
                number,
                hit,
            });
        }
    }
}

/// The end of a run of beams without a return that contains `first`, and how far these beams clear, m. A run of fewer than `lost` beams may
/// have been lost: it clears no farther than the neighbouring returns.
fn gap(scan: &Scan, first: usize, lost: usize) -> (usize, f64) {
    let is_gap = |beam: &usize| {
        scan.ranges
            .get(*beam)
            .is_some_and(|range| f64::from(*range) > scan.range_max)
    };
    let begin = (0..first).rev().take_while(is_gap).last().unwrap_or(first);
    let end = (first..scan.ranges.len())
        .take_while(is_gap)
        .last()
        .map_or(first, |last| last + 1);
    let is_return = |beam: &usize| scan.ranges.get(*beam).is_some_and(|range| scan.is_return(*range));
    // The next return on either side; invalid readings count for nothing.
    let before = (begin.saturating_sub(lost)..begin).rev().find(is_return);
    let after = (end..end + lost).find(is_return);
    let returns = [before, after]
        .into_iter()
        .flatten()
        .filter_map(|beam| scan.ranges.get(beam));
    let least = returns.fold(f64::INFINITY, |least, range| least.min(f64::from(*range)));
    (end, if end - begin < lost { least } else { f64::INFINITY })
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Pose2;

    use super::*;

    fn scan(angle_increment: f64, ranges: Vec<f32>) -> Scan {
        Scan {
            angle_min: 0.0,
            angle_increment,
            range_min: 0.1,
            range_max: 5.0,
            base_from_laser: Pose2::new(1.0, 0.0, 0.0),
            ..zenav_fixtures::scan(1, Pose2::new(0.0, 2.0, std::f64::consts::FRAC_PI_2), ranges)
        }
    }

    /// In cells of 0.5 m, whose anchor lies at (-1, 0).
    fn read(scan: &Scan, settings: &BeamSettings) -> Vec<Beam> {
        let frame = CellFrame {
            anchor: Point2::new(-1.0, 0.0),
            resolution: 0.5,
        };
        let mut beams = Vec::new();
        BeamReader::default().read(scan, settings, &frame, &mut beams);
        beams
    }

    #[test]
    fn a_beam_ends_where_the_laser_stands_and_looks() {
        let beams = read(
            &scan(0.1, vec![2.0]),
            &BeamSettings {
                trim: 0,
                ..BeamSettings::default()
            },
        );
        assert!((beams[0].end - Point2::new(2.0, 10.0)).norm() < 1e-12 && beams[0].hit);
    }

    #[test]
    fn readings_that_mean_nothing_are_dropped_and_far_ones_clear() {
        let scan = scan(0.1, vec![0.05, f32::NAN, -1.0, 1.0, 4.5, f32::INFINITY]);
        let settings = BeamSettings {
            trim: 0,
            max_range: Some(4.0),
            clear_without_return: true,
            lost_run: 0,
        };
        let beams = read(&scan, &settings);
        assert_eq!(
            beams
                .iter()
                .map(|beam| (beam.number, beam.hit, beam.length))
                .collect::<Vec<_>>(),
            vec![(3, true, 2.0), (4, false, 8.0), (5, false, 8.0)]
        );
        assert_eq!(
            read(
                &scan,
                &BeamSettings {
                    clear_without_return: false,
                    ..settings
                }
            )
            .len(),
            2
        );
    }

    #[test]
    fn lost_beams_clear_no_farther_than_those_beside_them_and_a_moving_obstacle_is_no_hit() {
        let lost = f32::INFINITY;
        let settings = BeamSettings {
            trim: 0,
            lost_run: 4,
            ..BeamSettings::default()
        };
        let mut scan = scan(0.1, vec![2.0, lost, 3.0, lost, lost, lost, 1.0, lost, lost, lost, lost]);
        scan.moving = vec![[2, 3], [6, 8]];
        let beams = read(&scan, &settings);
        let lengths: Vec<(bool, f64)> = beams.iter().map(|beam| (beam.hit, beam.length)).collect();
        let free = |range: f64| (false, 2.0 * range);
        let open = free(scan.range_max);
        let (near, far) = (free(1.0), free(3.0));
        let expected = [
            (true, 4.0),
            free(2.0),
            far,
            near,
            near,
            near,
            near,
            open,
            open,
            open,
            open,
        ];
        assert_eq!(lengths, expected);
    }

    #[test]
    fn only_an_open_sweep_is_trimmed() {
        let settings = BeamSettings {
            trim: 3,
            ..BeamSettings::default()
        };
        assert_eq!(read(&scan(0.1, vec![1.0; 10]), &settings).len(), 4);
        assert_eq!(read(&scan(TAU / 10.0, vec![1.0; 10]), &settings).len(), 10);
        assert_eq!(read(&scan(0.1, vec![1.0; 5]), &settings).len(), 0);
    }
}
