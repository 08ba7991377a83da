//! Motion arbitration in a tick. Which twist does the source that may move the robot want, and how does it brake?

use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{Bump, EventKind, GuardZone, Mode};
use zenav_protocol::time::Stamp;

use super::Pilot;
use crate::arbitration::MotionSource;
use crate::avoidance::{Ahead, AvoidanceInput, Control};
use crate::gyro_settling::SettlingInput;
use crate::limiter::Braking;
use crate::trackers::TrackerInput;
use crate::wall_follower::WallFollowerInput;

/// How far ahead the plan is sampled, and the sampling period, s.
const AHEAD_SECS: f64 = 12.0;
const AHEAD_STEP: f64 = 0.1;

impl Pilot {
    /// The wanted twist of the source that may move the robot, and how it brakes.
    pub(super) fn arbitrate(&mut self, now: Stamp, dt: f64, bump: &Bump) -> (Twist2, Braking) {
        let plan_valid = self.active_plan.as_ref().is_some_and(|active| active.is_valid(now));
        let source = self.authority.motion_source(now, plan_valid);
        if source != MotionSource::Plan {
            self.gyro_settling.interrupt();
            self.right_of_way.reset();
        }
        // Also while the robot is lost: if it is found elsewhere the trail is forgotten, otherwise the estimate was about right.
        if source != MotionSource::ReturnHome {
            self.return_home.record(self.estimator.map_from_base().position());
        }
        if let Some(wanted) = self.step_maneuver(now, dt, source) {
            return (wanted, Braking::Normal);
        }
        match source {
            MotionSource::Brake => {
                self.mode = if self.authority.is_stopped() {
                    Mode::Stopped
                } else {
                    Mode::Idle
                };
                (Twist2::ZERO, Braking::Hard)
            }
            MotionSource::Rest => {
                self.mode = Mode::Idle;
                (Twist2::ZERO, Braking::Normal)
            }
            MotionSource::WallFollow => {
                self.mode = Mode::WallFollow;
                let input = WallFollowerInput {
                    now,
                    dt,
                    settings: &self.wall_following,
                    obstacles: &self.obstacles,
                    odom_from_base: self.estimator.odom_from_base(),
                    bump,
                    stopped: self.collision_monitor.zone() == GuardZone::Stop,
                };
                (self.wall_follower.step(&input, &mut self.events), Braking::Normal)
            }
            MotionSource::ReturnHome => (self.go_home(dt), Braking::Normal),
            MotionSource::Teleop => {
                self.mode = Mode::Teleop;
                if self.dead_man.just_expired(now) {
                    let reason = "teleop timed out".to_owned();
                    let zone = GuardZone::Stop;
                    self.events.record(now, EventKind::Guard { zone, reason });
                }
                (self.dead_man.twist(now), Braking::Normal)
            }
            MotionSource::Plan if self.settles(now) => {
                self.mode = Mode::Follow;
                (Twist2::ZERO, Braking::Normal)
            }
            MotionSource::Plan => (self.follow_plan(now, dt, bump), Braking::Normal),
        }
    }

    /// The twist of the running maneuver, if there is one. It moves only under a live lease; whose lease it is was checked when it began.
    fn step_maneuver(&mut self, now: Stamp, dt: f64, source: MotionSource) -> Option<Twist2> {
        self.maneuvers.running()?;
        let is_live = self.authority.lease_state(now).live;
        if !is_live || source == MotionSource::Brake {
            self.maneuvers.cancel(now, "the lease has expired", &mut self.events);
            return None;
        }
        self.mode = Mode::Behaviour;
        let (odom_from_base, velocity) = (self.estimator.odom_from_base(), self.estimator.velocity());
        let stopped = self.collision_monitor.zone() == GuardZone::Stop;
        let wanted = self
            .maneuvers
            .step(now, dt, odom_from_base, velocity, stopped, &mut self.events);
        Some(wanted)
    }

