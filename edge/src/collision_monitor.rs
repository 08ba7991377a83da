//! May the robot move as it wants to? The guard has the last word: after the limiters, straight before the wheels.
//!
//! The wanted twist is scaled down, curvature kept, until the robot can rest before it touches anything that stands, before
//! anything that moves could touch it, and within what was seen; what has gone out of sight it does not swing at (see
//! [`crate::passive_safety`]). Where that would pin a robot that only grazes something within the margin, a time to collision of at
//! least a second with the last centimetre allows it to go on slowly; motion that does not reduce the clearance is always free.
//! A stale scan, a command that is not finite, and contact stop it.

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{Bump, GuardZone};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::local_obstacles::LocalObstacles;
use crate::passive_safety::{LAST_CENTIMETRE, Motion, approaches, closing, touched};
use crate::time_to_contact::SweptFootprint;

/// Motion slower than this share of the wanted counts as stopped.
const STOPPED: f64 = 0.02;
/// Motion faster than this share of the wanted counts as clear.
const CLEAR: f64 = 0.95;
/// From what it touches a robot drives off with at least this share of its speed.
const AWAY: f64 = 0.2;
/// A zone must last this long before it is left for a milder one, s.
const HYSTERESIS: f64 = 0.3;

/// The last word.
#[derive(Clone, Debug)]
pub struct CollisionMonitor {
    model: RobotModel,
    /// The footprint's distances are small against this: points farther away are not looked at.
    tick: f64,
    scan_timeout: f64,
    /// Distance kept beyond the braking distance, m.
    pub margin: f64,
    /// Fastest speed to where the lidar does not look, m/s.
    pub blind_speed: f64,
    zone: GuardZone,
    since: Stamp,
    /// Why it stepped in last, and when that was told.
    told: (&'static str, Stamp),
}

/// What the guard lets through.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// The twist to drive.
    pub twist: Twist2,
    /// How near something is.
    pub zone: GuardZone,
    /// Why, when the zone has changed with this verdict, or stays for another reason.
    pub change: Option<String>,
}

impl CollisionMonitor {
    /// A guard for a robot, with its control period and the age at which a scan is too old, both in s.
    #[must_use]
    pub fn new(model: &RobotModel, tick: f64, scan_timeout: f64) -> Self {
        Self {
            model: model.clone(),
            tick,
            scan_timeout,
            margin: model.controller.guard_margin,
            blind_speed: model.controller.blind_speed,
            zone: GuardZone::Clear,
            since: Stamp::ZERO,
            told: ("", Stamp::ZERO),
        }
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
        around: &LocalObstacles,
        odom_from_base: Pose2,
        bump: &Bump,
    ) -> Verdict {
        let (share, reason) = self.share(now, wanted, around, odom_from_base, bump);
        let moving = self.model.drive.surface_speed(wanted) > 1e-3 || !wanted.is_finite();
        let zone = match share {
            _ if !moving => GuardZone::Clear,
            share if share < STOPPED => GuardZone::Stop,
            share if share < CLEAR => GuardZone::Slow,
            _ => GuardZone::Clear,
        };
        let twist = if share <= 0.0 || !wanted.is_finite() {
            Twist2::ZERO
        } else {
            Twist2::new(share * wanted.v, share * wanted.w)
        };
        Verdict {
            twist,
            zone,
            change: self.enter(now, zone, reason),
        }
    }

    /// How far the base could go along a twist's arc before contact, as a time at that twist, s; `None` for free way
    /// within the horizon.
    #[must_use]
    pub fn free_time(
        &self,
        twist: Twist2,
        horizon: f64,
        around: &LocalObstacles,
        odom_from_base: Pose2,
    ) -> Option<f64> {
        let close = SweptFootprint::new(&self.model.footprint, LAST_CENTIMETRE, twist);
        let times = around.in_base(odom_from_base).filter_map(|point| {
            if close.holds(point) {
                approaches(&self.model.footprint, twist, point).then_some(0.0)
            } else {
                close.contact(point)
            }
        });
        times.filter(|time| *time < horizon).reduce(f64::min)
    }

    fn share(
        &self,
        now: Stamp,
        wanted: Twist2,
        around: &LocalObstacles,
        odom_from_base: Pose2,
        bump: &Bump,
    ) -> (f64, &'static str) {
        if !wanted.is_finite() {
            return (0.0, "the command is not a number");
        }
        let age = match around.age(now) {
            Some(age) if age <= self.scan_timeout => age.max(0.0),
            Some(_) => return (0.0, "the scan is too old"),
            None => return (0.0, "no scan yet"),
        };
        if bump.pressed && !self.leaves(wanted, bump) {
            return (0.0, "contact");
        }
        let motion = Motion::new(
            &self.model.footprint,
            &self.model.drive,
            wanted,
            age,
            self.tick,
            self.margin,
        );
        if motion.speed < 1e-6 {
            return (1.0, "");
        }
        let limits = [
            (motion.past_obstacles(around, odom_from_base), "an obstacle in the way"),
            (motion.past_intruders(around, odom_from_base), "something moves nearby"),
            (
                motion.into_the_blind(around, odom_from_base, self.blind_speed),
                "nobody looks where it leads (`blind_speed` allows more)",
            ),
            (
                motion.past_the_lost(now, around, odom_from_base),
                "something that moves is out of sight",
            ),
        ];
        limits
            .into_iter()
            .fold((1.0, ""), |least, limit| if limit.0 < least.0 { limit } else { least })
    }

    /// Whether a motion leaves what is touched. Without a bearing the contact is taken to lie ahead.
    fn leaves(&self, wanted: Twist2, bump: &Bump) -> bool {
        let touched = touched(&self.model.footprint, bump);
        let closing = closing(&self.model.footprint, wanted, touched);
        // Along what is touched is not away from it.
        closing < 1e-6 && (wanted.v.abs() < 1e-3 || closing < -AWAY * wanted.v.abs())
    }

    /// Notes the zone; returns a reason when there is something to tell. Worse zones count at once, milder ones and other reasons
    /// after a while.
    fn enter(&mut self, now: Stamp, zone: GuardZone, reason: &'static str) -> Option<String> {
        let rank = |zone| match zone {
            GuardZone::Clear => 0,
            GuardZone::Slow => 1,
            GuardZone::Stop => 2,
        };
        if rank(zone) >= rank(self.zone) {
            self.since = now;
        }
        let leaves = rank(zone) < rank(self.zone) && now.secs_since(self.since) >= HYSTERESIS;
        let differs = rank(zone) == rank(self.zone)
            && zone != GuardZone::Clear
            && reason != self.told.0
            && now.secs_since(self.told.1) >= HYSTERESIS;
        if rank(zone) > rank(self.zone) || leaves || differs {
            self.zone = zone;
            self.since = now;
            self.told = (reason, now);
            return Some(if zone == GuardZone::Clear {
                "the way is free".to_owned()
            } else {
                reason.to_owned()
            });
        }
        None
    }
}

#[cfg(test)]
mod tests;
