//! Deskewing. What would the lidar have seen if it measured all beams at once, at the end of its sweep?
//!
//! A rotating lidar measures its beams one after the other, while the robot drives and turns: at 1 rad/s and five sweeps a second a wall is
//! sheared by 11 degrees from one end of the sweep to the other. Each return is placed by the odometry of its own time, then expressed from
//! the robot's pose at the stamp. A static obstacle is then where it stands; a moving one is where it was when its beam hit it
//! ([`LidarModel::before_end`] tells how long ago).

use std::borrow::Cow;
use std::f64::consts::TAU;

use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::readings::Sweep;
use zenav_protocol::robot::LidarModel;
use zenav_protocol::time::Stamp;

use crate::lost_beams::is_one_surface;

/// Between poses this far apart in time the motion counts as straight, s; most such poses.
const STRAIGHT: f64 = 0.01;
const MOST_STEPS: f64 = 100.0;
/// A robot that drives and turns less than this during a sweep is at rest, m and rad.
const STANDS: f64 = 1e-4;
/// Range of a direction that no beam covers: it neither hits nor clears.
const UNSEEN: f32 = 0.0;

/// A beam as seen from the pose at the stamp.
#[derive(Clone, Copy)]
struct Moved {
    /// Its direction, in beams from the first.
    at: f64,
    /// m; infinite without a return, zero where the lidar lost it.
    range: f32,
}

/// A sweep as if all beams had been measured at its stamp, from odometry at a stamp. Unchanged if the robot is at rest or the lidar takes
/// all beams at once.
pub(crate) fn deskewed<'a>(
    sweep: &'a Sweep,
    lidar: &LidarModel,
    odom_from_base_at: impl Fn(Stamp) -> Option<Pose2>,
) -> Cow<'a, Sweep> {
    let count = lidar.beams;
    if lidar.sweep_time == 0.0 || sweep.ranges.len() != count {
        return Cow::Borrowed(sweep);
    }
    let Some(end) = odom_from_base_at(sweep.stamp) else {
        return Cow::Borrowed(sweep);
    };
    let laser_from_odom = (end * lidar.mount).inverse();
    let steps = (lidar.sweep_time.abs() / STRAIGHT).ceil().min(MOST_STEPS);
    let step = lidar.sweep_time.abs() / steps;
    // Poses of the lidar at each step before the stamp; before the first odometry, that first pose.
    let mut earliest = end;
    let lasers = (0..=steps as usize).map(|nth| {
        earliest = odom_from_base_at(sweep.stamp.plus_secs(-step * nth as f64)).unwrap_or(earliest);
        laser_from_odom * earliest * lidar.mount
    });
    let lasers: Vec<Pose2> = lasers.collect();
    let has_moved = |laser: &Pose2| laser.position().coords.norm() > STANDS || laser.yaw.abs() > STANDS;
    if !lasers.iter().any(has_moved) {
        return Cow::Borrowed(sweep);
    }
    let laser_at = |ago: f64| {
        let nth = ((ago / step) as usize).min(lasers.len().saturating_sub(2));
        let [later, earlier] = [nth, nth + 1].map(|nth| lasers.get(nth).copied().unwrap_or(Pose2::IDENTITY));
        later.interpolate(&earlier, ago / step - nth as f64)
    };
    let moved = sweep.ranges.iter().enumerate().map(|(beam, range)| {
        let (laser, angle) = (
            laser_at(lidar.before_end(beam as f64)),
            lidar.angle_min() + beam as f64 * lidar.angle_increment(),
        );
        let seen = f64::from(*range);
        let (turn, range) = if (lidar.range_min..=lidar.range_max).contains(&seen) {
            let (sin, cos) = (laser.yaw + angle).sin_cos();
            let (x, y) = (laser.x + seen * cos, laser.y + seen * sin);
            // Bounded so that it stays a return.
            let range = x.hypot(y).min(0.999 * lidar.range_max).max(1.001 * lidar.range_min);
            (wrap_angle(y.atan2(x) - angle), range as f32)
        } else if seen > lidar.range_max {
            (laser.yaw, f32::INFINITY)
        } else {
            // No measurement, or NaN.
            (laser.yaw, UNSEEN)
        };
        let at = beam as f64 + turn / lidar.angle_increment();
        Moved { at, range }
    });
    let ranges = laid_out(&moved.collect::<Vec<_>>(), lidar);
    Cow::Owned(Sweep {
        lidar: sweep.lidar.clone(),
        stamp: sweep.stamp,
        ranges,
    })
}