    /// The twist of the way home; none at home, and while the robot is lost.
    fn go_home(&mut self, dt: f64) -> Twist2 {
        let map_from_base = self.estimator.map_from_base();
        if !self.health.is_trusted() || self.return_home.is_home(&map_from_base) {
            self.mode = Mode::Idle;
            return Twist2::ZERO;
        }
        self.mode = Mode::ReturnHome;
        let view = TrackerInput {
            dt,
            map_from_base,
            velocity: self.estimator.velocity(),
            speed_cap: f64::INFINITY,
        };
        self.return_home.step(&view, &self.config.model, &self.gains)
    }

    /// Whether the robot stands still on its plan because only a gyro with a poorly known bias gives its heading.
    fn settles(&mut self, now: Stamp) -> bool {
        let model = &self.config.model;
        let (Some(active), Some(bias_std)) = (&self.active_plan, self.estimator.gyro_bias_std()) else {
            return false;
        };
        if active.is_finished() || model.imu.compass_noise.is_some() || model.gps.is_some() {
            return false;
        }
        let input = SettlingInput {
            now,
            place: self.estimator.odom_from_base().position(),
            in_sight: self.obstacles.in_sight(),
            bias_std,
            time_left: active.time_left(&self.estimator.map_from_base()),
        };
        let held = self.gyro_settling.is_holding();
        let holds = self.gyro_settling.holds(&input, &self.config.settings.settling);
        if holds && !held {
            let reason = "nothing is in sight: the robot stands still until its gyro's bias is known".to_owned();
            let zone = GuardZone::Stop;
            self.events.record(now, EventKind::Guard { zone, reason });
        }
        holds
    }

    /// The twist of the plan's tracker, or an evasive one where the plan leads into the path of a moving obstacle.
    fn follow_plan(&mut self, now: Stamp, dt: f64, bump: &Bump) -> Twist2 {
        let Some(active) = &mut self.active_plan else {
            return Twist2::ZERO;
        };
        let drive = &self.config.model.drive;
        let map_from_base = self.estimator.map_from_base();
        let mut speed_cap = active.speed_cap(now, dt, drive);
        if active.is_finished() {
            self.right_of_way.reset();
        } else {
            let odom_from_map = self.estimator.map_from_odom().inverse();
            active.ahead(odom_from_map, AHEAD_SECS, AHEAD_STEP, &mut self.ahead);
            let radius = self.config.model.footprint.circumscribed_radius();
            self.right_of_way
                .update(now, active, odom_from_map, radius, &self.obstacles);
            let wait = self.right_of_way.wait(now, active);
            let way = wait.and_then(|wait| wait_on(&mut self.ahead, wait.at));
            let control = self.avoidance.step(&AvoidanceInput {
                dt,
                now,
                monitor: &self.collision_monitor,
                bump,
                odom_from_base: self.estimator.odom_from_base(),
                command: self.limiter.twist(),
                speed_cap,
                ahead: &self.ahead,
                obstacles: &self.obstacles,
            });
            if control != Control::Follow {
                active.rejoin(&map_from_base);
            }
            if let Control::Evade(twist) = control {
                self.mode = Mode::Follow;
                return twist;
            }
            if let Some(way) = way {
                speed_cap = speed_cap.min(active.speed_cap_within(way, dt, drive));
            }
        }
        let view = TrackerInput {
            dt,
            map_from_base,
            velocity: self.estimator.velocity(),
            speed_cap,
        };
        let wanted = active.step(&view, &self.gains);
        self.mode = if active.is_finished() { Mode::Idle } else { Mode::Follow };
        wanted
    }
}

/// Makes a plan wait from `secs` on: from then on it stays where it is. Returns the distance to there, m; `None` if the plan is not sampled
/// that far ahead.
fn wait_on(plan: &mut [Ahead], secs: f64) -> Option<f64> {
    let last = plan.iter().position(|ahead| ahead.secs >= secs)?;
    let steps = plan[..=last].windows(2);
    let way = steps
        .map(|two| (two[1].pose.position() - two[0].pose.position()).norm())
        .sum();
    let pose = plan[last].pose;
    for ahead in &mut plan[last..] {
        ahead.pose = pose;
    }
    Some(way)
}
