//! Passive safety. How fast may a robot go and still be at rest before any contact? Five limits: static obstacles, moving obstacles, the
//! lidar's blind spot, moving obstacles that have left the field of view, and people who may come out from behind a corner. Each is a share
//! of the wanted twist at constant curvature.
//!
//! Static: reaction (scan age, tick, motor lag) plus braking distance, `u tau + u²/(2 a)`, within the time to contact along the robot's own
//! arc. Slow motors count with as many time constants as they need to come to rest, so that the approach is critically damped.
//! Moving: passive safety (Macek et al., "Towards safe vehicle navigation in dynamic urban scenarios", Automatika 2009): a moving
//! obstacle may approach at the assumed speed, around the robot but not through it; the robot is at rest by the time that it could arrive.
//! Occluded (Bouraine et al., "Provably safe navigation for mobile robots with limited field-of-views in dynamic environments", Autonomous
//! Robots 2012): by that time no point of the outline moves outwards faster than gently, by driving or by turning.
//!
//! Contacts with points and distances from them are closed forms instead of parry's iterations, because every tick needs them for every
//! point of a scan: contacts are over 200 times, distances 3.6 times as fast (`cargo bench -p zenav-edge --bench collision_monitor`).

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::polygon::{Edge, edges};
use zenav_protocol::robot::{Drive, Footprint};
use zenav_protocol::time::Stamp;

use crate::blind_spot_grid::Floor;
use crate::field_of_view::rigid;
use crate::local_obstacles::LocalObstacles;
use crate::settings::PassiveSafetySettings;
use crate::time_to_contact::SweptFootprint;

/// No obstacle nearer than this is approached, m.
pub(crate) const LEAST_CLEARANCE: f64 = 0.01;
/// Shares of the wanted twist tried against moving obstacles.
const SHARES: [f64; 8] = [1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1, 0.05];
/// Spacing of the samples of the outline, and of the poses that they are checked at, m.
const SAMPLE: f64 = 0.04;
/// Number of steps in the time until rest.
const STOPPING_STEPS: u32 = 5;
/// Most poses checked along the stopping distance.
const MAX_POSES: f64 = 100.0;
/// Top speed of any robot that announces its course, m/s.
const FASTEST_ROBOT: f64 = 3.0;
/// A closing speed up to this counts as none, m/s.
const RESTING: f64 = 1e-6;
/// Contact at this speed is harmless, m/s.
pub(crate) const GENTLE: f64 = 0.008;
/// Harmless residual speed of a controller towards a contact, m/s.
const HARMLESS: f64 = 0.25 * GENTLE;
/// A point inside an outline may have come in through every side behind which it is at most this much deeper than behind the nearest, m.
const CORNER: f64 = 0.03;
/// A touching obstacle is seen inside the outline by no more than this, m.
const DEPTH: f64 = 0.05;
/// A motion that closes in on a point at no more than this share of its speed slides along it.
const SLIDING: f64 = 0.05;

/// A wanted motion, and how fast it can be brought to rest.
#[derive(Clone, Copy, Debug)]
pub struct BrakingMotion<'a> {
    /// Outline on the floor.
    pub footprint: &'a Footprint,
    /// The wanted twist, base frame.
    pub twist: Twist2,
    /// Speed of the faster wheel's contact point, m/s.
    pub speed: f64,
    /// Time before braking begins: scan age, tick and motor lag, s.
    pub reaction: f64,
    /// Deceleration, m/s².
    pub braking: f64,
    /// Time constant of the motors, s.
    pub lag: f64,
    /// What slow motors add to the reaction before a static obstacle, s: with one time constant alone they would overshoot.
    pub trailing: f64,
    /// Distance kept beyond the braking distance, m.
    pub margin: f64,
    /// Tunables.
    pub settings: &'a PassiveSafetySettings,
}

/// A moving disc or point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mover {
    /// Its center, base frame, m.
    pub at: Point2<f64>,
    /// m; zero for a point.
    pub radius: f64,
    /// Its known velocity, base frame, m/s.
    pub velocity: Vector2<f64>,
    /// Its largest speed relative to that, m/s.
    pub speed: f64,
    /// How far it may have moved between the beam that hit it and the newest sweep's stamp, m; negative: how far it must move to be there.
    pub travelled: f64,
}

