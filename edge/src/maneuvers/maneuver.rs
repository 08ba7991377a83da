//! Maneuver. How does one maneuver begin, continue and end? Spin, drive straight (back up), wait, drive to a free place. The collision
//! monitor supervises each; one that is blocked fails instead of waiting.

use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::{BehaviourAction, BehaviourReport, BehaviourState};
use zenav_protocol::robot::Drive;
use zenav_protocol::time::Stamp;

use super::free_place::Escape;
use crate::settings::ManeuverSettings;

/// Minimum speed of a drive, m/s: a slower one would occupy the robot for hours.
const LEAST_SPEED: f64 = 0.01;

/// A maneuver in progress.
#[derive(Clone, Debug)]
pub struct Maneuver {
    id: String,
    drive: Drive,
    settings: ManeuverSettings,
    motion: MotionPrimitive,
    /// The motion that follows.
    next: Option<MotionPrimitive>,
    deadline: Stamp,
    blocked: f64,
    begun: Pose2,
}

/// A motion primitive that the maneuver executes, and how far it is.
#[derive(Clone, Copy, Debug)]
enum MotionPrimitive {
    Spin {
        left: f64,
        last_yaw: f64,
    },
    Drive {
        distance: f64,
        speed: f64,
    },
    Wait {
        until: Stamp,
    },
    /// No free place was found.
    Nowhere,
}

/// Outcome of one tick.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// The maneuver continues with this twist.
    Go(Twist2),
    /// The maneuver has ended.
    Done(BehaviourReport),
}

impl Maneuver {
    /// Begins an action from `odom_from_base`; `escape` finds the path to a free place (clearance, within).
    ///
    /// # Errors
    /// What is wrong with the request's values.
    pub fn begin(
        id: &str,
        action: &BehaviourAction,
        now: Stamp,
        odom_from_base: Pose2,
        drive: &Drive,
        settings: &ManeuverSettings,
        escape: impl FnOnce(f64, f64) -> Option<Escape>,
    ) -> Result<Self, String> {
        let mut next = None;
        let (motion, allowance) = match *action {
            BehaviourAction::Spin { angle } => {
                if !angle.is_finite() || angle.abs() > 4.0 * std::f64::consts::PI {
                    return Err(format!(
                        "an angle of {angle} rad: expected radians within two full turns (4 pi)"
                    ));
                }
                (
                    MotionPrimitive::Spin {
                        left: angle,
                        last_yaw: odom_from_base.yaw,
                    },
                    5.0 + 4.0 * angle.abs() / drive.top_yaw_rate(),
                )
            }
            BehaviourAction::Drive { distance, speed } => {
                if !(distance.abs() <= 10.0 && speed >= LEAST_SPEED && speed.is_finite()) {
                    return Err(format!(
                        "expected a distance of at most 10 m and a speed of at least {LEAST_SPEED} m/s"
                    ));
                }
                let speed = speed.min(settings.speed_share * drive.top_speed());
                (
                    MotionPrimitive::Drive { distance, speed },
                    5.0 + 4.0 * distance.abs() / speed,
                )
            }
            BehaviourAction::ToFree { clearance, within } => {
                if !((0.0..=10.0).contains(&clearance) && (0.0..=10.0).contains(&within)) {
                    return Err("expected a clearance and a distance of at most 10 m".into());
                }
                match escape(clearance, within) {
                    None => (MotionPrimitive::Nowhere, 1.0),
                    Some(Escape { turn, distance }) => {
                        let speed = settings.escape_speed.min(settings.speed_share * drive.top_speed());
                        next = Some(MotionPrimitive::Drive { distance, speed });
                        let spin = MotionPrimitive::Spin {
                            left: turn,
                            last_yaw: odom_from_base.yaw,
                        };
                        (
                            spin,
                            10.0 + 4.0 * (turn.abs() / drive.top_yaw_rate() + distance.abs() / speed),
                        )
                    }
                }
            }
            BehaviourAction::Wait { secs } => {
                if !(0.0..=3600.0).contains(&secs) {
                    return Err("expected 0 to 3600 s".into());
                }
                (
                    MotionPrimitive::Wait {
                        until: now.plus_secs(secs),
                    },
                    secs + 5.0,
                )
            }
            BehaviourAction::Cancel | BehaviourAction::Report => return Err("not an action that begins".into()),
        };
        Ok(Self {
            id: id.to_owned(),
            drive: drive.clone(),
            settings: settings.clone(),
            motion,
            next,
            deadline: now.plus_secs(allowance),
            blocked: 0.0,
            begun: odom_from_base,
        })
    }

