//! Collision monitor. May the robot move as it wants to? The monitor has the last word: after the limiters, directly before the wheels.
//!
//! It scales the wanted twist down, at constant curvature, until the robot can stop before any static obstacle, before any moving obstacle
//! could reach it, and within the floor that the lidar has seen, unless it feels its way at `unseen_speed`. It does not swing towards a
//! moving obstacle that has left the field of view (see [`crate::passive_safety`]). A robot that only grazes an obstacle inside the margin
//! may creep on while its time to contact is at least a second; motion that does not reduce the clearance is always allowed. A gentle
//! motion begins only after the motors' response to a faster one has faded.
//!
//! Late scans delay the robot's reaction, so it drives accordingly more slowly. When scans stop arriving it slows down, and is at rest a
//! set time after the last one. While the wheel encoders are silent it drives slowly. A scan that is too old, a command that is not finite,
//! and bumper contact stop it at once.

use std::f64::consts::PI;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{Bump, GuardZone};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::local_obstacles::LocalObstacles;
use crate::passive_safety::{
    LEAST_CLEARANCE, Motion, Mover, closing_speed, contact_point, fastest_outward, share_beside,
};
use crate::settings::{CollisionMonitorSettings, EdgeSettings, PassiveSafetySettings};
use crate::time_to_contact::SweptFootprint;
use crate::wheel_coordination::WheelCoordination;

/// No point of the outline moves outwards faster than this once a faster motion has faded, m/s.
const FADED: f64 = 0.009;
/// A contact felt again within this time is the same contact, s.
const CHATTER: f64 = 0.5;

/// Judges every twist before it goes to the wheels.
#[derive(Clone, Debug)]
pub struct CollisionMonitor {
    model: RobotModel,
    tick: f64,
    settings: CollisionMonitorSettings,
    passive_safety: PassiveSafetySettings,
    /// Distance kept beyond the braking distance, m.
    pub margin: f64,
    /// Largest speed into the lidar's blind spot, m/s.
    pub blind_speed: f64,
    /// Largest speed over floor in the blind spot that was never seen, m/s.
    pub unseen_speed: f64,
    /// Whether the wheel encoders are silent although the wheels turn.
    pub encoders_silent: bool,
    /// Model of the motors' response to the commands so far.
    motors: WheelCoordination,
    /// Bearing of the last contact if its bumper gave none, rad: the direction of motion when it began; and when it was last felt.
    felt_toward: Option<(f64, Stamp)>,
    /// Stamp of the oldest of the lidars' newest scans, and when it arrived.
    scan: Option<(Stamp, Stamp)>,
    zone: GuardZone,
    since: Stamp,
    /// The reason last reported, and when.
    reported: (&'static str, Stamp),
}

/// The twist that may be driven, and why it was limited.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// The twist that may be driven.
    pub twist: Twist2,
    /// Clear, slowed or stopped.
    pub zone: GuardZone,
    /// The reason, when the zone has changed or holds for another reason.
    pub change: Option<String>,
}

impl CollisionMonitor {
    /// Monitors a robot with this control period, s.
    #[must_use]
    pub fn new(model: &RobotModel, tick: f64) -> Self {
        Self {
            model: model.clone(),
            tick,
            settings: CollisionMonitorSettings::default(),
            passive_safety: PassiveSafetySettings::default(),
            margin: model.controller.guard_margin,
            blind_speed: model.controller.blind_speed,
            unseen_speed: 0.0,
            encoders_silent: false,
            motors: WheelCoordination::new(&model.drive),
            felt_toward: None,
            scan: None,
            zone: GuardZone::Clear,
            since: Stamp::ZERO,
            reported: ("", Stamp::ZERO),
        }
    }

    /// The same with these settings instead of the defaults.
    #[must_use]
    pub fn with_settings(mut self, settings: &EdgeSettings) -> Self {
        self.settings = settings.collision_monitor.clone();
        self.passive_safety = settings.passive_safety.clone();
        self
    }

    /// The zone of the last verdict.
    #[must_use]
    pub fn zone(&self) -> GuardZone {
        self.zone
    }

