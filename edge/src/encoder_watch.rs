//! Encoder watch. How far have the wheels turned while their encoders are silent? As far as the motor model predicts, until they report
//! again.
//!
//! A lost reading repeats the previous angles, and a dead encoder keeps repeating them. Taken literally, the robot would stop from one tick
//! to the next, and every scan of that tick would be misplaced. Angles count from the start, so the next real reading corrects every error
//! of the prediction; a large error is corrected no faster than a wheel turns. In contact the robot may be held, and with an empty battery
//! the motors are off: then the encoders are believed. A wheel may be held without a contact, too: a long prediction needs a lidar whose
//! ranges change.

use zenav_protocol::readings::{Readings, Sweep};
use zenav_protocol::robot::RobotModel;

/// A reading is missing only if the wheel must have turned by this many encoder steps plus this angle, rad.
const STEPS: f64 = 3.0;
const NOTICEABLE: f64 = 0.002;

/// Longest prediction of a robot that no lidar sees driving, s.
const LONGEST_GUESS: f64 = 2.0;
/// Two sweeps this far apart, s, show that the robot drives if at least this share of the beams that return in both differ by at least this,
/// m, and there are at least so many of them.
const APART: f64 = 1.5;
const CHANGED: (f64, f32) = (0.2, 0.1);
const FEWEST: usize = 20;

/// Watches both encoders.
#[derive(Clone, Debug)]
pub(crate) struct EncoderWatch {
    noticeable: f64,
    /// Top speed of a wheel, rad/s: errors of the prediction are corrected as fast.
    top_speed: f64,
    wheels: [Wheel; 2],
    /// The sweep that the next ones are compared with, and whether the last comparison showed that the robot drives.
    earlier: Option<Sweep>,
    drives: bool,
}

/// One wheel.
#[derive(Clone, Copy, Debug, Default)]
struct Wheel {
    /// The last new angle, rad.
    told: f64,
    /// Angle turned since then by the model, rad, and the sum of the turns to either side.
    turned: f64,
    rolled: f64,
    /// For how long it has turned without a new reading, s.
    silent: f64,
    /// For how long it has turned while its encoder told no number, s.
    missing: f64,
    /// Part of the last real angles that is not reported yet, rad.
    behind: f64,
}

impl EncoderWatch {
    /// No reading yet.
    pub fn new(model: &RobotModel) -> Self {
        Self {
            noticeable: STEPS * model.encoders.resolution + NOTICEABLE,
            top_speed: model.drive.max_wheel_speed,
            wheels: [Wheel::default(); 2],
            earlier: None,
            drives: false,
        }
    }

    /// Angles of both wheels after a tick of `secs` seconds in which the motor model had them turn at `speeds` (rad/s): as read, or
    /// predicted where a new reading is missing.
    pub fn angles(&mut self, readings: &Readings, speeds: [f64; 2], secs: f64) -> [f64; 2] {
        let believed = readings.bump.pressed || readings.battery.charge <= 0.0;
        let mut angles = readings.wheels;
        for ((wheel, angle), speed) in self.wheels.iter_mut().zip(&mut angles).zip(speeds) {
            if !angle.is_finite() {
                // The estimator waits for the next number.
                wheel.missing += if believed || speed == 0.0 { 0.0 } else { secs };
                continue;
            }
            wheel.missing = 0.0;
            if *angle != wheel.told || believed {
                let missed = *angle - wheel.told - wheel.turned;
                // An encoder that is off by more than the wheel may have turned has begun anew.
                let is_missed = wheel.silent > 0.0 && missed.abs() <= wheel.rolled + self.noticeable;
                *wheel = Wheel {
                    told: *angle,
                    behind: wheel.behind + if is_missed { missed } else { 0.0 },
                    ..Wheel::default()
                };
            } else {
                if wheel.silent < LONGEST_GUESS || self.drives {
                    wheel.turned += speed * secs;
                    wheel.rolled += speed.abs() * secs;
                }
                if wheel.turned.abs() > self.noticeable {
                    wheel.silent += secs;
                    *angle += wheel.turned;
                }
            }
            let most = self.top_speed * secs;
            wheel.behind -= wheel.behind.clamp(-most, most);
            *angle -= wheel.behind;
        }
        angles
    }

    /// Takes in a sweep: while an encoder is silent, a lidar sees whether the robot drives.
    pub fn see(&mut self, sweep: &Sweep) {
        if self.silence() <= 0.0 {
            (self.earlier, self.drives) = (None, false);
            return;
        }
        let Some(earlier) = &self.earlier else {
            self.earlier = Some(sweep.clone());
            return;
        };
        if earlier.lidar == sweep.lidar && sweep.stamp.secs_since(earlier.stamp) >= APART {
            self.drives = is_changed(&earlier.ranges, &sweep.ranges);
            self.earlier = Some(sweep.clone());
        }
    }

    /// For how long a wheel has turned without a new reading, s.
    pub fn silence(&self) -> f64 {
        let silences = self.wheels.iter().flat_map(|wheel| [wheel.silent, wheel.missing]);
        silences.fold(0.0, f64::max)
    }
}

