//! Gyro settling. Is the gyro's bias known well enough for the rest of the plan, where nothing else gives the heading?
//!
//! A gyro's bias `b` bends a path of duration `t` by `b t / 2` of its length. The bias is learned at rest ([`crate::estimator`]), which
//! also corrects the path driven before, because the filter knows their correlation. So a robot that sees nothing, and does not know its
//! gyro's bias well enough for the rest of its plan, stands still for some seconds; if that was not enough, again after some metres.

use nalgebra::Point2;
use zenav_protocol::time::Stamp;

use crate::settings::SettlingSettings;

/// With a smaller share of beams returning, scans give no heading.
const IN_SIGHT: f64 = 0.05;

/// Inputs of the decision to stand still.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SettlingInput {
    /// Time of this tick.
    pub(crate) now: Stamp,
    /// Odometry frame, m.
    pub(crate) place: Point2<f64>,
    /// Share of beams with a return.
    pub(crate) in_sight: f64,
    /// Standard deviation of the gyro's bias, rad/s.
    pub(crate) bias_std: f64,
    /// Time left by the plan, s.
    pub(crate) time_left: f64,
}

/// Holds the robot while its gyro settles.
#[derive(Clone, Debug, Default)]
pub(crate) struct GyroSettling {
    /// Since when the robot has stood still.
    since: Option<Stamp>,
    /// Where it last stood still, odometry frame, m.
    stood: Option<Point2<f64>>,
}

impl GyroSettling {
    /// Whether the robot is standing still.
    pub(crate) fn is_holding(&self) -> bool {
        self.since.is_some()
    }

    /// A source other than the plan moves the robot.
    pub(crate) fn interrupt(&mut self) {
        self.since = None;
    }

    /// Decides whether the robot stands still for its gyro.
    pub(crate) fn holds(&mut self, input: &SettlingInput, settings: &SettlingSettings) -> bool {
        let is_known = 0.5 * input.bias_std * input.time_left <= settings.share;
        let is_over = self
            .since
            .is_some_and(|since| input.now.secs_since(since) >= settings.longest);
        if is_known || is_over || input.in_sight >= IN_SIGHT {
            if self.since.take().is_some() && (is_known || is_over) {
                self.stood = Some(input.place);
            }
            return false;
        }
        let is_far = |stood: Point2<f64>| (input.place - stood).norm() >= settings.apart;
        if self.since.is_none() && self.stood.is_none_or(is_far) {
            self.since = Some(input.now);
        }
        self.since.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_stands_until_its_gyro_is_known_but_not_for_ever_and_not_where_it_sees_something() {
        let settings = SettlingSettings::default();
        let input = |secs: f64, x: f64, in_sight: f64, bias_std: f64| SettlingInput {
            now: Stamp::from_secs(secs),
            place: Point2::new(x, 0.0),
            in_sight,
            bias_std,
            time_left: 100.0,
        };
        let mut settling = GyroSettling::default();
        let mut holds = |secs, x, in_sight, bias_std| settling.holds(&input(secs, x, in_sight, bias_std), &settings);
        assert!(!holds(0.0, 0.0, 0.3, 1e-3), "walls tell the heading");
        assert!(holds(1.0, 0.0, 0.0, 1e-3) && holds(2.0, 0.0, 0.01, 5e-4));
        assert!(!holds(3.0, 0.0, 0.0, 1e-4), "known to 0.5 % of the way");
        assert!(!holds(4.0, 1.0, 0.0, 1e-3), "it has only just stood");
        assert!(holds(60.0, 20.0, 0.0, 1e-3) && holds(60.0 + 0.9 * settings.longest, 20.0, 0.0, 1e-3));
        assert!(!holds(61.0 + settings.longest, 20.0, 0.0, 1e-3), "long enough");
        assert!(
            holds(100.0, 40.0, 0.0, 1e-3) && !holds(100.1, 40.0, 0.3, 1e-3) && holds(100.2, 40.0, 0.0, 1e-3),
            "somebody passed"
        );
    }
}