    /// Judges a wanted twist.
    pub fn judge(
        &mut self,
        now: Stamp,
        wanted: Twist2,
        obstacles: &LocalObstacles,
        odom_from_base: Pose2,
        bump: &Bump,
    ) -> Verdict {
        self.feel(now, bump);
        let silence = self.silence(now, obstacles);
        let (share, reason) = self.share(now, wanted, obstacles, odom_from_base, bump, silence);
        let moving = self.model.drive.surface_speed(wanted) > 1e-3 || !wanted.is_finite();
        let zone = match share {
            _ if !moving => GuardZone::Clear,
            share if share < self.settings.stop_share => GuardZone::Stop,
            share if share < self.settings.clear_share => GuardZone::Slow,
            _ => GuardZone::Clear,
        };
        let allowed = if share <= 0.0 || !wanted.is_finite() {
            Twist2::ZERO
        } else {
            Twist2::new(share * wanted.v, share * wanted.w)
        };
        let twist = if self.fades(allowed) { Twist2::ZERO } else { allowed };
        self.motors.command(self.model.drive.wheels(twist), self.tick);
        Verdict {
            twist,
            zone,
            change: self.enter(now, zone, reason),
        }
    }

    /// The body has stopped its wheels by itself.
    pub(crate) fn rest(&mut self) {
        self.motors.reset();
    }

    /// The twist that is driven by now: the motors lag behind their commands.
    fn driven(&self) -> Twist2 {
        self.model.drive.twist(self.motors.speed())
    }

    /// Whether more than a gentle motion is left of earlier commands while only a gentle one is allowed now: the two together would not be
    /// gentle.
    fn fades(&self, allowed: Twist2) -> bool {
        let fastest = |twist| fastest_outward(&self.model.footprint, twist);
        fastest(allowed) <= FADED && fastest(self.driven()) > FADED
    }

    /// Time to contact with any known obstacle along a twist's arc, s; `None` without contact within the horizon.
    #[must_use]
    pub fn free_time(
        &self,
        twist: Twist2,
        horizon: f64,
        obstacles: &LocalObstacles,
        odom_from_base: Pose2,
    ) -> Option<f64> {
        let close = SweptFootprint::new(&self.model.footprint, LEAST_CLEARANCE, twist);
        let times = obstacles.in_base(odom_from_base).filter_map(|point| {
            if close.contains(point) {
                (share_beside(&self.model.footprint, twist, point) <= 0.0).then_some(0.0)
            } else {
                close.time_to_contact(point)
            }
        });
        times.filter(|time| *time < horizon).reduce(f64::min)
    }

    /// The share of a wanted twist that moving obstacles allow: `movers` in view, and those out of sight. In contact (`touched`), the
    /// bumper, static obstacles and unseen floor limit it too.
    #[must_use]
    pub fn share_among(
        &self,
        now: Stamp,
        wanted: Twist2,
        movers: &[Mover],
        obstacles: &LocalObstacles,
        odom_from_base: Pose2,
        touched: Option<&Bump>,
    ) -> f64 {
        let motion = self.motion(wanted, obstacles.age(now).unwrap_or(0.0).max(0.0));
        if motion.speed < 1e-6 {
            return 1.0;
        }
        let occluded = motion.limit_occluded(now, obstacles, odom_from_base);
        let moving = motion.limit_among(movers).min(occluded);
        let Some(bump) = touched else { return moving };
        let felt = if bump.pressed {
            self.share_in_contact(wanted, bump)
        } else {
            1.0
        };
        let standing = motion.limit_static(obstacles, odom_from_base);
        let floor = motion.limit_blind_spot(
            obstacles,
            odom_from_base,
            self.speed_into_blind_spot(now, obstacles, odom_from_base),
            self.unseen_speed,
        );
        moving.min(felt).min(standing).min(floor)
    }

    /// Allowed speed into the blind spot, m/s: zero while an obstacle that entered it may still be there.
    pub(crate) fn speed_into_blind_spot(&self, now: Stamp, obstacles: &LocalObstacles, odom_from_base: Pose2) -> f64 {
        match obstacles.moving().may_be_in_blind_spot(now, odom_from_base.position()) {
            true => 0.0,
            false => self.blind_speed,
        }
    }