impl Mover {
    /// A mover that turns at will, at a speed up to this, m/s.
    #[must_use]
    pub fn at_will(at: Point2<f64>, radius: f64, speed: f64) -> Self {
        Self {
            at,
            radius,
            velocity: Vector2::zeros(),
            speed,
            travelled: 0.0,
        }
    }
}

/// A moving disc that has left the field of view: no part of it is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hidden {
    /// One of its points when it was last seen, base frame of the newest sweep, m.
    pub last_seen: Point2<f64>,
    /// How far it may have moved since, m.
    pub travelled: f64,
    /// Its minimum radius, m.
    pub radius: f64,
    /// Its largest speed, m/s.
    pub speed: f64,
}

/// One step of a motion until rest.
struct Step {
    /// Its end, s from now.
    until: f64,
    /// The robot's largest speed within it, as a share of the wanted twist.
    share: f64,
    /// The base frame at its beginning, in the present base frame.
    here_from_there: Isometry2<f64>,
    /// Path length of the base from now to its beginning, and to its end, m.
    way: [f64; 2],
}

impl Step {
    /// A disc that the robot occupies throughout, from now to the end of the step, in the base frame at its beginning. `inscribed` is the
    /// radius of a disc around the base, m. The base is never farther than `way[1] - way[0] / 2` from the middle between its places now and
    /// at the beginning.
    fn always_occupied(&self, there_from_here: Isometry2<f64>, inscribed: f64) -> Disc {
        Disc {
            center: Point2::from(0.5 * there_from_here.translation.vector),
            radius: inscribed - (self.way[1] - 0.5 * self.way[0]),
        }
    }
}

/// A disc that no obstacle passes through.
struct Disc {
    center: Point2<f64>,
    radius: f64,
}

impl Disc {
    /// Whether a round object of `radius` gets from `from` to `to` around this disc in at most `within` m; true wherever the disc is not in
    /// the way.
    fn is_passed(&self, from: Point2<f64>, to: Point2<f64>, radius: f64, within: f64) -> bool {
        let (off, to_end, radius) = (from - self.center, to - self.center, self.radius + radius);
        let straight = (to - from).norm();
        let along = (to - from) / straight.max(1e-9);
        let nearest = off + along * (-off.dot(&along)).clamp(0.0, straight);
        let (far, far_end) = (off.norm(), to_end.norm());
        if radius <= 0.0 || nearest.norm() >= radius || far.min(far_end) < radius - DEPTH {
            return true;
        }
        // An object that touches the disc may be seen inside it.
        let (far, far_end) = (far.max(radius), far_end.max(radius));
        let tangents = (far * far - radius * radius).sqrt() + (far_end * far_end - radius * radius).sqrt();
        // No path around is shorter than its tangents, or than the straight line outside the disc.
        if tangents > within || straight - 2.0 * DEPTH > within {
            return false;
        }
        let bent = off.angle(&to_end) - (radius / far).acos() - (radius / far_end).acos();
        tangents + radius * bent.max(0.0) <= within
    }
}

impl<'a> BrakingMotion<'a> {
    /// A twist of this robot, with the age of its newest scan and its control period, s.
    #[must_use]
    pub fn new(
        footprint: &'a Footprint,
        drive: &Drive,
        twist: Twist2,
        age: f64,
        tick: f64,
        margin: f64,
        settings: &'a PassiveSafetySettings,
    ) -> Self {
        let (lag, braking) = (drive.motor_lag, drive.hard_braking);
        // While the robot brakes, its speed is `braking * lag` above the commanded one, which carries it `braking * lag²` farther.
        let is_slow = braking * lag * lag > LEAST_CLEARANCE;
        Self {
            footprint,
            twist,
            speed: drive.surface_speed(twist),
            reaction: age + tick + lag,
            braking,
            lag,
            trailing: if is_slow {
                (settings.lags_to_rest - 1.0).max(0.0) * lag
            } else {
                0.0
            },
            margin,
            settings,
        }
    }

