//! Chassis. The motion of one robot among solids, and its contacts: a contact blocks motion into the obstacle.
//!
//! Motion is cut into pieces shorter than the footprint is wide, so that no obstacle is skipped. A piece that would bring the true
//! outline into contact is halved until the robot stands in front of the obstacle, and its wheels stall. A piece that only grazes the
//! obstacle slides along it. Exact distances are computed only where the last known clearance does not already rule contact out.

use parry2d_f64::math::Vector;
use parry2d_f64::query;
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::robot::{BatteryModel, Drive, RobotModel};
use zenav_protocol::time::Stamp;

use crate::clearance::{Placed, halved};
use crate::crowd::Crowd;
use crate::motors::Motors;
use crate::scene::Scene;
use crate::sensors::random::gauss;
use crate::shape::Solid;

/// Gap between a blocked robot and the obstacle, m: contact without overlap by rounding.
const SKIN: f64 = 1e-6;
/// A clearance up to this is contact, m.
pub(crate) const CONTACT: f64 = 1e-4;
/// A robot whose outline approaches what it touches by no more than this share of its motion grazes it, and slides along.
const GRAZE: f64 = 0.05;
/// A contact ends at this distance, m: one touch is one collision.
const RELEASE: f64 = 2e-3;
/// People farther away are not reported, m.
const SPACE: f64 = 3.0;
/// Longest integration step of motors and arcs, s.
const SUBSTEP: f64 = 0.005;
/// Number of halvings of a blocked piece to find how far it goes.
const HALVINGS: u32 = 20;

/// A collision, at its beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// When.
    pub stamp: Stamp,
    /// Direction of the touched point in the base frame, rad.
    pub bearing: f64,
    /// The robot's own speed towards the obstacle when they met, m/s; about zero when something ran into the robot.
    pub own_speed: f64,
}

/// Ground truth, which no robot knows exactly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Pose of the robot.
    pub map_from_base: Pose2,
    /// Its velocity, base frame.
    pub twist: Twist2,
    /// Distance from the footprint to the nearest solid, mover or robot, m; infinite if there is none.
    pub clearance: f64,
    /// The least clearance since the beginning, m.
    pub min_clearance: f64,
    /// Distance from the footprint to the nearest round mover, that is, a person, m; infinite if none is within 3 m.
    pub to_person: f64,
    /// Contacts since the beginning; a lasting contact counts once.
    pub collisions: u32,
    /// The latest contact.
    pub last_contact: Option<Contact>,
    /// The robot's largest own speed towards something that it touched, m/s.
    pub hardest_contact: f64,
    /// Distance driven since the beginning, forwards and backwards, m.
    pub length: f64,
    /// Energy drawn since the beginning, J.
    pub drawn_j: f64,
}

/// Everything that can be touched: the static scene, and everything that moves except this robot.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// The static scene.
    pub scene: &'a Scene,
    /// Movers and robots.
    pub crowd: &'a Crowd,
    /// The robot's own index in the crowd.
    pub own: usize,
}

impl Surroundings<'_> {
    /// Distance from a footprint to the nearest solid, m; infinite if there is none. Exact.
    #[must_use]
    pub fn clearance(&self, placed: &Placed) -> f64 {
        let moving = self.crowd.nearest(placed, self.own);
        moving
            .map_or(f64::INFINITY, |(distance, _)| distance)
            .min(self.scene.distance(placed))
    }

    /// Contact of a footprint with the nearest solid; `None` if nothing is near, and inside a solid.
    fn contact(&self, placed: &Placed) -> Option<query::Contact> {
        let moving = self.crowd.nearest(placed, self.own);
        let moving = moving.and_then(|(_, solid)| solid.contact(placed, RELEASE));
        let both = moving.into_iter().chain(self.scene.contact(placed, RELEASE));
        both.min_by(|a, b| a.dist.total_cmp(&b.dist))
    }
}

/// Motion of a tick, for the sensors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moved {
    /// True turns of the wheels (left, right), rad.
    pub wheels: [f64; 2],
    /// True turn of the base, rad.
    pub turn: f64,
    /// Upper bound of the motion of any point of the footprint, m.
    pub reach: f64,
}

/// Wheels, footprint and battery of one robot.
#[derive(Clone)]
pub struct Chassis {
    motors: Motors,
    footprint: Placed,
    floor: Pcg64Mcg,
    reach: f64,
    inscribed: f64,
    /// Lower bound of the distance to any solid, m: exact at the end of a tick.
    clearance: f64,
    touching: bool,
    bearing: Option<f64>,
    truth: Truth,
}