/// Whether the ranges of two sweeps, m, differ as those of a robot that drives.
fn is_changed(earlier: &[f32], later: &[f32]) -> bool {
    let both = earlier
        .iter()
        .zip(later)
        .filter(|(a, b)| a.is_finite() && b.is_finite());
    let (mut beams, mut changed) = (0_usize, 0_usize);
    for (a, b) in both {
        beams += 1;
        changed += usize::from((a - b).abs() >= CHANGED.1);
    }
    beams >= FEWEST && changed as f64 >= CHANGED.0 * beams as f64
}

#[cfg(test)]
mod tests {
    use zenav_protocol::time::Stamp;

    use super::*;

    fn read(angle: f64, pressed: bool) -> Readings {
        let mut readings = Readings::new(Stamp::ZERO);
        readings.wheels = [angle; 2];
        readings.bump.pressed = pressed;
        readings
    }

    #[test]
    fn a_lost_reading_is_guessed_and_made_up_for() {
        let mut watch = EncoderWatch::new(&zenav_fixtures::robot("tiago"));
        let mut angle = |read: Readings, speed: f64| {
            let [left, right] = watch.angles(&read, [speed; 2], 0.02);
            assert_eq!(left, right);
            (left, watch.silence())
        };
        assert_eq!(angle(read(1.0, false), 5.0), (1.0, 0.0));
        assert_eq!(angle(read(1.0, false), 5.0), (1.1, 0.02));
        assert_eq!(angle(read(1.0, false), 5.0), (1.2, 0.04));
        assert_eq!(angle(read(1.31, false), 5.0), (1.31, 0.0));
        // At rest and in contact the encoders are right.
        assert_eq!(angle(read(1.31, false), 0.0), (1.31, 0.0));
        assert_eq!(angle(read(1.31, true), 5.0), (1.31, 0.0));
        assert!(
            watch
                .angles(&read(f64::NAN, false), [5.0; 2], 0.02)
                .iter()
                .all(|angle| angle.is_nan())
        );
    }

    /// Angles reported in each tick of a drive at 5 rad/s whose encoders are silent for `ticks` ticks, and then report the truth: the wheels
    /// turned at this share of that speed. `range` is what all beams of a lidar return, by time in s.
    fn dead_for(ticks: u32, share: f64, range: impl Fn(f64) -> f32) -> Vec<f64> {
        let model = zenav_fixtures::robot("tiago");
        let mut watch = EncoderWatch::new(&model);
        watch.angles(&read(1.0, false), [5.0; 2], 0.02);
        let of = |tick: u32| {
            let secs = 0.02 * f64::from(tick);
            let angle = if tick < ticks { 1.0 } else { 1.0 + share * 5.0 * secs };
            let [left, _] = watch.angles(&read(angle, false), [5.0; 2], 0.02);
            if tick.is_multiple_of(10) {
                watch.see(&Sweep::new(Stamp::from_secs(secs), vec![range(secs); 100]));
            }
            left
        };
        (1..ticks + 300).map(of).collect()
    }

    #[test]
    fn dead_encoders_are_guessed_for_as_long_as_the_lidar_sees_the_robot_drive() {
        let standing = dead_for(500, 0.0, |_| 3.0);
        assert!((standing[498] - 11.0).abs() < 0.2, "{}", standing[498]);
        let driving = dead_for(500, 1.0, |secs| 10.0 - 0.5 * secs as f32);
        assert!((driving[498] - 50.9).abs() < 0.2, "{}", driving[498]);
    }

    #[test]
    fn the_whole_way_counts_once_the_encoders_are_back_and_no_wheel_jumps() {
        for (share, range) in [(0.01, 0.0), (0.8, 0.5), (1.1, 0.5)] {
            let angles = dead_for(500, share, |secs| 10.0 - range * secs as f32);
            let (end, told) = (1.0 + share * 5.0 * 0.02 * 799.0, angles[798]);
            assert!((told - end).abs() < 1e-9, "{share}: {told} of {end}");
            let fastest = 2.0 * zenav_fixtures::robot("tiago").drive.max_wheel_speed * 0.02;
            assert!(
                angles.windows(2).all(|pair| (pair[1] - pair[0]).abs() < fastest),
                "{share}"
            );
        }
    }

    #[test]
    fn an_encoder_that_tells_no_number_is_silent_until_it_tells_one() {
        let mut watch = EncoderWatch::new(&zenav_fixtures::robot("tiago"));
        watch.angles(&read(1.0, false), [5.0; 2], 0.02);
        for speed in [5.0, 0.0] {
            for _ in 0..20 {
                watch.angles(&read(f64::NAN, false), [speed; 2], 0.02);
            }
            assert!((watch.silence() - 0.4).abs() < 1e-9, "at rest it misses nothing");
        }
        assert_eq!(watch.angles(&read(3.0, false), [5.0; 2], 0.02), [3.0; 2]);
        assert_eq!(watch.silence(), 0.0);
    }

    #[test]
    fn encoders_that_begin_anew_are_taken_as_they_are() {
        let mut watch = EncoderWatch::new(&zenav_fixtures::robot("tiago"));
        for _ in 0..20 {
            watch.angles(&read(300.0, false), [5.0; 2], 0.02);
        }
        assert_eq!(watch.angles(&read(0.5, false), [5.0; 2], 0.02), [0.5; 2]);
    }
}