    /// Distance until rest at a share of the speed, m.
    fn stopping_distance(&self, share: f64) -> f64 {
        let speed = share * self.speed;
        speed * (self.reaction + self.trailing) + 0.5 * speed * speed / self.braking
    }

    /// Time until rest at a share of the speed, s.
    fn stopping_time(&self, share: f64) -> f64 {
        self.reaction + share * self.speed / self.braking + self.settings.lags_to_rest * self.lag
    }

    /// The largest share that stops within a free distance (m).
    fn share_within(&self, free: f64) -> f64 {
        let lag = self.braking * (self.reaction + self.trailing);
        ((lag * lag + 2.0 * self.braking * free).sqrt() - lag) / self.speed
    }

    /// Limit by static obstacles, for a robot at `odom_from_base`.
    #[must_use]
    pub fn limit_static(&self, obstacles: &LocalObstacles, odom_from_base: Pose2) -> f64 {
        let near = self.footprint.circumscribed_radius() + self.margin + self.stopping_distance(1.0) + LEAST_CLEARANCE;
        let outer = SweptFootprint::new(self.footprint, self.margin, self.twist);
        let inner = SweptFootprint::new(self.footprint, LEAST_CLEARANCE.min(self.margin), self.twist);
        // A motion that hardly moves the outline, such as a disc that turns on the spot, needs no more room.
        let slow = HARMLESS / fastest_outward(self.footprint, self.twist).max(1e-9);
        let mut share: f64 = 1.0;
        for point in obstacles.in_base(odom_from_base) {
            if point.coords.norm_squared() > near * near {
                continue;
            }
            let stopping = if outer.contains(point) {
                0.0
            } else {
                let Some(time) = outer.time_to_contact(point) else {
                    continue;
                };
                self.share_within(self.speed * time)
            };
            if stopping >= share {
                continue;
            }
            let creeping = if inner.contains(point) {
                match share_beside(self.footprint, self.twist, point) {
                    // The rear swings past points last seen by a beam or two, with all their noise: at this speed contact is harmless.
                    0.0 if self.twist.v > 0.0 && obstacles.blind_spots().in_blind_spot(point) => {
                        GENTLE / closing_speed(self.footprint, self.twist, point)
                    }
                    share => share,
                }
            } else {
                let creep_time = self.settings.creep_time.max(self.lag + self.trailing);
                let creeping = inner.time_to_contact(point).map_or(1.0, |time| time / creep_time);
                creeping.max(slow)
            };
            share = share.min(stopping.max(creeping));
        }
        share
    }

    /// Limit by moving obstacles in view, each of their points by itself, and by the robots that announce their course: those nearly keep
    /// their velocity, or brake, which [`Self::limit_static`] covers.
    #[must_use]
    pub fn limit_dynamic(&self, obstacles: &LocalObstacles, odom_from_base: Pose2) -> f64 {
        let sweep_time = obstacles.sweep_time();
        let mut points: Vec<_> = obstacles.moving().in_base(odom_from_base).collect();
        let reach = self.footprint.circumscribed_radius() + self.margin + self.stopping_distance(1.0);
        let robots = obstacles.robots_in_base(odom_from_base, reach + FASTEST_ROBOT * self.stopping_time(1.0));
        points.extend(robots.into_iter().map(|(at, velocity)| Mover {
            at,
            radius: 0.0,
            velocity,
            speed: self.settings.robot_deviation,
            travelled: velocity.norm() * sweep_time,
        }));
        self.limit_among(&points)
    }