impl Chassis {
    /// At rest at a pose. `floor` is the random stream of the wheels' slip.
    #[must_use]
    pub fn new(model: &RobotModel, map_from_base: Pose2, floor: Pcg64Mcg) -> Self {
        let truth = Truth {
            map_from_base,
            twist: Twist2::ZERO,
            clearance: f64::INFINITY,
            min_clearance: f64::INFINITY,
            to_person: f64::INFINITY,
            collisions: 0,
            last_contact: None,
            hardest_contact: 0.0,
            length: 0.0,
            drawn_j: 0.0,
        };
        let (reach, inscribed) = (
            model.footprint.circumscribed_radius(),
            model.footprint.inscribed_radius(),
        );
        Self {
            motors: Motors::at_rest(),
            footprint: Placed::footprint(&model.footprint, map_from_base),
            floor,
            reach,
            inscribed,
            clearance: 0.0,
            touching: false,
            bearing: None,
            truth,
        }
    }

    /// Commands the wheels (left, right; rad/s).
    pub fn command(&mut self, model: &RobotModel, wheels: [f64; 2]) {
        self.motors.command(&model.drive, wheels);
    }

    /// Moves to another pose at once.
    pub fn carry(&mut self, to: Pose2) {
        self.truth.map_from_base = to;
        (self.touching, self.bearing, self.clearance) = (false, None, 0.0);
    }

