//! Collision monitor. May the robot move as it wants to? The monitor has the last word: after the limiters, directly before the wheels.
//!
//! It scales the wanted twist down, at constant curvature, until the robot can stop before any static obstacle, before any moving obstacle
//! could reach it, and within the floor that the lidar has seen, unless it feels its way at `unseen_speed`. It does not swing towards a
//! moving obstacle that has left the field of view, and slows down where somebody may come out from behind a corner (see
//! [`crate::passive_safety`]). A robot that only grazes an obstacle inside the margin may creep on while its time to contact is at least a
//! second; motion that does not reduce the clearance is always allowed. A gentle motion begins only after the motors' response to a faster
//! one has faded.
//!
//! Late scans delay the robot's reaction, so it drives accordingly more slowly. When scans stop arriving it slows down, and is at rest a
//! set time after the last one. While the wheel encoders are silent, or a lidar is mounted crooked, it drives slowly. A scan that is too
//! old or of the future, a command or an odometry that is not finite, and bumper contact stop it at once.

use std::f64::consts::PI;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{Bump, GuardZone};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::field_of_view::rigid;
use crate::local_obstacles::LocalObstacles;
use crate::passive_safety::{
    BrakingMotion, LEAST_CLEARANCE, Mover, closing_speed, contact_point, fastest_outward, share_beside,
};
use crate::settings::{CollisionMonitorSettings, EdgeSettings, PassiveSafetySettings};
use crate::time_to_contact::SweptFootprint;
use crate::wheel_coordination::WheelCoordination;

/// Reason of slowing down where nothing is in the way yet.
pub const AT_A_CORNER: &str = "somebody may come out from behind a corner";
/// Reasons of slowing down or stopping for want of scans.
pub const SCAN_TOO_OLD: &str = "lidar scan too old";
/// See [`SCAN_TOO_OLD`].
pub const NO_SCAN: &str = "no lidar scan yet";

/// No point of the outline moves outwards faster than this once a faster motion has faded, m/s.
const FADED: f64 = 0.009;
/// A body stops by itself if it gets no command for longer than this, s.
const LONGEST_PERIOD: f64 = 0.1;
/// A contact felt again within this time is the same contact, s.
const CHATTER: f64 = 0.5;

/// Judges every twist before it goes to the wheels.
#[derive(Clone, Debug)]
pub struct CollisionMonitor {
    model: RobotModel,
    /// Control period, s.
    tick: f64,
    /// Time until the next verdict, s: the control period, or what it has been of late if the body's readings come more slowly.
    period: f64,
    /// When the last verdict was given, and how long after the one before, s.
    judged: Option<(Stamp, f64)>,
    settings: CollisionMonitorSettings,
    passive_safety: PassiveSafetySettings,
    /// Age of a scan at which the robot stops, s.
    scan_timeout: f64,
    /// Time from the last scan until the robot is at rest, s.
    rest_after_silence: f64,
    /// Distance kept beyond the braking distance, m.
    pub margin: f64,
    /// Largest speed into the lidar's blind spot, m/s.
    pub blind_speed: f64,
    /// Largest speed over floor in the blind spot that was never seen, m/s.
    pub unseen_speed: f64,
    /// Whether the wheel encoders are silent although the wheels turn.
    pub encoders_silent: bool,
    /// Whether a lidar looks elsewhere than its file says.
    pub lidar_crooked: bool,
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
        let settings = EdgeSettings::default();
        Self {
            model: model.clone(),
            tick,
            period: tick,
            judged: None,
            scan_timeout: settings.scan_timeout(model),
            rest_after_silence: settings.rest_after_silence(model, tick),
            settings: settings.collision_monitor,
            passive_safety: settings.passive_safety,
            margin: model.controller.guard_margin,
            blind_speed: model.controller.blind_speed,
            unseen_speed: 0.0,
            encoders_silent: false,
            lidar_crooked: false,
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
        self.scan_timeout = settings.scan_timeout(&self.model);
        self.rest_after_silence = settings.rest_after_silence(&self.model, self.tick);
        self
    }

    /// The zone of the last verdict.
    #[must_use]
    pub fn zone(&self) -> GuardZone {
        self.zone
    }

    /// Judges a wanted twist.
    ///
    /// ```
    /// # use zenav_edge::{collision_monitor::CollisionMonitor, local_obstacles::LocalObstacles};
    /// # use zenav_protocol::{geometry::{Pose2, Twist2}, messages::{Bump, GuardZone}, time::Stamp};
    /// # let tiago = zenav_fixtures::robot("tiago");
    /// # let lidar = tiago.lidar.as_ref().unwrap();
    /// // Full speed ahead, 50 ms after a scan that shows a wall this far ahead of the base; the robot's radius is 0.265 m.
    /// let judge = |ahead: f64| {
    ///     let mut obstacles = LocalObstacles::new(&tiago);
    ///     obstacles.insert(&zenav_fixtures::sweep_in_room(lidar, 1.0, Pose2::IDENTITY, (ahead, 2.0), &[]), Pose2::IDENTITY);
    ///     let (now, wanted) = (Stamp::from_secs(1.05), Twist2::new(0.6, 0.0));
    ///     CollisionMonitor::new(&tiago, 0.02).judge(now, wanted, &obstacles, Pose2::IDENTITY, &Bump::none(now))
    /// };
    /// assert!(judge(2.0).zone == GuardZone::Clear && judge(2.0).twist.v > 0.59);
    /// assert_eq!((judge(0.27).zone, judge(0.27).twist), (GuardZone::Stop, Twist2::ZERO));
    /// ```
    pub fn judge(
        &mut self,
        now: Stamp,
        wanted: Twist2,
        obstacles: &LocalObstacles,
        odom_from_base: Pose2,
        bump: &Bump,
    ) -> Verdict {
        self.keep_pace(now);
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
        self.motors.command(self.model.drive.wheels(twist), self.period);
        Verdict {
            twist,
            zone,
            change: self.enter(now, zone, reason),
        }
    }

