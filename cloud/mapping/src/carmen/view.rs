//! View. In which directions do the readings of a line look?
//!
//! A `FLASER` line states only how many readings it has. A sweep of half a circle has 180, 181, 360 or 361; lasers that report 540, 541,
//! 1080 or 1081 see three quarters of a circle. What a log's turns say counts more: when the robot turns on the spot, what it saw moves
//! over as many beams as the turn spans. That also shows a laser mounted upside down, whose readings run clockwise. Odometry that overstates
//! turns makes a field of view look too wide: where half a circle is usual, turns say only which way the readings run.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI};

use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::Scan;

/// Angles that differ by less, rad, are the same.
const SAME_ANGLE: f64 = 1e-9;
/// The robot turns on the spot: least and largest turn between two sweeps, rad, and longest way, m.
const TURN: (f64, f64) = (0.06, 0.5);
const WAY: f64 = 0.1;
/// A difference of two readings counts as at most this, m: they lie on two surfaces.
const LARGEST: f64 = 1.0;
/// Numbers of readings of lasers that see half a circle.
const HALF_CIRCLES: [usize; 4] = [180, 181, 360, 361];
/// Least number of readings in a sweep, and of turns in a log, that say anything.
const LEAST_READINGS: usize = 20;
const LEAST_TURNS: usize = 10;
/// Most turns that are looked at.
const MOST_TURNS: usize = 400;
/// Another view is believed if its error is at most this share of that of the usual one.
const BETTER: f64 = 0.75;

/// Directions of the readings of a sweep in the laser's frame, rad, anticlockwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct View {
    /// Direction of the first reading.
    pub(super) angle_min: f64,
    /// From one reading to the next.
    pub(super) angle_increment: f64,
    /// Whether the readings are those from the last direction to the first.
    pub(super) is_clockwise: bool,
}

/// Angle, rad, between the readings of a sweep of half a circle: 180 readings are a degree apart, and so are 181.
pub(super) fn half_circle_increment(readings: usize) -> f64 {
    match readings {
        180 | 181 => PI / 180.0,
        360 | 361 => PI / 360.0,
        count => PI / count.saturating_sub(1).max(1) as f64,
    }
}

impl View {
    /// Half a circle straight ahead, with this many readings.
    pub(super) fn half_circle(readings: usize) -> Self {
        Self {
            angle_min: -FRAC_PI_2,
            angle_increment: half_circle_increment(readings),
            is_clockwise: false,
        }
    }

    /// So many radians, half of them on each side.
    fn centred(readings: usize, radians: f64) -> Self {
        Self {
            angle_min: -0.5 * radians,
            angle_increment: radians / readings.saturating_sub(1).max(1) as f64,
            is_clockwise: false,
        }
    }

    /// Of a `FLASER` line with so many readings.
    pub(super) fn of_front(readings: usize) -> Self {
        match readings {
            540 | 541 => Self {
                angle_increment: PI / 360.0,
                ..Self::centred(readings, 1.5 * PI)
            },
            1080 | 1081 => Self {
                angle_increment: PI / 720.0,
                ..Self::centred(readings, 1.5 * PI)
            },
            _ => Self::half_circle(readings),
        }
    }

    /// Of a line that states it: the direction of the first reading, the field of view, and the angle between two readings, rad. An angle
    /// that is zero or turns by more than a full circle follows from the field of view.
    pub(super) fn stated(start: f64, field_of_view: f64, resolution: f64, readings: usize) -> Self {
        let steps = readings.saturating_sub(1).max(1) as f64;
        let is_usable = resolution != 0.0 && steps * resolution.abs() <= 2.0 * PI + 1e-6;
        let step = if is_usable {
            resolution
        } else {
            field_of_view.abs() / steps
        };
        // Readings that run clockwise are turned round.
        Self {
            angle_min: if step < 0.0 { start + steps * step } else { start },
            angle_increment: step.abs(),
            is_clockwise: step < 0.0,
        }
    }

    /// The same directions as seen by a laser mounted upside down.
    fn mirrored(self, readings: usize) -> Self {
        let last = self.angle_min + readings.saturating_sub(1) as f64 * self.angle_increment;
        Self {
            angle_min: -last,
            is_clockwise: !self.is_clockwise,
            ..self
        }
    }