    /// The truth at the end of the last tick.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.truth
    }

    /// The footprint where the robot is.
    #[must_use]
    pub fn outline(&self) -> Placed {
        self.footprint.at(self.truth.map_from_base)
    }

    /// Charge left, 0 to 1.
    #[must_use]
    pub fn charge(&self, battery: &BatteryModel) -> f64 {
        (1.0 - self.truth.drawn_j / battery.capacity).max(0.0)
    }

    /// Direction of the touched point in the base frame, rad, while something is touched.
    #[must_use]
    pub fn bump(&self) -> Option<f64> {
        self.bearing
    }

    /// Drives for a time. `others` bounds how far anything else has moved since the last call of [`Self::settle`], m.
    pub fn advance(
        &mut self,
        model: &RobotModel,
        around: Surroundings<'_>,
        secs: f64,
        others: f64,
        now: Stamp,
    ) -> Moved {
        self.clearance -= others;
        if self.charge(&model.battery) <= 0.0 {
            self.motors.command(&model.drive, [0.0; 2]);
        }
        let substeps = (secs / SUBSTEP).ceil().clamp(1.0, 1000.0);
        let mut moved = Moved::default();
        for _ in 0..substeps as u32 {
            self.substep(model, around, secs / substeps, now, &mut moved);
        }
        moved
    }

    fn substep(&mut self, model: &RobotModel, around: Surroundings<'_>, secs: f64, now: Stamp, moved: &mut Moved) {
        let before = self.motors.speed();
        let wheels = self.motors.step(&model.drive, secs);
        let after = self.motors.speed();
        let gained = [(after[0] - before[0]) / secs, (after[1] - before[1]) / secs];
        self.truth.drawn_j += model.power(wheels, gained) * secs;
        let turning = model.drive.true_twist(wheels);
        let twist = model.drive.true_twist(self.slipped(&model.drive, wheels, secs));
        let share = if wheels == [0.0; 2] {
            1.0
        } else {
            self.roll(around, [twist, turning], secs, now)
        };
        let secs_moving = secs * share;
        for (sum, speed) in moved.wheels.iter_mut().zip(wheels) {
            *sum += speed * secs_moving;
        }
        moved.turn += twist.w * secs_moving;
        moved.reach += (1.0 + GRAZE) * self.speed_of_outline(twist) * secs_moving;
        self.truth.length += twist.v.abs() * secs_moving;
        if share < 1.0 {
            self.motors.stall();
        }
        self.truth.twist = model.drive.true_twist(self.motors.speed());
    }

    /// The wheel speeds after slip, rad/s: a random walk along the distance, whatever the step.
    fn slipped(&mut self, drive: &Drive, wheels: [f64; 2], secs: f64) -> [f64; 2] {
        let slip = drive.errors.slip;
        if slip <= 0.0 {
            return wheels;
        }
        wheels.map(|speed| {
            let rolled = (speed * drive.wheel_radius * secs).abs();
            speed + gauss(&mut self.floor, slip * rolled.sqrt()) / (drive.wheel_radius * secs)
        })
    }

    /// Upper bound of the speed of any point of the footprint, m/s.
    fn speed_of_outline(&self, twist: Twist2) -> f64 {
        twist.v.abs() + twist.w.abs() * self.reach
    }

    /// Moves along an arc until something is touched; returns the share of the time in which it could move. `turning` is the motion of
    /// the wheels without slip: slip is a random walk, with a distance but no speed.
    fn roll(&mut self, around: Surroundings<'_>, [twist, turning]: [Twist2; 2], secs: f64, now: Stamp) -> f64 {
        let pieces = (self.speed_of_outline(twist) * secs / self.inscribed)
            .ceil()
            .clamp(1.0, 1000.0);
        let piece = secs / pieces;
        let reach = self.speed_of_outline(twist) * piece;
        for done in 0..pieces as u32 {
            let here = self.truth.map_from_base;
            if self.clearance - reach > SKIN {
                self.clearance -= reach;
                self.truth.map_from_base = here.advance(twist, piece);
                continue;
            }
            let exact = |pose: Pose2| around.clearance(&self.footprint.at(pose));
            let next = here.advance(twist, piece);
            let there = exact(next);
            // A robot in contact may still turn on the spot or move away.
            let before = exact(here);
            if there > SKIN || there >= before {
                self.clearance = there;
                self.truth.map_from_base = next;
                continue;
            }
            if let Some((beside, clearance)) = self.pushed_aside(around, next, before, twist, piece) {
                self.clearance = clearance;
                self.truth.map_from_base = beside;
                self.touch(around, turning, now);
                continue;
            }
            // Pressed against an obstacle already: nothing left to halve.
            let halvings = if before <= 2.0 * SKIN { 0 } else { HALVINGS };
            let is_free = |share: f64| exact(here.advance(twist, share * piece)) > SKIN;
            let free = halved(0.0, 1.0, halvings, is_free);
            self.truth.map_from_base = here.advance(twist, free * piece);
            self.clearance = exact(self.truth.map_from_base);
            self.touch(around, turning, now);
            return (f64::from(done) + free) / pieces;
        }
        1.0
    }

    /// The pose to which a robot that grazes something is pushed, and its clearance there: its tyres give way sideways by so little.
    /// `next` is where its wheels alone would take it from a clearance of `before` (m), by a twist for `secs` seconds.
    fn pushed_aside(
        &self,
        around: Surroundings<'_>,
        next: Pose2,
        before: f64,
        twist: Twist2,
        secs: f64,
    ) -> Option<(Pose2, f64)> {
        let contact = around.contact(&self.footprint.at(next))?;
        let way = velocity_at(twist, contact.point1).length() * secs;
        if before - contact.dist > GRAZE * way {
            return None;
        }
        let out = contact.normal1 * (contact.dist - 2.0 * SKIN);
        let beside = next * Pose2::new(out.x, out.y, 0.0);
        let clearance = around.clearance(&self.footprint.at(beside));
        (clearance > SKIN).then_some((beside, clearance))
    }

    fn touch(&mut self, around: Surroundings<'_>, twist: Twist2, now: Stamp) {
        let contact = around.contact(&self.outline());
        // A solid that contains the whole robot has no contact point: straight ahead is taken.
        let (at, normal) = contact.map_or((Vector::ZERO, Vector::X), |found| (found.point1, found.normal1));
        let bearing = at.y.atan2(at.x);
        self.bearing = Some(bearing);
        let own_speed = velocity_at(twist, at).dot(normal);
        self.truth.hardest_contact = self.truth.hardest_contact.max(own_speed);
        if self.touching {
            return;
        }
        self.touching = true;
        self.truth.collisions = self.truth.collisions.saturating_add(1);
        self.truth.last_contact = Some(Contact {
            stamp: now,
            bearing,
            own_speed,
        });
    }

    /// Updates the distance to the nearest solid that is a person.
    pub fn meet(&mut self, crowd: &Crowd, is_person: impl Fn(usize, &Solid) -> bool) {
        let (outline, mut nearest) = (self.outline(), f64::INFINITY);
        crowd.near(outline.center(), self.reach + SPACE, |index, solid| {
            if is_person(index, solid) {
                nearest = nearest.min(solid.distance(&outline));
            }
        });
        self.truth.to_person = if nearest <= SPACE { nearest } else { f64::INFINITY };
    }

    /// Discards the known clearance, because a solid has appeared at once.
    pub fn look_again(&mut self) {
        self.clearance = 0.0;
    }

    /// Ends a tick after everything has moved: true clearance, and contacts caused by others.
    pub fn settle(&mut self, around: Surroundings<'_>, now: Stamp) {
        let clearance = around.clearance(&self.outline());
        self.clearance = clearance;
        self.truth.clearance = clearance;
        self.truth.min_clearance = self.truth.min_clearance.min(clearance);
        if clearance <= CONTACT {
            self.touch(around, self.truth.twist, now);
        } else {
            self.bearing = None;
            if clearance > RELEASE {
                self.touching = false;
            }
        }
    }
}
/// Velocity of a point of a robot that moves with a twist, base frame, m/s.
fn velocity_at(twist: Twist2, point: Vector) -> Vector {
    Vector::new(twist.v - twist.w * point.y, twist.w * point.x)
}