    /// Limit by moving obstacles: no point of the outline that one can reach by then, at its own speed and turning at will, moves outwards
    /// faster than gently. So the robot may move away at any speed, and is otherwise at rest before contact. No obstacle passes through the
    /// robot: from behind, it has a long way to the front.
    #[must_use]
    pub fn limit_among(&self, movers: &[Mover]) -> f64 {
        let stopping_time = self.stopping_time(1.0);
        let radius = self.footprint.circumscribed_radius() + self.margin + self.stopping_distance(1.0);
        let is_near = |mover: &&Mover| {
            let fastest = mover.velocity.norm() + mover.speed;
            mover.at.coords.norm() <= radius + mover.radius + mover.travelled + fastest * stopping_time
        };
        let near: Vec<Mover> = movers.iter().filter(is_near).copied().collect();
        if near.is_empty() {
            return 1.0;
        }
        let samples = outline_samples(self.footprint, 0.0);
        let safe = |share: &&f64| !self.may_be_touched(**share, &samples, &near);
        SHARES.iter().find(safe).copied().unwrap_or(0.0)
    }

    /// Limit by people who may come out from behind corners, as [`Self::limit_among`]; the robot creeps past where no speed is slow enough.
    #[must_use]
    pub fn limit_corners(&self, people: &[Mover]) -> f64 {
        self.limit_among(people)
            .max((self.settings.corner_speed / self.speed).min(1.0))
    }