    /// Measures the time between verdicts. One long interval is a late tick; two in a row are the pace of the body.
    fn keep_pace(&mut self, now: Stamp) {
        let (gap, before) = match self.judged {
            Some((last, before)) => (now.secs_since(last).clamp(0.0, LONGEST_PERIOD), before),
            None => (0.0, 0.0),
        };
        self.period = self.tick.max(gap.min(before));
        self.judged = Some((now, gap));
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
        let felt = self.share_in_contact(wanted, bump);
        let standing = motion.limit_static(obstacles, odom_from_base);
        let floor = motion.limit_blind_spot(
            obstacles,
            odom_from_base,
            self.speed_into_blind_spot(now, obstacles, odom_from_base),
            self.unseen_speed,
        );
        moving.min(felt).min(standing).min(floor)
    }

    /// The share of a wanted twist that these people allow, who may come out from behind corners.
    pub(crate) fn share_past_corners(
        &self,
        now: Stamp,
        wanted: Twist2,
        people: &[Mover],
        obstacles: &LocalObstacles,
    ) -> f64 {
        let motion = self.motion(wanted, obstacles.age(now).unwrap_or(0.0).max(0.0));
        if motion.speed < 1e-6 {
            return 1.0;
        }
        motion.limit_corners(people)
    }

    /// Allowed speed into the blind spot, m/s: zero while an obstacle that entered it may still be there.
    pub(crate) fn speed_into_blind_spot(&self, now: Stamp, obstacles: &LocalObstacles, odom_from_base: Pose2) -> f64 {
        match obstacles.moving().may_be_in_blind_spot(now, odom_from_base.position()) {
            true => 0.0,
            false => self.blind_speed,
        }
    }

    /// People who may come out from behind corners, where no beam sees them.
    pub(crate) fn people_behind_corners(&self, obstacles: &LocalObstacles, odom_from_base: Pose2) -> Vec<Mover> {
        let speed = self.passive_safety.speed_round_corners(self.model.drive.top_speed());
        let base_from_odom = rigid(odom_from_base).inverse();
        let corners = obstacles.blind_corners().filter(|_| speed > 0.0);
        let radius = self.passive_safety.person_radius;
        corners
            .map(|corner| corner.person(&base_from_odom, radius, speed))
            .collect()
    }

    fn motion(&self, wanted: Twist2, age: f64) -> BrakingMotion<'_> {
        BrakingMotion::new(
            &self.model.footprint,
            &self.model.drive,
            wanted,
            age,
            self.period,
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
        if !odom_from_base.is_finite() {
            return (0.0, "the odometry is not finite");
        }
        let age = match obstacles.age(now) {
            Some(age) if age.abs() <= self.scan_timeout => age.max(0.0),
            Some(age) if age < 0.0 => return (0.0, "lidar scan of the future"),
            Some(_) => return (0.0, SCAN_TOO_OLD),
            None => return (0.0, NO_SCAN),
        };
        let in_contact = self.share_in_contact(wanted, bump);
        if in_contact <= 0.0 {
            return (0.0, "bumper contact");
        }
        let motion = self.motion(wanted, age);
        if motion.speed < 1e-6 {
            return (1.0, "");
        }
        let left = self.rest_after_silence - silence - self.period - self.passive_safety.lags_to_rest * motion.lag;
        let share_of_top = |share: f64, applies: bool| match applies {
            true => (share * self.model.drive.top_speed() / motion.speed).min(1.0),
            false => 1.0,
        };
        let blind_speed = self.speed_into_blind_spot(now, obstacles, odom_from_base);
        let limits = [
            (in_contact, "sliding along a contact"),
            (
                share_of_top(self.settings.without_encoders, self.encoders_silent),
                "the wheel encoders are silent",
            ),
            (
                share_of_top(self.settings.with_crooked_lidar, self.lidar_crooked),
                "a lidar looks elsewhere than its file says",
            ),
            ((motion.braking * left / motion.speed).clamp(0.0, 1.0), SCAN_TOO_OLD),
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
            (
                motion.limit_corners(&self.people_behind_corners(obstacles, odom_from_base)),
                AT_A_CORNER,
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

    /// The share of a motion allowed while the bumper is pressed: all of it away from the contact, slowly along it, and nothing towards it.
    /// Without a bearing the contact is assumed to lie where the robot was moving when it began, and no motion along it is allowed.
    fn share_in_contact(&self, wanted: Twist2, bump: &Bump) -> f64 {
        if !bump.pressed {
            return 1.0;
        }
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
