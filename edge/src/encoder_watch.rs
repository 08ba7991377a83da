//! Encoder watch. How far have the wheels turned while their encoders are silent? As far as the motor model predicts, until they report
//! again.
//!
//! A lost reading repeats the previous angles, and a dead encoder keeps repeating them. Taken literally, the robot would stop from one tick
//! to the next, and every scan of that tick would be misplaced. Angles count from the start, so the next real reading corrects every error
//! of the prediction. In contact the robot may be held, and with an empty battery the motors are off: then the encoders are believed.

use zenav_protocol::readings::Readings;
use zenav_protocol::robot::RobotModel;

/// A reading is missing only if the wheel must have turned by this many encoder steps plus this angle, rad.
const STEPS: f64 = 3.0;
const NOTICEABLE: f64 = 0.002;

/// Longest prediction, s: the wheel may also be held.
const LONGEST_GUESS: f64 = 2.0;

/// Watches both encoders.
#[derive(Clone, Debug)]
pub(crate) struct EncoderWatch {
    noticeable: f64,
    wheels: [Wheel; 2],
}

/// One wheel.
#[derive(Clone, Copy, Debug, Default)]
struct Wheel {
    /// The last new angle, rad.
    told: f64,
    /// Angle turned since then by the model, rad.
    turned: f64,
    /// For how long it has turned without a new reading, s.
    silent: f64,
}

impl EncoderWatch {
    /// No reading yet.
    pub fn new(model: &RobotModel) -> Self {
        Self {
            noticeable: STEPS * model.encoders.resolution + NOTICEABLE,
            wheels: [Wheel::default(); 2],
        }
    }

    /// Angles of both wheels after a tick of `secs` seconds in which the motor model had them turn at `speeds` (rad/s): as read, or
    /// predicted where a new reading is missing.
    pub fn angles(&mut self, readings: &Readings, speeds: [f64; 2], secs: f64) -> [f64; 2] {
        let believed = readings.bump.pressed || readings.battery.charge <= 0.0;
        let mut angles = readings.wheels;
        for ((wheel, angle), speed) in self.wheels.iter_mut().zip(&mut angles).zip(speeds) {
            if *angle != wheel.told || believed {
                *wheel = Wheel {
                    told: *angle,
                    ..Wheel::default()
                };
                continue;
            }
            if wheel.silent < LONGEST_GUESS {
                wheel.turned += speed * secs;
            }
            if wheel.turned.abs() > self.noticeable {
                wheel.silent += secs;
                *angle += wheel.turned;
            }
        }
        angles
    }

    /// For how long a wheel has turned without a new reading, s.
    pub fn silence(&self) -> f64 {
        self.wheels.iter().map(|wheel| wheel.silent).fold(0.0, f64::max)
    }
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
}