    fn motion(&self, wanted: Twist2, age: f64) -> Motion<'_> {
        Motion::new(
            &self.model.footprint,
            &self.model.drive,
            wanted,
            age,
            self.tick,
            self.margin,
            &self.passive_safety,
        )
    }

    /// Time since the last scan arrived from the lidar that is farthest behind, s; before its second one, since the first was taken.
    fn silence(&mut self, now: Stamp, obstacles: &LocalObstacles) -> f64 {
        let Some(stamp) = obstacles.oldest() else {
            return f64::INFINITY;
        };
        let arrived = match self.scan {
            None => stamp,
            Some((last, arrived)) if last == stamp => arrived,
            Some(_) => now,
        };
        self.scan = Some((stamp, arrived));
        now.secs_since(arrived)
    }

    fn share(
        &self,
        now: Stamp,
        wanted: Twist2,
        obstacles: &LocalObstacles,
        odom_from_base: Pose2,
        bump: &Bump,
        silence: f64,
    ) -> (f64, &'static str) {
        if !wanted.is_finite() {
            return (0.0, "the command is not finite");
        }
        let age = match obstacles.age(now) {
            Some(age) if age <= self.settings.scan_timeout => age.max(0.0),
            Some(_) => return (0.0, "lidar scan too old"),
            None => return (0.0, "no lidar scan yet"),
        };
        let in_contact = if bump.pressed {
            self.share_in_contact(wanted, bump)
        } else {
            1.0
        };
        if in_contact <= 0.0 {
            return (0.0, "bumper contact");
        }
        let motion = self.motion(wanted, age);
        if motion.speed < 1e-6 {
            return (1.0, "");
        }
        let left =
            self.settings.rest_after_silence - silence - self.tick - self.passive_safety.lags_to_rest * motion.lag;
        let without_encoders = if self.encoders_silent {
            self.settings.without_encoders * self.model.drive.top_speed() / motion.speed
        } else {
            1.0
        };
        let blind_speed = self.speed_into_blind_spot(now, obstacles, odom_from_base);
        let limits = [
            (in_contact, "sliding along a contact"),
            (without_encoders.min(1.0), "the wheel encoders are silent"),
            (
                (motion.braking * left / motion.speed).clamp(0.0, 1.0),
                "lidar scan too old",
            ),
            (motion.limit_static(obstacles, odom_from_base), "obstacle in the way"),
            (
                motion.limit_dynamic(obstacles, odom_from_base),
                "moving obstacle nearby",
            ),
            (
                motion.limit_blind_spot(obstacles, odom_from_base, blind_speed, self.unseen_speed),
                "moving into the lidar's blind spot (`blind_speed` and `feeling_speed` allow more)",
            ),
            (
                motion.limit_occluded(now, obstacles, odom_from_base),
                "a moving obstacle may be in the lidar's blind spot",
            ),
        ];
        limits
            .into_iter()
            .fold((1.0, ""), |least, limit| if limit.0 < least.0 { limit } else { least })
    }

    /// The contact point of the bumper (base frame); `None` without contact.
    pub(crate) fn feel(&mut self, now: Stamp, bump: &Bump) -> Option<Point2<f64>> {
        if !bump.pressed {
            return None;
        }
        let lately = self.felt_toward.filter(|(_, felt)| now.secs_since(*felt) <= CHATTER);
        let moves = if self.driven().v < 0.0 { PI } else { 0.0 };
        self.felt_toward = Some((lately.map_or(moves, |(toward, _)| toward), now));
        Some(contact_point(&self.model.footprint, self.bearing(bump)))
    }

    fn bearing(&self, bump: &Bump) -> f64 {
        bump.bearing
            .or(self.felt_toward.map(|(toward, _)| toward))
            .unwrap_or(0.0)
    }

    /// The share of a motion allowed in contact: all of it away from the contact, slowly along it, and nothing towards it. Without a
    /// bearing the contact is assumed to lie where the robot was moving when it began, and no motion along it is allowed.
    fn share_in_contact(&self, wanted: Twist2, bump: &Bump) -> f64 {
        let touched = contact_point(&self.model.footprint, self.bearing(bump));
        let share = share_beside(&self.model.footprint, wanted, touched);
        let (closing, speed) = (closing_speed(&self.model.footprint, wanted, touched), wanted.v.abs());
        if share >= 1.0 && (speed < 1e-3 || closing < -self.settings.departure_share * speed) {
            1.0
        } else if bump.bearing.is_some() {
            share.min(self.settings.sliding_speed / speed.max(1e-3))
        } else {
            0.0
        }
    }

    /// Enters a zone; returns the reason when it is to be reported. A worse zone is entered at once, a milder one or another reason after
    /// the hysteresis.
    fn enter(&mut self, now: Stamp, zone: GuardZone, reason: &'static str) -> Option<String> {
        let rank = |zone| match zone {
            GuardZone::Clear => 0,
            GuardZone::Slow => 1,
            GuardZone::Stop => 2,
        };
        if rank(zone) >= rank(self.zone) {
            self.since = now;
        }
        let leaves = rank(zone) < rank(self.zone) && now.secs_since(self.since) >= self.settings.hysteresis;
        let differs = rank(zone) == rank(self.zone)
            && zone != GuardZone::Clear
            && reason != self.reported.0
            && now.secs_since(self.reported.1) >= self.settings.hysteresis;
        if rank(zone) > rank(self.zone) || leaves || differs {
            self.zone = zone;
            self.since = now;
            self.reported = (reason, now);
            return Some(if zone == GuardZone::Clear {
                "path clear".to_owned()
            } else {
                reason.to_owned()
            });
        }
        None
    }
}

#[cfg(test)]
mod tests;