    /// Whether the directions of a scan are those of a `FLASER` line with as many readings, and half a circle.
    pub(super) fn is_half_circle(scan: &Scan) -> bool {
        let readings = scan.ranges.len();
        let view = Self::half_circle(readings);
        Self::of_front(readings) == view
            && (scan.angle_min - view.angle_min).abs() < SAME_ANGLE
            && (scan.angle_increment - view.angle_increment).abs() < SAME_ANGLE
    }
}

/// The layout of a line: whether it is a `FLASER` line, and its number of readings.
pub(super) type Layout = (bool, usize);

/// What the turns of a log say about the view of one kind of sweep.
#[derive(Clone, Debug)]
struct Evidence {
    /// What is possible, the usual view first.
    views: Vec<View>,
    /// Sum over the turns of the mean difference between readings of the same direction, m, for each of them.
    errors: Vec<f64>,
    turns: usize,
}

/// A sweep with its pose: the layout of its line, the pose of the laser, and the readings in the order of their line.
#[derive(Clone, Debug)]
struct Posed {
    layout: Layout,
    pose: Pose2,
    ranges: Vec<f32>,
}

/// The turns of a log.
#[derive(Clone, Debug, Default)]
pub(super) struct Turns {
    before: Option<Posed>,
    layouts: BTreeMap<Layout, Evidence>,
}

impl Turns {
    /// Takes in a sweep, as read with its `usual` view.
    pub(super) fn add(&mut self, layout: Layout, usual: View, scan: &Scan) {
        let mut ranges: Vec<f32> = scan.ranges.clone();
        for range in ranges.iter_mut().filter(|range| !scan.is_return(**range)) {
            *range = f32::NAN;
        }
        if usual.is_clockwise {
            ranges.reverse();
        }
        let pose = scan.map_from_laser();
        let now = Posed { layout, pose, ranges };
        let Some(before) = self
            .before
            .replace(now.clone())
            .filter(|before| before.layout == layout)
        else {
            return;
        };
        let turn = wrap_angle(now.pose.yaw - before.pose.yaw);
        let is_turn = (TURN.0..=TURN.1).contains(&turn.abs()) && now.pose.distance(&before.pose) < WAY;
        if !is_turn || now.ranges.len() < LEAST_READINGS {
            return;
        }
        let evidence = self
            .layouts
            .entry(layout)
            .or_insert_with(|| Evidence::new(layout, usual));
        evidence.add(&before.ranges, &now.ranges, turn);
    }

    /// The views that differ from the usual ones.
    pub(super) fn others(&self) -> BTreeMap<Layout, View> {
        let others = self.layouts.iter();
        others
            .filter_map(|(layout, evidence)| Some((*layout, evidence.other()?)))
            .collect()
    }
}

impl Evidence {
    fn new((is_front, readings): Layout, usual: View) -> Self {
        let mut views = vec![usual];
        if is_front && !HALF_CIRCLES.contains(&readings) {
            let possible = [
                View::half_circle(readings),
                View::centred(readings, 1.5 * PI),
                View::centred(readings, PI / 1.8),
            ];
            let is_near = |a: &View, b: &View| (a.angle_increment / b.angle_increment - 1.0).abs() < 0.05;
            for view in possible {
                if !views.iter().any(|known| is_near(known, &view)) {
                    views.push(view);
                }
            }
        }
        let mirrored: Vec<View> = views.iter().map(|view| view.mirrored(readings)).collect();
        views.extend(mirrored);
        Self {
            errors: vec![0.0; views.len()],
            views,
            turns: 0,
        }
    }

    /// Compares two sweeps between which the laser turned, rad.
    fn add(&mut self, before: &[f32], now: &[f32], turn: f64) {
        if self.turns >= MOST_TURNS {
            return;
        }
        let errors = self.views.iter().map(|view| {
            let step = if view.is_clockwise {
                -view.angle_increment
            } else {
                view.angle_increment
            };
            difference(before, now, turn / step)
        });
        // A turn counts if it says something about each view.
        if let Some(errors) = errors.collect::<Option<Vec<f64>>>() {
            self.turns += 1;
            for (sum, error) in self.errors.iter_mut().zip(errors) {
                *sum += error;
            }
        }
    }

    /// The view that fits much better than the usual one.
    fn other(&self) -> Option<View> {
        let usual = self.errors.first().filter(|_| self.turns >= LEAST_TURNS)?;
        let all = self.errors.iter().zip(&self.views);
        let (error, view) = all.min_by(|a, b| a.0.total_cmp(b.0))?;
        (*error < BETTER * usual).then_some(*view)
    }
}