    /// Bounds the robot's motion from a share of its speed until rest, in steps.
    fn until_rest(&self, share: f64) -> impl Iterator<Item = Step> + '_ {
        let (speed, all) = (share * self.speed, self.stopping_time(share));
        let (mut travelled, mut before) = (0.0, 0.0);
        (1..=STOPPING_STEPS).map(move |step| {
            let until = all * f64::from(step) / f64::from(STOPPING_STEPS);
            let share = (speed - self.braking * (before - self.reaction).max(0.0)).max(0.0) / self.speed;
            let after = travelled + share * (until - before);
            let step = Step {
                until,
                share,
                here_from_there: rigid(Pose2::IDENTITY.advance(self.twist, travelled)),
                way: [travelled, after].map(|secs| secs * self.twist.v.abs()),
            };
            (travelled, before) = (after, until);
            step
        })
    }

    /// Whether a mover may touch the outline where it moves outwards, before the robot is at rest from a share of its speed.
    fn may_be_touched(&self, share: f64, samples: &[(Point2<f64>, Vector2<f64>)], movers: &[Mover]) -> bool {
        let inscribed = self.footprint.inscribed_radius();
        self.until_rest(share).any(|step| {
            let there_from_here = step.here_from_there.inverse();
            let occupied = step.always_occupied(there_from_here, inscribed);
            movers.iter().any(|mover| {
                let place = there_from_here * (mover.at + mover.velocity * step.until);
                let way = (self.margin + mover.travelled + mover.speed * step.until).max(0.0);
                let reach = way + mover.radius;
                samples.iter().any(|(at, normal)| {
                    (place - at).norm_squared() <= reach * reach
                        && step.share * self.outward(*at, *normal) > GENTLE
                        && occupied.is_passed(place, at + normal * mover.radius, mover.radius, way)
                })
            })
        })
    }

    /// Limit by the lidar's blind spot: the outline moves over floor that was never seen no faster than `unseen` (m/s), and straight into
    /// the blind spot no faster than `allowed` (m/s), because an obstacle may have entered it unseen.
    #[must_use]
    pub fn limit_blind_spot(
        &self,
        obstacles: &LocalObstacles,
        odom_from_base: Pose2,
        allowed: f64,
        unseen: f64,
    ) -> f64 {
        let grid = obstacles.blind_spots();
        if !grid.has_blind_spot() {
            return 1.0;
        }
        let odom_from_base = rigid(odom_from_base);
        let reach = self.footprint.circumscribed_radius();
        let outline_speed = self.twist.v.abs() + self.twist.w.abs() * reach;
        let way = self.stopping_distance(1.0) * (outline_speed / self.speed).max(1.0);
        let poses = (way / SAMPLE).ceil().clamp(1.0, MAX_POSES);
        let step = way / outline_speed / poses;
        let samples: Vec<_> = outline_samples(self.footprint, self.margin + self.settings.unseen_margin)
            .into_iter()
            .filter(|(at, normal)| {
                // A point that moves outwards this slowly is harmless.
                self.outward(*at, *normal) > GENTLE
            })
            .map(|(at, normal)| {
                (
                    at,
                    at - normal * (self.margin + self.settings.unseen_margin - LEAST_CLEARANCE),
                    self.outward(at, normal),
                )
            })
            .collect();
        let mut share: f64 = 1.0;
        for pose in 1..=poses as u32 {
            let stopping = self.share_within(self.speed * f64::from(pose - 1) * step);
            if stopping >= share {
                break;
            }
            let there = rigid(Pose2::IDENTITY.advance(self.twist, f64::from(pose) * step));
            for (outer, inner, outward) in &samples {
                if GENTLE >= share * outward {
                    continue;
                }
                let floor = grid.floor(&odom_from_base, there * outer);
                // An occupied cell is coarse: its obstacle is also remembered as a point.
                let met = || grid.floor(&odom_from_base, there * inner) == Floor::Occupied;
                let harmless = match floor {
                    Floor::InSight => continue,
                    _ if met() => GENTLE,
                    Floor::Unknown => unseen.max(GENTLE),
                    Floor::Free | Floor::Occupied => continue,
                };
                share = share.min(stopping.max(harmless / outward));
            }
        }
        if grid.leads_into_blind_spot(self.twist.v) {
            share = share.min(allowed.max(GENTLE) / self.twist.v.abs().max(1e-9));
        }
        share.min(1.0)
    }

    /// Limit by moving obstacles that have left the field of view: each may be wherever it can have moved unseen by now, and comes out of
    /// there at its own speed. No point of the outline that it can reach before the robot is at rest moves outwards faster than gently:
    /// inside the blind spot by any motion, outside it by swinging towards an obstacle that may come into view.
    #[must_use]
    pub fn limit_occluded(&self, now: Stamp, obstacles: &LocalObstacles, odom_from_base: Pose2) -> f64 {
        let mut hidden: Vec<Hidden> = obstacles.hidden(now).collect();
        if hidden.is_empty() {
            return 1.0;
        }
        let samples: Vec<_> = outline_samples(self.footprint, 0.0)
            .into_iter()
            .map(|(at, normal)| {
                let swing = self.twist.w * (at.x * normal.y - at.y * normal.x);
                let is_blind = obstacles.blind_spots().in_blind_spot(at);
                (at, normal, if is_blind { self.outward(at, normal) } else { swing })
            })
            .filter(|(_, _, outward)| *outward > GENTLE)
            .collect();
        if self.twist.v <= 0.0 {
            // Turning on the spot or backing up is possible beside an obstacle that is half hidden: its size is not relied on there.
            hidden.iter_mut().for_each(|hidden| hidden.radius = 0.0);
        }
        let then_from_here = obstacles.base_at_newest_sweep().inverse() * rigid(odom_from_base);
        let safe = |share: &&f64| !self.may_be_met(**share, &samples, &hidden, obstacles, then_from_here);
        let share = SHARES.iter().find(safe).copied().unwrap_or(0.0);
        let fastest = samples.iter().map(|(_, _, outward)| *outward).fold(GENTLE, f64::max);
        share.max(GENTLE / fastest)
    }

    /// Whether a hidden obstacle may touch one of these points of the outline (with their normals and outward speeds, m/s) where it moves
    /// outwards, before the robot is at rest from a share of its speed.
    fn may_be_met(
        &self,
        share: f64,
        samples: &[(Point2<f64>, Vector2<f64>, f64)],
        hidden: &[Hidden],
        obstacles: &LocalObstacles,
        then_from_here: Isometry2<f64>,
    ) -> bool {
        self.until_rest(share).any(|step| {
            let then_from_there = then_from_here * step.here_from_there;
            let moving = samples.iter().filter(|(_, _, outward)| step.share * outward > GENTLE);
            moving.into_iter().any(|(at, normal, _)| {
                hidden.iter().any(|hidden| {
                    // The obstacle's center when it touches that point.
                    let center = then_from_there * (at + normal * hidden.radius);
                    let reach = self.margin + hidden.speed * step.until;
                    let known = reach + hidden.radius + hidden.travelled;
                    (center - hidden.last_seen).norm_squared() <= known * known
                        && hidden.radius - obstacles.depth_out_of_sight(center) <= reach
                })
            })
        })
    }

    /// How fast a point of the outline moves along its normal, m/s.
    fn outward(&self, at: Point2<f64>, normal: Vector2<f64>) -> f64 {
        outward(self.twist, at, normal)
    }
}