/// One range for each of the lidar's directions. Where two beams fall on one direction the nearer counts; on one surface, the later.
fn laid_out(moved: &[Moved], lidar: &LidarModel) -> Vec<f32> {
    let count = moved.len();
    let mut laid = vec![None; count];
    // Directions repeat after a full circle, which need not be a whole number of beams.
    let circle = TAU / lidar.angle_increment();
    let place = |at: f64| {
        let wrapped = if at < -0.5 { at + circle } else { at };
        let wrapped = if wrapped > circle - 0.5 {
            wrapped - circle
        } else {
            wrapped
        };
        let beam = wrapped.round();
        (0.0..count as f64).contains(&beam).then_some(beam.abs() as usize)
    };
    let surface = |a: &Moved, b: &Moved| is_return(a.range) && is_return(b.range) && is_one_surface(a.range, b.range);
    let mut lay = |at: f64, range: f32| {
        let Some(known) = place(at).and_then(|beam| laid.get_mut(beam)) else {
            return;
        };
        *known = match *known {
            Some(before) if !(is_return(before) && is_return(range) && is_one_surface(before, range)) => {
                Some(f32::min(before, range))
            }
            _ => Some(range),
        };
    };
    let in_time = |nth: usize| if lidar.sweep_time < 0.0 { count - 1 - nth } else { nth };
    for beam in (0..count).map(in_time) {
        let Some(this) = moved.get(beam) else { continue };
        if this.range == UNSEEN {
            continue;
        }
        let beside = [beam.checked_sub(1), Some(beam + 1)].map(|beam| moved.get(beam?));
        let nearest = this.at.round();
        // Follows its surface to the direction asked for.
        let [before, after] = beside.map(|other| other.filter(|other| surface(this, other)));
        let (from, to) = (before.unwrap_or(this), after.unwrap_or(this));
        let slope = if to.at - from.at > 0.5 {
            f64::from(to.range - from.range) / (to.at - from.at)
        } else {
            0.0
        };
        let range = if is_return(this.range) {
            (f64::from(this.range) + slope * (nearest - this.at)) as f32
        } else {
            this.range
        };
        lay(nearest, range);
        // Where the robot turns with the sweep, some neighbouring beams lie two directions apart.
        if let Some(next) = beside[1]
            && next.at.round() - nearest == 2.0
            && (after.is_some() || this.range == next.range)
        {
            let share = (nearest + 1.0 - this.at) / (next.at - this.at);
            let between = if is_return(this.range) {
                this.range + share as f32 * (next.range - this.range)
            } else {
                this.range
            };
            lay(nearest + 1.0, between);
        }
    }
    laid.into_iter().map(|range| range.unwrap_or(UNSEEN)).collect()
}