    /// The execution's id.
    #[must_use]
    pub fn id(&self) -> &str {
        &self.id
    }

    /// The motion that must be free at the start: a twist, and its duration, s.
    #[must_use]
    pub fn sweep(&self) -> Option<(Twist2, f64)> {
        match self.motion {
            MotionPrimitive::Spin { left, .. } => Some((Twist2::new(0.0, left.signum()), left.abs())),
            MotionPrimitive::Drive { distance, .. } => Some((Twist2::new(distance.signum(), 0.0), distance.abs())),
            MotionPrimitive::Wait { .. } | MotionPrimitive::Nowhere => None,
        }
    }

    /// One tick. `stopped`: the collision monitor stopped the robot at the last one.
    pub fn step(&mut self, now: Stamp, dt: f64, odom_from_base: Pose2, velocity: Twist2, stopped: bool) -> Step {
        self.blocked = if stopped { self.blocked + dt } else { 0.0 };
        if self.blocked > self.settings.blocked_timeout {
            return Step::Done(self.report(BehaviourState::Failed, Some("obstacle in the way")));
        }
        if now >= self.deadline {
            return Step::Done(self.report(BehaviourState::Failed, Some("timed out")));
        }
        let step = self.advance(now, odom_from_base, velocity);
        match (step, self.next.take()) {
            (Step::Done(report), Some(next)) if report.state == BehaviourState::Succeeded => {
                self.motion = next;
                self.begun = odom_from_base;
                Step::Go(Twist2::ZERO)
            }
            (step, next) => {
                self.next = next;
                step
            }
        }
    }

    /// One tick of the current motion.
    fn advance(&mut self, now: Stamp, odom_from_base: Pose2, velocity: Twist2) -> Step {
        let slow = velocity.v.abs() < 0.02 && velocity.w.abs() < 0.05;
        match &mut self.motion {
            MotionPrimitive::Spin { left, last_yaw } => {
                *left -= wrap_angle(odom_from_base.yaw - *last_yaw);
                *last_yaw = odom_from_base.yaw;
                if left.abs() < self.settings.turn_tolerance && slow {
                    return Step::Done(self.report(BehaviourState::Succeeded, None));
                }
                let brakes = 2.0 * self.drive.acceleration() / self.drive.wheel_separation;
                let speed =
                    approach(left.abs(), 0.5 * brakes, 3.0).min(self.settings.speed_share * self.drive.top_yaw_rate());
                Step::Go(Twist2::new(0.0, speed * left.signum()))
            }
            MotionPrimitive::Drive { distance, speed } => {
                let gone = self.begun.inverse() * odom_from_base;
                let left = *distance - gone.x;
                if left.abs() < self.settings.distance_tolerance && slow {
                    return Step::Done(self.report(BehaviourState::Succeeded, None));
                }
                let v = approach(left.abs(), 0.5 * self.drive.acceleration(), 2.0).min(*speed);
                Step::Go(Twist2::new(v * left.signum(), -self.settings.straight_gain * gone.yaw))
            }
            MotionPrimitive::Nowhere => {
                Step::Done(self.report(BehaviourState::Failed, Some("no free place within reach")))
            }
            MotionPrimitive::Wait { until } => {
                if now >= *until {
                    return Step::Done(self.report(BehaviourState::Succeeded, None));
                }
                Step::Go(Twist2::ZERO)
            }
        }
    }

    /// A report on this execution.
    #[must_use]
    pub fn report(&self, state: BehaviourState, reason: Option<&str>) -> BehaviourReport {
        BehaviourReport {
            id: self.id.clone(),
            state,
            reason: reason.map(str::to_owned),
        }
    }
}