/// Mean difference between two sweeps, m, the second one moved by so many readings; `None` if less than a quarter of them meet.
fn difference(before: &[f32], now: &[f32], by: f64) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0_usize);
    for (index, range) in before.iter().enumerate() {
        let at = (index as f64 - by).round();
        let other = (at >= 0.0).then(|| now.get(at as usize)).flatten();
        let difference = other.map_or(f64::NAN, |other| f64::from(range - other).abs());
        if difference.is_finite() {
            sum += difference.min(LARGEST);
            count += 1;
        }
    }
    (4 * count >= before.len()).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the sweeps of a laser that turns on the spot in a room say, with readings in these directions.
    fn turns(readings: usize, usual: View, truth: View) -> Option<View> {
        turns_by_odometry(1.0, readings, usual, truth)
    }

    /// The same by odometry that states so many times each turn.
    fn turns_by_odometry(scale: f64, readings: usize, usual: View, truth: View) -> Option<View> {
        let mut turns = Turns::default();
        for number in 0..40_u32 {
            let pose = Pose2::new(0.0, 0.0, 0.11 * f64::from(number));
            let range = |reading: usize| {
                let place = if truth.is_clockwise {
                    readings - 1 - reading
                } else {
                    reading
                };
                let (sin, cos) = (pose.yaw + truth.angle_min + place as f64 * truth.angle_increment).sin_cos();
                let (ahead, aside) = (if cos > 0.0 { 4.0 } else { 2.5 }, if sin > 0.0 { 3.0 } else { 1.5 });
                f64::min(ahead / cos.abs().max(1e-3), aside / sin.abs().max(1e-3)) as f32
            };
            let mut ranges: Vec<f32> = (0..readings).map(range).collect();
            if usual.is_clockwise {
                ranges.reverse();
            }
            let scan = Scan {
                angle_min: usual.angle_min,
                angle_increment: usual.angle_increment,
                range_min: 0.02,
                range_max: 80.0,
                ranges,
                odom_from_base: Pose2::new(0.0, 0.0, wrap_angle(scale * pose.yaw)),
                ..Scan::default()
            };
            turns.add((true, readings), usual, &scan);
        }
        turns.others().into_values().next()
    }

    #[test]
    fn the_view_follows_from_the_number_of_readings() {
        let degrees = |readings| {
            let View {
                angle_min,
                angle_increment,
                ..
            } = View::of_front(readings);
            [angle_min, angle_increment].map(|angle| (angle.to_degrees() * 1e6).round() / 1e6)
        };
        for (readings, step) in [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5), (91, 2.0)] {
            assert_eq!(degrees(readings), [-90.0, step], "{readings}");
        }
        assert_eq!(degrees(541), [-135.0, 0.5]);
        assert_eq!(degrees(1081), [-135.0, 0.25]);
    }

    #[test]
    fn turns_show_the_field_of_view_and_which_way_round_the_readings_run() {
        for readings in [181, 361, 541] {
            let usual = View::of_front(readings);
            assert_eq!(turns(readings, usual, usual), None, "{readings}");
            let upside_down = usual.mirrored(readings);
            assert_eq!(turns(readings, usual, upside_down), Some(upside_down), "{readings}");
        }
        let half = View::half_circle(541);
        assert_eq!(turns(541, View::of_front(541), half), Some(half));
        let wide = View::centred(271, 1.5 * PI);
        assert_eq!(turns(271, View::of_front(271), wide), Some(wide));
        let clockwise = View::stated(FRAC_PI_2, PI, -PI / 180.0, 181);
        assert!((clockwise.angle_min + FRAC_PI_2).abs() < 1e-9 && clockwise.is_clockwise);
        assert_eq!(turns(181, clockwise, clockwise), None, "stated, and so");
    }

    #[test]
    fn half_a_circle_stays_one_if_odometry_overstates_turns() {
        for readings in HALF_CIRCLES {
            let usual = View::of_front(readings);
            let upside_down = usual.mirrored(readings);
            assert_eq!(turns_by_odometry(1.5, readings, usual, usual), None, "{readings}");
            let found = turns_by_odometry(1.5, readings, usual, upside_down);
            assert_eq!(found, Some(upside_down), "{readings}");
        }
    }
}