/// The contact point for a bumper bearing (base frame, rad), just outside the outline.
pub(crate) fn contact_point(footprint: &Footprint, bearing: f64) -> Point2<f64> {
    let toward = Vector2::new(bearing.cos(), bearing.sin());
    // Bisection along the bearing.
    let (mut inside, mut outside) = (0.0, 2.0 * footprint.circumscribed_radius());
    for _ in 0..20 {
        let middle = 0.5 * (inside + outside);
        if footprint.distance(Point2::from(toward * middle)) > 0.0 {
            outside = middle;
        } else {
            inside = middle;
        }
    }
    Point2::from(toward * (outside + 1e-3))
}

/// Points on the grown outline with their outward normals, base frame.
fn outline_samples(footprint: &Footprint, margin: f64) -> Vec<(Point2<f64>, Vector2<f64>)> {
    match footprint {
        Footprint::Radius(radius) => {
            let radius = radius + margin;
            let count = (std::f64::consts::TAU * radius / SAMPLE).ceil().clamp(8.0, 1000.0);
            (0..count as u32)
                .map(|step| {
                    let angle = f64::from(step) * std::f64::consts::TAU / count;
                    let normal = Vector2::new(angle.cos(), angle.sin());
                    (Point2::from(normal * radius), normal)
                })
                .collect()
        }
        Footprint::Polygon(corners) => {
            let normal = |a: &Point2<f64>, b: &Point2<f64>| {
                let along = (b - a).normalize();
                Vector2::new(along.y, -along.x)
            };
            let mut samples: Vec<_> = edges(corners)
                .flat_map(|Edge { a, b }| {
                    let along = (b - a).normalize();
                    let normal = normal(&a, &b);
                    let length = (b - a).norm() + 2.0 * margin;
                    let count = (length / SAMPLE).ceil().clamp(1.0, 1000.0);
                    let from = a + (normal - along) * margin;
                    (0..=count as u32).map(move |step| (from + along * (length * f64::from(step) / count), normal))
                })
                .collect();
            // A corner can be touched from between its two sides as well.
            let before = corners.iter().cycle().skip(corners.len() - 1);
            let after = corners.iter().cycle().skip(1);
            samples.extend(corners.iter().zip(before).zip(after).map(|((corner, before), after)| {
                let between = (normal(before, corner) + normal(corner, after)).normalize();
                (corner + between * margin, between)
            }));
            samples
        }
    }
}

/// Largest speed at which a twist moves any point of the outline outwards, m/s.
pub(crate) fn fastest_outward(footprint: &Footprint, twist: Twist2) -> f64 {
    let samples = outline_samples(footprint, 0.0);
    let outward = samples.iter().map(|(at, normal)| outward(twist, *at, *normal));
    outward.fold(0.0, f64::max)
}

/// How fast a point of the outline moves along its normal, m/s.
fn outward(twist: Twist2, at: Point2<f64>, normal: Vector2<f64>) -> f64 {
    Vector2::new(twist.v - twist.w * at.y, twist.w * at.x).dot(&normal)
}

/// How fast a twist brings the outline nearer to a static point (base frame), m/s; negative: away from it.
pub(crate) fn closing_speed(footprint: &Footprint, twist: Twist2, point: Point2<f64>) -> f64 {
    const STEP: f64 = 1e-3;
    let motion = Vector2::new(twist.w * point.y - twist.v, -twist.w * point.x);
    let (here, there) = (footprint.distance(point), footprint.distance(point + motion * STEP));
    if here > 0.0 {
        (here - there) / STEP
    } else {
        // Inside the outline, by noise or in contact: sliding along a side does not come nearer. At a corner both sides count.
        match footprint {
            Footprint::Radius(_) => -point.coords.dot(&motion) / point.coords.norm().max(1e-9),
            Footprint::Polygon(corners) => {
                let inward = |Edge { a, b }| {
                    let along = (b - a).normalize();
                    (along.perp(&(point - a)), along.perp(&motion))
                };
                let depth = edges(corners).map(|edge| inward(edge).0).fold(f64::INFINITY, f64::min);
                edges(corners)
                    .map(inward)
                    .filter(|(deep, _)| *deep <= depth + CORNER)
                    .map(|(_, closing)| closing)
                    .fold(f64::NEG_INFINITY, f64::max)
            }
        }
    }
}