/// Speed that comes to rest after `left` at this deceleration, and settles exponentially at the end.
fn approach(left: f64, deceleration: f64, gain: f64) -> f64 {
    (2.0 * deceleration * left).sqrt().min(gain * left)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::limiter::{Braking, Limiter};

    fn run(action: &BehaviourAction, stopped: bool) -> (BehaviourReport, Pose2) {
        let drive = zenav_fixtures::robot("tiago").drive;
        let mut pose = Pose2::new(1.0, 2.0, 3.0);
        let mut now = Stamp::from_secs(5.0);
        let way = |_, within: f64| {
            Some(Escape {
                turn: 0.8,
                distance: -within,
            })
        };
        let mut maneuver = Maneuver::begin("b1", action, now, pose, &drive, &ManeuverSettings::default(), way).unwrap();
        let mut limiter = Limiter::new(&drive);
        loop {
            now = now.plus_secs(0.02);
            match maneuver.step(now, 0.02, pose, limiter.twist(), stopped) {
                Step::Done(report) => return (report, pose),
                Step::Go(twist) => {
                    let wheels = limiter.limit(if stopped { Twist2::ZERO } else { twist }, 0.02, Braking::Normal);
                    limiter.set(wheels, 0.02);
                    pose = pose.advance(limiter.twist(), 0.02);
                }
            }
        }
    }

    #[test]
    fn a_spin_turns_by_its_angle_and_more_than_half_a_circle() {
        for angle in [1.5, -1.5, 6.2] {
            let (report, pose) = run(&BehaviourAction::Spin { angle }, false);
            assert_eq!(report.state, BehaviourState::Succeeded);
            assert!(wrap_angle(pose.yaw - 3.0 - angle).abs() < 0.05, "{angle}: {pose:?}");
        }
    }

    #[test]
    fn backing_up_goes_straight_back() {
        let (report, pose) = run(
            &BehaviourAction::Drive {
                distance: -0.3,
                speed: 0.15,
            },
            false,
        );
        assert_eq!(report.state, BehaviourState::Succeeded);
        let gone = Pose2::new(1.0, 2.0, 3.0).inverse() * pose;
        assert!((gone.x + 0.3).abs() < 0.01 && gone.y.abs() < 0.01, "{gone:?}");
    }

    #[test]
    fn to_a_free_place_it_turns_first_and_then_drives() {
        let action = BehaviourAction::ToFree {
            clearance: 0.1,
            within: 0.4,
        };
        let (report, pose) = run(&action, false);
        assert_eq!(report.state, BehaviourState::Succeeded);
        let gone = Pose2::new(1.0, 2.0, 3.8).inverse() * pose;
        assert!(
            (gone.x + 0.4).abs() < 0.02 && gone.y.abs() < 0.02 && gone.yaw.abs() < 0.05,
            "{gone:?}"
        );
    }

    #[test]
    fn a_blocked_motion_fails_and_says_why() {
        let (report, _) = run(
            &BehaviourAction::Drive {
                distance: 1.0,
                speed: 0.2,
            },
            true,
        );
        assert_eq!(
            (report.state, report.reason.as_deref()),
            (BehaviourState::Failed, Some("obstacle in the way"))
        );
    }

    #[test]
    fn nonsense_is_refused() {
        let drive = zenav_fixtures::robot("tiago").drive;
        for action in [
            BehaviourAction::Spin { angle: f64::NAN },
            BehaviourAction::Drive {
                distance: 1.0,
                speed: 0.0,
            },
            BehaviourAction::Wait { secs: f64::INFINITY },
            BehaviourAction::ToFree {
                clearance: f64::NAN,
                within: 1.0,
            },
        ] {
            assert!(
                Maneuver::begin(
                    "b",
                    &action,
                    Stamp::ZERO,
                    Pose2::IDENTITY,
                    &drive,
                    &ManeuverSettings::default(),
                    |_, _| None
                )
                .is_err(),
                "{action:?}"
            );
        }
    }
}
