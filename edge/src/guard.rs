//! May the robot move as it wants to? The guard has the last word: after the limiters, straight before the wheels.
//!
//! The wanted twist is scaled down, curvature kept, until the robot can rest before it touches anything that stands, before
//! anything that moves could touch it, and within what was seen (see [`crate::stopping`]). Where that would pin a robot that
//! only grazes something within the margin, a time to collision of at least a second with the last centimetre allows it to
//! go on slowly; motion that does not reduce the clearance is always free. A stale scan, a command that is not finite, and
//! contact stop it.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{Bump, GuardZone};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::contact::Sweeper;
use crate::limiter::wheel_surface_speed;
use crate::stopping::{LAST_CENTIMETRE, Motion, approaches, closing};
use crate::surroundings::Surroundings;

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
pub struct Guard {
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
}

/// What the guard lets through.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// The twist to drive.
    pub twist: Twist2,
    /// How near something is.
    pub zone: GuardZone,
    /// Why, when the zone has changed with this verdict.
    pub change: Option<String>,
}

impl Guard {
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
        around: &Surroundings,
        odom_from_base: Pose2,
        bump: &Bump,
    ) -> Verdict {
        let (share, reason) = self.share(now, wanted, around, odom_from_base, bump);
        let moving = wheel_surface_speed(&self.model.drive, wanted) > 1e-3 || !wanted.is_finite();
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
    pub fn free_time(&self, twist: Twist2, horizon: f64, around: &Surroundings, odom_from_base: Pose2) -> Option<f64> {
        let close = Sweeper::new(&self.model.footprint, LAST_CENTIMETRE, twist);
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
        around: &Surroundings,
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
                "nobody looks where it leads",
            ),
        ];
        limits
            .into_iter()
            .fold((1.0, ""), |least, limit| if limit.0 < least.0 { limit } else { least })
    }

    /// Whether a motion leaves what is touched. Without a bearing the contact is taken to lie ahead.
    fn leaves(&self, wanted: Twist2, bump: &Bump) -> bool {
        let bearing = bump.bearing.unwrap_or(0.0);
        let toward = Vector2::new(bearing.cos(), bearing.sin());
        // Just outside the outline, found by halving along the bearing.
        let (mut inside, mut outside) = (0.0, 2.0 * self.model.footprint.circumscribed_radius());
        for _ in 0..20 {
            let middle = 0.5 * (inside + outside);
            if self.model.footprint.distance(Point2::from(toward * middle)) > 0.0 {
                outside = middle;
            } else {
                inside = middle;
            }
        }
        let touched = Point2::from(toward * (outside + 1e-3));
        let closing = closing(&self.model.footprint, wanted, touched);
        // Along what is touched is not away from it.
        closing < 1e-6 && (wanted.v.abs() < 1e-3 || closing < -AWAY * wanted.v.abs())
    }

    /// Notes the zone; returns a reason when it has changed. Worse zones count at once, milder ones after a while.
    fn enter(&mut self, now: Stamp, zone: GuardZone, reason: &str) -> Option<String> {
        let rank = |zone| match zone {
            GuardZone::Clear => 0,
            GuardZone::Slow => 1,
            GuardZone::Stop => 2,
        };
        if rank(zone) >= rank(self.zone) {
            self.since = now;
        }
        let leaves = rank(zone) < rank(self.zone) && now.secs_since(self.since) >= HYSTERESIS;
        if rank(zone) > rank(self.zone) || leaves {
            self.zone = zone;
            self.since = now;
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
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use zenav_protocol::readings::Sweep;
    use zenav_protocol::robot::shipped;

    const NO_BUMP: Bump = Bump {
        stamp: Stamp::ZERO,
        pressed: false,
        bearing: None,
    };

    fn tiago() -> RobotModel {
        RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap()
    }

    /// A TIAGo that looks all around.
    fn all_seeing() -> RobotModel {
        let mut model = tiago();
        model.lidar.field_of_view = std::f64::consts::TAU;
        model
    }

    /// A wall across the way at `distance` ahead of the base.
    fn wall(model: &RobotModel, distance: f64) -> Surroundings {
        let lidar = &model.lidar;
        let mut around = Surroundings::new(lidar, &model.footprint);
        let range = |beam: usize| {
            let cos = (lidar.angle_min() + beam as f64 * lidar.angle_increment()).cos();
            if cos > 0.05 {
                ((distance - lidar.mount.x) / cos) as f32
            } else {
                f32::INFINITY
            }
        };
        around.insert(
            &Sweep {
                stamp: Stamp::from_secs(1.0),
                ranges: (0..lidar.beams).map(range).collect(),
            },
            Pose2::IDENTITY,
        );
        around
    }

    fn judge(model: &RobotModel, around: &Surroundings, wanted: Twist2) -> Verdict {
        Guard::new(model, 0.02, 0.5).judge(Stamp::from_secs(1.05), wanted, around, Pose2::IDENTITY, &NO_BUMP)
    }

    #[test]
    fn full_speed_at_a_wall_is_slowed_and_stopped_before_it() {
        let model = tiago();
        let full = Twist2::new(0.6, 0.0);
        assert_eq!(judge(&model, &wall(&model, 2.0), full).zone, GuardZone::Clear);
        let near = judge(&model, &wall(&model, 0.42), full);
        assert!(near.zone == GuardZone::Slow && near.twist.v < 0.5, "{near:?}");
        assert_eq!(judge(&model, &wall(&model, 0.27), full).twist.v, 0.0);
        assert_eq!(judge(&model, &wall(&model, 0.27), full).zone, GuardZone::Stop);
    }

    #[test]
    fn a_robot_at_a_wall_may_turn_and_back_away() {
        let model = all_seeing();
        let around = wall(&model, 0.28);
        assert_eq!(judge(&model, &around, Twist2::new(0.0, 1.5)).twist.w, 1.5);
        assert_eq!(judge(&model, &around, Twist2::new(-0.3, 0.0)).twist.v, -0.3);
    }

    #[test]
    fn a_wall_alongside_at_a_tenth_of_a_metre_slows_nothing() {
        let model = tiago();
        let lidar = &model.lidar;
        let mut around = Surroundings::new(lidar, &model.footprint);
        let ranges = (0..lidar.beams).map(|beam| {
            let sin = (lidar.angle_min() + beam as f64 * lidar.angle_increment()).sin();
            if sin > 0.05 {
                (0.365 / sin) as f32
            } else {
                f32::INFINITY
            }
        });
        around.insert(
            &Sweep {
                stamp: Stamp::from_secs(1.0),
                ranges: ranges.collect(),
            },
            Pose2::IDENTITY,
        );
        assert_eq!(judge(&model, &around, Twist2::new(0.6, 0.0)).twist.v, 0.6);
    }

    #[test]
    fn without_a_fresh_scan_nothing_moves() {
        let model = tiago();
        let mut guard = Guard::new(&model, 0.02, 0.5);
        let stale = guard.judge(
            Stamp::from_secs(1.6),
            Twist2::new(0.1, 0.0),
            &wall(&model, 3.0),
            Pose2::IDENTITY,
            &NO_BUMP,
        );
        assert_eq!((stale.twist, stale.zone), (Twist2::ZERO, GuardZone::Stop));
        assert_eq!(stale.change.as_deref(), Some("the scan is too old"));
        let none = guard.judge(
            Stamp::from_secs(1.6),
            Twist2::new(0.1, 0.0),
            &Surroundings::new(&model.lidar, &model.footprint),
            Pose2::IDENTITY,
            &NO_BUMP,
        );
        assert_eq!(none.twist, Twist2::ZERO);
    }

    #[test]
    fn contact_allows_only_the_way_back() {
        let model = all_seeing();
        let around = wall(&model, 3.0);
        let bump = Bump {
            stamp: Stamp::ZERO,
            pressed: true,
            bearing: Some(0.3),
        };
        let mut guard = Guard::new(&model, 0.02, 0.5);
        let now = Stamp::from_secs(1.05);
        assert_eq!(
            guard
                .judge(now, Twist2::new(0.2, 0.0), &around, Pose2::IDENTITY, &bump)
                .twist,
            Twist2::ZERO
        );
        assert_eq!(
            guard
                .judge(now, Twist2::new(-0.2, 0.0), &around, Pose2::IDENTITY, &bump)
                .twist
                .v,
            -0.2
        );
    }

    /// Free floor all around, seen at 1.0 s from a robot that looks along `yaw`.
    fn looked(around: &mut Surroundings, model: &RobotModel, secs: f64, yaw: f64) {
        let sweep = Sweep {
            stamp: Stamp::from_secs(secs),
            ranges: vec![f32::INFINITY; model.lidar.beams],
        };
        assert!(around.insert(&sweep, Pose2::new(0.0, 0.0, yaw)));
    }

    #[test]
    fn where_nobody_looks_it_backs_up_over_known_floor_only_and_as_slowly_as_it_is_told() {
        let model = tiago();
        let mut guard = Guard::new(&model, 0.02, 0.5);
        let mut back = |around: &Surroundings, allowed: f64| {
            guard.blind_speed = allowed;
            let wanted = Twist2::new(-0.3, 0.0);
            -guard
                .judge(Stamp::from_secs(1.05), wanted, around, Pose2::IDENTITY, &NO_BUMP)
                .twist
                .v
        };
        let mut ahead = Surroundings::new(&model.lidar, &model.footprint);
        looked(&mut ahead, &model, 1.0, 0.0);
        assert!(back(&ahead, 0.15) <= 0.01, "never seen");
        let mut both = Surroundings::new(&model.lidar, &model.footprint);
        looked(&mut both, &model, 0.5, std::f64::consts::PI);
        looked(&mut both, &model, 1.0, 0.0);
        assert!((back(&both, 0.15) - 0.15).abs() < 1e-9);
        assert!(back(&both, 0.0) <= 0.01, "somebody may have come up");
    }

    #[test]
    fn what_comes_at_the_robot_stops_it_earlier_than_what_stands() {
        let model = tiago();
        let lidar = &model.lidar;
        let mut moving = Surroundings::new(lidar, &model.footprint);
        let mut standing = Surroundings::new(lidar, &model.footprint);
        let post = |distance: f64, secs: f64| Sweep {
            stamp: Stamp::from_secs(secs),
            ranges: (0..lidar.beams)
                .map(|beam| {
                    let angle = lidar.angle_min() + beam as f64 * lidar.angle_increment();
                    if angle.abs() < 0.2 {
                        distance as f32
                    } else {
                        f32::INFINITY
                    }
                })
                .collect(),
        };
        for (secs, distance) in [(0.6, 0.7), (0.8, 0.6), (1.0, 0.5)] {
            moving.insert(&post(distance, secs), Pose2::IDENTITY);
            standing.insert(&post(0.5, secs), Pose2::IDENTITY);
        }
        let wanted = Twist2::new(0.5, 0.0);
        assert_eq!(judge(&model, &standing, wanted).twist.v, 0.5);
        let verdict = judge(&model, &moving, wanted);
        assert!(verdict.twist.v < 0.4 && verdict.change.unwrap().contains("moves"));
    }

    proptest! {
        #[test]
        fn the_guard_only_ever_scales_down(v in prop::num::f64::ANY, w in prop::num::f64::ANY, distance in 0.3..3.0) {
            let model = tiago();
            let verdict = judge(&model, &wall(&model, distance), Twist2::new(v, w));
            prop_assert!(verdict.twist.is_finite());
            if v.is_finite() && w.is_finite() {
                prop_assert!(verdict.twist.v.abs() <= v.abs() && verdict.twist.w.abs() <= w.abs());
            }
        }
    }
}