/// The share of a twist allowed beside a point (base frame) that the robot may not approach: all of a twist that leads away; of one that
/// slides along the point, as much as stays harmless given the errors of drive and sensors; nothing of one that leads towards it.
pub(crate) fn share_beside(footprint: &Footprint, twist: Twist2, point: Point2<f64>) -> f64 {
    let closing = closing_speed(footprint, twist, point);
    if closing <= RESTING {
        1.0
    } else if closing <= (SLIDING * twist.v.abs()).max(HARMLESS) {
        (HARMLESS / closing).min(1.0)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// A disc of half a metre, 1 m to the left.
    const DISC: Disc = Disc {
        center: Point2::new(0.0, 1.0),
        radius: 0.5,
    };

    #[test]
    fn around_a_disc_lead_tangents_and_an_arc_where_it_is_in_the_way() {
        let passed = |from, to, radius, within| DISC.is_passed(Point2::from(from), Point2::from(to), radius, within);
        let takes = |from, to, way: f64| !passed(from, to, 0.0, way - 1e-6) && passed(from, to, 0.0, way + 1e-6);
        assert!(takes([0.0, 0.5], [0.0, 1.5], 0.5 * PI), "half around");
        // A tangent, a quarter of the circle, a tangent.
        assert!(takes([-0.5, 0.5], [0.5, 1.5], 1.0 + 0.5 * FRAC_PI_2));
        assert!(passed([-2.0, 0.4], [2.0, 0.4], 0.0, 1.0), "past it");
        // Something round goes around on a wider circle.
        assert!(!passed([-2.0, 0.4], [2.0, 0.4], 0.2, 4.0) && passed([-2.0, 0.4], [2.0, 0.4], 0.2, 4.1));
    }

    #[test]
    fn past_a_corner_it_creeps_at_a_set_speed() {
        let model = zenav_fixtures::robot("tiago");
        let ahead = Twist2::new(0.5, 0.0);
        let person = Mover::at_will(
            Point2::new(model.footprint.circumscribed_radius() + 0.01, 0.0),
            0.0,
            1.4,
        );
        for corner_speed in [0.1, 0.2] {
            let settings = PassiveSafetySettings {
                corner_speed,
                ..PassiveSafetySettings::default()
            };
            let motion = BrakingMotion::new(&model.footprint, &model.drive, ahead, 0.05, 0.02, 0.05, &settings);
            assert!((motion.limit_corners(&[person]) * motion.speed - corner_speed).abs() < 1e-9);
        }
    }

    #[test]
    fn who_leans_on_the_robot_from_behind_does_not_hold_it_and_who_stands_ahead_does() {
        let model = zenav_fixtures::robot("tiago");
        let settings = PassiveSafetySettings::default();
        let ahead = Twist2::new(0.3, 0.0);
        let motion = BrakingMotion::new(&model.footprint, &model.drive, ahead, 0.05, 0.02, 0.05, &settings);
        let at = |bearing: f64| {
            let touching = model.footprint.circumscribed_radius() + 0.01;
            Mover::at_will(
                Point2::new(touching * bearing.cos(), touching * bearing.sin()),
                0.0,
                1.0,
            )
        };
        assert_eq!(motion.limit_among(&[at(PI)]), 1.0);
        assert_eq!(motion.limit_among(&[at(0.0)]), 0.0);
        assert!(
            motion.limit_among(&[at(FRAC_PI_2)]) < 1.0,
            "it is not far around a quarter of the robot"
        );
    }
}