fn is_return(range: f32) -> bool {
    range > 0.0 && range.is_finite()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use proptest::prelude::*;
    use zenav_protocol::geometry::Twist2;

    use super::*;

    /// A room of 6 m by 4 m.
    const HALF: [f64; 2] = [3.0, 2.0];
    const STAMP: f64 = 10.0;

    fn lidar(robot: &str, sweep_time: f64) -> LidarModel {
        let lidar = zenav_fixtures::robot(robot).lidar.unwrap_or_else(|| unreachable!());
        LidarModel {
            sweep_time,
            range_max: 10.0,
            ..lidar
        }
    }

    /// Distance to the wall from a pose, in a direction.
    fn range(from: Pose2, angle: f64) -> f32 {
        let (sin, cos) = (from.yaw + angle).sin_cos();
        let to = |along: f64, at: f64, half: f64| (half * along.signum() - at) / along;
        to(cos, from.x, HALF[0]).min(to(sin, from.y, HALF[1])) as f32
    }

    /// What the lidar sees of the room, each beam so many seconds before the stamp.
    fn seen(lidar: &LidarModel, pose: impl Fn(f64) -> Pose2, before: impl Fn(usize) -> f64) -> Vec<f32> {
        let beams = (0..lidar.beams).map(|beam| {
            let angle = lidar.angle_min() + beam as f64 * lidar.angle_increment();
            range(pose(STAMP - before(beam)) * lidar.mount, angle)
        });
        beams.collect()
    }

    proptest! {
        #[test]
        fn walls_stand_where_they_would_be_seen_at_the_stamp(
            v in -0.5..0.5_f64,
            w in -1.5..1.5_f64,
            yaw in -PI..PI,
            (robot, sweep_time) in prop_oneof![Just(("neato", 0.2)), Just(("neato", -0.2)), Just(("tiago", 0.07)), Just(("jackal", -0.05))],
        ) {
            let lidar = lidar(robot, sweep_time);
            let pose = |at: f64| Pose2::new(0.5, -0.3, yaw).advance(Twist2::new(v, w), at - STAMP);
            let skewed = Sweep::new(Stamp::from_secs(STAMP), seen(&lidar, pose, |beam| lidar.before_end(beam as f64)));
            let seen_from_stamp = seen(&lidar, pose, |_| 0.0);
            let deskewed = deskewed(&skewed, &lidar, |stamp| Some(pose(stamp.as_secs())));
            let mut unseen = 0;
            for (beam, (range, truth)) in deskewed.ranges.iter().zip(&seen_from_stamp).enumerate() {
                unseen += usize::from(*range == UNSEEN);
                // Past a corner a wall continues by up to half a beam.
                let beside = [beam + lidar.beams - 1, beam + 1].map(|beam| (seen_from_stamp[beam % lidar.beams] - truth).abs());
                let most = 0.002 + 0.002 * truth + beside[0].max(beside[1]).min(0.1);
                prop_assert!(*range == UNSEEN || (range - truth).abs() < most, "{range} {truth}");
            }
            // A robot that turns against the sweep misses as many beams as it turned by, and one at each end.
            let turned = (w * sweep_time / lidar.angle_increment()).abs().ceil() as usize;
            let moved = (v * sweep_time / 1.5 / lidar.angle_increment()).abs().ceil() as usize;
            prop_assert!(unseen <= turned + moved + 2, "{unseen} of {turned} + {moved}");
        }
    }

    #[test]
    fn a_sweep_at_rest_and_one_of_a_lidar_that_takes_all_at_once_stay_as_they_are() {
        let drives = |stamp: Stamp| Some(Pose2::new(stamp.as_secs(), 0.0, 0.0));
        let stands = |_: Stamp| Some(Pose2::new(1.0, 2.0, 3.0));
        let [swept, at_once] = [0.2, 0.0].map(|sweep_time| lidar("neato", sweep_time));
        let sweep = Sweep::new(Stamp::from_secs(STAMP), vec![1.0; swept.beams]);
        assert!(matches!(deskewed(&sweep, &swept, stands), Cow::Borrowed(_)));
        assert!(matches!(deskewed(&sweep, &at_once, drives), Cow::Borrowed(_)));
        assert!(matches!(deskewed(&sweep, &swept, drives), Cow::Owned(_)));
        // Before the first odometry the motion is unknown.
        assert!(matches!(deskewed(&sweep, &swept, |_| None), Cow::Borrowed(_)));
    }

    #[test]
    fn a_lidar_of_hardly_any_range_is_no_reason_to_panic() {
        let narrow = LidarModel {
            range_min: 9.99,
            range_max: 10.0,
            ..lidar("neato", 0.2)
        };
        let turns = |stamp: Stamp| Some(Pose2::new(0.0, 0.0, stamp.as_secs()));
        let sweep = Sweep::new(Stamp::from_secs(STAMP), vec![9.995; narrow.beams]);
        let deskewed = deskewed(&sweep, &narrow, turns);
        assert!(deskewed.ranges.iter().all(|range| range.is_finite()));
    }

    #[test]
    fn what_is_open_stays_open_and_what_was_lost_stays_lost() {
        let lidar = lidar("neato", 0.2);
        let turns = |stamp: Stamp| Some(Pose2::new(0.0, 0.0, stamp.as_secs()));
        let mut ranges = vec![f32::INFINITY; lidar.beams];
        ranges[100..110].fill(UNSEEN);
        let sweep = Sweep::new(Stamp::from_secs(STAMP), ranges);
        let deskewed = deskewed(&sweep, &lidar, turns);
        let lost = deskewed.ranges.iter().filter(|range| **range == UNSEEN).count();
        assert!((8..=12).contains(&lost), "{lost}");
        assert_eq!(
            deskewed.ranges.iter().filter(|range| range.is_infinite()).count(),
            lidar.beams - lost
        );
    }
}
